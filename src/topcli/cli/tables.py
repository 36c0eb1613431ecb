"""Tables of text: aligned columns, fitted to a width by wrapping at words and by blocks of columns."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from textwrap import wrap

GAP = 2
"""Spaces between columns."""
COMFORTABLE = 24
"""Prose is not made narrower than this where columns can go into another block instead."""


def table_lines(
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    right: Collection[int] = (),
    width: int | None = None,
    rule: bool = False,
) -> list[str]:
    """Lines of a table, none longer than ``width``.

    A table that is too wide is printed in blocks of columns, each of which begins with the first column. Cells are
    wrapped at words; a word is broken only where it alone does not fit.

    Parameters
    ----------
    header : sequence of str
        Names of the columns; an empty one prints no header.
    rows : sequence of sequences of str
        Cells, as many in each row as there are columns.
    right : collection of int
        Indices of the right-aligned columns.
    width : int or None
        Characters in a line; None for no limit.
    rule : bool
        Draw a line under the header.
    """
    table = [header, *rows] if header else list(rows)
    count = len(table[0]) if table else 0
    natural = [max(len(row[i]) for row in table) for i in range(count)]
    least = natural if width is None else _least(table, natural, right, width)
    lines: list[str] = []
    for block in _blocks(least, width):
        widths = {i: least[i] for i in block}
        _widen(widths, natural, width)
        lines += [""] if lines else []
        for number, row in enumerate(table):
            lines += _row_lines(row, widths, right)
            if rule and header and number == 0:
                lines.append("─" * (sum(widths.values()) + GAP * (len(widths) - 1)))
    return lines


def _least(table: Sequence[Sequence[str]], natural: list[int], right: Collection[int], width: int) -> list[int]:
    """Narrowest width of each column: that of its longest word, of prose a comfortable one, and at most what fits."""
    least = []
    for i in range(len(natural)):
        word = max((len(part) for row in table for part in row[i].split()), default=0)
        if i in right:  # numbers stay whole, with their errors and units; only the header is wrapped
            word = max(word, *(len(row[i]) for row in table[1:] or table))
        else:
            word = max(word, min(natural[i], COMFORTABLE))
        most = width if len(natural) == 1 else (width - GAP) // 2 if i == 0 else width - GAP - least[0]
        least.append(min(word, most))
    return least


def _blocks(least: Sequence[int], width: int | None) -> list[list[int]]:
    """Columns of each block: the first one, and as many others as fit."""
    if not least:
        return []
    blocks = [[0]]
    for i in range(1, len(least)):
        used = sum(least[j] + GAP for j in blocks[-1]) + least[i]
        if width is not None and used > width and len(blocks[-1]) > 1:
            blocks.append([0])
        blocks[-1].append(i)
    return blocks


def _widen(widths: dict[int, int], natural: Sequence[int], width: int | None) -> None:
    """Give the room that is left in a line to the columns that lack most."""
    left = 0 if width is None else width - sum(widths.values()) - GAP * (len(widths) - 1)
    while left > 0:
        most = max(widths, key=lambda i: natural[i] - widths[i])
        if natural[most] <= widths[most]:
            return
        widths[most] += 1
        left -= 1


def _row_lines(row: Sequence[str], widths: dict[int, int], right: Collection[int]) -> list[str]:
    cells = {i: _wrapped(row[i], width) for i, width in widths.items()}
    lines = []
    for number in range(max(map(len, cells.values()))):
        parts = []
        for i, width in widths.items():
            part = cells[i][number] if number < len(cells[i]) else ""
            parts.append(part.rjust(width) if i in right else part.ljust(width))
        lines.append((" " * GAP).join(parts).rstrip())
    return lines


def _wrapped(text: str, width: int) -> list[str]:
    """Lines of a cell; an indented one stays indented."""
    if len(text) <= width:
        return [text]
    indent = " " * (len(text) - len(text.lstrip()) + 2) if text[:1] == " " else ""
    return wrap(text, width, subsequent_indent=indent, break_on_hyphens=False)
