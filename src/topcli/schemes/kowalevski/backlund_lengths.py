"""Lengths of Bäcklund steps whose composition is the motion itself, without discretization error.

A step of length h is the flow of E over the time T_E(h) and that of k² over T_K(h). With s from 0 to h/2, and x, y, r,
v, S, P, R of ``backlund_constants`` for a step of length 2s::

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

from topcli.contracts import Array
from topcli.schemes.kowalevski.backlund_constants import FOREVER

QUADRATURE = 32
"""Gauss-Legendre points: their error is 1e-18 up to ``LONGEST_BACK``."""
LONGEST_BACK = 3.6
"""Longest step back times sqrt(F + 2k) and times sqrt|c gamma|. There y <= 0.81, and p and t do not come close to 0,
as they may within the longer steps of ``backlund_constants.admits``."""
ROUNDS = 60
CLOSE = 1e-9
"""Relative change of a length after which one more round of Newton's method yields round-off."""
FEWEST, MOST = 3, 4
"""Numbers of forward steps: with the smaller one a step is cheaper, with the larger one H may be longer."""
Floats4 = tuple[float, float, float, float]


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


def flow_times(h: float, constants: Floats4, unit: float) -> Times:
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


def forward_length(b: float, count: int, constants: Floats4, unit: float) -> float:
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


def longest_back(constants: Floats4) -> float:
    """Longest step back; 0 if omega is too large for a double."""
    _, high, weight, _ = constants
    scale = max(high, weight)
    if not math.isfinite(high - constants[0]):
        return 0.0
    return min(LONGEST_BACK / math.sqrt(scale), FOREVER) if scale > 0.0 else FOREVER


def longest_composition(constants: Floats4, count: int = MOST) -> float:
    """Longest H that ``count`` steps and one backward step can make, without the errors of this number."""
    longest = longest_back(constants)
    if longest == 0.0 or longest >= FOREVER:
        return longest
    a = forward_length(longest, count, constants, longest)
    return count * flow_times(a, constants, longest).energy - flow_times(longest, constants, longest).energy


def lengths(H: float, count: int, constants: Floats4) -> tuple[float, float]:
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
