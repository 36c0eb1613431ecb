"""Parts of the reference that are written when the documentation is built, from what the package declares.

Each page of the reference includes one part: commands, config, schemes, tops, measures, the Python interface and the
paper's claims. ``conf.py`` calls ``write_parts``; nothing that it writes is kept in the repository.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel

import topcli
from topcli.cli.app import GROUPS, all_commands
from topcli.cli.options import parameter_rows
from topcli.contracts import Invariant, Scheme, Top, parts_of
from topcli.schemes.registry import all_schemes
from topcli.table import DASH
from topcli.tops import TOPS

Page = list[str]

HUGE = 1e15
"""Limits beyond it are those of the machine, and are not shown."""
EVERY = ("--plugin", "--help", "--json", "--quiet")
"""Options of every command, described once."""
CODE = (
    r"((?<![\w-])--[a-z-]+|\btopcli list [a-z]+|\btopcli plot (?:section|sweep)\b|\btopcli [a-z]+|pip install '[^']+')"
)
"""Options and commands in a help text."""
KEYS = ("key", "type", "default", "meaning")
TYPES = (
    *("studies.report.Report", "table.Table", "cli.reports.RunReport", "cli.reports.SweepReport"),
    *("contracts.Stepper", "contracts.Scheme", "contracts.Invariant", "contracts.Sampler"),
    *("contracts.Block", "sweeps.batch.Batch"),
)
"""Types of arguments and results outside ``topcli`` itself, named from it on."""
MEMBERS = {
    "Top": "constants, invariants, euler_poisson, new\n   :exclude-members: model_config",
    "Trajectory": "",
    "Motion": "",
    "studies.report.Report": "table, plot, save, as_dict",
    "table.Table": "frame, text",
    "cli.reports.RunReport": "folder, outcome, status, series, table, as_dict",
    "cli.reports.SweepReport": "folder, outcomes, table, as_dict",
    "contracts.Scheme": "",
}
"""Members of classes that the page shows."""


def capitalized(text: str) -> str:
    """Text with a capital first letter and the rest as it is."""
    return text[:1].upper() + text[1:]


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> Page:
    """Lines of a Markdown table; none without rows."""
    lines = [f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |" for row in rows]
    return [f"| {' | '.join(header)} |", f"|{' --- |' * len(header)}", *lines, ""] if lines else []


def prose(text: str) -> str:
    """Docstring as Markdown."""
    return text.replace("``", "`")


def display(formula: str) -> Page:
    """Display formulas, one for each part between empty lines."""
    return [line for part in re.split(r"\n\s*\n", formula.strip()) for line in ("$$", part, "$$", "")]


def grouped() -> dict[str, list[Scheme]]:
    """The schemes of topcli by name."""
    groups: dict[str, list[Scheme]] = {}
    for scheme in sorted(all_schemes(), key=lambda scheme: scheme.name):
        if scheme.origin == "topcli":
            groups.setdefault(scheme.name, []).append(scheme)
    return groups


# commands


def plain(text: str) -> str:
    """Text of a help in Markdown: options and commands as code, and nothing else as markup."""
    parts = re.split(CODE, text)
    escaped = [re.sub(r"([\\`*_\[\]<>$])", r"\\\1", part) for part in parts]
    return "".join(f"`{part}`" if i % 2 else escaped[i] for i, part in enumerate(parts))


def parameters(context: Any) -> Iterator[tuple[str, str, str]]:
    """Arguments and options of a command, without those of every command: name, meaning, and default and limits."""
    for rows in parameter_rows(context.command, context).values():
        for name, text in rows:
            if not any(option in name for option in EVERY):
                parts = re.fullmatch(r"(.*?)(?:  \[(.*)\])?", text, re.DOTALL)
                meaning, extra = parts.groups("") if parts else (text, "")
                yield f"`{name}`", plain(meaning), plain(extra)


def commands_part() -> Page:
    """All commands in the groups of ``topcli --help``: help, usage and options."""
    lines: Page = []
    for title, group in GROUPS.items():
        lines += [f"## {title}", ""]
        for path, context in all_commands().items():
            if path.partition(" ")[0] not in group:
                continue
            lines += [f"{'####' if ' ' in path else '###'} topcli {path}", ""]
            for part in re.split(r"\n\s*\n", (context.command.help or "").strip()):
                lines += [plain(" ".join(part.split())), ""]
            usage = " ".join([context.command_path, *context.command.collect_usage_pieces(context)])
            lines += ["```text", usage, "```", ""]
            lines += table(("argument or option", "meaning", "default and limits"), parameters(context))
    return lines


# config


def spelled(value: Any) -> str:
    """Value as YAML spells it."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return f"{value:g}" if isinstance(value, float) else str(value)


def type_of(schema: Mapping[str, Any]) -> str:
    """Type of a key in words, from its JSON Schema."""
    if "anyOf" in schema:
        return " or ".join(dict.fromkeys(type_of(choice) for choice in schema["anyOf"]))
    if "enum" in schema or "const" in schema:
        return " or ".join(f"`{spelled(value)}`" for value in schema.get("enum", [schema.get("const")]))
    limits = [
        f"{sign} {schema[key]:g}"
        for key, sign in (("minimum", "≥"), ("exclusiveMinimum", ">"), ("maximum", "≤"))
        if key in schema and abs(schema[key]) < HUGE
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
    word = names.get(str(schema.get("type")), "section" if "$ref" in schema else "see below")
    return f"{word} {', '.join(limits)}".strip()


def keys_of(model: type[BaseModel]) -> list[tuple[str, str, str, str]]:
    """Key, type, default and description of each field of a model."""
    from topcli.config.document import description_of

    rows = []
    schemas = model.model_json_schema()["properties"]
    for (name, schema), field in zip(schemas.items(), model.model_fields.values(), strict=True):
        default = "required" if field.is_required() else f"`{spelled(schema.get('default'))}`"
        default = "see below" if isinstance(schema.get("default"), dict) else default
        rows.append((f"`{name}`", type_of(schema), default, prose(description_of(model, name))))
    return rows


def config_part() -> Page:
    """Keys of a config, from the models that read it."""
    from topcli.config.ensemble import EnsembleSection, Range
    from topcli.config.formulas import CustomSection
    from topcli.config.models import Config, Output, PoincareSection
    from topcli.config.states import Random

    sections = {
        "`output`": ("", Output),
        "`section`": (
            "A [Poincaré section](chaos.md#poincare-sections). Give either `component` or `quantity`.",
            PoincareSection,
        ),
        "`ensemble`": (
            "An [ensemble](sweeps.md#ensembles). Give one of `states`, `grid` and `random`.",
            EnsembleSection,
        ),
        "`ensemble.grid`": ("Evenly spaced values can be written as a range, which is a section.", Range),
        "`ensemble.random`": ("Besides these keys, a key for each vector says how the vector is drawn.", Random),
        "`top` with `kind: custom`": ("[A top of your own](own.md).", CustomSection),
    }
    lines = table(KEYS, keys_of(Config))
    for title, (about, model) in sections.items():
        lines += [f"## {title}", "", *([about, ""] if about else []), *table(KEYS, keys_of(model))]
    return lines


# schemes and tops


def distinct(schemes: Sequence[Scheme], text: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """The tops, joined, and the text that they share, for each different text."""
    tops: dict[str, list[str]] = {}
    for scheme in schemes:
        tops.setdefault(text[scheme.top], []).append(f"`{scheme.top}`")
    for shared, names in tops.items():
        yield ("" if len(tops) == 1 else ", ".join(names)), shared


def symbols(invariants: Iterable[Invariant]) -> str:
    """Symbols of invariants, typeset."""
    return ", ".join(f"${invariant.tex}$" for invariant in invariants)


def conserved(scheme: Scheme) -> str:
    """Invariants that a scheme conserves exactly, and its modified integrals."""
    top = TOPS[scheme.top].new()
    exact = symbols(invariant for invariant in top.invariants() if invariant.name in scheme.conserves) or "nothing"
    modified = symbols(scheme.modified(top, 0.01, scheme.options())) if scheme.modified else ""
    return f"{exact}; in modified form {modified}" if modified else exact


def kind_of(scheme: Scheme) -> tuple[str, str]:
    """Order of a scheme, and whether it is explicit and self-adjoint."""
    order = str(scheme.order or ("by tolerance" if scheme.adaptive else "exact"))
    kind = "adaptive" if scheme.adaptive else "explicit" if scheme.explicit else "implicit"
    return order, f"{kind}, {'self-adjoint' if scheme.self_adjoint else 'not self-adjoint'}"


def schemes_part() -> Page:
    """Table of the schemes, and a section on each: what it does, its formulas, conservation, options and limits."""
    groups = grouped()
    lines = table(
        ("scheme", "title", "order", "kind"),
        [(f"[`{name}`](#{name})", capitalized(some[0].title), *kind_of(some[0])) for name, some in groups.items()],
    )
    for name, some in groups.items():
        lines += [f"## {name}", "", f"*{capitalized(some[0].title)}.*", ""]
        for tops, doc in distinct(some, {scheme.top: scheme.doc for scheme in some}):
            lines += [f"{f'{tops}: ' if tops else ''}{prose(doc)}", ""]
        for tops, formula in distinct(some, {scheme.top: scheme.formula for scheme in some}):
            lines += [*([f"{tops}:", ""] if tops else []), *display(formula)]
        rows = [(f"`{scheme.top}`", *kind_of(scheme), conserved(scheme)) for scheme in some]
        lines += table(("top", "order", "kind", "conserves exactly"), rows)
        lines += table(("option", "type", "default", "meaning"), keys_of(some[0].options))
        limits = {scheme.top: "\n".join(f"- `{key}`: {text}" for key, text in scheme.limits.items()) for scheme in some}
        for tops, text in distinct(some, limits):
            if text:
                lines += [f"Limits{f' on {tops}' if tops else ''}:", "", text, ""]
        lines += [f"Source: {citation}.\n" for citation in dict.fromkeys(scheme.citation for scheme in some)]
    return lines


def top_section(top: type[Top]) -> Page:
    """Section on one form of a top: equations of motion, parameters and integrals."""
    lines = [f"## {top.form}", "", prose(parts_of(top.__doc__ or "")["Description"]), "", *display(top.formula)]
    vectors = ", ".join(f"`{name}`" for name in top.vectors)
    lines += [f"`kind: {top.kind}`, initial vectors {vectors}.", ""]
    lines += table(("parameter", "type", "default", "meaning"), keys_of(top))
    if top.step_constants:
        constants = ", ".join(f"`{constant}`" for constant in top.step_constants)
        lines += [f"Constants `p` of a step: {constants}.", ""]
    rows = []
    for invariant in top.new().invariants():
        level = " and ".join(f"`{name}` = {value:g}" for name, value in invariant.on.items())
        about = invariant.meaning + (f"; conserved only where {level}" if level else "")
        rows.append((f"${invariant.tex}$", f"`{invariant.name}`", about))
    lines += table(("integral", "column", "meaning"), rows)
    names = dict.fromkeys(scheme.name for scheme in all_schemes() if scheme.top == top.form)
    return [*lines, f"Schemes: {', '.join(f'[`{name}`](schemes.md#{name})' for name in sorted(names))}.", ""]


def tops_part() -> Page:
    """A section on each form of a top."""
    return [line for top in TOPS.values() for line in top_section(top)]


# measures, Python interface, claims


def measures_part() -> Page:
    """Table of the measures of sweeps."""
    from topcli.sweeps.measures import all_measures

    rows = [(f"`{measure.name}`", prose(measure.summary), measure.unit) for measure in all_measures()]
    return table(("measure", "content", "unit"), rows)


def api_part() -> Page:
    """Objects of the Python interface, from their docstrings: functions, then types."""
    public = sorted(set(topcli.__all__) - {"__version__"})
    functions = [name for name in public if name[0].islower()]
    lines: Page = []
    for title, directive, names in (
        ("Functions", "autofunction", functions),
        ("Types", "autoclass", [*(name for name in public if name not in functions), *TYPES]),
    ):
        lines += [f"### {title}", "", "```{eval-rst}"]
        for name in names:
            lines += [f".. {directive}:: topcli.{name}"]
            lines += [f"   :members: {MEMBERS[name]}".rstrip()] if name in MEMBERS else []
            lines += [""]
        lines += ["```", ""]
    return lines


def literal(text: str) -> str:
    """Text without the marks of Markdown."""
    return re.sub(r"([*_])", r"\\\1", text)


def claims_part() -> Page:
    """All claims of the paper by section, with their verdicts; this runs their experiments."""
    from topcli.paper.claims import all_claims, excluded

    wrong = "What does not hold"
    rows: dict[str, list[Sequence[str]]] = {wrong: []}
    claims, _, experiments = (table.cells() for table in topcli.claims().tables)
    for claim, line, details in zip(all_claims().values(), claims.lines, experiments.lines, strict=True):
        verdict, measured, bound, statement, source = line[1:]
        measures, _, note, corrected, experiment = map(literal, details[1:])
        about = f"**{claim.id}**: {literal(statement)} ({literal(source)})<br>{experiment}"
        if corrected != DASH:
            measured += f"; corrected: {corrected}"
        row = (about, verdict, measures, f"{measured} ({note})" if note else measured, bound)
        rows.setdefault(claim.section, []).append(row)
        if not verdict.startswith("holds"):
            rows[wrong].append(row)
    lines: Page = []
    for section, listed in rows.items():
        header = ("statement and experiment", "verdict", "quantity", "measured", "bound")
        lines += [f"## {section}", "", *table(header, listed)]
    lines += ["## Statements that are not tested", "", "No experiment tests these statements of the paper.", ""]
    left = [(f"**{id}**: {literal(statement)} ({source})", reason) for id, statement, source, reason in excluded()]
    return [*lines, *table(("statement", "reason"), left)]


PARTS = {
    "commands": commands_part,
    "config": config_part,
    "schemes": schemes_part,
    "tops": tops_part,
    "measures": measures_part,
    "api": api_part,
    "claims": claims_part,
}
"""Functions that write the parts, by the names of their files."""


def write_parts(folder: Path) -> None:
    """Write all parts into ``folder``; one whose text is unchanged keeps its file, so that it is not built again."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, part in PARTS.items():
        path, text = folder / f"{name}.md", "\n".join(part()).rstrip() + "\n"
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
