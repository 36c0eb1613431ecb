"""Tables of text: aligned columns, fitted to a width by wrapping at words and by blocks of columns."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from textwrap import wrap

GAP = 2
"""Spaces between columns."""
COMFORTABLE = 24
"""Smallest width of prose if columns can go into another block instead."""


def table_lines(
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    right: Collection[int] = (),
    width: int | None = None,
    rule: bool = False,
    keys: int = 1,
) -> list[str]:
    """Lines of a table, none longer than ``width``.

    A table that is too wide is printed in blocks of columns, and each block begins with the columns that name a row.
    Cells are wrapped at words; a word is broken only if it does not fit by itself.

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
    keys : int
        Leading columns that name a row.
    """
    table = [header, *rows] if header else list(rows)
    if not table:
        return []
    count = len(table[0])
    natural = [max(len(row[i]) for row in table) for i in range(count)]
    least = natural
    if width is not None:
        least, keys = _least(table, natural, right, width, keys)
    lines: list[str] = []
    for block in _blocks(least, width, keys):
        widths = {i: least[i] for i in block}
        _widen(widths, natural, width)
        lines += [""] if lines else []
        for number, row in enumerate(table):
            lines += _row_lines(row, widths, right)
            if rule and header and number == 0:
                lines.append("─" * (sum(widths.values()) + GAP * (len(widths) - 1)))
    return lines


def _least(
    table: Sequence[Sequence[str]], natural: Sequence[int], right: Collection[int], width: int, keys: int
) -> tuple[list[int], int]:
    """Smallest width of each column, and the number of columns that name a row, which is 1 if space is short.

    A column is at least as wide as its longest word, and any column fits beside those that name a row.
    """
    words = [max((len(part) for row in table for part in row[i].split()), default=0) for i in range(len(natural))]
    for i in right:  # numbers stay whole, with their errors and units; only the header is wrapped
        words[i] = max(words[i], *(len(row[i]) for row in table[1:] or table))
    least = [word if i in right else max(word, min(natural[i], COMFORTABLE)) for i, word in enumerate(words)]
    longest = max(words[keys:], default=-GAP)
    if sum(least[:keys]) + GAP * keys > min(width * 2 // 3, width - longest) or keys >= len(words):
        keys = 1
        longest = min(max(words[1:], default=-GAP), width - GAP - min(words[0], (width - GAP) // 2))
        least[0] = min(least[0], width - GAP - longest)
    room = width - sum(least[:keys]) - GAP * keys
    return [*least[:keys], *(min(one, room) for one in least[keys:])], keys


def _blocks(least: Sequence[int], width: int | None, keys: int) -> list[list[int]]:
    """Columns of each block: those that name a row, and as many more as fit."""
    first = list(range(min(keys, len(least))))
    blocks = [[*first]]
    for i in range(len(first), len(least)):
        used = sum(least[j] + GAP for j in blocks[-1]) + least[i]
        if width is not None and used > width and len(blocks[-1]) > len(first):
            blocks.append([*first])
        blocks[-1].append(i)
    return blocks


def _widen(widths: dict[int, int], natural: Sequence[int], width: int | None) -> None:
    """Distribute the remaining width of a line to the columns that lack most."""
    left = 0 if width is None else width - sum(widths.values()) - GAP * (len(widths) - 1)
    while left > 0:
        most = max(widths, key=lambda i: natural[i] - widths[i])
        if natural[most] <= widths[most]:
            return
        widths[most] += 1
        left -= 1


def _row_lines(row: Sequence[str], widths: dict[int, int], right: Collection[int]) -> list[str]:
    """Lines of one row of a block."""
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
    """Lines of a cell, with the indentation of its text."""
    if len(text) <= width:
        return [text]
    indent = " " * (len(text) - len(text.lstrip()) + 2) if text[:1] == " " else ""
    return wrap(text, width, subsequent_indent=indent, break_on_hyphens=False)
