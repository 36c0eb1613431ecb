"""The midpoint rule that keeps all four integrals: its equation, its safety, and that nothing carried matters."""

from __future__ import annotations

import math

import numpy as np
import pytest

from conftest import GEN, random_states
from test_beyond import deviations, gradients, ran, stepper
from topcli.analysis.order import observed_order, one_step_back_and_forth
from topcli.analysis.reference import reference_states
from topcli.contracts import Floats, Outcome
from topcli.schemes.kowalevski.four_integrals import (
    bracket,
    conserving_direction,
    fourth_column,
    hamiltonian_field,
    momentum_field,
    newton_matrix,
    newton_solve,
    xi_of,
)
from topcli.tops.kowalevski import Kowalevski, field

M = np.diag([2.0, 2.0, 1.0, 1.0, 1.0, 1.0])
"""From omega, gamma to m, gamma."""


def poisson(y: Floats) -> np.ndarray:
    """The 6x6 matrix J of the bracket at omega, gamma, for gradients with respect to (m, gamma)."""

    def hat(v: np.ndarray) -> np.ndarray:
        return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])

    m, gamma = hat(np.array([2.0 * y[0], 2.0 * y[1], y[2]])), hat(np.array(y[3:]))
    return np.block([[m, gamma], [gamma, np.zeros((3, 3))]])


@pytest.mark.parametrize("c", [1.0, -1.5, 0.0])
def test_fields_are_the_brackets_of_their_functions(c: float) -> None:
    """F and X are J times gradients by complex steps; F is the motion's field; J is applied rightly."""
    for y in map(tuple, random_states(10, seed=51)):
        xi = xi_of(y[0], y[1], y[3], y[4], c)
        D = np.linalg.inv(M) @ gradients(y, c, *xi)
        J = poisson(y)
        np.testing.assert_allclose(J @ D[:, :2], 0.0, atol=1e-13)  # Casimirs
        np.testing.assert_allclose(momentum_field(y, c), J @ D[:, 2], atol=1e-13)
        np.testing.assert_allclose(momentum_field(y, c), M @ field(y, (c,)), atol=1e-14)
        np.testing.assert_allclose(hamiltonian_field(y, fourth_column(y[0], y[1], *xi, c)), J @ D[:, 3], atol=1e-12)
        v = (0.3, -0.7, 0.2, 1.1, -0.4, 0.9)
        np.testing.assert_allclose(M @ bracket(y, v), J @ v, atol=1e-13)


def test_direction_keeps_three_and_changes_k_at_its_rate() -> None:
    for y in map(tuple, random_states(20, seed=52)):
        xi = xi_of(y[0], y[1], y[3], y[4], 1.0)
        n, rate, most = conserving_direction(y, momentum_field(y, 1.0), fourth_column(y[0], y[1], *xi, 1.0))
        D = gradients(y, 1.0, *xi)
        np.testing.assert_allclose(D[:, :3].T @ n, 0.0, atol=1e-12 * np.linalg.norm(n))
        assert D[:, 3] @ n == pytest.approx(-rate, rel=1e-9)
        assert 0.0 < rate <= most


def test_newton_matrix_is_the_derivative() -> None:
    """Against the derivative of the field by complex steps and numpy's solver."""
    for y in map(tuple, random_states(20, seed=53)):
        columns = []
        for i in range(6):
            z = [complex(v) for v in y]
            z[i] += 1e-200j
            columns.append([complex(v).imag / 1e-200 for v in field(tuple(z), (-1.3,))])  # type: ignore[arg-type]
        r = (0.3, -0.2, 0.5, 0.7, 0.1, -0.9)
        exact = np.linalg.solve(np.eye(6) - 0.2 * np.array(columns).T, r)
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
def test_four_integrals_on_random_orbits_with_a_large_step() -> None:
    """100 orbits, 2000 steps of 0.1, and one step there and back: a few ulp, no projection; HK is far off."""
    made, worst, control = stepper("midpoint4"), 0.0, math.inf
    for y in map(tuple, random_states(100, seed=7)):
        states, ending = ran(made, y, 0.1, 2000)
        assert ending.counters["plain_projections"] == 0
        worst = max(worst, *deviations(states).values())
        control = min(control, *deviations(ran(stepper("hk"), y, 0.1, 200)[0]).values())
        assert one_step_back_and_forth(Kowalevski(), made, np.array(y), 0.2) < 5e-15
    assert worst < 15.0
    assert control == pytest.approx(4.95e11, rel=0.05)


def test_from_rest_with_gamma_along_the_third_axis() -> None:
    """xi = 0 and omega = 0: the top falls, with order 2; it is a fixed point of Bohlin's method."""
    y0 = (0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    exact = reference_states(Kowalevski(), y0, np.array([5.0]))[0]
    errors = [np.abs(ran(stepper("midpoint4"), y0, 5.0 / N, N)[0][-1] - exact).max() for N in (50, 100, 200)]
    assert errors[1] / errors[2] == pytest.approx(4.0, abs=0.05)
    assert errors[0] < 2e-3
    assert tuple(ran(stepper("bohlin-a"), y0, 0.05, 100)[0][-1]) == y0


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
