"""Commands in forks and processes of their own, and signals at the n-th operation on the disk: no moment is guessed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from conftest import Said
from faults import Disk

LIMIT = 120
"""Seconds after which a fork is ended; a fork takes one or two."""


def fork(work: Callable[[], int]) -> int:
    """Run ``work`` in a process of its own, which exits with the code that it returns; return the process number."""
    sys.stdout.flush()
    sys.stderr.flush()
    pid = os.fork()
    if not pid:
        try:
            os._exit(work())
        except BaseException as error:
            print(repr(error), file=sys.stderr, flush=True)
            os._exit(99)
    return pid


def in_fork(work: Callable[[], object]) -> int:
    """Exit code of ``work`` in a fork of this process, negative for a signal. Fails if it does not end in time."""

    def limited() -> int:
        signal.alarm(LIMIT)
        code = work()
        return code if isinstance(code, int) else 0

    code = os.waitstatus_to_exitcode(os.waitpid(fork(limited), 0)[1])
    assert code != -signal.SIGALRM, f"a fork did not end within {LIMIT} s"
    return code


def command_in_fork(argv: Sequence[str], cwd: Path, disk: Disk) -> Said:
    """Call the command in a fork with the faults of ``disk``. Fails if it does not end in time."""
    from topcli.__main__ import main

    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:

        def work() -> int:
            os.chdir(cwd)
            os.dup2(out.fileno(), 1)
            os.dup2(err.fileno(), 2)
            sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115 (for the whole process)
            sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
            sys.argv = ["topcli", *argv]
            disk.install()
            try:
                main()
            except SystemExit as leaving:
                sys.stdout.flush()
                sys.stderr.flush()
                return leaving.code if isinstance(leaving.code, int) else 0
            return 0

        code = in_fork(work)
        out.seek(0)
        err.seek(0)
        return Said(code, out.read().decode(), err.read().decode())


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
