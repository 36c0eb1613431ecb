"""The command in a process of its own, forked from one that has imported its packages: a start takes 30 ms, not 500."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from multiprocessing import get_context
from pathlib import Path

SERVER = get_context("forkserver")
SERVER.set_forkserver_preload(["topcli.cli.app", "pandas", "pyarrow.parquet", "matplotlib.pyplot", "numba", "scipy"])


def _enter(arguments: Sequence[str], folder: str, environment: Mapping[str, str], output: str) -> None:
    from topcli.__main__ import entry

    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    written = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for number in (1, 2):
        os.dup2(written, number)
    sys.stdout, sys.stderr = (os.fdopen(n, "w", 1, encoding="utf-8", closefd=False) for n in (1, 2))
    sys.argv = ["topcli", *arguments]
    entry()


def topcli(arguments: Sequence[str], folder: Path, environment: Mapping[str, str], output: Path) -> int:
    """Exit code of ``topcli`` in a ``folder``; what it prints is in the file ``output``."""
    process = SERVER.Process(target=_enter, args=([*arguments], str(folder), dict(environment), str(output)))
    process.start()
    process.join()
    assert process.exitcode is not None
    return process.exitcode
