"""Self-contained HTML page of reports: no scripts, no requests, readable on a phone."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from html import escape
from pathlib import Path
from typing import Any

from topcli import __version__
from topcli.config.text import to_yaml
from topcli.errors import UnknownNameError, counted, printable
from topcli.store.provenance import now
from topcli.studies.cite import ALWAYS, bibliography, works_of
from topcli.table import Cells, stored_cells

HEAD, STYLES = Path(__file__).with_suffix(".html"), Path(__file__).with_suffix(".css")
LONGEST_TEXT = 400
"""Lines of a config that a page shows; an ensemble may list thousands of states."""


def page_of(records: Sequence[Mapping[str, Any]]) -> str:
    """Page of reports, each a ``Report.record``, under headings if there are several; their texts are escaped."""
    title = text(records[0]["title"] if len(records) == 1 else counted(len(records), "result"))
    head, styles = (path.read_text(encoding="utf-8") for path in (HEAD, STYLES))
    head = head.format(title=title, styles=styles, version=__version__, written=now())
    sections = [section_html(record, len(records) > 1) for record in records]
    return head + "".join(sections) + "</body>\n</html>\n"


def text(content: object) -> str:
    """Text in HTML; control characters are shown as escapes."""
    return escape(printable(str(content)))


def section_html(record: Mapping[str, Any], titled: bool) -> str:
    """Section of a page, under a heading if ``titled``: answer, messages, picture and tables, and the origin folded."""
    origin = {key: record[key] for key in ("written", "commit", "dirty") if record.get(key)} | record["environment"]
    setup = {
        "Config": lines_html(to_yaml(record["config"]) if record["config"] else ""),
        "Provenance": table_html(Cells("", (), [[key, str(value)] for key, value in origin.items()])),
        "BibTeX": lines_html("\n\n".join(works(record).values())),
    }
    parts = [f"<h2>{text(record['title'])}</h2>"] if titled else []
    parts.append(f'<p class="quiet">topcli {text(record["command"])}</p>')
    if record["answer"]:
        parts.append(f'<p class="{"bad" if record["code"] else "good"}">{text(record["answer"])}</p>')
    if messages := [*record["errors"], *record["notes"]]:
        parts.append(f"<ul>{''.join(f'<li>{text(message)}</li>' for message in messages)}</ul>")
    if record["picture"]:  # a browser runs nothing in an image
        source = "data:image/svg+xml;base64," + base64.b64encode(record["picture"].encode()).decode()
        parts.append(f'<figure><img src="{source}" alt="{text(record["title"])}"></figure>')
    parts += [table_html(stored_cells(table)) for table in record["tables"]]
    parts += [f"<details><summary>{name}</summary>{html}</details>" for name, html in setup.items() if html]
    return "\n".join(["<section>", *filter(None, parts), "</section>\n"])


def table_html(cells: Cells) -> str:
    """Table under its title, which scrolls if it is wider than the page; empty without lines."""
    if not cells.lines:
        return ""

    def row(line: Sequence[str], tag: str) -> str:
        looks = (f"{'number' * (i in cells.right)} {cells.marks.get(cell, '')}" for i, cell in enumerate(line))
        written = zip(map(str.strip, looks), map(text, line), strict=True)
        parts = [f'<{tag} class="{look}">{cell}</{tag}>'.replace(' class=""', "") for look, cell in written]
        return f"<tr>{''.join(parts)}</tr>\n"

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


def works(record: Mapping[str, Any]) -> dict[str, str]:
    """BibTeX of topcli, the paper, and the works behind the tops and schemes that took part, as far as registered here.

    They are those of the rows, or without any, that of the config.
    """
    rows = [*record.get("rows", ()), *(row for table in record["tables"] for row in table["rows"])]
    config, names = record["config"].get("base", record["config"]), []
    for key, part in (("top", "kind"), ("scheme", "name")):
        of_config = config.get(key) or ""
        of_config = of_config if isinstance(of_config, str) else of_config.get(part, "")
        names += [row[key] for row in rows if isinstance(row.get(key), str)] or [of_config]
    entries = {key: bibliography()[key][0] for key in ALWAYS}
    for name in dict.fromkeys(re.split("[ :]", name)[0] for name in names):
        with suppress(UnknownNameError):
            entries |= works_of(name)
    return entries
