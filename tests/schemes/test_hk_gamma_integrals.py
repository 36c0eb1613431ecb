"""The two integrals of the Hirota-Kimura map of the Euler top that involve gamma.

Expected values come from the formulas with the differences of moments in the denominators, in rational numbers.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from topcli.contracts import Invariant
from topcli.engine.loop import Run
from topcli.schemes.registry import find_scheme
from topcli.tops.euler import EulerGamma

BODIES = [(3.0, 2.0, 1.0), (1.0, 2.0, 2.5), (2.0, 1.0, 1.5), (1.0, 1.0 + 1e-9, 1.5), (2.0, 2.0, 1.0), (1.0, 1.0, 1.0)]
START = (0.7, -0.4, 1.3, 0.6, 0.48, 0.64)
NEXT = ((1, 2), (2, 0), (0, 1))
ULP = 2.0**-52


def top_of(moments: tuple[float, ...]) -> EulerGamma:
    A, B, C = moments
    return EulerGamma(A=A, B=B, C=C)


def integrals(top: EulerGamma, h: float) -> tuple[Invariant, Invariant]:
    scheme = find_scheme("hk", "euler+gamma")
    assert scheme.modified is not None
    found = {one.name: one for one in scheme.modified(top, h, scheme.options())}
    return found["modified_m_gamma"], found["modified_gamma_sq"]


def states(top: EulerGamma, name: str, h: float, N: int, start=START) -> np.ndarray:
    scheme = find_scheme(name, "euler+gamma")
    return Run(top, scheme.build(top, scheme.options()), start, h, N, 1).collect().states


def solved(matrix: list[list[Fraction]], right: list[Fraction]) -> list[Fraction]:
    """Solution of a linear system in rational numbers, by elimination."""
    rows = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    for i in range(3):
        pivot = next(r for r in range(i, 3) if rows[r][i] != 0)
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [value / rows[i][i] for value in rows[i]]
        for r in range(3):
            if r != i:
                rows[r] = [a - rows[r][i] * b for a, b in zip(rows[r], rows[i], strict=True)]
    return [row[3] for row in rows]


def rational_step(moments: list[Fraction], y: list[Fraction], h: Fraction) -> list[Fraction]:
    """One HK step: every product of two components becomes the mean of its two mixed products."""
    d = h / 2
    w, g = y[:3], y[3:]
    omega = [[Fraction(int(i == j)) for j in range(3)] for i in range(3)]
    for i, (j, k) in enumerate(NEXT):
        a = d * (moments[j] - moments[k]) / moments[i]
        omega[i][j] -= a * w[k]
        omega[i][k] -= a * w[j]
    new = solved(omega, w)
    gamma, right = [[Fraction(int(i == j)) for j in range(3)] for i in range(3)], list(g)
    for i, (j, k) in enumerate(NEXT):  # gamma' = gamma x omega
        gamma[i][j] -= d * w[k]
        gamma[i][k] += d * w[j]
        right[i] += d * (g[j] * new[k] - g[k] * new[j])
    return [*new, *solved(gamma, right)]


def rational_integrals(moments: list[Fraction], y: list[Fraction], h: Fraction) -> tuple[Fraction, Fraction]:
    """J and G by the formulas for distinct moments, divided by powers of K_1."""
    square = h * h / 4
    w, g = y[:3], y[3:]
    alpha = [(moments[j] - moments[k]) / moments[i] for i, (j, k) in enumerate(NEXT)]
    K = [1 - square * alpha[j] * alpha[k] * w[i] ** 2 for i, (j, k) in enumerate(NEXT)]
    Q = [(K[i] - K[j]) * (K[i] - K[k]) + alpha[j] * alpha[k] * K[j] * K[k] for i, (j, k) in enumerate(NEXT)]
    J, G, S = Fraction(0), Fraction(0), Fraction(0)
    for i, (j, k) in enumerate(NEXT):
        bracket = moments[k] * K[j] * (K[i] - K[j]) - moments[j] * K[k] * (K[i] - K[k])
        J += moments[i] * (K[j] * K[k] + bracket / (moments[k] - moments[j])) * w[i] * g[i]
        G += alpha[j] * alpha[k] * Q[j] * Q[k] * g[i] ** 2 / K[i]
        S += alpha[j] * alpha[k] * (alpha[i] * K[i] + K[j] - K[k]) * w[i] * g[i] / K[i]
    G += square * K[0] * K[1] * K[2] * S**2
    mean = sum(K) / 3
    product = alpha[0] * alpha[1] * alpha[2]
    return J / mean**3, G / (mean**4 * product**2)


def fractions(values) -> list[Fraction]:
    return [Fraction(value) for value in values]


@pytest.mark.parametrize("moments", [body for body in BODIES if len({*body}) == 3])
def test_integrals_equal_their_rational_formulas(moments) -> None:
    rng = np.random.default_rng(5)
    for h in (1e-3, 0.1, 0.5, -0.3):
        top, y = top_of(moments), rng.normal(size=6)
        for one, expected in zip(
            integrals(top, h), rational_integrals(fractions(moments), fractions(y), Fraction(h)), strict=True
        ):
            error = float(abs(Fraction(float(one.value(y[None])[0])) - expected))
            assert error < 20 * ULP * one.scale(y[None])[0]  # typically 1 ulp


def test_rational_orbit_conserves_both_integrals_exactly() -> None:
    rng = np.random.default_rng(6)
    for _ in range(5):
        moments = [Fraction(int(n), 7) for n in rng.permutation(np.arange(5, 10))[:3]]
        y = [Fraction(int(n), 10) for n in rng.integers(-12, 13, size=6)]
        first = rational_integrals(moments, y, Fraction(1, 3))
        m_gamma = sum(m * w * g for m, w, g in zip(moments, y, y[3:], strict=False))
        gamma_sq = sum(g * g for g in y[3:])
        for _ in range(3):
            y = rational_step(moments, y, Fraction(1, 3))
            assert rational_integrals(moments, y, Fraction(1, 3)) == first
        assert sum(m * w * g for m, w, g in zip(moments, y, y[3:], strict=False)) != m_gamma
        assert sum(g * g for g in y[3:]) != gamma_sq


@pytest.mark.parametrize("moments", BODIES)
def test_integrals_are_conserved_to_round_off(moments) -> None:
    N, h = 10000, 0.1
    top = top_of(moments)
    y = states(top, "hk", h, N)
    for one in integrals(top, h):
        value = one.value(y)
        assert np.max(np.abs(value - value[0])) < 50 * ULP * np.sqrt(N) * one.scale(y).max()


def test_midpoint_does_not_conserve_them() -> None:
    """The defects, 7e-3 and 3e-3, are those of the rational formulas along the same orbit."""
    h = 0.1
    moments, y = fractions(BODIES[0]), states(top_of(BODIES[0]), "midpoint", h, 40)
    first, last = (rational_integrals(moments, fractions(row), Fraction(h)) for row in (y[0], y[-1]))
    for one, a, b in zip(integrals(top_of(BODIES[0]), h), first, last, strict=True):
        defect = float(one.value(y[-1:])[0] - one.value(y[:1])[0])
        assert defect == pytest.approx(float(b - a), rel=1e-9)
        assert abs(defect) > 1e-3


def test_integrals_tend_to_those_of_the_motion() -> None:
    top, y = top_of(BODIES[3]), np.array([START])
    m_gamma = 0.7 * 0.6 - 0.4 * 0.48 * (1.0 + 1e-9) + 1.5 * 1.3 * 0.64
    for h in (1e-2, 1e-3, 1e-12):
        J, G = (float(one.value(y)[0]) for one in integrals(top, h))
        assert abs(J - m_gamma) < h * h + 1e-15
        assert abs(G - 1.0) < h * h + 1e-15


def test_gamma_is_bounded_where_the_form_is_definite_and_grows_where_it_is_not() -> None:
    """For A, B, C = 3, 2, 1: alpha_2 alpha_3, alpha_3 alpha_1, alpha_1 alpha_2 = -1, 1/3, -1/3."""
    products = np.array([-1.0, 1 / 3, -1 / 3])
    lengths = {}
    for h in (4.0, 5.0):
        K = 1 - h**2 / 4 * products * np.array(START[:3]) ** 2
        Q = np.array([(K[i] - K[j]) * (K[i] - K[k]) + products[i] * K[j] * K[k] for i, (j, k) in enumerate(NEXT)])
        assert np.all(K > 0)
        y = states(top_of(BODIES[0]), "hk", h, 1500)
        lengths[bool(np.all(Q / products > 0))] = np.abs(y[:, 3:]).max()
    assert lengths[True] == pytest.approx(2.1, abs=0.8)
    assert lengths[False] > 1e100
