"""One peer in a process of its own, which answers requests; the contract of a peer's file.

A peer's file has ``variants(problem)``, each with a ladder of settings and a call for each setting. Requests and
answers are pickled: ``(method of Worker, *arguments)`` is answered with its result, or with a ``NoResultError``. Output
that the peer prints goes to stderr.
"""

from __future__ import annotations

import os
import pickle
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import IO, Any

import numpy as np

from topcli.config.load import load_experiment
from topcli.contracts import Array, Top
from topcli.studies.bench.peers import NoResultError

Call = Callable[[], Array]
"""Integrate once, warm, and return the states at the problem's times, shape (m, d). Raises NoResultError."""


@dataclass(frozen=True)
class PeerProblem:
    """The motion of ``top`` from ``y0`` at time zero, to be recorded at ``times`` (m,), the first of them zero."""

    top: Top
    y0: Array
    times: Array


@dataclass(frozen=True)
class Variant:
    """One way to use a peer; ``prepare(value)`` compiles everything for one value of ``parameter``."""

    name: str
    parameter: str
    values: Sequence[float]
    prepare: Callable[[float], Call]


def decades(first: int, last: int, step: int = 1) -> list[float]:
    """Return 10^first, 10^(first - step), ... down to 10^last."""
    return [float(f"1e{exponent}") for exponent in range(first, last - 1, -step)]


def checked(states: Array, problem: PeerProblem) -> Array:
    """Return ``states`` if they are complete and finite; raise NoResultError otherwise."""
    expected = (len(problem.times), len(problem.y0))
    if states.shape != expected:
        raise NoResultError(f"gave states of shape {states.shape}; expected {expected}")
    if not np.isfinite(states).all():
        raise NoResultError("gave states that are not finite")
    return states


class Worker:
    """The variants of one peer for one problem, and the prepared calls."""

    def start(self, module: str, config: dict[str, Any], span: float, intervals: int) -> list[tuple[Any, ...]]:
        """Load a peer for a problem; return the name, the parameter and the values of each variant."""
        experiment = load_experiment(config)
        times = np.arange(intervals + 1) * (span / intervals)
        variants = import_module(module).variants(PeerProblem(experiment.top, np.array(experiment.y0), times))
        self._variants: dict[str, Variant] = {variant.name: variant for variant in variants}
        self._calls: dict[tuple[str, float], Call] = {}
        return [(variant.name, variant.parameter, list(variant.values)) for variant in variants]

    def run(self, name: str, value: float) -> tuple[Array, float, float]:
        """Prepare and call once; return the states, and the CPU seconds of the call and of its preparation."""
        started = time.process_time()
        call = self._variants[name].prepare(value)
        compiled = time.process_time()
        states = call()
        ended = time.process_time()
        self._calls[name, value] = call
        return np.ascontiguousarray(states, dtype=np.float64), ended - compiled, compiled - started

    def seconds(self, name: str, value: float, calls: int) -> float:
        """Call again, warm; return the mean CPU seconds of a call."""
        call = self._calls[name, value]
        started = time.process_time()
        for _ in range(calls):
            call()
        return (time.process_time() - started) / calls


def serve(requests: IO[bytes], answers: IO[bytes]) -> None:
    """Answer all ``requests``."""
    worker = Worker()
    while True:
        try:
            method, *arguments = pickle.load(requests)
        except EOFError:
            return
        try:
            answer = getattr(worker, method)(*arguments)
        except NoResultError as failure:
            answer = failure
        except Exception as error:  # any exception of a peer is its result
            answer = NoResultError(f"{type(error).__name__}: {error}".splitlines()[0])
        pickle.dump(answer, answers)
        answers.flush()


def main() -> None:
    """Answer on the original stdout; all other output goes to stderr."""
    with os.fdopen(os.dup(1), "wb") as answers:
        os.dup2(2, 1)
        serve(sys.stdin.buffer, answers)
    os._exit(0)  # some peers take long to shut down
