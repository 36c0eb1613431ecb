"""Kowalevski's separation of variables: integrals, roots of the curve, and s1, s2 of a state, in multiprecision.

With x1 = omega1 + i omega2, xi = x1² - c (gamma1 + i gamma2), k = |xi|, l1 = E/3, L = l c and G = c² gamma² the motion
separates on the curve w² = -Phi(s), (s1 - s2)² s_i'² = -Phi(s_i), with

    R(x) = -x⁴ + 6 l1 x² - 4 L x + G - k²,    Phi(s) = (4 s³ - g2 s - g3)(s - e4)(s - e5) = 4 prod (s - e_i),
    g2 = k² - G + 3 l1²,    g3 = l1 (k² - G - l1²) + L²,    e4, e5 = (l1 ± k)/2

(Kowalevski 1889; Golubev, Lectures on Integration, chapter 4). Double roots of Phi are decided in rational arithmetic
from the binary numbers of the initial state, without a tolerance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from topcli.contracts import Floats
from topcli.schemes.kowalevski.closed_form.multiprecision import acos, cbrt, cos, mp, mpc, mpf, pi, sign, sqrt

DIGITS = 60
"""Decimal digits of the integrals; the roots are computed with twice as many."""
Real = Any
"""A number of mpmath, which has no types."""


@dataclass(frozen=True)
class Integrals:
    """Exact integrals of a state, and the coefficients of its curve."""

    l1: Fraction
    L: Fraction
    G: Fraction
    k_sq: Fraction
    g2: Fraction
    g3: Fraction

    @property
    def double_roots(self) -> frozenset[str]:
        """Coincidences of the roots of Phi: "k" (e4 = e5), "e4" and "e5" (a root of the cubic), "cubic"."""
        found = {"k"} if self.k_sq == 0 else set()
        if self.G:
            u = self._on_cubic()
            if u * u == self.k_sq:
                found |= ({"e4"} if u >= 0 else set()) | ({"e5"} if u <= 0 else set())
        if self.g2**3 == 27 * self.g3**2:
            found.add("cubic")
        return frozenset(found)

    def _on_cubic(self) -> Fraction:
        """2 L²/G - E; the cubic vanishes at e4 or e5 if it is k or -k."""
        return 2 * self.L**2 / self.G - 3 * self.l1

    def e4_e5(self) -> tuple[Real, Real]:
        """Roots (l1 ± k)/2; rational at the double roots, so that equal ones are equal in multiprecision too."""
        if self.double_roots & {"k", "e4", "e5"}:
            k = abs(self._on_cubic()) if self.k_sq else Fraction(0)
            return real((self.l1 + k) / 2), real((self.l1 - k) / 2)
        k = sqrt(real(self.k_sq))
        return (real(self.l1) + k) / 2, (real(self.l1) - k) / mpf(2)


def real(q: Fraction) -> Real:
    """Return ``q`` in multiprecision."""
    return mpf(q.numerator) / q.denominator


def integrals(y: Floats, c: float) -> Integrals:
    """Exact integrals of the state ``y`` (6,)."""
    w1, w2, w3, g1, g2, g3 = map(Fraction, y)
    f = Fraction(c)
    l1 = (w1 * w1 + w2 * w2 + w3 * w3 / 2 + f * g1) / 3
    L = f * (2 * (w1 * g1 + w2 * g2) + w3 * g3) / 2
    G = f * f * (g1 * g1 + g2 * g2 + g3 * g3)
    k_sq = (w1 * w1 - w2 * w2 - f * g1) ** 2 + (2 * w1 * w2 - f * g2) ** 2
    return Integrals(l1, L, G, k_sq, k_sq - G + 3 * l1 * l1, l1 * (k_sq - G - l1 * l1) + L * L)


def cubic_roots(g2: Real, g3: Real) -> list[Real]:
    """Roots of 4 s³ - g2 s - g3; a conjugate pair comes last."""
    D = g2**3 - 27 * g3**2
    if D >= 0:
        m = sqrt(g2 / 3)
        angle = acos(min(max(g3 / m**3, mpf(-1)), mpf(1))) / 3
        return [mpc(m * cos(angle - 2 * pi * j / 3)) for j in range(3)]
    q = sqrt(-D / 27)
    u = g3 + q if g3 >= 0 else g3 - q
    a = sign(u) * cbrt(abs(u) / 8)
    b = g2 / (12 * a)
    imaginary = sqrt(mpf(3)) * (a - b) / 2
    return [mpc(a + b), mpc(-(a + b) / 2, abs(imaginary)), mpc(-(a + b) / 2, -abs(imaginary))]


def _roots(of: Integrals, e4: Real, e5: Real) -> list[Real]:
    """Roots of the cubic; equal ones are exactly equal."""
    double, g2, g3 = of.double_roots, real(of.g2), real(of.g3)
    if "cubic" in double:
        d = -3 * of.g3 / (2 * of.g2) if of.g2 else Fraction(0)
        return [mpc(real(-2 * d)), mpc(real(d)), mpc(real(d))]
    if {"e4", "e5"} <= double and "k" not in double:
        return [mpc(e4), mpc(e5), mpc(-e4 - e5)]
    if double & {"e4", "e5"}:
        v = e4 if "e4" in double else e5
        rest = real(of.g2) - 3 * v * v
        if rest >= 0:
            return [mpc(v), mpc((-v + sqrt(rest)) / 2), mpc((-v - sqrt(rest)) / 2)]
        return [mpc(v), mpc(-v, sqrt(-rest)) / 2, mpc(-v, -sqrt(-rest)) / 2]
    return cubic_roots(g2, g3)


@dataclass(frozen=True)
class Curve:
    """Roots ``e`` of Phi, of which ``e[3]`` and ``e[4]`` are e4 and e5, and a root ``x0`` of R.

    With ``pair``, e[1] and e[2] are conjugate. ``r1`` = R'(x0)/4, ``r2`` = R''(x0)/24.
    """

    of: Integrals
    e: tuple[Real, ...]
    pair: bool
    x0: Real
    r1: Real
    r2: Real

    def occupied(self) -> tuple[int, int, int]:
        """Indices of the ends of the ovals: s2 <= e[first], e[second] <= s1 <= e[third] for every real motion."""
        order = sorted((i for i in range(5) if self.e[i].imag == 0), key=lambda i: self.e[i].real)
        return order[0], order[-2], order[-1]


def curve(of: Integrals) -> Curve:
    """Curve of the given integrals."""
    (e4, e5), l1, L = of.e4_e5(), real(of.l1), real(of.L)
    e = _roots(of, e4, e5)
    pair = any(v.imag != 0 for v in e)
    if pair:
        e.sort(key=lambda v: (v.imag != 0, -v.imag))
    x0 = _isolated_root(e, l1, L)
    r1, r2 = -(x0**3) + 3 * l1 * x0 - L, (l1 - x0 * x0) / 2
    return Curve(of, (*e, mpc(e4), mpc(e5)), pair, x0, r1, r2)


def _isolated_root(e: Sequence[Real], l1: Real, L: Real) -> Real:
    """Root of R that is furthest from the others; x = q1 + q2 + q3 with q_i² = e_i + l1 and q1 q2 q3 = -L/2."""
    q = [sqrt(v + l1) for v in e]
    if abs(q[0] * q[1] * q[2] + L / 2) > abs(q[0] * q[1] * q[2] - L / 2):
        largest = max(range(3), key=lambda i: abs(q[i]))
        q[largest] = -q[largest]
    tiny = mpf(10) ** (-mp.dps // 3)
    best, found = mpf(-1), mpc(0)
    for signs in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)):
        a, b, d = (s * v for s, v in zip(signs, q, strict=True))
        x, apart = a + b + d, min(abs(a + b), abs(b + d), abs(a + d))
        if abs(x.imag) <= tiny * (1 + abs(x)):
            x, apart = mpc(x.real), 2 * apart
        if apart > best:
            best, found = apart, x
    return found


def separated(of: Integrals, y: Sequence[Real]) -> tuple[Real, Real]:
    """Kowalevski's variables s1 >= s2 of a state; s2 is minus infinity where omega2 = 0.

    Raises ZeroDivisionError where both omega2 and R(omega1) vanish.
    """
    l1, L, rest = real(of.l1), real(of.L), real(of.G - of.k_sq)
    x, w2 = mpc(y[0], y[1]), y[1]
    n = abs(x) ** 2
    size = abs(x * (x * (6 * l1 - x * x) - 4 * L) + rest)
    R12 = -n * n + 6 * l1 * n - 4 * L * x.real + rest
    R1 = (6 * l1 - 4 * x.real**2) * (rest - n * n) - (2 * L - 2 * n * x.real) ** 2
    if R12 >= 0:
        low = l1 / 2 - (R12 + size) / (8 * w2**2) if w2 else mpf("-inf")
        return l1 / 2 - R1 / (2 * (size + R12)), low
    return l1 / 2 + (size - R12) / (8 * w2**2), l1 / 2 - R1 / (2 * (R12 - size))


def series_step(y: Sequence[Real], c: Real, t: Real, order: int) -> list[Any]:
    """State after the time ``t`` by a Taylor series; the components may be numbers of mpmath or arrays."""
    w: list[list[Any]] = [[v] for v in y]

    def product(a: list[Any], b: list[Any], m: int) -> Any:
        return sum(a[i] * b[m - i] for i in range(m + 1))

    w1, w2, w3, g1, g2, g3 = w
    for m in range(order):
        rates = (
            product(w2, w3, m) / 2,
            (c * g3[m] - product(w3, w1, m)) / 2,
            -c * g2[m],
            product(g2, w3, m) - product(g3, w2, m),
            product(g3, w1, m) - product(g1, w3, m),
            product(g1, w2, m) - product(g2, w1, m),
        )
        for column, rate in zip(w, rates, strict=True):
            column.append(rate / (m + 1))
    found = []
    for column in w:
        value = column[-1]
        for coefficient in column[-2::-1]:
            value = value * t + coefficient
        found.append(value)
    return found
