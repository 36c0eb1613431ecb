"""Integrable discretization of the Kowalevski top: two Bäcklund transformations at once, in rational form.

The step maps each torus of the continuous top to itself and is a translation on it: it conserves gamma², 2l, E and k²,
is Poisson, commutes with the flow and with steps of other lengths, and has a discrete Lax pair.

**The step.** With C = 1, (a, b, n) = -h/2 (w1, w2, w3/2), d = c h²/8 gamma and t = 2 - tau, the vector e = (1; y, -x,
-z) solves a 3x3 linear system (the formula below). Multiplied by the determinant e0 of that system, everything is a
polynomial in e = (e0, e1, e2, e3), and one division remains. The changes, not the new values, are computed, so that the
rounding errors are proportional to them.

**tau.** With F = 2 E, k = abs(xi), it depends on h and the four integrals through numbers of size (h omega)²::

    x, y = (h/4)² (F - 2k), (h/4)² (F + 2k),    r = (h²/8) |c gamma|,    v = (h³/32) c m.gamma
    S = x + y - r²,    P = x y - v²,    p = (S - P)/(1 + sqrt(1 - S + P)),    z = S + 2 p,    tau = z/(2 + sqrt(4 - z))

tau is computed once, from the initial state. On the surface of the initial integrals this is the same map; off it, a
deviation by round-off contracts, because the surface attracts. |m.gamma|² <= |gamma|² (F + 2k) for every real state,
and within ``_LONGEST`` 1 - S + P is at least 1/32: round-off of tau does no harm there.

**Exact nodes.** A step of length h is the flow of E over the time T_E(h) and that of k² over T_K(h). With s from 0 to
h/2, and r, S, P for a step of length 2s::

    T_E(h) = int (t² - r²)/(p t) ds,    T_K(h) = int s²/(2 p t) ds,    p = sqrt(1 - S + P),  t² = 2 - S + 2 p

The flows commute. Hence three or four steps of length a > 0 and one of length -b < 0 are the motion over the time H if
the times of the flows of E add up to H and those of k² to 0. There is one solution for every H up to the one that
belongs to the longest b.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from topcli.arithmetic.fused import fma
from topcli.contracts import Array, Floats, Stepper, Top
from topcli.schemes.registry import scheme

_LONGEST = 3.6
"""Longest step times sqrt(2 E + 2 k) and times sqrt|c gamma|: 1 - S + P is then at least 1/32."""
SHORTEST = 1e-290
"""Shortest step: omega times h loses digits among denormal numbers."""
_ROUNDING = 1.0 + 1e-9
"""Factor by which a step may be longer: the longest one of a state that was projected differs by round-off."""
FOREVER = 1e300
"""Longest step at rest without gravity; finite, because ensembles test their working states for infinities."""
TINY_STATE = 8e-3
"""Size of the scaled state below which tau is not rounded: the rounding would change E visibly."""


def numerators(z: Floats, D: float, tau: float) -> Floats:
    """Numerators of the changes of (a, b, n) and of gamma, and the factor of each; ``D`` is c h²/8."""
    a, b, n, g1, g2, g3 = z
    d2, d3 = D * g2, D * g3

    # the linear system for e, by minors
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

    # gamma turns by the quaternion (v0, v)
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


def constants_at(y: Floats, c: float) -> Floats:
    """F - 2k, F + 2k, |c gamma|, c m.gamma at a state, and the size of the scaled state divided by h²."""
    w1, w2, w3, g1, g2, g3 = y
    energy = (w1 * w1 + w2 * w2) + (0.5 * (w3 * w3) + c * g1)
    k = math.hypot((w1 - w2) * (w1 + w2) - c * g1, 2.0 * w1 * w2 - c * g2)
    weight = abs(c) * math.hypot(math.hypot(g1, g2), g3)
    moment = c * (2.0 * (w1 * g1 + w2 * g2) + w3 * g3)
    size = (0.25 * (w1 * w1 + w2 * w2) + 0.125 * (w3 * w3)) + 0.25 * weight
    return (2.0 * (energy - k), 2.0 * (energy + k), weight, moment, size)


def longest_step(constants: Floats) -> float:
    """Length of the longest step; 0 if omega is too large for a double."""
    scale = max(constants[1], constants[2])
    if not math.isfinite(constants[1] - constants[0]) or not math.isfinite(scale):
        return 0.0
    return min(_LONGEST / math.sqrt(scale), FOREVER) if scale > 0.0 else FOREVER


def tau_of(h: float, constants: Floats) -> float:
    """Constant tau of a step of length h."""
    low, high, weight, moment, _ = constants
    s = 0.25 * h
    x, y = (s * low) * s, (s * high) * s
    r, v = (0.125 * h) * (h * weight), (0.125 * h) * (s * (h * moment))
    total, product = (x + y) - r * r, x * y - v * v
    z = total + 2.0 * ((total - product) / (1.0 + math.sqrt((1.0 - total) + product)))
    return z / (2.0 + math.sqrt(4.0 - z))


def rounded_tau(tau: float, size: float) -> float:
    """tau, rounded such that t = 2 - tau and 2 + t are exact, unless the scaled state, of this ``size``, is tiny.

    Otherwise their rounding errors, the same in every step, make the integrals drift.
    """
    return 2.0 - (((2.0 - tau) + 2.0) - 2.0) if size > TINY_STATE else tau


def plain_step(s: Floats, h: float, p: Floats) -> Floats:
    """One step: (a, b, n), gamma; tau; the status."""
    x1, x2, x3, y1, y2, y3, r, q = numerators((s[0], s[1], s[2], s[3], s[4], s[5]), (0.125 * p[0]) * (h * h), s[6])
    m = (fma(x1, r, s[0]), fma(x2, r, s[1]), fma(x3, r, s[2]))
    return (*m, fma(y1, q, s[3]), fma(y2, q, s[4]), fma(y3, q, s[5]), s[6], s[7])


def enter(y: Floats, h: float, p: Floats) -> Floats:
    """(a, b, n), gamma; tau; the status: 0.0, or nan if the step is too long or too short."""
    constants, k, tau = constants_at(y, p[0]), -0.5 * h, math.nan
    if SHORTEST <= abs(h) <= _ROUNDING * longest_step(constants):
        tau = rounded_tau(tau_of(h, constants), h * h * constants[4])
    return (k * y[0], k * y[1], (0.5 * k) * y[2], y[3], y[4], y[5], tau, tau - tau)


def leave(s: Floats, h: float, p: Floats) -> Floats:
    """Physical state; divided, because the error of a factor 1/h would be the same in every row."""
    k = -0.5 * h
    return (s[0] / k, s[1] / k, s[2] / (0.5 * k), s[3], s[4], s[5])


QUADRATURE = 32
"""Gauss-Legendre points: their error is 1e-18 up to ``_LONGEST``."""
_ROUNDS = 60
_CLOSE = 1e-9
"""Relative change of a length after which one more round of Newton's method yields round-off."""
FEWEST, MOST = 3, 4
"""Numbers of forward steps: with the smaller one a step is cheaper, with the larger one H may be longer."""


@cache
def _points() -> tuple[Array, Array]:
    """Quadrature points in (0, 1) with 1 as the last one, and weights with 0 as the last one."""
    x, w = np.polynomial.legendre.leggauss(QUADRATURE)
    return np.append(0.5 * (x + 1.0), 1.0), np.append(0.5 * w, 0.0)


def flow_times(h: float, constants: Floats, unit: float) -> tuple[float, float, float, float]:
    """T_E and T_K/unit² of a step of length h > 0, and their derivatives by h."""
    low, high, weight, moment, _ = constants
    points, weights = _points()
    s = (0.5 * h) * points
    half = 0.5 * s
    r, v = half * (s * weight), half * (half * (s * moment))
    x, y, rr = (half * low) * half, (half * high) * half, r * r
    S, P = (x + y) - rr, x * y - v * v
    p = np.sqrt((1.0 - S) + P)
    tt = (2.0 - S) + 2.0 * p
    pt = p * np.sqrt(tt)
    energy, k_sq, part = (tt - rr) / pt, 0.5 * (s / unit) ** 2 / pt, 0.5 * h
    rates = 0.5 * float(energy[-1]), 0.5 * float(k_sq[-1])
    return (part * math.fsum(energy * weights), part * math.fsum(k_sq * weights), *rates)


def forward_length(b: float, count: int, constants: Floats, unit: float) -> float:
    """Length a of ``count`` steps with count T_K(a) = T_K(b); nan if it is not found.

    T_K is convex, so that Newton's method from beyond the solution decreases towards it.
    """
    target = flow_times(b, constants, unit)[1] / count
    a, close = b, False
    for _ in range(_ROUNDS):
        times = flow_times(a, constants, unit)
        change = (times[1] - target) / times[3]
        a -= change
        if close:
            return a
        close = abs(change) <= _CLOSE * a
    return math.nan


def longest_composition(constants: Floats, count: int = MOST) -> float:
    """Longest H that ``count`` steps and one backward step can make."""
    b = longest_step(constants)
    if b == 0.0 or b >= FOREVER:
        return b
    a = forward_length(b, count, constants, b)
    return count * flow_times(a, constants, b)[0] - flow_times(b, constants, b)[0]


def lengths(H: float, count: int, constants: Floats) -> tuple[float, float]:
    """Lengths a > 0 and -b < 0 whose composition is the motion over H, of either sign; nan if there are none.

    Newton's method for b, on the curve a(b); a bracket of b catches what leads away.
    """
    unit, root = abs(H), count ** (1.0 / 3.0)
    lower, upper = 0.0, longest_step(constants)
    b, close = min(root * unit / (count - root), upper), False
    for _ in range(_ROUNDS):
        a = forward_length(b, count, constants, unit)
        forward, back = flow_times(a, constants, unit), flow_times(b, constants, unit)
        off = (count * forward[0] - back[0]) - unit
        if close or a != a:
            return math.copysign(a, H), -math.copysign(b, H)
        lower, upper = (lower, b) if off > 0.0 else (b, upper)
        last, b = b, b - off / (back[3] * (forward[2] / forward[3]) - back[2])
        if not lower <= b <= upper:
            b = 0.5 * (lower + upper)
        close = abs(b - last) <= _CLOSE * b
    return math.nan, math.nan


def length_step(y: Floats, c: float, k: float, scale: float, error: float, tau: float) -> Floats:
    """New (omega, gamma) after one step of the length -2 k.

    The scale of omega, 1/k, is not a floating-point number. Its rounding ``error``, the same in every step, would make
    the integrals drift. The state stays physical, because a change of scale between two lengths would do the same.
    """
    z = (k * y[0], k * y[1], (0.5 * k) * y[2], y[3], y[4], y[5])
    x1, x2, x3, y1, y2, y3, r, q = numerators(z, (0.5 * c) * (k * k), tau)
    x1, x2, x3 = x1 * r, x2 * r, 2.0 * (x3 * r)
    w1 = y[0] + fma(x1, scale, x1 * error)
    w2 = y[1] + fma(x2, scale, x2 * error)
    w3 = y[2] + fma(x3, scale, x3 * error)
    return (w1, w2, w3, fma(y1, q, y[3]), fma(y2, q, y[4]), fma(y3, q, y[5]))


def nodes_step(s: Floats, h: float, p: Floats) -> Floats:
    """Three or four steps of one length, one of the other; h itself entered at the start."""
    c, k, scale, error, tau = p[0], s[6], s[7], s[8], s[9]
    y: Floats = length_step((s[0], s[1], s[2], s[3], s[4], s[5]), c, k, scale, error, tau)
    y = length_step(y, c, k, scale, error, tau)
    y = length_step(y, c, k, scale, error, tau)
    if s[14] > 3.5:
        y = length_step(y, c, k, scale, error, tau)
    y = length_step(y, c, s[10], s[11], s[12], s[13])
    return (y[0], y[1], y[2], y[3], y[4], y[5], *s[6:16])


def enter_nodes(y: Floats, h: float, p: Floats) -> Floats:
    """omega, gamma; k, 1/k, its error and tau of both lengths; the number of forward steps; the status."""
    constants = constants_at(y, p[0])
    a = b = math.nan
    count = MOST
    if SHORTEST <= abs(h) <= longest_composition(constants):
        count = FEWEST if abs(h) <= longest_composition(constants, FEWEST) else MOST
        a, b = lengths(h, count, constants)
    if a != a:
        return (*y, *(math.nan,) * 8, float(count), math.nan)
    slots: list[float] = []
    for length in (a, b):
        k = -0.5 * length
        scale = 1.0 / k
        # tau is not rounded, which would be an error of the time
        slots += (k, scale, fma(-k, scale, 1.0) * scale, tau_of(length, constants))
    return (*y, *slots, float(count), 0.0)


def leave_nodes(s: Floats, h: float, p: Floats) -> Floats:
    """Physical state."""
    return s[:6]


class BacklundOptions(BaseModel):
    """Option: exact nodes."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    nodes: Literal["plain", "exact"] = Field(
        default="plain",
        description="division of h: one step of length h (plain), or three or four steps forward and one backward that "
        "together have no discretization error (exact)",
    )


def domain(top: Top, y0: Floats, options: BacklundOptions) -> float:
    """Length of the longest step from ``y0``."""
    constants = constants_at(y0, top.constants()[0])
    return longest_composition(constants) if options.nodes == "exact" else longest_step(constants)


PLAIN = Stepper(plain_step, 8, enter, leave, iterative=True, checked=6)
_NODES = Stepper(nodes_step, 16, enter_nodes, leave_nodes, iterative=True, checked=6)


@scheme(
    "backlund",
    top="kowalevski",
    order=2,
    explicit=True,
    self_adjoint=True,
    conserves=("gamma_sq", "two_l", "energy", "k_sq"),
    options=BacklundOptions,
    longest_step=domain,
    order_with=lambda options: None if options.nodes == "exact" else 2,
)
def build_backlund(top: Top, options: BacklundOptions) -> Stepper:
    r"""Bäcklund transformation, an integrable map.

    Each step is a translation on the torus of the exact motion, given by explicit rational formulas.

    The map conserves gamma², 2l, E and k², preserves the Poisson bracket, commutes with the exact motion and with steps
    of other lengths, and has a discrete Lax pair. We know of no earlier integrable map for this top. The states stay on
    the torus of the exact motion; only their position on this torus has an error.

    A step solves one 3x3 linear system, applies one rotation and needs only one division. The formulas contain a
    constant, tau, that depends on h and on the integrals. tau is computed once, from the initial state; deviations of
    the integrals due to round-off then shrink. Round-off spoils the integrals if h is too long; such an h is refused.

    With `nodes: exact`, the position on the torus has no error either. A step then consists of three or four steps of
    one length and one backward step of another length. The two lengths are chosen such that these steps together are
    the exact motion over a time h.

    Source
    ------
    after Kuznetsov, Vanhaecke 2000 (Bäcklund transformations); Bobenko, Reyman, Semenov-Tian-Shansky 1989 (Lax pair)

    Equations
    ---------
    L' U = U L with the 5x5 Lax matrix L, U the product of two dressing matrices with poles at ±2/h

    Formula
    -------
    L'(\lambda)\,U(\lambda) = U(\lambda)\,L(\lambda), \qquad
    (a, b, n) = -\tfrac h2\,(\omega_1, \omega_2, \tfrac12\omega_3), \quad d = \tfrac18 c h^2\,\gamma, \quad t = 2 - \tau

    \begin{aligned}
    (t - d_1)\,x - d_2\,y - a\,z &= b - d_3\\
    -d_2\,x + (t + d_1)\,y - (b + d_3)\,z &= -a\\
    a\,x + (b - d_3)\,y + (2 + t - d_1)\,z &= 2n + d_2
    \end{aligned}

    e = (1;\ y, -x, -z), \qquad \gamma' \text{ and } \omega' \text{ rational in } e

    Limits
    ------
    resonance, singular-step
        The h of this case is so long that round-off would spoil the integrals; the run is refused before its start.
    long steps
        A run is refused if its h exceeds 3.6/sqrt(2E + 2k) or 3.6/sqrt|c gamma|; the map itself exists for longer steps
        too. In an ensemble, a motion for which h is too long ends as `no_convergence` at step 1.
    compositions
        The variables of a step depend on h, so that steps of several lengths are not composed; with `nodes: exact` the
        error is zero.
    tiny steps
        If |h| is below 1e-290, the run ends as `no_convergence`, because omega times h would lose digits.
    spin about the third axis
        If k is between about E/30 and E/8, the body mainly spins about the third axis. If then |h omega3| is between
        about 2.9 and 3.3, deviations of the integrals grow instead of shrinking, and all integrals are lost within 1e5
        steps. The key `project: 16` of the scheme prevents this.
    hanging top
        Within a distance of about 1e-2 of the hanging equilibrium, deviations of the integrals hardly decrease. If h
        exceeds 0.1/sqrt(c), the integral 2l, which is small there, deviates by more than round-off after 1e5 steps. The
        key `project: 16` of the scheme prevents this.
    no gravity
        Without gravity (c0 = 0), omega rotates uniformly, and the rounding errors of gamma repeat with each rotation.
        After 1e5 steps gamma² deviates by up to 15 times the bound expected for round-off. The key `project: 16` of the
        scheme prevents this.
    exact nodes
        The longest h with exact nodes is 0.8 to 2.2 times the longest plain step, with a median of 1.6. The set-up
        takes 3 to 20 ms for each initial state, also in an ensemble. The integrals of some motions with long steps
        deviate within 1e5 steps; the key `project: 16` of the scheme prevents this.
    """
    return _NODES if options.nodes == "exact" else PLAIN
