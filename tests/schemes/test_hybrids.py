"""Bohlin's methods and the hybrids: charts, round-off of the carried lengths, and no secular drift over long times."""

from __future__ import annotations

import math

import numpy as np
import pytest

from conftest import GEN, PAPER, random_states
from stepping import deviations, error_at, ran, stepper
from topcli.analysis.tally import InvariantRow, InvariantTally
from topcli.contracts import Floats, Outcome
from topcli.engine.run import Run
from topcli.schemes.kowalevski.bohlin import SWITCH_BELOW, method_b_single, method_b_switch
from topcli.schemes.kowalevski.hybrid import enter_carried
from topcli.tops.kowalevski import Kowalevski

DELONE = (0.9, 0.3, 1.0, 0.72, 0.54, math.sqrt(1.0 - 0.72**2 - 0.54**2))
"""xi = 0 exactly: Delone's motion, k² = 0 with a vanishing gradient."""
SCENES = [(GEN, 0.05), (PAPER, 0.01), (DELONE, 0.02)]


def test_bohlin_b_on_the_other_chart_is_its_mirror_image() -> None:
    """gamma3 -> -gamma3 with (omega1, omega2) -> -(omega1, omega2) takes one chart's gamma to the other's."""
    for y in random_states(20, seed=8):
        w1, w2, w3, g1, g2, g3 = map(float, y)
        shrink = 0.5 / math.hypot(g1, g2)
        g1, g2, g3 = shrink * g1, shrink * g2, math.sqrt(0.75)
        up = method_b_single(w1, w2, w3, g1, g2, g3, 0.01)
        down = method_b_switch(-w1, -w2, w3, g1, g2, -g3, 0.01)
        assert (down[0], down[1], -down[2]) == up


def test_bohlin_b_keeps_the_papers_chart_on_the_papers_scene() -> None:
    states, ending = ran(stepper("bohlin-b"), PAPER, 1e-3, 50_000)
    assert ending.counters == {"chart_switches": 0, "ambiguous_roots": 0}
    assert np.array_equal(states, ran(stepper("bohlin-b", chart="single"), PAPER, 1e-3, 50_000)[0])


def test_bohlin_b_passes_the_south_pole() -> None:
    """Through gamma3 = -1 with chart switches; the paper's single chart does not survive the same orbit."""
    y0, h = (1.5, 0.0, 0.0, 0.0, -math.sin(3.0), math.cos(3.0)), 1e-3
    states, ending = ran(stepper("bohlin-b"), y0, h, 20_000)
    assert ending.outcome is Outcome.COMPLETED
    crossings = np.count_nonzero(np.diff(states[:, 5] < SWITCH_BELOW))
    assert crossings > 2
    assert ending.counters == {"chart_switches": crossings, "ambiguous_roots": 0}
    assert states[:, 5].min() < -0.999
    assert np.abs((states[:, 3:] ** 2).sum(axis=1) - 1.0).max() < 8 * 2.0**-52
    assert np.abs(np.diff(states, axis=0)).max() < 5 * h  # no jump, at the pole or at a switch
    _, single = ran(stepper("bohlin-b", chart="single"), (0.01, 0.0, 3.0, 1e-8, 0.0, -1.0), 0.1, 1000)
    assert single.outcome is Outcome.BLEW_UP


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hybrid-sym", "hybrid-xi"])
@pytest.mark.parametrize(("y0", "h"), SCENES)
def test_lengths_stay_within_ulps_over_many_steps(name: str, y0: Floats, h: float) -> None:
    states, ending = ran(stepper(name), y0, h, 50_000, 100)
    assert ending.outcome is Outcome.COMPLETED
    found = deviations(states)
    assert found["gamma_sq"] < 5.0
    assert found["k_sq"] < 20.0


def test_hybrid_xi_is_the_hybrid() -> None:
    """The same trajectory up to round-off, on generic orbits, for either branch of the root, and for k = 0."""
    for branch in ("nearest", "sign"):
        for y in [GEN, DELONE, *map(tuple, random_states(5, seed=33))]:
            mine, hybrid = (ran(stepper(name, branch=branch), y, 0.02, 100)[0] for name in ("hybrid-xi", "hybrid"))
            assert np.abs(mine - hybrid).max() < 1e-11


def test_carried_xi_without_a_direction() -> None:
    """k = 0 or gamma = 0 divide by nothing."""
    assert enter_carried((1.0, 0.0, 0.5, 1.0, 0.0, 0.0), 0.1, (1.0,))[6:9] == (1.0, 0.0, 0.0)
    for y in [(0.0,) * 6, (0.7, -0.4, 1.3, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0, 0.0, 1.0)]:
        for name in ("hybrid-sym", "hybrid-xi"):
            states, ending = ran(stepper(name), y, 0.01, 1000)
            assert ending.outcome is Outcome.COMPLETED, (name, y)
            assert max(deviations(states)[n] for n in ("gamma_sq", "k_sq")) < 20.0


@pytest.mark.slow
def test_steps_of_many_orbits_converge() -> None:
    """30 random orbits, 1e4 steps of 0.1: some pass close to omega1 + i omega2 = 0, where the roots merge."""
    closest, iterations = 1.0, 0
    for y in map(tuple, random_states(30, seed=7)):
        states, ending = ran(stepper("hybrid-sym"), y, 0.1, 10_000, 1)
        assert ending.outcome is Outcome.COMPLETED
        closest = min(closest, float(np.hypot(states[:, 0], states[:, 1]).min()))
        iterations += ending.counters["iterations"]
    assert closest < 0.01
    assert 4.5e5 < iterations < 9e5


def test_a_step_that_does_not_converge_ends_the_run() -> None:
    """A step of no use, far beyond what the motion allows."""
    outcomes = {ran(stepper("hybrid-sym"), tuple(3.0 * y), 5.0, 200)[1].outcome for y in random_states(20, seed=35)}
    assert Outcome.NO_CONVERGENCE in outcomes


def test_hybrids_have_order_two_like_hk() -> None:
    """PAPER, h = 0.05, t = 50: the self-adjoint hybrid is as good as HK; the paper's hybrid is lost."""
    assert error_at(stepper("hybrid-sym"), PAPER, 0.05, 50.0) < 0.1
    assert error_at(stepper("hybrid"), PAPER, 0.05, 50.0) > 0.5


def drifts(name: str, h: float = 0.05, t: float = 1e5) -> tuple[dict[str, InvariantRow], dict[str, float]]:
    """The report on all integrals over the time ``t``, and their slopes in standard errors."""
    tally = InvariantTally(Kowalevski().invariants(), h)
    for chunk in Run(Kowalevski(), stepper(name), GEN, h, round(t / h), 20):
        tally.add(chunk.n, chunk.states)
    rows = {row.name: row for row in tally.report()}
    return rows, {name: abs(row.drift or 0.0) / (row.drift_error or math.nan) for name, row in rows.items()}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "h", "bound"), [("midpoint4", 0.05, 1e-14), ("backlund", 0.05, 1e-12), ("backlund", 0.4, 1e-12)]
)
def test_four_integrals_do_not_drift(name: str, h: float, bound: float) -> None:
    rows, in_errors = drifts(name, h)
    assert max(in_errors.values()) < 5.0
    assert {row.verdict for row in rows.values()} == {"exact"}
    assert all(row.max_deviation < bound * max(1.0, abs(row.first)) for row in rows.values())


@pytest.mark.slow
def test_the_self_adjoint_hybrid_does_not_drift_and_the_papers_does() -> None:
    rows, in_errors = drifts("hybrid-sym")
    assert max(in_errors.values()) < 5.0
    verdicts = {name: row.verdict for name, row in rows.items()}
    assert verdicts == {"gamma_sq": "exact", "k_sq": "exact", "two_l": "no drift seen", "energy": "no drift seen"}
    rows, in_errors = drifts("hybrid")
    for name in ("two_l", "energy"):
        assert in_errors[name] > 20.0  # 49 by the error of the mean drift, the larger of the two
        assert rows[name].verdict == "lost"  # so far that hardly anything is left of it
