"""Bohlin's methods and the hybrids: charts, round-off of the carried lengths, and no secular drift over long times."""

from __future__ import annotations

import math

import numpy as np
import pytest

from conftest import GEN, random_states
from stepping import ran, stepper
from topcli.analysis.tally import invariant_report
from topcli.analysis.verdict import InvariantRow
from topcli.contracts import Outcome
from topcli.engine.drive import orbit
from topcli.tops.kowalevski import Kowalevski


def test_bohlin_b_is_lost_at_the_pole() -> None:
    """Near gamma3 = -1 the paper's coordinate is infinite: the run blows up there. gamma stays a unit vector before."""
    y0 = (0.05, 0.0, 0.0, math.sqrt(1.0 - 0.9**2), 0.0, -0.9)
    assert ran(stepper("bohlin-b"), (0.01, 0.0, 3.0, 1e-8, 0.0, -1.0), 0.1, 1000)[1].outcome is Outcome.BLEW_UP
    states, _ = ran(stepper("bohlin-b"), y0, 0.01, 200)
    assert np.abs((states[:, 3:] ** 2).sum(axis=1) - 1.0).max() < 8 * 2.0**-52


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


def drifts(name: str, h: float = 0.05, t: float = 1e5) -> tuple[dict[str, InvariantRow], dict[str, float]]:
    """The report on all integrals over the time ``t``, and their slopes in standard errors."""
    top = Kowalevski()
    n, states, _ = orbit(top, stepper(name), GEN, h, round(t / h), 20)
    rows = {row.name: row for row in invariant_report(top, top.invariants(), n, h, states)[0]}
    return rows, {name: abs(row.drift or 0.0) / (row.drift_error or math.nan) for name, row in rows.items()}


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
