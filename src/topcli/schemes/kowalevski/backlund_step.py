"""Bäcklund steps of the Kowalevski top: with one parameter, and with two parameters as one exact step.

**One length.** A step is a 3x3 linear system and a rotation. Two Bäcklund transformations of the 5x5 Lax matrix, at
lambda = -2/h and its two eigenvalues near 4/h, are together a rational map. With a, b, n = -(h/2) (w1, w2, w3/2), d =
(c h²/8) gamma and t = 2 - tau, solve ::

    (t - d1) x - d2 y - a z = b - d3
    -d2 x + (t + d1) y - (b + d3) z = -a
    a x + (b - d3) y + (2 + t - d1) z = 2 n + d2

by Cramer's rule in homogeneous form, (e0; e1, e2, e3) = (1; y, -x, -z) times the determinant. The new momentum and the
rotation of gamma are rational in e and have one common divisor. Nothing branches, and there is no root.

With N = |e|², f = (e0 e1 - e3 e2, e0 e2 + e3 e1), g = (e0 e1 + e3 e2, e0 e2 - e3 e1), cc = e0² + e3²::

    X = 8 e0 e3 + 2 (n cc + a f2 - b f1),  Y = t N,  H = X² + Y²,  R(u) = (Y u1 + X u2, Y u2 - X u1)
    (a, b)' = (a, b) - (2t/H) R(N (a, b) + 2 g),    n' = n + (4t/H) (2 Y e0 e3 - X (e0² - e3²))

and gamma is turned by the unit quaternion ((Y² - X²) cc - H (e1² + e2²); -2 Y R(f); -2 X Y cc)/(H N).

For small h the sums N a + 2 g1 and the like cancel. The code inserts the linear equations, q = (a e0 + 2 e1,
b e0 + 2 e2, 2 n e0 + 4 e3), so that every change is a sum of terms of its own size.

The code turns gamma by the quaternion (v0; -2Y v)/(H N) with v = (R(f); X cc): with s = v x gamma and i = -2/(H N)
the change is Y i² (2Y v x s - v0 s).

Performance: 132 operations and one division; the order of the terms keeps the longest chain at 17 of them. The scaling
is internal, and only changes are scaled back, so that the state stays physical and a scaling error cannot accumulate
when steps of several lengths follow each other.

**Two lengths.** The set-up, once for each initial state, finds the lengths (``backlund_parameters``) and compares the
first step with the motion by Taylor series in integers: an error beyond ``ACCURACY`` refuses it. Every step compares E
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

from topcli.arithmetic.fused import fma
from topcli.arithmetic.vectors import Floats6
from topcli.contracts import Floats, Stepper
from topcli.errors import UsageError
from topcli.schemes.kowalevski.backlund_parameters import (
    FEWEST,
    MOST,
    frozen_constants,
    lengths,
    longest_composition,
    tau_of,
)
from topcli.schemes.kowalevski.four_integrals import first_three, sizes, xi_of
from topcli.schemes.layout import first


def numerators(z: Floats, D: float, tau: float) -> Floats:
    """Numerators of the changes of (a, b, n) and of gamma, and the factor of each; ``D`` is c h²/8."""
    a, b, n, g1, g2, g3 = z
    d2, d3 = D * g2, D * g3

    t = 2.0 - tau
    tm, tp, f = fma(-D, g1, t), fma(D, g1, t), fma(-D, g1, 2.0 + t)
    bm, bp = fma(-D, g3, b), fma(D, g3, b)
    n2 = n + n
    r3 = n2 + d2
    c00, c01, c02 = fma(tp, f, bm * bp), fma(d2, f, -(a * bp)), -fma(a, tp, d2 * bm)
    c10, c11, c12 = fma(d2, f, -(a * bm)), fma(tm, f, a * a), -fma(tm, bm, d2 * a)
    c20, c21, c22 = fma(a, tp, d2 * bp), fma(tm, bp, a * d2), fma(tm, tp, -(d2 * d2))
    e0 = fma(tm, c00, -fma(d2, c01, a * c02))
    e1 = fma(bm, c01, fma(r3, c21, -(a * c11)))
    e2 = fma(a, c10, -fma(bm, c00, r3 * c20))
    e3 = fma(a, c12, -fma(bm, c02, r3 * c22))

    um, up = fma(-D, g1, tau), fma(D, g1, tau)
    q1 = fma(um, e1, -fma(d2, e2, bp * e3))
    q2 = fma(up, e2, -(d2 * e1)) + fma(a, e3, d3 * e0)
    q3 = fma(up, e3, -(bp * e1)) + fma(a, e2, -(d2 * e0))  # 2 n e0 + 4 e3 + 2 (a e2 - b e1)

    e00, e33, twice = e0 * e0, e3 * e3, e3 + e3
    four = (e0 + e0) * twice
    cc, pp = e00 + e33, fma(e1, e1, e2 * e2)
    N, rest = cc + pp, pp + e33
    across, along = fma(a, e1, b * e2), n2 * e33
    # X, and X without its largest term, which cancels in the change of n
    X, xs = fma(e0, q3, fma(twice, across, along + four)), fma(e0, q3, fma(twice, across, along))
    f1, f2 = fma(e0, e1, -(e3 * e2)), fma(e0, e2, e3 * e1)
    Y = t * N
    XX, YY = X * X, Y * Y
    inverse = -2.0 / fma(XX, N, YY * N)
    factor = Y * inverse

    u1 = fma(e0, q1, fma(a, rest, e2 * twice))
    u2 = fma(e0, q2, fma(b, rest, -(e1 * twice)))
    lift = fma(four, fma(-0.5 * tau, N, rest + e33), -(xs * (e00 - e33)))

    m = Y + Y
    v0 = fma(-XX, N, YY * (cc - pp))
    v1, v2, v3 = fma(X, f2, Y * f1), fma(Y, f2, -(X * f1)), X * cc
    s1, s2, s3 = fma(v2, g3, -(v3 * g2)), fma(v3, g1, -(v1 * g3)), fma(v1, g2, -(v2 * g1))
    return (
        fma(Y, u1, X * u2),
        fma(Y, u2, -(X * u1)),
        -(lift + lift),
        fma(m, fma(v2, s3, -(v3 * s2)), -(v0 * s1)),
        fma(m, fma(v3, s1, -(v1 * s3)), -(v0 * s2)),
        fma(m, fma(v1, s2, -(v2 * s1)), -(v0 * s3)),
        factor,
        factor * inverse,
    )


def scaled_step(z: Floats, D: float, tau: float) -> Floats6:
    """New (a, b, n) and gamma after one step."""
    x1, x2, x3, y1, y2, y3, r, q = numerators(z, D, tau)
    return (
        fma(x1, r, z[0]),
        fma(x2, r, z[1]),
        fma(x3, r, z[2]),
        fma(y1, q, z[3]),
        fma(y2, q, z[4]),
        fma(y3, q, z[5]),
    )


def scales_of(h: float) -> tuple[float, float, float]:
    """Constants of a length: k = -h/2, and 1/k with its rounding error.

    The scale of omega, 1/k, is not a floating-point number. Its rounding error, the same in every step, would make the
    integrals drift; it is therefore used with its error.
    """
    k = -0.5 * h
    scale = 1.0 / k
    return (k, scale, fma(-k, scale, 1.0) * scale)


def scaled_change(z: Floats, D: float, tau: float) -> Floats6:
    """Change of (a, b, n) and gamma in one step."""
    x1, x2, x3, y1, y2, y3, r, q = numerators(z, D, tau)
    return (x1 * r, x2 * r, x3 * r, y1 * q, y2 * q, y3 * q)


def length_numerators(y: Floats, c: float, k: float, scale: float, error: float, tau: float) -> Floats:
    """Changes of omega, numerators of those of gamma, and their factor, for ``scales_of`` a length and its ``tau``."""
    z = (k * y[0], k * y[1], (0.5 * k) * y[2], y[3], y[4], y[5])
    x1, x2, x3, y1, y2, y3, r, q = numerators(z, (0.5 * c) * (k * k), tau)
    x1, x2, x3 = x1 * r, x2 * r, 2.0 * (x3 * r)
    w1, w2, w3 = fma(x1, scale, x1 * error), fma(x2, scale, x2 * error), fma(x3, scale, x3 * error)
    return (w1, w2, w3, y1, y2, y3, q)


def length_step(y: Floats, c: float, k: float, scale: float, error: float, tau: float) -> Floats6:
    """New (omega, gamma) after one step, whose length is given by its ``scales_of`` and ``tau``."""
    w1, w2, w3, y1, y2, y3, q = length_numerators(y, c, k, scale, error, tau)
    return (y[0] + w1, y[1] + w2, y[2] + w3, fma(y1, q, y[3]), fma(y2, q, y[4]), fma(y3, q, y[5]))


def physical_change(y: Floats, h: float, c: float, tau: float) -> Floats6:
    """Change of (omega, gamma) in one step of length h with the parameter ``tau``."""
    k, scale, error = scales_of(h)
    w1, w2, w3, y1, y2, y3, q = length_numerators(y, c, k, scale, error, tau)
    return (w1, w2, w3, y1 * q, y2 * q, y3 * q)


def physical_step(y: Floats, h: float, c: float, tau: float) -> Floats6:
    """New (omega, gamma) after one step of length h with the parameter ``tau``."""
    k, scale, error = scales_of(h)
    return length_step(y, c, k, scale, error, tau)


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


def longest_from(y: Floats, h: float, p: Floats) -> tuple[float, Floats]:
    """Longest step and first four frozen constants of ``y``. Raises UsageError for other numbers than doubles."""
    if not isinstance(h, float):
        raise UsageError(
            "precision: scheme 'backlund' with nodes: exact computes its lengths in doubles; use nodes: plain"
        )
    low, high, weight, moment, _ = frozen_constants(y, p)
    constants = (low, high, weight, moment)
    return longest_composition(constants), constants


def begin(y: Floats, H: float, p: Floats, longest: float, constants: Floats) -> Floats:
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
