"""Chapters of a page on runs, ensembles and sweeps.

The chapter on a sweep shows its rows, and its measures over the key that varies most.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from functools import partial
from itertools import islice
from typing import Any

import numpy as np

from topcli.config.models import OUTSIDE_IDENTITY
from topcli.config.sweep import Sweep
from topcli.contracts import Outcome
from topcli.errors import counted
from topcli.figures.run import draw_quantiles, quantiles_of, run_pictures, series_of
from topcli.figures.study import picture
from topcli.figures.sweep import Choice, curves_of, draw_sweep
from topcli.pages.contents import (
    Chapter,
    Notes,
    Parts,
    Pictures,
    add_origin,
    experiment_of,
    files_block,
    parts_of,
    text_block,
    value_text,
)
from topcli.runs.report import (
    VERDICT_MARKS,
    comparison_lines,
    ensemble_statements,
    precision_note,
    report_tables,
    warning_of,
)
from topcli.schemes.display import display_name
from topcli.store.result_folder import flattened
from topcli.store.results import StoredResult
from topcli.sweeps.measures import in_words
from topcli.sweeps.store import COMPLETED, SWEEP_FILE, stored_sweep_file
from topcli.sweeps.table import Frame, key_labels, read_rows
from topcli.table import DASH, Cells, number, significant

SMALL = (4.8, 2.8)
"""Size of a picture in inches."""


def outcome_in_words(outcome: str) -> str:
    """Outcome of a run as people read it."""
    return "left its energy surface" if outcome == Outcome.LEFT_MOTION.value else outcome.replace("_", " ")


def run_chapter(run: StoredResult) -> Chapter:
    """Chapter on a finished or interrupted run."""
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
        caption = "largest deviation of each invariant, over the fraction of trajectories that stay below it"
        quantiles = quantiles_of(run.folder, report)
        chapter.add(Pictures([(picture(lambda axes: draw_quantiles(axes, quantiles), size=SMALL), caption)]))
    else:
        chapter.add(_verdicts(report), _warnings(report))
        series = series_of(run.series, float(Fraction(h)))  # h of a config may be the text 1/3
        pictures = run_pictures(series, experiment) if series and experiment else []
        chapter.add(Pictures([(picture(one.draw, size=SMALL), one.caption) for one in pictures]))
    chapter.add(*(table.cells() for table in report_tables(report)))
    if not many:
        chapter.add(_reasons(report), folded=True)
    add_origin(chapter, manifest, parts_of(experiment))
    chapter.add(files_block(run.folder, manifest["files"]), folded=True)
    return chapter


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
    common = [[row for row in report["invariants"] if row["name"] in shared] for report in reports]
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


def sweep_chapter(stored: StoredResult) -> Chapter:
    """Chapter on a finished sweep."""
    folder, rows = stored.folder, read_rows(stored.folder)
    outcomes = Counter(rows["outcome"])
    listed = ", ".join(f"{count} {outcome_in_words(outcome)}" for outcome, count in outcomes.items())
    chapter = Chapter(
        folder.name, "sweep", "rows of a sweep", "finished", message=f"{counted(len(rows), 'row')}: {listed}"
    )
    chapter.add(sweep_pictures(rows), rows_table(rows))
    chapter.add(text_block("Sweep file", (folder / SWEEP_FILE).read_text(encoding="utf-8")), folded=True)
    add_origin(chapter, stored.manifest, _parts(stored_sweep_file(folder)))
    chapter.add(files_block(folder, stored.manifest["files"]), folded=True)
    return chapter


def _parts(sweep: Sweep) -> Parts:
    """Forms of the tops and names of the schemes of all rows, each pair once. Raises ConfigError."""
    return list(dict.fromkeys((group.experiment.top.form, group.experiment.scheme.name) for group in sweep.groups()))


def rows_table(rows: Frame) -> Cells:
    """The first rows of a sweep with their keys, outcome and measures."""
    names, measures = rows.attrs["keys"], rows.attrs["measures"]
    labels = {key: key_labels(rows[key]) for key in names}
    lines = []
    for row in rows.head(MOST_ROWS).to_dict("records"):
        keys = [labels[key].get(row[key], DASH) for key in names]
        values = [significant(row[name], 4) for name in measures]
        lines.append([str(row["row"]), *keys, outcome_in_words(row["outcome"]), *values])
    more = len(rows) - len(lines)
    caption = f"The first {MOST_ROWS} rows; {more} more are in {rows.attrs['path']}." if more > 0 else ""
    marks = {outcome_in_words(outcome): "bad" for outcome in rows["outcome"] if outcome != COMPLETED}
    return Cells("Rows", ["row", *names, "outcome", *measures], lines, caption, keys=1 + len(names), marks=marks)


def sweep_choices(rows: Frame) -> Iterator[Choice]:
    """Yield a choice for each measure: over the numeric key with most values, with a curve for each scheme or top.

    Without them the curves are those of the next key if it has few values. Values of rows that differ in other keys are
    combined by their median.
    """
    counts = {key: count for key in rows.attrs["keys"] if (count := rows[key].nunique(dropna=False)) > 1}
    varied = sorted(counts, key=lambda key: -counts[key])
    if not varied:
        return
    x = next((key for key in varied if rows[key].dtype.kind in "fi"), varied[0])
    named = [key for key in (*KINDS, *varied) if key in counts and key != x]
    by = next((key for key in named if key in KINDS or counts[key] <= MOST_CURVES), None)
    aggregate = "median" if rows.duplicated([key for key in (x, by) if key]).any() else None
    for measure in rows.attrs["measures"]:
        if np.isfinite(rows[measure]).any():
            yield Choice(x, measure, by, aggregate=aggregate)


def sweep_pictures(rows: Frame) -> Pictures:
    """Pictures of the first measures; none if no key varies. Raises UsageError."""
    pictures = []
    for choice in islice(sweep_choices(rows), MOST_PICTURES):
        combined = f", {choice.aggregate} over the rows" if choice.aggregate else ""
        each = f" for each {choice.by}" if choice.by else ""
        size = (5.6, max(3.2, 0.2 * curves_of(rows, choice) + 1.0))  # as high as the legend
        svg = picture(partial(draw_sweep, frame=rows, choice=choice), size=size)
        pictures.append((svg, f"{in_words(choice.y)} against {choice.x}{each}{combined}"))
    return Pictures(pictures)
