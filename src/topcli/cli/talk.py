"""How the command line speaks: data on stdout, talk on stderr, tables and progress only on a terminal."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from topcli.config.ensemble import EnsembleExperiment
    from topcli.config.models import Experiment


def print_json(command: str, content: dict[str, Any]) -> None:
    """Print the one JSON document of a command: ``schema_version``, ``command`` and its ``content``."""
    document = {"schema_version": 1, "command": command, **content}
    print(json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False))


def say(line: str) -> None:
    """Print a line of talk."""
    print(line, file=sys.stderr, flush=True)


def say_warnings(experiment: Experiment | EnsembleExperiment) -> None:
    """Say what is unusual about the parameters of the experiment's top."""
    for line in experiment.top.warnings():
        say(f"warning: {experiment.name}: {line}")


def on_terminal() -> bool:
    """Whether stdout is a terminal that can show more than plain lines."""
    return sys.stdout.isatty() and os.environ.get("TERM") != "dumb"


def print_table(header: Sequence[str], rows: Sequence[Sequence[str]], title: str = "", numbers: bool = True) -> None:
    """Print a table: ruled on a terminal, plain aligned columns elsewhere.

    The first column is left-aligned, and so are the others unless they are ``numbers``.
    """
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]
    fits = sum(widths) + 3 * len(widths) <= shutil.get_terminal_size().columns
    if on_terminal() and (fits or not numbers):  # a number broken over two lines misleads
        from rich import box
        from rich.console import Console
        from rich.table import Table

        table = Table(title=title or None, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
        for i, name in enumerate(header):
            table.add_column(name, justify="right" if i and numbers else "left", overflow="fold")
        for row in rows:
            table.add_row(*row)
        Console(highlight=False).print(table)
        return
    if title:
        print(title)
    for row in [header, *rows]:
        cells = [
            row[0].ljust(widths[0]),
            *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)),
        ]
        print("  ".join(cells).rstrip())


def spell_seconds(seconds: float) -> str:
    """A duration as 42 s, 3:05 min, 7:03:20 h or 12 d 3 h."""
    whole = round(seconds)
    minutes, hours, days = whole // 60, whole // 3600, whole // 86400
    if whole < 100:
        return f"{whole} s"
    if hours < 1:
        return f"{minutes}:{whole % 60:02d} min"
    return f"{hours}:{minutes % 60:02d}:{whole % 60:02d} h" if days < 2 else f"{days} d {hours % 24} h"


def _percent(done: int, total: int) -> str:
    """How much is done, rounded down: 100% is said of what is done."""
    return f"{1000 * done // total / 10:.1f}%"


class _Pace:
    """The rate over the last half minute or so, and the time left at that rate."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, int]] = deque(maxlen=32)

    def look(self, now: float, done: int) -> None:
        if not self._seen or now - self._seen[-1][0] >= 1.0:
            self._seen.append((now, done))

    def told(self, now: float, done: int, total: int) -> str:
        """``5.98e+07 steps/s, 3:05 min left``; empty when nothing can be said yet."""
        began, before = self._seen[0]
        if done <= before or now <= began:
            return ""
        rate = (done - before) / (now - began)
        return f"{rate:.3g} steps/s, {spell_seconds((total - done) / rate)} left"


class ProgressTeller:
    """One progress display for several runs: a bar on a terminal, a line now and then in a log.

    Nothing is shown for what is done within the first half second. Lines come after 15 s, and then, as the run gets
    longer, at least every ten minutes. ``clock`` gives seconds.
    """

    def __init__(self, runs: int, quiet: bool, clock: Callable[[], float] = time.monotonic) -> None:
        self._runs, self._quiet, self._clock = runs, quiet, clock
        self._index, self._name = 0, ""
        self._began = self._told = clock()
        self._pace = _Pace()
        self._bar: Any = None
        self._task: Any = None

    def begin(self, name: str) -> None:
        """The next run begins."""
        self._index, self._name = self._index + 1, name
        self._began = self._told = self._clock()
        self._pace = _Pace()

    def __call__(self, done: int, total: int) -> None:
        """Of this run, ``done`` of ``total`` steps are done."""
        if self._quiet:
            return
        now = self._clock()
        self._pace.look(now, done)
        if now - self._began < 0.5:
            return
        try:
            self._tell(now, done, total)
        except OSError:  # the terminal is gone; the run goes on without it
            self._quiet = True

    def _tell(self, now: float, done: int, total: int) -> None:
        label = f"[{self._index}/{self._runs}] {self._name}" if self._runs > 1 else self._name
        if sys.stderr.isatty() and os.environ.get("TERM") != "dumb":
            self._show_bar(label, now, done, total)
        elif now - self._told > min(max(15.0, 0.2 * (now - self._began)), 600.0):
            self._told = now
            pace = self._pace.told(now, done, total)
            say(f"{label}: {_percent(done, total)}, {done} of {total} steps{', ' * bool(pace)}{pace}")

    def _show_bar(self, label: str, now: float, done: int, total: int) -> None:
        if self._bar is None:
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn

            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.fields[percent]}  {task.fields[pace]}"),
                console=Console(stderr=True),
                transient=True,
            )
            self._bar.start()
            self._task = self._bar.add_task(label, percent="", pace="")
        pace = self._pace.told(now, done, total)
        percent = _percent(done, total)
        self._bar.update(self._task, description=label, completed=done, total=total, percent=percent, pace=pace)

    def close(self) -> None:
        """Take the display away."""
        if self._bar is not None:
            with contextlib.suppress(OSError):
                self._bar.stop()
            self._bar = None
