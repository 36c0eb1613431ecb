"""The checks of the claims reject wrong statements, and the transcribed formulas are those of the paper."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np
import pytest

from topcli.paper import checks, formulas
from topcli.paper.numbers import I_UNIT, MP, Draws, exact, plane, unit_complex, vector_product
from topcli.tops.euler import Euler

WRONG = "does not hold as stated"


def xi_turns_back(w: Any, c: Any, c0: Any) -> Any:
    """(Kxi) with the opposite sign."""
    rate = 2 * plane(w) * formulas.complex_omega(c0, plane(w), w[2], c[2])[0]
    rate -= c0 * formulas.complex_gamma(plane(w), w[2], plane(c), c[2])[0]
    return [rate - I_UNIT * w[2] * formulas.xi(c0, w, c)]


def dependent(w: Any, c: Any) -> Any:
    return exact(c @ c, c[0], c[0] * c[0])


def square_of_another(kowalevski_top: Any, w: Any, c: Any) -> Any:
    return exact(*formulas.kowalevski_integrals(kowalevski_top, w, c)[:3], (c @ c) * (c @ c))


def implicit_b(new: Any, w: Any) -> Any:
    """The rate of z at the new z."""
    return [plane(new) - formulas.stereographic_rate(plane(w), w[2], plane(new))]


def implicit_c(new: Any, turn: Any, c: Any) -> Any:
    """A rotation about an axis that depends on the new gamma."""
    return new - formulas.rotation(new, *turn) @ c


def implicit_bohlin(new: Any, c0: Any, turn: Any, old: Any, e: Any) -> Any:
    """The root as the unknown."""
    return [formulas.bohlin_equation(c0, plane(turn), old, exact(*new, 0, *e))]


def method_a(c0: Any, h: Any, old: Any, new: Any) -> Any:
    """Method (A), whose omega is the old one: of order 1 and not symmetric."""
    return formulas.bs(h, old[3:], new[3:], old[:3])


def still(old: Any, new: Any) -> Any:
    return old[:3]


def euler_rule(c0: Any, h: Any, old: Any, new: Any) -> Any:
    """Bohlin's equation with the old angular velocity alone."""
    return [formulas.bohlin_equation(c0, unit_complex(-h * old[2]), old, new)]


ROUND = "rational top.A=1 top.B=1 top.C=1"
EULER = {"A": "A", "B": "B", "C": "C"}
CROSSING = [[-0.8, 1e-3 * k, 0.5, 0.6, -0.48, -0.64] for k in range(40)]
BY_SIGN = {"name": "bohlin-a", "branch": "sign"}


STATEMENTS: dict[str, Callable[[], checks.Measured]] = {
    "xi turns back": lambda: checks.identity(xi_turns_back),
    "midpoint rule explicit": lambda: checks.linear(formulas.midpoint_rule),
    "implicit forms of B explicit": lambda: checks.linear(implicit_b, 2),
    "implicit form of C explicit": lambda: checks.linear(implicit_c),
    "root explicit": lambda: checks.linear(implicit_bohlin, 2),
    "BS implicit": lambda: checks.linear(formulas.bs, sense=False),
    "functions of gamma independent": lambda: checks.independent(dependent, 3),
    "square of an integral independent": lambda: checks.independent(square_of_another, 4),
    "Kowalevski's integrals too few": lambda: checks.independent(formulas.kowalevski_integrals, 4, sense=False),
    "precession elliptic": lambda: checks.elliptic("lagrange_bs rational", 0),
    "upright top elliptic": lambda: checks.elliptic("lagrange_bs rational initial.m=[0,0,1] initial.a=[0,0,1]", 0),
    "HK conserves m²": lambda: checks.conserved("euler_hk rational N=10", ["m_sq"]),
    "HK of a round body conserves m²": lambda: checks.conserved(f"euler_hk {ROUND} N=3", ["m_sq"]),
    "midpoint violates m²": lambda: checks.conserved("euler_hk scheme=midpoint fifty N=10", ["m_sq"], sense=False),
    "HK conserves k²": lambda: checks.formula_conserved(
        "kowalevski_hk fifty N=10 generic", formulas.k_squared, formulas.k_squared_hybrid
    ),
    "RK2 reversible": lambda: checks.reversible("heavy_hk scheme=rk2 rational"),
    "BS of a round body reversible": lambda: checks.reversible(f"euler_bs {ROUND}"),
    "HK irreversible": lambda: checks.reversible("euler_hk rational N=10", sense=False),
    "BS is HK": lambda: checks.same_map("euler_bs rational", "euler_hk rational", EULER),
    "BS of a round body is HK": lambda: checks.same_map(f"euler_bs {ROUND}", "euler_hk rational", EULER),
    "method A symmetric": lambda: checks.solves("kowalevski_bohlin_a fifty generic", method_a, reverse=True),
    "rest stays": lambda: checks.solves("kowalevski_bohlin_a fifty N=1 initial.omega=[0,0,0]", still),
    "energy of BS of order 2": lambda: checks.deviation_order("euler_bs", "m_omega", 2),
    "BS of order 2": lambda: checks.convergence_order("euler_bs", 2),
    "method A of order 2": lambda: checks.equation_order("kowalevski_hk generic", method_a, 2),
    "Euler's rule of order 2": lambda: checks.equation_order("kowalevski_hk generic", euler_rule, 2),
    "range at another h": lambda: checks.extremes("kowalevski_hk h=0.002 N=25000", "k_sq", 9.000003, 9.000011, 1e-6),
    "energy of BS small": lambda: checks.small("euler_bs", ["m_omega"]),
    "RK2 as good as RK4": lambda: checks.quality(["heavy_hk scheme=rk2", "heavy_hk scheme=rk4"], ["energy"]),
    "energy of Bohlin A returns": lambda: checks.oscillates(["kowalevski_bohlin_a"], "energy"),
    "k² of HK rises": lambda: checks.rises("kowalevski_hk", "k_sq"),
    "Figure 2 is Figure 1": lambda: checks.same_picture("kowalevski_hk", ["kowalevski_bohlin_a"]),
    "RK4 differs from HK": lambda: checks.same_picture("kowalevski_hk", ["kowalevski_hk scheme=rk4"], sense=False),
    "omega3 constant": lambda: checks.straight_line("kowalevski_bohlin_a", "omega3", 6.0),
    "HK has another period": lambda: checks.other_period(["kowalevski_hk"]),
    "Lagrange's top chaotic": lambda: checks.neighbours_part("lagrange_bs scheme=taylor N=5000"),
    "backlund chaotic": lambda: checks.neighbours_part("kowalevski_hk scheme=backlund h=0.4 N=2000", pairs=32),
    "angle not halved": lambda: checks.root_angles(1.0, 1, right=1),
    "quarter turns": lambda: checks.root_angles(0.5, 4, right=2),
    "sign chooses the root": lambda: checks.right_root({"h": 0.2, "N": 2, "scheme": BY_SIGN, "states": CROSSING}),
}


@pytest.mark.slow
@pytest.mark.parametrize("statement", STATEMENTS)
def test_wrong_statement_is_rejected(statement: str) -> None:
    assert STATEMENTS[statement]().verdict == WRONG


@pytest.mark.slow
@pytest.mark.parametrize("name", ["top_integrals", "euler_integrals", "lagrange_integrals", "kowalevski_integrals"])
def test_law_with_another_term_is_rejected(name: str) -> None:
    """Each integral is conserved, but not plus omega_1."""
    integrals = getattr(formulas, name)

    @wraps(integrals)
    def spoilt(**point: Any) -> Any:
        return integrals(**point) + point["w"][0]

    for law in range(len(integrals(**Draws(1).point(integrals)))):
        assert checks.identity(integrals, law).verdict == "holds"
        assert checks.identity(spoilt, law).figure > 1e-3


def test_rounding_of_an_exact_law_may_grow_with_the_steps() -> None:
    """A thousand roundings a step, each of half a unit in the last of the 169 bits that hold 50 digits."""
    assert checks.law("euler_hk scheme=midpoint fifty", 0.0, 4).limit == pytest.approx(4e3 * 2.0**-169, rel=1e-12)
    assert checks.law("euler_hk rational", 0.0, 4).limit == 0.0


# pictures, the Jacobian


def test_distance_between_pictures() -> None:
    """Two horizontal lines 0.3 mm apart, and one with a bump of 2 mm."""
    x = np.linspace(0.0, 45.0, 500)
    flat, bump = np.zeros_like(x), 2.0 * np.exp(-((x - 20.0) ** 2))
    lines = [checks.resampled(x, y) for y in (flat, flat + 0.3, bump)]
    assert checks.curve_distance(lines[0], lines[1]) == pytest.approx(0.3, abs=0.01)
    assert checks.curve_distance(lines[2], lines[0]) == pytest.approx(2.0, abs=0.02)


def test_jacobian_norm() -> None:
    """Euler's field at omega = (0, 0, w): a 2x2 block with entries w (B - C)/A and w (C - A)/B."""
    states = np.array([[0.0, 0.0, 2.0], [0.0, 0.0, -3.0]])
    assert checks.jacobian_norm(Euler(A=3.0, B=2.0, C=1.0), states) == pytest.approx(3.0, rel=1e-12)


# printed equations against formulas of NumPy

I, G, W, V, C, E = np.random.default_rng(5).uniform(0.5, 2.0, (6, 3))  # noqa: E741
H, C0 = 0.3, 1.7
OMEGA, GAMMA = complex(W[0], W[1]), complex(C[0], C[1])
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
        ("free_top", (I, W), np.cross(I * W, W)),
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
        ("kowalevski_laws", (C0, W, C), [C @ C, [2, 2, 1] * W @ C, [1, 1, 0.5] @ W**2 + C0 * C[0], abs(XI) ** 2]),
        ("k_squared_hybrid", (C0, W, C), abs(OMEGA - C0 * GAMMA) ** 2),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_printed_formulas_are_those_of_numpy(formula: str, arguments: Any, expected: Any) -> None:
    """Each with all of its terms, written independently."""
    numbers = (exact(*map(MP.mpf, x)) if isinstance(x, np.ndarray) else MP.mpf(x) for x in arguments)
    values = np.array(getattr(formulas, formula)(*numbers), dtype=float)
    np.testing.assert_allclose(values, np.array(expected, dtype=float), rtol=1e-13, atol=1e-14)


def test_hat_has_the_sign_of_the_paper() -> None:
    u, v = exact(1, 2, 3), exact(5, 7, -4)
    assert (formulas.commutator(formulas.hat(u), formulas.hat(v)) == formulas.hat(vector_product(v, u))).all()
