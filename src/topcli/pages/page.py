"""Render chapters as one self-contained HTML page: no script, no request, light and dark, for paper and phones."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from topcli import __version__
from topcli.errors import printable
from topcli.pages.contents import Chapter
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


def rendered(chapters: Sequence[Chapter], title: str) -> str:
    """Return the page of ``chapters`` as text; everything in them but the pictures is escaped."""
    from markupsafe import Markup

    template = _environment().get_template(TEMPLATE)
    styles = (FOLDER / STYLES).read_text(encoding="utf-8")
    text = template.render(
        title=title, chapters=chapters, styles=Markup(styles), safe=Markup, version=__version__, written=now()
    )
    return text.lstrip()


def fragment(chapter: Chapter) -> str:
    """Return the chapter as HTML for a cell of a notebook, without styles of its own."""
    module = _environment().get_template(TEMPLATE).make_module({"safe": str, "title": "", "chapters": ()})
    return str(module.summary(chapter))
