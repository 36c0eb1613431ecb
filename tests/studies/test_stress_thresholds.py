"""Both sides of every threshold of the stress checks: motions made up just inside and just outside of each."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from topcli.analysis.tally import invariant_report
from topcli.analysis.trajectory import Trajectory
from topcli.contracts import Array, Ending, Invariant, Outcome
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
BELOW_AND_ABOVE = pytest.mark.parametrize("factor", [0.98, 1.02])


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
    top: Any = field(default_factory=lambda: SimpleNamespace(components=("a", "b", "c"), swing="a"))
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
        return Trajectory(self.top, "made up", h, n, self.moves(n, h), Ending(Outcome.COMPLETED, N, N * h), 0.0, 0.0)

    def reference(self, times: Array) -> Array:
        return self.exact(times)

    def claimed(self, h: float) -> list[Invariant]:
        return list(self.claims)

    def closed_form(self, n: Array) -> Array:
        return self.closed(n, self.h)


def outcome(check: Check, trial: MadeUp) -> str:
    return check(cast(Trial, trial)).result.value


def off_by(error: Any) -> MadeUp:
    """The reference motion with ``error(h)`` in its first component from the first step on."""
    trial = MadeUp(None)
    trial.moves = lambda n, h: trial.exact(n * h) + np.where(n > 0, error(h), 0.0)[:, None] * [1.0, 0.0, 0.0]
    return trial


@BELOW_AND_ABOVE
def test_an_error_of_half_the_size_has_left_the_motion(factor: float) -> None:
    trial = off_by(lambda h: factor * 0.5 * (h / 0.1) ** 2)
    assert outcome(keeps_order, trial) == ("held" if factor < 1.0 else "broke")


@pytest.mark.parametrize(("order", "found"), [(1.67, "held"), (1.63, "degraded")])
def test_an_order_may_fall_short_by_0_35(order: float, found: str) -> None:
    assert outcome(keeps_order, off_by(lambda h: 1e-3 * h**order)) == found


@BELOW_AND_ABOVE
@pytest.mark.parametrize("order", [None])
def test_a_closed_form_is_right_to_1e_10(order: int | None, factor: float) -> None:
    trial = off_by(lambda h: factor * 1e-10)
    trial.order = order
    assert outcome(keeps_order, trial) == ("held" if factor < 1.0 else "degraded")


@pytest.mark.parametrize(
    ("late", "found"),
    [
        (0.0098, "held"),
        (0.0102, "degraded"),
        (0.098, "degraded"),
        (0.102, "broke"),
        (-0.0098, "held"),
        (-0.102, "broke"),
    ],
)
def test_times_are_right_to_a_hundredth_and_rough_to_a_tenth(late: float, found: str) -> None:
    """A swing or a flip that comes too late or too early by this part of its time."""
    due = math.pi
    pace = 1.0 / (1.0 + late)
    swinging = MadeUp(lambda n, h: np.cos(np.outer(n * h * pace, [1.0, 0.0, 0.0])), N=6000, h=0.001)
    assert outcome(swings_at(due), swinging) == found
    spaced = MadeUp(swinging.moves, N=16_000, h=0.001)
    assert outcome(swings_at(2.0 * due, spacing=True), spaced) == found


@BELOW_AND_ABOVE
def test_a_swing_spans_half_a_unit(factor: float) -> None:
    moves = lambda n, h: factor * 0.25 * np.cos(np.outer(n * h, [1.0, 0.0, 0.0]))  # noqa: E731
    assert outcome(swings_at(math.pi), MadeUp(moves, N=6000, h=0.001)) == ("held" if factor > 1.0 else "broke")


@pytest.mark.parametrize(("late", "found"), [(0.0098, "held"), (0.0102, "degraded"), (0.102, "broke")])
def test_a_flip_is_timed_against_the_closed_form(late: float, found: str) -> None:
    """omega2 = cos t changes its sign at pi/2; the scheme's later by this part."""

    def closed(n: Array, h: float) -> Array:
        return np.stack([np.ones(len(n)), np.cos(n * h), np.zeros(len(n))], axis=1)

    moves = lambda n, h: closed(n, h / (1.0 + late))  # noqa: E731
    assert outcome(flips, MadeUp(moves, N=2000, h=0.001, closed=closed)) == found


@pytest.mark.parametrize(
    ("largest", "found"), [(1.98, "held"), (2.02, "degraded"), (98.0, "degraded"), (102.0, "broke")]
)
def test_bounded_is_twice_the_size_and_lost_a_hundred_times(largest: float, found: str) -> None:
    """The motion's size is that of its largest component over ten time scales: 1 here."""
    moves = lambda n, h: np.where(n == 30, largest, 1.0)[:, None] * np.array([1.0, 0.2, 0.1])  # noqa: E731
    assert outcome(stays_bounded, MadeUp(moves)) == found


@BELOW_AND_ABOVE
@pytest.mark.parametrize(("self_adjoint", "found"), [(True, "broke"), (False, "degraded")])
def test_a_return_misses_by_round_off_only(factor: float, self_adjoint: bool, found: str) -> None:
    """4 ulp (sqrt(N) + h N^1.5) of the size of the state, which is 2."""
    N, h, size = 400, 0.1, 2.0
    missed = factor * 4.0 * EPS * (math.sqrt(N) + h * N**1.5) * size

    def moves(n: Array, h: float) -> Array:
        ends = np.array([size, 0.0, 0.0]) + (np.array([0.0, missed, 0.0]) if h < 0.0 else 0.0)
        return np.tile(ends, (len(n), 1))

    trial = MadeUp(moves, N=N, h=h, y0=(size, 0.0, 0.0), self_adjoint=self_adjoint)
    assert outcome(returns, trial) == ("held" if factor < 1.0 else found)


def test_findings_name_the_first_step_beyond_a_bound() -> None:
    """Neither the row of that step, of which every second one is recorded here, nor the step of the largest excess."""
    lost = MadeUp(None)
    lost.moves = lambda n, h: lost.exact(n * h) + np.select([n >= 60, n >= 30], [5.0, 0.7], 0.0)[:, None]
    growing = MadeUp(lambda n, h: np.select([n >= 60, n >= 30], [50.0, 2.5], 1.0)[:, None] * np.array([1.0, 0.2, 0.1]))
    claim = Invariant("a", "a", "a", "the first component", lambda y: y[:, 0], lambda y: np.ones(len(y)))
    moved = MadeUp(lambda n, h: np.select([n >= 60, n >= 30], [1.1, 1.01], 1.0)[:, None] * np.ones(3), claims=(claim,))
    returned = MadeUp(lambda n, h: np.full((len(n), 3), 1.0 if h > 0.0 else 1.5), y0=(1.0, 1.0, 1.0), N=70)
    checks_of = {keeps_order: lost, stays_bounded: growing, returns: returned}
    found = {check.__name__: check(cast(Trial, trial)).step for check, trial in checks_of.items()}
    assert found == {"keeps_order": 30, "stays_bounded": 30, "returns": 140}
    violated = claim_violated(cast(Trial, moved), moved.run())
    assert violated is not None
    assert violated.step == 30
    assert "off by 1.0e-02" in violated.why
    assert violated.figures["deviation"] == pytest.approx(0.1, rel=1e-12)


FIRST = Invariant("a", "a", "a", "the first component", lambda y: y[:, 0], lambda y: np.ones(len(y)))


@BELOW_AND_ABOVE
def test_a_claim_holds_to_50_ulp_times_the_root_of_the_steps(factor: float) -> None:
    def moves(n: Array, h: float) -> Array:
        a = np.ones(len(n))
        a[64] += factor * 50.0 * EPS * math.sqrt(64.0)
        return np.stack([a, a, a], axis=1)

    trial = MadeUp(moves, claims=(FIRST,))
    assert (claim_violated(cast(Trial, trial), trial.run()) is None) == (factor < 1.0)


@BELOW_AND_ABOVE
def test_a_bias_is_a_slope_of_three_times_the_root_of_the_steps_in_ulp(factor: float) -> None:
    """Within the round-off bound, a line without noise: its error is nearly zero."""
    N = 8192
    moved = factor * 3.0 * math.sqrt(N) * EPS * 32.0
    terms = Invariant("a", "a", "a", "a series", lambda y: y[:, 0], lambda y: np.full(len(y), 32.0))

    def moves(n: Array, h: float) -> Array:
        ripple = 1e-3 * moved * np.random.default_rng(1).normal(size=len(n))
        return np.repeat((moved * n / N + ripple)[:, None], 3, axis=1)

    trial = MadeUp(moves, N=N, claims=(terms,))
    assert outcome(does_not_drift, trial) == ("held" if factor < 1.0 else "degraded")


@BELOW_AND_ABOVE
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_bias_is_a_slope_of_five_standard_errors(factor: float, sign: float) -> None:
    """Noise that is constant within 64 steps, and a line added to it that leaves its standard error as it is.

    Over the run the slope is 4 sqrt(N) ulp, where the other condition holds and the deviation is still round-off.
    """
    N, h, size = 8192, 0.1, 32.0
    ulp = EPS * size
    terms = Invariant("a", "a", "a", "a series", lambda y: y[:, 0], lambda y: np.full(len(y), size))
    noise = np.repeat(np.random.default_rng(4).normal(size=N // 64 + 1), 64)[: N + 1]
    (plain,) = invariant_report([terms], np.arange(N + 1), h, np.repeat(noise[:, None], 3, axis=1))
    assert plain.drift is not None
    assert plain.drift_error is not None
    assert plain.model == "linear trend"
    scale = 4.0 * math.sqrt(N) * ulp / (5.0 * plain.drift_error * N * h)
    slope = sign * factor * 5.0 * plain.drift_error - plain.drift
    series = scale * (noise + slope * h * np.arange(N + 1))
    series -= series[0]
    assert np.abs(series).max() < 20.0 * math.sqrt(N) * ulp
    trial = MadeUp(lambda n, h: np.repeat(series[n][:, None], 3, axis=1), N=N, h=h, claims=(terms,))
    assert outcome(does_not_drift, trial) == ("held" if factor < 1.0 else "degraded")


@pytest.mark.parametrize(("factor", "found"), [(0.0, "held"), (200.0, "broke")])
def test_a_claimed_invariant_with_a_slope_breaks(factor: float, found: str) -> None:
    """A slope of a hundredth of the claim's bound, far beyond its error, is named; round-off alone is not."""
    noise = np.random.default_rng(3).normal(size=20_001)

    def moves(n: Array, h: float) -> Array:
        first = 1.0 + EPS * (np.cumsum(noise)[n] + factor * n)
        return np.stack([first, 0.0 * n, 0.0 * n], axis=1)

    claim = Invariant("a", "a", "a", "first", lambda y: y[:, 0], lambda y: np.abs(y[:, 0]))
    result = does_not_drift(cast(Trial, MadeUp(moves, N=20_000, claims=(claim,), claim_ulps=1e9)))
    assert result.result.value == found
    if found == "broke":
        slope = result.why.removeprefix("drifts: a ").split()[0]
        assert float(slope) == pytest.approx(factor * 20_000 * EPS, rel=0.05)
        assert result.step == 20_000


def test_checks_that_need_compiled_code_are_not_tried_in_the_interpreter() -> None:
    never = lambda n, h: pytest.fail("it was run")  # noqa: E731
    claim = Invariant("a", "a", "a", "first", lambda y: y[:, 0], lambda y: np.abs(y[:, 0]))
    for check in (returns, does_not_drift):
        found = check(cast(Trial, MadeUp(never, plain=True, claims=(claim,))))
        assert (found.result.value, found.why) == ("not tried", "runs in the interpreter")
    assert outcome(does_not_drift, MadeUp(never)) == "not tried"
