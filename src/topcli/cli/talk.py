"""Printing: data on stdout, messages on stderr, rules and progress bars only on a terminal.

All output passes ``printable``, because names and files may contain control characters.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import sys
import time
from collections import deque
from collections.abc import Callable, Collection, Sequence
from textwrap import wrap
from typing import TYPE_CHECKING, Any, TextIO

from topcli.cli.tables import table_lines
from topcli.errors import TopcliError, clipped, printable

if TYPE_CHECKING:
    from topcli.config.ensemble import EnsembleExperiment
    from topcli.config.models import Experiment


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


def say(line: str) -> None:
    """Print a message on stderr, wrapped at words on a terminal."""
    for part in _wrapped(clipped(printable(line), 990), sys.stderr):
        print(part, file=sys.stderr)
    sys.stderr.flush()


def say_text(text: str) -> None:
    """Print a text of several lines on stderr without wrapping."""
    for line in text.splitlines():
        print(printable(line), file=sys.stderr)


def say_error(error: TopcliError) -> None:
    """Print the lines of an error, the first one after the prefix ``error:``."""
    first, *others = error.lines or ("",)
    say(f"error: {first}")
    for line in others:
        say(line)


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


def say_warnings(experiment: Experiment | EnsembleExperiment) -> None:
    """Print warnings about unusual parameters of the experiment's top."""
    for line in experiment.top.warnings():
        say(f"warning: {experiment.name}: {line}")


def on_terminal() -> bool:
    """True if stdout is a terminal with more capabilities than plain lines."""
    return _terminal(sys.stdout) and os.environ.get("TERM") != "dumb"


def screen_width() -> int:
    """Characters in a line of the terminal."""
    return max(40, shutil.get_terminal_size().columns)


def prose_width() -> int:
    """Characters in a line of prose on stdout: at most 100."""
    return min(100, screen_width()) if _terminal(sys.stdout) else 100


def print_table(
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    title: str = "",
    numbers: bool | Collection[int] = True,
    keys: int = 1,
) -> None:
    """Print a table: ruled and fitted to its width on a terminal, plain aligned columns in whole lines elsewhere.

    ``numbers`` are the indices of the right-aligned columns: all but the first by default, none if False. The first
    ``keys`` columns name a row.
    """
    right = range(1, len(header)) if numbers is True else numbers or ()
    table = [[printable(cell) for cell in row] for row in (header, *rows)]
    width = screen_width() if _terminal(sys.stdout) else None
    if title:
        emit_prose(title)
    for line in table_lines(table[0], table[1:], right, width, rule=on_terminal(), keys=keys):
        print(line)


def spell_seconds(seconds: float) -> str:
    """Text of a duration: 42 s, 3:05 min, 7:03:20 h or 12 d 3 h."""
    whole = round(seconds)
    minutes, hours, days = whole // 60, whole // 3600, whole // 86400
    if whole < 100:
        return f"{whole} s"
    if hours < 1:
        return f"{minutes}:{whole % 60:02d} min"
    return f"{hours}:{minutes % 60:02d}:{whole % 60:02d} h" if days < 2 else f"{days} d {hours % 24} h"


def _percent(done: int, total: int) -> str:
    """Percentage done, rounded down so that 100% means completed."""
    return f"{1000 * done // total / 10:.1f}%"


class _Pace:
    """Rate over the last half minute, and the time left at that rate."""

    def __init__(self, unit: str) -> None:
        self._unit = unit
        self._seen: deque[tuple[float, int]] = deque(maxlen=32)

    def add(self, now: float, done: int) -> None:
        if not self._seen or now - self._seen[-1][0] >= 1.0:
            self._seen.append((now, done))

    def text(self, now: float, done: int, total: int) -> str:
        """``5.98e+07 steps/s, 3:05 min left``, or an empty text if the rate is not known yet."""
        began, before = self._seen[0]
        if done <= before or now <= began:
            return ""
        rate = (done - before) / (now - began)
        return f"{rate:.3g} {self._unit}/s, {spell_seconds((total - done) / rate)} left"


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
        self._pace = _Pace(self._unit)
        self._bar: Any = None
        self._task: Any = None

    def begin(self, name: str) -> None:
        """Begin the next run."""
        self._index, self._name = self._index + 1, name
        self._began = self._reported = self._clock()
        self._pace = _Pace(self._unit)

    def __call__(self, done: int, total: int, note: str = "") -> None:
        """Show that ``done`` of ``total`` steps of this run are done, and a ``note`` behind it."""
        if self._quiet:
            return
        self._note = f", {note}" if note else ""
        now = self._clock()
        self._pace.add(now, done)
        if now - self._began < 0.5:
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
            say(
                f"{label}: {_percent(done, total)}, {done} of {total} {self._unit}{', ' * bool(pace)}{pace}{self._note}"
            )

    def _show_bar(self, label: str, now: float, done: int, total: int) -> None:
        if self._bar is None:
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn

            self._bar = Progress(
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                TextColumn("{task.fields[percent]}  {task.fields[pace]}", markup=False),
                console=Console(stderr=True, markup=False, emoji=False, highlight=False),
                transient=True,
            )
            self._bar.start()
            self._task = self._bar.add_task(label, percent="", pace="")
        pace = self._pace.text(now, done, total) + self._note
        percent = _percent(done, total)
        self._bar.update(self._task, description=label, completed=done, total=total, percent=percent, pace=pace)

    def close(self) -> None:
        """Remove the display."""
        if self._bar is not None:
            with contextlib.suppress(OSError):
                self._bar.stop()
            self._bar = None
