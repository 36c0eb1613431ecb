"""Chapters of a page on stored results: runs, ensembles, sweeps, and reports of studies."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from topcli.config.text import to_yaml
from topcli.contracts import Outcome
from topcli.errors import ExitCode, UsageError, counted
from topcli.figures.figure import picture_of
from topcli.figures.run import run_figure
from topcli.figures.study import picture
from topcli.figures.sweep import Choice, draw_sweep, height_of
from topcli.pages.page import Chapter
from topcli.runs.report import ensemble_statements, precision_note, report_tables, warning_of
from topcli.store.results import MANIFEST, REPORT, StoredResult, intact_result
from topcli.studies.report import read_record
from topcli.sweeps.measures import in_words
from topcli.sweeps.store import COMPLETED, ROWS_FILE, SWEEP_FILE, intact_sweep, is_sweep, stored_sweep_file
from topcli.sweeps.table import Frame, key_labels, read_rows
from topcli.table import DASH, Cells, significant, stored_cells

ORIGIN = ("started", "ended", "written", "commit", "dirty", "digest", "code")
"""Entries of a manifest or a stored report that a page shows, besides the environment."""
FILES = (MANIFEST, REPORT, ROWS_FILE, SWEEP_FILE, "config.yaml")
"""Files that stand for their folder, and so do files of a time series."""
MOST_ROWS, MOST_PICTURES, MOST_CURVES = 200, 6, 12
"""Largest numbers of rows and pictures of a sweep on a page, and of curves of a picture."""
_KINDS = ("scheme", "top")
"""Keys over whose values no median is taken."""


def stored_chapter(place: Path) -> Chapter:
    """Chapter on the result in a folder or file.

    Raises UsageError if there is nothing that topcli stored or the result is not finished, and RunError if it is
    damaged.
    """
    folder = place.parent if place.name in FILES or place.suffix in (".parquet", ".csv") else place
    if not folder.is_dir():
        record = read_record(place)
        if missing := {"title", "answer", "code", "notes", "errors", "config", "picture"} - record.keys():
            raise UsageError(f"{place}: not of the form that this version of topcli writes ({min(missing)} is missing)")
        return record_chapter(record)
    return sweep_chapter(intact_sweep(folder)) if is_sweep(folder) else run_chapter(intact_result(folder))


def origin_facts(record: Mapping[str, Any]) -> dict[str, Any]:
    """Times, digests and versions of a manifest or a stored report."""
    return {key: record[key] for key in ORIGIN if record.get(key)} | (record.get("environment") or {})


def run_chapter(run: StoredResult) -> Chapter:
    """Chapter on a finished or interrupted run or ensemble: verdicts and tables, and columns of a run over time."""
    manifest, report, config = run.manifest, run.report(), run.manifest["config"]
    if report.get("kind") == "ensemble":
        notes = ensemble_statements(report)
    else:
        notes = [f"{row['symbol']}: {row['statement']}" for row in report["invariants"]]
        notes += filter(None, [precision_note(report), warning_of(report)])
    try:
        figure = run_figure(run)
        pictures = [(picture_of(figure.draw, figure.data(), figure.size, "svg"), "recorded columns over time")]
    except UsageError:  # an ensemble, no rows, or the top is that of a plugin that is not loaded
        pictures = []
    return Chapter(
        manifest["name"],
        f"{report['top_title']}; {report['scheme']}: {report['scheme_title']}; h = {report['h']}",
        report["message"],
        ExitCode.SUCCESS if run.outcome is Outcome.COMPLETED else ExitCode.FAILED,
        pictures,
        [table.cells() for table in report_tables(report)],
        notes,
        to_yaml(config),
        origin_facts(manifest),
        (config["top"]["kind"], config["scheme"]["name"]),
    )


def record_chapter(record: Mapping[str, Any]) -> Chapter:
    """Chapter on a stored report of a study; the schemes that took part are those of its tables."""
    schemes = [row["scheme"] for table in record["tables"] for row in table["rows"] if row.get("scheme")]
    top = record["config"].get("top", {}).get("kind")
    return Chapter(
        f"topcli {record['command']}",
        record["title"],
        record["answer"],
        record["code"],
        [(record["picture"].encode(), record["title"])] if record["picture"] else [],
        [stored_cells(table) for table in record["tables"]],
        [*record["errors"], *record["notes"]],
        to_yaml(record["config"]) if record["config"] else "",
        origin_facts(record),
        [*([top] if top else []), *(re.split("[ :]", scheme)[0] for scheme in schemes)],
    )


def sweep_chapter(stored: StoredResult) -> Chapter:
    """Chapter on a finished sweep: its measures over the key that varies most, and its rows."""
    rows, sweep = read_rows(stored.folder), stored_sweep_file(stored.folder)
    outcomes = Counter(rows["outcome"])
    parts = [(group.experiment.top.kind, group.experiment.scheme.name) for group in sweep.groups()]
    return Chapter(
        stored.folder.name,
        "sweep",
        f"{counted(len(rows), 'row')}: " + ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items()),
        ExitCode.SUCCESS if set(outcomes) <= {COMPLETED} else ExitCode.PARTLY_FAILED,
        list(sweep_pictures(rows)),
        [rows_table(rows)],
        config=sweep.to_yaml(),
        origin=origin_facts(stored.manifest),
        cited=[name for part in parts for name in part],
    )


def rows_table(rows: Frame) -> Cells:
    """The first rows of a sweep with their keys, outcome and measures."""
    names, measures = rows.attrs["keys"], rows.attrs["measures"]
    labels = {key: key_labels(rows[key]) for key in names}
    lines = []
    for row in rows.head(MOST_ROWS).to_dict("records"):
        keys = [labels[key].get(row[key], DASH) for key in names]
        values = [significant(row[name], 4) for name in measures]
        lines.append([str(row["row"]), *keys, row["outcome"], *values])
    more = len(rows) - len(lines)
    caption = f"The first {MOST_ROWS} rows; {more} more are in {rows.attrs['path']}." if more > 0 else ""
    marks = {outcome: "bad" for outcome in rows["outcome"] if outcome != COMPLETED}
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
    named = [key for key in (*_KINDS, *varied) if key in counts and key != x]
    by = next((key for key in named if key in _KINDS or counts[key] <= MOST_CURVES), None)
    aggregate = "median" if rows.duplicated([key for key in (x, by) if key]).any() else None
    for measure in rows.attrs["measures"]:
        if np.isfinite(rows[measure]).any():
            yield Choice(x, measure, by, aggregate=aggregate)


def sweep_pictures(rows: Frame) -> Iterator[tuple[bytes, str]]:
    """Pictures of the first measures, with captions; none if no key varies. Raises UsageError."""
    for choice in islice(sweep_choices(rows), MOST_PICTURES):
        combined = f", {choice.aggregate} over the rows" if choice.aggregate else ""
        each = f" for each {choice.by}" if choice.by else ""
        svg = picture(partial(draw_sweep, rows=rows, choice=choice), size=(5.6, height_of(rows, choice)))
        yield svg, f"{in_words(choice.y)} against {choice.x}{each}{combined}"
