"""Formulas in a config: the section ``top`` of a custom top, and ``output.quantities``."""

from __future__ import annotations

import math
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
from topcli.contracts import Invariant, Top, checked_rotation
from topcli.errors import nearest, quoted
from topcli.field.expression import parse
from topcli.field.integrals import broken_integral, conserves_exactly
from topcli.tops import CUSTOM, TOPS
from topcli.tops.custom import EXAMPLE, VECTORS, custom_class, name_fault


class CustomSection(BaseModel):
    """The section ``top`` of a top that the config declares, beside its kind."""

    model_config = STRICT

    components: list[str] = Field(min_length=1, description="names of the components of the state, in order")
    parameters: dict[str, float] = Field(default={}, description="names of the parameters, with their values")
    field: dict[str, Any] = Field(description="for each component of the state, a formula of its time derivative")
    invariants: dict[str, Any] = Field(
        default={},
        description="formulas of conserved quantities by name; {value: F, on: {NAME: X}} if F is conserved only "
        "where the invariant NAME is X",
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


class Relation(BaseModel):
    """Invariant that is conserved on a level of other invariants."""

    model_config = STRICT

    value: Any = Field(description="the formula")
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
    named = _check_names(section, problems)
    if len(problems.messages) > before:
        return None, None
    for key in VECTORS:
        if len(getattr(section, key) or range(3)) != 3:
            problems.add(("top", key), f"must be a list of three formulas, not of {len(getattr(section, key))}")
            return None, None
    parts: list[tuple[str, dict[Any, Any]]] = [("field", section.field), ("invariants", section.invariants)]
    parts += [(key, dict(enumerate(getattr(section, key) or ()))) for key in VECTORS]
    formulas = {
        (key, name): _formula(value, ("top", key, name), named, problems)
        for key, part in parts
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


def _check_names(section: CustomSection, problems: Problems) -> tuple[str, ...]:
    """Add the names that cannot be used, and components without a rate; return those that formulas may use."""
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
            problems.add(("top", "field", name), f"is not a component; {nearest(name, section.components)}")
    return (*section.components, *section.parameters)


def _formula(value: Any, path: KeyPath, names: Sequence[str], problems: Problems) -> Any:
    """A formula as text, and one that holds on a level as a section; mistakes are added."""
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


def check_numbers(top: Top, problems: Problems) -> None:
    """Add a division by zero in the field, and an invariant that it does not conserve, with these parameters."""
    checked = _checked.setdefault(top.form, set())
    if top in checked:
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
    many = len(checked) >= CHECKED_TOPS
    if not (many and _conserves_with_all_parameters(type(top))) and (fault := broken_integral(top)):
        name = next(name for name in top.integrals if fault.startswith(repr(name)))
        problems.add(("top", "invariants", name), fault)
        return
    if top.vertical:
        with problems.at("top", "vertical"):
            checked_rotation(top, "the vertical")
    if not many:
        checked.add(top)


@cache
def _conserves_with_all_parameters(cls: type[Top]) -> bool:
    """True if the field conserves all integrals exactly for random parameters of both signs, and so for all others."""
    random, names = np.random.default_rng(0), list(cls.model_fields)
    sets = random.normal(size=(RANDOM_TOPS, len(names))).tolist()
    return all(conserves_exactly(cls(**dict(zip(names, values, strict=True)))) for values in sets)


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
