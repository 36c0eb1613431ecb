"""Elliptic integrals in decimal arithmetic and Jacobi elliptic functions in double precision.

A phase that grows with time loses no digits: its constants come from Carlson integrals in decimal arithmetic, the
phase is reduced by its period in double-double arithmetic, and only the remainder is a double. The error of sn, cn and
dn is then a few ulp for any time, and close to a separatrix too, where the complementary parameter m1 = 1 - k² must
not be rounded.

Sources: Carlson, Numer. Algorithms 10 (1995) 13-26 (R_F, R_C, R_J by duplication; R_J with the sum of DLMF 19.36);
Bulirsch, Numer. Math. 7 (1965) 78-90 (sn, cn, dn by the Landen transformation from m1).
"""

from __future__ import annotations

import math
from decimal import Decimal
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.double_double import dd_add, quick_two_sum

DIGITS = 80
"""Decimal digits of the constants; sums of products of four doubles are then exact."""
DUPLICATION_LIMIT = Decimal("3e-7")
"""Relative deviation at which duplication ends; the series of order six then has a relative error of 1e-39."""
PI = Decimal("3.14159265358979323846264338327950288419716939937510582097494459230781640628620899862803482534211706798")
DoubleDouble = tuple[float, float]
Array = NDArray[np.floating[Any]]


def to_dd(x: Decimal) -> DoubleDouble:
    """Return ``x`` as an unevaluated sum of two doubles."""
    high = float(x)
    return high, float(x - Decimal(high))


def carlson_rf(x: Decimal, y: Decimal, z: Decimal) -> Decimal:
    """Carlson integral R_F(x, y, z) for arguments >= 0, at most one of them 0 (Carlson 1995, eq. 2.1 and 4.1)."""
    mean = (x + y + z) / 3
    while max(abs(mean - x), abs(mean - y), abs(mean - z)) >= mean * Decimal("1e-11"):
        sx, sy, sz = x.sqrt(), y.sqrt(), z.sqrt()
        step = sx * sy + sy * sz + sz * sx
        x, y, z = (x + step) / 4, (y + step) / 4, (z + step) / 4
        mean = (x + y + z) / 3
    X, Y = 1 - x / mean, 1 - y / mean
    Z = -X - Y
    e2, e3 = X * Y - Z * Z, X * Y * Z
    series = 1 - e2 / 10 + e3 / 14 + e2 * e2 / 24 - 3 * e2 * e3 / 44 - 5 * e2**3 / 208 + 3 * e3 * e3 / 104
    return series / mean.sqrt()


def carlson_rc(x: Decimal, y: Decimal) -> Decimal:
    """Carlson integral R_C(x, y) = R_F(x, y, y) for x >= 0, y > 0."""
    return carlson_rf(x, y, y)


def carlson_rj(x: Decimal, y: Decimal, z: Decimal, p: Decimal) -> Decimal:
    """Carlson integral R_J(x, y, z, p) for x, y, z >= 0, at most one of them 0, and p > 0."""
    mean = (x + y + z + 2 * p) / 5
    delta = (p - x) * (p - y) * (p - z)
    total, power = Decimal(0), Decimal(1)
    while max(abs(mean - x), abs(mean - y), abs(mean - z), abs(mean - p)) > DUPLICATION_LIMIT * mean:
        rx, ry, rz, rp = x.sqrt(), y.sqrt(), z.sqrt(), p.sqrt()
        d = (rp + rx) * (rp + ry) * (rp + rz)
        total += power / d * carlson_rc(Decimal(1), 1 + delta * power**3 / (d * d))
        step = rx * ry + ry * rz + rz * rx
        x, y, z, p = (x + step) / 4, (y + step) / 4, (z + step) / 4, (p + step) / 4
        mean = (x + y + z + 2 * p) / 5
        power /= 4
    dx, dy, dz = 1 - x / mean, 1 - y / mean, 1 - z / mean
    dp = -(dx + dy + dz) / 2
    e2 = dx * dy + dy * dz + dz * dx - 3 * dp * dp
    e3 = dx * dy * dz + 2 * e2 * dp + 4 * dp**3
    e4 = (2 * dx * dy * dz + e2 * dp + 3 * dp**3) * dp
    e5 = dx * dy * dz * dp * dp
    series = 1 - 3 * e2 / 14 + e3 / 6 + 9 * e2 * e2 / 88 - 3 * e4 / 22 - 9 * e2 * e3 / 52 + 3 * e5 / 26
    return power * series / (mean * mean.sqrt()) + 6 * total


def _split(a: Any) -> tuple[Any, Any]:
    """Return ``(top, bottom)`` with at most 26 bits each and top + bottom = a exactly (Veltkamp), for |a| < 2^996."""
    t = 134217729.0 * a  # 2^27 + 1
    top = t - (t - a)
    return top, a - top


def _two_product(a: Any, b: Any) -> tuple[Any, Any]:
    """Product a b in double-double, elementwise, without fma, which NumPy arrays lack (Dekker)."""
    p = a * b
    a1, a2 = _split(a)
    b1, b2 = _split(b)
    return p, ((a1 * b1 - p) + a1 * b2 + a2 * b1) + a2 * b2


def multiple(step: DoubleDouble, n: Array) -> tuple[Array, Array]:
    """Product of ``step`` and whole numbers ``n`` given as floats, shape (m,), in double-double."""
    hi, lo = step
    p, e = _two_product(hi, n)
    th, tl = quick_two_sum(p, lo * n)  # type: ignore[arg-type]
    return quick_two_sum(th, tl + e)  # type: ignore[return-value]


def add(a: tuple[Any, Any], b: tuple[Any, Any]) -> tuple[Any, Any]:
    """Sum a + b in double-double, elementwise."""
    return dd_add(*a, *b)


def reduce(u: tuple[Array, Array], period: DoubleDouble) -> tuple[Array, tuple[Array, Array]]:
    """Return ``(j, r)`` with u = j period + r and |r| <= period/2, elementwise; r in double-double."""
    j = np.round(u[0] / period[0])
    return j, add(u, multiple(period, -j))


LANDEN_LIMIT = 64
"""Descents of a Landen transformation; for any double a dozen is enough."""


def landen(u: Array, m1: float) -> tuple[Array, Array, Array]:
    """Jacobi's sn, cn, dn at ``u`` (m,), |u| of the order of a period, for 0 < m1 <= 1.

    Descending Landen transformation, accurate for k close to 1 too.
    """
    a = middle = 1.0
    root = m1
    ladder = []
    for _ in range(LANDEN_LIMIT):
        root = math.sqrt(root)
        ladder.append((a, root))
        middle = 0.5 * (a + root)
        if abs(a - root) <= 1e-9 * a:
            break
        root *= a
        a = middle
    sine, cosine, dn = np.sin(middle * u), np.cos(middle * u), np.ones_like(u)
    zero = sine == 0.0
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        b = cosine / sine
        c = middle * b
        for a, root in reversed(ladder):
            b = c * b
            c = c * dn
            dn = (root + b) / (a + b)
            b = c / a
        sn = np.where(sine >= 0.0, 1.0, -1.0) / np.sqrt(c * c + 1.0)
        cn = np.where(zero, np.where(cosine > 0.0, 1.0, -1.0), c * sn)
    return np.where(zero, 0.0, sn), cn, np.where(zero, 1.0, dn)


def _near_zero(u: Array, m1: float) -> tuple[Array, Array, Array]:
    """``landen`` for |u| <= K/2, with errors of a few ulp each."""
    tiny = np.abs(u) < 1e-9
    sn, cn, dn = landen(np.where(tiny, 1.0, u), m1)
    return np.where(tiny, u, sn), np.where(tiny, 1.0, cn), np.where(tiny, 1.0, dn)


def jacobi(r: tuple[Array, Array], quarter: DoubleDouble | None, m1: float) -> tuple[Array, Array, Array]:
    """Jacobi's sn, cn, dn of ``r`` (double-double, |r| <= K) for the complementary parameter ``m1``.

    ``quarter`` is the quarter period K, or None for m1 = 0, where K is infinite. Beyond K/2 the functions are evaluated
    at K - |r|, so that cn keeps its digits where it is small.
    """
    if quarter is None:
        decay = np.exp(-np.abs(r[0]))
        sech = 2.0 * decay / (1.0 + decay * decay)
        return np.tanh(r[0]), sech, sech
    sign = np.where(r[0] < 0.0, -1.0, 1.0)
    size = (sign * r[0], sign * r[1])
    far = size[0] > 0.5 * quarter[0]
    rest = add(quarter, (-size[0], -size[1]))
    s, c, d = _near_zero(np.where(far, rest[0], size[0]), m1)
    k1 = math.sqrt(m1)
    return sign * np.where(far, c / d, s), np.where(far, k1 * s / d, c), np.where(far, k1 / d, d)
