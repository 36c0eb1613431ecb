"""Descriptions of schemes and tops for ``topcli show``, as plain data and as text."""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterable, Sequence
from textwrap import fill
from typing import Any

from topcli.contracts import Block, Scheme, Top, parts_of
from topcli.errors import UsageError
from topcli.field.polynomial import NotPolynomialError, field_of
from topcli.schemes.registry import names_for
from topcli.table import DASH
from topcli.tops import TOPS


def generated_source(schemes: Sequence[Scheme]) -> str:
    """Code that schemes are made of for the default parameters of their tops, each under a line with the name.

    Schemes that are written out are left out. Raises UsageError if all are.
    """
    texts = []
    for scheme in schemes:
        method = scheme.build(TOPS[scheme.top].new(), scheme.options())
        source = method.text if isinstance(method, Block) else getattr(method, "source", None)
        if source is not None:
            texts.append(f"# {scheme.name} ({scheme.top})\n{source()}")
    if not texts:
        name, top, file = schemes[0].name, schemes[0].top, inspect.getsourcefile(schemes[0].maker)
        raise UsageError(f"scheme {name!r} of the top {top!r} is not made from the field; see {file}")
    return "\n".join(texts)


def scheme_data(scheme: Scheme) -> dict[str, Any]:
    """Declarations of a scheme as plain data."""
    plain = ("name", "top", "title", "order", "explicit", "self_adjoint", "adaptive", "equations", "citation", "doc")
    return {name: getattr(scheme, name) for name in plain} | {
        "conserves": list(scheme.conserves),
        "modified": scheme.modified is not None,
        "options": {
            key: {"default": field.default, "description": field.description}
            for key, field in scheme.options.model_fields.items()
        },
        "limits": dict(scheme.limits),
        "origin": scheme.origin,
    }


def schemes_text(schemes: Sequence[Scheme], width: int = 100) -> str:
    """Description of the schemes of one name for a terminal, in lines of at most ``width`` characters.

    Tops for which the scheme is the same share a description.
    """
    groups: dict[str, list[Scheme]] = {}
    for scheme in schemes:
        same = scheme.title, scheme.doc, scheme.order, scheme.equations, scheme.citation, scheme.options.model_fields
        groups.setdefault(str(same), []).append(scheme)
    return "\n\n".join(_scheme_text(group, width) for group in groups.values())


def _scheme_text(schemes: Sequence[Scheme], width: int) -> str:
    """Description of schemes that differ in what they conserve and in their limits at most."""
    first, tops = schemes[0], ", ".join(scheme.top for scheme in schemes)
    kind = "adaptive" if first.adaptive else "explicit" if first.explicit else "implicit"
    items = [
        f"order: {first.order or ('by tolerance' if first.adaptive else 'exact')}",
        f"kind: {kind}, {'self-adjoint' if first.self_adjoint else 'not self-adjoint'}",
        "conserves to round-off: " + "; ".join(_by_tops([(_conserved(scheme), scheme.top) for scheme in schemes])),
        f"equations: {first.equations}",
        f"source: {first.citation}",
    ]
    for key, field in first.options.model_fields.items():
        value = field.default if isinstance(field.default, str) else json.dumps(field.default)
        items.append(f"option {key} (default {value}): {field.description}")
    if len(schemes) == 1 and (constants := TOPS[first.top].step_constants):
        items.append(f"constants p of a step: {', '.join(constants)}")
    limits = [(f"limit {key}: {text}", scheme.top) for scheme in schemes for key, text in scheme.limits.items()]
    items += _by_tops(limits) or ["limits: none known"]
    return _described(f"{first.name} ({tops}): {first.title}", first.doc, items, width)


def _conserved(scheme: Scheme) -> str:
    """Symbols of the invariants that a scheme conserves."""
    symbols = [each.symbol for each in TOPS[scheme.top].new().invariants() if each.name in scheme.conserves]
    return ", ".join([*symbols, *(["modified integrals"] if scheme.modified else [])]) or "nothing"


def _by_tops(texts: Iterable[tuple[str, str]]) -> list[str]:
    """Different texts, each with the tops that have it."""
    tops: dict[str, list[str]] = {}
    for text, top in texts:
        tops.setdefault(text, []).append(top)
    return [f"{text} ({', '.join(names)})" for text, names in tops.items()]


def _described(title: str, doc: str, items: Sequence[str], width: int) -> str:
    """Title, paragraphs of the docstring, and items, in lines of at most ``width`` characters."""
    paragraphs = [fill(part, width, break_on_hyphens=False) + "\n" for part in doc.split("\n\n") if part.strip()]
    lines = [fill(line, width, subsequent_indent="  ", break_on_hyphens=False) for line in (title, *items)]
    return "\n".join([lines[0], "", *paragraphs, *lines[1:]])


def top_data(top: Top) -> dict[str, Any]:
    """Declarations of a top, and what follows from its field with its parameters, as plain data."""
    invariants, names = top.invariants(), top.components
    data: dict[str, Any] = {
        "kind": top.kind,
        "form": top.form,
        "title": top.title,
        "doc": parts_of(type(top).__doc__ or "")["Description"],
        "citation": top.citation,
        "parameters": {
            name: {"value": getattr(top, name), "description": field.description or ""}
            for name, field in type(top).model_fields.items()
        },
        "components": list(names),
        "step_p": list(top.step_constants),
        "integrals": [
            {"name": each.name, "symbol": each.symbol, "meaning": each.meaning, "on": dict(each.on)}
            for each in invariants
        ],
        "schemes": names_for(top.form),
    }
    try:
        field = field_of(top)
    except NotPolynomialError as error:
        return {**data, "field": None, "reason": f"the field is not a polynomial: it {error}"}
    rates = {name: rate.text(names) for name, rate in zip(names, field, strict=True)}
    return {**data, "field": rates, "degree": max(rate.degree for rate in field)}


def top_text(top: Top, width: int = 100) -> str:
    """Description of a top for a terminal, in lines of at most ``width`` characters."""
    data = top_data(top)
    name = data["form"] if top.kind in data["form"] else top.kind
    items: list[str] = []
    for key, parameter in data["parameters"].items():
        value = parameter["value"]
        text = DASH if value is None else f"{value:g}" if isinstance(value, float) else str(value)
        items.append(f"{key}: " + ", ".join(filter(None, (text, parameter["description"]))))
    items += [f"source: {top.citation}"] if top.citation else []
    items += [f"constants p of a step: {', '.join(top.step_constants)}"] if top.step_constants else []
    if data["field"] is None:
        items.append(f"equations: {data['reason']}")
    else:
        items += [f"{component}' = {rate}" for component, rate in data["field"].items()]
        items.append(f"degree of the equations: {data['degree']}")
    for each in data["integrals"]:
        level = " and ".join(f"{key} = {value:g}" for key, value in each["on"].items())
        items.append(f"integral {each['symbol']}: {each['meaning']}" + (f"; conserved where {level}" if level else ""))
    items.append(f"schemes: {', '.join(data['schemes'])}")
    return _described(f"{name}: {top.title}", data["doc"].partition("\n\n")[2], items, width)
