"""Self-contained HTML page on results: no scripts, no requests; for screens, phones and paper."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from topcli import __version__
from topcli.errors import UsageError, counted, printable
from topcli.pages.contents import MALFORMED, Chapter
from topcli.pages.results import comparisons, run_chapter, sweep_chapter
from topcli.pages.studies import record_chapter
from topcli.store.provenance import now
from topcli.store.results import MANIFEST, intact_result
from topcli.studies.report import read_record
from topcli.sweeps.store import ROWS_FILE, SWEEP_FILE, intact_sweep, is_sweep, missing_result

_EXPONENT = re.compile(r"(?:(?<!\w)-)?\d[\d.]*e[-+]\d+")
FOLDER = Path(__file__).parent
TEMPLATE = "page.html.jinja"
STYLES = "page.css"
MOST_NAMED = 3
"""Largest number of results whose names make the title of a page."""
LONGEST_WORD = 30
"""Longest word, in letters, that no line breaks; digests and paths are longer."""


def _shown(value: object) -> object:
    """Value of an expression of the template, with escapes for control characters; names in files may hold any."""
    return printable(value) if type(value) is str else value


def _prose(text: object) -> Any:
    """Text that is never broken within a number such as 1e-07, where browsers break after the sign."""
    from markupsafe import Markup, escape

    shown = printable(text) if isinstance(text, str) else text
    return Markup(_EXPONENT.sub(r'<span class="number">\g<0></span>', str(escape(shown))))


def _environment() -> Any:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    made = Environment(
        loader=FileSystemLoader(FOLDER),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_shown,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.filters["prose"] = _prose
    made.tests["unbroken"] = lambda text: max(map(len, str(text).split()), default=0) > LONGEST_WORD
    return made


def rendered(chapters: Sequence[Chapter], title: str) -> str:
    """Return the page of ``chapters`` as text; everything in them but the pictures is escaped."""
    from markupsafe import Markup

    text = (
        _environment()
        .get_template(TEMPLATE)
        .render(
            title=title,
            chapters=chapters,
            styles=Markup((FOLDER / STYLES).read_text(encoding="utf-8")),
            version=__version__,
            written=now(),
        )
    )
    return text.lstrip()


@dataclass(frozen=True)
class Page:
    """A page on results: its ``chapters`` and its ``text`` as HTML."""

    chapters: Sequence[Chapter]
    text: str


def page_of(chapters: Sequence[Chapter], title: str | None = None) -> Page:
    """Page on ``chapters``, after comparisons of the runs among them that share a top."""
    whole = [*comparisons(chapters), *chapters]
    titles = [chapter.title for chapter in chapters]
    named = ", ".join(titles) if len(titles) <= MOST_NAMED else counted(len(titles), "result")
    return Page(whole, rendered(whole, title or named))


_RUN_FILES = ("report.json", "config.yaml", "series.parquet", "series.csv", "trajectories.parquet", "trajectories.csv")


def all_chapters(places: Sequence[str], results: Path) -> list[Chapter]:
    """Chapters on all ``places``, each once. Raises UsageError and RunError."""
    return [_chapter(place, results) for place in dict.fromkeys(places)]


def report_page(
    places: Sequence[str],
    results: Path = Path("results"),
    title: str | None = None,
) -> Page:
    """Page on the results that ``places`` name: paths, or names of folders in ``results``.

    Raises UsageError and RunError.
    """
    return page_of(all_chapters(places, results), title)


def _chapter(place: str, results: Path) -> Chapter:
    """Chapter on what ``place`` names: a path, or the name of a folder in ``results``.

    Raises UsageError if there is nothing that topcli stored or the result is not finished, and RunError if it is
    damaged.
    """
    try:
        for path in (Path(place), results / place):
            if path.exists():
                return _of_folder(path) if path.is_dir() else _of_file(path)
    except OSError as error:
        raise UsageError(f"{place[:400]}: cannot be read ({error.strerror})") from None
    except MALFORMED as error:
        reason = f"{type(error).__name__}: {error}"
        raise UsageError(f"{place}: not of the form that this version of topcli writes ({reason})") from None
    raise missing_result(place, results)


def _of_folder(folder: Path) -> Chapter:
    if is_sweep(folder):
        return sweep_chapter(intact_sweep(folder))
    return run_chapter(intact_result(folder))


def _of_file(path: Path) -> Chapter:
    """Chapter on a file: a study as JSON, or a file of a run or sweep, which stands for its folder."""
    if path.name in (ROWS_FILE, SWEEP_FILE, MANIFEST, *_RUN_FILES):
        return _of_folder(path.parent)
    return record_chapter(read_record(path))
