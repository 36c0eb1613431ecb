"""Progress of commands and functions: a bar on a terminal or in a notebook, lines in a log."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from datetime import timedelta
from importlib.util import find_spec
from typing import Any

from topcli.errors import printable
from topcli.studies import Watch

_PATIENCE = 0.5
"""Seconds before anything is shown."""
FIRST_LINE, LAST_PAUSE = 15.0, 600.0
"""Seconds before the first line in a log, and the longest pause between two lines; pauses grow with the work."""


class Progress(Watch):
    """Progress of some work as a context manager, called with (done, total).

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

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


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
