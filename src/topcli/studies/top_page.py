"""Description of a top: parameters, equations, declared and other integrals, symmetry, and schemes."""

from __future__ import annotations

import inspect
from textwrap import fill
from typing import Any

from topcli.contracts import Top
from topcli.field.integrals import divergence, further_integrals, polynomial_value, reversal
from topcli.field.polynomial import Field, NotPolynomialError, Polynomial, field_of
from topcli.schemes.registry import names_for
from topcli.table import DASH


def top_data(top: Top) -> dict[str, Any]:
    """Declarations of a top, and what follows from its field with its parameters, as plain data."""
    invariants = top.invariants()
    data: dict[str, Any] = {
        "kind": top.kind,
        "form": top.form,
        "title": top.title,
        "doc": inspect.getdoc(type(top)) or "",
        "citation": top.citation,
        "parameters": {
            name: {"value": getattr(top, name), "description": field.description or ""}
            for name, field in type(top).model_fields.items()
        },
        "components": list(top.components),
        "step_p": list(top.step_constants),
        "integrals": [
            {"name": one.name, "symbol": one.symbol, "meaning": one.meaning, "on": dict(one.on)} for one in invariants
        ],
        "schemes": names_for(top.form),
    }
    try:
        field = field_of(top)
    except NotPolynomialError as error:
        return {**data, "field": None, "reason": f"the field is not a polynomial: it {error}"}
    return {**data, **_of_field(top, field)}


def _of_field(top: Top, field: Field) -> dict[str, Any]:
    """Entries that follow from a polynomial field."""
    declared: list[Polynomial] = []
    for invariant in top.invariants():
        try:
            declared += [] if invariant.on else [polynomial_value(invariant.value, len(field))]
        except NotPolynomialError:
            continue
    degree, further = further_integrals(field, declared)
    names, signs = top.components, reversal(field)
    return {
        "field": {name: rate.text(names) for name, rate in zip(names, field, strict=True)},
        "degree": max(rate.degree for rate in field),
        "divergence": divergence(field).text(names),
        "reversal": signs and [name for name, sign in zip(names, signs, strict=True) if sign < 0],
        "integrals_sought": degree,
        "further_integrals": [integral.text(names) for integral in further],
    }


def top_text(top: Top, width: int = 100) -> str:
    """Description of a top for a terminal, in lines of at most ``width`` characters."""
    data = top_data(top)
    name = data["form"] if top.kind in data["form"] else top.kind
    lines = [fill(f"{name}: {top.title}", width), ""]
    lines += [
        fill(part, width) + "\n" for part in " ".join(data["doc"].split("\n    ")).split("\n\n")[1:] if part.strip()
    ]

    def item(label: str, text: str) -> None:
        lines.append(fill(f"{label}: {text}", width, subsequent_indent="  ", break_on_hyphens=False))

    for key, parameter in data["parameters"].items():
        value = parameter["value"]
        shown = DASH if value is None else f"{value:g}" if isinstance(value, float) else str(value)
        item(key, shown + (f", {parameter['description']}" if parameter["description"] else ""))
    if top.citation:
        item("source", top.citation)
    if top.step_constants:
        item("constants p of a step", ", ".join(top.step_constants))
    if data["field"] is None:
        item("equations", data["reason"])
    else:
        lines.append("equations with these parameters:")
        lines += [f"  {component}' = {rate}" for component, rate in data["field"].items()]
        item("degree of the equations", str(data["degree"]))
        item("divergence", f"{data['divergence']}{' (the flow preserves volume)' if data['divergence'] == '0' else ''}")
        minus = data["reversal"]
        item("time reversal", f"change the signs of {', '.join(minus)}" if minus else "not by a change of signs")
    for one in data["integrals"]:
        level = " and ".join(f"{key} = {value:g}" for key, value in one["on"].items())
        item(f"integral {one['symbol']}", one["meaning"] + (f"; conserved where {level}" if level else ""))
    if data["field"] is not None:
        sought = f"up to degree {data['integrals_sought']}"
        for text in data["further_integrals"]:
            item(f"further polynomial integral {sought}, found by computation", text)
        if not data["further_integrals"]:
            item("further polynomial integrals", f"none {sought} with these parameters")
    item("schemes", ", ".join(data["schemes"]))
    return "\n".join(lines)
