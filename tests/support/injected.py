"""Signals and kills at the n-th operation on the disk, in a fork of this process: no test has to guess a moment."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any

from attack.command import Running, Said, fork, in_process, redirect

LIMIT = 120
"""Seconds after which a fork is ended; a fork takes one or two."""
OPERATIONS = ("pwrite", "ftruncate", "fsync", "rename", "replace", "unlink", "mkdir")
"""Functions of ``os`` that change the disk or wait for it."""


def path_of(what: object) -> str:
    """Path that the first argument of an operation names, or the path of the open file with this number."""
    if isinstance(what, int):
        return os.readlink(f"/proc/self/fd/{what}")
    return os.fsdecode(what) if isinstance(what, str | bytes | os.PathLike) else ""


class Operations:
    """Counts the operations of this process below ``folder``; calls ``act`` before the one with the number ``at``.

    ``names`` are those that count, ``only`` a part of the path of those. With ``torn`` the first half of what the
    operation would write is written before. ``install`` is for a process that ends afterwards.
    """

    def __init__(
        self,
        folder: Path,
        at: int = 0,
        act: Callable[[], object] = lambda: os.kill(os.getpid(), signal.SIGKILL),
        *,
        names: Collection[str] = OPERATIONS,
        only: str = "",
        torn: bool = False,
    ) -> None:
        self.count, self._folder, self._at, self._act = 0, os.path.realpath(folder), at, act
        self._names, self._only, self._torn = names, only, torn

    def install(self, patch: Callable[[Any, str, Any], None] = setattr) -> Operations:
        """Replace the functions of ``os`` by counting ones."""
        for name in self._names:
            patch(os, name, self._counting(name, getattr(os, name)))
        return self

    def _counting(self, name: str, real: Callable[..., Any]) -> Callable[..., Any]:
        def operation(*arguments: Any, **options: Any) -> Any:
            path = path_of(arguments[0])
            if self._folder in os.path.realpath(path) and self._only in path:
                self.count += 1
                if self.count == self._at:
                    if self._torn and name == "pwrite":
                        handle, content, offset = arguments
                        real(handle, content[: len(content) // 2], offset)
                    self._act()
            return real(*arguments, **options)

        return operation


def in_fork(work: Callable[[], object], limit: int = LIMIT) -> int:
    """Exit code of ``work`` in a fork of this process, negative for a signal. Fails if it does not end in time."""

    def limited() -> int:
        signal.alarm(limit)
        work()
        return 0

    code = os.waitstatus_to_exitcode(os.waitpid(fork(limited), 0)[1])
    assert code != -signal.SIGALRM, f"a fork did not end within {limit} s"
    return code


def command_in_fork(argv: Sequence[str], cwd: Path, operations: Operations) -> Said:
    """Call the command in a fork in which ``operations`` are counted. Fails if it does not end in time."""
    files = (tempfile.TemporaryFile(), tempfile.TemporaryFile(), tempfile.TemporaryFile())  # noqa: SIM115

    def work() -> int:
        os.chdir(cwd)
        redirect(files[0], files[1])
        operations.install()
        return in_process(argv)

    said = Running(tuple(argv), fork(work), files).finish(LIMIT)
    assert said.code is not None, f"topcli {' '.join(argv)} did not end within {LIMIT} s"
    assert not said.slow, f"topcli {' '.join(argv)} took more than {LIMIT} s"
    return said


def signal_to_self(number: signal.Signals) -> Callable[[], None]:
    """Send a signal to this process, as another process would; it arrives before the next operation."""
    return lambda: os.kill(os.getpid(), number)


def python_process(code: str, *arguments: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run Python code in a process of its own, with these variables of the environment changed."""
    command = [sys.executable, "-c", code, *arguments]
    env = {**os.environ, **environment}
    return subprocess.run(command, capture_output=True, text=True, env=env, cwd=cwd, check=False)


def topcli_process(
    *arguments: str, cwd: Path, path: Path | None = None, **options: Any
) -> subprocess.CompletedProcess[str]:
    """Run the command in a process of its own, with the packages in ``path`` installed."""
    environment = {**os.environ, **options.pop("env", {})}
    if path:
        environment["PYTHONPATH"] = os.pathsep.join([str(path), *filter(None, [os.environ.get("PYTHONPATH")])])
    command = [sys.executable, "-m", "topcli", *arguments]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options}
    return subprocess.run(command, text=True, cwd=cwd, env=environment, check=False, **streams)
