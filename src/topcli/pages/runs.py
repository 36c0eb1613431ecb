"""Chapters on runs: finished, interrupted, damaged or unfinished ones, of one trajectory or an ensemble."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from topcli.contracts import Outcome
from topcli.pages.contents import Block, Cells, Chapter, Facts, Notes
from topcli.pages.ensembles import ensemble_blocks
from topcli.pages.origin import (
    citation_block,
    config_block,
    experiment_of,
    files_block,
    parts_of,
    provenance_block,
    text_block,
    value_text,
)
from topcli.pages.series_pictures import series_pictures
from topcli.runs.report import invariant_table, precision_note, warning_of
from topcli.store.checkpoint import CHECKPOINT, read_checkpoint
from topcli.store.manifest import MANIFEST, REPORT, DamagedError, DamagedRun, StoredRun, read_json
from topcli.store.parts import Part

DAMAGED = "damaged"
UNFINISHED = "unfinished"


def run_chapter(run: StoredRun, name: str | None) -> Chapter:
    """Chapter on a finished or interrupted run; ``name`` is unique within the page, None leaves out pictures."""
    manifest = run.manifest
    chapter = Chapter(manifest["name"], "ensemble" if manifest.get("kind") == "ensemble" else "run")
    chapter.state, chapter.message = run.outcome.value, value_text(manifest.get("message", ""))
    chapter.good = run.outcome is Outcome.COMPLETED
    damage = run.damage()
    if damage:
        chapter.state, chapter.good = DAMAGED, False
        chapter.missing += [f"{file}: {why}" for file, why in damage.items()]
    if run.interrupted:
        chapter.missing.append(
            f"rows after step {manifest.get('step', 0)} of {manifest['config']['N']}: the run was interrupted; "
            "topcli run with --resume continues it"
        )
    report = _report(chapter, run.folder)
    _fill(chapter, run.folder, manifest, report, run.series, name)
    chapter.attempt("files", lambda: files_block(run.folder, manifest["files"], damage))
    return chapter


def damaged_chapter(run: DamagedRun, name: str) -> Chapter:
    """Chapter on a folder whose manifest is missing or cannot be trusted, of what else can be read."""
    chapter = Chapter(run.folder.name, "run", state=DAMAGED, good=False)
    chapter.message = "what follows is not confirmed by a manifest"
    chapter.missing.append(run.reason)
    report = _report(chapter, run.folder)
    manifest: dict[str, Any] = {"config": {}}
    try:
        manifest = read_json(run.folder / MANIFEST)
    except (OSError, DamagedError):
        chapter.missing.append("provenance: it is part of the manifest")
    series = next(iter(sorted(run.folder.glob("series.*"))), run.folder / "series.parquet")
    config = manifest.get("config")
    _fill(chapter, run.folder, {**manifest, "config": config if isinstance(config, dict) else {}}, report, series, name)
    return chapter


def part_chapter(part: Part, title: str) -> Chapter:
    """Chapter on the part folder of a run that is in progress or was killed."""
    chapter = Chapter(title, "run", state=UNFINISHED, good=False)
    chapter.message = "another process is running it" if part.alive else "it was killed before its end"
    checkpoint = read_checkpoint(part.folder)
    chapter.missing.append("invariants, pictures and report: they are written at the end of a run")
    if checkpoint is None:
        there = (part.folder / CHECKPOINT).exists()
        chapter.missing.append(f"{CHECKPOINT}: {'cannot be read' if there else 'none was written'}; run again")
        return chapter
    about = checkpoint.about
    config = about["config"]
    chapter.missing.append(
        f"rows after step {checkpoint.done} of {value_text(config.get('N'))}, its last checkpoint"
        + ("" if part.alive else "; topcli run with --resume continues from there")
    )
    experiment = experiment_of(config)
    chapter.attempt("setup", lambda: _setup(config, {}))
    chapter.attempt("config", lambda: config_block(config))
    chapter.attempt("provenance", lambda: provenance_block(about))
    version = about["environment"].get("topcli")
    chapter.attempt("citation", lambda: citation_block(parts_of(experiment), version))
    return chapter


def _report(chapter: Chapter, folder: Path) -> dict[str, Any]:
    """Content of ``report.json``, or an empty one that the chapter says is missing."""
    try:
        return read_json(folder / REPORT)
    except OSError as error:
        reason = error.strerror
    except DamagedError as error:
        reason = str(error)
    chapter.missing.append(f"invariants: {REPORT}: {reason}")
    return {}


def _fill(
    chapter: Chapter, folder: Path, manifest: Mapping[str, Any], report: dict[str, Any], series: Path, name: str | None
) -> None:
    """Add all blocks that the files in ``folder`` allow, from the setup to the citation."""
    config = manifest["config"]
    experiment = experiment_of(config) if config else None
    chapter.data = {"config": config, "report": report, "seconds": manifest.get("seconds")}
    chapter.attempt("setup", lambda: _setup(config, report))
    if report:
        chapter.subtitle = f"{value_text(report.get('top_title'))}; {value_text(report.get('scheme_title'))}"
        if chapter.kind == "ensemble" or report.get("kind") == "ensemble":
            ensemble_blocks(chapter, folder, report, name)
        else:
            chapter.attempt("invariants", lambda: _invariants(report))
            chapter.attempt("verdicts", lambda: _verdicts(report))
    if chapter.kind != "ensemble" and name:
        h = config.get("h", report.get("h", 1.0))
        chapter.attempt("pictures", lambda: series_pictures(series, experiment, float(h), name))
    chapter.attempt("config", lambda: _config(config, folder))
    if len(manifest) > 1:
        chapter.attempt("provenance", lambda: provenance_block(manifest))
    version = (manifest.get("environment") or {}).get("topcli")
    chapter.attempt("citation", lambda: citation_block(parts_of(experiment), version))


def _config(config: Mapping[str, Any], folder: Path) -> Block:
    """The config of the manifest or, without one, the file beside it."""
    if config:
        return config_block(config)
    return text_block("Config", (folder / "config.yaml").read_text(encoding="utf-8"))


def _setup(config: Mapping[str, Any], report: Mapping[str, Any]) -> Facts | None:
    """Top, scheme, steps and initial state."""
    if not (config or report):
        return None
    top, scheme = config.get("top", report.get("top")), config.get("scheme", report.get("scheme"))
    h, N = (config.get(key, report.get(key)) for key in ("h", "N"))
    rows: list[tuple[str, Any]] = [
        ("top", report.get("top_title")),
        ("parameters", {key: value for key, value in top.items() if key != "kind"} if isinstance(top, dict) else top),
        ("scheme", f"{scheme['name']}: {report.get('scheme_title', '')}" if isinstance(scheme, dict) else scheme),
        (
            "options",
            {key: one for key, one in scheme.items() if key != "name"} if isinstance(scheme, dict) else None,
        ),
        *((f"initial {key}", value) for key, value in (config.get("initial") or {}).items()),
        ("step size h", h),
        ("steps N", N),
        ("time N h", f"{h * N:.10g}" if isinstance(h, float | int) and isinstance(N, int) else None),
        ("precision", report.get("precision")),
        ("trajectories", report.get("trajectories")),
    ]
    return Facts("Setup", [(key, value_text(value)) for key, value in rows if value not in (None, {}, "")])


def _invariants(report: dict[str, Any]) -> Cells:
    header, *lines = invariant_table(report)
    return Cells("Conservation laws", header, lines, marks={"lost": "bad", "drifting": "middling", "exact": "good"})


def _verdicts(report: dict[str, Any]) -> Notes:
    """Reasons of the verdicts, with warnings about the run."""
    said = [f"{row['symbol']} ({row['name']}) {row['verdict']}: {row['reason']}" for row in report["invariants"]]
    left = report.get("left_motion")
    if left:
        said.append(f"far off its energy surface from step {left['step']} (t = {left['t']:.6g})")
    counters = ", ".join(f"{count} {key.replace('_', ' ')}" for key, count in report["counters"].items())
    return Notes(
        "Verdicts",
        [
            *map(str, said),
            *([f"counters: {counters}"] if counters else []),
            *(line for line in (precision_note(report), warning_of(report)) if line),
        ],
    )
