"""The Kowalevski HK step that carries along what its sums lose, and what the change of gamma misses.

Kahan's method for y' = f(y), f quadratic, is x = h f(y) + h/2 J(y) x with the Jacobian J. A change x that was solved
for is off by its rounding, and it belongs to the rounded state y instead of y + e. Put into the right side once more
it gives the change that is wanted, but for terms smaller by h. With t = x + e, the number that is added to y::

    e' = (y + t - y') + r,    r = (h f(y) - t) + h/2 J(y) (x + 2 e) + e

where h f(y), of which the difference leaves the last bits alone, is formed exactly. The next step waits for none of it.
It is done for gamma, whose change is rounded two to three times as much as omega's, and gamma² stays as it is; for
omega as well it would cost a sixth more.
"""

from __future__ import annotations

from topcli.contracts import Floats
from topcli.kernels.dd import quick_two_sum, two_prod, two_sum
from topcli.kernels.fused import fma
from topcli.kernels.hk_kowalevski import hk_kowalevski_change
from topcli.kernels.increments import carried_sum


def _missing(h: float, a: float, b: float, u: float, v: float, rest: float, t: float, e: float) -> float:
    """h (a b - u v) + h/2 ``rest`` + e - t, where that is small: exact but for its own last bits."""
    p, p_low = two_prod(a, b)
    q, q_low = two_prod(u, v)
    s, s_low = two_sum(p, -q)
    x, x_low = two_prod(h, s)
    return fma(0.5 * h, rest, ((x - t) + e) + fma(h, (p_low - q_low) + s_low, x_low))


def hk_kowalevski_refined(state: Floats, h: float, p: Floats) -> Floats:
    """One step of (omega, gamma) and of the six numbers e by which they fall short."""
    w1, w2, w3, g1, g2, g3, e1, e2, e3, e4, e5, e6 = state
    x1, x2, x3, y1, y2, y3 = hk_kowalevski_change((w1, w2, w3, g1, g2, g3), h, p)
    u1 = fma(2.0, e1, x1)
    u2 = fma(2.0, e2, x2)
    u3 = fma(2.0, e3, x3)
    v1 = fma(2.0, e4, y1)
    v2 = fma(2.0, e5, y2)
    v3 = fma(2.0, e6, y3)
    j1 = fma(g2, u3, w3 * v2) - fma(g3, u2, w2 * v3)
    j2 = fma(g3, u1, w1 * v3) - fma(g1, u3, w3 * v1)
    j3 = fma(g1, u2, w2 * v1) - fma(g2, u1, w1 * v2)
    t1 = y1 + e4
    t2 = y2 + e5
    t3 = y3 + e6
    r1 = _missing(h, g2, w3, g3, w2, j1, t1, e4)
    r2 = _missing(h, g3, w1, g1, w3, j2, t2, e5)
    r3 = _missing(h, g1, w2, g2, w1, j3, t3, e6)
    w1, e1 = carried_sum(w1, e1, x1)
    w2, e2 = carried_sum(w2, e2, x2)
    w3, e3 = carried_sum(w3, e3, x3)
    g1, e4 = quick_two_sum(g1, t1)
    g2, e5 = quick_two_sum(g2, t2)
    g3, e6 = quick_two_sum(g3, t3)
    return (w1, w2, w3, g1, g2, g3, e1, e2, e3, e4 + r1, e5 + r2, e6 + r3)
