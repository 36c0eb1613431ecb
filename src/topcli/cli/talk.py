"""How the command line speaks: data on stdout, talk on stderr, tables and progress only on a terminal."""

from __future__ import annotations

import json
import os
import shutil
import sys
import time
from collections.abc import Sequence
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


class ProgressTeller:
    """One progress display for several runs: a bar on a terminal, a line now and then in a log.

    Nothing is shown for what is done within the first half second.
    """

    def __init__(self, runs: int, quiet: bool) -> None:
        self._runs, self._quiet = runs, quiet
        self._index, self._name = 0, ""
        self._began = self._told = time.monotonic()
        self._bar: Any = None
        self._task: Any = None

    def begin(self, name: str) -> None:
        """The next run begins."""
        self._index, self._name = self._index + 1, name
        self._began = self._told = time.monotonic()

    def __call__(self, done: int, total: int) -> None:
        """Of this run, ``done`` of ``total`` steps are done."""
        now = time.monotonic()
        if self._quiet or now - self._began < 0.5:
            return
        label = f"[{self._index}/{self._runs}] {self._name}" if self._runs > 1 else self._name
        if sys.stderr.isatty() and os.environ.get("TERM") != "dumb":
            self._show_bar(label, done, total)
        elif now - self._told > 15.0:
            self._told = now
            left = (now - self._began) * (total - done) / max(done, 1)
            say(f"{label}: {100.0 * done / total:.0f}%, {done} of {total} steps, about {left:.0f} s left")

    def _show_bar(self, label: str, done: int, total: int) -> None:
        if self._bar is None:
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                TaskProgressColumn(),
                TimeRemainingColumn(),
                console=Console(stderr=True),
                transient=True,
            )
            self._bar.start()
            self._task = self._bar.add_task(label)
        self._bar.update(self._task, description=label, completed=done, total=total)

    def close(self) -> None:
        """Take the display away."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None
