"""Jacobi elliptic functions in doubles, of an argument that grows linearly, and incomplete integrals in many digits.

An argument that grows with time loses no digits: its constants come from Carlson integrals in multiprecision, it is
reduced by its period in double-double arithmetic, and only the remainder is a double. The error of sn, cn and dn is
then a few ulp at any time, and close to a separatrix too, where the complementary parameter m1 = 1 - k² must not be
rounded. (SciPy's ``ellipj`` is off by 1e-8 there.)

Sources: Bulirsch, Numer. Math. 7 (1965) 78-90 (Landen transformation from m1); DLMF 19.25.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.multiprecision import Real, mp

_Array = NDArray[np.floating[Any]]
LANDEN_LIMIT = 64
"""Descents of a Landen transformation; for any double a dozen is enough."""


def _two_product(a: Any, b: Any) -> tuple[Any, Any]:
    """Product a b in double-double, without fma, which NumPy arrays lack (Dekker)."""
    c, d, p = 134217729.0 * a, 134217729.0 * b, a * b  # 2^27 + 1
    a1, b1 = c - (c - a), d - (d - b)
    a2, b2 = a - a1, b - b1
    return p, ((a1 * b1 - p) + a1 * b2 + a2 * b1) + a2 * b2


def phase(start: Real, step: Real, n: NDArray[Any]) -> tuple[NDArray[np.int64], _Array]:
    """Whole part and rest in [-1/2, 1/2] of start + n step, for numbers of mpmath and numbers ``n`` (m,)."""
    before = int(mp.nint(start))
    a, c = float(start - before), float(step)
    b, d = float(start - before - a), float(step - c)
    n = n.astype(np.float64)
    high, low = _two_product(c, n)
    whole = np.rint(high + a)
    return before + whole.astype(np.int64), ((high - whole) + a) + (low + (d * n + b))


def landen(u: _Array, m1: float) -> tuple[_Array, _Array, _Array]:
    """Jacobi's sn, cn, dn at ``u`` (m,), |u| of the order of a period, for 0 < m1 <= 1, accurate for m1 near 0 too."""
    a = middle = 1.0
    root, ladder = m1, []
    for _ in range(LANDEN_LIMIT):
        root = math.sqrt(root)
        ladder.append((a, root))
        middle = 0.5 * (a + root)
        if abs(a - root) <= 1e-9 * a:
            break
        root, a = root * a, middle
    sine, cosine, dn = np.sin(middle * u), np.cos(middle * u), np.ones_like(u)
    zero = np.abs(sine) < 1e-100
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        b = cosine / sine
        c = middle * b
        for a, root in reversed(ladder):
            b, c = c * b, c * dn
            dn = (root + b) / (a + b)
            b = c / a
        sn = np.where(sine >= 0.0, 1.0, -1.0) / np.sqrt(c * c + 1.0)
        cn = np.where(zero, np.sign(cosine), c * sn)
    return np.where(zero, 0.0, sn), cn, np.where(zero, 1.0, dn)


@dataclass(frozen=True)
class Argument:
    """Argument ``start`` + ``rate`` t of Jacobi's functions with the complementary parameter ``m1``."""

    start: Real
    rate: Real
    m1: Real
    quarter: Real
    """Quarter period K of sn; None if m1 = 0."""

    @classmethod
    def of(cls, start: Real, rate: Real, m1: Real) -> Argument:
        """Argument with these constants."""
        return cls(start, rate, m1, mp.pi / (2 * mp.agm(1, mp.sqrt(m1))) if m1 else None)

    def functions(self, n: NDArray[Any], h: Real) -> tuple[NDArray[np.int64], _Array, _Array, _Array, _Array]:
        """``j``, u, sn, cn, dn (m,) after ``n`` (m,) steps of ``h``: the argument is 2 K j + u, and |u| <= K."""
        if self.quarter is None:
            u = float(self.start) + float(self.rate * h) * n
            decay = np.exp(-np.abs(u))
            sech = 2.0 * decay / (1.0 + decay * decay)
            return np.zeros(len(n), dtype=np.int64), u, np.tanh(u), sech, sech
        period = 2 * self.quarter
        j, turn = phase(self.start / period, self.rate * h / period, n)
        sn, cn, dn = self.at(turn)
        odd = np.where(j % 2, -1.0, 1.0)
        return j, float(period) * turn, odd * sn, odd * cn, dn

    def at(self, turn: _Array) -> tuple[_Array, _Array, _Array]:
        """sn, cn, dn (m,) at 2 K ``turn`` (m,), from -1/2 to 1/2.

        Beyond K/2 they are computed from K - |u|, so that cn keeps its digits where it is small.
        """
        size, m1 = np.abs(turn), float(self.m1)
        far = size > 0.25
        s, c, d = landen(float(2 * self.quarter) * np.where(far, 0.5 - size, size), m1)
        k1 = math.sqrt(m1)
        return np.sign(turn) * np.where(far, c / d, s), np.where(far, k1 * s / d, c), np.where(far, k1 / d, d)


def third_kind(u: Real, s: Real, c2: Real, d2: Real, n: Real) -> Real:
    """Integral of 1/(1 - n sn²) from 0 to u, with s = sn u, c2 = cn² u, d2 = dn² u (DLMF 19.25.14)."""
    return u + n / 3 * s**3 * mp.elliprj(c2, d2, 1, 1 - n * s * s) if n else u
