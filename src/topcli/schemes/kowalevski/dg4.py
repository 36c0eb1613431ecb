"""Discrete gradient method that conserves all four integrals of the Kowalevski top.

With m = (y' + y)/2 and the 6x4 matrix D of discrete gradients between y and y'::

    y' = y + h f(m) - D x,   x such that gamma², 2l, E and k² are conserved

where D x is the component of h f(m) in the span of D. The discrete gradients of the quadratic gamma², 2l, E are their
gradients at m; that of k² is the mean of its gradient on the segment from y to y', for which Simpson's rule is exact.
All terms are symmetric in y and y', so the step is self-adjoint. The target values are those of the initial state, so
that round-off does not accumulate.

The equations are solved by a simplified Newton iteration with the matrix 1 - h/2 f' at the midpoint of HK's step: the
derivative of D x is only O(h²), because f is normal to every gradient.

Performance: gamma is eliminated as in HK, the 3x3 and 4x4 systems are solved in scalars without calls or arrays, and
all iterations of a step share one matrix.
"""

from __future__ import annotations

import math

from topcli.arithmetic.rotations import resolvent
from topcli.arithmetic.tolerances import follow_precision
from topcli.arithmetic.vectors import Floats6, Matrix, add, axpy, dot, scaled, solve3, subtract
from topcli.contracts import Floats, NoOptions, Stepper, Top
from topcli.schemes.declarations import NEWTON_SINGULAR
from topcli.schemes.heavy.hk import implicit_matrix
from topcli.schemes.kowalevski.four_integrals import (
    EPS,
    Floats4,
    combination,
    directional_derivatives,
    enter_with_targets,
    factorize,
    first_three,
    gram,
    mean_column,
    solve,
    xi_of,
)
from topcli.schemes.kowalevski.hk import hk_kowalevski
from topcli.schemes.kowalevski.projected import MAX_CORRECTION, TRIPLE_ROOT, VANISHING, project_unless_worse
from topcli.schemes.layout import stepper
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
"""Factor by which an iteration may stall above ``SETTLED``."""
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
    matrix = implicit_matrix(a, (n1, n2, n3), d, (2.0, 2.0, 1.0, c, 0.0, 0.0))
    four = k > VANISHING * (w * w + abs(c) * g)
    start = z
    status = math.nan
    off, short = 0.0, 0.0
    for i in range(DG_ITERATIONS + MIDPOINT_ITERATIONS):
        if i == DG_ITERATIONS:
            four = False
            z = start
        iterations += 1.0
        f, short = right_hand_side(y, z, excess, reach * reach, four, h, p)
        r = subtract(f, z)
        before = off
        off = abs(r[0]) + abs(r[1]) + abs(r[2]) + abs(r[3]) + abs(r[4]) + abs(r[5])
        # near a degenerate torus the iteration stalls at the magnified rounding errors of D^T f; it is projected below
        if off <= tolerance or (0.25 * before < off <= FLOOR * tolerance and i > 0):
            z = f
            status = 0.0
            break
        b = implicit_change(a, e, matrix, d, c, r)
        # written out: with a call of add the step takes a tenth longer
        z = (z[0] + b[0], z[1] + b[1], z[2] + b[2], z[3] + b[3], z[4] + b[4], z[5] + b[5])
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
    conserves=("gamma_sq", "two_l", "energy", "k_sq"),
    citation="McLachlan, Quispel, Robidoux 1999; Dahlby, Owren, Yaguchi 2011 (several integrals)",
    formula=r"""
y' = y + h\,\bigl(1 - D\,(D^{\mathsf T} D)^{-1} D^{\mathsf T}\bigr)\,f(\bar y), \qquad
D = (\bar\nabla I_1, \dots, \bar\nabla I_4), \qquad \bar\nabla I\cdot(y' - y) = I(y') - I(y)
""",
    equations="y' = y + h (1 - D (D^T D)^-1 D^T) f((y + y')/2), D the discrete gradients of gamma², 2l, E, k²",
    limits={
        "singular-step": NEWTON_SINGULAR,
        "delone-sleeping": TRIPLE_ROOT.format("The steps are those of the midpoint rule, and k² is"),
        "huge": "The iteration ends at the round-off of the whole state: if omega is larger than gamma by many powers "
        "of ten, the last digits of gamma are not converged, and gamma² changes by 1e-12. Beyond |omega| of about 1e77 "
        "|xi|² overflows, and the midpoint rule is used.",
    },
)
def build(top: Top, options: NoOptions) -> Stepper:
    """Implicit midpoint rule without its component along the discrete gradients of gamma², 2l, E and k².

    Self-adjoint; all four integrals are conserved. On degenerate tori, where the gradients are linearly dependent, only
    independent integrals are used. For k = 0 (Delone's motion), and if the iteration does not converge, the step is
    that of the midpoint rule, projected as in hk-projected; a step whose iteration stalls at magnified round-off is
    projected too. The numbers of midpoint steps and of those that did not restore all four values are reported. If the
    midpoint rule does not converge either, the run ends as `no_convergence`.
    """
    return stepper(dg4_step, 6, 4, adds=False, counters=COUNTERS, iterative=True, enter=enter_with_targets)
