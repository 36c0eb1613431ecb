"""Kowalevski's separation of variables: integrals, roots of the curve, and s1, s2 of a state, in multiprecision.

With x1 = omega1 + i omega2, xi = x1² - c (gamma1 + i gamma2), k = |xi|, l1 = E/3, L = l c and G = c² gamma² the motion
separates on the curve w² = -Phi(s), (s1 - s2)² s_i'² = -Phi(s_i), with

    R(x) = -x⁴ + 6 l1 x² - 4 L x + G - k²,    Phi(s) = (4 s³ - g2 s - g3)(s - e4)(s - e5) = 4 prod (s - e_i),
    g2 = k² - G + 3 l1²,    g3 = l1 (k² - G - l1²) + L²,    e4, e5 = (l1 ± k)/2

(Kowalevski 1889; Golubev, Lectures on Integration, chapter 4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from topcli.arithmetic.multiprecision import Real, cubic_roots, mp, real


@dataclass(frozen=True)
class Integrals:
    """Exact integrals of a state, and the coefficients of its curve."""

    l1: Fraction
    L: Fraction
    G: Fraction
    k_sq: Fraction

    @classmethod
    def of(cls, y: Sequence[float | Fraction], c: float) -> Integrals:
        """Integrals of the state ``y`` (6,)."""
        w1, w2, w3, g1, g2, g3 = (Fraction(v) for v in y)
        f = Fraction(c)
        l1 = (w1 * w1 + w2 * w2 + w3 * w3 / 2 + f * g1) / 3
        L = f * (2 * (w1 * g1 + w2 * g2) + w3 * g3) / 2
        k_sq = (w1 * w1 - w2 * w2 - f * g1) ** 2 + (2 * w1 * w2 - f * g2) ** 2
        return cls(l1, L, f * f * (g1 * g1 + g2 * g2 + g3 * g3), k_sq)

    @property
    def g2(self) -> Fraction:
        """Coefficient of the cubic 4 s³ - g2 s - g3."""
        return self.k_sq - self.G + 3 * self.l1**2

    @property
    def g3(self) -> Fraction:
        """Coefficient of the cubic 4 s³ - g2 s - g3."""
        return self.l1 * (self.k_sq - self.G - self.l1**2) + self.L**2

    def discriminants(self) -> tuple[Fraction, Fraction, Fraction]:
        """Numbers that vanish if e4 = e5, if one of these is a root of the cubic, and if two roots of that coincide."""
        on_cubic = (2 * self.L**2 - 3 * self.l1 * self.G) ** 2 - self.k_sq * self.G**2
        return self.k_sq, on_cubic, self.g2**3 - 27 * self.g3**2


@dataclass(frozen=True)
class Curve:
    """Roots ``e`` of Phi, of which ``e[3]`` and ``e[4]`` are e4 and e5, and the root ``x0`` of R.

    With ``pair``, e[1] and e[2] are conjugate. ``r1`` = R'(x0)/4, ``r2`` = R''(x0)/24.
    """

    of: Integrals
    e: tuple[Real, ...]
    x0: Real
    r1: Real
    r2: Real

    @classmethod
    def with_integrals(cls, of: Integrals) -> Curve:
        """Curve of the given integrals, in the precision of the context."""
        l1, L, k = real(of.l1), real(of.L), mp.sqrt(real(of.k_sq))
        e = cubic_roots(real(of.g2), real(of.g3), of.discriminants()[2] >= 0)
        x0 = _isolated_root(e, l1, L)
        r1, r2 = -(x0**3) + 3 * l1 * x0 - L, (l1 - x0 * x0) / 2
        return cls(of, (*e, mp.mpc((l1 + k) / 2), mp.mpc((l1 - k) / 2)), x0, r1, r2)

    @property
    def pair(self) -> bool:
        """True if two roots are conjugate."""
        return self.e[1].imag != 0

    def occupied(self) -> tuple[int, int, int]:
        """Indices of the ends of the ovals: s2 <= e[first], e[second] <= s1 <= e[third] for every real motion."""
        order = sorted((i for i in range(5) if self.e[i].imag == 0), key=lambda i: self.e[i].real)
        return order[0], order[-2], order[-1]


def _isolated_root(e: Sequence[Real], l1: Real, L: Real) -> Real:
    """Root of R that is furthest from the others; x = q1 + q2 + q3 with q_i² = e_i + l1 and q1 q2 q3 = -L/2."""
    q = [mp.sqrt(v + l1) for v in e]
    if abs(q[0] * q[1] * q[2] + L / 2) > abs(q[0] * q[1] * q[2] - L / 2):
        largest = max(range(3), key=lambda i: abs(q[i]))
        q[largest] = -q[largest]
    tiny = mp.mpf(10) ** (-mp.dps // 3)
    best, isolated = mp.mpf(-1), mp.mpc(0)
    for signs in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)):
        a, b, d = (s * v for s, v in zip(signs, q, strict=True))
        x, apart = a + b + d, min(abs(a + b), abs(b + d), abs(a + d))
        if abs(x.imag) <= tiny * (1 + abs(x)):  # a real root is preferred
            x, apart = mp.mpc(x.real), 2 * apart
        if apart > best:
            best, isolated = apart, x
    return isolated


def separated(of: Integrals, y: Sequence[Real]) -> tuple[Real, Real]:
    """Kowalevski's variables s1 >= s2 of a state; s2 is minus infinity where omega2 = 0.

    Raises ZeroDivisionError where both omega2 and R(omega1) vanish.
    """
    l1, L, rest = real(of.l1), real(of.L), real(of.G - of.k_sq)
    x, w2 = mp.mpc(y[0], y[1]), y[1]
    n = abs(x) ** 2
    size = abs(x * (x * (6 * l1 - x * x) - 4 * L) + rest)
    R12 = -n * n + 6 * l1 * n - 4 * L * x.real + rest
    R1 = (6 * l1 - 4 * x.real**2) * (rest - n * n) - (2 * L - 2 * n * x.real) ** 2
    if R12 >= 0:
        low = l1 / 2 - (R12 + size) / (8 * w2**2) if w2 else mp.mpf("-inf")
        return l1 / 2 - R1 / (2 * (size + R12)), low
    return l1 / 2 + (size - R12) / (8 * w2**2), l1 / 2 - R1 / (2 * (R12 - size))


def series_step(y: Sequence[Any], c: Any, t: Any, order: int) -> list[Any]:
    """State after the time ``t`` by a Taylor series; the components may be numbers of any kind or arrays."""

    def product(a: list[Any], b: list[Any]) -> Any:
        return sum(u * v for u, v in zip(a, reversed(b), strict=True))

    columns = w1, w2, w3, g1, g2, g3 = [[v] for v in y]
    for m in range(1, order + 1):
        rates = (
            product(w2, w3) / 2,
            (c * g3[-1] - product(w3, w1)) / 2,
            -c * g2[-1],
            product(g2, w3) - product(g3, w2),
            product(g3, w1) - product(g1, w3),
            product(g1, w2) - product(g2, w1),
        )
        for column, rate in zip(columns, rates, strict=True):
            column.append(rate / m)
    return [sum(v * t**m for m, v in enumerate(column)) for column in columns]
