"""Formulas in a config: the section ``top`` of a custom top, and ``output.quantities``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from itertools import chain
from typing import Any

import numpy as np
from pydantic import BaseModel, Field

from topcli.analysis.columns import ATTITUDES
from topcli.analysis.quantities import usable_names
from topcli.config.document import STRICT, KeyPath, Problems, WrittenFloat, describe, validate
from topcli.config.models import Output, PoincareSection
from topcli.contracts import Invariant, Top
from topcli.errors import nearest, quoted
from topcli.field.expression import parse
from topcli.field.integrals import broken_hk_integral, broken_integral, conserves_exactly
from topcli.tops import CUSTOM, TOPS, BodyTop
from topcli.tops.bodies import checked_rotation
from topcli.tops.declared import BODY_SYMBOLS, EXAMPLE, VECTORS, Declared, custom_class, name_fault


class Body(BaseModel):
    """A rigid body with a fixed point, whose equations of motion are those of Euler and Poisson."""

    model_config = STRICT

    moments: list[Any] = Field(description="three formulas of the parameters: the moments of inertia")
    gravity: list[Any] = Field(
        description="three formulas of the parameters: the weight times the coordinates of the centre of gravity"
    )
    rotor: list[Any] | None = Field(
        default=None, description="three formulas of the parameters: the angular momentum of the rotors in the body"
    )


class CustomSection(BaseModel):
    """The section ``top`` of a top that the config declares, beside its kind."""

    model_config = STRICT

    components: list[str] = Field(default=[], description="names of the components of the state, in order")
    vectors: dict[str, list[str]] = Field(
        default={}, description="neighbouring components that initial and pictures take as a vector, by its name"
    )
    parameters: dict[str, float] = Field(default={}, description="names of the parameters, with their values")
    body: Body | None = Field(
        default=None,
        description="a rigid body, instead of components and field; its state is omega1 to omega3, the angular "
        "velocity, and gamma1 to gamma3, the vertical",
    )
    field: dict[str, Any] = Field(
        default={}, description="for each component of the state, a formula of its time derivative"
    )
    invariants: dict[str, Any] = Field(
        default={},
        description="formulas of conserved quantities by name; {value: F, on: {NAME: X}} if F is conserved only "
        "where the invariant NAME is X, {value: F, if: G} if F exists only where the formula G of the parameters is 0",
    )
    hk: dict[str, Any] = Field(
        default={},
        description="formulas, which may contain h, of quantities that the scheme hk conserves, by name; "
        "{value: F, if: G} as for invariants",
    )
    angular_velocity: list[Any] | None = Field(
        default=None,
        description="three formulas: the angular velocity in the frame of the body; the attitude can then be recorded",
    )
    vertical: list[Any] | None = Field(
        default=None,
        description="three formulas: the components, in the frame of the body, of a vector that is fixed in space and "
        "drawn upright",
    )


class Conditional(BaseModel):
    """Quantity that the scheme hk conserves for some parameters."""

    model_config = STRICT

    value: Any = Field(description="the formula")
    condition: Any = Field(
        default=None, alias="if", description="a formula of the parameters that is 0 where the value is conserved"
    )


class Relation(Conditional):
    """Invariant for some parameters, or on a level of other invariants."""

    on: dict[str, float] = Field(default={}, description="values of other invariants for which this one is conserved")


CHECKED_TOPS = 64
"""Sets of parameters of one top whose integrals are checked one by one; a sweep may have a million."""
RANDOM_TOPS = 8
"""Random sets of parameters that stand for all others."""
_checked: dict[str, set[Top]] = {}


def read_custom(raw: dict[str, Any], problems: Problems) -> tuple[type[Top] | None, Top | None]:
    """Return the class of a top that a config declares, and the top; None for each that cannot be read."""
    before = len(problems.messages)
    given = raw.get("parameters")
    section = validate(
        CustomSection, raw, ("top",), problems, beside=("kind", *(given if isinstance(given, dict) else ()))
    )
    if section is None:
        return None, None
    _check_names(section, problems)
    if len(problems.messages) > before:
        return None, None
    components, parameters = components_of(section), (*section.parameters,)
    places: list[tuple[tuple[str, ...], dict[Any, Any], Sequence[str]]] = [
        (("field",), section.field, (*components, *parameters)),
        (("invariants",), section.invariants, (*components, *parameters)),
        (("hk",), section.hk, (*components, *parameters, "h")),
    ]
    threes = [((key,), getattr(section, key), (*components, *parameters)) for key in VECTORS]
    threes += [(("body", key), value, parameters) for key, value in section.body or ()]
    for path, value, names in threes:
        if value is not None and len(value) != 3:
            problems.add(("top", *path), f"must be a list of three formulas, not of {len(value)}")
        elif value is not None:
            places.append((path, dict(enumerate(value)), names))
    declared = section.model_dump(by_alias=True, exclude_none=True)
    for path, part, names in places:
        place = declared[path[0]] if len(path) == 1 else declared[path[0]][path[1]]
        for name, value in part.items():
            place[name] = _formula(value, ("top", *path, name), names, problems, parameters)
    if len(problems.messages) > before:
        return None, None
    cls = custom_class(declared)
    TOPS.declared[cls.form] = cls
    top = validate(cls, cls.parameters_in({**declared, **raw, "parameters": section.parameters}), ("top",), problems)
    if top is not None:
        check_numbers(top, problems)
    return cls, top if len(problems.messages) == before else None


def declared_class(section: object) -> type[Top] | None:
    """Class of a top that a resolved section ``top`` declares; None for other tops."""
    if not isinstance(section, Mapping) or section.get("kind") != CUSTOM:
        return None
    cls = custom_class(section)
    TOPS.declared[cls.form] = cls
    return cls


def example_class() -> type[Top]:
    """Class of the top of a starting config."""
    cls = declared_class(EXAMPLE)
    assert cls is not None
    return cls


def components_of(section: CustomSection) -> tuple[str, ...]:
    """Names of the components of the state."""
    return BodyTop.components if section.body else tuple(section.components)


def _check_names(section: CustomSection, problems: Problems) -> None:
    """Add what is missing or given twice, the names that cannot be used, and vectors of unknown components."""
    before = len(problems.messages)
    for key in ("components", "field", "vectors", *VECTORS):
        if section.body and getattr(section, key):
            problems.add(("top", key), "is given by body; leave it out")
        elif not section.body and key in ("components", "field") and not getattr(section, key):
            problems.add(("top",), f"needs {key}, or body for a rigid body with a fixed point")
    components = components_of(section)
    earlier = dict.fromkeys((*components, *BODY_SYMBOLS), "quantity of the body") if section.body else {}
    groups = (
        ("component", "components"),
        ("parameter", "parameters"),
        ("invariant", "invariants"),
        ("invariant", "hk"),
    )
    for what, key in groups:
        for index, name in enumerate(getattr(section, key) or ()):
            if fault := name_fault(name, what, earlier):
                problems.add(("top", key, index if what == "component" else name), fault)
            earlier.setdefault(name, what)
    if len(problems.messages) > before:
        return
    for name in components:
        if section.field and name not in section.field:
            problems.add(("top", "field"), f"gives no rate of change of {name!r}")
    for name in section.field:
        if name not in components:
            problems.add(("top", "field", name), f"is not a component; {nearest(name, components)}")
    for vector, part in section.vectors.items():
        if fault := name_fault(vector, "vector", dict.fromkeys(components, "component")):
            problems.add(("top", "vectors", vector), fault)
        start = components.index(part[0]) if part and part[0] in components else 0
        if not part or tuple(part) != components[start : start + len(part)]:
            problems.add(("top", "vectors", vector), f"must be neighbours in components, {', '.join(components)}")
    if section.vectors and sorted(chain.from_iterable(section.vectors.values())) != sorted(components):
        problems.add(("top", "vectors"), "must contain each component once")


def _formula(
    value: Any, path: KeyPath, names: Sequence[str], problems: Problems, parameters: Sequence[str] = ()
) -> Any:
    """A formula as text, and one with a condition as a section; mistakes are added."""
    if isinstance(value, dict) and path[1] in ("invariants", "hk"):
        given = validate(Relation if path[1] == "invariants" else Conditional, value, path, problems)
        if given is None:
            return None
        parts: dict[str, Any] = {"value": _formula(given.value, (*path, "value"), names, problems)}
        if given.condition is not None:
            parts["if"] = _formula(given.condition, (*path, "if"), parameters, problems)
        return parts | ({"on": given.on} if isinstance(given, Relation) and given.on else {})
    text = formula_text(value)
    if text is None:
        problems.add(path, f"must be a formula such as 2*{next(iter(names), 1)}, not {describe(value)}")
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


def check_numbers(top: Declared, problems: Problems) -> None:
    """Add an integral that the field, or the HK map, does not conserve with these parameters."""
    checked = _checked.setdefault(top.form, set())
    if top in checked:
        return
    many = len(checked) >= CHECKED_TOPS
    known = many and _conserves_with_all_parameters(type(top))
    if not known and (fault := broken_integral(top)):
        name = next(name for name in top.integrals if fault.startswith(repr(name)))
        problems.add(("top", "invariants", name), fault)
        return
    if not known and (fault := broken_hk_integral(top)):
        problems.add(("top", "hk", next(name for name in top.hk if fault.startswith(repr(name)))), fault)
        return
    if top.vertical:
        with problems.at("top", "vertical"):
            checked_rotation(top, "the vertical")
    if not many:
        checked.add(top)


@cache
def _conserves_with_all_parameters(cls: type[Declared]) -> bool:
    """True if field and HK map conserve the integrals exactly for random parameters, and so for all others."""
    if cls.conditions:
        return False
    random, names = np.random.default_rng(0), list(cls.model_fields)
    sets = random.normal(size=(RANDOM_TOPS, len(names))).tolist()
    tops = [cls(**dict(zip(names, values, strict=True))) for values in sets]
    return all(conserves_exactly(top) and not broken_hk_integral(top) for top in tops)


def read_quantities(
    output: Output, cls: type[Top], integrals: Sequence[Invariant], problems: Problems
) -> dict[str, str] | None:
    """The formulas of ``output.quantities`` as text, checked; None if there are none."""
    if not output.quantities:
        return None
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


def read_section(section: PoincareSection, cls: type[Top], problems: Problems) -> PoincareSection | None:
    """The section of orbits of ``cls``, its formula as text, checked; None if it is wrong."""
    component, path = section.component, ("section",)
    if (component is None) == (section.quantity is None):
        given = "both are given" if component else "neither is given"
        problems.add(path, f"needs component or quantity, and {given}; for example component: {cls.components[-1]}")
    elif component is not None and component not in cls.components:
        problems.add(
            (*path, "component"), f"unknown component {quoted(component)}; {nearest(component, cls.components)}"
        )
    elif component is not None:
        return section
    elif isinstance(text := _formula(section.quantity, (*path, "quantity"), usable_names(cls), problems), str):
        return section.model_copy(update={"quantity": text})
    return None
