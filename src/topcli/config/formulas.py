"""Formulas in a config: the section ``top`` of a custom top, and ``output.quantities``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache, lru_cache
from itertools import chain
from typing import Any

import numpy as np
from pydantic import BaseModel, Field

from topcli.analysis.quantities import usable_names
from topcli.config.document import STRICT, Document, describe
from topcli.config.models import Output, PoincareSection
from topcli.config.text import KeyPath
from topcli.contracts import Invariant, Top
from topcli.engine.columns import ATTITUDES
from topcli.errors import UsageError, nearest, quoted
from topcli.field.expression import parse
from topcli.field.integrals import broken_hk_integral, broken_integral, conserves_exactly
from topcli.tops import CUSTOM, TOPS, BodyTop
from topcli.tops.bodies import checked_rotation
from topcli.tops.declared import BODY_SYMBOLS, VECTORS, Declared, custom_class, name_fault


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


RANDOM_TOPS = 8
"""Random sets of parameters that stand for all others."""


def read_custom(raw: dict[str, Any], document: Document) -> tuple[type[Top] | None, Top | None]:
    """Return the class of a top that a config declares, and the top; None for each that cannot be read."""
    before = len(document.faults)
    given = raw.get("parameters")
    section = document.read(CustomSection, raw, "top", beside=("kind", *(given if isinstance(given, dict) else ())))
    if section is None:
        return None, None
    _check_names(section, document)
    if len(document.faults) > before:
        return None, None
    declared = _with_texts(section, document)
    if len(document.faults) > before:
        return None, None
    cls = custom_class(declared)
    TOPS.declared[cls.form] = cls
    top = document.read(cls, cls.parameters_in({**declared, **raw, "parameters": section.parameters}), "top")
    if top is not None:
        check_numbers(top, document)
    return cls, top if len(document.faults) == before else None


def _with_texts(section: CustomSection, document: Document) -> dict[str, Any]:
    """The section as plain data, each formula as a text that has been parsed; mistakes are added."""
    declared = section.model_dump(by_alias=True, exclude_none=True)
    parameters = (*section.parameters,)
    names = (*components_of(section), *parameters)
    usable = dict.fromkeys(("field", "invariants", *VECTORS), names) | {"hk": (*names, "h")}
    places = [((key,), declared, key, usable[key]) for key in usable if declared.get(key)]
    places += [(("body", key), declared["body"], key, parameters) for key in declared.get("body", ())]
    for path, owner, key, allowed in places:
        part = owner[key]
        if isinstance(part, list) and len(part) != 3:
            document.fault(("top", *path), f"must be a list of three formulas, not of {len(part)}")
            continue
        for name, value in part.items() if isinstance(part, dict) else enumerate(part):
            part[name] = _formula(value, ("top", *path, name), allowed, document, parameters)
    return declared


def declared_class(section: object) -> type[Top] | None:
    """Class of a top that a resolved section ``top`` declares; None for other tops."""
    if not isinstance(section, Mapping) or section.get("kind") != CUSTOM:
        return None
    cls = custom_class(section)
    TOPS.declared[cls.form] = cls
    return cls


def components_of(section: CustomSection) -> tuple[str, ...]:
    """Names of the components of the state."""
    return BodyTop.components if section.body else tuple(section.components)


def _check_names(section: CustomSection, document: Document) -> None:
    """Add what is missing or given twice, the names that cannot be used, and vectors of unknown components."""
    before = len(document.faults)
    for key in ("components", "field", "vectors", *VECTORS):
        given = bool(getattr(section, key))
        if section.body and given:
            document.fault(("top", key), "is given by body; leave it out")
        if not section.body and not given and key in ("components", "field"):
            document.fault(("top",), f"needs {key}, or body for a rigid body with a fixed point")
    components = components_of(section)
    earlier = dict.fromkeys((*components, *BODY_SYMBOLS), "quantity of the body") if section.body else {}
    groups = {"components": "component", "parameters": "parameter", "invariants": "invariant", "hk": "invariant"}
    for key, what in groups.items():
        for index, name in enumerate(getattr(section, key)):
            if fault := name_fault(name, what, earlier):
                document.fault(("top", key, index if what == "component" else name), fault)
            earlier.setdefault(name, what)
    if len(document.faults) > before:
        return
    for name in components:
        if section.field and name not in section.field:
            document.fault(("top", "field"), f"gives no rate of change of {name!r}")
    for name in section.field:
        if name not in components:
            document.fault(("top", "field", name), f"is not a component; {nearest(name, components)}")
    for vector, part in section.vectors.items():
        if fault := name_fault(vector, "vector", dict.fromkeys(components, "component")):
            document.fault(("top", "vectors", vector), fault)
        start = components.index(part[0]) if part and part[0] in components else 0
        if not part or tuple(part) != components[start : start + len(part)]:
            document.fault(("top", "vectors", vector), f"must be neighbours in components, {', '.join(components)}")
    if section.vectors and sorted(chain.from_iterable(section.vectors.values())) != sorted(components):
        document.fault(("top", "vectors"), "must contain each component once")


def _formula(
    value: Any, path: KeyPath, names: Sequence[str], document: Document, parameters: Sequence[str] = ()
) -> Any:
    """A formula as text, and one with a condition as a section; mistakes are added."""
    if isinstance(value, dict) and path[1] in ("invariants", "hk"):
        given = document.read(Relation if path[1] == "invariants" else Conditional, value, *path)
        if given is None:
            return None
        parts: dict[str, Any] = {"value": _formula(given.value, (*path, "value"), names, document)}
        if given.condition is not None:
            parts["if"] = _formula(given.condition, (*path, "if"), parameters, document)
        return parts | ({"on": given.on} if isinstance(given, Relation) and given.on else {})
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        return document.fault(path, f"must be a formula such as 2*{next(iter(names), 1)}, not {describe(value)}")
    text = value.strip() if isinstance(value, str) else repr(value)
    with document.at(*path):
        parse(text, names)
    return text


def check_numbers(top: Declared, document: Document) -> None:
    """Add an integral that the field, or the HK map, does not conserve with these parameters."""
    frozen: Any = top  # and so hashable
    key, name, text = _broken(frozen)
    if text:
        document.fault(("top", key, *([name] if name else ())), text)


@lru_cache(maxsize=1024)
def _broken(top: Declared) -> tuple[str, str, str]:
    """Key and name of an integral that is not conserved, or of a vector not fixed in space, and why; or empty texts."""
    if not _conserves_with_all_parameters(type(top)):
        for key, fault in (("invariants", broken_integral(top)), ("hk", broken_hk_integral(top))):
            if fault:
                names = top.integrals if key == "invariants" else top.hk
                return key, next(name for name in names if fault.startswith(repr(name))), fault
    try:
        if top.vertical:
            checked_rotation(top, "the vertical")
    except (ValueError, UsageError) as error:
        return "vertical", "", str(error)
    return "", "", ""


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
    output: Output, cls: type[Top], integrals: Sequence[Invariant], document: Document
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
            document.fault(path, fault)
        elif isinstance(text := _formula(value, path, usable_names(cls), document), str):
            formulas[name] = text
    return formulas


def read_section(section: PoincareSection, cls: type[Top], document: Document) -> PoincareSection | None:
    """The section of orbits of ``cls``, its formula as text, checked; None if it is wrong."""
    component, path = section.component, ("section",)
    if (component is None) == (section.quantity is None):
        given = "both are given" if component else "neither is given"
        document.fault(path, f"needs component or quantity, and {given}; for example component: {cls.components[-1]}")
    elif component is not None and component not in cls.components:
        document.fault(
            (*path, "component"), f"unknown component {quoted(component)}; {nearest(component, cls.components)}"
        )
    elif component is not None:
        return section
    elif isinstance(text := _formula(section.quantity, (*path, "quantity"), usable_names(cls), document), str):
        return section.model_copy(update={"quantity": text})
    return None
