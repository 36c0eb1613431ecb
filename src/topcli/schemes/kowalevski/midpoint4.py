"""Implicit midpoint rule for the Kowalevski top with a correction that conserves k² as well: all four integrals.

With y = (m, gamma), z = (y' + y)/2 and a direction n that conserves gamma², 2l and E (``lie_poisson``)::

    y' = y + h f(z) + s n(z),   s such that k(y') = k(y)

The midpoint rule conserves gamma², 2l and E because they are quadratic, and so does the term s n(z); only the number s
remains to be determined. All terms are symmetric in y and y', so the step is self-adjoint. It is not singular where
omega1 + i omega2 vanishes: k² enters by its gradient, and there is no square root.

If k is so small that the error of the step could rotate xi about 0, the condition on k is replaced by one on both
components of xi, with two directions n: xi' is xi rotated by -h m3. For k = 0 this is Delone's motion.

Performance:
- the iteration starts from HK's step plus the extrapolated difference between the solution and HK's step in the last
  two steps; the error is O(h⁵), and one iteration is typical for small h. The carried differences affect only the
  start of the iteration, not its limit;
- Newton's method for y' and s is bordered: both right-hand sides are solved in parallel with one factorization;
- n needs no matrix, and the first division is that by the derivative of k².

Robustness: the target values are those of the initial state. Deviations of gamma², 2l and E by round-off are corrected
by half of the gradient step of each (Cimmino's method), which is stable for any angles between the gradients;
deviations of k² are corrected only beyond ``BAND``, because a short n would magnify them. If n vanishes (degenerate
tori, relative equilibria), if s n exceeds the bound on corrections, or if the iteration does not converge, the step is
that of the midpoint rule, projected as in hk-projected, and is counted.
"""

from __future__ import annotations

import math

from topcli.arithmetic.complex_plane import rotation_increment
from topcli.arithmetic.tolerances import follow_precision
from topcli.arithmetic.vectors import Floats6, add, axpy, norm1, scaled, subtract
from topcli.contracts import Floats, NoOptions, Stepper, Top
from topcli.schemes.any_top.midpoint import midpoint
from topcli.schemes.declarations import LONG_NEWTON
from topcli.schemes.kowalevski.four_integrals import (
    EPS,
    Floats4,
    combination,
    first_three,
    fourth_column,
    target_values,
    xi_of,
)
from topcli.schemes.kowalevski.hk import hk_kowalevski
from topcli.schemes.kowalevski.lie_poisson import (
    DEPENDENT,
    TINY,
    NewtonMatrix,
    bracket,
    conserving_direction,
    momentum_field,
    newton_matrix,
    newton_solve,
    xi_fields,
)
from topcli.schemes.kowalevski.projected import TRIPLE_ROOT, project_unless_worse
from topcli.schemes.layout import stepper
from topcli.schemes.registry import scheme

ROUNDS = 12
"""Maximum number of iterations, after which a projected midpoint step is used instead; one or two are typical."""
SETTLED = 4.0 * EPS
"""Tolerance of the iteration, relative to the state: the last bits of the new state."""
FLOOR = 2.0**10
"""Factor by which an iteration may stall above ``SETTLED``, at magnified round-off near a degenerate torus."""
CONTRACTION = 4.0
"""Bound on the contraction factor of an iteration, in units of the sum of all changes and s n relative to the state,
divided by the squared sine of the angle between the field of k² and that of the motion, which is typically 1."""
SMALL_K = 2.0**-10
"""Threshold of k relative to its terms, below which xi is used instead; for small h it is h² times the terms."""
STEEP = 2.0**-4
"""Minimum derivative of k² along n relative to its leading term, so that the intended solution is found."""
BAND = 2.0 * EPS
"""Deviation of k² relative to its terms, its rounding error, which is not corrected."""
follow_precision(__name__, caps=("ROUNDS",), SETTLED=1, BAND=1)
Solution = tuple[Floats6, float, float]


def restoring_change(y: Floats, t: Floats4, c: float) -> Floats6:
    """Change of the state that takes gamma², 2l and E about halfway back to their targets in ``t``."""
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


def change_of_xi(y: Floats, e: Floats6, c: float) -> tuple[float, float]:
    """xi(y + e) - xi(y), with rounding errors proportional to e."""
    w1, w2, e1, e2 = y[0], y[1], e[0], e[1]
    return (
        (e1 * (2.0 * w1 + e1) - e2 * (2.0 * w2 + e2)) - c * e[3],
        2.0 * (e1 * (w2 + e2) + e2 * w1) - c * e[4],
    )


def midpoint_residual(m: Floats6, e: Floats6, b: Floats6, f: Floats6, h: float) -> Floats6:
    """Residual b + h f(m) - e of the midpoint rule; ``f`` is the vector field for (m, gamma)."""
    d = 0.5 * h
    return (
        (d * f[0] + b[0]) - e[0],
        (d * f[1] + b[1]) - e[1],
        (h * f[2] + b[2]) - e[2],
        (h * f[3] + b[3]) - e[3],
        (h * f[4] + b[4]) - e[4],
        (h * f[5] + b[5]) - e[5],
    )


def solve_with_k(
    y: Floats, b: Floats6, start: Floats6, newton: NewtonMatrix, k: float, reach: float, h: float, c: float
) -> Solution:
    """Change of the state that conserves k, by iteration from ``start``; status (0.0 or nan); number of iterations."""
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
        m = axpy((y[0], y[1], y[2], y[3], y[4], y[5]), 0.5, e)
        f = momentum_field(m, c)
        u1, u2 = xi_of(m[0], m[1], m[3], m[4], c)
        n, rate, most = conserving_direction(m, f, fourth_column(m[0], m[1], u1, u2, c))
        along = newton_solve(newton, n)
        z = newton_solve(newton, midpoint_residual(m, e, b, f, h))
        d1, d2 = change_of_xi(y, e, c)
        a1, a2, b1, b2 = fourth_column(y[0] + e[0], y[1] + e[1], x1 + d1, x2 + d2, c)
        over = (excess + (x1 * d1 + x2 * d2)) + 0.5 * (d1 * d1 + d2 * d2)
        over += (a1 * z[0] + a2 * z[1]) + (b1 * z[3] + b2 * z[4])
        slope = (a1 * along[0] + a2 * along[1]) + (b1 * along[3] + b2 * along[4])
        if not (rate > DEPENDENT * most and -slope > STEEP * rate):
            break
        s = -over / slope
        shift = abs(s) * norm1(n)
        if shift > reach:
            break
        z = axpy(z, s, along)
        e = add(e, z)
        before, off = off, norm1(z)
        way += off
        if CONTRACTION * off * (way + shift) * most <= (EPS * size * size) * rate or off <= SETTLED * size:
            status = 0.0
            break
        if 0.5 * before < off <= FLOOR * SETTLED * size:
            status = 0.0
            break
    return e, status, rounds


def solve_with_xi(
    y: Floats, b: Floats6, start: Floats6, newton: NewtonMatrix, k: float, reach: float, h: float, c: float
) -> Solution:
    """``solve_with_k`` with the condition xi' = e^{-i h m3} xi in place of k' = k."""
    x1, x2 = xi_of(y[0], y[1], y[3], y[4], c)
    now = math.sqrt(x1 * x1 + x2 * x2)
    scale = k / now if now > 0.0 else 0.0
    p1, p2 = scale * x1, scale * x2
    size = (abs(y[0]) + abs(y[1]) + abs(y[2])) + (abs(y[3]) + abs(y[4]) + abs(y[5]))
    e = start
    status, rounds, off = math.nan, 0.0, math.inf
    for _ in range(ROUNDS):
        rounds += 1.0
        m = axpy((y[0], y[1], y[2], y[3], y[4], y[5]), 0.5, e)
        f = momentum_field(m, c)
        u, v = xi_fields(m, c)
        nu, nv = bracket(m, u), bracket(m, v)
        au, av = newton_solve(newton, nu), newton_solve(newton, nv)
        z = newton_solve(newton, midpoint_residual(m, e, b, f, h))
        d1, d2 = change_of_xi(y, e, c)
        t1, t2 = rotation_increment(h * m[2], p1, p2)
        w1, w2 = 2.0 * (y[0] + e[0]), 2.0 * (y[1] + e[1])
        r1 = ((x1 - p1) + (d1 - t1)) + ((w1 * z[0] - w2 * z[1]) - c * z[3])
        r2 = ((x2 - p2) + (d2 - t2)) + ((w2 * z[0] + w1 * z[1]) - c * z[4])
        m11, m12 = (w1 * au[0] - w2 * au[1]) - c * au[3], (w1 * av[0] - w2 * av[1]) - c * av[3]
        m21, m22 = (w2 * au[0] + w1 * au[1]) - c * au[4], (w2 * av[0] + w1 * av[1]) - c * av[4]
        det = m11 * m22 - m12 * m21
        if not abs(det) > DEPENDENT * ((m11 * m11 + m12 * m12) + (m21 * m21 + m22 * m22)):
            break
        su, sv = (m12 * r2 - m22 * r1) / det, (m21 * r1 - m11 * r2) / det
        z = axpy(axpy(z, su, au), sv, av)
        e = add(e, z)
        before, off = off, norm1(z)
        if abs(su) * norm1(nu) + abs(sv) * norm1(nv) > reach:
            break
        if off <= SETTLED * size or 0.5 * before < off <= FLOOR * SETTLED * size:
            status = 0.0
            break
    return e, status, rounds


def midpoint4_step(s: Floats, h: float, p: Floats) -> Floats:
    """New state of one step, its status, and what the counters add.

    The state consists of omega, gamma; the last difference from HK's step, and its extrapolation to the next step. The
    target values follow, the size of the terms of xi, and 1.0 if k is small relative to it.
    """
    y = (s[0], s[1], s[2], s[3], s[4], s[5])
    t = (s[18], s[19], s[20], s[21])
    c = p[0]
    z: Floats = hk_kowalevski(y, h, p)
    hk = subtract(z, y)
    start = add((s[12], s[13], s[14], s[15], s[16], s[17]), hk)
    newton = newton_matrix(axpy(y, 0.5, start), 0.5 * h, c)
    b = restoring_change(y, t, c)
    reach = min(1.0, h * h * s[22]) * norm1(hk)
    if s[23] > 0.0:
        e, status, rounds = solve_with_xi(y, b, start, newton, t[3], reach, h, c)
    else:
        e, status, rounds = solve_with_k(y, b, start, newton, t[3], reach, h, c)
    plain, unmet = 0.0, 0.0
    if status != 0.0:
        v1, v2, v3, v4, v5, v6, status, more = midpoint(y, h, (2.0, 2.0, 1.0, c, 0.0, 0.0))
        v = (v1, v2, v3, v4, v5, v6)
        w, unmet = project_unless_worse(v, reach * reach, c, t)
        e = subtract(w, y)
        rounds += more
        plain = 1.0
    difference = subtract(e, hk)
    extrapolated = subtract(scaled(2.0, difference), (s[6], s[7], s[8], s[9], s[10], s[11]))
    return (*add(y, e), *difference, *extrapolated, status, rounds, plain, unmet)


def enter(y: Floats, h: float, p: Floats) -> Floats:
    """State, target values and sizes from the physical state; see ``midpoint4_step``."""
    c = p[0]
    t = target_values(y, p)
    terms = t[2] + 2.0 * abs(c) * math.sqrt(2.0 * t[0])
    small = 1.0 if t[3] <= min(h * h * terms, SMALL_K) * terms else 0.0
    return (*y, *(0.0,) * 12, *t, terms, small)


@scheme(
    "midpoint4",
    top="kowalevski",
    title="Implicit midpoint rule that conserves all four integrals",
    order=2,
    explicit=False,
    self_adjoint=True,
    conserves=("gamma_sq", "two_l", "energy", "k_sq"),
    citation="after Dahlby, Owren, Yaguchi 2011 (several integrals) and Cooper 1987 (quadratic ones)",
    formula=r"""
y' = y + h\,f(\bar y) + s\,J\,\bigl(|F|^2 X - (F\cdot X)\,F\bigr), \qquad
F = J\,\nabla E, \quad X = J\,\nabla k^2 \ \text{ at } \bar y, \qquad
s \text{ such that } k(y') = k(y), \qquad y = (m, \gamma)
""",
    equations="y' = y + h f(z) + s J(|F|² X - (F·X) F), z = (y + y')/2, F = J grad E, X = J grad k² at z, k(y') = k(y) "
    "for y = (m, gamma), m = (2 omega1, 2 omega2, omega3)",
    limits={
        "singular-step": LONG_NEWTON,
        "delone-sleeping": TRIPLE_ROOT.format("The steps are those of the midpoint rule, and k² is"),
    },
)
def build(top: Top, options: NoOptions) -> Stepper:
    """Implicit midpoint rule plus a change that conserves gamma², 2l and E, with its length chosen to conserve k².

    The equation is one for m and gamma: J is their Poisson tensor, and |F|² and F·X are products of their fields.
    Self-adjoint; all four integrals are conserved, and omega1 + i omega2 = 0 is a regular point. For k close to 0
    (Delone's motion), xi = omega² - c gamma is rotated by the mean omega3 instead, which conserves k. On degenerate
    tori, where the four gradients are linearly dependent, and if the iteration does not converge, the step is that of
    the midpoint rule, projected onto the independent integrals. The numbers of iterations, of such steps, and of such
    steps that did not restore all four values are reported. If the midpoint rule does not converge either, the run ends
    as `no_convergence`.
    """
    counters = ("iterations", "plain_projections", "unmet")
    return stepper(midpoint4_step, 18, 6, adds=False, counters=counters, iterative=True, enter=enter)
