"""Self-contained HTML page on results: no scripts, no requests, readable on a phone."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

from topcli import __version__
from topcli.errors import ExitCode, UnknownNameError, counted, printable
from topcli.store.provenance import now
from topcli.studies.cite import ALWAYS, bibliography, works_of
from topcli.table import Cells

STYLES = Path(__file__).with_name("page.css")
HEAD = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'; img-src data:">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
{styles}</style>
</head>
<body>
<h1>{title}</h1>
<p class="quiet">Written by topcli {version} on {written}. All quantities are dimensionless.</p>
"""
MOST_NAMED = 3
"""Largest number of results whose names make the title of a page."""
LONGEST_TEXT = 400
"""Lines of a config that a page shows; an ensemble may list thousands of states."""


@dataclass(frozen=True)
class Chapter:
    """One result on a page.

    Attributes
    ----------
    title, subtitle, answer : str
        Name, description, and outcome or answer.
    code : int
        Exit code of the command; the answer is green only for 0.
    pictures : sequence of (bytes, str)
        SVG, which browsers show without running anything in it, and captions.
    tables : sequence of Cells
        Tables.
    notes : sequence of str
        Sentences: verdicts, warnings, explanations.
    config : str
        Config as YAML.
    origin : mapping
        Times, versions, machine and digests.
    cited : iterable of str
        Names of the schemes and tops that took part.
    """

    title: str
    subtitle: str = ""
    answer: str = ""
    code: int = ExitCode.SUCCESS
    pictures: Sequence[tuple[bytes, str]] = ()
    tables: Sequence[Cells] = ()
    notes: Sequence[str] = ()
    config: str = ""
    origin: Mapping[str, Any] = field(default_factory=dict)
    cited: Iterable[str] = ()


def page_of(chapters: Sequence[Chapter]) -> str:
    """Page of ``chapters``; everything in them but the pictures is escaped."""
    titles = [chapter.title for chapter in chapters]
    title = text(", ".join(titles) if len(titles) <= MOST_NAMED else counted(len(titles), "result"))
    styles = STYLES.read_text(encoding="utf-8")
    head = HEAD.format(title=title, styles=styles, version=__version__, written=now())
    return head + "".join(map(chapter_html, chapters)) + "</body>\n</html>\n"


def text(content: object) -> str:
    """Text in HTML; control characters are shown as escapes."""
    return escape(printable(str(content)))


def chapter_html(chapter: Chapter) -> str:
    """Section of a page: answer, notes, pictures and tables, and the origin folded."""
    setup = [
        ("Config", lines_html(chapter.config)),
        ("Provenance", table_html(Cells("", (), [[key, str(value)] for key, value in chapter.origin.items()]))),
        ("BibTeX", lines_html("\n\n".join(works(chapter.cited).values()))),
    ]
    parts = [
        f"<h2>{text(chapter.title)}</h2>",
        f'<p class="quiet">{text(chapter.subtitle)}</p>' if chapter.subtitle else "",
        f'<p class="{"bad" if chapter.code else "good"}">{text(chapter.answer)}</p>' if chapter.answer else "",
        f"<ul>{''.join(f'<li>{text(note)}</li>' for note in chapter.notes)}</ul>" if chapter.notes else "",
        *(picture_html(svg, caption) for svg, caption in chapter.pictures),
        *map(table_html, chapter.tables),
        *(f"<details><summary>{title}</summary>{content}</details>" for title, content in setup if content),
    ]
    return "<section>\n" + "\n".join(filter(None, parts)) + "\n</section>\n"


def picture_html(svg: bytes, caption: str) -> str:
    """Picture with its caption."""
    source = "data:image/svg+xml;base64," + base64.b64encode(svg).decode()
    return f'<figure><img src="{source}" alt="{text(caption)}"><figcaption>{text(caption)}</figcaption></figure>'


def table_html(cells: Cells) -> str:
    """Table under its title, which scrolls if it is wider than the page; empty without lines."""
    if not cells.lines:
        return ""

    def row(line: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(cell(i, content, tag) for i, content in enumerate(line)) + "</tr>\n"

    def cell(i: int, content: str, tag: str) -> str:
        looks = " ".join(filter(None, ["number" if i in cells.right else "", cells.marks.get(content, "")]))
        return f'<{tag} class="{looks}">{text(content)}</{tag}>' if looks else f"<{tag}>{text(content)}</{tag}>"

    head = f"<thead>{row(cells.header, 'th')}</thead>" if cells.header else ""
    body = "".join(row(line, "td") for line in cells.lines)
    title = f"<h3>{text(cells.title)}</h3>" if cells.title else ""
    caption = f'<p class="quiet">{text(cells.caption)}</p>' if cells.caption else ""
    return f'{title}<div class="scroll" tabindex="0"><table>{head}<tbody>{body}</tbody></table></div>{caption}'


def lines_html(content: str) -> str:
    """Text line by line, without the rest of a very long one."""
    lines = content.splitlines()
    left = len(lines) - LONGEST_TEXT
    lines = lines[:LONGEST_TEXT] + ([f"... and {left} more lines"] if left > 0 else [])
    return f'<pre tabindex="0">{chr(10).join(map(text, lines))}</pre>' if lines else ""


def works(names: Iterable[str]) -> dict[str, str]:
    """BibTeX of topcli, the paper, and the works behind ``names``, without those that are not registered here."""
    entries = {key: bibliography()[key][0] for key in ALWAYS}
    for name in dict.fromkeys(names):
        try:
            entries |= works_of(name)
        except UnknownNameError:
            continue
    return entries
