"""The implicit midpoint rule for the Kowalevski top, kept on the surface of k² too: all four integrals.

With m = (y' + y)/2 and a direction n that changes neither gamma², 2l nor E (``lie_poisson``)::

    y' = y + h f(m) + s n(m),   s such that k(y') = k(y)

The midpoint rule keeps gamma², 2l and E because they are quadratic, and n(m) keeps them for the same reason; so one
number s is left to be found. Everything is symmetric in y and y': the step is self-adjoint. Nothing is singular where
omega1 + i omega2 vanishes: k² enters by its gradient, and no square root is taken.

Where k is so small that the step's own error could turn xi about 0, its two components take the place of k: xi' is
xi turned back by h m3, with two directions n. That is Delone's motion for k = 0.

What makes it fast:
- HK's step, plus what was added to it in the last two steps, extrapolated, is off by O(h⁵): one iteration is the rule
  for small h. What is carried along decides where the iteration starts, not where it ends;
- Newton's iteration for y' and s together, bordered: the two solutions with one factorized matrix run side by side;
- n needs no matrix, and no division comes before that by the slope of k².

What makes it safe: the values aimed at are carried from the initial state, and round-off's deviations from them are
given back gently: those of gamma², 2l and E by half of each one's own gradient step (Cimmino), which is stable whatever
their angles, those of k² beyond ``BAND`` only, because where n is short they would be magnified. Where n vanishes
(degenerate tori, relative equilibria), where s n would be longer than any correction is, and where the iteration does
not settle, the step is the midpoint rule's, projected as hk-projected's is. It is counted.
"""

from __future__ import annotations

import math

from topcli.arithmetic.complex_plane import turn_increment
from topcli.contracts import Floats, NoOptions, Stepper, Top
from topcli.schemes.any_top.midpoint import midpoint
from topcli.schemes.kowalevski.four_integrals import (
    EPS,
    Four,
    Six,
    combination,
    first_three,
    fourth_column,
    targets_with_k,
    xi_of,
)
from topcli.schemes.kowalevski.hk import hk_kowalevski
from topcli.schemes.kowalevski.lie_poisson import (
    DEPENDENT,
    TINY,
    Newton,
    bracket,
    field_of_m,
    fields_of_xi,
    keeping_three,
    newton_matrix,
    newton_solved,
)
from topcli.schemes.kowalevski.projected import leave
from topcli.schemes.kowalevski.projection import onto_but_no_worse
from topcli.schemes.limits import LONG_NEWTON
from topcli.schemes.registry import scheme

ROUNDS = 12
"""Iterations before a projected midpoint step is made instead; one or two are the rule."""
SETTLED = 4.0 * EPS
"""Change of the step, in units of the state, that ends the iteration: the last bits of the new state."""
FLOOR = 2.0**10
"""How far above ``SETTLED`` an iteration may stall: round-off magnified, near a degenerate torus."""
CONTRACTION = 4.0
"""Each iteration multiplies the change of the step by less than this, times the sum of all changes and of s n in units
of the state, over the square of the part of k²'s field that is normal to the motion's: 1 as a rule."""
SMALL_K = 2.0**-10
"""k in units of its terms below which, for h not small, xi takes its place; h² times the terms for smaller h."""
STEEP = 2.0**-4
"""How much of its leading term the slope of k² must have for the equation to be the one meant."""
BAND = 2.0 * EPS
"""Deviation of k², in units of its terms, that is left alone: its rounding error."""
Solution = tuple[float, float, float, float, float, float, float, float]


def size_of(v: Six) -> float:
    """The sum of the magnitudes."""
    return ((abs(v[0]) + abs(v[1])) + abs(v[2])) + ((abs(v[3]) + abs(v[4])) + abs(v[5]))


def plus(v: Six, s: float, n: Six) -> Six:
    """v + s n."""
    return (v[0] + s * n[0], v[1] + s * n[1], v[2] + s * n[2], v[3] + s * n[3], v[4] + s * n[4], v[5] + s * n[5])


def given_back(y: Floats, t: Four, c: float) -> Six:
    """The change of the state that takes gamma², 2l and E half of the way back to their values in ``t``, or so."""
    w1, w2, w3, g1, g2, g3 = y
    i1, i2, i3 = first_three(y, c)
    ww, w33 = w1 * w1 + w2 * w2, w3 * w3
    gg, g33 = g1 * g1 + g2 * g2, g3 * g3
    x = (
        0.5 * (t[0] - i1) / ((gg + g33) + TINY),
        0.5 * (t[1] - i2) / ((4.0 * (gg + ww) + (g33 + w33)) + TINY),
        0.5 * (t[2] - i3) / ((4.0 * ww + (w33 + c * c)) + TINY),
        0.0,
    )
    return combination(y, c, (0.0, 0.0, 0.0, 0.0), x)


def change_of_xi(y: Floats, e: Six, c: float) -> tuple[float, float]:
    """xi(y + e) - xi(y), its rounding errors of the size of e."""
    w1, w2, e1, e2 = y[0], y[1], e[0], e[1]
    return (
        (e1 * (2.0 * w1 + e1) - e2 * (2.0 * w2 + e2)) - c * e[3],
        2.0 * (e1 * (w2 + e2) + e2 * w1) - c * e[4],
    )


def left_over(m: Six, e: Six, b: Six, f: Six, h: float) -> Six:
    """b + h f(m) - e, what the midpoint rule's equation is off by; ``f`` is the field of (m, gamma)."""
    d = 0.5 * h
    return (
        (d * f[0] + b[0]) - e[0],
        (d * f[1] + b[1]) - e[1],
        (h * f[2] + b[2]) - e[2],
        (h * f[3] + b[3]) - e[3],
        (h * f[4] + b[4]) - e[4],
        (h * f[5] + b[5]) - e[5],
    )


def keeping_k(y: Floats, b: Six, start: Six, newton: Newton, k: float, reach: float, h: float, c: float) -> Solution:
    """The change of the state that keeps k, by iteration from ``start``; 0.0, or nan if it is not found; the rounds."""
    x1, x2 = xi_of(y[0], y[1], y[3], y[4], c)
    over = (x1 * x1 + x2 * x2) - k * k
    terms = (y[0] * y[0] + y[1] * y[1]) + abs(c) * (abs(y[3]) + abs(y[4]))
    band = BAND * (terms * terms)
    excess = 0.5 * (over - max(-band, min(band, over)))
    size = (abs(y[0]) + abs(y[1]) + abs(y[2])) + (abs(y[3]) + abs(y[4]) + abs(y[5]))
    e = start
    status, rounds, off, way = math.nan, 0.0, math.inf, 0.0
    for _ in range(ROUNDS):
        rounds += 1.0
        m = plus((y[0], y[1], y[2], y[3], y[4], y[5]), 0.5, e)
        f = field_of_m(m, c)
        u1, u2 = xi_of(m[0], m[1], m[3], m[4], c)
        n, rate, most = keeping_three(m, f, fourth_column(m[0], m[1], u1, u2, c))
        along = newton_solved(newton, n)
        z = newton_solved(newton, left_over(m, e, b, f, h))
        d1, d2 = change_of_xi(y, e, c)
        a1, a2, b1, b2 = fourth_column(y[0] + e[0], y[1] + e[1], x1 + d1, x2 + d2, c)
        over = (excess + (x1 * d1 + x2 * d2)) + 0.5 * (d1 * d1 + d2 * d2)
        over += (a1 * z[0] + a2 * z[1]) + (b1 * z[3] + b2 * z[4])
        slope = (a1 * along[0] + a2 * along[1]) + (b1 * along[3] + b2 * along[4])
        if not (rate > DEPENDENT * most and -slope > STEEP * rate):
            break
        s = -over / slope
        shift = abs(s) * size_of(n)
        if shift > reach:
            break
        z = plus(z, s, along)
        e = plus(e, 1.0, z)
        before, off = off, size_of(z)
        way += off
        if CONTRACTION * off * (way + shift) * most <= (EPS * size * size) * rate or off <= SETTLED * size:
            status = 0.0
            break
        if 0.5 * before < off <= FLOOR * SETTLED * size:
            status = 0.0
            break
    return (e[0], e[1], e[2], e[3], e[4], e[5], status, rounds)


def keeping_xi(y: Floats, b: Six, start: Six, newton: Newton, k: float, reach: float, h: float, c: float) -> Solution:
    """The same for xi' = e^{-i h m3} xi in place of k' = k."""
    x1, x2 = xi_of(y[0], y[1], y[3], y[4], c)
    now = math.sqrt(x1 * x1 + x2 * x2)
    scale = k / now if now > 0.0 else 0.0
    p1, p2 = scale * x1, scale * x2
    size = (abs(y[0]) + abs(y[1]) + abs(y[2])) + (abs(y[3]) + abs(y[4]) + abs(y[5]))
    e = start
    status, rounds, off = math.nan, 0.0, math.inf
    for _ in range(ROUNDS):
        rounds += 1.0
        m = plus((y[0], y[1], y[2], y[3], y[4], y[5]), 0.5, e)
        f = field_of_m(m, c)
        u, v = fields_of_xi(m, c)
        nu, nv = bracket(m, u), bracket(m, v)
        au, av = newton_solved(newton, nu), newton_solved(newton, nv)
        z = newton_solved(newton, left_over(m, e, b, f, h))
        d1, d2 = change_of_xi(y, e, c)
        t1, t2 = turn_increment(h * m[2], p1, p2)
        w1, w2 = 2.0 * (y[0] + e[0]), 2.0 * (y[1] + e[1])
        r1 = ((x1 - p1) + (d1 - t1)) + ((w1 * z[0] - w2 * z[1]) - c * z[3])
        r2 = ((x2 - p2) + (d2 - t2)) + ((w2 * z[0] + w1 * z[1]) - c * z[4])
        m11, m12 = (w1 * au[0] - w2 * au[1]) - c * au[3], (w1 * av[0] - w2 * av[1]) - c * av[3]
        m21, m22 = (w2 * au[0] + w1 * au[1]) - c * au[4], (w2 * av[0] + w1 * av[1]) - c * av[4]
        det = m11 * m22 - m12 * m21
        if not abs(det) > DEPENDENT * ((m11 * m11 + m12 * m12) + (m21 * m21 + m22 * m22)):
            break
        su, sv = (m12 * r2 - m22 * r1) / det, (m21 * r1 - m11 * r2) / det
        z = plus(plus(z, su, au), sv, av)
        e = plus(e, 1.0, z)
        before, off = off, size_of(z)
        if abs(su) * size_of(nu) + abs(sv) * size_of(nv) > reach:
            break
        if off <= SETTLED * size or 0.5 * before < off <= FLOOR * SETTLED * size:
            status = 0.0
            break
    return (e[0], e[1], e[2], e[3], e[4], e[5], status, rounds)


def midpoint4_step(s: Floats, h: float, p: Floats) -> Floats:
    """Omega, gamma; the values aimed at; the size of the terms of xi, and 1.0 where k is small beside it; what was last
    added to HK's step, and what is expected next; whether the iteration settled; the counters.
    """
    y = (s[0], s[1], s[2], s[3], s[4], s[5])
    t = (s[6], s[7], s[8], s[9])
    c = p[0]
    z: Floats = hk_kowalevski(y, h, p)
    hk = (z[0] - y[0], z[1] - y[1], z[2] - y[2], z[3] - y[3], z[4] - y[4], z[5] - y[5])
    start = plus((s[18], s[19], s[20], s[21], s[22], s[23]), 1.0, hk)
    newton = newton_matrix(plus(y, 0.5, start), 0.5 * h, c)
    b = given_back(y, t, c)
    reach = min(1.0, h * h * s[10]) * size_of(hk)
    if s[11] > 0.0:
        e1, e2, e3, e4, e5, e6, status, rounds = keeping_xi(y, b, start, newton, t[3], reach, h, c)
    else:
        e1, e2, e3, e4, e5, e6, status, rounds = keeping_k(y, b, start, newton, t[3], reach, h, c)
    plain, unmet = s[26], s[27]
    if status != 0.0:
        v1, v2, v3, v4, v5, v6, status, more = midpoint(y, h, (2.0, 2.0, 1.0, c, 0.0, 0.0))
        v = (v1, v2, v3, v4, v5, v6)
        w, missed = onto_but_no_worse(v, reach * reach, c, t)
        e1, e2, e3, e4, e5, e6 = w[0] - y[0], w[1] - y[1], w[2] - y[2], w[3] - y[3], w[4] - y[4], w[5] - y[5]
        rounds += more
        plain += 1.0
        unmet += missed
    x1, x2, x3, x4, x5, x6 = e1 - hk[0], e2 - hk[1], e3 - hk[2], e4 - hk[3], e5 - hk[4], e6 - hk[5]
    return (
        y[0] + e1,
        y[1] + e2,
        y[2] + e3,
        y[3] + e4,
        y[4] + e5,
        y[5] + e6,
        t[0],
        t[1],
        t[2],
        t[3],
        s[10],
        s[11],
        x1,
        x2,
        x3,
        x4,
        x5,
        x6,
        2.0 * x1 - s[12],
        2.0 * x2 - s[13],
        2.0 * x3 - s[14],
        2.0 * x4 - s[15],
        2.0 * x5 - s[16],
        2.0 * x6 - s[17],
        status,
        s[25] + rounds,
        plain,
        unmet,
    )


def enter(y: Floats, h: float, p: Floats) -> Floats:
    """The physical state, the values of its integrals, and what they say of the size of omega² and of k."""
    c = p[0]
    t = targets_with_k(y, p)
    terms = t[2] + 2.0 * abs(c) * math.sqrt(2.0 * t[0])
    small = 1.0 if t[3] <= min(h * h * terms, SMALL_K) * terms else 0.0
    nothing = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return (y[0], y[1], y[2], y[3], y[4], y[5], *t, terms, small, *nothing, *nothing, 0.0, 0.0, 0.0, 0.0)


@scheme(
    "midpoint4",
    top="kowalevski",
    title="Implicit midpoint rule that keeps all four integrals",
    order=2,
    explicit=False,
    self_adjoint=True,
    conserves=("gamma_sq", "two_l", "energy", "k_sq"),
    citation="after Dahlby, Owren, Yaguchi 2011 (several integrals) and Cooper 1987 (quadratic ones)",
    equations="y' = y + h f(m) + s J(|F|² X - (F·X) F), m = (y + y')/2, F = J grad E, X = J grad k² at m, k(y') = k(y)",
    limits={"singular-step": LONG_NEWTON},
)
def build(top: Top, options: NoOptions) -> Stepper:
    """The implicit midpoint rule, which keeps gamma², 2l and E, and a change that keeps these, so long that k² is kept.

    Its own inverse under h -> -h; all four integrals are conserved. omega1 + i omega2 = 0 is an ordinary point. For k
    close to 0 (Delone's motion) xi = omega² - c gamma is turned by the mean omega3 instead, which keeps k. On
    degenerate tori, where the four gradients are dependent, and where the iteration does not settle, the step is the
    midpoint rule's, projected onto as many of the integrals as are independent. The run reports the iterations, such
    steps, and those of them that did not meet all four values. A step of which not even the midpoint rule's iteration
    settles ends the run as `no_convergence`.
    """
    return Stepper(midpoint4_step, 28, enter, leave, ("iterations", "plain_projections", "unmet"), iterative=True)
