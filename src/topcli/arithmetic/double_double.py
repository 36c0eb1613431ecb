"""Double-double arithmetic on plain floats: a number is an unevaluated sum hi + lo with |lo| <= ulp(hi)/2.

This gives about 32 digits with the exponent range of a double. The operations and their error bounds, in units of u²
with u = 2^-53, are those of Joldes, Muller and Popescu, ACM Trans. Math. Softw. 44(2), 2017; they hold in the absence
of overflow and underflow. Each operation must be rounded separately: no reassociation, and no contraction other than
the explicit ``fma``.
"""

from __future__ import annotations

from topcli.arithmetic.fused import fma


def two_sum(a: float, b: float) -> tuple[float, float]:
    """Return ``(s, e)`` with s = fl(a + b) and s + e = a + b exactly (Knuth)."""
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


def quick_two_sum(a: float, b: float) -> tuple[float, float]:
    """Return ``two_sum(a, b)``, for |a| >= |b| or a = 0 (Dekker)."""
    s = a + b
    return s, b - (s - a)


def compensated_sum(y: float, e: float, d: float) -> tuple[float, float]:
    """Return ``(s, r)``: the rounded sum s of y + (e + d) and its rounding error r, so that s + r = y + (e + d).

    It carries the rounding error of an addition state + change to the next step (Kahan, Comm. ACM 8 (1965) 40). Only
    the errors of the changes remain, and round-off grows as h sqrt(N) instead of sqrt(N). The change is still evaluated
    at the rounded state; the resulting error is smaller by a factor of h and as random as the rounding.

    Exact for |y| >= |e + d| (Dekker). In the one or two steps in which a component passes zero, r itself may be
    rounded, with an error of at most the last bit of d, no larger than the error of d. Compensation adds one addition
    to the critical path of a step.
    """
    return quick_two_sum(y, d + e)


def two_prod(a: float, b: float) -> tuple[float, float]:
    """Return ``(p, e)`` with p = fl(a b) and p + e = a b exactly, for |a b| > 2^-968 or a b = 0, without overflow."""
    p = a * b
    return p, fma(a, b, -p)


def dd_add(ah: float, al: float, bh: float, bl: float) -> tuple[float, float]:
    """Sum a + b; relative error at most 3u²/(1 - 4u), even with cancellation."""
    sh, sl = two_sum(ah, bh)
    th, tl = two_sum(al, bl)
    vh, vl = quick_two_sum(sh, sl + th)
    return quick_two_sum(vh, tl + vl)


def dd_mul(ah: float, al: float, bh: float, bl: float) -> tuple[float, float]:
    """Product a b; relative error at most 7u²."""
    p, e = two_prod(ah, bh)
    return quick_two_sum(p, e + (ah * bl + al * bh))


def dd_scale(ah: float, al: float, b: float) -> tuple[float, float]:
    """Product a b for a plain float b; relative error at most 2u²."""
    p, e = two_prod(ah, b)
    th, tl = quick_two_sum(p, al * b)
    return quick_two_sum(th, tl + e)


def dd_div(ah: float, al: float, b: float) -> tuple[float, float]:
    """Quotient a / b for a plain float b != 0; relative error at most 3u²."""
    q = ah / b
    p, e = two_prod(q, b)
    return quick_two_sum(q, (((ah - p) - e) + al) / b)
