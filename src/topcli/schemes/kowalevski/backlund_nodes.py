"""Bäcklund steps of two lengths as one step without discretization error, checked and watched.

The set-up, once for each initial state, finds the lengths (``backlund_parameters``) and compares the first step with
the motion by Taylor series in integers: an error beyond ``ACCURACY`` refuses it. Every step compares E
and k² with their initial values. The state stays physical, because a change of scale between the lengths would make the
integrals drift.

The working state is omega, gamma; ``scales_of`` and tau of both lengths; the number of forward steps; 1/size, E and k²
relative to it; the fault; the longest step; the status. The fault says why a run ended: 0.0 for a step that is too
long, the error of the first step, or minus the deviation of an integral.

Motion of the Kowalevski top over a short time, to more than double precision: Taylor series in integers.

The coefficients of the series of omega and gamma follow from (K1), (K2) by Cauchy products. They are integers, in units
of 2^-96 of the largest rate of the motion. Products of integers are exact, no compiler is needed, and nothing is shared
with the schemes. Order and step follow Jorba and Zou, Experimental Mathematics 14 (2005) 99-117, for a relative local
error of 1e-22.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import mul

from topcli.contracts import Floats, Stepper
from topcli.errors import UsageError
from topcli.schemes.kowalevski.backlund_parameters import (
    FEWEST,
    MOST,
    Floats4,
    frozen_constants,
    lengths,
    longest_composition,
    tau_of,
)
from topcli.schemes.kowalevski.backlund_step import length_step, scales_of
from topcli.schemes.kowalevski.four_integrals import first_three, sizes, xi_of
from topcli.schemes.layout import first

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


ACCURACY = 1e-12
"""Largest error of the first step, relative to |omega| + sqrt|c gamma| and to |gamma|."""
WATCHED = 1e-11
"""Largest deviation of E and k² from their initial values, relative to the sizes of their terms."""
MAX_SUBSTEPS = 1e6
FAULT = 18
LEAVE = first(6)
"""Slot of the fault."""


def relative_integrals(y: Floats, c: float, inverse: float) -> tuple[float, float]:
    """E and k² relative to the size whose inverse is given, and to its square."""
    y = (y[0], y[1], y[2], y[3], y[4], y[5])
    _, _, energy = first_three(y, c)
    x1, x2 = xi_of(y[0], y[1], y[3], y[4], c)
    x1, x2 = inverse * x1, inverse * x2
    return inverse * energy, x1 * x1 + x2 * x2


def nodes_step(s: Floats, h: float, p: Floats) -> Floats:
    """Three or four steps of one length, one of the other; h itself entered at the start."""
    c, k, scale, error, tau = p[0], s[6], s[7], s[8], s[9]
    y: Floats = length_step((s[0], s[1], s[2], s[3], s[4], s[5]), c, k, scale, error, tau)
    y = length_step(y, c, k, scale, error, tau)
    y = length_step(y, c, k, scale, error, tau)
    if s[14] > 3.5:
        y = length_step(y, c, k, scale, error, tau)
    y = length_step(y, c, s[10], s[11], s[12], s[13])
    energy, k_sq = relative_integrals(y, c, s[15])
    off = max(abs(energy - s[16]), abs(k_sq - s[17]))
    kept = off <= WATCHED
    w1 = y[0] if kept else math.nan
    fault = s[18] if kept or s[20] != s[20] else -off  # nan: the first step was refused
    status = s[20] if kept else math.nan
    return (w1, y[1], y[2], y[3], y[4], y[5], *s[6:18], fault, s[19], status)


def error_of(state: Floats, expected: Floats, y: Floats, c: float) -> float:
    """Error of a state relative to the sizes of omega and gamma at ``y``; infinite for nan."""
    gamma = max(map(abs, y[3:]))
    omega = max(map(abs, y[:3])) + math.sqrt(abs(c) * gamma)
    off = [abs(a - b) for a, b in zip(state, expected, strict=True)]
    errors = [error / size for error, size in zip(off, [omega] * 3 + [gamma] * 3, strict=True) if error != 0.0]
    return math.inf if any(error != error for error in errors) else max(errors, default=0.0)


def longest_from(y: Floats, h: float, p: Floats) -> tuple[float, Floats4]:
    """Longest step and first four frozen constants of ``y``. Raises UsageError for other numbers than doubles."""
    if not isinstance(h, float):
        raise UsageError(
            "precision: scheme 'backlund' with nodes: exact computes its lengths in doubles; use nodes: plain"
        )
    low, high, weight, moment, _ = frozen_constants(y, p)
    constants = (low, high, weight, moment)
    return longest_composition(constants), constants


def begin(y: Floats, H: float, p: Floats, longest: float, constants: Floats4) -> Floats:
    """Working state for steps of H from ``y``, after a first step as a trial."""
    size = sizes(y, p[0])[2]
    inverse = 1.0 / size if size > 0.0 else 1.0
    a, b, count = math.nan, math.nan, MOST
    if abs(H) <= longest:
        count = FEWEST if abs(H) <= longest_composition(constants, FEWEST) else MOST
        a, b = lengths(H, count, constants)
    slots: list[float] = []
    for h in (a, b):
        slots += (*scales_of(h), tau_of(h, *constants))  # not rounded, which would be an error of the time
    watched = (float(count), inverse, *relative_integrals(y, p[0], inverse))
    s = (*y, *slots, *watched, 0.0, longest, 0.0)
    if a != a:
        return (*s[:-1], math.nan)
    error = error_of(nodes_step(s, H, p)[:6], motion(y, H, p[0]), y, p[0])
    if error <= ACCURACY:
        return s
    return (*y, *slots[:3], math.nan, *slots[4:], *watched, error, longest, math.nan)


def enter_nodes(y: Floats, h: float, p: Floats) -> Floats:
    """Working state for steps of h."""
    longest, constants = longest_from(y, h, p)
    return begin(y, h, p, longest, constants)


def enter_parts(y: Floats, h: float, p: Floats) -> Floats:
    """Working state for equal parts of h, as few as possible."""
    longest, constants = longest_from(y, h, p)
    return begin(y, h / substeps_of(h, longest), p, longest, constants)


def substeps_of(h: float, longest: float) -> int:
    """Least number of equal parts of h that are no longer than ``longest``; 1, which will fail, if it is too large."""
    ratio = abs(h) / longest if longest > 0.0 else math.inf
    return math.floor(ratio) + 1 if ratio < MAX_SUBSTEPS else 1


def advice(work: Sequence[float], h: float) -> str:
    """Reason why a run with exact nodes ended."""
    fault = work[FAULT]
    if fault > 0.0:
        return f"with nodes: exact, the first step differs from the motion by {fault:.1e}, more than {ACCURACY:g}"
    if fault < 0.0:
        return f"with nodes: exact, E or k² deviates by {-fault:.1e}, more than {WATCHED:g}; set scheme.project: 16"
    return f"with nodes: exact, |h| must be at most {work[FAULT + 1]:.4g} from this state"


NODES = Stepper(nodes_step, 21, enter_nodes, LEAVE, iterative=True, checked=6, advice=advice)
PARTS = Stepper(nodes_step, 21, enter_parts, LEAVE, iterative=True, checked=6, advice=advice)
