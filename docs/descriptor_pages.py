"""Pages on one scheme or one top, from declarations in the registry."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from typing import Any

from pydantic import BaseModel
from scheme_pictures import STEP, command
from symbols import symbols_of

from topcli.contracts import Invariant, Scheme, Top
from topcli.errors import capitalized
from topcli.schemes.display import display_name
from topcli.schemes.registry import all_schemes
from topcli.studies.citations import Publication, works_in
from topcli.tops import CATALOGUE, TOPS, gentle_scene

NOTATION = {
    "'": "A prime marks a value after the step.",
    r"\\bar (?!\\?nabla)|\\bar\\(?!nabla)": "A bar marks the mean of the values before and after the step.",
    r"\\dot |f[(\\]": "A dot marks the derivative with respect to time.",
    r"\\(?:omega|gamma)_[123]|d_1": "The indices 1, 2, 3 number the components of vectors.",
    r"\\(?:omega|alpha)_j|e_j": "The indices $i, j, k$ are 1, 2, 3 in cyclic order, except in sums.",
}
"""Explanations of the notation, each with a pattern of the formulas that need it."""
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
    for part in re.split(r",\s*\\q?quad\s*", formula):
        if rows[-1] and width(rows[-1] + part) > WIDEST:
            rows.append("")
        rows[-1] += (r", \qquad " if rows[-1] else "") + part.strip()
    body = ",\\\\[4pt]\n".join(rows)
    return "\\begin{gathered}\n" + body + "\n\\end{gathered}" if len(rows) > 1 else formula


def notation(formulas: Iterable[str]) -> str:
    """Explanation of the notation of formulas."""
    text = " ".join(formulas)
    return " ".join(words for pattern, words in NOTATION.items() if re.search(pattern, text))


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


def grouped() -> dict[str, list[Scheme]]:
    """The schemes of topcli by name."""
    groups: dict[str, list[Scheme]] = {}
    for scheme in sorted(all_schemes(), key=lambda one: one.name):
        if scheme.origin == "topcli":
            groups.setdefault(scheme.name, []).append(scheme)
    return groups


def anchor(work: Publication) -> str:
    """Name of the place of a work on the page of all works."""
    return f"work-{work.key}"


def linked(work: Publication) -> str:
    """Reference of a work, in which its addresses are links."""
    text = work.text
    for name, address in work.addresses.items():
        text = text.replace(name, f"[{name}]({address})")
    return text


def citations(works: Sequence[Publication], command: str) -> Page:
    """References with their BibTeX, each linked to its place on the page of all works."""
    lines = ["## Cite", ""]
    lines += [f"- {linked(one)} ([bibliography](#{anchor(one)}))" for one in works]
    bibtex = "\n\n".join(one.bibtex for one in works)
    return [*lines, "", f"`{command}` prints:", "", "```bibtex", bibtex, "```", ""]


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


def indexed(*entries: str) -> Page:
    """Main entries of the index, which the search shows first."""
    names = dict.fromkeys(entry.replace(",", "").replace(";", "") for entry in entries)
    return ["```{index} " + ", ".join(f"! {name}" for name in names), "```", ""]


def search_names(title: str) -> Iterator[str]:
    """Names under which the search finds a scheme of this title: the title, its authors, a name in parentheses."""
    yield title
    if authors := re.match(r"(?:[A-Z][a-z]+ )?([A-Z]\w+-[A-Z]\w+)", title):
        yield from (authors[1], authors[1].replace("-", " "))
    for name in re.findall(r"\((.+?)\)", title):
        yield from (name, name.replace("'s", ""), name.partition("'s")[0])


def shown_on(schemes: Sequence[Scheme]) -> Scheme:
    """Form of a scheme that its page shows first: that of the Kowalevski top if there is one."""
    return next((one for one in schemes if one.top == "kowalevski"), schemes[0])


def symbol_table(formula: str, scheme: str = "", top: str = "") -> Page:
    """Table of all symbols of a formula."""
    return table(("symbol", "meaning"), [(f"${symbol}$", text) for symbol, text in symbols_of(formula, scheme, top)])


def scheme_page(schemes: Sequence[Scheme]) -> Page:
    """Page of the schemes of one name, one for each top."""
    from topcli.studies.stress.cases import case_names

    name, cases, first = schemes[0].name, case_names(), shown_on(schemes)
    shown = capitalized(display_name(name))
    titles = list(dict.fromkeys(one.title for one in (first, *schemes)))
    summary, *rest = first.doc.split("\n\n")
    alike = len({one.doc for one in schemes}) == 1
    words = "top" if len(schemes) == 1 else "tops"
    *most, last = [f"[`{one.top}`](../tops/{file_of(one.top)}.md)" for one in schemes]
    tops = f"{', '.join(most)} and {last}" if most else last
    lines = [
        f"# {shown}",
        "",
        *indexed(name, shown, *(known for title in titles for known in search_names(title))),
        f"*{capitalized(titles[0])}.*",
        "",
        prose(summary),
        "",
        *([prose("\n\n".join(rest)), ""] if alike and rest else []),
        f"In configs and commands this scheme is called `{name}`. The scheme applies to the {words} {tops}.",
        "",
        "## Try it",
        "",
        "```sh",
        command(first),
        f"topcli show {name}",
        "```",
        "",
        f"![Motion under {shown}, and deviations of the integrals]({name}.png)",
        "",
        f"The left panel shows a component of the state of the {TOPS[first.top].title} under the scheme {shown} with "
        f"h = {STEP}; the exact motion is grey. The right panel shows the deviation of each integral from its first "
        "value.",
        "",
        "## Step",
        "",
    ]
    for group, formula in distinct(schemes, {one.top: one.formula for one in schemes}):
        lines += [f"For {group}:", ""] if group else []
        lines += display(formula)
        lines += symbol_table(formula, name, group.partition(",")[0])
    lines += [notation(one.formula for one in schemes), ""]
    lines += [
        f"Source of these equations{f' for {group}' if group else ''}: "
        + f"{equations}.\n".replace("the paper", "[the paper](../../paper.md)", 1)
        for group, equations in distinct(schemes, {one.top: one.equations for one in schemes})
        if "=" not in equations and "Sogo" in first.citation
    ]
    pages = {EXPLAINED[name, one.top]: one.top for one in schemes if (name, one.top) in EXPLAINED}
    lines += [f"A separate page [explains this scheme for the top `{top}`]({page}).\n" for page, top in pages.items()]
    if not alike:
        lines += ["## On each top", ""]
        for group, doc in distinct(schemes, {one.top: one.doc for one in schemes}):
            lines += [f"**{group}.** {prose(doc)}", ""]
    lines += ["## Properties", "", *properties(schemes)]
    lines += options_table(schemes[0].options)
    limits = {
        one.top: "\n".join(f"- {f'`{key}`' if key in cases else key}: {text}" for key, text in one.limits.items())
        for one in schemes
    }
    lines += ["## Limits", ""]
    if any(limits.values()):
        lines += [
            "A limit named after a [hard case](../../stress.md) of `topcli stress`, such as `singular-step`, says what "
            "happens in this case. The page [Hard cases](../../stress.md#counters-of-critical-events) also "
            "explains counters such as `unmet` and outcomes such as `no_convergence`.",
            "",
        ]
    for group, text in distinct(schemes, limits):
        lines += [f"**{group}**", ""] if group else []
        lines += [text or "No limit is known.", ""]
    if found := scenes_of(scheme=name):
        lines += ["## Scenes", "", *table(("scene", "content"), [(f"`{scene}`", about) for scene, about in found])]
    works = {work.key: work for one in schemes for work in works_in(one.citation)}
    return [*lines, *citations(list(works.values()), f"topcli cite {name}")]


PROPERTIES: dict[str, Callable[[Scheme], str]] = {
    "order": order,
    "step": lambda one: "explicit" if one.explicit else "implicit",
    "self-adjoint": lambda one: "yes" if one.self_adjoint else "no",
    "conserved exactly": lambda one: kept(one) or "nothing",
    "conserved in modified form": lambda one: symbols(own(one)) or "–",
    "not conserved exactly": lambda one: kept(one, False) or "–",
    "Lax pair": lambda one: one.integrable.lax if one.integrable else "–",
    "Poisson bracket": lambda one: one.integrable.poisson if one.integrable else "–",
}
"""Properties that a page of a scheme shows."""


def properties(schemes: Sequence[Scheme]) -> Page:
    """Declared properties: first those that are the same for all tops, then a table with a row for each top."""
    cells = {name: [value(one) for one in schemes] for name, value in PROPERTIES.items()}
    if not any(one.integrable for one in schemes):
        del cells["Lax pair"], cells["Poisson bracket"]
    shared = {name: values[0] for name, values in cells.items() if len(set(values)) == 1}
    differing = [name for name in cells if name not in shared]
    lines = table(("property", "value" if len(schemes) == 1 else "on all tops"), list(shared.items()))
    if differing:
        rows = [(f"`{one.top}`", *(cells[name][at] for name in differing)) for at, one in enumerate(schemes)]
        lines += table(("top", *differing), rows)
    return [
        *lines,
        "An invariant that is conserved exactly deviates by round-off only. If an invariant is conserved in modified "
        "form, the scheme conserves exactly a function that depends on $h$ and is close to the invariant. The page of "
        "each top (linked above) defines the invariants of the top. The page [Speed](../../speed.md) gives "
        "measured times.",
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


def level(invariant: Invariant) -> str:
    """Condition under which an invariant is conserved, after a semicolon; empty if it always is."""
    if not invariant.on:
        return ""
    return "; conserved only by motions with " + " and ".join(
        f"`{name}` = {value:g}" for name, value in invariant.on.items()
    )


def top_page(top: type[Top]) -> Page:
    """Page of one form of a top."""
    from topcli.studies.stress.cases import CASES

    made = top.new()
    short = re.sub(r" \([^)]*\)", "", capitalized(top.title))
    lines = [f"# {short}", "", *indexed(top.form, short)]
    summary = (top.__doc__ or "").split("\n")[0]
    lines += [f"*{capitalized(top.title)}.*", ""] if capitalized(top.title) not in (short, summary.rstrip(".")) else []
    lines += [prose(top.__doc__ or "").replace("\n    ", "\n"), ""]
    if top.form in CATALOGUE:
        degrees = "[shows whether the map is integrable](../../catalogue.md#what-is-known-about-their-hk-maps)"
        scene = f"The gentle motion is that of the scene (packaged experiment) `{gentle_scene(top.form)}`."
        lines += [scene, ""]
        lines += [
            "A step of the [HK](../../glossary.md) scheme, the HK map, is a rational function of the state, and so is "
            f"its n-th iterate. The growth of the degree of the iterates {degrees}."
        ]
        lines += [""]
    lines += ["## Equations of motion", "", *display(top.formula), *symbol_table(top.formula, top=top.form)]
    *most, last = [f"`{name}`" for name in top.vectors]
    vectors = f"{', '.join(most)} and {last}" if most else last
    lines += [
        f"In a config for this top, the section `top` has `kind: {top.kind}`, and the section `initial` gives {vectors}"
        + (f" ({', '.join(f'`{name}`' for name in top.unit_vectors)} of unit length)" if top.unit_vectors else "")
        + f". The state has the components {', '.join(f'`{name}`' for name in top.components)}.",
        "",
    ]
    if rows := keys_of(top):
        lines += ["## Parameters", "", *table(("parameter", "type", "default", "meaning"), rows)]
    if top.step_constants:
        constants = ", ".join(f"`{one}`" for one in top.step_constants)
        these = "these constants" if len(top.step_constants) > 1 else "one constant"
        lines += [
            f"In the code of a scheme, the argument `p` of a step contains {these} of the equations of motion: "
            f"{constants}.",
            "",
        ]
    lines += [
        "## Integrals",
        "",
        *table(
            ("integral", "column", "meaning"),
            [(f"${one.tex}$", f"`{one.name}`", one.meaning + level(one)) for one in made.invariants()],
        ),
    ]
    schemes = [one for group in grouped().values() for one in group if one.top == top.form]
    lines += [
        "## Schemes",
        "",
        *table(
            ("scheme", "title", "order", "step", "self-adjoint", "conserved exactly"),
            [
                (
                    f"[`{one.name}`](../schemes/{one.name}.md)",
                    one.title,
                    order(one),
                    "explicit" if one.explicit else "implicit",
                    "yes" if one.self_adjoint else "no",
                    kept(one) or "–",
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
