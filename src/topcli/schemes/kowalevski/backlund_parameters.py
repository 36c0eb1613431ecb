"""Parameter tau of a step of ``backlund``, which depends only on h and the integrals, and its domain.

With C = 1, F = 2 E, k = |xi|, and the step h, the following numbers of the scaled state are of size (h omega)²::

    x, y = (h/4)² (F - 2k), (h/4)² (F + 2k),    r = (h²/8) |c gamma|,    v = (h³/32) c m.gamma
    S = x + y - r²,    P = x y - v²,    R = 1 - S + P = (1 - x)(1 - y) + r² - v²
    p = (S - P)/(1 + sqrt R),    z = S + 2 p,    tau = z/(2 + sqrt(4 - z))

In this form tau, of size h² E/4, is a sum of small terms. k enters instead of k², which overflows beyond |omega| of
about 1e77.

The map exists for every h at which R > 0 and 4 - z = t² > 0, and there it is exact. |m.gamma|² <= |gamma|² (F + 2k) for
every real state, so that v² <= r² y and R >= (1 - y)(1 - x + r²): up to y = 1, h = 4/sqrt(F + 2k), nothing ends the
domain. Where and whether it ends beyond depends on the state; ``admits`` keeps to the part where round-off is safe.

Lengths of Bäcklund steps whose composition is the motion itself, without discretization error.

A step of length h is the flow of E over the time T_E(h) and that of k² over T_K(h). With s from 0 to h/2, and x, y, r,
v, S, P, R of ``backlund_parameters`` for a step of length 2s::

    T_E(h) = int (t² - r²)/(p t) ds,    T_K(h) = int s²/(2 p t) ds,    p = sqrt R,  t² = 2 - S + 2 p

The flows commute. Hence n steps of length a > 0 and one of length -b < 0 are the motion over the time H, if ::

    n T_E(a) - T_E(b) = H,    n T_K(a) - T_K(b) = 0

T_K increases, so that the second equation defines a(b). T_E'/T_K' = 2 (t² - r²)/s² decreases, hence H increases with b:
there is one solution for every H up to the one that belongs to the longest b, ``longest_back``.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from topcli.contracts import Array, Floats
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


def frozen_constants(y: Floats, p: Floats) -> Floats:
    """F - 2k, F + 2k, |c gamma|, c m.gamma at a state, and the size of the scaled state divided by h²."""
    c = p[0]
    w1, w2, w3, g1, g2, g3 = y
    _, two_l, energy = first_three(y, c)
    xi, eta = xi_of(w1, w2, g1, g2, c)
    k = math.hypot(xi, eta)
    weight = abs(c) * math.hypot(math.hypot(g1, g2), g3)
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
    scale = max(max(abs(low), abs(high)), weight)
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


QUADRATURE = 32
"""Gauss-Legendre points: their error is 1e-18 up to ``LONGEST_BACK``."""
LONGEST_BACK = 3.6
"""Longest step back times sqrt(F + 2k) and times sqrt|c gamma|. There y <= 0.81, and p and t do not come close to 0,
as they may within the longer steps of ``admits``."""
ROUNDS = 60
CLOSE = 1e-9
"""Relative change of a length after which one more round of Newton's method yields round-off."""
FEWEST, MOST = 3, 4
"""Numbers of forward steps: with the smaller one a step is cheaper, with the larger one H may be longer."""


class Times(NamedTuple):
    """T_E and T_K/unit² of a step, and their derivatives by its length."""

    energy: float
    k_sq: float
    energy_rate: float
    k_sq_rate: float


@cache
def _points() -> tuple[Array, Array]:
    """Quadrature points in (0, 1) with 1 as the last one, and weights with 0 as the last one."""
    x, w = np.polynomial.legendre.leggauss(QUADRATURE)
    return np.append(0.5 * (x + 1.0), 1.0), np.append(0.5 * w, 0.0)


def flow_times(h: float, constants: Floats, unit: float) -> Times:
    """Times of the flows of E and of k², the latter divided by ``unit``², that a step of length h > 0 is.

    ``constants`` are the first four ``frozen_constants``. nan beyond the domain.
    """
    low, high, weight, moment = constants
    points, weights = _points()
    s = (0.5 * h) * points
    half = 0.5 * s
    x, y = (half * low) * half, (half * high) * half
    r = half * (s * weight)
    v = half * (half * (s * moment))
    rr = r * r
    S, P = (x + y) - rr, x * y - v * v
    with np.errstate(all="ignore"):
        p = np.sqrt((1.0 - S) + P)
        tt = (2.0 - S) + 2.0 * p
        pt = p * np.sqrt(tt)
        energy, k_sq = (tt - rr) / pt, 0.5 * (s / unit) ** 2 / pt
    part = 0.5 * h
    return Times(
        part * math.fsum(energy * weights),
        part * math.fsum(k_sq * weights),
        0.5 * float(energy[-1]),
        0.5 * float(k_sq[-1]),
    )


def forward_length(b: float, count: int, constants: Floats, unit: float) -> float:
    """Length a of ``count`` steps with count T_K(a) = T_K(b); nan if it is not found.

    T_K is convex, so that Newton's method from beyond the solution decreases towards it.
    """
    wanted = flow_times(b, constants, unit).k_sq / count
    a, close = b, False
    for _ in range(ROUNDS):
        times = flow_times(a, constants, unit)
        change = (times.k_sq - wanted) / times.k_sq_rate
        a -= change
        if close:
            return a
        close = abs(change) <= CLOSE * a
    return math.nan


def longest_back(constants: Floats) -> float:
    """Longest step back; 0 if omega is too large for a double."""
    _, high, weight, _ = constants
    scale = max(high, weight)
    if not math.isfinite(high - constants[0]):
        return 0.0
    return min(LONGEST_BACK / math.sqrt(scale), FOREVER) if scale > 0.0 else FOREVER


def longest_composition(constants: Floats, count: int = MOST) -> float:
    """Longest H that ``count`` steps and one backward step can make, without the errors of this number."""
    longest = longest_back(constants)
    if longest == 0.0 or longest >= FOREVER:
        return longest
    a = forward_length(longest, count, constants, longest)
    return count * flow_times(a, constants, longest).energy - flow_times(longest, constants, longest).energy


def lengths(H: float, count: int, constants: Floats) -> tuple[float, float]:
    """Lengths a > 0 and -b < 0 whose composition is the motion over H, of either sign; nan if there are none.

    Newton's method for b, on the curve a(b); a bracket of b catches what leads away.
    """
    unit, root = abs(H), count ** (1.0 / 3.0)
    lower, upper = 0.0, longest_back(constants)
    b, close = min(root * unit / (count - root), upper), False
    for _ in range(ROUNDS):
        a = forward_length(b, count, constants, unit)
        forward, back = flow_times(a, constants, unit), flow_times(b, constants, unit)
        off = (count * forward.energy - back.energy) - unit
        if close or a != a:
            sign = math.copysign(1.0, H)
            return sign * a, -sign * b
        lower, upper = (lower, b) if off > 0.0 else (b, upper)
        rate = back.k_sq_rate * (forward.energy_rate / forward.k_sq_rate) - back.energy_rate
        last, b = b, b - off / rate
        if not lower <= b <= upper:
            b = 0.5 * (lower + upper)
        close = abs(b - last) <= CLOSE * b
    return math.nan, math.nan
