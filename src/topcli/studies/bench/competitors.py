"""The competitors: our schemes in this process, and the peers in one or several processes of their own."""

from __future__ import annotations

import base64
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import IO, Any, NamedTuple, Protocol

import numpy as np
from pydantic import BaseModel

from topcli.contracts import Array, Sampler, Scheme
from topcli.engine.driver import Loop, loop_of
from topcli.studies.bench.ladder import Rung, ladder, tolerance_option
from topcli.studies.bench.peers import Peer
from topcli.studies.bench.scenes import Problem


class NoResultError(Exception):
    """One setting of a competitor gave no trajectory; the message is the reason."""


@dataclass(frozen=True)
class FirstCall:
    """Result of the first call of a setting: ``states`` (m, d) at the problem's times, and its CPU seconds.

    ``setup_seconds`` are those of what a scheme computes once for an initial state, before the steps.
    """

    states: Array
    seconds: float
    compile_seconds: float
    setup_seconds: float = 0.0


class Competitor(Protocol):
    """One way to solve a problem, over a ladder of settings; ``kind`` is ``topcli`` or ``peer``."""

    name: str
    kind: str
    parameter: str
    order: int | None
    patience: float

    def rungs(self) -> Iterator[Rung]:
        """Yield the settings, coarse to fine."""
        ...

    def run(self, rung: Rung) -> FirstCall:
        """Prepare and call once. Raises NoResultError."""
        ...

    def seconds(self, rung: Rung, calls: int) -> list[float]:
        """Return the mean CPU seconds of a warm call over ``calls`` calls, for each process. Raises NoResultError."""
        ...


class SchemeCompetitor:
    """A scheme in the engine's own loop, driven over the whole run."""

    kind = "topcli"
    patience = 1.0

    def __init__(self, scheme: Scheme, problem: Problem) -> None:
        self.name = scheme.name
        self.parameter = tolerance_option(scheme) or "h"
        self._scheme, self._problem = scheme, problem
        self._y0 = np.array(problem.experiment.y0)
        self._p = np.array(problem.top.constants(), dtype=np.float64)
        self.order: int | None = scheme.order_for(self._defaults())
        self._out = np.empty(problem.intervals * len(self._y0))
        self._loops: dict[Rung, tuple[Loop, Array, Array]] = {}
        self._fixed: Loop | None = None

    def rungs(self) -> Iterator[Rung]:
        """Yield the rungs of ``ladder``."""
        return ladder(self._scheme, self._y0, self._problem.interval)

    def _loop(self, rung: Rung) -> Loop:
        """Return the loop for a rung; rungs without options share one."""
        if rung.options or self._fixed is None:
            options = self._scheme.options.model_validate({**self._defaults().model_dump(), **dict(rung.options)})
            method = self._scheme.build(self._problem.top, options)
            loop = loop_of(method, len(self._y0), len(self._p))
            if rung.options:
                return loop
            self._fixed = loop
        return self._fixed

    def _defaults(self) -> BaseModel:
        """Options of the problem's config if this is its scheme, else the defaults of the scheme."""
        experiment = self._problem.experiment
        return experiment.options if experiment.scheme.name == self._scheme.name else self._scheme.options()

    def _drive(self, rung: Rung) -> int:
        loop, work, start = self._loops[rung]
        np.copyto(work, start)
        steps = rung.steps * self._problem.intervals
        return loop.drive(work, self._out, self._p, self._h(rung), steps, rung.steps, rung.steps)

    def _h(self, rung: Rung) -> float:
        return self._problem.interval / rung.steps

    def run(self, rung: Rung) -> FirstCall:
        """Compile or load, enter the working state, and drive once.

        The entered initial state is kept: a timed call starts from a copy of it, as the peers' calls do.
        """
        known = self._fixed is not None and not rung.options
        loop = self._loop(rung)
        start = np.zeros(loop.width)
        begun = time.process_time()
        loop.enter(self._y0, start, self._p, self._h(rung))
        setup_seconds = time.process_time() - begun
        self._loops[rung] = loop, start.copy(), start
        started = time.process_time()
        taken = self._drive(rung)
        seconds = time.process_time() - started
        if taken < 0:
            raise NoResultError(f"fails at step {-taken} of {rung.steps * self._problem.intervals}")
        states = np.vstack([self._y0, self._out.reshape(self._problem.intervals, len(self._y0))])
        return FirstCall(states, seconds, 0.0 if known else loop.seconds, setup_seconds)

    def seconds(self, rung: Rung, calls: int) -> list[float]:
        """Drive again, warm, and return the mean CPU seconds of a call."""
        started = time.process_time()
        for _ in range(calls):
            self._drive(rung)
        return [(time.process_time() - started) / calls]


_ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false",
    "JAX_PLATFORMS": "cpu",
}


class PeerProcess:
    """A running worker that answers each request once."""

    def __init__(self, peer: Peer, problem: Problem) -> None:
        self._log: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 (closed with the process)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "topcli.studies.bench.peers.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            env={**os.environ, **_ONE_THREAD},
        )
        times = [problem.duration, problem.intervals]
        self.send({"peer": peer.name, "config": problem.experiment.resolved(), "times": times})

    def send(self, request: dict[str, Any]) -> None:
        """Send a request without waiting for the answer."""
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):  # reading the answer reports it
            print(json.dumps(request), file=self._process.stdin, flush=True)

    def answer(self) -> dict[str, Any]:
        """Return the answer to the last request. Raises NoResultError if it failed or the process died."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            code = self._process.wait()
            self._log.seek(0)
            lines = self._log.read().decode(errors="replace").strip().splitlines()
            raise NoResultError(f"its process died with code {code}" + (f": {lines[-1]}" if lines else ""))
        answer = json.loads(line)
        if "failed" in answer:
            raise NoResultError(answer["failed"])
        return answer

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.communicate()
        self._log.close()


class PeerCompetitor:
    """One variant of a peer, in all of its processes; the states are those of the first."""

    kind = "peer"
    order: int | None = None

    def __init__(self, peer: Peer, variant: dict[str, Any], processes: list[PeerProcess], problem: Problem) -> None:
        self.name, self.parameter = variant["name"], variant["parameter"]
        self.patience = peer.patience
        self._values, self._processes, self._problem = variant["values"], processes, problem

    def rungs(self) -> Iterator[Rung]:
        """Yield the values that the peer's file gives."""
        return (Rung(value) for value in self._values)

    def _ask(self, verb: str, *arguments: Any) -> None:
        for process in self._processes:
            process.send({verb: [self.name, *arguments]})

    def run(self, rung: Rung) -> FirstCall:
        """Prepare and call once in every process, in parallel."""
        self._ask("run", rung.value)
        answers, failure = [], None
        for process in self._processes:  # every answer is read, also after a failure
            try:
                answers.append(process.answer())
            except NoResultError as failed:
                failure = failed
        if failure is not None:
            raise failure
        states = np.frombuffer(base64.b64decode(answers[0]["states"])).reshape(self._problem.intervals + 1, -1)
        seconds = min(answer["seconds"] for answer in answers)
        return FirstCall(states, seconds, min(answer["compile_seconds"] for answer in answers))

    def seconds(self, rung: Rung, calls: int) -> list[float]:
        """Call again, warm, in one process after the other, and return the CPU seconds of each."""
        spent = []
        for process in self._processes:
            process.send({"time": [self.name, rung.value, calls]})
            spent.append(float(process.answer()["seconds"]))
        return spent


MANY = 200_000
"""Number of states over which the time of a closed form is measured, so that the cost of a call does not count."""


class ClosedForm(NamedTuple):
    """States of a closed form at a problem's times, and the CPU seconds for each of ``MANY`` states.

    ``setup_seconds`` is the time to compute the set-up, whether it is stored or not; None if there is none.
    """

    states: Array
    seconds_per_state: float
    setup_seconds: float | None


def closed_form(scheme: Scheme, problem: Problem) -> ClosedForm:
    """Evaluate a closed form at the problem's times; time it at many, and its set-up apart."""
    method = scheme.build(problem.top, scheme.options())
    assert isinstance(method, Sampler)
    y0, n, p = np.array(problem.experiment.y0), np.arange(problem.intervals + 1), problem.top.constants()
    states = method.states(y0, problem.interval, n, p)
    started = time.process_time()
    method.states(y0, problem.duration / MANY, np.arange(MANY), p)
    seconds = (time.process_time() - started) / MANY
    if method.setup is None:
        return ClosedForm(states, seconds, None)
    started = time.process_time()
    method.setup.compute(y0, p)
    return ClosedForm(states, seconds, time.process_time() - started)
