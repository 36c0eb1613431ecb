"""Chapters of a page on studies and on the exact motion."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

from topcli.analysis.motion import Motion, motion_table
from topcli.analysis.motion.of_top import closed_form_top
from topcli.config.formulas import declared_class
from topcli.config.models import Experiment
from topcli.errors import ExitCode, TopcliError
from topcli.figures.motion import motion_drawing
from topcli.figures.study import picture
from topcli.pages.contents import (
    Chapter,
    Notes,
    Pictures,
    add_origin,
    citation_block,
    config_block,
    sources_of,
)
from topcli.schemes.own_tops import top_class
from topcli.table import stored_cells


def parts_of(config: Mapping[str, Any], names: Iterable[str]) -> list[tuple[str, str]]:
    """Form of the top of a resolved config, and each of the schemes; their settings may follow the names."""
    form = (declared_class(config["top"]) or top_class(config["top"]["kind"], config.get("initial") or ())).form
    return [(form, re.split("[ :]", name)[0]) for name in names]


def record_chapter(record: Mapping[str, Any]) -> Chapter:
    """Chapter on a stored report of a study."""
    code, errors = record["code"], record["errors"]
    state = ExitCode(code).meaning if code else "measured"
    chapter = Chapter(f"topcli {record['command']}", record["command"], record["title"], state, not code)
    chapter.message = record["answer"]
    pictures = [(record["picture"].encode(), record["title"])] if record["picture"] else []
    chapter.add(Pictures(pictures), *(stored_cells(table) for table in record["tables"]))
    chapter.add(Notes("Notes", [*record["notes"], *errors]))
    named = [row["scheme"] for table in record["tables"] for row in table["rows"] if row.get("scheme")]
    try:
        parts = parts_of(record["config"], named) if "top" in record["config"] else ()
    except TopcliError:  # of a plugin that is not loaded
        parts = ()
    add_origin(chapter, record, parts)
    return chapter


def motion_chapter(motion: Motion, experiment: Experiment) -> Chapter:
    """Chapter on the ``motion`` that an experiment starts."""
    from topcli import __version__

    chapter = Chapter(experiment.name, "motion", motion.top, motion.kind, message=motion.title)
    draw, projection = motion_drawing(closed_form_top(experiment.top), motion, experiment.name)
    chapter.add(Pictures([(picture(draw, size=(5.6, 4.0), projection=projection), motion.title)]))
    chapter.add(motion_table(motion).cells(), Notes("Notes", motion.notes))
    config = experiment.resolved()
    chapter.add(config_block({key: config[key] for key in ("top", "initial")}), folded=True)
    chapter.add(citation_block(sources_of([(experiment.top.form, "")]), __version__))
    return chapter
