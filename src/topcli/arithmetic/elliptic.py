"""Elliptic integrals in decimal arithmetic, and Jacobi elliptic functions in double precision.

A phase that grows with time loses no digits: its constants come from Carlson integrals in decimal arithmetic, the
phase is reduced by its period in double-double arithmetic, and only the remainder is a double. The error of sn, cn and
dn is then a few ulp for any time, and close to a separatrix too, where the complementary parameter m1 = 1 - k² must
not be rounded.

Sources: Carlson, Numer. Algorithms 10 (1995) 13-26 (R_F, R_C, R_J by duplication; R_J with the sum of DLMF 19.36);
Bulirsch, Numer. Math. 7 (1965) 78-90 (sn, cn, dn by the Landen transformation from m1).

**Oscillations.** (dx/dt)² = Q(x) is solved between two simple roots of Q, a polynomial of degree at most four. The
constants of the motion (invariants, roots, periods, phases) are computed once, with ``DIGITS`` digits, so that nearly
equal roots cost no accuracy; the elliptic functions are then evaluated in doubles at phases that are reduced exactly.
The formula is that of Biermann and Weierstrass (Whittaker and Watson, section 20.6): with the root r from which the
motion rises,

    x(t) = r + (Q'(r)/4)/(wp(t) - Q''(r)/24),    g2 = a0 a4 - 4 a1 a3 + 3 a2²,
    g3 = a0 a2 a4 + 2 a1 a2 a3 - a2³ - a0 a3² - a1² a4,    Q = a0 x⁴ + 4 a1 x³ + 6 a2 x² + 4 a3 x + a4.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, localcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.fused import dd_add, quick_two_sum

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
    """Product of ``step`` and numbers ``n`` (m,), in double-double."""
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


TURN = 1 << 64
"""Phases are integers in units of 2^-64 of the period 4K of sn, which is two periods of x; they wrap exactly."""


def horner(q: Sequence[Decimal], x: Decimal) -> Decimal:
    """Value at x of the polynomial with coefficients ``q``, highest degree first."""
    value = q[0]
    for coefficient in q[1:]:
        value = value * x + coefficient
    return value


def derivative(q: Sequence[Decimal]) -> list[Decimal]:
    """Coefficients of the derivative of the polynomial with coefficients ``q``."""
    return [c * (len(q) - 1 - i) for i, c in enumerate(q[:-1])]


def cubic_roots(g2: Decimal, g3: Decimal) -> tuple[Decimal, Decimal, Decimal]:
    """Real roots e1 >= e2 >= e3 of 4 e³ - g2 e - g3, to ``DIGITS`` digits, or half as many for nearly double roots.

    Raises ValueError if the roots are not all real.
    """
    if not g2 > 0 or (27 * g3 * g3 - g2**3) > g2**3 * Decimal(10) ** (6 - DIGITS):
        raise ValueError("oscillation: the cubic has complex roots")

    def outer(start: Decimal) -> Decimal:
        x = start  # beyond the root, where Newton's method is monotone
        for _ in range(300):
            slope = 12 * x * x - g2
            step = (4 * x**3 - g2 * x - g3) / slope if slope > 0 else Decimal(0)
            if abs(step) <= abs(x) * Decimal(10) ** (2 - DIGITS):
                break
            x -= step
        return x

    bound = (g2 / 3).sqrt()
    e1, e3 = outer(bound), outer(-bound)
    return e1, -e1 - e3, e3


@dataclass(frozen=True)
class Oscillation:
    """Periodic motion sampled at equal steps, the result of ``oscillation``; phases in units of 2^-64 periods of sn.

    ``lower`` and ``upper`` are the turning points; ``gap`` is their difference, 0 if x is at rest. With s = sn,
    x - lower = gap s² (1 + bend)/(1 + bend s²).
    """

    lower: Decimal
    upper: Decimal
    gap: float
    bend: float
    """(e3 - Q''(r)/24)/(e1 - e3)."""
    kc2: float
    """Complementary parameter m1 = (e1 - e2)/(e1 - e3)."""
    quarter: float
    """Quarter period K of sn."""
    period: float
    """Period of x in time."""
    start: int
    step: int

    def phases(self, n: Array | NDArray[np.int64]) -> NDArray[np.uint64]:
        """Phases after n (m,) steps, n of either sign, with fractions perhaps."""
        if n.dtype.kind == "f" and (n != np.floor(n)).any():
            ratios = (x.as_integer_ratio() for x in n.tolist())
            found = [(self.start + self.step * top // bottom) % TURN for top, bottom in ratios]
            return np.array(found, dtype=np.uint64)
        return np.uint64(self.start) + n.astype(np.int64).view(np.uint64) * np.uint64(self.step % TURN)

    def at(self, phase: NDArray[np.uint64]) -> tuple[Array, Array, Array, Array, Array]:
        """x - lower, upper - x, dx/dt, sn and cn at the phases (m,); the first two without cancellation."""
        if self.gap == 0.0:
            still = np.zeros(len(phase))
            return still, still, still, still, still + 1.0
        sn, cn, dn = landen(phase.view(np.int64) * (4.0 * self.quarter / TURN), self.kc2)
        below = 1.0 + self.bend * sn * sn
        rise = self.gap * (1.0 + self.bend) * sn * sn / below
        fall = self.gap * cn * cn / below
        rate = self.gap * (1.0 + self.bend) * 2.0 * sn * cn * dn / (below * below)
        return rise, fall, rate * (2.0 * self.quarter / self.period), sn, cn


def oscillation(q: Sequence[Decimal], x0: Decimal, rising: bool, low: Decimal, step: Decimal | None) -> Oscillation:
    """Motion with (dx/dt)² = Q(x) from ``x0``, rising or falling, sampled at intervals ``step`` of time.

    ``q`` contains five coefficients, highest degree first; Q(x0) >= 0, Q(low) <= 0, with one root between x0 and low.
    If ``step`` is None, it is the step of a map with the biquadratic invariant of Q: wp(step) = (a1² - a0 a2)/a0.
    Raises ValueError if the motion is not periodic (asymptotic to rest) or these conditions are violated.
    """
    with localcontext() as context:
        context.prec = DIGITS
        slope, bending = derivative(q), derivative(derivative(q))
        a0, a1, a2, a3, a4 = q[0], q[1] / 4, q[2] / 6, q[3] / 4, q[4]
        here, tilt = horner(q, x0), horner(slope, x0)
        tiny = Decimal(10) ** (10 - DIGITS)
        size = horner([abs(c) for c in q], abs(x0)) + abs(a4)
        if abs(here) <= tiny * size and abs(tilt) <= tiny * sum(map(abs, slope)):
            return Oscillation(x0, x0, 0.0, 0.0, 1.0, 1.0, 1.0, 0, 0)  # at rest
        e1, e2, e3 = cubic_roots(
            a0 * a4 - 4 * a1 * a3 + 3 * a2 * a2,
            a0 * a2 * a4 + 2 * a1 * a2 * a3 - a2**3 - a0 * a3 * a3 - a1 * a1 * a4,
        )
        if not e1 - e2 > abs(e1) * Decimal(10) ** (8 - DIGITS // 2):
            raise ValueError("oscillation: the motion is asymptotic to rest and not periodic, which is not supported")
        r = x0 if abs(here) <= tiny * size and tilt > 0 else _root_between(q, low, x0)
        scale, c = horner(slope, r) / 4, horner(bending, r) / 24
        half = carlson_rf(Decimal(0), e1 - e2, e1 - e3)

        def time_of(p: Decimal) -> Decimal:
            """Time t in (0, half] with wp(t) = p."""
            return carlson_rf(max(p - e1, Decimal(0)), p - e2, p - e3)

        begin = time_of(c + scale / (x0 - r)) if x0 != r else Decimal(0)
        if step is None:
            step = time_of((a1 * a1 - a0 * a2) / a0)
        bend, gap = (e3 - c) / (e1 - e3), scale / (e1 - c)
        period = 2 * half

        def turns(t: Decimal) -> int:
            return int((t / (2 * period) * TURN).to_integral_value())

        return Oscillation(
            lower=r,
            upper=r + gap,
            gap=float(gap),
            bend=float(bend),
            kc2=float((e1 - e2) / (e1 - e3)),
            quarter=float(half * (e1 - e3).sqrt()),
            period=float(period),
            start=turns(begin if rising else -begin) % TURN,
            step=turns(step),
        )


def _root_between(q: Sequence[Decimal], low: Decimal, high: Decimal) -> Decimal:
    """Root of Q between ``low``, where Q <= 0, and ``high``, where Q >= 0, by bisection."""
    nothing = sum(map(abs, q)) * Decimal(10) ** (10 - DIGITS)
    if horner(q, low) > nothing or horner(q, high) < -nothing:
        raise ValueError("oscillation: Q has no sign change at the expected turning point")
    for _ in range(4 * DIGITS):
        middle = (low + high) / 2
        if horner(q, middle) >= 0:
            high = middle
        else:
            low = middle
    return (low + high) / 2
