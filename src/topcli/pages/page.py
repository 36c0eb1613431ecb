"""Render chapters as one self-contained HTML page: no script, no request, light and dark, for paper and phones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from topcli import __version__
from topcli.errors import printable
from topcli.pages.contents import Chapter, Picture
from topcli.pages.pictures import svg_of
from topcli.pages.runs import comparisons
from topcli.store.provenance import now

FOLDER = Path(__file__).parent
TEMPLATE = "page.html.jinja"
STYLES = "page.css"


def _shown(value: object) -> object:
    """Value of an expression of the template, with escapes for control characters; names in files may hold any."""
    return printable(value) if type(value) is str else value


def _environment() -> Any:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    return Environment(
        loader=FileSystemLoader(FOLDER),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_shown,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def rendered(chapters: Sequence[Chapter], title: str, draw: Callable[[Picture], str] = svg_of) -> str:
    """Return the page of ``chapters`` as text; everything in them but the pictures is escaped."""
    from markupsafe import Markup

    svgs = {name: svg for chapter in chapters for name, svg in chapter.drawn(draw).items()}
    text = (
        _environment()
        .get_template(TEMPLATE)
        .render(
            title=title,
            chapters=chapters,
            styles=Markup((FOLDER / STYLES).read_text(encoding="utf-8")),
            svgs=svgs,
            safe=Markup,
            version=__version__,
            written=now(),
        )
    )
    return text.lstrip()


def fragment(chapter: Chapter) -> str:
    """Return the chapter as HTML for a cell of a notebook, without styles of its own."""
    module = _environment().get_template(TEMPLATE).make_module({"safe": str, "title": "", "chapters": ()})
    return str(module.summary(chapter))


@dataclass(frozen=True)
class Page:
    """A page on results: its ``chapters`` and its ``text`` as HTML."""

    chapters: Sequence[Chapter]
    text: str


def page_of(chapters: Sequence[Chapter], title: str | None = None, draw: Callable[[Picture], str] = svg_of) -> Page:
    """Page on ``chapters``, after comparisons of the runs among them that share a top; ``draw`` draws the pictures."""
    whole = [*comparisons(chapters), *chapters]
    return Page(whole, rendered(whole, title or ", ".join(chapter.title for chapter in chapters), draw))
