"""Chapters on runs, ensembles and sweeps: finished, interrupted, damaged or unfinished ones, and several compared.

A sweep has its rows, and pictures of the measures over the key that varies most.
"""

from __future__ import annotations

import contextlib
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from topcli.config.document import Problems
from topcli.config.models import OUTSIDE_IDENTITY
from topcli.config.rows import RowReader
from topcli.config.sweep import MISSING, Sweep
from topcli.contracts import Outcome
from topcli.errors import TopcliError
from topcli.figures.sweep import Choice, curves
from topcli.pages.contents import (
    UNFINISHED,
    Chapter,
    Facts,
    Notes,
    Parts,
    Picture,
    Pictures,
    add_files,
    add_origin,
    experiment_of,
    parts_of,
    text_block,
    value_text,
)
from topcli.pages.pictures import quantile_pictures, series_pictures
from topcli.runs.decision import flattened
from topcli.runs.report import INVARIANTS, QUANTITIES, comparison_lines, ensemble_table, precision_note, warning_of
from topcli.store.checkpoint import CHECKPOINT, read_checkpoint
from topcli.store.files import DamagedError, read_json
from topcli.store.manifest import MANIFEST, REPORT, DamagedRun, StoredRun, stored_sweep
from topcli.store.parts import Part
from topcli.sweeps.rows import SweepRows, encoded, key_labels, read_rows
from topcli.sweeps.run import SWEEP_FILE, stored_sweep_file
from topcli.sweeps.table_text import significant
from topcli.table import DASH, Cells

VERDICT_MARKS = {"lost": "bad", "drifting": "middling", "exact": "good"}


def run_chapter(run: StoredRun, name: str | None) -> Chapter:
    """Chapter on a finished or interrupted run; ``name`` is unique within the page, None leaves out pictures."""
    manifest = run.manifest
    chapter = Chapter(manifest["name"], "ensemble" if manifest.get("kind") == "ensemble" else "run")
    chapter.state, chapter.good = run.outcome.value, run.outcome is Outcome.COMPLETED
    chapter.message = value_text(manifest.get("message", ""))
    damage = chapter.check(run)
    if run.interrupted:
        chapter.missing.append(
            f"rows after step {manifest.get('step', 0)} of {manifest['config']['N']}: the run was interrupted; "
            "topcli run with --resume continues it"
        )
    _add_content(chapter, run.folder, manifest, _report(chapter, run.folder), run.series, name)
    add_files(chapter, run.folder, manifest, damage)
    return chapter


def damaged_chapter(run: DamagedRun, name: str) -> Chapter:
    """Chapter on a folder whose manifest is missing or cannot be trusted, of what else can be read."""
    chapter = Chapter(run.folder.name, "run", message="what follows is not confirmed by a manifest")
    chapter.damaged([run.reason])
    report = _report(chapter, run.folder)
    manifest: dict[str, Any] = {}
    try:
        manifest = read_json(run.folder / MANIFEST)
    except (OSError, DamagedError):
        chapter.missing.append("provenance: it is part of the manifest")
    series = next(iter(sorted(run.folder.glob("series.*"))), run.folder / "series.parquet")
    manifest["config"] = config if isinstance(config := manifest.get("config"), dict) else {}
    _add_content(chapter, run.folder, manifest, report, series, name)
    return chapter


def part_chapter(part: Part, title: str) -> Chapter:
    """Chapter on the part folder of a run that is in progress or was killed."""
    chapter = Chapter(title, "run", state=UNFINISHED, good=False)
    chapter.message = "another process is running it" if part.alive else "it was killed before its end"
    chapter.missing.append("invariants, pictures and report: they are written at the end of a run")
    checkpoint = read_checkpoint(part.folder)
    if checkpoint is None:
        fault = "cannot be read" if (part.folder / CHECKPOINT).exists() else "none was written"
        chapter.missing.append(f"{CHECKPOINT}: {fault}; run again")
        return chapter
    config = checkpoint.about["config"]
    resume = "" if part.alive else "; topcli run with --resume continues from there"
    chapter.missing.append(
        f"rows after step {checkpoint.done} of {value_text(config.get('N'))}, its last checkpoint{resume}"
    )
    chapter.attempt("setup", _setup, config, {})
    add_origin(chapter, checkpoint.about, parts_of(experiment_of(config)))
    return chapter


def _report(chapter: Chapter, folder: Path) -> dict[str, Any]:
    """Content of ``report.json``, or an empty one that the chapter says is missing."""
    try:
        return read_json(folder / REPORT)
    except (OSError, DamagedError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        chapter.missing.append(f"invariants: {REPORT}: {reason}")
    return {}


def _add_content(
    chapter: Chapter, folder: Path, manifest: Mapping[str, Any], report: dict[str, Any], series: Path, name: str | None
) -> None:
    """Add all blocks that the files in ``folder`` allow, from the setup to the citation."""
    config = manifest["config"]
    experiment = experiment_of(config) if config else None
    chapter.data = {"config": config, "report": report, "seconds": manifest.get("seconds")}
    if config or report:
        chapter.attempt("setup", _setup, config, report)
    if report:
        chapter.subtitle = f"{value_text(report.get('top_title'))}; {value_text(report.get('scheme_title'))}"
    if "ensemble" in (chapter.kind, report.get("kind")) and report:
        chapter.attempt("invariants", _quantiles, report)
        chapter.attempt("outcomes", outcome_notes, report)
        if name:
            chapter.attempt("distribution", quantile_pictures, folder, report, name)
    elif report:
        chapter.attempt("invariants", _invariants, report)
        chapter.attempt("verdicts", _verdicts, report)
    if report.get("quantities"):
        chapter.attempt("quantities", QUANTITIES.cells, report)
    if chapter.kind != "ensemble" and name:
        h = config.get("h", report.get("h", 1.0))
        chapter.attempt("pictures", lambda: series_pictures(series, experiment, float(h), name))
    if not config:
        chapter.attempt("config", lambda: text_block("Config", (folder / "config.yaml").read_text(encoding="utf-8")))
    add_origin(chapter, manifest, parts_of(experiment))


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


def _invariants(report: dict[str, Any]) -> Cells:
    return replace(INVARIANTS.cells(report), marks=VERDICT_MARKS)


def _counters(report: Mapping[str, Any]) -> dict[str, int]:
    return {key.replace("_", " "): count for key, count in report["counters"].items()}


def _verdicts(report: dict[str, Any]) -> Notes:
    """Reasons of the verdicts, with warnings about the run."""
    lines = [f"{row['symbol']} ({row['name']}) {row['verdict']}: {row['reason']}" for row in report["invariants"]]
    if left := report.get("left_motion"):
        lines.append(f"far off its energy surface from step {left['step']} (t = {left['t']:.6g})")
    if counters := _counters(report):
        lines.append(f"counters: {', '.join(f'{count} {key}' for key, count in counters.items())}")
    return Notes("Verdicts", [*lines, *filter(None, (precision_note(report), warning_of(report)))])


def _quantiles(report: dict[str, Any]) -> Cells:
    header, *lines = ensemble_table(report)
    return Cells("Conservation laws", header, lines, "Quantiles over the trajectories.")


def outcome_notes(report: Mapping[str, Any]) -> Notes:
    """Numbers of trajectories by outcome, and those that failed."""
    total = report["trajectories"]
    lines = [f"{count} of {total} trajectories: {outcome}" for outcome, count in report["outcomes"].items()]
    lines += [f"trajectory {row['trajectory']}: {row['outcome']} at step {row['step']}" for row in report["failures"]]
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
            made.append(Chapter("Comparison of the runs", "comparison", title, f"{len(runs)} runs", good))
            made[-1].attempt("comparison", _runs_table, runs)
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
        "Keys of the config are listed if the runs differ in them; invariants are those that all runs have.",
        marks=VERDICT_MARKS,
    )


MOST_ROWS = 200
"""Rows of a sweep that a page lists."""
MOST_PICTURES = 6
MOST_CURVES = 12
"""Largest number of values of a key that is drawn as curves of their own."""


def sweep_chapter(folder: Path, name: str | None) -> Chapter:
    """Chapter on the sweep in ``folder``, finished or not.

    ``name`` is unique within the page; None leaves out pictures.
    """
    chapter = Chapter(folder.name, "sweep", "rows of a sweep", "finished")
    stored, manifest = stored_sweep(folder), {}
    damage: Mapping[str, str] = {}
    if stored is None:
        chapter.state, chapter.good = UNFINISHED, False
        chapter.missing.append("manifest: the sweep is not finished; topcli sweep continues it")
        chapter.missing.append("provenance: it is part of the manifest")
    else:
        manifest, damage = stored.manifest, chapter.check(stored)
    try:
        rows = read_rows(folder)
    except TopcliError as error:
        chapter.missing.append(f"rows: {str(error).splitlines()[0]}")
    else:
        _add_setup(chapter, rows, folder)
        if name:
            chapter.attempt("pictures", sweep_pictures, rows, name)
        chapter.attempt("rows", rows_table, rows)
    chapter.attempt("sweep file", lambda: text_block("Sweep file", (folder / SWEEP_FILE).read_text(encoding="utf-8")))
    add_origin(chapter, manifest, lambda: _parts(stored_sweep_file(folder)))
    if stored is not None:
        add_files(chapter, folder, manifest, damage)
    return chapter


def _add_setup(chapter: Chapter, rows: SweepRows, folder: Path) -> None:
    """Say how many of the planned rows there are, and add their outcomes."""
    chapter.message = f"{len(rows)} rows"
    with contextlib.suppress(TopcliError):  # of the sweep file, which the chapter shows by itself
        total = stored_sweep_file(folder).count
        chapter.message = f"{len(rows)} of {total} rows"
        if len(rows) < total:
            chapter.missing.append(f"{total - len(rows)} of {total} rows, which have not run yet")
    outcomes = Counter(map(str, rows.columns["outcome"]))
    facts = [
        ("varied keys", ", ".join(rows.keys)),
        ("measures", ", ".join(rows.measures)),
        *((f"rows {outcome}", str(count)) for outcome, count in outcomes.items()),
    ]
    if rows.left_out:
        facts.append(("rows left out", f"{rows.left_out}, of an earlier version of the sweep file"))
    chapter.blocks.append(Facts("Setup", facts))


def _parts(sweep: Sweep) -> Parts:
    """Forms of the tops and names of the schemes of all rows, each pair once. Raises ConfigError."""
    reader, problems = RowReader(sweep), Problems(sweep.document)
    chosen = [key in ("top", "top.kind") or key.partition(".")[0] == "scheme" for key in sweep.keys]
    parts: dict[tuple[str, str], None] = {}
    seen: set[tuple[object, ...]] = set()
    for number, values in enumerate(sweep.assignments()):
        # of other keys, such as vectors, it matters only whether they are there
        kind = tuple(id(value) if chooses else value is MISSING for chooses, value in zip(chosen, values, strict=True))
        if kind not in seen:
            seen.add(kind)
            if row := reader.read(number, values, problems):
                parts[row.form, json.loads(row.scheme)["name"]] = None
    problems.raise_any()
    return list(parts)


def rows_table(rows: SweepRows) -> Cells:
    """The first rows of a sweep with their keys, outcome and measures."""
    labels = {key: key_labels(rows.columns[key]) for key in rows.keys}
    lines = []
    for i in range(min(len(rows), MOST_ROWS)):
        keys = [labels[key].get(_plain(rows.columns[key][i]), DASH) for key in rows.keys]
        values = [significant(float(rows.columns[name][i]), 4) for name in rows.measures]
        lines.append([str(int(rows.columns["row"][i])), *keys, str(rows.columns["outcome"][i]), *values])
    more = len(rows) - len(lines)
    caption = f"The first {MOST_ROWS} rows; {more} more are in {rows.path}." if more > 0 else ""
    marks = dict.fromkeys(map(str, rows.columns["outcome"][~rows.completed]), "bad")
    header = ["row", *rows.keys, "outcome", *rows.measures]
    return Cells("Rows", header, lines, caption, keys=1 + len(rows.keys), marks=marks)


def _plain(value: Any) -> Any:
    """Value of a column as the labels of ``key_labels`` know it."""
    plain = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(plain, float) and np.isnan(plain) else plain


def sweep_choices(rows: SweepRows) -> Iterator[Choice]:
    """Yield a choice for each measure: over the numeric key with most values, with curves of the next key if few.

    Values of rows that differ in other keys are combined by their median.
    """
    codes = {key: encoded(rows.columns[key]) for key in rows.keys}
    counts = {key: len(values) for key, (_, values) in codes.items() if len(values) > 1}
    varied = sorted(counts, key=lambda key: -counts[key])
    if not varied:
        return
    x = next((key for key in varied if rows.columns[key].dtype.kind in "fi"), varied[0])
    by = next((key for key in varied if key != x and counts[key] <= MOST_CURVES), None)
    combinations = set(zip(*(codes[key][0].tolist() for key in (x, by) if key), strict=True))
    aggregate = "median" if len(combinations) < len(rows) else None
    for measure in rows.measures:
        if np.isfinite(rows.columns[measure].astype(float)).any():
            yield Choice(x, measure, by, aggregate=aggregate)


def sweep_pictures(rows: SweepRows, name: str) -> Pictures:
    """Pictures of the first measures; none if no key varies. Raises UsageError."""
    pictures = []
    for number, choice in zip(range(MOST_PICTURES), sweep_choices(rows), strict=False):
        combined = f", {choice.aggregate} over the rows" if choice.aggregate else ""
        caption = f"{choice.y} over {choice.x}{f' for each {choice.by}' if choice.by else ''}{combined}"
        pictures.append(Picture(*curves(rows, choice), f"{name}-measure{number}", caption))
    return Pictures(pictures)
