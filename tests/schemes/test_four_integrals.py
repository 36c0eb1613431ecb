"""Schemes that keep all four integrals of the Kowalevski top: over long runs, and where the gradients are dependent."""

from __future__ import annotations

import math

import numpy as np
import pytest

from conftest import GEN, PAPER, random_states
from stepping import deviations, error_at, gradients, ran, stepper
from topcli.analysis.order import observed_order
from topcli.analysis.reference import reference_states
from topcli.contracts import Floats, Outcome
from topcli.schemes.kowalevski.four_integrals import (
    combination,
    directional_derivatives,
    factorize,
    fourth_column,
    gram,
    newton_matrix,
    newton_solve,
    solve,
    xi_of,
)
from topcli.tops.kowalevski import Kowalevski, field

ALL_FOUR = ("hk-projected", "hk-symproj", "dg4", "midpoint4")
DELONE = (0.9, 0.3, 1.0, 0.72, 0.54, math.sqrt(1.0 - 0.72**2 - 0.54**2))
"""xi = 0 exactly: Delone's motion, k² = 0 with a vanishing gradient."""
EQUILIBRIUM = (2.0, 0.0, 0.0, 1.0, 0.0, 0.0)
"""The relative equilibrium that PAPER is close to: the four gradients span a plane only."""


def matrices(y: Floats, c: float) -> tuple[np.ndarray, Floats]:
    """The matrix D of the gradients of gamma²/2, 2l, E and k²/2, and the fourth column as the schemes carry it."""
    D = gradients(Kowalevski(c0=c), y) / [2.0, 1.0, 1.0, 2.0]
    return D, fourth_column(y[0], y[1], *xi_of(y[0], y[1], y[3], y[4], c), c)


@pytest.mark.parametrize("c", [1.0, -1.5, 0.0])
def test_gradients_and_their_gram_matrix(c: float) -> None:
    for y in map(tuple, random_states(20, seed=21)):
        D, column = matrices(y, c)
        x = (0.3, -0.7, 0.4, 1.1)
        np.testing.assert_allclose(combination(y, c, column, x), D @ x, atol=1e-13)
        np.testing.assert_allclose(directional_derivatives(y, c, column, y), D.T @ y, atol=1e-13)
        G = D.T @ D
        np.testing.assert_allclose(gram(y, c, column), G[np.triu_indices(4)], rtol=1e-13, atol=1e-13)
        r = (0.3, -0.2, 0.5, 0.7)
        *x, short = solve(factorize(gram(y, c, column), True), r, math.inf)
        assert short == 0.0
        np.testing.assert_allclose(x, np.linalg.solve(G, r), rtol=1e-15 * np.linalg.cond(G))
        *x, short = solve(factorize(gram(y, c, column), True), r, 1e-8)
        assert short >= 1.0
        assert np.linalg.norm(D @ x) < 2.001e-4  # four directions, normal to each other, of 1e-4 at most


def test_dependent_gradients_are_left_out() -> None:
    """At the relative equilibrium the rank is 2: two directions are used, and they are solved for rightly."""
    D, column = matrices(EQUILIBRIUM, 1.0)
    assert np.linalg.matrix_rank(D) == 2
    factors = factorize(gram(EQUILIBRIUM, 1.0, column), True)
    assert [i > 0.0 for i in factors[:4]] == [True, True, False, False]
    wanted = D.T @ D @ [1.0, -2.0, 0.5, 0.1]
    *x, short = solve(factors, tuple(wanted), math.inf)
    assert short == 2.0
    np.testing.assert_allclose(D.T @ (D @ x), wanted, rtol=1e-13)


DEGENERATE = {
    "delone": DELONE,
    "equilibrium": EQUILIBRIUM,
    "zero": (0.0,) * 6,
    "hanging": (0.0, 0.0, 0.0, 1.0, 0.0, 0.0),
    "pendulum": (0.0, 1.3, 0.0, 0.6, 0.0, 0.8),
    "homoclinic": (2.0, 0.0, 0.0, 1.0, 0.0, 1e-9),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL_FOUR)
@pytest.mark.parametrize("c0", [1.0, 0.0, -1.5])
@pytest.mark.parametrize("y0", DEGENERATE.values(), ids=DEGENERATE)
def test_degenerate_tori_are_no_worse_than_hk(name: str, c0: float, y0: Floats) -> None:
    top = Kowalevski(c0=c0)
    states, ending = ran(stepper(name, top), y0, 0.01, 5000, 5, top)
    base, _ = ran(stepper("hk", top), y0, 0.01, 5000, 5, top)
    assert ending.outcome is Outcome.COMPLETED
    mine, hks = deviations(states, top), deviations(base, top)
    assert all(mine[integral] <= max(500.0, 1.1 * hks[integral]) for integral in mine)
    assert max(mine["gamma_sq"], mine["two_l"], mine["energy"]) < 100.0
    exact = reference_states(top, y0, np.array([10.0]))[0]
    assert np.abs(states[200] - exact).max() <= 2.0 * np.abs(base[200] - exact).max() + 1e-12


@pytest.mark.parametrize("name", ALL_FOUR)
@pytest.mark.parametrize("k", [0.0, 1e-9, 1e-4])
def test_small_k_is_conserved(name: str, k: float) -> None:
    """Delone's motion, k = 0, where the gradient of k² vanishes, and close to it; HK loses it at second order in h."""
    g1, g2 = 0.72 - 0.6 * k, 0.54 + 0.8 * k
    y0 = (0.9, 0.3, 1.0, g1, g2, math.sqrt(1.0 - g1 * g1 - g2 * g2))
    mine, hk = (ran(stepper(one), y0, 0.05, 200)[0] for one in (name, "hk"))
    off = [np.abs(ks - ks[0]) for s in (mine, hk) for ks in [np.hypot(*xi_of(s[:, 0], s[:, 1], s[:, 3], s[:, 4], 1.0))]]
    assert off[0].max() < (4e-15 if name == "midpoint4" else 1e-8)  # others: a step in a hundred
    assert np.median(off[0]) < 4e-15
    assert off[1].max() == pytest.approx(1.58e-3, rel=0.05)
    found = deviations(mine)
    assert max(found["gamma_sq"], found["two_l"], found["energy"]) < 100.0


@pytest.mark.parametrize("name", ALL_FOUR)
def test_near_the_homoclinic_orbit_the_phase_is_right(name: str) -> None:
    """PAPER, h = 0.05, t = 50: keeping the integrals keeps the swings' times; HK is off by a hundred times as much."""
    mine, hk = error_at(stepper(name), PAPER, 0.05, 50.0), error_at(stepper("hk"), PAPER, 0.05, 50.0)
    assert hk > 2e-2
    assert mine < 1e-3


KEPT_ON_PAPER = {
    "hk-projected": (20.0, 100.0),
    "hk-symproj": (50.0, 100.0),
    "dg4": (20.0, 20.0),
    "midpoint4": (20.0, 20.0),
}
"""Bounds in ulp of the terms for gamma², 2l and E, and for k². Typical: 6 and 59, 27 and 58, 5 and 3, 6 and 3. The
projections omit an integral in every fiftieth step, where the gradients are nearly dependent, and count these steps."""


@pytest.mark.parametrize("name", ALL_FOUR)
def test_four_integrals_on_the_papers_scene_with_a_large_step(name: str) -> None:
    states, ending = ran(stepper(name), PAPER, 0.2, 20_000)
    assert (ending.outcome, ending.counters["unmet"]) == (Outcome.COMPLETED, 0)
    found = deviations(states)
    three, fourth = KEPT_ON_PAPER[name]
    assert found.pop("k_sq") < fourth
    assert max(found.values()) < three
    assert (ending.counters.get("short_corrections", 0) > 0) == (fourth > 20.0)
    assert ending.counters.get("midpoint_steps", 0) < 4000  # 3342 of dg4, which takes them only if it must


def test_newton_matrix_is_the_derivative() -> None:
    """Against the derivative of the field by complex steps and numpy's solver."""
    for y in map(tuple, random_states(20, seed=53)):
        moved = np.array(y) + 1e-200j * np.eye(6)
        derivative = np.array([np.imag(field(tuple(z), (-1.3,))) / 1e-200 for z in moved.tolist()]).T
        r = (0.3, -0.2, 0.5, 0.7, 0.1, -0.9)
        exact = np.linalg.solve(np.eye(6) - 0.2 * derivative, r)
        np.testing.assert_allclose(newton_solve(newton_matrix(y, 0.2, -1.3), r), exact, rtol=1e-12, atol=1e-13)


@pytest.mark.slow
def test_carried_prediction_changes_only_iteration_counts() -> None:
    """Forgetting the expected change before every step gives the same trajectory to round-off, with more iterations."""
    p, h, made = (1.0,), 0.05, stepper("midpoint4")
    assert made.enter is not None
    s = forgetful = made.enter(GEN, h, p)
    for _ in range(400):
        s = made.step(s, h, p)
        forgetful = made.step((*forgetful[:6], *(0.0,) * 12, *forgetful[18:]), h, p)
    assert np.abs(np.subtract(s[:6], forgetful[:6])).max() < 1e-12
    assert forgetful[25] > 1.2 * s[25]


@pytest.mark.parametrize("eps", [1e-3, 1e-5, 1e-7, 1e-9])
def test_four_integrals_close_to_a_degenerate_torus(eps: float) -> None:
    """Ever closer to the homoclinic orbit all four are kept, and the steps that had to be projected are counted."""
    y0 = (2.0, 0.0, 0.0, math.sqrt(1.0 - eps * eps), 0.0, eps)
    states, ending = ran(stepper("midpoint4"), y0, 0.01, 10_000)
    assert ending.outcome is Outcome.COMPLETED
    assert max(deviations(states).values()) < 100.0
    if eps > 1e-4:
        assert ending.counters["plain_projections"] == 0
    if eps < 1e-6:
        assert 1300.0 < ending.counters["plain_projections"] < 20000.0
    assert 1.7e6 < deviations(ran(stepper("midpoint"), y0, 0.01, 10_000)[0])["k_sq"] < 7.3e8
    swing = math.sqrt(2.0) * math.log(8.0 * math.sqrt(7.0) / eps)
    first = states[: round(1.5 * swing / 0.01), 3]
    assert 0.01 * int(np.argmin(first)) == pytest.approx(swing, abs=0.011)


@pytest.mark.slow
@pytest.mark.parametrize("c0", [1.0, -1.0, 300.0])
def test_large_steps_are_never_silently_wrong(c0: float) -> None:
    """All integrals are kept, or the run says that it did not keep them, or that it did not converge."""
    top, outcomes = Kowalevski(c0=c0), set()
    for h in (0.2, 0.7, 2.0, 6.0):
        for y in map(tuple, random_states(8, seed=55)):
            states, ending = ran(stepper("midpoint4", top), y, h / math.sqrt(max(1.0, abs(c0))), 300, 1, top)
            outcomes.add(ending.outcome)
            kept = max(deviations(states[np.isfinite(states).all(axis=1)], top).values()) < 1e4
            assert kept or ending.counters["unmet"] > 0 or ending.outcome is Outcome.NO_CONVERGENCE
            assert kept or h > 0.5
    assert Outcome.NO_CONVERGENCE in outcomes


def crossing(t: float) -> tuple[Floats, Floats]:
    """A state a time ``t`` before omega1 + i omega2 = 0 exactly, and the exact state a time ``t`` after it.

    The motion backward in time is that of (-omega, gamma) forward.
    """
    top, times = Kowalevski(), np.array([t])
    before = reference_states(top, (0.0, 0.0, -1.3, 0.48, -0.6, 0.64), times)[0]
    after = reference_states(top, (0.0, 0.0, 1.3, 0.48, -0.6, 0.64), times)[0]
    return (*(-before[:3]), *before[3:]), tuple(after)


@pytest.mark.parametrize("name", ["midpoint4", "hk-symproj", "hybrid", "hybrid-xi"])
def test_order_through_omega_zero(name: str) -> None:
    """On a motion exactly through omega1 + i omega2 = 0 the order is 2 and k² is kept; the square root's is lost."""
    y0, exact = crossing(1.0)
    counts = 26 * 2 ** np.arange(7)
    errors = []
    for N in counts:
        states, _ = ran(stepper(name), y0, 2.0 / N, int(N))
        errors.append(float(np.linalg.norm(states[-1] - exact)))
        assert deviations(states)["k_sq"] < 20.0
        assert np.hypot(states[:, 0], states[:, 1]).min() < 10.0 * (2.0 / N)
    order = observed_order(list(2.0 / counts), errors, 1e-12)
    assert order is not None
    if name in ("midpoint4", "hk-symproj"):
        assert order == pytest.approx(2.0, abs=0.01)
    else:
        assert order < 1.6
