"""The implicit midpoint rule: its equation, its integrals over long runs, and steps that do not converge."""

from __future__ import annotations

import math

import numpy as np
import pytest

from conformance import exactness
from conftest import GEN, PAPER, random_states
from steppers import RK2
from topcli.contracts import Floats, Outcome, Stepper, Top
from topcli.engine.driver import plain_loop
from topcli.engine.loop import Run
from topcli.schemes.any_top.hk_midpoint import midpoint
from topcli.schemes.layout import polynomial_invariants
from topcli.schemes.registry import find_scheme
from topcli.tops.heavy import Heavy
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import LagrangeInertial
from twins_heavy import cross, midpoint_defect, random_heavy_tops

EPS = 2.0**-52
STEPS = 100_000


def stepper(top: Top, name: str = "midpoint") -> Stepper:
    scheme = find_scheme(name, top.form)
    made = scheme.build(top, scheme.options())
    assert isinstance(made, Stepper)
    return made


@pytest.mark.parametrize("h", [1e-6, 1e-3, 0.1, -0.1, 1.0])
def test_step_solves_the_midpoint_rule(h: float) -> None:
    """To some ulp of the change where h is small, of the state where it is large."""
    for top in random_heavy_tops(10, seed=1):
        p = top.constants()
        for y in random_states(10, seed=2):
            *new, status, iterations = midpoint(tuple(y), h, p)
            assert status == 0.0
            assert 1 <= iterations <= 20
            assert np.abs(midpoint_defect(tuple(y), new, h, p)).max() < 20 * EPS * max(1.0, abs(h)) * np.abs(new).max()


def over_bound(top: Top, made: Stepper, y0, h: float, names: tuple[str, ...]) -> float:
    """Largest deviation of the invariants ``names`` over 1e5 steps, in units of 50 ulp times sqrt(N)."""
    return exactness(top, made, y0, h, names, STEPS)


@pytest.mark.slow
@pytest.mark.parametrize("h", [0.2, 0.05, 0.01])
def test_quadratic_integrals_of_random_tops_over_long_runs(h: float) -> None:
    """6 random tops, 1e5 steps each: all three integrals within 50 ulp sqrt(N), and much less than that."""
    worst = [
        over_bound(top, stepper(top), y0, h, ("gamma_sq", "m_gamma", "energy"))
        for top, y0 in zip(random_heavy_tops(6, seed=8), random_states(6, seed=9), strict=True)
    ]
    assert max(worst) < 0.1


def test_long_run_controls() -> None:
    """HK fails the same test by far for each integral, and so does midpoint for Kowalevski's k²."""
    top, y0 = random_heavy_tops(1, seed=8)[0], random_states(1, seed=9)[0]
    for name in ("gamma_sq", "m_gamma", "energy"):
        assert 760000.0 < over_bound(top, stepper(top, "hk"), y0, 0.01, (name,)) < 3e7
    kowalevski = Kowalevski()
    assert over_bound(kowalevski, stepper(kowalevski), GEN, 0.05, ("gamma_sq", "two_l", "energy")) < 0.3
    assert over_bound(kowalevski, stepper(kowalevski), GEN, 0.05, ("k_sq",)) == pytest.approx(2.57e08, rel=0.05)


def test_which_invariants_are_quadratic() -> None:
    for top in (Kowalevski(), Kowalevski(c0=-3.0, A=0.1)):
        assert polynomial_invariants(top, 1) == ()
        assert polynomial_invariants(top, 2) == polynomial_invariants(top, 3) == ("gamma_sq", "two_l", "energy")
        assert polynomial_invariants(top, 4) == ("gamma_sq", "two_l", "energy", "k_sq")
    assert polynomial_invariants(Heavy(), 2) == ("gamma_sq", "m_gamma", "energy")


def test_self_adjoint_from_states_of_all_sizes() -> None:
    for top in random_heavy_tops(10, seed=10):
        p = top.constants()
        for y in random_states(10, seed=11) * np.repeat((5.0, 1.0), 3):
            for h in (0.2, 1e-3):
                there = midpoint(tuple(y), h, p)
                back = midpoint(there[:6], -h, p)
                assert there[6] == back[6] == 0.0
                assert np.abs(np.array(back[:6]) - y).max() < 64 * EPS * np.abs(y).max()


@pytest.mark.parametrize("y", [(0.0,) * 6, (0.0, 0.0, 0.0, 0.6, 0.0, 0.8), (0.0, 0.0, 2.0, 0.6, 0.0, 0.8), PAPER])
@pytest.mark.parametrize("h", [1e-9, 0.1])
def test_equilibria_and_special_states_settle(y: Floats, h: float) -> None:
    for p in ((1.0, 1.0, 1.0, 0.6, 0.0, 0.8), (2.0, 2.0, 1.0, 0.0, 0.0, 0.0), (2.0, 2.0, 1.0, 1.0, 0.0, 0.0)):
        assert midpoint(y, h, p)[6] == 0.0


def test_hanging_top_stays_at_rest() -> None:
    """Gamma along g at rest is an equilibrium; the step leaves it where it is, to the last bit."""
    y = (0.0, 0.0, 0.0, 0.0, 0.0, -1.0)
    assert midpoint(y, 0.1, (2.0, 1.5, 1.0, 0.0, 0.0, 3.0))[:6] == y


def test_a_step_that_does_not_converge_ends_the_run_as_such() -> None:
    """An h with no hope: the outcome, the step, the rows before it, compiled and interpreted alike."""
    top, y0, h = Heavy(A=3.0, B=2.0, C=1.2, x0=40.0, y0=-30.0, z0=60.0), (9.0, -8.0, 7.0, 0.6, 0.48, 0.64), 7.0
    run = Run(top, made := stepper(top), y0, h, 1000)
    states = run.collect().states
    assert run.ending is not None
    assert (run.ending.outcome, run.ending.step, len(states)) == (Outcome.NO_CONVERGENCE, 2, 2)
    assert np.isfinite(states).all()
    assert run.ending.counters["iterations"] == 35  # 10 in the first step, and all 25 in the second
    assert run.ending.message.startswith(f"did not converge at step {run.ending.step}")
    enter, drive = plain_loop(made, 6, 6)
    work, out, p = np.zeros(made.width), np.zeros(6000), np.array(top.constants())
    enter(np.array(y0), work, p, h)
    assert drive(work, out, p, h, 1000, 1, 1) == -run.ending.step
    assert math.isnan(work[made.width - 2])


def test_blow_up_is_not_reported_as_no_convergence() -> None:
    run = Run(Kowalevski(), RK2, (1e200, 1e200, 0.0, 0.6, 0.48, 0.64), 1.0, 10)
    list(run)
    assert run.ending is not None
    assert run.ending.outcome is Outcome.BLEW_UP


def test_iterations_are_counted() -> None:
    run = Run(Heavy(), stepper(Heavy()), GEN, 0.01, 1000)
    list(run)
    assert run.ending is not None
    assert 2000 <= run.ending.counters["iterations"] <= 4000


def test_inertial_form_of_lagranges_top_is_the_same_rule() -> None:
    """The midpoint rule of m' = p x a, a' = m x a, with its quadratic integrals m.p, m.a, a², m²/2 + a.p."""
    h, up, made = 0.1, [0.0, 0.0, 1.0], stepper(LagrangeInertial())
    assert made.enter is not None
    assert made.leave is not None
    for y in random_states(20, seed=12):
        y = tuple(map(float, y))
        working = made.enter(y, h, ())
        assert made.leave(working, h, ()) == y
        new = made.leave(made.step(working, h, ()), h, ())
        m, a = [[(u + v) / 2 for u, v in zip(y[k : k + 3], new[k : k + 3], strict=True)] for k in (0, 3)]
        assert [v - u for u, v in zip(y[:3], new[:3], strict=True)] == pytest.approx(
            [h * x for x in cross(up, a)], rel=1e-14, abs=1e-15
        )
        assert [v - u for u, v in zip(y[3:], new[3:], strict=True)] == pytest.approx(
            [h * x for x in cross(m, a)], rel=1e-14, abs=1e-15
        )
