"""Chapter on the result of a study, from its declaration."""

from __future__ import annotations

from topcli.pages.contents import Block, Chapter, Notes, Picture, Pictures
from topcli.pages.origin import add_origin
from topcli.studies import imported
from topcli.studies.study import Result, Study
from topcli.table import Table


def study_chapter(study: Study, result: Result, name: str | None) -> Chapter:
    """Chapter on a ``result`` of a study, which may hold anything if it was read from a file.

    ``name`` is unique within the page; None leaves out pictures.
    """
    data = result.data
    chapter = Chapter(study.name.capitalize(), study.name)

    def head() -> Block | None:
        chapter.title, chapter.subtitle, chapter.state, chapter.good, chapter.message = study.head(data)
        return None

    chapter.attempt("outcome", head)
    tables: list[Table] = []
    chapter.attempt("tables", lambda: tables.extend(study.tables_of(data)))
    for i, table in enumerate(tables):
        what = table.heading[:1].lower() + table.heading[1:]
        chapter.attempt(what, lambda table=table: cells if (cells := table.cells(data)).lines else None)
        if name and study.figure and i == 0:
            chapter.attempt("pictures", lambda: _pictures(study, result, name))
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
