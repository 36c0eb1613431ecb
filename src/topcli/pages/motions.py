"""Chapter on the closed form of one motion."""

from __future__ import annotations

from dataclasses import replace

from topcli.analysis.motion import NEIGHBOURS, QUANTITIES, Motion
from topcli.analysis.motion.of_top import closed_form_top
from topcli.config.models import Experiment
from topcli.figures.motion import motion_drawn
from topcli.pages.contents import Chapter, Notes, Picture, Pictures
from topcli.pages.origin import citation_block, config_block

SIZE = (5.6, 4.0)


def motion_chapter(motion: Motion, experiment: Experiment, name: str | None) -> Chapter:
    """Chapter on the ``motion`` that an experiment starts.

    ``name`` is unique within the page; None leaves out pictures.
    """
    from topcli import __version__

    chapter = Chapter(experiment.name, "motion", motion.top, motion.kind, message=motion.title)
    chapter.blocks.append(replace(QUANTITIES.cells(motion), numbers=False))
    if motion.neighbours:
        chapter.blocks.append(NEIGHBOURS.cells(motion))
    if motion.notes:
        chapter.blocks.append(Notes("Notes", motion.notes))
    if name:
        chapter.attempt("pictures", lambda: _picture(motion, experiment, name))
    config = experiment.resolved()
    chapter.blocks.append(config_block({key: config[key] for key in ("top", "initial")}))
    chapter.blocks.append(citation_block([], __version__))
    return chapter


def _picture(motion: Motion, experiment: Experiment, name: str) -> Pictures:
    panel, data = motion_drawn(closed_form_top(experiment.top), motion, experiment.name)
    caption = motion.title
    return Pictures([Picture(panel, data, name, caption, SIZE)])
