"""Printing: data on stdout, messages on stderr, rules and progress bars only on a terminal.

All output passes ``printable``, because names and files may contain control characters. Tables are aligned columns,
fitted to a width by wrapping at words and by blocks of columns.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import sys
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from textwrap import wrap
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TextIO

from topcli.errors import TopcliError, clipped, printable
from topcli.show.progress import PATIENCE, Bar, Rate, percent, plain_console, spell_seconds
from topcli.table import Cells

if TYPE_CHECKING:
    from topcli.config.ensemble import EnsembleExperiment
    from topcli.config.models import Experiment


PIPE_WIDTH = 100
"""Characters in a line of a table that does not go to a terminal."""


def emit(line: str = "") -> None:
    """Print one line of data on stdout."""
    print(printable(line))


def emit_text(text: str) -> None:
    """Print a text of several lines on stdout without wrapping."""
    for line in text.splitlines():
        emit(line)


def emit_prose(text: str, indent: str = "") -> None:
    """Print a sentence or two on stdout, wrapped at words on a terminal."""
    emit_text("\n".join(_wrapped(printable(text), sys.stdout, indent)))


def print_json(command: str, content: dict[str, Any]) -> None:
    """Print the one JSON document of a command: ``schema_version``, ``command`` and its ``content``."""
    print_document({"schema_version": 1, "command": command, **content})


def print_document(document: dict[str, Any]) -> None:
    """Print JSON, with escapes for all control characters."""
    for line in json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False).split("\n"):
        safe = line if line.isprintable() else "".join(c if c.isprintable() else json.dumps(c)[1:-1] for c in line)
        print(safe)


def print_message(line: str) -> None:
    """Print a message on stderr, wrapped at words on a terminal; behind the data printed before it, also in one log."""
    with contextlib.suppress(OSError):  # reported at the end, when it is flushed again
        sys.stdout.flush()
    for part in _wrapped(clipped(printable(line), 990), sys.stderr):
        print(part, file=sys.stderr)
    sys.stderr.flush()


def messages(quiet: bool) -> Callable[[str], None]:
    """Function that prints a message, or nothing if only errors shall be printed."""
    return (lambda line: None) if quiet else print_message


def print_message_text(text: str) -> None:
    """Print a text of several lines on stderr without wrapping."""
    for line in text.splitlines():
        print(printable(line), file=sys.stderr)


def print_error(error: TopcliError) -> None:
    """Print the lines of an error, the first one after the prefix ``error:``."""
    first, *others = error.lines or ("",)
    print_message(f"error: {first}")
    for line in others:
        print_message(line)


def _terminal(stream: TextIO) -> bool:
    return stream.isatty()


def _wrapped(line: str, stream: TextIO, indent: str = "") -> list[str]:
    if not _terminal(stream) or len(indent + line) <= (width := screen_width()):
        return [indent + line]
    return wrap(
        line,
        width,
        initial_indent=indent,
        subsequent_indent=indent + "  ",
        break_long_words=False,
        break_on_hyphens=False,
    )


def print_warnings(experiment: Experiment | EnsembleExperiment) -> None:
    """Print warnings about unusual parameters of the experiment's top and about its initial states."""
    for line in (*experiment.top.warnings(), *experiment.state_warnings()):
        print_message(f"warning: {experiment.name}: {line}")
    if line := _slow_precision(experiment.resolved()):
        print_message(f"warning: {experiment.name}: {line}")


MANY_STEPS = 1_000_000
"""Number of interpreted steps above which a warning is printed."""
STEP_SECONDS = (1e-5, 1e-2)
"""Usual time of an interpreted step, from explicit to implicit schemes."""


def _slow_precision(config: dict[str, Any]) -> str:
    """Warning about a long run in another precision than double, from its resolved config; empty for any other."""
    if "precision" not in config or config["N"] <= MANY_STEPS:
        return ""
    least, most = (spell_seconds(config["N"] * seconds) for seconds in STEP_SECONDS)
    return (
        f"{config['N']} steps in precision {config['precision']} take {least} to {most}, at 0.01 to 10 ms a step; "
        "--resume continues an interrupted run"
    )


def on_terminal() -> bool:
    """True if stdout is a terminal with more capabilities than plain lines."""
    return _terminal(sys.stdout) and os.environ.get("TERM") != "dumb"


def in_colour() -> bool:
    """True if stdout is such a terminal, and NO_COLOR is not set."""
    return on_terminal() and not os.environ.get("NO_COLOR")


COLOURS = {"good": "32", "middling": "33", "bad": "31"}
"""Parameters of the control sequences for the marks of cells: green, yellow and red."""


def screen_width() -> int:
    """Characters in a line of the terminal."""
    return max(40, shutil.get_terminal_size().columns)


def table_width() -> int:
    """Characters in a line of a table on stdout: those of the terminal; at most 100 elsewhere."""
    return screen_width() if _terminal(sys.stdout) else PIPE_WIDTH


def prose_width() -> int:
    """Characters in a line of prose on stdout: at most 100."""
    return min(PIPE_WIDTH, screen_width()) if _terminal(sys.stdout) else PIPE_WIDTH


def print_table(
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    title: str = "",
    numbers: bool | Collection[int] = True,
    keys: int = 1,
    marks: Mapping[str, str] = MappingProxyType({}),
) -> None:
    """Print a table, fitted to the width of the terminal and ruled on it; in a pipe at most 100 columns wide.

    ``numbers`` are the indices of the right-aligned columns: all but the first by default, none if False. The first
    ``keys`` columns name a row. ``marks`` are the looks of cells with certain texts, as in ``Cells``; they are coloured
    on a terminal.
    """
    right = range(1, len(header)) if numbers is True else numbers or ()
    table = [[printable(cell) for cell in row] for row in (header, *rows)]
    colours = {text: COLOURS[mark] for text, mark in marks.items()} if in_colour() else {}
    if title:
        emit_prose(title)
    for line in table_lines(table[0], table[1:], right, table_width(), rule=on_terminal(), keys=keys, colours=colours):
        print(line)


def print_cells(cells: Cells, title: str = "") -> None:
    """Print a table, and its caption below."""
    print_table(cells.header, cells.lines, title, cells.numbers, cells.keys, cells.marks)
    if cells.caption:
        emit_prose(cells.caption)


class ProgressDisplay:
    """Progress of several runs: a bar on a terminal, occasional lines in a log.

    Nothing is shown in the first half second. The first line is printed after 15 s; intervals grow with the run up to
    ten minutes. ``clock`` returns seconds.
    """

    def __init__(
        self, runs: int, quiet: bool, clock: Callable[[], float] = time.monotonic, unit: str = "steps"
    ) -> None:
        self._runs, self._quiet, self._clock, self._unit = runs, quiet, clock, unit
        self._note = ""
        self._index, self._name = 0, ""
        self._began = self._reported = clock()
        self._pace = Rate(self._unit)
        self._bar: Bar | None = None

    def begin(self, name: str) -> None:
        """Begin the next run."""
        self._index, self._name = self._index + 1, name
        self._began = self._reported = self._clock()
        self._pace = Rate(self._unit)

    def __call__(self, done: int, total: int, note: str = "") -> None:
        """Show that ``done`` of ``total`` steps of this run are done, and a ``note`` behind it."""
        if self._quiet:
            return
        self._note = f", {note}" if note else ""
        now = self._clock()
        self._pace.add(now, done)
        if now - self._began < PATIENCE:
            return
        try:
            self._show(now, done, total)
        except OSError:  # the terminal is gone; the run continues without it
            self._quiet = True

    def _show(self, now: float, done: int, total: int) -> None:
        name = printable(self._name)
        label = f"[{self._index}/{self._runs}] {name}" if self._runs > 1 else name
        if _terminal(sys.stderr) and os.environ.get("TERM") != "dumb":
            self._show_bar(label, now, done, total)
        elif now - self._reported > min(max(15.0, 0.2 * (now - self._began)), 600.0):
            self._reported = now
            pace = self._pace.text(now, done, total)
            print_message(
                f"{label}: {percent(done, total)}, {done} of {total} {self._unit}{', ' * bool(pace)}{pace}{self._note}"
            )

    def _show_bar(self, label: str, now: float, done: int, total: int) -> None:
        if self._bar is None:
            self._bar = Bar(plain_console(stderr=True), label)
        self._bar.show(label, done, total, self._pace.text(now, done, total) + self._note)

    def close(self) -> None:
        """Remove the display."""
        if self._bar is not None:
            with contextlib.suppress(OSError):
                self._bar.close()
            self._bar = None


GAP = 2
"""Spaces between columns."""
PROSE = (24, 20, 16, 12)
"""Smallest widths of prose that are tried in turn so that all columns fit into one block; the first for several."""


def table_lines(
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    right: Collection[int] = (),
    width: int | None = None,
    rule: bool = False,
    keys: int = 1,
    colours: Mapping[str, str] = MappingProxyType({}),
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
    colours : mapping of str to str
        Parameters of the control sequences around cells with these texts.
    """
    table = [header, *rows] if header else list(rows)
    if not table:
        return []
    count = len(table[0])
    natural = [max(len(row[i]) for row in table) for i in range(count)]
    layouts = [(natural, keys)]
    if width is not None:
        layouts = [_least(table, natural, right, width, keys, prose) for prose in PROSE]
    in_one_block = (layout for layout in layouts if len(_blocks(layout[0], width, layout[1])) == 1)
    least, keys = next(in_one_block, layouts[0])
    lines: list[str] = []
    for block in _blocks(least, width, keys):
        widths = {i: least[i] for i in block}
        _widen(widths, natural, width)
        lines += [""] if lines else []
        for number, row in enumerate(table):
            lines += _row_lines(row, widths, right, colours)
            if rule and header and number == 0:
                lines.append("─" * (sum(widths.values()) + GAP * (len(widths) - 1)))
    return lines


def _least(
    table: Sequence[Sequence[str]], natural: Sequence[int], right: Collection[int], width: int, keys: int, prose: int
) -> tuple[list[int], int]:
    """Smallest width of each column, and the number of columns that name a row, which is 1 if space is short.

    A column is at least as wide as its longest word, or as ``prose``; any column fits beside those that name a row.
    """
    words = [max((len(part) for row in table for part in row[i].split()), default=0) for i in range(len(natural))]
    for i in range(len(words)):
        if i in right:  # numbers stay whole, with their errors and units; only the header is wrapped
            words[i] = max(words[i], *(len(row[i]) for row in table[1:] or table))
    least = [word if i in right else max(word, min(natural[i], prose)) for i, word in enumerate(words)]
    longest = max(words[keys:], default=-GAP)
    if sum(least[:keys]) + GAP * keys > min(width * 2 // 3, width - longest) or keys >= len(words):
        keys = 1
        longest = min(max(words[1:], default=-GAP), width - GAP - min(words[0], (width - GAP) // 2))
        least[0] = min(least[0], width - GAP - longest)
    room = width - sum(least[:keys]) - GAP * keys
    return [*least[:keys], *(min(width, room) for width in least[keys:])], keys


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


def _row_lines(
    row: Sequence[str], widths: dict[int, int], right: Collection[int], colours: Mapping[str, str]
) -> list[str]:
    """Lines of one row of a block."""
    cells = {i: _cell_lines(row[i], width) for i, width in widths.items()}
    lines = []
    for number in range(max(map(len, cells.values()))):
        parts = []
        for i, width in widths.items():
            part = cells[i][number] if number < len(cells[i]) else ""
            padded = part.rjust(width) if i in right else part.ljust(width)
            colour = colours.get(row[i])
            parts.append(padded.replace(part, f"\x1b[{colour}m{part}\x1b[0m") if colour and part else padded)
        lines.append((" " * GAP).join(parts).rstrip())
    return lines


def _cell_lines(text: str, width: int) -> list[str]:
    """Lines of a cell, with the indentation of its text."""
    if len(text) <= width:
        return [text]
    indent = " " * (len(text) - len(text.lstrip()) + 2) if text[:1] == " " else ""
    return wrap(text, width, subsequent_indent=indent, break_on_hyphens=False)
