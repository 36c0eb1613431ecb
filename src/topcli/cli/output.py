"""Output of the commands: data on stdout, messages on stderr, and the progress of commands and functions.

A table is printed in aligned columns; one that is too wide, in blocks of columns. Colours and bars are only for a
terminal.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import sys
import time
from collections.abc import Callable, Mapping
from datetime import timedelta
from importlib.util import find_spec
from textwrap import fill
from typing import Any, NamedTuple, TextIO

from topcli.errors import ExitCode, TopcliError, printable
from topcli.studies import Watch
from topcli.table import Cells

WIDTH = 100
"""Characters in a line of a table or text that does not go to a terminal."""
_COLOURS = {"good": "32", "middling": "33", "bad": "31"}
"""Parameters of the control sequences for the marks of cells: green, yellow and red."""
GAP = "  "
"""Space between columns."""
_PATIENCE = 0.5
"""Seconds before any progress is shown."""
FIRST_LINE, LAST_PAUSE = 15.0, 600.0
"""Seconds before the first line in a log, and the longest pause between two lines; pauses grow with the work."""


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


class Progress(Watch):
    """Progress of some work, called with (done, total).

    Parameters
    ----------
    visible : bool, optional
        False to show nothing.
    log : callable, optional
        Called with lines on the progress where no bar can be drawn; by default, nothing is shown there.
    clock : callable, optional
        Time in seconds.
    """

    def __init__(
        self,
        visible: bool = True,
        log: Callable[[str], None] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._visible, self._log, self._clock = visible, log, clock
        self._bar: Any = None
        self.begin("")

    def begin(self, name: str, *experiments: Any, unit: str = "steps") -> None:
        """Begin work of this name."""
        self.close()
        self._name, self._unit = printable(name), unit
        self._began = self._reported = self._clock()

    def __call__(self, done: int, total: int, note: str = "") -> None:
        """Show that ``done`` of ``total`` are done, and a ``note`` behind it."""
        now = self._clock()
        if not self._visible or now - self._began < _PATIENCE:
            return
        try:
            self._show(now, done, total, f", {note}" if note else "")
        except OSError:  # the terminal is gone; the work continues without it
            self._visible = False

    def _show(self, now: float, done: int, total: int, note: str) -> None:
        if self._bar is None:
            self._bar = bar(self._clock)
            self._bar.add_task(self._name, total=total, rate="")
            self._bar.start()
        (task,) = self._bar.tasks
        self._bar.update(task.id, completed=done, total=total)
        share = f"{1000 * done // total / 10:.1f}%"  # rounded down: 100% means completed
        rate = ""
        if task.speed:
            left = timedelta(seconds=round(min((total - done) / task.speed, 1e12)))  # its largest value is 1e14 s
            rate = f"{task.speed:.3g} {self._unit}/s, {left} left"
        self._bar.update(task.id, rate=f"{share}  {rate}{note}")
        pause = min(max(FIRST_LINE, 0.2 * (now - self._began)), LAST_PAUSE)
        if self._log is not None and self._bar.disable and now - self._reported > pause:
            self._reported = now
            self._log(f"{self._name}: {share}, {done} of {total} {self._unit}{', ' * bool(rate)}{rate}{note}")

    def close(self) -> None:
        """Remove the bar."""
        if self._bar is not None:
            with contextlib.suppress(OSError):
                self._bar.stop()
            self._bar = None


def bar(clock: Callable[[], float]) -> Any:
    """Bar of rich in a notebook with widgets or on a terminal; anywhere else, one that only measures the rate."""
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn
    from rich.progress import Progress as Bar

    console = Console(stderr=True, markup=False, emoji=False, highlight=False)
    drawn = find_spec("ipywidgets") if console.is_jupyter else console.is_terminal and not console.is_dumb_terminal
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.fields[rate]}", markup=False),
    )
    return Bar(*columns, console=console, transient=True, disable=not drawn, get_time=clock)


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
    if cells.title:
        emit(wrapped(cells.title, sys.stdout))
    for line in table_lines(cells, width, terminal, terminal and not os.environ.get("NO_COLOR")):
        print(line)
    if cells.caption:
        emit(wrapped(cells.caption, sys.stdout))


def table_lines(cells: Cells, width: int = WIDTH, rule: bool = False, coloured: bool = False) -> list[str]:
    """Lines of a table in blocks of columns that fit ``width``, each of which begins with the columns that name a row.

    A last column of text may be wider. A ``rule`` is a line under the header; marked cells may be ``coloured``.
    """
    table = [[printable(cell) for cell in line] for line in (cells.header, *cells.lines) if line]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    colours = {text: _COLOURS[mark] for text, mark in cells.marks.items()} if coloured else {}

    # blocks: the columns that name a row, and as many more as fit
    first = list(range(min(cells.keys, len(widths))))
    blocks = [[*first]]
    for i in range(len(first), len(widths)):
        used = sum(widths[j] + len(GAP) for j in blocks[-1]) + widths[i]
        text = i == len(widths) - 1 and i not in cells.right
        if used > width and not text and len(blocks[-1]) > len(first):
            blocks.append([*first])
        blocks[-1].append(i)

    # padding counts letters, not the control sequences of colours
    def padded(text: str, i: int) -> str:
        padding, colour = " " * (widths[i] - len(text)), colours.get(text)
        text = f"\x1b[{colour}m{text}\x1b[0m" if colour and text else text
        return padding + text if i in cells.right else text + padding

    lines: list[str] = []
    for block in blocks if table else ():
        lines += [""] if lines else []
        rows = [GAP.join(padded(row[i], i) for i in block).rstrip() for row in table]
        if rule and cells.header:
            rows.insert(1, "─" * min(sum(widths[i] for i in block) + len(GAP) * (len(block) - 1), width))
        lines += rows
    return lines
