"""Constants of a step of ``backlund``: its parameter tau, which depends on h and the integrals alone, and its domain.

With C = 1, F = 2 E, k = |xi|, and the step h, the following numbers of the scaled state are of size (h omega)²::

    x, y = (h/4)² (F - 2k), (h/4)² (F + 2k),    r = (h²/8) |c gamma|,    v = (h³/32) c m.gamma
    S = x + y - r²,    P = x y - v²,    R = 1 - S + P = (1 - x)(1 - y) + r² - v²
    p = (S - P)/(1 + sqrt R),    z = S + 2 p,    tau = z/(2 + sqrt(4 - z))

In this form tau, of size h² E/4, is a sum of small terms. k enters instead of k², which overflows beyond |omega| of
about 1e77.

The map exists for every h at which R > 0 and 4 - z = t² > 0, and there it is exact. |m.gamma|² <= |gamma|² (F + 2k) for
every real state, so that v² <= r² y and R >= (1 - y)(1 - x + r²): up to y = 1, h = 4/sqrt(F + 2k), nothing ends the
domain. Where and whether it ends beyond depends on the state; ``admits`` keeps to the part where round-off is safe.
"""

from __future__ import annotations

import math

from topcli.contracts import Floats
from topcli.schemes.kowalevski.four_integrals import first_three, xi_of

REACH = 5.0
"""Longest step times sqrt(F + 2k), and times sqrt|c gamma|. From about 6 on, the integrals of
more and more motions are lost with frozen constants."""
LEAST_R = 1.0 / 32.0
"""Least R of a step. tau depends on its root, so that the rounding error of tau grows as 1/sqrt R."""
TINY_STATE = 8e-3
"""Size of the scaled state below which tau is not rounded: the rounding would change E visibly."""
SHORTEST = 1e-290
"""Shortest step: omega times h loses digits among denormal numbers."""
HALVINGS = 50
FOREVER = 1e300
"""Longest step at rest without gravity; finite, because ensembles test their working states for infinities."""
Floats5 = tuple[float, float, float, float, float]


def frozen_constants(y: Floats, p: Floats) -> Floats5:
    """F - 2k, F + 2k, |c gamma|, c m.gamma at a state, and the size of the scaled state divided by h²."""
    c = p[0]
    w1, w2, w3, g1, g2, g3 = y
    _, two_l, energy = first_three(y, c)
    k = math.hypot(*xi_of(w1, w2, g1, g2, c))
    weight = abs(c) * math.hypot(g1, g2, g3)
    size = (0.25 * (w1 * w1 + w2 * w2) + 0.125 * (w3 * w3)) + 0.25 * weight
    return (2.0 * (energy - k), 2.0 * (energy + k), weight, c * two_l, size)


def _tau(both: float, times: float, rr: float, vv: float) -> float:
    """tau from x + y, x y, r² and v²; nan where there is no step."""
    total, product = both - rr, times - vv
    under_root = (1.0 - total) + product
    root = math.sqrt(under_root) if under_root > 0.0 else math.nan
    z = total + 2.0 * ((total - product) / (1.0 + root))
    t = math.sqrt(4.0 - z) if z < 4.0 else math.nan
    return z / (2.0 + t)


def tau_of(h: float, low: float, high: float, weight: float, moment: float) -> float:
    """tau for a step of length h, from the first four ``frozen_constants``; nan where there is no step."""
    s = 0.25 * h
    x = (s * low) * s
    y = (s * high) * s
    r = (0.125 * h) * (h * weight)
    v = (0.125 * h) * (s * (h * moment))
    return _tau(x + y, x * y, r * r, v * v)


def tau_at(state: Floats, h: float, c: float) -> float:
    """tau for a step of length h from the integrals at a state; nan where there is no step."""
    w1, w2, w3, g1, g2, g3 = state
    k = -0.5 * h
    D = (0.125 * c) * (h * h)
    a, b, n = k * w1, k * w2, (0.5 * k) * w3
    d1, d2, d3 = D * g1, D * g2, D * g3
    both = (a * a + b * b) + 2.0 * (n * n + d1)
    xi1, xi2 = (a - b) * (a + b) - 2.0 * d1, 2.0 * (a * b - d2)
    times = 0.25 * (both * both - (xi1 * xi1 + xi2 * xi2))
    v = (a * d1 + b * d2) + n * d3
    return _tau(both, times, (d1 * d1 + d2 * d2) + d3 * d3, v * v)


def rounded_tau(tau: float, size: float) -> float:
    """tau, rounded such that t = 2 - tau and 2 + t are exact, unless the scaled state, of this ``size``, is tiny.

    Otherwise their rounding errors, the same in every step, make the integrals drift.
    """
    return 2.0 - (((2.0 - tau) + 2.0) - 2.0) if size > TINY_STATE else tau


def admits(h: float, low: float, high: float, weight: float, moment: float) -> bool:
    """True if round-off is safe in steps of length h; False for constants that are not finite.

    Three tests. h sqrt(F + 2k) and h sqrt|c gamma| are at most ``REACH``. R is at least ``LEAST_R`` for this step and
    for all shorter ones: as a function of h² it is a cubic with the value 1 at 0, and because its leading coefficient
    is not positive, it has at most one minimum, at ``least`` below. t² then needs no test: it was 0.13 or more for
    400,000 states with k = 0, for which it is least.
    """
    s = 0.25 * h
    x = (s * low) * s
    y = (s * high) * s
    r = (0.125 * h) * (h * weight)
    v = (0.125 * h) * (s * (h * moment))
    if not (16.0 * y <= REACH * REACH and 8.0 * r <= REACH * REACH):
        return False
    a1, a2, a3 = -(x + y), x * y + r * r, -(v * v)
    if not ((1.0 + a1) + a2) + a3 >= LEAST_R:
        return False
    discriminant = a2 * a2 - 3.0 * (a1 * a3)
    if a1 < 0.0 and a2 > 0.0 and discriminant > 0.0:
        least = -a1 / (a2 + math.sqrt(discriminant))
        if least < 1.0:
            return 1.0 + least * (a1 + least * (a2 + least * a3)) >= LEAST_R
    return True


def longest_step(low: float, high: float, weight: float, moment: float) -> float:
    """Length of the longest admissible step, by bisection; 0 if omega is too large for a double."""
    scale = max(abs(low), abs(high), weight)
    if scale == 0.0:
        return FOREVER
    if not math.isfinite(scale):
        return 0.0
    lower, upper = 0.0, 8.0 / math.sqrt(scale)
    while admits(upper, low, high, weight, moment):  # a body of low energy: only the cap limits h
        lower, upper = upper, 2.0 * upper
    for _ in range(HALVINGS):
        middle = 0.5 * (lower + upper)
        if admits(middle, low, high, weight, moment):
            lower = middle
        else:
            upper = middle
    return lower
