"""``topcli report``: one page on several results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from topcli.errors import UsageError
from topcli.pages.contents import Chapter
from topcli.pages.find import all_chapters
from topcli.pages.page import rendered
from topcli.pages.together import comparison_of

SUFFIXES = (".html", ".htm")


@dataclass(frozen=True)
class Page:
    """A page on results: its ``chapters`` and its ``text`` as HTML."""

    chapters: Sequence[Chapter]
    text: str


def require_html(path: Path) -> None:
    """Raise UsageError for a file whose name is not that of a page."""
    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(f"--out {path}: unknown type of page; use a name ending in .html")


def page_of(chapters: Sequence[Chapter], title: str | None = None) -> Page:
    """Page on ``chapters``, after comparisons of the runs among them that share a top."""
    whole = [*comparison_of(chapters), *chapters]
    return Page(whole, rendered(whole, title or ", ".join(chapter.title for chapter in chapters)))


def report_page(places: Sequence[str], results: Path = Path("results"), title: str | None = None) -> Page:
    """Page on the results that ``places`` name: paths, or names of folders in ``results``. Raises UsageError."""
    return page_of(all_chapters(places, results), title)
