"""Kowalevski's formulas in 50 digits, and the closed form against theta functions of genus two at long times.

Along a motion (a_i - s1)(a_i - s2)/((a_j - s1)(a_j - s2)), with branch points a_i of the curve, is a constant times the
squared ratio of two theta functions with half characteristics, whose arguments grow linearly in time. Which
characteristics and signs belong to it is found from the double-double reference at three short times.
"""

from __future__ import annotations

from functools import cached_property
from itertools import product
from typing import Any

import mpmath as _mpmath
import numpy as np
import pytest

from conftest import GEN
from topcli.analysis.reference import reference_states
from topcli.contracts import Sampler
from topcli.schemes.registry import find_scheme
from topcli.tops.kowalevski import Kowalevski

mpmath: Any = _mpmath  # its annotations make every root complex
mpc, mpf = mpmath.mpc, mpmath.mpf
SHORT = (0.0, 0.37, 0.81)
CHARACTERISTICS = list(product((mpf(0), mpf(1) / 2), repeat=4))


def states(y0, h: float, n) -> np.ndarray:
    method = find_scheme("exact", "kowalevski").build(Kowalevski(), None)
    assert isinstance(method, Sampler)
    return method.states(np.array(y0, dtype=float), h, np.array(n, dtype=np.int64), (1.0,))


def roots_of(coefficients: list[Any]) -> list[Any]:
    """Roots of a polynomial with simple roots, from numpy's by Newton's method; the leading coefficient comes first."""
    found = []
    for start in np.roots([float(v) for v in coefficients]):
        x = mpc(complex(start))
        for _ in range(8):
            value = slope = mpc(0)
            for coefficient in coefficients:
                value, slope = value * x + coefficient, slope * x + value
            x -= value / slope
        found.append(x)
    return found


class RealCurve:
    """Curve of a motion with c = 1 whose branch points ``a`` are all real, and its integrals by quadrature."""

    def __init__(self, y) -> None:
        w1, w2, w3, g1, g2, g3 = map(mpf, y)
        self.l1 = (w1**2 + w2**2 + w3**2 / 2 + g1) / 3
        self.L = (2 * (w1 * g1 + w2 * g2) + w3 * g3) / 2
        self.G = g1**2 + g2**2 + g3**2
        self.k_sq = (w1**2 - w2**2 - g1) ** 2 + (2 * w1 * w2 - g2) ** 2
        k, l1 = mpmath.sqrt(self.k_sq), self.l1
        g_2, g_3 = self.k_sq - self.G + 3 * l1**2, l1 * (self.k_sq - self.G - l1**2) + self.L**2
        self.cubic = roots_of([mpf(4), mpf(0), -g_2, -g_3])
        self.e4, self.e5 = (l1 + k) / 2, (l1 - k) / 2

    @cached_property
    def a(self) -> list[Any]:
        """Branch points in ascending order."""
        assert all(abs(mpmath.im(e)) < mpf(10) ** (-mpmath.mp.dps + 5) for e in self.cubic)
        return sorted([*map(mpmath.re, self.cubic), self.e4, self.e5])

    def R(self, x: Any) -> Any:
        """Kowalevski's polynomial."""
        return -(x**4) + 6 * self.l1 * x**2 - 4 * self.L * x + self.G - self.k_sq

    def separated(self, y) -> tuple[Any, Any]:
        """Kowalevski's variables s1 > s2 of a state with omega2 != 0."""
        w1, w2 = mpf(y[0]), mpf(y[1])
        n = w1**2 + w2**2
        R12 = -(n**2) + 6 * self.l1 * n - 4 * self.L * w1 + self.G - self.k_sq
        size = abs(self.R(mpc(w1, w2)))
        return self.l1 / 2 + (size - R12) / (8 * w2**2), self.l1 / 2 - (size + R12) / (8 * w2**2)

    def between(self, low: Any, high: Any) -> Any:
        """Integrals of ds/|w| and s ds/|w|, w² = -4 prod (s - a_i), between two points without branch points inside."""

        def density(theta: Any, k: int) -> Any:
            s = low + (high - low) * mpmath.sin(theta) ** 2
            rest = mpf(1)
            for a in self.a:
                # a factor (s - low)(high - s) is that of the substitution
                rest *= abs(s - a) if a not in (low, high) else mpf(1)
            ends = [end for end in (low, high) if end not in self.a]
            jacobian = mpmath.sqrt(abs(mpmath.fprod(s - end for end in ends)))
            return s**k * jacobian / mpmath.sqrt(rest)

        points = [mpf(0), mpmath.pi / 8, mpmath.pi / 4, 3 * mpmath.pi / 8, mpmath.pi / 2]
        return mpmath.matrix([mpmath.quad(lambda th, k=k: density(th, k), points) for k in (0, 1)])

    def to_infinity(self) -> Any:
        """The same from minus infinity to the lowest branch point, without the second integral's factor s."""
        first = self.a[0]

        def density(theta: Any, k: int) -> Any:
            S, C = mpmath.sin(theta), mpmath.cos(theta)
            rest = mpmath.fprod((a - first) * C**2 + S**2 for a in self.a[1:])
            return (first * C**2 - S**2) ** k * C ** (2 - 2 * k) / mpmath.sqrt(rest)

        return mpmath.matrix(
            [mpmath.quad(lambda th, k=k: density(th, k), [0, mpmath.pi / 4, mpmath.pi / 2]) for k in (0, 1)]
        )


class Theta:
    """Theta functions along the motion from the state ``y``."""

    def __init__(self, y) -> None:
        self.curve = curve = RealCurve(y)
        a = curve.a
        p = [curve.between(a[j], a[j + 1]) for j in range(4)]
        A, B = mpmath.matrix(2, 2), mpmath.matrix(2, 2)
        for i in (0, 1):
            A[i, 0], A[i, 1] = 2j * p[0][i], -2j * p[2][i]
            B[i, 0], B[i, 1] = 2 * (p[3][i] - p[1][i]), 2 * p[3][i]
        self.inverse = A**-1
        self.tau = self.inverse * B
        if mpmath.im(self.tau[0, 0]) < 0:
            self.tau = -self.tau
        self.Y = self.tau.apply(mpmath.im)
        s1, s2 = curve.separated(y)
        self.begun = curve.between(a[3], s1), curve.between(s2, a[0])

    def ratios(self, at: tuple[Any, Any]) -> list[Any]:
        """(a_i - s1)(a_i - s2)/((a_4 - s1)(a_4 - s2)) for i = 0..3."""
        each = [(a - at[0]) * (a - at[1]) for a in self.curve.a]
        return [one / each[4] for one in each[:4]]

    def squares(self, signs: tuple[int, int], t: Any) -> list[Any]:
        """Squared theta functions of all characteristics at the time ``t``, up to a common factor."""
        v = signs[0] * self.begun[0] + signs[1] * self.begun[1]
        z = self.inverse * mpmath.matrix([v[0], v[1] + t])
        whole = (self.Y**-1 * z.apply(mpmath.im)).apply(mpmath.nint)
        z = z - self.tau * whole
        return [self._theta(c, z) ** 2 for c in CHARACTERISTICS]

    def _theta(self, c: tuple[Any, ...], z: Any) -> Any:
        t, total = self.tau, mpc(0)
        for n, m in product(range(-9, 10), repeat=2):
            u, v = n + c[0], m + c[1]
            quadratic = u * u * t[0, 0] + 2 * u * v * t[0, 1] + v * v * t[1, 1]
            total += mpmath.exp(1j * mpmath.pi * (quadratic + 2 * (u * (z[0] + c[2]) + v * (z[1] + c[3]))))
        return total


def identified(theta: Theta, y) -> tuple[tuple[int, int], list[tuple[int, int]]]:
    """Signs of the initial integrals and, for each ratio, the numbers of its two characteristics."""
    reference = reference_states(Kowalevski(), list(y), np.array(SHORT))
    wanted = [theta.ratios(theta.curve.separated(state)) for state in reference]
    for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        squares = [theta.squares(signs, mpf(t)) for t in SHORT]
        pairs: list[tuple[int, int]] = []
        for i in range(4):
            for top, below in product(range(16), repeat=2):
                values = [one[top] / one[below] / want[i] for one, want in zip(squares, wanted, strict=True)]
                if max(abs(v / values[0] - 1) for v in values[1:]) < 1e-9:
                    pairs.append((top, below))
                    break
        if len(pairs) == 4:
            return signs, pairs
    raise AssertionError("no characteristics fit")


@pytest.mark.slow
def test_theta_functions_at_long_times() -> None:
    """At t = 1e6 and 1e8; typical differences 1e-14. A phase off by 1e-9 shows as much."""
    with mpmath.workdps(30):
        theta = Theta(GEN)
        assert abs(theta.tau[0, 1] - theta.tau[1, 0]) < 1e-25  # Riemann's bilinear relation
        signs, pairs = identified(theta, GEN)
        begin = theta.squares(signs, mpf(0))
        start = theta.ratios(theta.curve.separated(GEN))

        def difference(t: int, late: float = 0.0) -> float:
            now = theta.squares(signs, mpf(t) + mpf(late))
            found = theta.ratios(theta.curve.separated(states(GEN, 0.5, [2 * t])[0]))
            expected = [
                value * now[top] / now[below] / (begin[top] / begin[below])
                for value, (top, below) in zip(start, pairs, strict=True)
            ]
            return max(float(abs(one - other) / (1 + abs(one))) for one, other in zip(expected, found, strict=True))

        for t in (100, 10**6, 10**8):
            assert difference(t) < 1e-12
        assert 1e-11 < difference(10**6, 1e-9) < 1e-6


@pytest.mark.slow
def test_zeros_of_omega2_follow_the_frequency_of_s2() -> None:
    """omega2 vanishes where s2 is infinite, once in a cycle of s2: nu2 = a/(2 (P b + Q a)) by quadrature."""
    with mpmath.workdps(20):
        curve = RealCurve(GEN)
        first, second = curve.between(curve.a[3], curve.a[4]), curve.to_infinity()
        # the linear combination that conserves the first integral: a turns of s2 for b turns of s1
        a, b = first[0], second[0]
        period = 2 * abs(a * second[1] - b * first[1])
        frequency = float(a / period)
    T = 5000
    omega2 = states(GEN, 0.02, np.arange(50 * T))[:, 1]
    count = int(np.count_nonzero(np.diff(np.sign(omega2))))
    assert abs(count - frequency * T) <= 1.0
    assert count > 500


def in_terms_of_factors(curve: RealCurve, e: list[Any], f: list[Any], g: list[Any], x0: Any) -> tuple[Any, ...]:
    """omega1 + i omega2, omega3, c gamma3, c (gamma1 + i gamma2) by the formulas of ``state_of_factors``."""
    r1, r2 = -(x0**3) + 3 * curve.l1 * x0 - curve.L, (curve.l1 - x0**2) / 2
    h, k = ([u + sign * v for u, v in zip(f, g, strict=True)] for sign in (-1, 1))
    D = h[0] * k[0]
    La = 8 * D**2
    for i, j in ((0, 1), (1, 2), (2, 0)):
        La /= (h[i] - k[j]) * (h[i] + k[j])
    N = 2 * h[1] * h[2] / ((h[1] - k[2]) * (h[2] + k[1])) + (e[0] - r2) * La
    m, x = N - 1, x0 + r1 * La / N
    A, B = f[3] * f[4], g[3] * g[4]
    F = f[0] * f[1] * f[2] + f[0] * g[1] * g[2] + g[0] * f[1] * g[2] + g[0] * g[1] * f[2]
    other = g[0] * g[1] * g[2] + g[0] * f[1] * f[2] + f[0] * g[1] * f[2] + f[0] * f[1] * g[2]
    product_h = h[0] * h[1] * h[2]
    w3 = 2 * ((F * B - other * A) * (m**2 + 1) - 2 * m * (F * A - other * B)) / ((m**2 - 1) * D**2)
    g3 = w3 * x + 2 * r1 * product_h * La * (A + B) / (D**2 * N**2)
    xi = ((f[3] * g[4] + f[4] * g[3]) * product_h * (N - 2) / (N * D**2)) ** 2
    return x, w3, g3, x**2 - xi


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 6))])
def test_the_formulas_in_50_digits(seed: int) -> None:
    """A state follows from s1, s2 and signs, and (s1 - s2)² s_i'² = -Phi(s_i); residuals 1e-48."""
    y = np.random.default_rng(seed).normal(size=6).tolist()
    with mpmath.workdps(60):
        curve, y = RealCurve(y), list(map(mpf, y))
        e = [*curve.cubic, curve.e4, curve.e5]
        s1, s2 = curve.separated(y)
        f, g = ([mpmath.sqrt(mpc(s - root)) for root in e] for s in (s1, s2))
        x0 = max(
            roots_of([mpf(-1), mpf(0), 6 * curve.l1, -4 * curve.L, curve.G - curve.k_sq]),
            key=lambda x: abs(-(x**3) + 3 * curve.l1 * x - curve.L),
        )
        wanted = mpc(y[0], y[1]), y[2], y[5], mpc(y[3], y[4])
        best = min(
            max(map(abs, (one - other for one, other in zip(wanted, found, strict=True))))
            for signs in product((1, -1), repeat=8)
            for found in [
                in_terms_of_factors(
                    curve,
                    e,
                    [s * v for s, v in zip((*signs[:3], signs[6], 1), f, strict=True)],
                    [s * v for s, v in zip((*signs[3:6], signs[7], 1), g, strict=True)],
                    x0,
                )
            ]
        )
        assert best < mpf(10) ** -50
        w1, w2, w3, g1, g2, g3 = y
        rates = (w2 * w3 / 2, (g3 - w3 * w1) / 2, -g2, g2 * w3 - g3 * w2, g3 * w1 - g1 * w3, g1 * w2 - g2 * w1)
        tiny = mpf(10) ** -25
        ahead, behind = (
            curve.separated([v + sign * tiny * rate for v, rate in zip(y, rates, strict=True)]) for sign in (1, -1)
        )
        for s, later, earlier in zip((s1, s2), ahead, behind, strict=True):
            Phi = 4 * mpmath.fprod(s - root for root in e)
            rate = (later - earlier) / (2 * tiny)
            assert abs((s1 - s2) ** 2 * rate**2 + Phi) < mpf(10) ** -30 * (1 + abs(Phi)) * (1 + abs(s2)) ** 4
