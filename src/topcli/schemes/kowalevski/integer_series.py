"""Motion of the Kowalevski top over a short time, to more than double precision: Taylor series in integers.

The coefficients of the series of omega and gamma follow from (K1), (K2) by Cauchy products. They are integers, in units
of 2^-96 of the largest rate of the motion. Products of integers are exact, no compiler is needed, and nothing is shared
with the schemes. Order and step follow Jorba and Zou, Experimental Mathematics 14 (2005) 99-117, for a relative local
error of 1e-22.
"""

from __future__ import annotations

import math
from operator import mul

from topcli.contracts import Floats

BITS = 96
ORDER = 26
REACH = math.exp(-2.0)
"""Length of a step relative to the radius of convergence."""
LONGEST = 1.0
"""Longest step, in units of the shortest time scale of the motion."""
GRID = 2.0**20
"""Steps but the last one are multiples of 1/GRID, so that what is left of the time is exact."""
MAX_STEPS = 1000


def motion(y: Floats, h: float, c: float) -> Floats:
    """State after the time ``h`` from ``y``, omega and gamma for C = 1; nan if it is not finite or takes too long.

    An error of ``y`` of 2^-96 of its size is neglected.
    """
    omega, gamma = max(map(abs, y[:3])), max(map(abs, y[3:]))
    rate = max(omega, math.sqrt(abs(c)) * math.sqrt(gamma))
    if not (math.isfinite(rate) and math.isfinite(gamma)):
        return (math.nan,) * 6
    unit, size = math.frexp(rate)[1], math.frexp(gamma)[1]
    gravity = math.ldexp(math.ldexp(c, -unit), size - unit)
    shifts = (BITS - unit,) * 3 + (BITS - size,) * 3
    try:
        x = [int(math.ldexp(v, shift)) for v, shift in zip(y, shifts, strict=True)]
        left = math.ldexp(h, unit)
    except OverflowError:
        return (math.nan,) * 6
    g = int(math.ldexp(gravity, BITS))
    for _ in range(MAX_STEPS):
        series = coefficients(x, g)
        step = math.floor(min(LONGEST, REACH * radius(series)) * GRID) / GRID
        step = math.copysign(step, left) if step < abs(left) else left
        x = [value(one, step) for one in series]
        left -= step  # exact
        if left == 0.0:
            return tuple(math.ldexp(v, -shift) for v, shift in zip(x, shifts, strict=True))
    return (math.nan,) * 6


def coefficients(x: list[int], g: int) -> list[list[int]]:
    """Coefficients 0 to ``ORDER`` of the six series, in units of 2^-``BITS``; ``g`` is c."""
    w1, w2, w3, g1, g2, g3 = series = [[v] for v in x]

    def product(a: list[int], b: list[int]) -> int:
        return sum(map(mul, a, reversed(b)))

    for j in range(1, ORDER + 1):
        rates = (
            product(w2, w3) >> 1,
            (g * g3[-1] - product(w3, w1)) >> 1,
            -g * g2[-1],
            product(g2, w3) - product(g3, w2),
            product(g3, w1) - product(g1, w3),
            product(g1, w2) - product(g2, w1),
        )
        for one, rate in zip(series, rates, strict=True):
            one.append((rate >> BITS) // j)
    return series


def radius(series: list[list[int]]) -> float:
    """Radius of convergence estimated from the last two coefficients; infinite if both vanish."""
    first = sum(abs(one[0]) for one in series)
    found = math.inf
    for j in (ORDER - 1, ORDER):
        last = sum(abs(one[j]) for one in series)
        if last:
            found = min(found, (first / last) ** (1.0 / j))
    return found


def value(one: list[int], step: float) -> int:
    """Value of a series at ``step``."""
    d, total = int(math.ldexp(step, BITS)), 0
    for coefficient in reversed(one):
        total = coefficient + ((total * d) >> BITS)
    return total
