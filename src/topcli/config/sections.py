"""Sections ``top``, ``scheme`` and ``initial`` and the recorded columns, which depend on the top."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from pydantic import BaseModel

from topcli.config.document import Document, describe, number_of, unknown_key
from topcli.config.models import UNIT_LIMIT, UNIT_TOLERANCE, Output
from topcli.config.text import KeyPath
from topcli.contracts import Invariant, Scheme, Top
from topcli.engine.columns import ATTITUDES, spellings
from topcli.errors import nearest, quoted
from topcli.schemes.compose import COMPOSITIONS
from topcli.schemes.own_tops import top_class, top_names
from topcli.schemes.registry import find_scheme, names_for
from topcli.tops import CUSTOM

AUTO = {"auto": 1.0, "+auto": 1.0, "-auto": -1.0}
"""Texts for a component that completes a unit vector, with the component's sign."""


def read_top(raw: object, initial: object, document: Document) -> tuple[type[Top] | None, Top | None]:
    """Return the class of the top, and the top with its parameters; None for each that cannot be read.

    The vectors named in ``initial`` choose among the forms of a top.
    """
    section = _named_section(raw, "top", "kind", top_names, document)
    if section is None:
        return None, None
    kind, where, parameters = section
    if kind.lower() == CUSTOM:
        from topcli.config.formulas import read_custom  # whose models other configs do not need

        return read_custom(parameters, document)
    with document.at(*where):
        cls = top_class(kind, [key for key in initial if key != "normalize"] if isinstance(initial, dict) else ())
        return cls, top_with(cls, parameters, document)
    return None, None


def top_with(cls: type[Top], parameters: Mapping[str, Any], document: Document) -> Top | None:
    """Return the top of class ``cls`` with these parameters; None, and a fault, if they cannot be used."""
    before = len(document.faults)
    top = document.read(cls, parameters, "top", beside=("kind",))
    if top is not None and cls.kind == CUSTOM:
        from topcli.config.formulas import check_numbers
        from topcli.tops.declared import Declared

        assert isinstance(top, Declared)
        check_numbers(top, document)
    return top if len(document.faults) == before else None


def read_scheme(raw: object, cls: type[Top], document: Document) -> tuple[Scheme, BaseModel] | None:
    """Return the scheme for tops of class ``cls``, composed if ``compose`` is given, and its options."""
    section = _named_section(raw, "scheme", "name", lambda: names_for(cls.form), document)
    if section is None:
        return None
    before, (name, where, given) = len(document.faults), section
    with document.at(*where):
        scheme = find_scheme(name, cls.form)
        if "compose" in given:
            with document.at("scheme", "compose"):
                if not isinstance(compose := given["compose"], str):
                    raise ValueError(f"must be a name ({', '.join(COMPOSITIONS)}), not {describe(compose)}")
                scheme = find_scheme(f"{scheme.name}+{compose}", cls.form)
        options = document.read(scheme.options, given, "scheme", beside=("name", "compose"))
        return (scheme, options) if options is not None and len(document.faults) == before else None
    return None


def _named_section(
    raw: object, section: str, key: str, names: Callable[[], list[str]], document: Document
) -> tuple[str, KeyPath, dict[str, Any]] | None:
    """Return the name, its path and the whole section, from a bare name or a section with ``key``.

    ``names`` lists the known names and is called only for a message.
    """
    if isinstance(raw, str):
        return raw, (section,), {key: raw}
    if isinstance(raw, dict) and isinstance(raw.get(key), str):
        return raw[key], (section, key), raw
    known = ", ".join(names())
    if isinstance(raw, dict) and key not in raw:
        document.fault((section,), f"{key!r} is missing; known: {known}")
    else:
        given = describe(raw[key] if isinstance(raw, dict) else raw)
        document.fault((section,), f"must be a name ({known}) or a section with {key!r}, not {given}")
    return None


@dataclass(frozen=True)
class Vector:
    """A vector of the initial state: finite numbers; a unit vector may be completed or scaled."""

    name: str
    components: tuple[str, ...]
    unit: bool

    def read(self, raw: object, normalize: bool) -> list[float]:
        """Return the vector, completed, or scaled if it is to be normalized; a number is one component.

        Raises ValueError.
        """
        if len(self.components) == 1 and not isinstance(raw, list):
            raw = [raw]
        if not isinstance(raw, list) or len(raw) != len(self.components):
            given = len(raw) if isinstance(raw, list) else describe(raw)
            numbers = f"{len(self.components)} numbers ({', '.join(self.components)})"
            raise ValueError(f"must be a list of {numbers}, not {given}")
        signs = {i: AUTO[x] for i, x in enumerate(raw) if self.unit and isinstance(x, str) and x in AUTO}
        vector: list[Any] = [signs[i] if i in signs else number_of(x) for i, x in enumerate(raw)]
        for component, given, number in zip(self.components, raw, vector, strict=True):
            if number is None:
                words = ", or auto, +auto, -auto" if self.unit else ""
                raise ValueError(f"{component} must be a number{words}, not {describe(given)}")
            if not math.isfinite(number):
                raise ValueError(f"{component} must be a finite number, not {describe(given)}")
        if len(signs) > 1:
            raise ValueError(f"only one component may be auto, not {len(signs)}")
        return self._unit(vector, signs, normalize) if self.unit else vector

    def _unit(self, vector: list[float], signs: dict[int, float], normalize: bool) -> list[float]:
        """Return ``vector`` of unit length: completed at the place in ``signs``, scaled, or as it is."""
        for auto, sign in signs.items():
            rest = sum(value * value for i, value in enumerate(vector) if i != auto)
            if rest > 1.0 + UNIT_TOLERANCE:
                others = f"the squares of the others sum to {rest:.15g} > 1"
                raise ValueError(f"auto cannot make it a unit vector: {others}; make them smaller")
            size = math.sqrt(max(1.0 - rest, 0.0))
            vector[auto] = math.copysign(size, sign) if size else 0.0
            return vector
        if normalize:
            largest = max(map(abs, vector))
            if largest == 0.0:
                raise ValueError("is the zero vector, which has no direction to normalize")
            scaled = [value / largest for value in vector]  # first, so that no square over- or underflows
            length = math.hypot(*scaled)
            return [value / length for value in scaled]
        square = sum(value * value for value in vector)
        if abs(square - 1.0) > UNIT_LIMIT:
            raise ValueError(
                f"must be a unit vector: {self.name}² = {square:.15g} is off by {square - 1.0:.3g} (allowed: "
                f"{UNIT_LIMIT:g}); write one component as auto, or set initial.normalize: true"
            )
        return vector


@cache
def vectors_of(cls: type[Top]) -> list[Vector]:
    """Vectors of the initial state of tops of class ``cls``."""
    return [
        Vector(name, cls.components[start:stop], name in cls.unit_vectors)
        for name, (start, stop) in cls.vectors.items()
    ]


def read_initial(
    raw: object, cls: type[Top], document: Document, path: KeyPath = ("initial",)
) -> tuple[float, ...] | None:
    """Return the initial state in the order of the top's components, its unit vectors completed and checked."""
    before, keys = len(document.faults), [*cls.vectors, "normalize"]
    if not isinstance(raw, dict):
        return document.fault(path, f"must be a section with {', '.join(keys)}, not {describe(raw)}")
    for key in (key for key in raw if key not in keys):
        document.fault((*path, key), unknown_key(key, keys))
    if not isinstance(normalize := raw.get("normalize", False), bool):
        document.fault((*path, "normalize"), f"must be true or false, not {describe(normalize)}")
    state: list[float] = []
    for vector in vectors_of(cls):
        if vector.name not in raw:
            form = f"({', '.join(vector.components)})" if len(vector.components) > 1 else "a number"
            auto = "; auto completes it to a unit vector" if vector.unit else ""
            document.fault((*path, vector.name), f"missing; give {form}{auto}")
            continue
        with document.at(*path, vector.name):
            state += vector.read(raw[vector.name], normalize is True)
    return tuple(state) if len(document.faults) == before else None


def read_columns(
    output: Output, components: Sequence[str], integrals: Sequence[Invariant], document: Document
) -> tuple[str, ...] | None:
    """Names of the columns of ``output``, each given by its name or by the symbol that reports print."""
    if output.columns is None:
        return None
    names = {text: integral.name for integral in integrals for text in spellings(integral.name, integral.symbol)}
    names |= {name: name for name in ("n", "t", *components, *(output.quantities or ()), *output.attitude_columns)}
    chosen: list[str] = []
    for text in output.columns:
        name = names.get(text)
        form = next((form for form, columns in ATTITUDES.items() if text in columns), None)
        if name is None:
            hint = f"it needs output.attitude: {form}" if form else nearest(text, names)
            document.fault(("output", "columns"), f"unknown column {quoted(text)}; {hint}")
        elif name in chosen:
            document.fault(("output", "columns"), f"names {quoted(name)} twice")
        else:
            chosen.append(name)
    return tuple(chosen)
