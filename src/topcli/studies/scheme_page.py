"""What the registry knows of a scheme, for a reader: as Markdown for ``docs/schemes.md``, as plain data, as text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from topcli.contracts import Scheme
from topcli.schemes.registry import all_schemes, find_scheme
from topcli.studies.stress import case_names
from topcli.tops import TOPS

HEAD = """# Schemes

<!-- Made from the registry by `topcli list schemes --markdown > docs/schemes.md`; a test holds it up to date. -->

Every scheme with what it declares; what it declares is tested because it is declared. *Limits* say where it fails: those
named `like-this` are hard cases of `topcli stress`, which holds them against what happens, both ways.
"""


def scheme_forms(name: str) -> list[Scheme]:
    """The schemes called ``name``, one for each form of a top that it steps; empty when there is none."""
    base = name.lower().partition("+")[0]
    return [find_scheme(name, scheme.top) for scheme in all_schemes() if scheme.name == base]


def scheme_data(scheme: Scheme) -> dict[str, Any]:
    """What a scheme declares, as plain data."""
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


def _traits(scheme: Scheme) -> list[tuple[str, str]]:
    symbols = {invariant.name: invariant.symbol for invariant in TOPS[scheme.top].new().invariants()}
    kept = ", ".join(symbols[name] for name in scheme.conserves)
    if scheme.modified:
        kept += (", and " if kept else "") + "modified integrals of its own"
    kind = "adaptive" if scheme.adaptive else "explicit" if scheme.explicit else "implicit"
    options = "; ".join(
        f"{key} = {field.default!r}: {field.description}" for key, field in scheme.options.model_fields.items()
    )
    found = [
        ("order", "exact" if scheme.order is None else str(scheme.order)),
        ("kind", f"{kind}, {'self-adjoint' if scheme.self_adjoint else 'not self-adjoint'}"),
        ("conserves to round-off", kept or "nothing"),
        ("equations", scheme.equations),
        ("source", scheme.citation),
    ]
    return [*found, ("options", options)] if options else found


def _limits(scheme: Scheme) -> list[tuple[str, str]]:
    """The limits, the hard cases first and quoted."""
    known = case_names()
    quoted = [(f"`{key}`", text) for key, text in scheme.limits.items() if key in known]
    return [*quoted, *((key, text) for key, text in scheme.limits.items() if key not in known)]


def _section(schemes: Sequence[Scheme]) -> list[str]:
    """The Markdown section on a scheme of one or several tops that declares the same of all but for what is listed."""
    lines: list[str] = []
    for scheme in schemes:
        lines += [f"## {scheme.name} ({scheme.top})", "", f"{scheme.title}.", "", scheme.doc, ""]
        lines += [f"- {label}: {text}" for label, text in _traits(scheme)]
        limits = _limits(scheme)
        lines += ["", "Limits:", "", *(f"- {key}: {text}" for key, text in limits), ""] if limits else [""]
    return lines


def schemes_page(schemes: Sequence[Scheme] | None = None) -> str:
    """``docs/schemes.md``: every scheme that comes with topcli, by top and name."""
    shown = [scheme for scheme in all_schemes() if scheme.origin == "topcli"] if schemes is None else list(schemes)
    return "\n".join([HEAD, *_section(shown)]).rstrip() + "\n"


def scheme_text(scheme: Scheme) -> str:
    """The same for a terminal."""
    from textwrap import fill, indent

    lines = [f"{scheme.name} ({scheme.top}): {scheme.title}", ""]
    lines += [fill(part, 100) + "\n" for part in scheme.doc.split("\n\n")]
    lines += [fill(f"{label}: {text}", 100, subsequent_indent="  ") for label, text in _traits(scheme)]
    limits = _limits(scheme)
    lines.append("limits:" if limits else "limits: none known")
    lines += [indent(fill(f"{key}: {text}", 96, subsequent_indent="  "), "  ") for key, text in limits]
    return "\n".join(lines)
