"""Chapters of a page on studies, on benchmarks, and on the exact motion."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from topcli.analysis.motion import QUANTITIES, Motion
from topcli.analysis.motion.of_top import closed_form_top
from topcli.config.models import Experiment
from topcli.figures.motion import motion_drawn
from topcli.pages.contents import (
    Block,
    Chapter,
    Notes,
    Picture,
    Pictures,
    add_files,
    add_origin,
    citation_block,
    config_block,
    sources_of,
    works_block,
)
from topcli.store.manifest import StoredRun
from topcli.studies import imported
from topcli.studies.bench.result import DECADE_TABLE, POINT_TABLE
from topcli.studies.study import Result, Study, parts_of
from topcli.table import Table


def bench_chapter(run: StoredRun) -> Chapter:
    """Chapter on a benchmark of speed against error."""
    manifest = run.manifest
    chapter = Chapter(manifest["name"], "bench", "speed against error", "measured")
    damage = chapter.check(run)
    chapter.attempt("words", lambda: Notes("In words", [row["words"] for row in run.report()["decades"]]))
    chapter.attempt("best by decade", lambda: DECADE_TABLE.cells(run.report()))
    chapter.attempt("all points", lambda: POINT_TABLE.cells(run.report()))
    add_origin(chapter, manifest, lambda: _measured_parts(run.report()))
    add_files(chapter, run.folder, manifest, damage)
    return chapter


def _measured_parts(report: Mapping[str, Any]) -> Sequence[tuple[str, str]]:
    """Top and schemes of a benchmark; the settings of a competitor follow its name."""
    rows = [*report["competitors"], *report["closed_forms"]]
    names = [re.split("[ :]", row["name"])[0] for row in rows if row.get("kind", "topcli") == "topcli"]
    return parts_of(report["config"], names)


def study_chapter(study: Study, result: Result, name: str | None) -> Chapter:
    """Chapter on a ``result`` of a study, which may hold anything if it was read from a file.

    ``name`` is unique within the page; None leaves out pictures.
    """
    data = result.data
    chapter = Chapter(study.name.capitalize(), study.name)

    def head() -> Block | None:
        chapter.title, chapter.subtitle, chapter.state, chapter.good, message = study.head(data)
        chapter.message = message or study.answer(data)
        return None

    chapter.attempt("outcome", head)
    tables: list[Table] = []
    if name and study.captions:
        chapter.attempt("pictures", lambda: _pictures(study, result, name))
    chapter.attempt("tables", lambda: tables.extend(study.tables_of(data)))
    for table in tables:
        what = table.heading[:1].lower() + table.heading[1:]
        chapter.attempt(what, table.cells, data)
    chapter.attempt("notes", lambda: _notes(study, result, chapter.message))
    add_origin(chapter, data, lambda: study.parts(data))
    return chapter


def _notes(study: Study, result: Result, told: str) -> Notes | None:
    """Notes and faults, without those that the head tells."""
    lines = [*study.notes(result.data), *(line for line in study.faults(result.data).lines if line not in told)]
    return Notes("Notes", lines) if lines else None


def _pictures(study: Study, result: Result, name: str) -> Pictures:
    """Pictures of the panels of the study's figure."""
    loaded = imported(study.figure)(result)
    if not loaded.panels:
        return Pictures([])
    data = loaded.data()
    captions = study.captions(result.data) if callable(study.captions) else study.captions
    pictures = [
        Picture(panel, data, f"{name}-{i}", caption)
        for i, (panel, caption) in enumerate(zip(loaded.panels, captions, strict=True))
    ]
    return Pictures(pictures)


def motion_chapter(motion: Motion, experiment: Experiment, name: str | None) -> Chapter:
    """Chapter on the ``motion`` that an experiment starts.

    ``name`` is unique within the page; None leaves out pictures.
    """
    from topcli import __version__

    chapter = Chapter(experiment.name, "motion", motion.top, motion.kind, message=motion.title)
    if name:
        chapter.attempt("pictures", lambda: _motion_picture(motion, experiment, name))
    chapter.blocks.append(replace(QUANTITIES.cells(motion), numbers=False))
    if motion.notes:
        chapter.blocks.append(Notes("Notes", motion.notes))
    config = experiment.resolved()
    chapter.details.append(config_block({key: config[key] for key in ("top", "initial")}))
    sources = sources_of([(experiment.top.form, "")])
    chapter.blocks.append(citation_block(sources, __version__))
    chapter.details.append(works_block(sources))
    return chapter


def _motion_picture(motion: Motion, experiment: Experiment, name: str) -> Pictures:
    panel, data = motion_drawn(closed_form_top(experiment.top), motion, experiment.name)
    caption = motion.title
    return Pictures([Picture(panel, data, name, caption, (5.6, 4.0))])
