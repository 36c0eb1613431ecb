"""Exact numbers, ranks and distances of the ledger, and its scenes."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from topcli.paper import printed
from topcli.paper.algebra import I_UNIT, Draws, Dual, Gauss, commutator, cross, dot
from topcli.paper.kinds import motion, pictures, rank
from topcli.paper.scenes import Scene, trajectory
from topcli.tops.euler import Euler


def test_gaussian_rationals_are_complex_numbers() -> None:
    a, b = Gauss(Fraction(3), Fraction(-2)), Gauss(Fraction(1, 4), Fraction(5))
    x, y = 3 - 2j, 0.25 + 5j
    pairs = (a + b, x + y), (a - b, x - y), (a * b, x * y), (a / b, x / y), (2 - a, 2 - x), (3 * b, 3 * y), (-a, -x)
    for found, expected in (*pairs, (a.bar, 3 + 2j), (I_UNIT * a, 1j * x), (a / 2, x / 2)):
        assert complex(float(found.re), float(found.im)) == pytest.approx(expected, rel=1e-15)


def test_duals_follow_the_rules_of_differentiation() -> None:
    """d/dt of f(x, y) with x' = 2, y' = -3, by hand."""
    x, y = Dual(Fraction(5), Fraction(2)), Dual(Fraction(7), Fraction(-3))
    assert (x * y).rate == 2 * 7 - 3 * 5
    assert (x / y).rate == Fraction(2 * 7 + 3 * 5, 49)
    assert (x * x - 4 * y + 1).rate == 2 * 5 * 2 + 12
    assert (1 - x).rate == -2


def test_draws_are_exact_and_repeatable() -> None:
    draws, again = Draws(7), Draws(7)
    for _ in range(20):
        assert dot(unit := draws.unit(), unit) == 1
        c, s = draws.circle()
        assert c * c + s * s == 1
        again.unit()
        assert again.circle() == (c, s)


def test_the_hat_has_the_sign_of_the_paper() -> None:
    u, v = (1, 2, 3), (5, 7, -4)
    assert commutator(printed.hat(u), printed.hat(v)) == printed.hat(cross(v, u))
    assert cross((1, 0, 0), (0, 1, 0)) == (0, 0, 1)


def test_rank_of_rational_matrices() -> None:
    assert rank.rank([[1, 2, 3], [2, 4, 6]]) == 1
    assert rank.rank([[0, 1, 0], [1, 0, 0], [0, 0, 1]]) == 3
    assert rank.rank([[0, 0], [0, 0]]) == 0


@pytest.mark.slow
def test_distance_between_pictures() -> None:
    """Two horizontal lines 0.3 mm apart, and one with a bump of 2 mm."""
    x = np.linspace(0.0, 45.0, 500)
    flat, bump = np.zeros_like(x), 2.0 * np.exp(-((x - 20.0) ** 2))
    lines = [pictures._resampled(x, y) for y in (flat, flat + 0.3, bump)]
    assert pictures._apart(lines[0], lines[1]) == pytest.approx(0.3, abs=0.01)
    assert pictures._apart(lines[0], lines[2]) == pytest.approx(2.0, abs=0.02)
    assert pictures._apart(lines[2], lines[0]) == pictures._apart(lines[0], lines[2])


def test_rate_of_change_is_the_norm_of_the_jacobian() -> None:
    """Euler's field at omega = (0, 0, w): a 2x2 block with entries w (B - C)/A and w (C - A)/B."""
    states = np.array([[0.0, 0.0, 2.0], [0.0, 0.0, -3.0]])
    assert motion.rate_of_change(Euler(A=3.0, B=2.0, C=1.0), states) == pytest.approx(3.0, rel=1e-12)


def test_scenes_are_shown_as_commands_and_overrides_replace() -> None:
    scene = Scene("euler_hk", ("h=0.1", "initial.omega=[1, 2, 3]"))
    assert str(scene) == "topcli run euler_hk --set h=0.1 --set 'initial.omega=[1, 2, 3]'"
    assert scene.with_sets("h=0.2", "N=3").sets == ("initial.omega=[1, 2, 3]", "h=0.2", "N=3")


def test_a_run_that_fails_is_no_verdict() -> None:
    """The state blows up: the experiment has failed, not the claim."""
    from topcli.errors import RunError
    from topcli.paper.kinds.conservation import conserved

    scene = Scene("euler_bs", ("precision=rational", "h=1/10", "N=30", "max_digits=100"))
    with pytest.raises(RunError, match=r"euler_bs: stopped at step .* more digits than max_digits"):
        conserved(scene, "m_sq")


@pytest.mark.slow
def test_runs_in_doubles_are_carried_out_once() -> None:
    assert trajectory(Scene("euler_hk")) is trajectory(Scene("euler_hk"))
