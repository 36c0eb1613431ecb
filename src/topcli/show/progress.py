"""Progress bars, on a terminal or in a notebook."""

from __future__ import annotations

import os
import sys
import time
from collections import deque
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

from topcli.errors import printable
from topcli.studies import Watch

PATIENCE = 0.5
"""Seconds before a bar appears."""


def spell_seconds(seconds: float) -> str:
    """Text of a duration: 42 s, 3:05 min, 7:03:20 h or 12 d 3 h."""
    whole = round(seconds)
    minutes, hours, days = whole // 60, whole // 3600, whole // 86400
    if whole < 100:
        return f"{whole} s"
    if hours < 1:
        return f"{minutes}:{whole % 60:02d} min"
    return f"{hours}:{minutes % 60:02d}:{whole % 60:02d} h" if days < 2 else f"{days} d {hours % 24} h"


def percent(done: int, total: int) -> str:
    """Percentage done, rounded down so that 100% means completed."""
    return f"{1000 * done // total / 10:.1f}%"


class Rate:
    """Rate over the last half minute, and the time left at that rate."""

    def __init__(self, unit: str) -> None:
        self._unit = unit
        self._seen: deque[tuple[float, int]] = deque(maxlen=32)

    def add(self, now: float, done: int) -> None:
        """Note that so much is done at the time ``now``."""
        if not self._seen or now - self._seen[-1][0] >= 1.0:
            self._seen.append((now, done))

    def text(self, now: float, done: int, total: int) -> str:
        """``5.98e+07 steps/s, 3:05 min left``, or an empty text if the rate is not known yet."""
        began, before = self._seen[0]
        if done <= before or now <= began:
            return ""
        rate = (done - before) / (now - began)
        return f"{rate:.3g} {self._unit}/s, {spell_seconds((total - done) / rate)} left"


class Bar:
    """A bar on a console of rich, shown from the first call of ``show`` until ``close``."""

    def __init__(self, console: Any, label: str) -> None:
        from rich.progress import BarColumn, Progress, TextColumn

        self._shown = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TextColumn("{task.fields[percent]}  {task.fields[pace]}", markup=False),
            console=console,
            transient=True,
        )
        self._shown.start()
        self._task: Any = self._shown.add_task(label, percent="", pace="")

    def show(self, label: str, done: int, total: int, pace: str) -> None:
        """Show that ``done`` of ``total`` are done."""
        share = percent(done, total)
        self._shown.update(self._task, description=label, completed=done, total=total, percent=share, pace=pace)

    def close(self) -> None:
        """Remove the bar."""
        self._shown.stop()

    def get_renderable(self) -> Any:
        """The display of rich at the moment."""
        return self._shown.get_renderable()


def plain_console(**options: Any) -> Any:
    """Console of rich that takes all text as it is."""
    from rich.console import Console

    return Console(markup=False, emoji=False, highlight=False, **options)


def progress_console() -> Any:
    """Console for the progress of a function: a notebook with widgets, or a terminal; None for any other output."""
    if "IPython" in sys.modules:
        console = plain_console()
        if console.is_jupyter:
            return console if find_spec("ipywidgets") else None
    if sys.stderr is not None and sys.stderr.isatty() and os.environ.get("TERM") != "dumb":
        return plain_console(stderr=True)
    return None


class Progress(Watch):
    """Progress of a function as a context manager, called with (done, total); silent if no one would see it."""

    def __init__(
        self, name: str, shown: bool = True, unit: str = "steps", clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._name, self._clock = printable(name), clock
        self._console = progress_console() if shown else None
        self._pace = Rate(unit)
        self._began = clock()
        self._bar: Bar | None = None

    def __enter__(self) -> Progress:
        return self

    def begin(self, name: str, *experiments: Any, unit: str = "steps") -> None:
        """Take the name of what is run."""
        self._name = printable(name)

    def __call__(self, done: int, total: int, note: str = "") -> None:
        """Show that ``done`` of ``total`` are done, and a ``note`` behind it."""
        if self._console is None:
            return
        now = self._clock()
        self._pace.add(now, done)
        if now - self._began < PATIENCE:
            return
        if self._bar is None:
            self._bar = Bar(self._console, self._name)
        self._bar.show(self._name, done, total, self._pace.text(now, done, total) + (f", {note}" if note else ""))

    def __exit__(self, *exception: object) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None
