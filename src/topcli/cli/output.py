"""Printing: data on stdout, messages on stderr, rules and progress bars only on a terminal.

All output passes ``printable``, because names and files may contain control characters. Tables are aligned columns;
one that is too wide is printed in blocks of columns.
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


def print_warnings(experiment: Experiment) -> None:
    """Print warnings about unusual parameters of the experiment's top and about its initial states."""
    from topcli.tops.bodies import moment_warnings  # imports numpy

    for line in (*moment_warnings(experiment.top), *experiment.state_warnings()):
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
        "an interrupted one begins anew"
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


def print_cells(cells: Cells, title: str = "", whole: bool = False) -> None:
    """Print a table, ruled and coloured on a terminal, with its caption below.

    It is printed in blocks of columns that fit the terminal, and in a pipe 100 characters; in one block if ``whole``.
    """
    table = [[printable(cell) for cell in line] for line in (cells.header, *cells.lines)]
    colours = {text: COLOURS[mark] for text, mark in cells.marks.items()} if in_colour() else {}
    if title:
        emit_prose(title)
    width = None if whole else table_width()
    for line in table_lines(table[0], table[1:], cells.right, width, on_terminal(), cells.keys, colours):
        print(line)
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


def table_lines(
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    right: Collection[int] = (),
    width: int | None = None,
    rule: bool = False,
    keys: int = 1,
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
    width : int or None
        Characters in a line; None for no limit.
    rule : bool
        Draw a line under the header.
    keys : int
        Leading columns that name a row, with which each block begins.
    colours : mapping of str to str
        Parameters of the control sequences around cells with these texts.
    """
    table = [header, *rows] if header else list(rows)
    if not table:
        return []
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines: list[str] = []
    for block in _blocks(widths, right, width, keys):
        lines += [""] if lines else []
        for number, row in enumerate(table):
            cells = (_cell(row[i], widths[i], i in right, colours.get(row[i])) for i in block)
            lines.append((" " * GAP).join(cells).rstrip())
            if rule and header and number == 0:
                length = sum(widths[i] + GAP for i in block) - GAP
                lines.append("─" * (length if width is None else min(length, width)))
    return lines


def _blocks(widths: Sequence[int], right: Collection[int], width: int | None, keys: int) -> list[list[int]]:
    """Columns of each block: those that name a row, and as many more as fit."""
    first = list(range(min(keys, len(widths))))
    blocks = [[*first]]
    for i in range(len(first), len(widths)):
        used = sum(widths[j] + GAP for j in blocks[-1]) + widths[i]
        text = i == len(widths) - 1 and i not in right
        if width is not None and used > width and not text and len(blocks[-1]) > len(first):
            blocks.append([*first])
        blocks[-1].append(i)
    return blocks


def _cell(text: str, width: int, right: bool, colour: str | None) -> str:
    padding = " " * (width - len(text))
    shown = f"\x1b[{colour}m{text}\x1b[0m" if colour and text else text
    return padding + shown if right else shown + padding
