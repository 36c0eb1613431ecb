"""The sections ``top``, ``scheme`` and ``initial``, and the recorded columns: their keys depend on the top."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import chain
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, PlainValidator, create_model

from topcli.analysis.columns import ATTITUDES, spellings
from topcli.config.document import STRICT, KeyPath, Problems, WrittenFloat, describe, number_of, validate
from topcli.config.models import Output
from topcli.contracts import Invariant, Scheme, Top
from topcli.errors import nearest, quoted
from topcli.schemes.compose import COMPOSITIONS
from topcli.schemes.registry import composed, find_scheme, names_for
from topcli.tops import CUSTOM, TOPS, top_class, top_names

UNIT_TOLERANCE = 1e-12
"""Deviation of the square of a unit vector from 1 that is accepted."""
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
        return read_custom(parameters, problems)
    with problems.at(*where):
        cls = top_class(kind, [key for key in initial if key != "normalize"] if isinstance(initial, dict) else ())
        return cls, validate(cls, parameters, ("top",), problems, beside=("kind",))
    return None, None


class CustomSection(BaseModel):
    """The section ``top`` of a top that the config declares, beside its kind."""

    model_config = STRICT

    components: list[str] = Field(min_length=1, description="names of the components of the state, in order")
    parameters: dict[str, float] = Field(default={}, description="names of the parameters, with their values")
    field: dict[str, Any] = Field(description="for each component, its rate of change: a formula")
    invariants: dict[str, Any] = Field(
        default={},
        description="formulas of what is conserved; only on a level of others: {value: ..., on: {...}}",
    )


class Relation(BaseModel):
    """Invariant that is conserved on a level of other invariants."""

    model_config = STRICT

    value: Any = Field(description="the formula")
    on: dict[str, float] = Field(default={}, description="values of invariants where it is conserved")


CHECKED_TOPS = 64
"""Sets of parameters of one top whose integrals are checked; a sweep may have a million."""
_checked: dict[str, set[Top]] = {}


def read_custom(raw: dict[str, Any], problems: Problems) -> tuple[type[Top] | None, Top | None]:
    """Return the class of a top that a config declares, and the top; None for each that cannot be read."""
    from topcli.tops.custom import custom_class

    before = len(problems.messages)
    given = raw.get("parameters")
    section = validate(
        CustomSection, raw, ("top",), problems, beside=("kind", *(given if isinstance(given, dict) else ()))
    )
    if section is None:
        return None, None
    named = _check_names(section, problems)
    if len(problems.messages) > before:
        return None, None
    formulas = {
        (key, name): _formula(value, ("top", key, name), named, problems)
        for key, part in (("field", section.field), ("invariants", section.invariants))
        for name, value in part.items()
    }
    if len(problems.messages) > before:
        return None, None
    declared = section.model_dump()
    for (key, name), value in formulas.items():
        declared[key][name] = value
    cls = custom_class(declared)
    TOPS.declared[cls.form] = cls
    top = validate(cls, cls.parameters_in({**declared, **raw, "parameters": section.parameters}), ("top",), problems)
    if top is not None:
        _check_numbers(top, problems)
    return cls, top if len(problems.messages) == before else None


def declared_class(section: object) -> type[Top] | None:
    """Class of a top that a resolved section ``top`` declares; None for other tops."""
    if not isinstance(section, Mapping) or section.get("kind") != CUSTOM:
        return None
    from topcli.tops.custom import custom_class

    cls = custom_class(section)
    TOPS.declared[cls.form] = cls
    return cls


def example_class() -> type[Top]:
    """Class of the top of a starting config."""
    from topcli.tops.custom import EXAMPLE

    cls = declared_class(EXAMPLE)
    assert cls is not None
    return cls


def _check_names(section: CustomSection, problems: Problems) -> tuple[str, ...]:
    """Add the names that cannot be used, and components without a rate; return those that formulas may use."""
    from topcli.tops.custom import name_fault

    before = len(problems.messages)
    earlier: dict[str, str] = {}
    groups = (("component", "components"), ("parameter", "parameters"), ("invariant", "invariants"))
    for what, key in groups:
        for index, name in enumerate(getattr(section, key)):
            if fault := name_fault(name, what, earlier):
                problems.add(("top", key, index if what == "component" else name), fault)
            earlier.setdefault(name, what)
    if len(problems.messages) > before:
        return ()
    for name in section.components:
        if name not in section.field:
            problems.add(("top", "field"), f"gives no rate of change of {name!r}")
    for name in section.field:
        if name not in section.components:
            problems.add(("top", "field", name), f"is no component; {nearest(name, section.components)}")
    return (*section.components, *section.parameters)


def _formula(value: Any, path: KeyPath, names: Sequence[str], problems: Problems) -> Any:
    """A formula as text, and one that holds on a level as a section; mistakes are added."""
    from topcli.field.expression import parse

    if isinstance(value, dict):
        if path[1] != "invariants":
            problems.add(path, f"must be a formula such as 2*{names[0]}, not {describe(value)}")
            return None
        relation = validate(Relation, value, path, problems)
        if relation is None:
            return None
        return {"value": _formula(relation.value, (*path, "value"), names, problems), "on": relation.on}
    text = formula_text(value)
    if text is None:
        problems.add(path, f"must be a formula such as 2*{names[0]}, not {describe(value)}")
        return None
    with problems.at(*path):
        parse(text, names)
    return text


def formula_text(value: Any) -> str | None:
    """Text of a formula, which may be a single number; None for what is neither."""
    if isinstance(value, WrittenFloat):
        return value.text
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        return None
    return value.strip() if isinstance(value, str) else repr(value)


def _check_numbers(top: Top, problems: Problems) -> None:
    """Add a division by zero in the field, and an invariant that it does not conserve, with these parameters."""
    from topcli.field.integrals import broken_integral

    known = _checked.setdefault(top.form, set())
    if top in known or len(known) >= CHECKED_TOPS:
        return
    state = tuple(map(math.cos, range(1, len(top.components) + 1)))  # in general position
    try:
        top.field(state, top.constants())
    except ZeroDivisionError:
        zeros = ", ".join(f"{name} = 0" for name, value in top if value == 0.0)
        problems.add(("top", "field"), f"divides by zero{f' with {zeros}' if zeros else ''}")
        return
    except (ArithmeticError, ValueError):  # at this state, but not at every other
        pass
    if fault := broken_integral(top):
        name = next(name for name in top.integrals if fault.startswith(repr(name)))
        problems.add(("top", "invariants", name), fault)
        return
    known.add(top)


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
            scheme = composed(simple, compose)
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
        auto = "; auto completes it to a unit vector, -auto with a minus sign" if self.unit else ""
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
        if abs(square - 1.0) > UNIT_TOLERANCE:
            raise ValueError(
                f"must be a unit vector: {self.name}² = {square:.15g} is off by {square - 1.0:.3g} (allowed: "
                f"{UNIT_TOLERANCE:g}); write one component as auto, or set initial.normalize: true"
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
    scaled = f"true scales {', '.join(cls.unit_vectors) or 'the unit vectors'} to unit length"
    normalize = (bool, Field(default=False, description=scaled))  # first, because the vectors depend on it
    return create_model("Initial", __config__=STRICT, normalize=normalize, **vectors)


def read_initial(
    raw: object, cls: type[Top], problems: Problems, path: KeyPath = ("initial",)
) -> tuple[float, ...] | None:
    """Return the initial state in the order of the top's components, its unit vectors completed and checked."""
    initial = validate(initial_model(cls), raw, path, problems)
    return None if initial is None else tuple(chain.from_iterable(getattr(initial, name) for name in cls.vectors))


def read_quantities(
    output: Output, cls: type[Top], integrals: Sequence[Invariant], problems: Problems
) -> dict[str, str] | None:
    """The formulas of ``output.quantities`` as text, checked; None if there are none."""
    if not output.quantities:
        return None
    from topcli.analysis.quantities import usable_names
    from topcli.tops.custom import name_fault

    earlier = dict.fromkeys(cls.model_fields, "parameter") | dict.fromkeys(cls.components, "component")
    earlier |= dict.fromkeys((integral.name for integral in integrals), "invariant")
    earlier |= dict.fromkeys(chain.from_iterable(ATTITUDES.values()), "column of the attitude")
    formulas: dict[str, str] = {}
    for name, value in output.quantities.items():
        path = ("output", "quantities", name)
        if fault := name_fault(name, "quantity", earlier):
            problems.add(path, fault)
        elif isinstance(text := _formula(value, path, usable_names(cls), problems), str):
            formulas[name] = text
    return formulas


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
