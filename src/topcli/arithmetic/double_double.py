"""Double-double arithmetic on plain floats: a number is an unevaluated sum hi + lo with |lo| <= ulp(hi)/2.

About 32 digits with the exponent range of a double. The operations and their error bounds, in units of u² with
u = 2^-53, are those of Joldes, Muller and Popescu, ACM Trans. Math. Softw. 44(2), 2017, and hold as long as nothing
over- or underflows. Everything here depends on each operation being rounded by itself: no reassociation, no
contraction but the fused multiply-add that is asked for.
"""

from __future__ import annotations

from topcli.arithmetic.fused import fma


def two_sum(a: float, b: float) -> tuple[float, float]:
    """``(s, e)`` with s = fl(a + b) and s + e = a + b exactly (Knuth)."""
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


def quick_two_sum(a: float, b: float) -> tuple[float, float]:
    """``two_sum`` for |a| >= |b| or a = 0 (Dekker)."""
    s = a + b
    return s, b - (s - a)


def two_prod(a: float, b: float) -> tuple[float, float]:
    """``(p, e)`` with p = fl(a b) and p + e = a b exactly, unless it over- or underflows: |a b| > 2^-968 or 0."""
    p = a * b
    return p, fma(a, b, -p)


def dd_add(ah: float, al: float, bh: float, bl: float) -> tuple[float, float]:
    """a + b; relative error at most 3u²/(1 - 4u), also under cancellation."""
    sh, sl = two_sum(ah, bh)
    th, tl = two_sum(al, bl)
    vh, vl = quick_two_sum(sh, sl + th)
    return quick_two_sum(vh, tl + vl)


def dd_mul(ah: float, al: float, bh: float, bl: float) -> tuple[float, float]:
    """a b; relative error at most 7u²."""
    p, e = two_prod(ah, bh)
    return quick_two_sum(p, e + (ah * bl + al * bh))


def dd_scale(ah: float, al: float, b: float) -> tuple[float, float]:
    """a b for a plain float b; relative error at most 2u²."""
    p, e = two_prod(ah, b)
    th, tl = quick_two_sum(p, al * b)
    return quick_two_sum(th, tl + e)


def dd_div(ah: float, al: float, b: float) -> tuple[float, float]:
    """a / b for a plain float b != 0; relative error at most 3u²."""
    q = ah / b
    p, e = two_prod(q, b)
    return quick_two_sum(q, (((ah - p) - e) + al) / b)
