"""Chapters of a page on runs, ensembles and sweeps.

The chapter on a sweep shows its rows, and its measures over the key that varies most.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from topcli.config.models import OUTSIDE_IDENTITY
from topcli.config.rows import RowReader
from topcli.config.sweep import Sweep
from topcli.contracts import Outcome
from topcli.errors import counted
from topcli.figures.sweep import Choice, curves
from topcli.pages.contents import (
    Chapter,
    Facts,
    Notes,
    Parts,
    Picture,
    Pictures,
    add_origin,
    experiment_of,
    file_block,
    files_block,
    parts_of,
    value_text,
)
from topcli.pages.pictures import quantile_pictures, series_pictures
from topcli.runs.report import (
    ENSEMBLE,
    INVARIANTS,
    QUANTITIES,
    VERDICT_MARKS,
    comparison_lines,
    ensemble_statements,
    precision_note,
    warning_of,
)
from topcli.schemes.display import display_name
from topcli.store.result_folder import flattened
from topcli.store.results import StoredResult
from topcli.sweeps.measures import in_words
from topcli.sweeps.rows import SweepRows, encoded, key_labels, read_rows
from topcli.sweeps.run import SWEEP_FILE, stored_sweep_file
from topcli.table import DASH, Cells, number, significant


def outcome_in_words(outcome: str) -> str:
    """Outcome of a run as people read it."""
    return "left its energy surface" if outcome == Outcome.LEFT_MOTION.value else outcome.replace("_", " ")


def run_chapter(run: StoredResult, name: str | None) -> Chapter:
    """Chapter on a finished or interrupted run; ``name`` is unique within the page, None leaves out pictures."""
    manifest, report, config = run.manifest, run.report(), run.manifest["config"]
    many = report.get("kind") == "ensemble"
    chapter = Chapter(manifest["name"], "ensemble" if many else "run")
    chapter.state, chapter.good = outcome_in_words(manifest["outcome"]), run.outcome is Outcome.COMPLETED
    chapter.message = value_text(manifest.get("message", ""))
    chapter.data = {"config": config, "report": report}
    experiment, h = experiment_of(config), report["h"]
    chapter.subtitle = f"{report['top_title']}; {display_name(report['scheme'])}: {report['scheme_title']}; h = {h}"
    if many:
        chapter.add(Notes("Verdicts", ensemble_statements(report)), outcome_notes(report))
        if name:
            chapter.add(quantile_pictures(run.folder, report, name))
    else:
        chapter.add(_verdicts(report), _warnings(report))
        if name:
            step = float(Fraction(h))  # h of a config may be the text 1/3
            chapter.add(series_pictures(run.series, experiment, step, name))
    chapter.add(_quantiles(report) if many else INVARIANTS.cells(report))
    if report.get("quantities"):
        chapter.add(QUANTITIES.cells(report))
    if not many:
        chapter.add(_reasons(report), folded=True)
    chapter.add(_setup(config, report), folded=True)
    add_origin(chapter, manifest, parts_of(experiment))
    chapter.add(files_block(run.folder, manifest["files"]), folded=True)
    return chapter


def _without(data: Any, key: str) -> Any:
    """Mapping without a ``key``; any other content of a file as it is."""
    return {name: value for name, value in data.items() if name != key} if isinstance(data, dict) else data


def _of_top(top: Any) -> dict[str, Any]:
    """Parameters of a top, and the formulas of one that the config declares."""
    if not (isinstance(top, dict) and isinstance(top.get("field"), dict)):
        return {"parameters": _without(top, "kind")}
    formulas = {f"{name}'": formula for name, formula in top["field"].items()}
    return {"parameters": top.get("parameters"), **formulas, "invariants": top.get("invariants")}


def _setup(config: Mapping[str, Any], report: Mapping[str, Any]) -> Facts:
    """Top, scheme, steps and initial state."""
    top, scheme, h, N = ({**report, **config}.get(key) for key in ("top", "scheme", "h", "N"))
    described = isinstance(scheme, dict)
    facts = {
        "top": report.get("top_title"),
        **_of_top(top),
        "scheme": f"{scheme['name']}: {report.get('scheme_title', '')}" if described else scheme,
        "options": _without(scheme, "name") if described else None,
        **{f"initial {key}": value for key, value in (config.get("initial") or {}).items()},
        "step size h": h,
        "steps N": N,
        "time N h": f"{h * N:.10g}" if isinstance(h, float | int) and isinstance(N, int) else None,
        "precision": report.get("precision"),
        "trajectories": report.get("trajectories"),
    }
    return Facts("Setup", [(key, value_text(value)) for key, value in facts.items() if value not in (None, {}, "")])


def _counters(report: Mapping[str, Any]) -> dict[str, int]:
    return {key.replace("_", " "): count for key, count in report["counters"].items()}


def _verdicts(report: dict[str, Any]) -> Cells:
    """Statements of the verdicts on the invariants, as they can be quoted."""
    rows = report["invariants"]
    lines = [[row["symbol"], row["statement"], number(row["max_deviation"], 2), row["name"]] for row in rows]
    marks = {row["statement"]: VERDICT_MARKS.get(row["verdict"], "") for row in rows}
    header = ["invariant", "verdict", "max deviation", "name"]
    return Cells("Verdicts", header, lines, numbers=False, marks=marks)


def _warnings(report: dict[str, Any]) -> Notes:
    """Warnings about the run, its precision, and events that the scheme counted."""
    lines = [precision_note(report), warning_of(report)]
    if left := report.get("left_motion"):
        lines.insert(0, f"the state is far off its energy surface from step {left['step']} (t = {left['t']:.6g})")
    return Notes("Notes", list(filter(None, lines)))


def _reasons(report: dict[str, Any]) -> Notes:
    """Reasons of the verdicts, and counts of the scheme."""
    lines = [f"{row['symbol']} {row['verdict']}: {row['reason']}" for row in report["invariants"]]
    return Notes("Reasons of the verdicts", [*lines, *(f"{name}: {n}" for name, n in _counters(report).items())])


def _quantiles(report: dict[str, Any]) -> Cells:
    return replace(ENSEMBLE.cells(report), caption="Quantiles over the trajectories.")


def outcome_notes(report: Mapping[str, Any]) -> Notes:
    """Numbers of trajectories by outcome, and those that failed."""
    total = report["trajectories"]
    lines = [
        f"{count} of {total} trajectories: {outcome_in_words(outcome)}" for outcome, count in report["outcomes"].items()
    ]
    for row in report["failures"]:
        lines.append(f"trajectory {row['trajectory']}: {outcome_in_words(row['outcome'])} at step {row['step']}")
    return Notes("Outcomes", [*lines, *(f"counter {key}: {count}" for key, count in _counters(report).items())])


def comparisons(chapters: Sequence[Chapter]) -> list[Chapter]:
    """Chapters that compare the runs of one top in ``chapters``, one for each top with several runs."""
    tops: dict[str, list[Chapter]] = {}
    for chapter in chapters:
        report = chapter.data.get("report") or {}
        if chapter.kind == "run" and report.get("invariants") and isinstance(report.get("top_title"), str):
            tops.setdefault(report["top_title"], []).append(chapter)
    made = []
    for title, runs in tops.items():
        if len(runs) > 1:
            good = all(run.good for run in runs)
            made.append(Chapter("Comparison of the runs", "comparison", title, counted(len(runs), "run"), good))
            made[-1].add(_runs_table(runs))
    return made


def _runs_table(runs: Sequence[Chapter]) -> Cells:
    """Table with a column for each run: what differs in their configs, outcomes, and the invariants that they share."""
    reports = [run.data["report"] for run in runs]
    configs = [flattened(run.data["config"]) for run in runs]
    lines = []
    for key in dict.fromkeys(key for config in configs for key in config):
        values = [value_text(config.get(key)) for config in configs]
        if key not in OUTSIDE_IDENTITY and len(set(values)) > 1:
            lines.append([key, *values])
    lines.append(["outcome", *(run.state for run in runs)])
    lines.append(["steps", *(value_text(report["step"]) for report in reports)])
    lines.append(["run seconds", *(f"{report['seconds']['run']:.3g}" for report in reports)])
    shared = set.intersection(*({row["name"] for row in report["invariants"]} for report in reports))
    common = [{"invariants": [row for row in report["invariants"] if row["name"] in shared]} for report in reports]
    return Cells(
        "Comparison",
        ["", *(run.title for run in runs)],
        [*lines, *comparison_lines(common)],
        "Keys of the config in which the runs differ, and invariants that all runs have.",
        marks=VERDICT_MARKS,
    )


MOST_ROWS = 200
"""Rows of a sweep that a page lists."""
MOST_PICTURES = 6
MOST_CURVES = 12
"""Largest number of values of a key that is drawn as curves of their own."""
KINDS = ("scheme", "top")
"""Keys over whose values no median is taken."""


def sweep_chapter(stored: StoredResult, name: str | None) -> Chapter:
    """Chapter on a finished sweep; ``name`` is unique within the page, None leaves out pictures."""
    folder, rows = stored.folder, read_rows(stored.folder)
    outcomes = Counter(map(str, rows.columns["outcome"]))
    listed = ", ".join(f"{count} {outcome_in_words(outcome)}" for outcome, count in outcomes.items())
    chapter = Chapter(
        folder.name, "sweep", "rows of a sweep", "finished", message=f"{counted(len(rows), 'row')}: {listed}"
    )
    facts = [("varied keys", ", ".join(rows.keys)), ("measures", ", ".join(rows.measures))]
    if rows.left_out:
        facts.append(("rows left out", f"{rows.left_out}, of an earlier version of the sweep file"))
    if name:
        chapter.add(sweep_pictures(rows, name))
    chapter.add(rows_table(rows))
    chapter.add(Facts("Setup", facts), file_block("Sweep file", folder / SWEEP_FILE), folded=True)
    add_origin(chapter, stored.manifest, _parts(stored_sweep_file(folder)))
    chapter.add(files_block(folder, stored.manifest["files"]), folded=True)
    return chapter


def _parts(sweep: Sweep) -> Parts:
    """Forms of the tops and names of the schemes of all rows, each pair once. Raises ConfigError."""
    reader, document = RowReader(sweep), replace(sweep.document, faults=[])
    chosen = [key in ("top", "top.kind") or key.partition(".")[0] == "scheme" for key in sweep.keys]
    parts: dict[tuple[str, str], None] = {}
    seen: set[tuple[object, ...]] = set()
    for row_number, values in enumerate(sweep.assignments()):
        kind = tuple(id(value) for chooses, value in zip(chosen, values, strict=True) if chooses)
        if kind not in seen:
            seen.add(kind)
            if row := reader.read(row_number, values, document):
                parts[row.form, json.loads(row.scheme)["name"]] = None
    document.check()
    return list(parts)


def rows_table(rows: SweepRows) -> Cells:
    """The first rows of a sweep with their keys, outcome and measures."""
    labels = {key: key_labels(rows.columns[key]) for key in rows.keys}
    lines = []
    for i in range(min(len(rows), MOST_ROWS)):
        keys = [labels[key].get(_plain(rows.columns[key][i]), DASH) for key in rows.keys]
        values = [significant(float(rows.columns[name][i]), 4) for name in rows.measures]
        lines.append(
            [str(int(rows.columns["row"][i])), *keys, outcome_in_words(str(rows.columns["outcome"][i])), *values]
        )
    more = len(rows) - len(lines)
    caption = f"The first {MOST_ROWS} rows; {more} more are in {rows.path}." if more > 0 else ""
    failed = rows.columns["outcome"][~rows.completed]
    marks = dict.fromkeys((outcome_in_words(str(outcome)) for outcome in failed), "bad")
    header = ["row", *rows.keys, "outcome", *rows.measures]
    return Cells("Rows", header, lines, caption, keys=1 + len(rows.keys), marks=marks)


def _plain(value: Any) -> Any:
    """Value of a column as the labels of ``key_labels`` know it."""
    plain = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(plain, float) and np.isnan(plain) else plain


def sweep_choices(rows: SweepRows) -> Iterator[Choice]:
    """Yield a choice for each measure: over the numeric key with most values, with a curve for each scheme or top.

    Without them the curves are those of the next key if it has few values. Values of rows that differ in other keys are
    combined by their median.
    """
    codes = {key: encoded(rows.columns[key]) for key in rows.keys}
    counts = {key: len(values) for key, (_, values) in codes.items() if len(values) > 1}
    varied = sorted(counts, key=lambda key: -counts[key])
    if not varied:
        return
    x = next((key for key in varied if rows.columns[key].dtype.kind in "fi"), varied[0])
    named = [key for key in (*KINDS, *varied) if key in counts and key != x]
    by = next((key for key in named if key in KINDS or counts[key] <= MOST_CURVES), None)
    combinations = set(zip(*(codes[key][0].tolist() for key in (x, by) if key), strict=True))
    aggregate = "median" if len(combinations) < len(rows) else None
    for measure in rows.measures:
        if np.isfinite(rows.columns[measure].astype(float)).any():
            yield Choice(x, measure, by, aggregate=aggregate)


def sweep_pictures(rows: SweepRows, name: str) -> Pictures:
    """Pictures of the first measures; none if no key varies. Raises UsageError."""
    pictures = []
    for i, choice in zip(range(MOST_PICTURES), sweep_choices(rows), strict=False):
        combined = f", {choice.aggregate} over the rows" if choice.aggregate else ""
        measured = in_words(choice.y)
        caption = f"{measured} against {choice.x}{f' for each {choice.by}' if choice.by else ''}{combined}"
        panel, data = curves(rows, choice)
        size = (5.6, max(3.2, 0.2 * len(panel.labels) + 1.0))  # as high as the legend
        pictures.append(Picture(panel, data, f"{name}-measure{i}", caption, size))
    return Pictures(pictures)
