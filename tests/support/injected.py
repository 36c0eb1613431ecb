"""Commands in forks and processes of their own, and signals at the n-th operation on the disk: no moment is guessed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from attack.command import Said, call, fork
from attack.faults import Disk

LIMIT = 120
"""Seconds after which a fork is ended; a fork takes one or two."""


def in_fork(work: Callable[[], object]) -> int:
    """Exit code of ``work`` in a fork of this process, negative for a signal. Fails if it does not end in time."""

    def limited() -> int:
        signal.alarm(LIMIT)
        work()
        return 0

    code = os.waitstatus_to_exitcode(os.waitpid(fork(limited), 0)[1])
    assert code != -signal.SIGALRM, f"a fork did not end within {LIMIT} s"
    return code


def command_in_fork(argv: Sequence[str], cwd: Path, disk: Disk) -> Said:
    """Call the command in a fork with the faults of ``disk``. Fails if it does not end in time."""
    said = call(argv, cwd, [cwd], limit=LIMIT, prepare=disk.install)
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
