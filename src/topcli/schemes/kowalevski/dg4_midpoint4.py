"""Self-adjoint implicit steps that conserve all four integrals of the Kowalevski top: `dg4` and `midpoint4`.

**dg4**, a discrete gradient method. With m = (y' + y)/2 and the 6x4 matrix D of discrete gradients between y and y'::

    y' = y + h f(m) - D x,   x such that gamma², 2l, E and k² are conserved

where D x is the component of h f(m) in the span of D. The discrete gradients of the quadratic gamma², 2l, E are their
gradients at m; that of k² is the mean of its gradient on the segment from y to y', for which Simpson's rule is exact.
All terms are symmetric in y and y', so the step is self-adjoint. The target values are those of the initial state, so
that round-off does not accumulate.

The equations are solved by a simplified Newton iteration with the matrix 1 - h/2 f' at the midpoint of HK's step: the
derivative of D x is only O(h²), because f is normal to every gradient.

Performance: gamma is eliminated as in HK, the 3x3 and 4x4 systems are solved in scalars without calls or arrays, and
all iterations of a step share one matrix.

**midpoint4**, the implicit midpoint rule with a correction that conserves k² as well. With y = (m, gamma), z = (y' +
y)/2 and a direction n that conserves gamma², 2l and E (``four_integrals``)::

    y' = y + h f(z) + s n(z),   s such that k(y') = k(y)

The midpoint rule conserves gamma², 2l and E because they are quadratic, and so does the term s n(z); only the number s
remains to be determined. This step is symmetric too. It is not singular where omega1 + i omega2 vanishes: k² enters by
its gradient, and there is no square root.

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

from topcli.arithmetic.fused import follow_precision
from topcli.arithmetic.vectors import (
    Floats6,
    Matrix,
    Vector,
    add,
    axpy,
    dot,
    norm1,
    resolvent,
    rotation_increment,
    scaled,
    solve3,
    subtract,
)
from topcli.contracts import Floats, NoOptions, Stepper, Top
from topcli.schemes.kowalevski.four_integrals import (
    EPS,
    INTEGRALS,
    PARALLEL,
    Floats4,
    NewtonMatrix,
    bracket,
    change_of_xi,
    combination,
    conserving_direction,
    directional_derivatives,
    enter_with_targets,
    factorize,
    first_three,
    fourth_column,
    gram,
    mean_column,
    momentum_field,
    newton_matrix,
    newton_solve,
    restoring_change,
    solve,
    target_values,
    xi_fields,
    xi_of,
)
from topcli.schemes.kowalevski.hk import hk_kowalevski
from topcli.schemes.kowalevski.projected import MAX_CORRECTION, TRIPLE_ROOT, VANISHING, project_unless_worse
from topcli.schemes.layout import LONG_NEWTON, NEWTON_SINGULAR, stepper
from topcli.schemes.registry import scheme
from topcli.tops.kowalevski import field

DG_ITERATIONS = 16
"""Maximum number of iterations, after which the midpoint rule is used instead; three to five are typical."""
MIDPOINT_ITERATIONS = 40
"""Maximum number of iterations for the midpoint rule, after which the step fails."""
COUNTERS = ("iterations", "midpoint_steps", "short_corrections", "unmet")
"""Number of iterations; of midpoint steps used instead; of steps in which an integral was omitted or its correction
shortened, because the gradients were nearly dependent; of projected steps that did not restore all four values."""
FLOOR = 2.0**10
"""Factor by which an iteration may stall above ``SETTLED``, at magnified round-off near a degenerate torus."""
SETTLED = 4.0 * EPS
"""Tolerance of the iteration, relative to the state: the last bits of the new state."""
follow_precision(__name__, caps=("DG_ITERATIONS", "MIDPOINT_ITERATIONS"), SETTLED=1)


def right_hand_side(
    y: Floats, e: Floats, excess: Floats4, reach: float, four: bool, h: float, p: Floats
) -> tuple[Floats6, float]:
    """Right-hand side h f(m) - D x for the change ``e``, and the number of integrals that are not fully corrected.

    ``excess`` are the deviations of the integrals of y from the targets. Integrals are omitted if the Gram matrix is
    nearly singular. With ``four`` false the result is h f(m) alone: the implicit midpoint rule, which conserves the
    three quadratic integrals.
    """
    c = p[0]
    m: Floats = axpy(y, 0.5, e)
    v = scaled(h, field(m, p))
    if not four:
        return v, 0.0
    column = mean_column(y, e, c)
    r1, r2, r3, r4 = directional_derivatives(m, c, column, v)
    residual = (r1 + excess[0], r2 + excess[1], r3 + excess[2], r4 + excess[3])
    x1, x2, x3, x4, short = solve(factorize(gram(m, c, column), True), residual, reach * dot(v, v))
    return subtract(v, combination(m, c, column, (x1, x2, x3, x4))), short


def implicit_change(a: Floats, e: Floats, matrix: Matrix, d: float, c: float, r: Floats6) -> Floats6:
    """Solve z - h/2 f'(m) z = r for z; ``a`` is d omega and ``e`` d gamma at m, ``matrix`` the system for omega."""
    a1, a2, a3 = a
    e1, e2, e3 = e
    _, s2, s3 = resolvent(a1, a2, a3, r[3], r[4], r[5])
    k = d * c
    z1, z2, z3 = solve3(matrix, r[0], r[1] + (0.5 * k) * s3, r[2] - k * s2)
    t1, t2, t3 = resolvent(
        a1, a2, a3, r[3] + (e2 * z3 - e3 * z2), r[4] + (e3 * z1 - e1 * z3), r[5] + (e1 * z2 - e2 * z1)
    )
    return (z1, z2, z3, t1, t2, t3)


def omega_matrix(a: Vector, gamma: Vector, d: float, c: float) -> Matrix:
    """Matrix of 1 - h/2 f' for the change of omega alone, in row-major order, for a = d omega, gamma and d = h/2."""
    a1, a2, a3 = a
    e1, e2, e3 = d * gamma[0], d * gamma[1], d * gamma[2]
    _, s21, s31 = resolvent(a1, a2, a3, 0.0, e3, -e2)
    _, s22, s32 = resolvent(a1, a2, a3, -e3, 0.0, e1)
    _, s23, s33 = resolvent(a1, a2, a3, e2, -e1, 0.0)
    k = d * c
    return (
        1.0,
        -0.5 * a3,
        -0.5 * a2,
        0.5 * a3 - 0.5 * k * s31,
        1.0 - 0.5 * k * s32,
        0.5 * a1 - 0.5 * k * s33,
        k * s21,
        k * s22,
        1.0 + k * s23,
    )


def iterated(
    y: Floats,
    z: Floats,
    excess: Floats4,
    size: tuple[float, float, float],
    four: bool,
    system: tuple[Vector, Vector, Matrix],
    h: float,
    p: Floats,
) -> tuple[Floats, float, float, float, float]:
    """Change of a step by a simplified Newton iteration from ``z``; see ``right_hand_side``.

    Its status, the number of iterations, the last residual, and the number of integrals that are not fully corrected
    follow. ``size`` are the tolerance, the reach of corrections, and the weight of gamma's residual; ``system`` are the
    arguments of ``implicit_change``.
    """
    tolerance, reach, weight = size
    a, e, matrix = system
    off, short, iterations = 0.0, 0.0, 0.0
    for i in range(DG_ITERATIONS if four else MIDPOINT_ITERATIONS):
        iterations += 1.0
        f, short = right_hand_side(y, z, excess, reach, four, h, p)
        r = subtract(f, z)
        before = off
        off = abs(r[0]) + abs(r[1]) + abs(r[2]) + weight * (abs(r[3]) + abs(r[4]) + abs(r[5]))
        # near a degenerate torus the iteration stalls at the magnified rounding errors of D^T f; it is projected below
        if off <= tolerance or (0.25 * before < off <= FLOOR * tolerance and i > 0):
            return f, 0.0, iterations, off, short
        b = implicit_change(a, e, matrix, 0.5 * h, p[0], r)
        # written out: with a call of add the step takes a tenth longer
        z = (z[0] + b[0], z[1] + b[1], z[2] + b[2], z[3] + b[3], z[4] + b[4], z[5] + b[5])
    return z, math.nan, iterations, off, short


def dg4_step(s: Floats, h: float, p: Floats) -> Floats:
    """New omega, gamma, from these and the four target values; the status of the iteration; what the counters add."""
    w1, w2, w3, g1, g2, g3, i1, i2, i3, k = s
    iterations, midpoint_steps, unmet = 0.0, 0.0, 0.0
    c = p[0]
    d = 0.5 * h
    y = (w1, w2, w3, g1, g2, g3)
    k1, k2, k3 = first_three(y, c)
    x1, x2 = xi_of(w1, w2, g1, g2, c)
    xi = math.sqrt(x1 * x1 + x2 * x2)
    excess = (k1 - i1, k2 - i2, k3 - i3, 0.5 * ((xi - k) * (xi + k)))
    w, g = abs(w1) + abs(w2) + abs(w3), abs(g1) + abs(g2) + abs(g3)
    reach = min(1.0, MAX_CORRECTION * (h * h) * (w * w + abs(c) * g))
    tolerance = SETTLED * (w + g)
    z = subtract(hk_kowalevski(y, h, p), y)
    m1, m2, m3, n1, n2, n3 = axpy(y, 0.5, z)
    a, e = (d * m1, d * m2, d * m3), (d * n1, d * n2, d * n3)
    matrix = omega_matrix(a, (n1, n2, n3), d, c)
    four = k > VANISHING * (w * w + abs(c) * g)
    size = tolerance, reach * reach, 1.0
    status, more, off, short = math.nan, 0.0, math.inf, 0.0
    f: Floats = z
    if four:
        f, status, iterations, off, short = iterated(y, z, excess, size, True, (a, e, matrix), h, p)
    if status != 0.0:
        four = False
        f, status, more, off, short = iterated(y, z, excess, size, False, (a, e, matrix), h, p)
        iterations += more
    z = f
    new: Floats = add(y, z)
    if not four or off > tolerance:
        midpoint_steps += 0.0 if four else 1.0
        new, missed = project_unless_worse(new, (reach * reach) * dot(z, z), c, (i1, i2, i3, k))
        unmet += missed
    short = 1.0 if short > 0.0 else 0.0
    return (*new, status, iterations, midpoint_steps, short, unmet)


@scheme(
    "dg4",
    top="kowalevski",
    title="Discrete gradient method for all four integrals",
    order=2,
    explicit=False,
    self_adjoint=True,
    conserves=INTEGRALS,
    citation="McLachlan, Quispel, Robidoux 1999; Dahlby, Owren, Yaguchi 2011 (several integrals)",
    formula=r"""
y' = y + h\,\bigl(1 - D\,(D^{\mathsf T} D)^{-1} D^{\mathsf T}\bigr)\,f(\bar y), \qquad
D = (\bar\nabla I_1, \dots, \bar\nabla I_4), \qquad \bar\nabla I\cdot(y' - y) = I(y') - I(y)
""",
    equations="y' = y + h (1 - D (D^T D)^-1 D^T) f((y + y')/2), D the discrete gradients of gamma², 2l, E, k²",
    limits={
        "singular-step": NEWTON_SINGULAR,
        "delone-sleeping": TRIPLE_ROOT.format("The steps are then those of the midpoint rule, and k² deviates"),
        "huge": "The iteration for the step ends when its error is at the level of round-off relative to the whole "
        "state. If omega is larger than gamma by many powers of ten, the last digits of gamma have not converged by "
        "then, and gamma² changes by 1e-12. If |omega| exceeds about 1e77, k² overflows, and the step is that of the "
        "midpoint rule.",
    },
)
def build_dg4(top: Top, options: NoOptions) -> Stepper:
    """The scheme omits from the implicit midpoint rule the part along the discrete gradients of gamma², 2l, E and k².

    The scheme is self-adjoint and conserves all four integrals. On degenerate tori, where the gradients are linearly
    dependent, the scheme uses only integrals with independent gradients. For k = 0 (Delone's motion), or if the
    iteration for the step does not converge, the scheme instead takes a step of the midpoint rule and projects it onto
    the integrals as in `hk-projected`. If the iteration stops converging at a level above round-off, the step is
    projected too. If the iteration for the midpoint rule does not converge either, the run ends as `no_convergence`.

    A run reports the number of midpoint steps (`midpoint_steps`) and the number of steps that did not restore the
    values of all four integrals (`unmet`).
    """
    return stepper(dg4_step, 6, 4, adds=False, counters=COUNTERS, iterative=True, enter=enter_with_targets)


ROUNDS = 12
"""Maximum number of iterations, after which a projected midpoint step is used instead; one or two are typical."""
CONTRACTION = 4.0
"""Bound on the contraction factor of an iteration, in units of the sum of all changes and s n relative to the state,
divided by the squared sine of the angle between the field of k² and that of the motion, which is typically 1."""
SMALL_K = 2.0**-10
"""Threshold of k relative to its terms, below which xi is used instead; for small h it is h² times the terms."""
STEEP = 2.0**-4
"""Minimum derivative of k² along n relative to its leading term, so that the intended solution is found."""
BAND = 2.0 * EPS
"""Deviation of k² relative to its terms, its rounding error, which is not corrected."""
follow_precision(__name__, caps=("ROUNDS",), BAND=1)
Solution = tuple[Floats6, float, float]


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
    size = norm1(y)
    e = start
    status, rounds, off, way = math.nan, 0.0, math.inf, 0.0
    for _ in range(ROUNDS):
        rounds += 1.0
        m = axpy(y, 0.5, e)
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
        if not (rate > PARALLEL * most and -slope > STEEP * rate):
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
    size = norm1(y)
    e = start
    status, rounds, off = math.nan, 0.0, math.inf
    for _ in range(ROUNDS):
        rounds += 1.0
        m = axpy(y, 0.5, e)
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
        if not abs(det) > PARALLEL * ((m11 * m11 + m12 * m12) + (m21 * m21 + m22 * m22)):
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
        d = 0.5 * h
        m1, m2, m3, n1, n2, n3 = axpy(y, 0.5, hk)
        a, g = (d * m1, d * m2, d * m3), (n1, n2, n3)
        system = a, (d * n1, d * n2, d * n3), omega_matrix(a, g, d, c)
        w = abs(y[0]) + abs(y[1]) + abs(y[2]) + abs(d * c)
        size = SETTLED * w, 0.0, w  # gamma is of length one
        v, status, more, _, _ = iterated(y, hk, (0.0, 0.0, 0.0, 0.0), size, False, system, h, p)
        v = add(y, v)
        new, unmet = project_unless_worse(v, reach * reach, c, t)
        e = subtract(new, y)
        rounds += more
        plain = 1.0
    difference = subtract(e, hk)
    extrapolated = subtract(scaled(2.0, difference), (s[6], s[7], s[8], s[9], s[10], s[11]))
    return (*add(y, e), *difference, *extrapolated, status, rounds, plain, unmet)


def enter_midpoint4(y: Floats, h: float, p: Floats) -> Floats:
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
    conserves=INTEGRALS,
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
        "delone-sleeping": TRIPLE_ROOT.format("The steps are then those of the midpoint rule, and k² deviates"),
    },
)
def build_midpoint4(top: Top, options: NoOptions) -> Stepper:
    """The implicit midpoint rule plus a term that conserves gamma², 2l and E and has the size that keeps k² constant.

    In the equation of the step, J is the Poisson tensor of m and gamma, and F and X are the Hamiltonian vector fields
    of the energy and of k². The scheme is self-adjoint and conserves all four integrals. Unlike the scheme `hybrid` and
    its variants, `midpoint4` is regular at omega1 + i omega2 = 0. For k close to 0 (Delone's motion), two such terms
    make xi = (omega1 + i omega2)² - c (gamma1 + i gamma2) rotate by the angle -h times the mean omega3, which conserves
    k = |xi|.

    On degenerate tori, where the gradients of the four integrals are linearly dependent, and wherever the iteration for
    the step does not converge, the scheme instead takes a step of the midpoint rule and projects it onto the
    independent integrals. If the iteration for the midpoint rule does not converge either, the run ends as
    `no_convergence`. A run reports the number of iterations, the number of projected steps (`plain_projections`) and
    the number of those that did not restore the values of all four integrals (`unmet`).
    """
    counters = ("iterations", "plain_projections", "unmet")
    return stepper(midpoint4_step, 18, 6, adds=False, counters=counters, iterative=True, enter=enter_midpoint4)
