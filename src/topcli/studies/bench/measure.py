"""Measure competitors on one problem: errors once, then times in interleaved repetitions.

Errors are Euclidean norms of the difference of states from the Taylor reference in double-double arithmetic at the
common times. Seconds are those of the CPU, in the process that works, so that a busy machine disturbs them least.
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
from topcli.studies.bench.competitors import Competitor, NoResultError
from topcli.studies.bench.ladder import Rung
from topcli.studies.bench.scenes import Problem

ROUND_OFF = 1e-6
"""Below this error a ladder ends where two finer rungs in turn gain less than a factor of two."""
SLICE = 0.002
"""Seconds that one repetition takes at least: what is quicker is called several times."""
ALLOWANCE = 0.2
"""Seconds that the repetitions of one rung take together, unless three take longer."""
LONG = 0.25
"""What takes longer than this in seconds is timed once."""
USELESS = 1.0
"""A setting with a larger error than this is timed once too: it says nothing about speed."""


@dataclass(frozen=True)
class Effort:
    """How much to measure: CPU seconds a call may take, and repetitions of it."""

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

    def best(self) -> list[float]:
        """The repetitions in the process with the smallest median; the first call where there are none."""
        return min(self.samples, key=lambda one: float(np.median(one))) if self.samples else [self.first]

    def point(self) -> Point:
        """Its place in the plane of error and seconds."""
        return Point(self.error, float(np.median(self.best())), self.rung.value)


@dataclass
class Standing:
    """What was measured of one competitor: its rungs, those that ``failed`` and why, and where its ladder ``ended``."""

    competitor: Competitor
    rungs: list[Measured] = field(default_factory=list)
    failed: list[tuple[float, str]] = field(default_factory=list)
    ended: str = "the ladder's end"
    broken: str = ""
    """Why nothing more could be had of it; empty where nothing happened."""

    def points(self) -> list[Point]:
        """Its rungs in the plane of error and seconds."""
        return [rung.point() for rung in self.rungs]


def deviations(invariants: Sequence[Invariant], states: Array) -> dict[str, float]:
    """How far each invariant gets from its first value, relative to the size of the terms that make it up."""
    found = {}
    with np.errstate(all="ignore"):
        for invariant in invariants:
            values, scale = invariant.value(states), float(invariant.scale(states[:1])[0])
            found[invariant.name] = float(np.abs(values - values[0]).max()) / (scale or 1.0)
    return found


def _estimate(rung: Rung, before: Sequence[Measured]) -> float:
    """Seconds that the next rung will take: in proportion to its steps, or growing as the last ones did."""
    if not before:
        return 0.0
    last = before[-1]
    if rung.options or rung.steps == last.rung.steps:
        growth = last.first / before[-2].first if len(before) > 1 and before[-2].first > 0.0 else 1.0
        return last.first * min(max(growth, 1.0), 10.0)
    return last.first * rung.steps / last.rung.steps


def _saturated(rungs: Sequence[Measured]) -> bool:
    """Whether the last two rungs gained nothing any more. Finer tolerances cost little: those are all tried."""
    if len(rungs) < 3 or rungs[-1].rung.steps == rungs[-2].rung.steps:
        return False
    best = min(rung.error for rung in rungs[:-2])
    return best < ROUND_OFF and min(rung.error for rung in rungs[-2:]) > 0.5 * best


def explore(competitor: Competitor, problem: Problem, reference: Array, effort: Effort) -> Standing:
    """Climb the ladder of ``competitor`` once: the errors, and a first idea of the time.

    It ends where the next rung would take longer than the budget, or where round-off has been reached.
    """
    standing = Standing(competitor)
    allowed = effort.budget * competitor.patience
    invariants = problem.top.invariants()
    for rung in competitor.rungs():
        told = f"{competitor.parameter} = {rung.value:.2g}"
        estimate = _estimate(rung, standing.rungs)
        if estimate > allowed:
            standing.ended = f"{told} would take some {estimate:.2g} s a run, and {allowed:.2g} s are allowed"
            break
        try:
            first = competitor.run(rung)
        except NoResultError as failure:
            standing.failed.append((rung.value, str(failure)))
            continue
        except UsageError as error:  # a step that cannot be compiled: no other rung can be
            standing.ended = standing.broken = str(error)
            break
        with np.errstate(over="ignore", invalid="ignore"):
            errors = np.linalg.norm(first.states - reference, axis=1)
        standing.rungs.append(
            Measured(
                rung,
                float(errors.max()),
                float(errors[-1]),
                deviations(invariants, first.states),
                first.seconds,
                first.compile_seconds,
            )
        )
        if _saturated(standing.rungs):
            standing.ended = f"round-off: finer than {told} gains nothing"
            break
    return standing


def _repetitions(rung: Measured, most: int) -> int:
    """How often the call of a rung is repeated."""
    if rung.first > LONG or not rung.error <= USELESS:
        return 0
    return min(most, max(3, math.floor(ALLOWANCE / max(rung.first, SLICE))))


def time_all(standings: Sequence[Standing], effort: Effort, told: Callable[[int, int], None]) -> None:
    """Time every rung of all ``standings``, repetition by repetition, each beginning with another competitor.

    A competitor that fails now keeps what it has, and why is noted in ``broken``. ``told`` hears (done, of how many).
    """
    plan = [
        (standing, rung, _repetitions(rung, effort.repetitions)) for standing in standings for rung in standing.rungs
    ]
    rounds = max((count for *_, count in plan), default=0)
    total, done = sum(count for *_, count in plan), 0
    for repetition in range(rounds):
        start = repetition * len(plan) // rounds
        for standing, rung, count in plan[start:] + plan[:start]:
            if repetition >= count or standing.broken:
                continue
            try:
                spent = standing.competitor.seconds(rung.rung, max(1, math.ceil(SLICE / max(rung.first, 1e-7))))
            except NoResultError as failure:
                standing.broken = str(failure)
                continue
            if not rung.samples:
                rung.samples = [[] for _ in spent]
            for samples, seconds in zip(rung.samples, spent, strict=True):
                samples.append(seconds)
            done += 1
            told(done, total)


def as_rows(standing: Standing, duration: float) -> list[dict[str, Any]]:
    """The rungs as plain data; times are CPU seconds per unit of simulated time."""
    rows = []
    for rung in standing.rungs:
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
