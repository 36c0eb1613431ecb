"""Measurements of all participants on one problem: errors once, then times in interleaved repetitions.

Competitors are our schemes in this process, and peers in one or several processes of their own. Errors are Euclidean
norms of the difference of states from the Taylor reference in double-double arithmetic at the common times. Times are
CPU seconds of the working process, which depend least on the load of the machine.
"""

from __future__ import annotations

import hashlib
import math
import os
import pickle
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, NamedTuple, Protocol

import numpy as np
from pydantic import BaseModel

from topcli.analysis.reference import reference_states
from topcli.contracts import Array, Invariant, Sampler, Scheme
from topcli.engine.loops import Loop, loop_of
from topcli.errors import UsageError
from topcli.runs.identity import code_digest
from topcli.runs.report import finite
from topcli.schemes.plugins import FILES, users_error
from topcli.store.provenance import environment, installed
from topcli.studies.bench.contest import LineUp, Problem, Rung, ladder, tolerance_option
from topcli.studies.bench.peers import NoResultError, Peer, missing
from topcli.studies.bench.result import Point, decade_rows, front


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
        steps = rung.steps * self._problem.intervals
        if taken != steps:
            reason = f"fails at step {-taken}" if taken < 0 else f"returns after step {taken}"
            raise NoResultError(f"{reason} of {steps}")
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
            [sys.executable, "-P", "-c", "from topcli.studies.bench.peers import main; main()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            env={**os.environ, **_ONE_THREAD},
        )
        plugins = [Path(file.path).absolute() for file in FILES.values()]
        self.send("start", peer.variants, problem.experiment.resolved(), problem.duration, problem.intervals, plugins)

    def send(self, method: str, *arguments: Any) -> None:
        """Send a request, a method of ``Worker``, without waiting for the answer."""
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):  # reading the answer reports it
            pickle.dump((method, *arguments), self._process.stdin)
            self._process.stdin.flush()

    def answer(self) -> Any:
        """Return the answer to the last request. Raises NoResultError if it failed or the process died."""
        assert self._process.stdout is not None
        try:
            answer = pickle.load(self._process.stdout)
        except (EOFError, pickle.UnpicklingError):
            code = self._process.wait()
            self._log.seek(0)
            lines = self._log.read().decode(errors="replace").strip().splitlines()
            raise NoResultError(f"its process died with code {code}" + (f": {lines[-1]}" if lines else "")) from None
        if isinstance(answer, NoResultError):
            raise answer
        return answer

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.communicate()
        self._log.close()


@dataclass
class PeerCompetitor:
    """One variant of a peer, in all of its processes; the states are those of the first."""

    name: str
    parameter: str
    values: Sequence[float]
    processes: Sequence[PeerProcess]
    patience: float = 1.0
    kind = "peer"
    order: int | None = None

    def rungs(self) -> Iterator[Rung]:
        """Yield the values that the peer's file gives."""
        return (Rung(value) for value in self.values)

    def run(self, rung: Rung) -> FirstCall:
        """Prepare and call once in every process, in parallel."""
        for process in self.processes:
            process.send("run", self.name, rung.value)
        answers, failure = [], None
        for process in self.processes:  # every answer is read, also after a failure
            try:
                answers.append(process.answer())
            except NoResultError as failed:
                failure = failed
        if failure is not None:
            raise failure
        states, seconds, compile_seconds = zip(*answers, strict=True)
        return FirstCall(states[0], min(seconds), min(compile_seconds))

    def seconds(self, rung: Rung, calls: int) -> list[float]:
        """Call again, warm, in one process after the other, and return the CPU seconds of each."""
        spent = []
        for process in self.processes:
            process.send("seconds", self.name, rung.value, calls)
            spent.append(float(process.answer()))
        return spent


MANY = 200_000
"""Number of states over which the time of a closed form is measured, so that the cost of a call does not count."""


class ClosedForm(NamedTuple):
    """States of a closed form at a problem's times, and the CPU seconds for each of ``MANY`` states.

    ``setup_seconds`` is the time of the first state, which sets up the closed form.
    """

    states: Array
    seconds_per_state: float
    setup_seconds: float


def closed_form(scheme: Scheme, problem: Problem) -> ClosedForm:
    """Evaluate a closed form at the problem's times; time it at many, and its set-up apart."""
    method = scheme.build(problem.top, scheme.options())
    assert isinstance(method, Sampler)
    y0, n, p = np.array(problem.experiment.y0), np.arange(problem.intervals + 1), problem.top.constants()
    started = time.process_time()
    method.states(y0, problem.interval, n[:1], p)
    setup_seconds = time.process_time() - started
    states = method.states(y0, problem.interval, n, p)
    started = time.process_time()
    method.states(y0, problem.duration / MANY, np.arange(MANY), p)
    return ClosedForm(states, (time.process_time() - started) / MANY, setup_seconds)


SATURATED_BELOW = 1e-6
"""Below this error a ladder ends when two finer rungs in a row gain less than a factor of two."""
SLICE = 0.002
"""Shortest repetition in seconds; a quicker call is repeated within it."""
ALLOWANCE = 0.2
"""Seconds for all repetitions of one rung, unless three take longer."""
LONG = 0.25
"""Calls longer than this, in seconds, are timed once."""
USELESS = 1.0
"""Settings with a larger error than this are timed once, because their speed is of no interest."""


@dataclass(frozen=True)
class Effort:
    """Amount of measurement: CPU seconds allowed for a call, and repetitions of it."""

    budget: float = 0.06
    repetitions: int = 7


@dataclass
class Measured:
    """One rung of one competitor: its errors, the deviation of each invariant, and the seconds of each process."""

    rung: Rung
    error: float
    final_error: float
    drift: dict[str, float]
    first: float
    compile_seconds: float
    samples: list[list[float]] = field(default_factory=list)
    setup_seconds: float = 0.0

    def best(self) -> list[float]:
        """Repetitions in the process with the smallest median; the first call if there are none."""
        return min(self.samples, key=np.median) if self.samples else [self.first]

    def point(self) -> Point:
        """Point of the rung in the plane of error and seconds."""
        return Point(self.error, float(np.median(self.best())), self.rung.value)


@dataclass
class Measurements:
    """Measurements of one competitor: its rungs, those that ``failed`` and why, and why its ladder ``ended``."""

    competitor: Competitor
    rungs: list[Measured] = field(default_factory=list)
    failed: list[tuple[float, str]] = field(default_factory=list)
    ended: str = "the finest setting is reached"
    broken: str = ""
    """Reason why this competitor stopped; empty if it did not."""

    def points(self) -> list[Point]:
        """Points of the rungs in the plane of error and seconds."""
        return [rung.point() for rung in self.rungs]


def deviations(invariants: Sequence[Invariant], states: Array) -> dict[str, float]:
    """Return the largest deviation of each invariant from its first value, relative to the size of its terms."""
    largest = {}
    with np.errstate(all="ignore"):
        for invariant in invariants:
            values, scale = invariant.value(states), float(invariant.scale(states[:1])[0])
            largest[invariant.name] = float(np.abs(values - values[0]).max()) / (scale or 1.0)
    return largest


def _estimate(rung: Rung, before: Sequence[Measured]) -> float:
    """Estimate the seconds of the next rung: in proportion to its steps, or growing as the last ones did."""
    if not before:
        return 0.0
    last = before[-1]
    if rung.options or rung.steps == last.rung.steps:
        growth = last.first / before[-2].first if len(before) > 1 and before[-2].first > 0.0 else 1.0
        return last.first * min(max(growth, 1.0), 10.0)
    return last.first * rung.steps / last.rung.steps


def _saturated(rungs: Sequence[Measured]) -> bool:
    """True if the last two rungs gained nothing; never for tolerances, which cost little and are all tried."""
    if len(rungs) < 3 or rungs[-1].rung.steps == rungs[-2].rung.steps:
        return False
    best = min(rung.error for rung in rungs[:-2])
    return best < SATURATED_BELOW and min(rung.error for rung in rungs[-2:]) > 0.5 * best


def explore(competitor: Competitor, problem: Problem, reference: Array, effort: Effort) -> Measurements:
    """Climb the ladder of ``competitor`` once, for the errors and a first estimate of the times.

    The ladder ends when the next rung would exceed the budget, or when round-off has been reached.
    """
    measured = Measurements(competitor)
    allowed = effort.budget * competitor.patience
    invariants = problem.top.invariants()
    for rung in competitor.rungs():
        setting = f"{competitor.parameter} = {rung.value:.2g}"
        estimate = _estimate(rung, measured.rungs)
        if estimate > allowed:
            measured.ended = f"{setting} would take about {estimate:.2g} s a run; {allowed:.2g} s are allowed"
            break
        try:
            first = competitor.run(rung)
        except NoResultError as failure:
            measured.failed.append((rung.value, str(failure)))
            continue
        except Exception as error:  # such as a step that cannot be compiled, which fails at every rung
            known = error if isinstance(error, UsageError) else users_error(error)
            if known is None:
                raise
            measured.ended = measured.broken = str(known)
            break
        with np.errstate(over="ignore", invalid="ignore"):
            errors = np.linalg.norm(first.states - reference, axis=1)
        measured.rungs.append(
            Measured(
                rung,
                float(errors.max()),
                float(errors[-1]),
                deviations(invariants, first.states),
                first.seconds,
                first.compile_seconds,
                setup_seconds=first.setup_seconds,
            )
        )
        if _saturated(measured.rungs):
            measured.ended = f"round-off: steps finer than {setting} gain nothing"
            break
    return measured


def _repetitions(rung: Measured, most: int) -> int:
    """Number of repetitions of the call of a rung."""
    if rung.first > LONG or not rung.error <= USELESS:
        return 0
    return min(most, max(3, math.floor(ALLOWANCE / max(rung.first, SLICE))))


def time_all(measurements: Sequence[Measurements], effort: Effort, on_progress: Callable[[int, int], None]) -> None:
    """Time every rung of all ``measurements``, repetition by repetition, each beginning with another competitor.

    A competitor that fails keeps its measurements so far, and ``broken`` gives the reason. ``on_progress`` is called
    with the repetitions done and their total.
    """
    plan = [
        (measured, rung, _repetitions(rung, effort.repetitions)) for measured in measurements for rung in measured.rungs
    ]
    rounds = max((count for *_, count in plan), default=0)
    total, done = sum(count for *_, count in plan), 0
    for repetition in range(rounds):
        start = repetition * len(plan) // rounds
        for measured, rung, count in plan[start:] + plan[:start]:
            if repetition >= count or measured.broken:
                continue
            try:
                spent = measured.competitor.seconds(rung.rung, max(1, math.ceil(SLICE / max(rung.first, 1e-7))))
            except NoResultError as failure:
                measured.broken = str(failure)
                continue
            if not rung.samples:
                rung.samples = [[] for _ in spent]
            for samples, seconds in zip(rung.samples, spent, strict=True):
                samples.append(seconds)
            done += 1
            on_progress(done, total)


def as_rows(measured: Measurements, duration: float) -> list[dict[str, Any]]:
    """Return the rungs as plain data; times are CPU seconds per unit of simulated time."""
    rows = []
    for rung in measured.rungs:
        spent = np.array(rung.best()) / duration
        rows.append(
            {
                "value": rung.rung.value,
                "error": rung.error,
                "final_error": rung.final_error,
                "drift": max(rung.drift.values(), default=0.0),
                "invariants": rung.drift,
                "seconds": float(np.median(spent)),
                "fastest": float(spent.min()),
                "quartiles": [float(q) for q in np.quantile(spent, [0.25, 0.75])],
                "repetitions": len(spent) if rung.samples else 0,
                "processes": [float(np.median(process)) / duration for process in rung.samples],
            }
        )
    return rows


def code_of(line_up: LineUp, problem: Problem) -> str:
    """Digest of the code of all schemes that take part."""
    codes = [code_digest(type(problem.top), scheme) for scheme in line_up.schemes]
    return hashlib.sha256(" ".join(codes).encode()).hexdigest()


def _peer_competitors(
    peers: Sequence[Peer], problem: Problem, processes: int, stack: ExitStack
) -> tuple[list[PeerCompetitor], list[tuple[str, str]], list[tuple[str, str]]]:
    """Start the peers; return their variants, and the peers not installed and failed, with the reasons."""
    absent = [(peer.name, reason) for peer in peers if (reason := missing(peer))]
    started: list[tuple[Peer, list[PeerProcess]]] = []
    for peer in peers:
        if not missing(peer):
            started.append((peer, []))
            for _ in range(processes if peer.varies else 1):
                started[-1][1].append(process := PeerProcess(peer, problem))
                stack.callback(process.close)
    competitors, failed = [], []
    for peer, group in started:
        try:
            answers = [process.answer() for process in group]
        except NoResultError as failure:
            failed.append((peer.name, str(failure)))
            continue
        competitors += [
            PeerCompetitor(name, parameter, values, group, peer.patience) for name, parameter, values in answers[0]
        ]
    return competitors, absent, failed


def _row(measured: Measurements, duration: float) -> dict[str, Any]:
    competitor = measured.competitor
    return {
        "name": competitor.name,
        "kind": competitor.kind,
        "order": competitor.order,
        "parameter": competitor.parameter,
        "compile_seconds": sum(rung.compile_seconds for rung in measured.rungs),
        "setup_seconds": min((rung.setup_seconds for rung in measured.rungs), default=0.0),
        "ended": measured.ended,
        "failed": [{"value": value, "reason": reason} for value, reason in measured.failed],
        "broken": measured.broken or None,
        "points": as_rows(measured, duration),
    }


def _closed_forms(schemes: Sequence[Scheme], problem: Problem, reference: Array) -> list[dict[str, Any]]:
    """Return rows for the closed forms, whose cost depends on the number of evaluations, not on the duration."""
    rows = []
    for scheme in schemes:
        states, seconds_per_state, setup = closed_form(scheme, problem)
        errors = np.linalg.norm(states - reference, axis=1)
        rows.append(
            {
                "name": scheme.name,
                "title": scheme.title,
                "error": float(errors.max()),
                "final_error": float(errors[-1]),
                "invariants": deviations(problem.top.invariants(), states),
                "seconds_per_state": seconds_per_state,
                "states": MANY,
                "setup_seconds": setup,
            }
        )
    return rows


def bench(
    problem: Problem,
    line_up: LineUp,
    peers: Sequence[Peer],
    effort: Effort,
    *,
    processes: int = 5,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
    on_message: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Measure the schemes of ``line_up`` and the ``peers`` on ``problem``; return the result as plain data.

    A peer whose speed varies from process to process is measured in this many ``processes``. ``on_message`` receives
    one line for each peer that is skipped or fails. Raises RunError if the reference cannot follow the motion.
    """
    reference = reference_states(problem.top, problem.experiment.y0, problem.times)
    with ExitStack() as stack:
        others, absent, failed = _peer_competitors(peers, problem, processes, stack)
        for name, reason in absent:
            on_message(f"{problem.name}: peer {name} is skipped: {reason}")
        for name, reason in failed:
            on_message(f"error: {problem.name}: peer {name} failed: {reason}")
        taking_part: list[Competitor] = [*(SchemeCompetitor(scheme, problem) for scheme in line_up.schemes), *others]
        measurements = []
        for i, competitor in enumerate(taking_part):
            measurements.append(explore(competitor, problem, reference, effort))
            on_progress(i + 1, 2 * len(taking_part))
        time_all(measurements, effort, lambda done, total: on_progress(total + done, 2 * total))
    rows = [_row(measured, problem.duration) for measured in measurements]
    for row in rows:
        if row["broken"]:
            on_message(f"error: {problem.name}: {row['name']} failed: {row['broken']}")
        elif not row["points"]:
            reason = row["failed"][0]["reason"] if row["failed"] else row["ended"]
            on_message(f"{problem.name}: {row['name']} gave no result: {reason}")
    return finite(
        {
            "name": problem.name,
            "title": problem.title,
            "top": problem.top.title,
            "config": problem.experiment.resolved(),
            "duration": problem.duration,
            "intervals": problem.intervals,
            "goal": problem.goal,
            "reference": "Taylor series in double-double arithmetic",
            "effort": {"budget": effort.budget, "repetitions": effort.repetitions, "processes": processes},
            "competitors": rows,
            "closed_forms": _closed_forms(line_up.closed_forms, problem, reference),
            "left_out": [{"name": name, "reason": reason} for name, reason in line_up.left_out],
            "skipped_peers": [{"name": name, "reason": reason} for name, reason in absent],
            "failed_peers": [{"name": name, "reason": reason} for name, reason in failed],
            "front": front(rows),
            "decades": decade_rows(rows),
            "environment": {
                **environment(),
                "peers": {package: installed(package) for peer in peers for package in peer.requires},
            },
        }
    )
