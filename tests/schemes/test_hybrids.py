"""The hybrids with carried xi: their equations, round-off that does not grow, reversal over long runs."""

from __future__ import annotations

import cmath

import numpy as np
import pytest
from mpmath import mp, mpf

from conftest import GEN, PAPER, random_states
from steppers import physical
from test_beyond import DELONE, deviations, error_at, ran, stepper
from topcli.analysis.trend import trend
from topcli.contracts import Floats, Outcome, Stepper
from topcli.schemes.kowalevski.hybrid import enter_carried
from topcli.schemes.registry import find_scheme
from topcli.tops.kowalevski import Kowalevski

SCENES = [(GEN, 0.05), (GEN, 0.01), (PAPER, 0.01), (DELONE, 0.02)]


def relations(old: Floats, new: Floats, h, c) -> list:
    """The paper's three relations between old and new state, in the arithmetic of the arguments; all zero."""
    w, g, v, n = old[:3], old[3:], new[:3], new[3:]
    o = [(a + b) / 2 for a, b in zip(w, v, strict=True)]
    q = [(a + b) / 2 for a, b in zip(g, n, strict=True)]
    turned = [q[1] * o[2] - q[2] * o[1], q[2] * o[0] - q[0] * o[2], q[0] * o[1] - q[1] * o[0]]
    xi = (w[0] + 1j * w[1]) ** 2 - c * (g[0] + 1j * g[1])
    xi_new = (v[0] + 1j * v[1]) ** 2 - c * (n[0] + 1j * n[1])
    x = h * o[2]
    turn = mp.mpc(mp.cos(x), -mp.sin(x)) if isinstance(h, mpf) else cmath.exp(-1j * x)
    z = xi_new - turn * xi
    return [*(b - a - h * x for a, b, x in zip(g, n, turned, strict=True)), v[2] - w[2] + h * c * q[1], z.real, z.imag]


def test_hybrid_does_not_satisfy_the_symmetric_relations() -> None:
    """Control: the paper's hybrid misses the relations by h times its prediction's error, O(h⁴)."""
    step = physical(stepper("hybrid"))
    defects = [max(map(abs, relations(GEN, step(GEN, h, (1.0,)), h, 1.0))) for h in (0.1, 0.05)]
    assert defects[1] == pytest.approx(4.27e-07, rel=0.05)
    assert 12.0 < defects[0] / defects[1] < 20.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hybrid-sym", "hybrid-xi"])
@pytest.mark.parametrize(("y0", "h"), SCENES)
def test_lengths_stay_within_ulps_over_many_steps(name: str, y0: Floats, h: float) -> None:
    states, ending = ran(stepper(name), y0, h, 200_000, 100)
    assert ending.outcome is Outcome.COMPLETED
    found = deviations(states)
    assert found["gamma_sq"] < 5.0
    assert found["k_sq"] < 20.0


def test_papers_hybrid_loses_its_lengths() -> None:
    found = deviations(ran(stepper("hybrid"), GEN, 0.05, 1_000_000, 100)[0])
    assert found["gamma_sq"] == pytest.approx(323, rel=0.05)
    assert found["k_sq"] == pytest.approx(248, rel=0.05)


def test_hybrid_xi_is_the_hybrid() -> None:
    """The same trajectory up to round-off, on generic orbits, for either branch of the root, and for k = 0."""
    scheme, plain = find_scheme("hybrid-xi", "kowalevski"), find_scheme("hybrid", "kowalevski")
    for branch in ("nearest", "sign"):
        for y in [GEN, DELONE, *map(tuple, random_states(5, seed=33))]:
            options = {"branch": branch}
            mine, _ = ran(scheme.build(Kowalevski(), scheme.options(**options)), y, 0.02, 100)
            hybrid, _ = ran(plain.build(Kowalevski(), plain.options(**options)), y, 0.02, 100)
            assert np.abs(mine - hybrid).max() < 1e-11


def test_carried_xi_without_a_direction() -> None:
    """k = 0 or gamma = 0 divide by nothing."""
    assert enter_carried((1.0, 0.0, 0.5, 1.0, 0.0, 0.0), 0.1, (1.0,))[6:9] == (1.0, 0.0, 0.0)
    for y in [(0.0,) * 6, (0.7, -0.4, 1.3, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0, 0.0, 1.0)]:
        for name in ("hybrid-sym", "hybrid-xi"):
            states, ending = ran(stepper(name), y, 0.01, 1000)
            assert ending.outcome is Outcome.COMPLETED, (name, y)
            assert max(deviations(states)[n] for n in ("gamma_sq", "k_sq")) < 20.0


def slope_over_error(made: Stepper, integral: str) -> float:
    """The drift of an integral along GEN with h = 0.05 over t = 2e4, in its standard errors."""
    states, _ = ran(made, GEN, 0.05, 400_000, 10)
    values = next(i for i in Kowalevski().invariants() if i.name == integral).value(states)
    blocks = values[: len(values) // 100 * 100].reshape(100, -1).mean(axis=1)
    fit = trend(np.arange(100.0), blocks)
    assert fit is not None
    return abs(fit.slope) / fit.error


@pytest.mark.slow
@pytest.mark.parametrize("integral", ["two_l", "energy"])
def test_the_other_integrals_do_not_drift(integral: str) -> None:
    assert slope_over_error(stepper("hybrid-sym"), integral) < 5.0
    assert 900.0 < slope_over_error(stepper("hybrid"), integral) < 3900.0


@pytest.mark.parametrize(
    ("y0", "defect"),
    list(zip([GEN, *map(tuple, random_states(2, seed=34))], [0.2884, 3.471e-3, 3.474e-2], strict=True)),
)
def test_reversal_over_long_runs(y0: Floats, defect: float) -> None:
    """1e4 steps forward and as many back: round-off grown along the orbit; the paper's hybrid misses."""

    def missed(name: str) -> float:
        there, _ = ran(stepper(name), y0, 0.05, 10_000, 10_000)
        back, _ = ran(stepper(name), tuple(there[-1]), -0.05, 10_000, 10_000)
        return float(np.abs(back[-1] - y0).max())

    assert missed("hybrid-sym") < 1e-8
    assert missed("hybrid") == pytest.approx(defect, rel=0.01)


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
