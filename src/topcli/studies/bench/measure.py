"""Measure competitors on one problem: errors once, then times in interleaved repetitions.

Errors are Euclidean norms of the difference of states from the Taylor reference in double-double arithmetic at the
common times. Times are CPU seconds of the working process, which depend least on the load of the machine.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from topcli.analysis.pareto import Point
from topcli.contracts import Array, Invariant
from topcli.errors import UsageError
from topcli.schemes.user_code import users_error
from topcli.studies.bench.competitors import Competitor, NoResultError
from topcli.studies.bench.ladder import Rung
from topcli.studies.bench.scenes import Problem

ROUND_OFF = 1e-6
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
    end_error: float
    drift: dict[str, float]
    first: float
    compile_seconds: float
    samples: list[list[float]] = field(default_factory=list)
    setup_seconds: float = 0.0

    def best(self) -> list[float]:
        """Repetitions in the process with the smallest median; the first call if there are none."""
        return min(self.samples, key=lambda one: float(np.median(one))) if self.samples else [self.first]

    def point(self) -> Point:
        """Point of the rung in the plane of error and seconds."""
        return Point(self.error, float(np.median(self.best())), self.rung.value)


@dataclass
class Measurements:
    """Measurements of one competitor: its rungs, those that ``failed`` and why, and why its ladder ``ended``."""

    competitor: Competitor
    rungs: list[Measured] = field(default_factory=list)
    failed: list[tuple[float, str]] = field(default_factory=list)
    ended: str = "the ladder's end"
    broken: str = ""
    """Reason why this competitor stopped; empty if it did not."""

    def points(self) -> list[Point]:
        """Points of the rungs in the plane of error and seconds."""
        return [rung.point() for rung in self.rungs]


def deviations(invariants: Sequence[Invariant], states: Array) -> dict[str, float]:
    """Return the largest deviation of each invariant from its first value, relative to the size of its terms."""
    found = {}
    with np.errstate(all="ignore"):
        for invariant in invariants:
            values, scale = invariant.value(states), float(invariant.scale(states[:1])[0])
            found[invariant.name] = float(np.abs(values - values[0]).max()) / (scale or 1.0)
    return found


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
    return best < ROUND_OFF and min(rung.error for rung in rungs[-2:]) > 0.5 * best


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
        except UsageError as error:  # a step that cannot be compiled fails at every rung
            measured.ended = measured.broken = str(error)
            break
        except Exception as error:
            found = users_error(error)
            if found is None:
                raise
            measured.ended = measured.broken = str(found)
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
                "end_error": rung.end_error,
                "drift": max(rung.drift.values(), default=0.0),
                "invariants": rung.drift,
                "seconds": float(np.median(spent)),
                "fastest": float(spent.min()),
                "quartiles": [float(q) for q in np.quantile(spent, [0.25, 0.75])],
                "repetitions": len(spent) if rung.samples else 0,
                "processes": [float(np.median(one)) / duration for one in rung.samples],
            }
        )
    return rows
