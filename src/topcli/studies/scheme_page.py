"""Descriptions of schemes for ``topcli show``."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from typing import Any

from topcli.contracts import Block, Scheme
from topcli.errors import UsageError
from topcli.schemes.own_tops import forms
from topcli.schemes.registry import all_schemes, find_scheme
from topcli.tops import TOPS


def scheme_forms(name: str, top: str | None = None) -> list[Scheme]:
    """Schemes called ``name``, one for each form of a top, or of ``top`` that it fits; empty if there is none.

    Raises UnknownNameError for an unknown top, SchemeMisfitError for a scheme that fits no form of it.
    """
    base = name.lower().partition("+")[0]
    fits = [scheme.top for scheme in all_schemes() if scheme.name == base]
    if top is None or not fits:
        return [find_scheme(name, form) for form in fits]
    asked = [form.form for form in forms(top)]
    return [find_scheme(name, form) for form in asked if form in fits] or [find_scheme(name, asked[0])]


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
        name, top, file = schemes[0].name, schemes[0].top, inspect.getsourcefile(inspect.unwrap(schemes[0].build))
        raise UsageError(f"scheme {name!r} of the top {top!r} is not made from the field; see {file}")
    return "\n".join(texts)


def scheme_data(scheme: Scheme) -> dict[str, Any]:
    """Declarations of a scheme as plain data."""
    return {
        "name": scheme.name,
        "top": scheme.top,
        "title": scheme.title,
        "order": scheme.order,
        "explicit": scheme.explicit,
        "self_adjoint": scheme.self_adjoint,
        "adaptive": scheme.adaptive,
        "conserves": list(scheme.conserves),
        "modified": scheme.modified is not None,
        "options": {
            key: {"default": field.default, "description": field.description}
            for key, field in scheme.options.model_fields.items()
        },
        "equations": scheme.equations,
        "citation": scheme.citation,
        "doc": scheme.doc,
        "limits": dict(scheme.limits),
        "origin": scheme.origin,
    }


CONSERVES = "conserves to round-off"
"""Trait that depends on the top."""


def _plain(value: Any) -> str:
    """Value of an option as a config has it."""
    if value is None:
        return "null"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _traits(scheme: Scheme) -> list[tuple[str, str]]:
    symbols = {invariant.name: invariant.symbol for invariant in TOPS[scheme.top].new().invariants()}
    kept = ", ".join(symbols[name] for name in scheme.conserves)
    if scheme.modified:
        kept += (", and " if kept else "") + "modified integrals"
    kind = "adaptive" if scheme.adaptive else "explicit" if scheme.explicit else "implicit"
    fields = scheme.options.model_fields
    options = "\n".join(
        f"{key} (default {_plain(field.default)}): {field.description}" for key, field in fields.items()
    )
    traits = [
        ("order", str(scheme.order or ("by tolerance" if scheme.adaptive else "exact"))),
        ("kind", f"{kind}, {'self-adjoint' if scheme.self_adjoint else 'not self-adjoint'}"),
        (CONSERVES, kept or "nothing"),
        ("equations", scheme.equations),
        ("source", scheme.citation),
    ]
    return [*traits, ("options", options)] if options else traits


def _limits(scheme: Scheme) -> list[tuple[str, str]]:
    """Limits of a scheme, those named after hard cases first and quoted."""
    from topcli.studies.stress.cases import case_names

    known = case_names()
    quoted = [(f"`{key}`", text) for key, text in scheme.limits.items() if key in known]
    return [*quoted, *((key, text) for key, text in scheme.limits.items() if key not in known)]


def schemes_text(schemes: Sequence[Scheme], width: int = 100) -> str:
    """Description of the schemes of one name for a terminal, in lines of at most ``width`` characters.

    What is the same for several tops is described once.
    """
    groups: dict[tuple[Any, ...], list[Scheme]] = {}
    for scheme in schemes:
        shared = [text for label, text in _traits(scheme) if label != CONSERVES]
        groups.setdefault((scheme.title, scheme.doc, *shared), []).append(scheme)
    return "\n\n".join(_group_text(group, width) for group in groups.values())


def _filled(text: str, width: int, subsequent_indent: str = "") -> str:
    from textwrap import fill

    return fill(text, width, subsequent_indent=subsequent_indent, break_on_hyphens=False)


def _group_text(schemes: Sequence[Scheme], width: int) -> str:
    """Description of schemes of several tops that differ in what they conserve and in their limits at most."""
    from textwrap import indent

    first, tops = schemes[0], [scheme.top for scheme in schemes]
    lines = [_filled(f"{first.name} ({', '.join(tops)}): {first.title}", width, subsequent_indent="  "), ""]
    lines += [_filled(part, width) + "\n" for part in first.doc.split("\n\n")]
    for label, text in _traits(first):
        if label == "options":
            lines += ["options:", *(_filled(f"  {one}", width, subsequent_indent="    ") for one in text.split("\n"))]
            continue
        if label != CONSERVES:
            lines.append(_filled(f"{label}: {text}", width, subsequent_indent="  "))
            continue
        kept = _by_text({scheme.top: dict(_traits(scheme))[label] for scheme in schemes})
        said = [text if len(kept) == 1 else f"{text} ({', '.join(names)})" for text, names in kept.items()]
        lines.append(_filled(f"{label}: {'; '.join(said)}", width, subsequent_indent="  "))
    if len(schemes) == 1 and (known := TOPS[first.top].step_constants):
        lines.append(_filled(f"constants p of a step: {', '.join(known)}", width, subsequent_indent="  "))
    limits: dict[tuple[str, str], list[str]] = {}
    for scheme in schemes:
        for limit in _limits(scheme):
            limits.setdefault(limit, []).append(scheme.top)
    lines.append("limits:" if limits else "limits: none known")
    for (key, text), names in limits.items():
        where = "" if names == tops else f" ({', '.join(names)})"
        lines.append(indent(_filled(f"{key}{where}: {text}", width - 4, subsequent_indent="  "), "  "))
    return "\n".join(lines)


def _by_text(texts: Mapping[str, str]) -> dict[str, list[str]]:
    """Names of the entries with each text."""
    named: dict[str, list[str]] = {}
    for name, text in texts.items():
        named.setdefault(text, []).append(name)
    return named
