"""Chapters of a page on studies, on benchmarks, and on the exact motion."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from topcli.analysis.motion import QUANTITIES, Motion
from topcli.analysis.motion.of_top import closed_form_top
from topcli.config.models import Experiment
from topcli.errors import TopcliError
from topcli.figures.motion import motion_drawn
from topcli.pages.contents import (
    Chapter,
    Notes,
    Picture,
    Pictures,
    add_origin,
    citation_block,
    config_block,
    files_block,
    sources_of,
)
from topcli.store.results import StoredResult
from topcli.studies import imported
from topcli.studies.bench.result import DECADE_TABLE, POINT_TABLE
from topcli.studies.study import Result, Study, parts_of


def bench_chapter(run: StoredResult) -> Chapter:
    """Chapter on a benchmark of speed against error."""
    manifest = run.manifest
    chapter = Chapter(manifest["name"], "bench", "speed against error", "measured")
    report = run.report()
    chapter.add(Notes("In words", [row["words"] for row in report["decades"]]))
    chapter.add(DECADE_TABLE.cells(report), POINT_TABLE.cells(report))
    add_origin(chapter, manifest, _measured_parts(report))
    chapter.add(files_block(run.folder, manifest["files"]), folded=True)
    return chapter


def _measured_parts(report: Mapping[str, Any]) -> Sequence[tuple[str, str]]:
    """Top and schemes of a benchmark; the settings of a competitor follow its name."""
    rows = [*report["competitors"], *report["closed_forms"]]
    names = [re.split("[ :]", row["name"])[0] for row in rows if row.get("kind", "topcli") == "topcli"]
    return parts_of(report["config"], names)


def study_chapter(study: Study, result: Result, name: str | None) -> Chapter:
    """Chapter on a ``result`` of a study; ``name`` is unique within the page, None leaves out pictures."""
    data = result.data
    chapter = Chapter(study.name.capitalize(), study.name)
    chapter.title, chapter.subtitle, chapter.state, chapter.good, message = study.head(data)
    chapter.message = message or study.answer(data)
    if name and study.captions:
        chapter.add(_pictures(study, result, name))
    chapter.add(*(table.cells(data) for table in study.tables_of(data)))
    chapter.add(_notes(study, result, chapter.message))
    try:
        parts = study.parts(data)
    except TopcliError:  # of a plugin that is not loaded
        parts = ()
    add_origin(chapter, data, parts)
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
        chapter.add(_motion_picture(motion, experiment, name))
    chapter.blocks.append(replace(QUANTITIES.cells(motion), numbers=False))
    if motion.notes:
        chapter.blocks.append(Notes("Notes", motion.notes))
    config = experiment.resolved()
    chapter.details.append(config_block({key: config[key] for key in ("top", "initial")}))
    chapter.blocks.append(citation_block(sources_of([(experiment.top.form, "")]), __version__))
    return chapter


def _motion_picture(motion: Motion, experiment: Experiment, name: str) -> Pictures:
    panel, data = motion_drawn(closed_form_top(experiment.top), motion, experiment.name)
    caption = motion.title
    return Pictures([Picture(panel, data, name, caption, (5.6, 4.0))])
