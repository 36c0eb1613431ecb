"""A Dask scheduler and workers in processes of their own on the loopback interface."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import topcli

SECONDS = 300.0
"""Limit of a wait for an event, which a fast machine sees after some seconds."""


def once(true: Callable[[], object], what: str) -> Callable[[], bool]:
    """A ``stop`` that turns true with ``true`` and stays so; fails with ``what`` if that takes too long."""
    deadline, seen = time.monotonic() + SECONDS, []

    def stop() -> bool:
        if not seen:
            assert time.monotonic() < deadline, what
            seen.extend([True] * bool(true()))
        return bool(seen)

    return stop


def wait_until(true: Callable[[], object], what: str) -> None:
    """Wait for an event; fails with ``what`` if that takes too long."""
    deadline = time.monotonic() + SECONDS
    while not true():
        assert time.monotonic() < deadline, what
        time.sleep(0.05)


class Processes:
    """Processes of a cluster; the address is known once the scheduler runs."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.address = folder, ""
        self.running: list[subprocess.Popen[bytes]] = []

    def _start(self, *arguments: str, path: Path | None = None) -> subprocess.Popen[bytes]:
        places = [str(path)] if path else []
        places.append(str(Path(topcli.__file__).parents[1]))
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(places)}
        with open(self.folder / "log", "ab") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", *arguments], stdout=log, stderr=log, env=environment, cwd=self.folder
            )
        self.running.append(process)
        return process

    def scheduler(self) -> None:
        file = self.folder / "scheduler.json"
        quiet = ["--no-dashboard", "--host", "127.0.0.1", "--port", "0"]
        self._start("distributed.cli.dask_scheduler", *quiet, "--scheduler-file", str(file))
        wait_until(lambda: file.exists() and file.stat().st_size, "the scheduler does not start")
        self.address = json.loads(file.read_text())["address"]

    def worker(self, path: Path | None = None) -> subprocess.Popen[bytes]:
        """A worker with one thread, on whose module path ``path`` comes first."""
        quiet = ["--no-dashboard", "--no-nanny", "--nthreads", "1", "--local-directory", str(self.folder)]
        return self._start("distributed.cli.dask_worker", self.address, *quiet, path=path)

    def end(self) -> None:
        for process in reversed(self.running):
            process.kill()
        for process in self.running:
            process.wait(SECONDS)


@contextmanager
def processes(folder: Path, workers: int = 2) -> Iterator[Processes]:
    """A scheduler and some workers, which have joined it."""
    from distributed import Client

    made = Processes(folder)
    try:
        made.scheduler()
        for _ in range(workers):
            made.worker()
        with Client(made.address, set_as_default=False) as client:
            wait_until(lambda: len(client.nthreads()) == workers, "the workers do not join")
        yield made
    finally:
        made.end()
