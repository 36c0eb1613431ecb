"""Both sides of every threshold of the stress checks: motions made up just inside and just outside of each."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from topcli.analysis.series_report import invariant_report
from topcli.analysis.trajectory import Trajectory
from topcli.contracts import Array, Invariant, Outcome
from topcli.engine.endings import Endings
from topcli.engine.plan import Plan
from topcli.engine.rows import Rows
from topcli.studies.stress.checks import (
    Check,
    Trial,
    claim_violated,
    does_not_drift,
    flips,
    keeps_order,
    returns,
    stays_bounded,
    swings_at,
)

EPS = 2.0**-52


@dataclass
class MadeUp:
    """A trial whose runs are made up: ``moves(n, h)`` gives the states (m, d) at the steps n."""

    moves: Any
    exact: Any = lambda t: np.stack([np.cos(t), np.sin(t), 0.0 * t], axis=1)
    N: int = 100
    h: float = 0.1
    order: int | None = 2
    self_adjoint: bool = True
    claims: tuple[Invariant, ...] = ()
    y0: tuple[float, ...] = (1.0, 0.0, 0.0)
    top: Any = field(default_factory=lambda: SimpleNamespace(components=("a", "b", "c"), swing="a", energy="energy"))
    plain: bool = False
    claim_ulps: float = 50.0
    closed: Any = None

    @property
    def scheme(self) -> Any:
        return SimpleNamespace(order=self.order, adaptive=False, self_adjoint=self.self_adjoint)

    @property
    def experiment(self) -> Any:
        return SimpleNamespace(h=self.h)

    def run(self, h: float | None = None, N: int | None = None, every: int = 1, y0: Any = None) -> Trajectory:
        h, N = h or self.h, N or self.N
        n = np.arange(0, N + 1, every, dtype=np.int64)
        states, endings = self.moves(n, h), Endings.of_none(1, h)
        endings.put(0, Outcome.COMPLETED, N, ())
        rows = Rows(Plan(self.top, None, states[:1], h, N, every, invariants=self.claims), n, states)
        return Trajectory(rows, "made up", endings, states[-1], n[-1], {})

    def reference(self, times: Array) -> Array:
        return self.exact(times)

    def claimed(self, h: float) -> list[Invariant]:
        return list(self.claims)

    def closed_form(self, n: Array) -> Array:
        return self.closed(n, self.h)


def off_by(error: Callable[[float], float], **changes: Any) -> MadeUp:
    """The reference motion with ``error(h)`` in its first component from the first step on."""
    trial = MadeUp(None, **changes)
    trial.moves = lambda n, h: trial.exact(n * h) + np.where(n > 0, error(h), 0.0)[:, None] * [1.0, 0.0, 0.0]
    return trial


def turning(rate: float, size: float = 1.0, **changes: Any) -> MadeUp:
    """A swing of this size, which is due at pi, later by the factor 1 / rate."""
    return MadeUp(lambda n, h: size * np.cos(np.outer(n * h * rate, [1.0, 0.0, 0.0])), h=0.001, **changes)


def late_swing(late: float) -> MadeUp:
    return turning(1.0 / (1.0 + late), N=6000)


def late_second_swing(late: float) -> MadeUp:
    return turning(1.0 / (1.0 + late), N=16_000)


def late_flip(late: float) -> MadeUp:
    """omega2 = cos t changes its sign at pi/2; the scheme's later by this part."""

    def closed(n: Array, h: float) -> Array:
        return np.stack([np.ones(len(n)), np.cos(n * h), np.zeros(len(n))], axis=1)

    return MadeUp(lambda n, h: closed(n, h / (1.0 + late)), N=2000, h=0.001, closed=closed)


def once_as_large(largest: float) -> MadeUp:
    """The motion's size is that of its largest component over ten time scales: 1 here."""
    return MadeUp(lambda n, h: np.where(n == 30, largest, 1.0)[:, None] * np.array([1.0, 0.2, 0.1]))


def not_quite_back(missed: float, self_adjoint: bool = True) -> MadeUp:
    """Missed by this many ulp of the state, which is 2, times sqrt(N) + h N^1.5."""
    N, h, size = 400, 0.1, 2.0
    off = missed * EPS * (math.sqrt(N) + h * N**1.5) * size

    def moves(n: Array, h: float) -> Array:
        return np.tile([size, off if h < 0.0 else 0.0, 0.0], (len(n), 1))

    return MadeUp(moves, N=N, h=h, y0=(size, 0.0, 0.0), self_adjoint=self_adjoint)


def series(terms: float) -> Invariant:
    return Invariant("x", "x", "x", "a series", lambda y: y[:, 0], lambda y: np.full(len(y), terms))


def moved_in_ulp(slope: float) -> MadeUp:
    """A claim that moves over the run by this many ulp times sqrt(N), along a line almost without noise."""
    N = 8192
    moved = slope * math.sqrt(N) * EPS * 32.0

    def moves(n: Array, h: float) -> Array:
        ripple = 1e-3 * moved * np.random.default_rng(1).normal(size=len(n))
        return np.repeat((moved * n / N + ripple)[:, None], 3, axis=1)

    return MadeUp(moves, N=N, claims=(series(32.0),))


def moved_in_errors(errors: float) -> MadeUp:
    """Noise that is constant within 64 steps, and a line with a slope of this many of its standard errors.

    Over the run the slope is 4 sqrt(N) ulp, where the other condition holds and the deviation is still round-off.
    """
    N, h, size = 8192, 0.1, 32.0
    noise = np.repeat(np.random.default_rng(4).normal(size=N // 64 + 1), 64)[: N + 1]
    states = np.repeat(noise[:, None], 3, axis=1)
    ((plain,), _) = invariant_report(MadeUp(None).top, [series(size)], np.arange(N + 1), h, states)
    assert plain.drift is not None
    assert plain.drift_error is not None
    assert plain.model == "linear trend"
    scale = 4.0 * math.sqrt(N) * EPS * size / (5.0 * plain.drift_error * N * h)
    values = scale * (noise + (errors * plain.drift_error - plain.drift) * h * np.arange(N + 1))
    values -= values[0]
    assert np.abs(values).max() < 20.0 * math.sqrt(N) * EPS * size
    return MadeUp(lambda n, h: np.repeat(values[n][:, None], 3, axis=1), N=N, h=h, claims=(series(size),))


THRESHOLDS: dict[str, tuple[Check, Callable[[float], MadeUp], float, str, str]] = {
    "error of half the size": (keeps_order, lambda x: off_by(lambda h: x * (h / 0.1) ** 2), 0.5, "held", "broke"),
    "order short by 0.35": (keeps_order, lambda x: off_by(lambda h: 1e-3 * h ** (2.0 - x)), 0.35, "held", "degraded"),
    "error of a closed form": (keeps_order, lambda x: off_by(lambda h: x, order=None), 1e-10, "held", "degraded"),
    "swing a hundredth late": (swings_at(math.pi), late_swing, 0.01, "held", "degraded"),
    "swing a tenth late": (swings_at(math.pi), late_swing, 0.1, "degraded", "broke"),
    "swing a hundredth early": (swings_at(math.pi), late_swing, -0.01, "held", "degraded"),
    "swing a tenth early": (swings_at(math.pi), late_swing, -0.1, "degraded", "broke"),
    "spacing a hundredth long": (swings_at(2.0 * math.pi, spacing=True), late_second_swing, 0.01, "held", "degraded"),
    "spacing a tenth short": (swings_at(2.0 * math.pi, spacing=True), late_second_swing, -0.1, "degraded", "broke"),
    "swing of half a unit": (swings_at(math.pi), lambda x: turning(1.0, 0.5 * x, N=6000), 0.5, "broke", "held"),
    "flip a hundredth late": (flips, late_flip, 0.01, "held", "degraded"),
    "flip a tenth late": (flips, late_flip, 0.1, "degraded", "broke"),
    "twice the size": (stays_bounded, once_as_large, 2.0, "held", "degraded"),
    "a hundred times the size": (stays_bounded, once_as_large, 100.0, "degraded", "broke"),
    "return missed": (returns, not_quite_back, 4.0, "held", "broke"),
    "return missed, not self-adjoint": (returns, lambda x: not_quite_back(x, False), 4.0, "held", "degraded"),
    "claim that moves": (does_not_drift, moved_in_ulp, 3.0, "held", "degraded"),
    "claim that moves beyond its error": (does_not_drift, moved_in_errors, 5.0, "held", "degraded"),
    "claim that falls beyond its error": (does_not_drift, moved_in_errors, -5.0, "held", "degraded"),
}
"""A check, the motion of a size, the size of the threshold, and the outcomes 2 % below and above it."""


@pytest.mark.parametrize("name", THRESHOLDS)
def test_outcomes_change_at_their_thresholds(name: str) -> None:
    check, motion, size, below, above = THRESHOLDS[name]
    found = [check(cast(Trial, motion(factor * size))).result.value for factor in (0.98, 1.02)]
    assert found == [below, above]


@pytest.mark.parametrize(("factor", "kept"), [(0.98, True), (1.02, False)])
def test_a_claim_holds_to_50_ulp_times_the_root_of_the_steps(factor: float, kept: bool) -> None:
    def moves(n: Array, h: float) -> Array:
        a = np.ones(len(n))
        a[64] += factor * 50.0 * EPS * math.sqrt(64.0)
        return np.stack([a, a, a], axis=1)

    trial = MadeUp(moves, claims=(series(1.0),))
    assert (claim_violated(cast(Trial, trial), trial.run()) is None) == kept


def test_findings_name_the_first_step_beyond_a_bound() -> None:
    """Neither the row of that step, of which every second one is recorded here, nor the step of the largest excess."""
    lost = MadeUp(None)
    lost.moves = lambda n, h: lost.exact(n * h) + np.select([n >= 60, n >= 30], [5.0, 0.7], 0.0)[:, None]
    growing = MadeUp(lambda n, h: np.select([n >= 60, n >= 30], [50.0, 2.5], 1.0)[:, None] * np.array([1.0, 0.2, 0.1]))
    moved = MadeUp(
        lambda n, h: np.select([n >= 60, n >= 30], [1.1, 1.01], 1.0)[:, None] * np.ones(3), claims=(series(1.0),)
    )
    returned = MadeUp(lambda n, h: np.full((len(n), 3), 1.0 if h > 0.0 else 1.5), y0=(1.0, 1.0, 1.0), N=70)
    checks_of = {keeps_order: lost, stays_bounded: growing, returns: returned}
    found = {check.__name__: check(cast(Trial, trial)).step for check, trial in checks_of.items()}
    assert found == {"keeps_order": 30, "stays_bounded": 30, "returns": 140}
    violated = claim_violated(cast(Trial, moved), moved.run())
    assert violated is not None
    assert violated.step == 30
    assert "changes by 1.0e-02" in violated.why
    assert violated.figures["deviation"] == pytest.approx(0.1, rel=1e-12)


@pytest.mark.parametrize(("factor", "found"), [(0.0, "held"), (200.0, "broke")])
def test_a_claimed_invariant_with_a_slope_breaks(factor: float, found: str) -> None:
    """A slope of a hundredth of the claim's bound, far beyond its error, is named; round-off alone is not."""
    noise = np.random.default_rng(3).normal(size=20_001)

    def moves(n: Array, h: float) -> Array:
        first = 1.0 + EPS * (np.cumsum(noise)[n] + factor * n)
        return np.stack([first, np.cos(1.0 * n), 0.0 * n], axis=1)

    result = does_not_drift(cast(Trial, MadeUp(moves, N=20_000, claims=(series(1.0),), claim_ulps=1e9)))
    assert result.result.value == found
    if found == "broke":
        slope = result.why.removeprefix("drifts: x ").split()[0]
        assert float(slope) == pytest.approx(factor * 20_000 * EPS, rel=0.05)
        assert result.step == 20_000


def test_checks_that_need_compiled_code_are_not_tried_in_the_interpreter() -> None:
    never = lambda n, h: pytest.fail("it was run")  # noqa: E731
    for check in (returns, does_not_drift):
        found = check(cast(Trial, MadeUp(never, plain=True, claims=(series(1.0),))))
        assert (found.result.value, found.why) == ("not tried", "runs in the interpreter")
    assert does_not_drift(cast(Trial, MadeUp(never))).result.value == "not tried"
