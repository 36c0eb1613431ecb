"""Self-contained HTML page of reports: no scripts, no requests, readable on a phone."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from topcli import __version__
from topcli.config.text import to_yaml
from topcli.errors import UnknownNameError, counted, printable
from topcli.store.provenance import now
from topcli.studies.cite import ALWAYS, bibliography, works_of
from topcli.table import Cells, stored_cells

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
LONGEST_TEXT = 400
"""Lines of a config that a page shows; an ensemble may list thousands of states."""
WRITTEN = ("written", "commit", "dirty")
"""Entries of a stored record on its origin, besides the environment."""


def page_of(records: Sequence[Mapping[str, Any]]) -> str:
    """Page of reports, each a ``Report.record``; everything in them but the pictures is escaped."""
    title = text(records[0]["title"] if len(records) == 1 else counted(len(records), "result"))
    styles = STYLES.read_text(encoding="utf-8")
    head = HEAD.format(title=title, styles=styles, version=__version__, written=now())
    return head + "".join(map(section_html, records)) + "</body>\n</html>\n"


def text(content: object) -> str:
    """Text in HTML; control characters are shown as escapes."""
    return escape(printable(str(content)))


def section_html(record: Mapping[str, Any]) -> str:
    """Section of a page: answer, notes, picture and tables, and the origin folded."""
    origin = {key: record[key] for key in WRITTEN if record.get(key)} | record["environment"]
    setup = [
        ("Config", lines_html(to_yaml(record["config"]) if record["config"] else "")),
        ("Provenance", table_html(Cells("", (), [[key, str(value)] for key, value in origin.items()]))),
        ("BibTeX", lines_html("\n\n".join(works(cited(record)).values()))),
    ]
    messages = [*record["errors"], *record["notes"]]
    parts = [
        f"<h2>{text(record['title'])}</h2>",
        f'<p class="quiet">topcli {text(record["command"])}</p>',
        f'<p class="{"bad" if record["code"] else "good"}">{text(record["answer"])}</p>' if record["answer"] else "",
        f"<ul>{''.join(f'<li>{text(message)}</li>' for message in messages)}</ul>" if messages else "",
        picture_html(record["picture"], record["title"]) if record["picture"] else "",
        *(table_html(stored_cells(table)) for table in record["tables"]),
        *(f"<details><summary>{title}</summary>{content}</details>" for title, content in setup if content),
    ]
    return "<section>\n" + "\n".join(filter(None, parts)) + "\n</section>\n"


def picture_html(svg: str, title: str) -> str:
    """Picture, which a browser shows without running anything in it."""
    source = "data:image/svg+xml;base64," + base64.b64encode(svg.encode()).decode()
    return f'<figure><img src="{source}" alt="{text(title)}"></figure>'


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


def cited(record: Mapping[str, Any]) -> Iterator[str]:
    """Names of the tops and schemes that took part: those of the rows, or without any, that of the config."""
    rows = [*record.get("rows", ()), *(row for table in record["tables"] for row in table["rows"])]
    config = record["config"].get("base", record["config"])
    for key, part in (("top", "kind"), ("scheme", "name")):
        in_rows = [row[key] for row in rows if isinstance(row.get(key), str)]
        in_config = config.get(key) or {}
        yield from in_rows or [in_config if isinstance(in_config, str) else in_config.get(part, "")]


def works(names: Iterable[str]) -> dict[str, str]:
    """BibTeX of topcli, the paper, and the works behind ``names``, without those that are not registered here."""
    entries = {key: bibliography()[key][0] for key in ALWAYS}
    for name in dict.fromkeys(re.split("[ :]", name)[0] for name in names):
        try:
            entries |= works_of(name)
        except UnknownNameError:
            continue
    return entries
