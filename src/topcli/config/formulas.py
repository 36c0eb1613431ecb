"""Formulas in a config: the section ``top`` of a custom top, and ``output.quantities``."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from typing import Annotated, Any

from pydantic import BaseModel, Field

from topcli.analysis.quantities import usable_names
from topcli.config.document import STRICT, Document, describe
from topcli.config.models import Experiment
from topcli.contracts import Top
from topcli.engine.columns import ATTITUDES
from topcli.errors import nearest, quoted
from topcli.field.expression import parse
from topcli.field.integrals import broken_hk_integral, broken_integral
from topcli.tops import TOPS, BodyTop
from topcli.tops.bodies import checked_rotation
from topcli.tops.declared import BODY_SYMBOLS, VECTORS, custom_class, name_fault

Three = Annotated[list[Any], Field(min_length=3, max_length=3)]
"""Three formulas."""


class BodySection(BaseModel):
    """A rigid body with a fixed point, whose equations of motion are those of Euler and Poisson."""

    model_config = STRICT

    moments: Three
    """three formulas of the parameters: the moments of inertia"""
    gravity: Three
    """three formulas of the parameters: weight times the centre of gravity"""
    rotor: Three | None = None
    """three formulas: the angular momentum of rotors in the body"""


class CustomSection(BaseModel):
    """The section ``top`` of a top that the config declares, beside its kind."""

    model_config = STRICT

    components: list[str] = []
    """names of the components of the state, in order"""
    vectors: dict[str, list[str]] = {}
    """neighbouring components that initial and pictures take as a vector, by its name"""
    parameters: dict[str, float] = {}
    """names of the parameters, with their values"""
    body: BodySection | None = None
    """a rigid body, instead of components and field; its state is omega1 to omega3, the angular velocity, and gamma1 to
    gamma3, the vertical"""
    field: dict[str, Any] = {}
    """for each component, a formula of its time derivative"""
    invariants: dict[str, Any] = {}
    """formulas of conserved quantities by name; {value: F, on: {NAME: X}} if F is conserved only where the invariant
    NAME is X, {value: F, if: G} if F exists only where the formula G of the parameters is 0"""
    hk: dict[str, Any] = {}
    """formulas, also of h, that the scheme hk conserves, by name; {value: F, if: G} as above"""
    angular_velocity: Three | None = None
    """three formulas: the angular velocity in the body; the attitude can then be recorded"""
    vertical: Three | None = None
    """three formulas: a vector fixed in space, in the body, which is drawn upright"""


class Relation(BaseModel):
    """Invariant for some parameters, or on a level of other invariants."""

    model_config = STRICT

    value: Any
    """the formula"""
    condition: Any = Field(default=None, alias="if")
    """a formula of the parameters that must be 0"""
    on: dict[str, float] = {}
    """values of other invariants for which this one is conserved"""


def read_custom(raw: dict[str, Any], document: Document) -> type[Top]:
    """Return the class of a top that a config declares."""
    parameters = raw.get("parameters")
    names = parameters if isinstance(parameters, dict) else ()
    section = document.read(CustomSection, raw, "top", beside=("kind", *names))
    _check_names(section, document)
    cls = custom_class(_with_texts(section, document))
    TOPS.declared[cls.form] = cls
    return cls


def _check_names(section: CustomSection, document: Document) -> None:
    """Refuse what is missing or given twice, names that cannot be used, and vectors of unknown components."""
    components, earlier = section.components, {}
    if section.body:
        components = list(BodyTop.components)
        earlier = dict.fromkeys((*components, *BODY_SYMBOLS), "quantity of the body")
    for key in ("components", "field", "vectors", *VECTORS):
        present = bool(getattr(section, key))
        if section.body and present:
            document.fault(("top", key), "is given by body; leave it out")
        elif not section.body and not present and key in ("components", "field"):
            document.fault(("top", key), "missing; give it, or body for a rigid body with a fixed point")

    # each name once, and none that has another meaning
    groups = {"components": "component", "parameters": "parameter", "invariants": "invariant", "hk": "invariant"}
    for key, what in groups.items():
        for name in getattr(section, key):
            if fault := name_fault(name, what, earlier):
                document.fault(("top", key, *([name] if what != "component" else [])), fault)
            earlier.setdefault(name, what)
    for vector in section.vectors:
        if fault := name_fault(vector, "vector", dict.fromkeys(components, "component")):
            document.fault(("top", "vectors", vector), fault)

    # a rate of change for each component, which is in one vector
    for name in section.field:
        if name not in components:
            document.fault(("top", "field", name), f"is not a component; {nearest(name, components)}")
    if missing := [name for name in components if section.field and name not in section.field]:
        document.fault(("top", "field"), f"gives no rate of change of {', '.join(missing)}")
    if section.vectors and ([*chain(*section.vectors.values())] != components or not all(section.vectors.values())):
        document.fault(("top", "vectors"), f"must contain each component once, in the order {', '.join(components)}")


def _with_texts(section: CustomSection, document: Document) -> dict[str, Any]:
    """The section as plain data, each formula as a text that has been parsed."""
    declared = section.model_dump(by_alias=True, exclude_none=True)
    parameters = (*section.parameters,)
    names = (*(BodyTop.components if section.body else section.components), *parameters)

    def read(part: Any, *path: str, allowed: Sequence[str] = names) -> Any:
        if isinstance(part, dict):
            return {key: read_formula(value, allowed, document, *path, key) for key, value in part.items()}
        return [read_formula(value, allowed, document, *path, i) for i, value in enumerate(part)]

    declared |= {key: read(declared[key], "top", key) for key in ("field", *VECTORS) if key in declared}
    for key, part in declared.get("body", {}).items():
        declared["body"][key] = read(part, "top", "body", key, allowed=parameters)
    for key, allowed in (("invariants", names), ("hk", (*names, "h"))):
        for name, value in declared[key].items():
            path = ("top", key, name)
            if isinstance(value, dict):
                relation = document.read(Relation, value, *path)
                texts: dict[str, Any] = read({"value": relation.value}, *path, allowed=allowed)
                if relation.condition is not None:
                    texts |= read({"if": relation.condition}, *path, allowed=parameters)
                if relation.on and key == "hk":
                    document.fault((*path, "on"), "is for invariants only")
                declared[key][name] = texts | ({"on": relation.on} if relation.on else {})
            else:
                declared[key][name] = read_formula(value, allowed, document, *path)
    return declared


def read_formula(value: object, names: Sequence[str], document: Document, *path: str | int) -> str:
    """Return a formula of these names, at ``path``, as text."""
    text = value.strip() if isinstance(value, str) else repr(value)
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        document.fault(path, f"must be a formula such as 2*{next(iter(names), 1)}, not {describe(value)}")
    with document.at(*path):
        parse(text, names)
    return text


def check_numbers(top: Any, document: Document) -> None:
    """Refuse an integral that the field, or the HK map, does not conserve with these parameters."""
    for key, fault in (("invariants", broken_integral(top)), ("hk", broken_hk_integral(top))):
        if fault:  # which begins with the name of the integral
            document.fault(("top", key, fault.split("'")[1]), fault)
    if top.vertical:
        with document.at("top", "vertical"):
            checked_rotation(top, "the vertical")


def read_columns(experiment: Experiment, document: Document) -> dict[str, Any]:
    """Return ``output`` and ``crossings`` of an experiment with the texts of their formulas, and all names checked."""
    cls, output, crossings = type(experiment.top), experiment.output, experiment.crossings
    integrals = experiment.top.invariants() + experiment.modified
    earlier = dict.fromkeys(cls.model_fields, "parameter") | dict.fromkeys(cls.components, "component")
    earlier |= dict.fromkeys((integral.name for integral in integrals), "invariant")
    earlier |= dict.fromkeys(chain.from_iterable(ATTITUDES.values()), "column of the attitude")
    formulas: dict[str, str] = {}
    for name, value in (output.quantities or {}).items():
        if fault := name_fault(name, "quantity", earlier):
            document.fault(("output", "quantities", name), fault)
        formulas[name] = read_formula(value, usable_names(cls), document, "output", "quantities", name)
    names = [integral.name for integral in integrals]
    names += ["n", "t", *cls.components, *formulas, *output.attitude_columns]
    columns = output.columns or ()
    for name in columns:
        if name not in names:
            document.fault(("output", "columns"), f"unknown column {quoted(name)}; {nearest(name, names)}")
    if len(set(columns)) < len(columns):
        document.fault(("output", "columns"), "names a column twice")
    output = output.model_copy(update={"columns": columns or None, "quantities": formulas or None})

    # the surface of a Poincaré section
    if crossings and crossings.component is None:
        text = read_formula(crossings.quantity, usable_names(cls), document, "section", "quantity")
        crossings = crossings.model_copy(update={"quantity": text})
    elif crossings and crossings.component not in cls.components:
        near = nearest(crossings.component or "", cls.components)
        document.fault(("section", "component"), f"unknown component {quoted(crossings.component or '')}; {near}")
    return {"output": output, "crossings": crossings}
