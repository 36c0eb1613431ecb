"""Double-double arithmetic on plain floats: a number is an unevaluated sum hi + lo with |lo| <= ulp(hi)/2.

About 32 digits with the exponent range of a double. Without a fused multiply-add the exact product is Dekker's
(Numer. Math. 18, 1971); the operations and their error bounds, in units of u² with u = 2^-53, are those of
Joldes, Muller and Popescu, ACM Trans. Math. Softw. 44(2), 2017, and hold as long as nothing over- or
underflows. Everything here depends on each operation being rounded by itself: no reassociation, no contraction.
"""

from __future__ import annotations

SPLITTER = 134217729.0
"""2^27 + 1: splits a 53-bit significand into two halves of at most 26 bits (Veltkamp)."""


def two_sum(a: float, b: float) -> tuple[float, float]:
    """``(s, e)`` with s = fl(a + b) and s + e = a + b exactly (Knuth)."""
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


def quick_two_sum(a: float, b: float) -> tuple[float, float]:
    """``two_sum`` for |a| >= |b| or a = 0 (Dekker)."""
    s = a + b
    return s, b - (s - a)


def split(a: float) -> tuple[float, float]:
    """``(top, bottom)`` of at most 26 bits each with top + bottom = a exactly; |a| < 2^996."""
    t = SPLITTER * a
    top = t - (t - a)
    return top, a - top


def two_prod(a: float, b: float) -> tuple[float, float]:
    """``(p, e)`` with p = fl(a b) and p + e = a b exactly; |a|, |b| < 2^996, |a b| > 2^-968 or 0."""
    p = a * b
    a1, a2 = split(a)
    b1, b2 = split(b)
    return p, ((a1 * b1 - p) + a1 * b2 + a2 * b1) + a2 * b2


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
