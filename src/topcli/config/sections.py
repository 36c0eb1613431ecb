"""The sections whose keys depend on the top and the scheme: ``top``, ``initial``, ``scheme``, columns."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from pydantic import BaseModel

from topcli.analysis.columns import spellings
from topcli.config.document import KeyPath, describe
from topcli.config.problems import Problems, unknown_key, validate
from topcli.contracts import Invariant, Scheme, Top
from topcli.errors import UnknownNameError, UsageError, nearest, quoted
from topcli.schemes.compose import COMPOSITIONS
from topcli.schemes.registry import composed, find_scheme, names_for
from topcli.tops import top_class, top_names

UNIT_TOLERANCE = 1e-12
AUTO = {"auto": 1.0, "+auto": 1.0, "-auto": -1.0}


def read_top(raw: object, initial: object, problems: Problems) -> tuple[type[Top] | None, Top | None]:
    """The class of the top, and the top with its parameters; None for what cannot be read.

    The vectors named in ``initial`` choose among the forms of a top.
    """
    section = _named_section(raw, "top", "kind", top_names, problems)
    if section is None:
        return None, None
    kind, where, parameters = section
    try:
        cls = top_class(kind, [key for key in initial if key != "normalize"] if isinstance(initial, dict) else ())
    except UnknownNameError as error:
        problems.add(where, str(error), unknown_name=True)
        return None, None
    return cls, validate(cls, parameters, ("top",), problems, beside=("kind",))


def read_scheme(raw: object, cls: type[Top], problems: Problems) -> tuple[Scheme, BaseModel] | None:
    """The scheme for tops of class ``cls``, composed where ``compose`` says so, with its options."""
    section = _named_section(raw, "scheme", "name", lambda: names_for(cls.form), problems)
    if section is None:
        return None
    name, where, given = section
    composition = given.get("compose", "")
    if "compose" in given and not isinstance(composition, str):
        problems.add(("scheme", "compose"), f"must be a name ({', '.join(COMPOSITIONS)}), not {describe(composition)}")
        return None
    try:
        scheme = find_scheme(name, cls.form)
        if "compose" in given:
            where = ("scheme", "compose")
            scheme = composed(scheme, composition)
    except UsageError as error:
        problems.add(where, str(error), unknown_name=isinstance(error, UnknownNameError))
        return None
    options = validate(scheme.options, given, ("scheme",), problems, beside=("name", "compose"))
    return None if options is None else (scheme, options)


def _named_section(
    raw: object, section: str, key: str, names: Callable[[], list[str]], problems: Problems
) -> tuple[str, KeyPath, dict[str, Any]] | None:
    """Name, the path where it stands, and the whole section, of a bare name or of a section with ``key``.

    The known ``names`` are asked for only where a message needs them.
    """
    if isinstance(raw, str):
        return raw, (section,), {key: raw}
    if isinstance(raw, dict) and isinstance(raw.get(key), str):
        return raw[key], (section, key), raw
    known = ", ".join(names())
    if not isinstance(raw, dict):
        problems.add((section,), f"must be a name ({known}) or a section with {key!r}, not {describe(raw)}")
    elif key not in raw:
        near = [other for other in raw if other.lower() == key]
        missing = f"{key!r} is missing; known: {known}"
        problems.add((section,), f"{near[0]!r} should be {key!r}" if near else missing)
    else:
        problems.add((section, key), f"must be a name ({known}), not {describe(raw[key])}")
    return None


def read_initial(raw: object, cls: type[Top], problems: Problems) -> tuple[float, ...] | None:
    """The initial state in the order of the top's components, its unit vectors completed and checked."""
    names = list(cls.vectors)
    if not isinstance(raw, dict):
        problems.add(("initial",), f"must be a section with {', '.join(names)}, not {describe(raw)}")
        return None
    for key in raw:
        if key not in (*names, "normalize"):
            problems.add(("initial", key), unknown_key(key, [*names, "normalize"]))
    normalize = raw.get("normalize", False)
    if not isinstance(normalize, bool):
        problems.add(("initial", "normalize"), f"must be true or false, not {describe(normalize)}")
        return None
    state = [0.0] * len(cls.components)
    complete = True
    for name, (start, stop) in cls.vectors.items():
        if name not in raw:
            problems.add(("initial", name), f"missing; give a list of {stop - start} numbers")
            vector = None
        else:
            vector = read_vector(raw[name], cls, name, normalize, problems)
        if vector is None:
            complete = False
        else:
            state[start:stop] = vector
    return tuple(state) if complete else None


def read_vector(raw: object, cls: type[Top], name: str, normalize: bool, problems: Problems) -> list[float] | None:
    """The vector ``name`` of the initial state, complete; None when it is wrong."""
    start, stop = cls.vectors[name]
    components = cls.components[start:stop]
    path: KeyPath = ("initial", name)
    unit = name in cls.unit_vectors
    if not isinstance(raw, list) or len(raw) != len(components):
        given = f"{len(raw)}" if isinstance(raw, list) else describe(raw)
        wanted = f"{len(components)} numbers ({', '.join(components)})"
        problems.add(path, f"must be a list of {wanted}, not {given}")
        return None
    vector: list[float] = []
    autos: list[int] = []
    for index, (value, component) in enumerate(zip(raw, components, strict=True)):
        number = number_of(value)
        if unit and isinstance(value, str) and value in AUTO:
            autos.append(index)
            vector.append(AUTO[value])
        elif number is None:
            ending = ", or auto, +auto, -auto" if unit else ""
            problems.add(path, f"{component} must be a number{ending}, not {describe(value)}")
        elif not math.isfinite(number):
            problems.add(path, f"{component} must be a finite number, not {describe(value)}")
        else:
            vector.append(number)
    if len(vector) < len(components):
        return None
    if len(autos) > 1:
        problems.add(path, f"only one component may be auto, not {len(autos)}")
        return None
    if autos:
        return _completed(vector, autos[0], path, problems)
    return _unit(vector, normalize, path, problems) if unit else vector


def number_of(value: object) -> float | None:
    """``value`` as a float, infinite where it is too large for one; None when it is no number."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _completed(vector: list[float], auto: int, path: KeyPath, problems: Problems) -> list[float] | None:
    """``vector`` with component ``auto``, which holds the sign, set so that the length is one."""
    rest = sum(value * value for index, value in enumerate(vector) if index != auto)
    if rest > 1.0 + UNIT_TOLERANCE:
        others = f"the squares of the others sum to {rest:.15g} > 1"
        problems.add(path, f"auto cannot make it a unit vector: {others}; make them smaller")
        return None
    size = math.sqrt(max(1.0 - rest, 0.0))
    vector[auto] = math.copysign(size, vector[auto]) if size else 0.0
    return vector


def _unit(vector: list[float], normalize: bool, path: KeyPath, problems: Problems) -> list[float] | None:
    """``vector`` when it has unit length, or scaled to it on request."""
    if normalize:
        largest = max(abs(value) for value in vector)
        if largest == 0.0:
            problems.add(path, "is the zero vector, which has no direction to normalize")
            return None
        scaled = [value / largest for value in vector]  # first, so that no square over- or underflows
        length = math.hypot(*scaled)
        return [value / length for value in scaled]
    square = sum(value * value for value in vector)
    excess = square - 1.0
    if abs(excess) <= UNIT_TOLERANCE:
        return vector
    name = path[-1]
    problems.add(
        path,
        f"must be a unit vector: {name}² = {square:.15g} is off by {excess:.3g} (allowed: {UNIT_TOLERANCE:g})"
        "; write one component as auto, or set initial.normalize: true",
    )
    return None


def read_columns(
    given: tuple[str, ...] | None, components: Sequence[str], integrals: Sequence[Invariant], problems: Problems
) -> tuple[str, ...] | None:
    """Names of the ``given`` columns, each of which may be a name or the symbol that reports print."""
    if given is None:
        return None
    plain = {name: name for name in ("n", "t", *components)}
    names = {text: one.name for one in integrals for text in spellings(one.name, one.symbol)} | plain
    found: list[str] = []
    for text in given:
        name = names.get(text)
        if name is None:
            near = nearest(text, names)
            if near.startswith("known"):
                near = f"known: {', '.join([*plain, *(f'{one.name} ({one.symbol})' for one in integrals)])}"
            problems.add(("output", "columns"), f"unknown column {quoted(text)}; {near}")
        elif name in found:
            problems.add(("output", "columns"), f"names {quoted(name)} twice")
        else:
            found.append(name)
    return tuple(found)
