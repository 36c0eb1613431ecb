"""Set-ups of closed forms: stored on disk by their content, and computed in several processes.

The key consists of the initial state and the constants of the top, bit by bit, and of the text that identifies the
code of the set-up. The rules of storing are those of ``code_cache``.

    python -m topcli.engine.setups

is such a process, which answers each line of JSON with a line of JSON. A request ``{"class": [module, name], "y0",
"p"}`` has the numbers in hexadecimal. It is answered with ``{"setup"}``: the bytes in base64, or null if they cannot be
computed. A process of ``concurrent.futures`` would run a script that calls topcli a second time.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from base64 import b64decode, b64encode
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import ExitStack
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np

from topcli import __version__
from topcli.contracts import Array, Floats, Setup, check_stop
from topcli.engine.code_cache import CACHE_ENTRIES, store_setup, stored_setup
from topcli.errors import TopcliError

WORKER = "topcli.engine.setups"
_ROOT = str(Path(__file__).resolve().parents[2])
AHEAD = 4
"""Set-ups requested in advance for each process."""
POLL_SECONDS = 0.1
"""Time between two questions whether to go on waiting for another process."""
WORTH_WORKERS = 1.0
"""Seconds of computation from which on other processes are started; each takes a third of a second to start."""


@dataclass
class SetupTime:
    """``seconds`` spent on set-ups; ``cached`` is true if all came from memory or disk."""

    seconds: float = 0.0
    cached: bool = True


def _words(setup: Setup, code: str, y0: Array, p: Floats) -> str:
    numbers = [float(v).hex() for v in (*y0, *p)]
    return " ".join(("setup", __version__, type(setup).__module__, type(setup).__qualname__, code, *numbers))


def _used(setup: Setup, y0: Array, p: Floats, data: bytes | None) -> bool:
    """True if ``data`` could be used as the set-up."""
    if data is None:
        return False
    try:
        setup.use(y0, p, data)
    except ValueError:
        return False
    return True


def prepare(setup: Setup, y0: Array, p: Floats) -> SetupTime:
    """Load or compute the set-up of one initial state, and store it. Raises RunError."""
    begin, cached = time.perf_counter(), True
    if setup.needed(y0, p):
        words = _words(setup, setup.code(), y0, p)
        if not _used(setup, y0, p, stored_setup(words)):
            store_setup(words, setup.compute(y0, p))
            cached = False
    return SetupTime(time.perf_counter() - begin, cached)


def setup_estimate(setup: Setup, count: int) -> float:
    """Approximate seconds of the set-ups of ``count`` initial states, one after the other, if none is stored."""
    return setup.seconds * count


def setup_processes(setup: Setup, count: int, threads: int) -> int:
    """Number of other processes that compute the set-ups of ``count`` initial states; 0 if that takes short."""
    built_in = type(setup).__module__.startswith("topcli.") and bool(sys.executable)
    return min(threads, count) if built_in and setup_estimate(setup, count) > WORTH_WORKERS else 0


class _Worker:
    """A process that computes set-ups, one after the other."""

    def __init__(self, setup: Setup, p: Floats) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", WORKER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, (_ROOT, os.environ.get("PYTHONPATH"))))},
        )
        self._request: dict[str, Any] = {
            "class": [type(setup).__module__, type(setup).__qualname__],
            "p": [float(v).hex() for v in p],
        }

    def compute(self, y0: Array) -> bytes | None:
        """Return the set-up of an initial state; None if it has to be computed in this process."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            print(
                json.dumps({**self._request, "y0": [float(v).hex() for v in y0]}), file=self._process.stdin, flush=True
            )
            data = json.loads(self._process.stdout.readline())["setup"]
            return None if data is None else b64decode(data, validate=True)
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.communicate()


class Setups:
    """Set-ups of many initial states ``y0`` (m, d), of which ``threads`` are computed at the same time.

    Iterate over the numbers 0 to m - 1: each set-up is ready when its number appears. The time waited for them is added
    to ``time``. They are kept on disk if all of them fit there easily. A request to stop ends the iteration, by
    ``StopAsked``, and the processes.
    """

    def __init__(self, setup: Setup, y0: Array, p: Floats, threads: int, time: SetupTime | None = None) -> None:
        self._setup, self._y0, self._p = setup, y0, p
        self.time = time or SetupTime()
        self._code, self._keep = setup.code(), len(y0) <= CACHE_ENTRIES // 2
        self.processes = setup_processes(setup, len(y0), threads)
        self._idle: SimpleQueue[_Worker] = SimpleQueue()

    def __iter__(self) -> Iterator[int]:
        """Numbers of the initial states, in order."""
        count = len(self._y0)
        with ExitStack() as stack:
            pool = stack.enter_context(ThreadPoolExecutor(max(1, self.processes)))
            stack.callback(pool.shutdown, cancel_futures=True)
            for _ in range(self.processes):
                worker = _Worker(self._setup, self._p)
                stack.callback(worker.close)
                self._idle.put(worker)
            coming: deque[Future[tuple[bytes | None, bool]]] = deque()
            for i in range(count):
                begin = time.perf_counter()
                while len(coming) < AHEAD * self.processes and i + len(coming) < count:
                    coming.append(pool.submit(self._looked_up, i + len(coming)))
                while coming and not wait([coming[0]], POLL_SECONDS).done:
                    check_stop()
                data = coming.popleft().result() if coming else self._looked_up(i)
                self._use(i, *data)
                self.time.seconds += time.perf_counter() - begin
                yield i

    def _words(self, i: int) -> str:
        return _words(self._setup, self._code, self._y0[i], self._p)

    def _looked_up(self, i: int) -> tuple[bytes | None, bool]:
        """Set-up ``i`` from disk or another process, and True if it is stored."""
        if not self._setup.needed(self._y0[i], self._p):
            return None, True
        stored = stored_setup(self._words(i))
        if stored is not None:
            return stored, True
        if not self.processes:
            return None, False
        worker = self._idle.get()
        try:
            return worker.compute(self._y0[i]), False
        finally:
            self._idle.put(worker)

    def _use(self, i: int, data: bytes | None, stored: bool) -> None:
        """Make set-up ``i`` ready in this process. Raises RunError."""
        y0 = self._y0[i]
        if not self._setup.needed(y0, self._p):
            return
        if not _used(self._setup, y0, self._p, data):
            data, stored = self._setup.compute(y0, self._p), False
        self.time.cached &= stored
        if self._keep and not stored and data is not None:
            store_setup(self._words(i), data)


def answer(request: dict[str, Any]) -> dict[str, str | None]:
    """Answer one request."""
    module, name = request["class"]
    if not module.startswith("topcli."):
        raise ValueError(f"{module} is not a part of topcli")
    setup = getattr(import_module(module), name)()
    y0 = np.array([float.fromhex(text) for text in request["y0"]])
    try:
        data = setup.compute(y0, tuple(float.fromhex(text) for text in request["p"]))
    except (TopcliError, ArithmeticError):
        return {"setup": None}
    return {"setup": b64encode(data).decode()}


def main() -> None:
    """Answer the requests on stdin until it ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a library prints is no answer
    for line in sys.stdin:
        print(json.dumps(answer(json.loads(line))), file=answers, flush=True)


if __name__ == "__main__":
    main()
