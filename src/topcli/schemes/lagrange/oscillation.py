"""Closed-form solution of (dx/dt)² = Q(x) between two simple roots of Q, a polynomial of degree at most four.

The constants of the motion (invariants, roots, periods, phases) are computed once, in decimal arithmetic with
``DIGITS`` digits, so that nearly equal roots cost no accuracy; the elliptic functions are then evaluated in doubles at
phases that are reduced exactly. The formula is that of Biermann and Weierstrass (Whittaker and Watson, section 20.6):
with the root r from which the motion rises,

    x(t) = r + (Q'(r)/4)/(wp(t) - Q''(r)/24),    g2 = a0 a4 - 4 a1 a3 + 3 a2²,
    g3 = a0 a2 a4 + 2 a1 a2 a3 - a2³ - a0 a3² - a1² a4,    Q = a0 x⁴ + 4 a1 x³ + 6 a2 x² + 4 a3 x + a4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, localcontext

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.elliptic import DIGITS, carlson_rf, landen
from topcli.contracts import Array

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

    def phases(self, n: NDArray[np.int64]) -> NDArray[np.uint64]:
        """Phases after n (m,) steps, n of either sign."""
        return np.uint64(self.start) + n.astype(np.int64).view(np.uint64) * np.uint64(self.step)

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
            return int((t / (2 * period) * TURN).to_integral_value()) % TURN

        return Oscillation(
            lower=r,
            upper=r + gap,
            gap=float(gap),
            bend=float(bend),
            kc2=float((e1 - e2) / (e1 - e3)),
            quarter=float(half * (e1 - e3).sqrt()),
            period=float(period),
            start=turns(begin if rising else -begin),
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
