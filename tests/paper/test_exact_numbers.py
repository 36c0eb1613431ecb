"""Exact numbers, ranks, random points and printed formulas of the ledger, and its scenes."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from topcli.arithmetic.elimination import linear_solution, row_reduced
from topcli.errors import RunError
from topcli.paper import identities, printed
from topcli.paper.algebra import DRAWN, I_UNIT, Draws, Dual, Gauss, arguments, commutator, cross, exact
from topcli.paper.exact_checks import conservation
from topcli.paper.scenes import LedgerScene


def test_gaussian_rationals_are_complex_numbers() -> None:
    a, b = Gauss(Fraction(3), Fraction(-2)), Gauss(Fraction(1, 4), Fraction(5))
    x, y = 3 - 2j, 0.25 + 5j
    pairs = (a + b, x + y), (a - b, x - y), (a * b, x * y), (a / b, x / y), (2 - a, 2 - x), (3 * b, 3 * y), (-a, -x)
    for pair, expected in (*pairs, (a.bar, 3 + 2j), (I_UNIT * a, 1j * x), (a / 2, x / 2)):
        assert complex(float(pair.first), float(pair.second)) == pytest.approx(expected, rel=1e-15)


def test_duals_follow_the_rules_of_differentiation() -> None:
    """d/dt of f(x, y) with x' = 2, y' = -3, by hand."""
    x, y = Dual(Fraction(5), Fraction(2)), Dual(Fraction(7), Fraction(-3))
    assert (x * y).second == 2 * 7 - 3 * 5
    assert (x / y) == Dual(Fraction(5, 7), Fraction(2 * 7 + 3 * 5, 49))
    assert (x * x - 4 * y + 1).second == 2 * 5 * 2 + 12
    assert (1 - x).second == -2
    moving = exact(x, y) * exact(2, 3) - y * exact(x, 1)
    assert [value.second for value in moving] == [2 * 2 - (2 * 7 - 3 * 5), 3 * -3 + 3]


def test_draws_are_exact_and_repeatable() -> None:
    draws, again = Draws(7), Draws(7)
    for _ in range(20):
        assert (unit := draws.unit()) @ unit == 1
        c, s = draws.circle()
        assert c * c + s * s == 1
        again.unit()
        assert again.circle().tolist() == [c, s]


@pytest.mark.parametrize("name", ["moments", "top", "euler_top", "lagrange_top", "kowalevski_top"])
def test_tops_are_drawn_with_many_moments(name: str) -> None:
    """An identity is tried with 15 triples of moments or more, of which 10 differ in C; gravity is that of the top."""
    draws = Draws(1)
    drawn = [DRAWN[name](draws) for _ in range(20)]
    moments = [tuple(top if name == "moments" else top[0]) for top in drawn]
    assert all(moment > 0 for triple in moments for moment in triple)
    assert len(set(moments)) >= 15
    assert len({triple[2] for triple in moments}) >= 10
    shape = {"euler_top": (0, 0, 0), "lagrange_top": (0, 0, 1), "kowalevski_top": (1, 0, 0)}.get(name, (1, 1, 1))
    assert name == "moments" or {tuple(int(x != 0) for x in gravity) for _, gravity in drawn} == {shape}
    relation = {"lagrange_top": lambda A, B, C: A == B, "kowalevski_top": lambda A, B, C: A == B == 2 * C}.get(name)
    assert relation is None or all(relation(*triple) for triple in moments)


def test_rank_of_rational_matrices() -> None:
    assert row_reduced([[1, 2, 3], [2, 4, 6]]) == ([[1, 2, 3]], [0])
    assert row_reduced([[0, 2, 0], [1, 0, 3]]) == ([[1, 0, 3], [0, 1, 0]], [0, 1])
    assert row_reduced([[0, 0], [0, 0]]) == ([], [])
    assert linear_solution([[0, 2, 1], [3, 1, 1]]) == [Fraction(1, 6), Fraction(1, 2)]
    assert linear_solution([[1, 2, 1], [2, 4, 3]]) is None


def test_the_hat_has_the_sign_of_the_paper() -> None:
    u, v = exact(1, 2, 3), exact(5, 7, -4)
    assert (commutator(printed.hat(u), printed.hat(v)) == printed.hat(cross(v, u))).all()
    assert cross(exact(1, 0, 0), exact(0, 1, 0)).tolist() == [0, 0, 1]


# printed equations against formulas of NumPy

I, G, W, V, C, E = np.random.default_rng(5).uniform(0.5, 2.0, (6, 3))  # noqa: E741
H, C0 = 0.3, 1.7
OMEGA, GAMMA = complex(W[0], W[1]), complex(C[0], C[1])
J = np.array([2.0, 2.0, 1.0])
XI = OMEGA**2 - C0 * GAMMA
K1 = np.array([W[1] * W[2], C0 * C[2] - W[2] * W[0], -2.0 * C0 * C[1]]) / 2.0


def hk(gravity: np.ndarray) -> np.ndarray:
    """HK of the heavy top: each product of the field by its polarisation."""
    omega = V - W - H / 2.0 * (np.cross(I * V, W) + np.cross(I * W, V) + np.cross(E + C, gravity)) / I
    return np.concatenate([omega, E - C - H / 2.0 * (np.cross(E, W) + np.cross(C, V))])


@pytest.mark.parametrize(
    ("formula", "arguments", "expected"),
    [
        ("euler", (I, G, W, C), np.cross(I * W, W) + np.cross(C, G)),
        ("euler_top", (I, W), np.cross(I * W, W)),
        ("poisson", (W, C), np.cross(C, W)),
        ("euler_poisson", (I, G, W, C), [np.cross(I * W, W) + np.cross(C, G), np.cross(C, W)]),
        ("laws", (I, G, W, C), [C @ C, (I * W) @ C, (I * W) @ W / 2.0 + G @ C]),
        ("hk_euler", (I, H, W, V), hk(np.zeros(3))[:3]),
        ("hk_heavy", (I, G, H, np.append(W, C), np.append(V, E)), hk(G)),
        ("bs", (H, C, E, W), E - C - H / 2.0 * np.cross(E + C, W)),
        ("midpoint", (H, C, E, W, V), E - C - H * np.cross((E + C) / 2.0, (V + W) / 2.0)),
        ("lagrange_l1", (H, W, V, C), V - W - H * np.array([-C[1], C[0], 0.0])),
        ("lagrange_l2", (H, V, C, E), E - C - H * np.cross(V, (C + E) / 2.0)),
        ("kowalevski", (C0, W, C), [K1, np.cross(C, W)]),
        ("kowalevski_laws", (C0, W, C), [C @ C, J * W @ C, J @ W**2 / 2 + C0 * C[0], abs(XI) ** 2]),
        ("k_squared_hybrid", (C0, W, C), abs(OMEGA - C0 * GAMMA) ** 2),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)  # fmt: skip
def test_printed_formulas_are_those_of_numpy(formula: str, arguments: Any, expected: Any) -> None:
    """Each with all of its terms, written independently."""
    given = (exact(*value) if isinstance(value, np.ndarray) else value for value in arguments)
    found = np.array(getattr(printed, formula)(*given), dtype=float)
    np.testing.assert_allclose(found, np.array(expected, dtype=float), rtol=1e-13, atol=1e-14)


def test_the_misprint_is_one_half_of_a_term() -> None:
    """Both states equal, the printed last line gives (gamma_1 omega_2 - gamma_2 omega_1)/2 instead of twice that."""
    state, one = exact(1, 2, 3, 5, 7, 11) * Fraction(1), exact(1, 1, 1) * Fraction(1)
    for as_printed, factor in ((True, Fraction(1, 2)), (False, Fraction(1))):
        left = printed.hk_heavy(one, 0 * one, Fraction(1), state, state, as_printed)
        assert -left[5] == factor * (5 * 2 - 7 * 1)
        assert left[:5].tolist() == printed.hk_heavy(one, 0 * one, Fraction(1), state, state)[:5].tolist()


def test_epsilon_has_to_be_a_grassmann_symbol() -> None:
    """With a number for epsilon (Audin) fails by -epsilon² [G, M]."""
    hat = {name: printed.hat(v).astype(float) for name, v in (("M", I * W), ("G", G), ("W", W), ("C", C))}
    m_rate, c_rate = np.cross(I * W, W) + np.cross(C, G), np.cross(C, W)
    for eps in (0.5, 0.1):
        left = printed.hat(c_rate).astype(float) + eps * printed.hat(m_rate).astype(float)
        right = commutator(hat["W"] + eps * hat["G"], hat["C"] + eps * hat["M"])
        assert left - right == pytest.approx(-(eps**2) * commutator(hat["G"], hat["M"]), rel=1e-12, abs=1e-14)


def test_every_formula_of_the_ledger_can_be_drawn() -> None:
    """The names of the parameters of identities, integrals and equations are all variables."""
    for name, function in vars(identities).items():
        if getattr(function, "__module__", "") == identities.__name__ and not name.startswith("_"):
            known = {"new", "functions"}
            assert set(arguments(function)) - known <= set(DRAWN), name


# scenes


def test_scenes_are_shown_as_commands_and_overrides_replace() -> None:
    scene = LedgerScene("euler_hk", ("h=0.1", "initial.omega=[1, 2, 3]"))
    assert str(scene) == "topcli run euler_hk --set h=0.1 --set 'initial.omega=[1, 2, 3]'"
    assert scene.with_sets("h=0.2", "N=3").sets == ("initial.omega=[1, 2, 3]", "h=0.2", "N=3")
    assert LedgerScene.read("euler_hk h=0.1 N=3") == LedgerScene("euler_hk", ("h=0.1", "N=3"))


def test_a_run_that_fails_is_no_verdict() -> None:
    """The state blows up: the experiment has failed, not the claim."""
    with pytest.raises(RunError, match=r"euler_bs: stopped at step .* more digits than max_digits"):
        conservation(LedgerScene.read("euler_bs rational N=30 max_digits=100"), ["m_sq"])


@pytest.mark.slow
def test_runs_in_doubles_are_carried_out_once() -> None:
    assert LedgerScene("euler_hk").trajectory() is LedgerScene("euler_hk").trajectory()
