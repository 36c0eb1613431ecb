"""Output of the commands: data on stdout, messages on stderr, colours and progress only on a terminal.

A table is printed in aligned columns; one that is too wide, in blocks of columns.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import sys
from collections.abc import Collection, Mapping, Sequence
from textwrap import fill
from types import MappingProxyType
from typing import Any, NamedTuple, TextIO

from topcli.errors import ExitCode, TopcliError, printable
from topcli.show.progress import Progress
from topcli.table import Cells

WIDTH = 100
"""Characters in a line of a table or text that does not go to a terminal."""
_COLOURS = {"good": "32", "middling": "33", "bad": "31"}
"""Parameters of the control sequences for the marks of cells: green, yellow and red."""
GAP = 2
"""Spaces between columns."""


def width_of(stream: TextIO) -> int:
    """Characters in a line of a terminal; 100 anywhere else."""
    return max(40, shutil.get_terminal_size().columns) if stream.isatty() else WIDTH


def wrapped(line: str, stream: TextIO) -> str:
    """A sentence or two, on a terminal in lines that end at words."""
    if not stream.isatty():
        return line
    return fill(line, width_of(stream), subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)


def emit(text: str = "") -> None:
    """Print lines of data on stdout."""
    for line in text.split("\n"):
        print(printable(line))


def print_document(document: Mapping[str, Any]) -> None:
    """Print JSON."""
    print(json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False))


def print_message(line: str) -> None:
    """Print a message on stderr, behind the data printed before it, also in one log."""
    with contextlib.suppress(OSError):  # reported at the end, when it is flushed again
        sys.stdout.flush()
    print(wrapped(printable(line), sys.stderr), file=sys.stderr, flush=True)


def print_lines(text: str) -> None:
    """Print a text of several lines on stderr as it is."""
    for line in text.splitlines():
        print(printable(line), file=sys.stderr)


def print_error(error: TopcliError) -> None:
    """Print the lines of an error, the first one after the prefix ``error:``."""
    first, *others = error.lines or ("",)
    for line in (f"error: {first}", *others):
        print_message(line)


class CommandResult(NamedTuple):
    """Result of a command: the content of its JSON document, and its exit code."""

    data: Mapping[str, Any]
    code: ExitCode = ExitCode.SUCCESS


class Screen(Progress):
    """Output of a command while it works: everything, only messages beside one document of JSON, or only errors."""

    def __init__(self, as_json: bool = False, quiet: bool = False) -> None:
        super().__init__(not quiet, print_message)
        self.as_json, self.quiet = as_json, quiet

    def begin(self, name: str, *experiments: Any, unit: str = "steps") -> None:
        """Begin work, after warnings about the experiments."""
        super().begin(name, *experiments, unit=unit)
        for experiment in experiments:
            from topcli.tops.bodies import moment_warnings  # imports numpy

            for line in (*moment_warnings(experiment.top), *experiment.state_warnings()):
                self.warn(f"warning: {experiment.name}: {line}")

    def show(self, *parts: str | Cells, width: int | None = None) -> None:
        """Print data: texts, and tables under their titles, in lines of ``width`` or of that of the terminal."""
        self.close()
        for part in () if self.quiet or self.as_json else parts:
            if isinstance(part, str):
                emit(part if "\n" in part else wrapped(part, sys.stdout))
            else:
                print_cells(part, width or width_of(sys.stdout))

    def warn(self, line: str) -> None:
        """Print a message."""
        self.close()
        if not self.quiet:
            print_message(line)

    def say(self, line: str) -> None:
        """Print a message about what the document of JSON says, too."""
        if not self.as_json:
            self.warn(line)


def print_cells(cells: Cells, width: int) -> None:
    """Print a table in blocks that fit; on a terminal ruled and, without NO_COLOR, coloured."""
    terminal = sys.stdout.isatty() and os.environ.get("TERM") != "dumb"
    marks = cells.marks if terminal and not os.environ.get("NO_COLOR") else {}
    colours = {text: _COLOURS[mark] for text, mark in marks.items()}
    header, *rows = [[printable(cell) for cell in line] for line in (cells.header, *cells.lines)]
    if cells.title:
        emit(wrapped(cells.title, sys.stdout))
    for line in table_lines(header, rows, cells.right, width, cells.keys, terminal, colours):
        print(line)
    if cells.caption:
        emit(wrapped(cells.caption, sys.stdout))


def table_lines(
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    right: Collection[int] = (),
    width: int = WIDTH,
    keys: int = 1,
    rule: bool = False,
    colours: Mapping[str, str] = MappingProxyType({}),
) -> list[str]:
    """Lines of a table in blocks of columns that fit ``width``; a last column of text may be wider.

    Parameters
    ----------
    header : sequence of str
        Names of the columns; an empty one prints no header.
    rows : sequence of sequences of str
        Cells, as many in each row as there are columns.
    right : collection of int
        Indices of the right-aligned columns.
    width : int
        Characters in a line.
    keys : int
        Leading columns that name a row, with which each block begins.
    rule : bool
        Draw a line under the header.
    colours : mapping of str to str
        Parameters of the control sequences around cells with these texts.
    """
    table = [header, *rows] if header else list(rows)
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]

    # blocks: the columns that name a row, and as many more as fit
    first = list(range(min(keys, len(widths))))
    blocks = [[*first]]
    for i in range(len(first), len(widths)):
        used = sum(widths[j] + GAP for j in blocks[-1]) + widths[i]
        text = i == len(widths) - 1 and i not in right
        if used > width and not text and len(blocks[-1]) > len(first):
            blocks.append([*first])
        blocks[-1].append(i)

    # padding counts letters, not the control sequences of colours
    lines: list[str] = []
    for block in blocks if table else ():
        lines += [""] if lines else []
        for number, row in enumerate(table):
            cells = []
            for i in block:
                padding, colour = " " * (widths[i] - len(row[i])), colours.get(row[i])
                text = f"\x1b[{colour}m{row[i]}\x1b[0m" if colour and row[i] else row[i]
                cells.append(padding + text if i in right else text + padding)
            lines.append((" " * GAP).join(cells).rstrip())
            if rule and header and number == 0:
                lines.append("─" * min(sum(widths[i] + GAP for i in block) - GAP, width))
    return lines
