"""Descriptions of schemes from the registry: Markdown for ``docs/schemes.md``, plain data, text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from topcli.contracts import Scheme
from topcli.schemes.registry import all_schemes, find_scheme
from topcli.studies.stress import case_names
from topcli.tops import TOPS

HEAD = """# Schemes

<!-- Made from the registry by `topcli list schemes --markdown > docs/schemes.md`; a test holds it up to date. -->

Every scheme with what it declares; what it declares is tested because it is declared. *Limits* say where it fails:
those named `like-this` are hard cases of `topcli stress`, which holds them against what happens, both ways.
"""


def scheme_forms(name: str) -> list[Scheme]:
    """Schemes called ``name``, one for each form of a top; empty if there is none."""
    base = name.lower().partition("+")[0]
    return [find_scheme(name, scheme.top) for scheme in all_schemes() if scheme.name == base]


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


def _traits(scheme: Scheme) -> list[tuple[str, str]]:
    symbols = {invariant.name: invariant.symbol for invariant in TOPS[scheme.top].new().invariants()}
    kept = ", ".join(symbols[name] for name in scheme.conserves)
    if scheme.modified:
        kept += (", and " if kept else "") + "modified integrals of its own"
    kind = "adaptive" if scheme.adaptive else "explicit" if scheme.explicit else "implicit"
    fields = scheme.options.model_fields
    options = "; ".join(f"{key} = {field.default!r}: {field.description}" for key, field in fields.items())
    found = [
        ("order", "exact" if scheme.order is None else str(scheme.order)),
        ("kind", f"{kind}, {'self-adjoint' if scheme.self_adjoint else 'not self-adjoint'}"),
        ("conserves to round-off", kept or "nothing"),
        ("equations", scheme.equations),
        ("source", scheme.citation),
    ]
    return [*found, ("options", options)] if options else found


def _limits(scheme: Scheme) -> list[tuple[str, str]]:
    """Limits of a scheme, those named after hard cases first and quoted."""
    known = case_names()
    quoted = [(f"`{key}`", text) for key, text in scheme.limits.items() if key in known]
    return [*quoted, *((key, text) for key, text in scheme.limits.items() if key not in known)]


def _shared(schemes: Sequence[Scheme], traits: Sequence[Sequence[tuple[str, str]]]) -> list[str]:
    """Bullet for each (label, text) among the ``traits`` of the schemes, with the tops unless it holds for all."""
    tops_with: dict[tuple[str, str], list[str]] = {}
    for scheme, items in zip(schemes, traits, strict=True):
        for item in items:
            tops_with.setdefault(item, []).append(scheme.top)
    labels = list(dict.fromkeys(label for label, _ in tops_with))
    bullets = []
    for label, text in sorted(tops_with, key=lambda item: labels.index(item[0])):
        tops = tops_with[label, text]
        where = "" if len(tops) == len(schemes) else f" ({', '.join(tops)})"
        bullets.append(f"- {label}{where}: {text}")
    return bullets


def _section(schemes: Sequence[Scheme]) -> list[str]:
    """Markdown section on one scheme of one or several tops."""
    first = schemes[0]
    tops = ", ".join(scheme.top for scheme in schemes)
    limits = _shared(schemes, [_limits(scheme) for scheme in schemes])
    return [
        f"## {first.name} ({tops})",
        "",
        f"**{first.title[:1].upper()}{first.title[1:]}.** {first.doc.replace('``', '`')}",
        "",
        *_shared(schemes, [_traits(scheme) for scheme in schemes]),
        "",
        *(["Limits:", "", *limits, ""] if limits else []),
    ]


def schemes_page(schemes: Sequence[Scheme] | None = None) -> str:
    """Content of ``docs/schemes.md``: by default, every scheme that comes with topcli, by name."""
    shown = [scheme for scheme in all_schemes() if scheme.origin == "topcli"] if schemes is None else list(schemes)
    groups: dict[tuple[str, str], list[Scheme]] = {}
    for scheme in sorted(shown, key=lambda scheme: scheme.name):
        groups.setdefault((scheme.name, scheme.doc), []).append(scheme)
    lines = [line for group in groups.values() for line in _section(group)]
    return "\n".join([HEAD, *lines]).rstrip() + "\n"


def scheme_text(scheme: Scheme, width: int = 100) -> str:
    """Description of a scheme for a terminal, in lines of at most ``width`` characters."""
    from textwrap import fill, indent

    lines = [fill(f"{scheme.name} ({scheme.top}): {scheme.title}", width), ""]
    lines += [fill(part, width) + "\n" for part in scheme.doc.split("\n\n")]
    lines += [fill(f"{label}: {text}", width, subsequent_indent="  ") for label, text in _traits(scheme)]
    limits = _limits(scheme)
    lines.append("limits:" if limits else "limits: none known")
    lines += [indent(fill(f"{key}: {text}", width - 4, subsequent_indent="  "), "  ") for key, text in limits]
    return "\n".join(lines)
