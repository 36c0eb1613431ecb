"""Pages on one scheme or one top, from what is declared in the registry and counted on the step."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from typing import Any

from pydantic import BaseModel

from topcli.contracts import Invariant, Scheme, Top
from topcli.schemes.registry import all_schemes
from topcli.studies.citations import Publication, works_in
from topcli.studies.scheme_page import operations_of
from topcli.tops import CATALOGUE, TOPS

NOTATION = r"""
A prime marks the new state, a bar the mean of the old and the new one; $f$ is the right-hand side of the equations of
motion, $J$ holds the moments of inertia $I_i$, $m = J\omega$, and $r$ is the weight times the centre of gravity.
"""
WIDEST = 48
"""Width of a row of formulas, in letters."""
HUGE = 1e15
"""Limits beyond it are those of the machine, and are not shown."""
EXPLAINED = {
    ("backlund", "kowalevski"): "../../backlund.md",
    ("exact", "kowalevski"): "../../kowalevski-exact.md",
    ("hk", "euler+gamma"): "../../hk-gamma.md",
}
"""Pages that derive a method."""
Page = list[str]


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> Page:
    """Lines of a Markdown table."""
    lines = [f"| {' | '.join(header)} |", f"|{' --- |' * len(header)}"]
    return [*lines, *(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |" for row in rows), ""]


def width(formula: str) -> int:
    """Rough width of a formula in letters."""
    plain = re.sub(r"\\(?:mathrm|text|tfrac|frac|begin|end|[bB]ig[lr]?|left|right|[,;!]|quad)", "", formula)
    return len(re.sub(r"[{}_^&\s]", "", re.sub(r"\\[A-Za-z]+", "x", plain)))


def rows_of(formula: str) -> str:
    """Formula broken at wide gaps into rows that fit a page; one that is short, or broken already, as it is."""
    if width(formula) <= WIDEST or r"\\" in formula:
        return formula
    rows = [""]
    for part in re.split(r",\s*\\qquad\s*", formula):
        if rows[-1] and width(rows[-1] + part) > WIDEST:
            rows.append("")
        rows[-1] += (r", \qquad " if rows[-1] else "") + part.strip()
    body = ",\\\\[4pt]\n".join(rows)
    return "\\begin{gathered}\n" + body + "\n\\end{gathered}" if len(rows) > 1 else formula


def display(formula: str) -> Page:
    """Display formulas, one for each part between empty lines."""
    lines: Page = []
    for part in re.split(r"\n\s*\n", formula.strip()):
        lines += ["$$", rows_of(part), "$$", ""]
    return lines


def prose(text: str) -> str:
    """Docstring as Markdown."""
    return text.replace("``", "`")


def file_of(form: str) -> str:
    """Name of the page of a top, without suffix."""
    return re.sub(r"[+/]", "-", form)


def own(scheme: Scheme) -> tuple[Invariant, ...]:
    """Modified integrals of a scheme, with a small h."""
    return scheme.modified(TOPS[scheme.top].new(), 0.01, scheme.options()) if scheme.modified else ()


def symbols(found: Iterable[Invariant]) -> str:
    """Symbols of invariants, typeset."""
    return ", ".join(f"${one.tex}$" for one in found)


def kept(scheme: Scheme, exact: bool = True) -> str:
    """Invariants of the top that a scheme conserves exactly, or those that it does not."""
    invariants = TOPS[scheme.top].new().invariants()
    return symbols(one for one in invariants if (one.name in scheme.conserves) is exact)


def order(scheme: Scheme) -> str:
    """Order as a word or a number; exact solutions and tolerances have none."""
    if scheme.order is not None:
        return str(scheme.order)
    return "by tolerance" if scheme.adaptive else "exact"


@cache
def cost(scheme: Scheme) -> str:
    """Operations per step; a dash for methods without steps in plain arithmetic."""
    found = operations_of(scheme)
    return "–" if found is None else found.text


def grouped() -> dict[str, list[Scheme]]:
    """The schemes of topcli by name."""
    groups: dict[str, list[Scheme]] = {}
    for scheme in sorted(all_schemes(), key=lambda one: one.name):
        if scheme.origin == "topcli":
            groups.setdefault(scheme.name, []).append(scheme)
    return groups


def citations(works: Sequence[Publication], command: str) -> Page:
    """References with their BibTeX."""
    lines = ["## Cite", "", *(f"- {one.text}" for one in works), ""]
    bibtex = "\n\n".join(one.bibtex for one in works)
    return [*lines, f"`{command}` prints:", "", "```bibtex", bibtex, "```", ""]


@cache
def packaged_scenes() -> list[tuple[str, str, str, str]]:
    """Name, scheme, top and description of each packaged scene."""
    from topcli.config.load import scenes

    return [(name, first.scheme.name, first.top.form, about) for name, first, _, about in scenes()]


def scenes_of(scheme: str = "", form: str = "") -> list[tuple[str, str]]:
    """Names and descriptions of the packaged scenes of a scheme or a top."""
    return [(name, about) for name, its, top, about in packaged_scenes() if (its == scheme if scheme else top == form)]


def distinct(schemes: Sequence[Scheme], text: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """The tops, joined, and the text that they share, for each different text."""
    tops: dict[str, list[str]] = {}
    for one in schemes:
        tops.setdefault(text[one.top], []).append(one.top)
    for shared, names in tops.items():
        yield ("" if len(tops) == 1 else ", ".join(names)), shared


def scheme_page(schemes: Sequence[Scheme]) -> Page:
    """Page of the schemes of one name, one for each top."""
    from topcli.studies.stress.cases import case_names

    name, cases = schemes[0].name, case_names()
    titles = list(dict.fromkeys(one.title for one in schemes))
    lines = [f"# `{name}`: {titles[0]}" if len(titles) == 1 else f"# `{name}`", ""]
    if len(titles) > 1:
        for tops, title in distinct(schemes, {one.top: one.title for one in schemes}):
            lines += [f"**{title[:1].upper()}{title[1:]}** ({tops}).", ""]
    for tops, doc in distinct(schemes, {one.top: one.doc for one in schemes}):
        lines += [f"**{tops}**", ""] if tops else []
        lines += [prose(doc), ""]
    lines += ["## Step", ""]
    for tops, formula in distinct(schemes, {one.top: one.formula for one in schemes}):
        lines += [f"For {tops}:", ""] if tops else []
        lines += display(formula)
    lines += [NOTATION]
    lines += [
        f"Equations: {equations}." + (f" ({tops})" if tops else "") + "\n"
        for tops, equations in distinct(schemes, {one.top: one.equations for one in schemes})
    ]
    pages = {EXPLAINED[name, one.top]: one.top for one in schemes if (name, one.top) in EXPLAINED}
    lines += [f"[Derivation]({page}) ({top}).\n" for page, top in pages.items()]
    lines += ["## Properties", "", *properties(schemes)]
    lines += options_table(schemes[0].options)
    limits = {
        one.top: "\n".join(f"- {f'`{key}`' if key in cases else key}: {text}" for key, text in one.limits.items())
        for one in schemes
    }
    if any(limits.values()):
        lines += [
            "## Where it breaks",
            "",
            "Names `like-this` are [hard cases](../../stress.md), checked in both directions.",
            "",
        ]
        for tops, text in distinct(schemes, limits):
            lines += [f"**{tops}**", ""] if tops else []
            lines += [text or "No limit is known.", ""]
    if found := scenes_of(scheme=name):
        lines += ["## Scenes", "", *table(("scene", "content"), [(f"`{scene}`", about) for scene, about in found])]
    works = {work.key: work for one in schemes for work in works_in(one.citation)}
    return [*lines, *citations(list(works.values()), f"topcli cite {name}")]


def properties(schemes: Sequence[Scheme]) -> Page:
    """Table of the declared properties, a column for each top."""
    rows: list[tuple[str, list[str]]] = [
        ("order", [order(one) for one in schemes]),
        ("step", ["explicit" if one.explicit else "implicit" for one in schemes]),
        ("self-adjoint", ["yes" if one.self_adjoint else "no" for one in schemes]),
        ("conserves exactly", [kept(one) or "nothing" for one in schemes]),
        ("in modified form", [symbols(own(one)) or "–" for one in schemes]),
        ("not exactly", [kept(one, False) or "–" for one in schemes]),
        ("operations per step", [cost(one) for one in schemes]),
    ]
    if any(one.integrable for one in schemes):
        rows.append(("Lax pair", [one.integrable.lax if one.integrable else "–" for one in schemes]))
        rows.append(("Poisson", [one.integrable.poisson if one.integrable else "–" for one in schemes]))
    header = ["", *(f"[{one.top}](../tops/{file_of(one.top)}.md)" for one in schemes)]
    found = table(header, [(label, *cells) for label, cells in rows])
    return [
        *found,
        "Invariants conserved exactly deviate by round-off only; those in modified form depend on $h$ and are "
        "conserved exactly in their place. Operations are counted with the default options at h = 0.01, iterations "
        "and counters included; [Speed](../../speed.md) has times.",
        "",
    ]


def keys_of(model: type[BaseModel]) -> list[tuple[str, str, str, str]]:
    """Key, type, default and description of each field of a model."""
    schema = model.model_json_schema()
    rows = []
    for (name, found), field in zip(schema["properties"].items(), model.model_fields.values(), strict=True):
        default = "required" if field.is_required() else f"`{spelled(found.get('default'))}`"
        default = "see below" if isinstance(found.get("default"), dict) else default
        rows.append((f"`{name}`", type_of(found), default, prose(field.description or "")))
    return rows


def spelled(value: Any) -> str:
    """Value as YAML spells it."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return f"{value:g}" if isinstance(value, float) else str(value)


def type_of(found: Mapping[str, Any]) -> str:
    """Type of a key in words, from its JSON Schema."""
    if "anyOf" in found:
        return " or ".join(dict.fromkeys(type_of(one) for one in found["anyOf"]))
    if "enum" in found or "const" in found:
        return " or ".join(f"`{spelled(one)}`" for one in found.get("enum", [found.get("const")]))
    limits = [
        f"{sign} {found[key]:g}"
        for key, sign in (("minimum", "≥"), ("exclusiveMinimum", ">"), ("maximum", "≤"))
        if key in found and abs(found[key]) < HUGE
    ]
    names = {
        "number": "number",
        "integer": "whole number",
        "boolean": "true or false",
        "string": "text",
        "array": "list",
        "null": "null",
        "object": "section",
    }
    word = names.get(str(found.get("type")), "section" if "$ref" in found else "see below")
    return f"{word} {', '.join(limits)}".strip()


def options_table(model: type[BaseModel]) -> Page:
    """Section on the options of a scheme; nothing if it has none."""
    rows = keys_of(model)
    header = ("option", "type", "default", "meaning")
    return ["## Options", "", *table(header, rows)] if rows else []


def top_page(top: type[Top]) -> Page:
    """Page of one form of a top."""
    from topcli.studies.stress.cases import CASES

    made = top.new()
    lines = [f"# {top.title[:1].upper()}{top.title[1:]}", "", prose(top.__doc__ or "").replace("\n    ", "\n"), ""]
    if top.form in CATALOGUE:
        picture = f"![Motions of its gentle and its hard scene](../../images/tops/{top.form}.png)"
        scenes = " and ".join(f"`{top.form.replace('-', '_')}_{case}`" for case in ("gentle", "hard"))
        lines += [picture, "", f"The exact motions of the scenes {scenes}.", ""]
    lines += ["## Equations of motion", "", *display(top.formula)]
    vectors = ", ".join(f"`{name}`" for name in top.vectors)
    lines += [
        f"In a config: `kind: {top.kind}`, with the initial vectors {vectors}"
        + (f" ({', '.join(f'`{name}`' for name in top.unit_vectors)} of unit length)" if top.unit_vectors else "")
        + f". Its state has the components {', '.join(f'`{name}`' for name in top.components)}.",
        "",
    ]
    if rows := keys_of(top):
        lines += ["## Parameters", "", *table(("parameter", "type", "default", "meaning"), rows)]
    if top.step_constants:
        constants = ", ".join(f"`{one}`" for one in top.step_constants)
        lines += [f"A step gets the constants of the equations of motion, p = ({constants}).", ""]
    lines += [
        "## Integrals",
        "",
        *table(
            ("integral", "column", "meaning"),
            [(f"${one.tex}$", f"`{one.name}`", one.meaning) for one in made.invariants()],
        ),
    ]
    schemes = [one for group in grouped().values() for one in group if one.top == top.form]
    lines += [
        "## Schemes",
        "",
        *table(
            ("scheme", "", "order", "step", "self-adjoint", "conserves exactly", "operations per step"),
            [
                (
                    f"[`{one.name}`](../schemes/{one.name}.md)",
                    one.title,
                    order(one),
                    "explicit" if one.explicit else "implicit",
                    "yes" if one.self_adjoint else "no",
                    kept(one) or "–",
                    cost(one),
                )
                for one in schemes
            ],
        ),
    ]
    lines += [
        "## Scenes",
        "",
        *table(("scene", "content"), [(f"`{name}`", about) for name, about in scenes_of(form=top.form)]),
    ]
    if cases := [case for case in CASES if case.form == top.form]:
        lines += ["## Hard cases", "", *table(("case", "question"), [(f"`{one.name}`", one.question) for one in cases])]
    return [*lines, *citations(works_in(top.citation), f"topcli cite {top.form}")]
