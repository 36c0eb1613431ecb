"""Sections ``top``, ``scheme`` and ``initial`` and the recorded columns, which depend on the top."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import chain
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, PlainValidator, create_model

from topcli.analysis.columns import ATTITUDES, spellings
from topcli.config.document import STRICT, KeyPath, Problems, describe, number_of, validate
from topcli.config.models import UNIT_LIMIT, UNIT_TOLERANCE, Output
from topcli.contracts import Invariant, Scheme, Top
from topcli.errors import nearest, quoted
from topcli.schemes.compose import COMPOSITIONS
from topcli.schemes.own_tops import top_class, top_names
from topcli.schemes.registry import find_scheme, names_for
from topcli.tops import CUSTOM

AUTO = {"auto": 1.0, "+auto": 1.0, "-auto": -1.0}
"""Texts for a component that completes a unit vector, with the component's sign."""


def read_top(raw: object, initial: object, problems: Problems) -> tuple[type[Top] | None, Top | None]:
    """Return the class of the top, and the top with its parameters; None for each that cannot be read.

    The vectors named in ``initial`` choose among the forms of a top.
    """
    section = _named_section(raw, "top", "kind", top_names, problems)
    if section is None:
        return None, None
    kind, where, parameters = section
    if kind.lower() == CUSTOM:
        from topcli.config.formulas import read_custom  # whose models other configs do not need

        return read_custom(parameters, problems)
    with problems.at(*where):
        cls = top_class(kind, [key for key in initial if key != "normalize"] if isinstance(initial, dict) else ())
        return cls, top_with(cls, parameters, problems)
    return None, None


def top_with(cls: type[Top], parameters: Mapping[str, Any], problems: Problems) -> Top | None:
    """Return the top of class ``cls`` with these parameters; None, and a problem, if they cannot be used."""
    before = len(problems.messages)
    top = validate(cls, parameters, ("top",), problems, beside=("kind",))
    if top is not None and cls.kind == CUSTOM:
        from topcli.config.formulas import check_numbers
        from topcli.tops.declared import Declared

        assert isinstance(top, Declared)
        check_numbers(top, problems)
    return top if len(problems.messages) == before else None


def read_scheme(raw: object, cls: type[Top], problems: Problems) -> tuple[Scheme, BaseModel] | None:
    """Return the scheme for tops of class ``cls``, composed if ``compose`` is given, and its options."""
    section = _named_section(raw, "scheme", "name", lambda: names_for(cls.form), problems)
    if section is None:
        return None
    name, where, given = section
    scheme = None
    with problems.at(*where):
        scheme = find_scheme(name, cls.form)
    if scheme is not None and "compose" in given:
        simple, scheme = scheme, None
        with problems.at("scheme", "compose"):
            if not isinstance(compose := given["compose"], str):
                raise ValueError(f"must be a name ({', '.join(COMPOSITIONS)}), not {describe(compose)}")
            scheme = find_scheme(f"{simple.name}+{compose}", cls.form)
    if scheme is None:
        return None
    options = validate(scheme.options, given, ("scheme",), problems, beside=("name", "compose"))
    return None if options is None else (scheme, options)


def _named_section(
    raw: object, section: str, key: str, names: Callable[[], list[str]], problems: Problems
) -> tuple[str, KeyPath, dict[str, Any]] | None:
    """Return the name, its path and the whole section, from a bare name or a section with ``key``.

    ``names`` lists the known names and is called only for a message.
    """
    if isinstance(raw, str):
        return raw, (section,), {key: raw}
    if isinstance(raw, dict) and isinstance(raw.get(key), str):
        return raw[key], (section, key), raw
    known = ", ".join(names())
    if not isinstance(raw, dict):
        problems.add((section,), f"must be a name ({known}) or a section with {key!r}, not {describe(raw)}")
    elif key not in raw:
        misspelt = [other for other in raw if other.lower() == key]
        missing = f"{key!r} is missing; known: {known}"
        problems.add((section,), f"{misspelt[0]!r} should be {key!r}" if misspelt else missing)
    else:
        problems.add((section, key), f"must be a name ({known}), not {describe(raw[key])}")
    return None


@dataclass(frozen=True)
class Vector:
    """Type of a vector of the initial state: finite numbers; a unit vector may be completed or scaled."""

    name: str
    components: tuple[str, ...]
    unit: bool

    @property
    def type(self) -> Any:
        """Annotation of a field of pydantic."""
        size, number = len(self.components), float | Literal["auto", "+auto", "-auto"] if self.unit else float
        numbers: Any = Annotated[list[number], Field(min_length=size, max_length=size)]  # type: ignore[valid-type]
        numbers = number | numbers if size == 1 else numbers
        return Annotated[
            list[float],
            PlainValidator(
                lambda raw, info: self.read(raw, info.data.get("normalize", False)), json_schema_input_type=numbers
            ),
        ]

    @property
    def description(self) -> str:
        """Components and how they may be given."""
        if len(self.components) == 1:
            return "a number"
        auto = "; auto completes it to a unit vector, -auto with a negative number" if self.unit else ""
        return f"({', '.join(self.components)}){auto}"

    def read(self, raw: object, normalize: bool) -> list[float]:
        """Return the vector, completed, or scaled if it is to be normalized; a number is one component.

        Raises ValueError.
        """
        if len(self.components) == 1 and not isinstance(raw, list):
            raw = [raw]
        if not isinstance(raw, list) or len(raw) != len(self.components):
            given = len(raw) if isinstance(raw, list) else describe(raw)
            wanted = f"{len(self.components)} numbers ({', '.join(self.components)})"
            raise ValueError(f"must be a list of {wanted}, not {given}")
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


@cache
def initial_model(cls: type[Top]) -> type[BaseModel]:
    """Model of the section ``initial`` for tops of class ``cls``."""
    vectors: dict[str, Any] = {
        vector.name: (vector.type, Field(description=vector.description)) for vector in vectors_of(cls)
    }
    scaled = f"if true, {', '.join(cls.unit_vectors) or 'each unit vector'} is scaled to unit length"
    normalize = (bool, Field(default=False, description=scaled))  # first, because the vectors depend on it
    return create_model("Initial", __config__=STRICT, normalize=normalize, **vectors)


def read_initial(
    raw: object, cls: type[Top], problems: Problems, path: KeyPath = ("initial",)
) -> tuple[float, ...] | None:
    """Return the initial state in the order of the top's components, its unit vectors completed and checked."""
    initial = validate(initial_model(cls), raw, path, problems)
    return None if initial is None else tuple(chain.from_iterable(getattr(initial, name) for name in cls.vectors))


def read_columns(
    output: Output, components: Sequence[str], integrals: Sequence[Invariant], problems: Problems
) -> tuple[str, ...] | None:
    """Names of the columns of ``output``, each given by its name or by the symbol that reports print."""
    given = output.columns
    if given is None:
        return None
    plain = {name: name for name in ("n", "t", *components, *(output.quantities or ()), *output.attitude_columns)}
    names = {
        text: integral.name for integral in integrals for text in spellings(integral.name, integral.symbol)
    } | plain
    chosen: list[str] = []
    for text in given:
        name = names.get(text)
        form = next((form for form, columns in ATTITUDES.items() if text in columns), None)
        if name is None and form:
            problems.add(("output", "columns"), f"{quoted(text)} needs output.attitude: {form}")
        elif name is None:
            hint = nearest(text, names)
            if hint.startswith("known"):
                hint = f"known: {', '.join([*plain, *(f'{known.name} ({known.symbol})' for known in integrals)])}"
            problems.add(("output", "columns"), f"unknown column {quoted(text)}; {hint}")
        elif name in chosen:
            problems.add(("output", "columns"), f"names {quoted(name)} twice")
        else:
            chosen.append(name)
    return tuple(chosen)
