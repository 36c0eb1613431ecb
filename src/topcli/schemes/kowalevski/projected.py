"""HK for the Kowalevski top, projected onto the level set of its four integrals, by standard or symmetric projection.

Performance:
- D^T D is computed from a few sums and factorized in scalars, without arrays or LAPACK;
- HK leaves the level set by O(h³), and one correction with the gradients at HK's point reduces this to O(h⁶): two
  corrections with one factorization are typical.

Robustness: the target values are those of the initial state, so that nothing accumulates. Integrals with dependent
gradients are omitted, and xi replaces a vanishing k (``projection``). No correction is longer than HK's step, and a
correction that does not reduce the deviations is discarded; the step is then HK's and is counted.

Projection of a state of the Kowalevski top onto given values of its four integrals, by the shortest correction.

Integrals with dependent gradients are omitted (``four_integrals``). The length of a correction is limited, and a
correction that does not reduce the deviations is discarded. For xi = 0 the gradient of k does not exist, and if k is
about as small as its deviation, the direction of the gradient changes within the correction; the condition on k is then
replaced by one on both components of xi.
"""

from __future__ import annotations

import math

from topcli.arithmetic.fused import follow_precision
from topcli.arithmetic.vectors import Vector, add, axpy, dot, scaled, subtract
from topcli.contracts import Floats, NoOptions, Stepper, Top
from topcli.schemes.kowalevski.four_integrals import (
    EPS,
    INTEGRALS,
    Floats4,
    combination,
    directional_derivatives,
    enter_with_targets,
    factorize,
    first_three,
    fourth_column,
    gram,
    mean_column,
    sizes,
    solve,
    xi_correction,
    xi_of,
)
from topcli.schemes.kowalevski.hk import hk_kowalevski
from topcli.schemes.layout import stepper
from topcli.schemes.registry import scheme

ROUNDS = 3
"""Maximum number of factorizations for all four integrals; one is typical."""
ROUNDS_WITHOUT_K = 2
"""Maximum number of further factorizations without k."""
ROUNDS_FOR_XI = 5
"""Maximum number of corrections with xi instead of k; two are typical."""
XI_THRESHOLD = 2.0**-4
"""Relative deviation of k above which xi is used instead."""
SETTLED = EPS
"""Tolerance of the deviations from the targets, relative to ``sizes``: about the round-off of evaluating them."""
MET = 8.0 * EPS
"""Largest deviation of an integral that counts as restored."""
WELL_CONSERVED = 64.0 * EPS
"""Deviation of gamma², 2l and E above which a projection is worse than a state that conserves these three."""
TINY = 1e-300
follow_precision(
    __name__,
    caps=("ROUNDS", "ROUNDS_WITHOUT_K", "ROUNDS_FOR_XI"),
    SETTLED=1,
    MET=1,
    WELL_CONSERVED=1,
    TINY=20,
)
Projection = tuple[Floats, float, float, float]
"""Projected state, and the increments of ``COUNTERS``."""
TRIPLE_ROOT = (
    "If k = 0 and also E = 2 l², the gradients of gamma², 2l, E and of both components of Kowalevski's variable xi, "
    "with k = |xi|, are linearly dependent on the whole orbit. {} by more than round-off. The counter `unmet` counts "
    "such steps."
)
"""Limit of the projections onto the four integrals in the case ``delone-sleeping``."""


def deviations(y: Floats, c: float, t: Floats4) -> Floats:
    """Deviations of gamma²/2, 2l, E and k from ``t``, and the direction xi/k, taken as 1 for xi = 0."""
    x, v = xi_of(y[0], y[1], y[3], y[4], c)
    k = math.sqrt(x * x + v * v)
    if k > 0.0:
        u1, u2 = x / k, v / k
    else:
        u1, u2 = 1.0, 0.0
    i1, i2, i3 = first_three(y, c)
    return (i1 - t[0], i2 - t[1], i3 - t[2], k - t[3], u1, u2)


def largest_deviation(r1: float, r2: float, r3: float, r4: float, s: Vector) -> float:
    """Largest deviation relative to the sizes ``s``; a size of 0 is replaced by a tiny number."""
    return max(max(abs(r1) / (s[0] + TINY), abs(r2) / (s[1] + TINY)), max(abs(r3), abs(r4)) / (s[2] + TINY))


def project_with_xi(start: Floats, limit: float, c: float, t: Floats4) -> Projection:
    """``project`` for small k, where the direction of xi changes within the projection: onto both components of xi.

    The target of xi has the direction of its value at ``start``. For k = 0, where the gradient of k does not exist and
    that of k² vanishes, xi = 0 provides two equations with regular gradients.
    """
    y: Floats = start
    size = sizes(y, c)
    x1, x2 = xi_of(y[0], y[1], y[3], y[4], c)
    now = math.sqrt(x1 * x1 + x2 * x2)
    scale = t[3] / now if now > 0.0 else 0.0
    p1, p2 = scale * x1, scale * x2
    i1, i2, i3 = first_three(y, c)
    off = largest_deviation(i1 - t[0], i2 - t[1], i3 - t[2], abs(x1 - p1) + abs(x2 - p2), size)
    corrections, cut = 0.0, 0.0
    nothing = (0.0, 0.0, 0.0, 0.0)
    for _ in range(ROUNDS_FOR_XI):
        if off <= SETTLED:
            break
        factors = factorize(gram(y, c, nothing), False)
        n1, n2, n3, _, _ = solve(factors, (i1 - t[0], i2 - t[1], i3 - t[2], 0.0), limit)
        z: Floats = subtract(y, combination(y, c, nothing, (n1, n2, n3, 0.0)))
        x1, x2 = xi_of(z[0], z[1], z[3], z[4], c)
        e, dependent = xi_correction(z, x1 - p1, x2 - p2, c)
        length = dot(e, e)
        if length > limit:
            e = scaled(math.sqrt(limit / length), e)
            dependent = 1.0
        z = subtract(z, e)
        x1, x2 = xi_of(z[0], z[1], z[3], z[4], c)
        i1, i2, i3 = first_three(z, c)
        new = largest_deviation(i1 - t[0], i2 - t[1], i3 - t[2], abs(x1 - p1) + abs(x2 - p2), size)
        if not new < off:
            break
        y, off = z, new
        corrections += 1.0
        cut = max(cut, dependent)
    return (y, corrections, cut, 0.0 if off <= MET else 1.0)


def project(start: Floats, limit: float, c: float, t: Floats4) -> Projection:
    """Return the projection of ``start`` onto the values ``t`` and the increments of the counters."""
    y: Floats = start
    size = sizes(y, c)
    x1, x2 = xi_of(y[0], y[1], y[3], y[4], c)
    if not abs(math.sqrt(x1 * x1 + x2 * x2) - t[3]) < XI_THRESHOLD * t[3]:
        return project_with_xi(start, limit, c, t)
    corrections, unmet = 0.0, 0.0
    r1, r2, r3, r4, u1, u2 = deviations(y, c, t)
    off = largest_deviation(r1, r2, r3, r4, size)
    going = not off <= SETTLED
    cut = 0.0
    for i in range(ROUNDS + ROUNDS_WITHOUT_K):
        if i == ROUNDS and not off <= MET:
            # k has no gradient at xi = 0, and a rapidly varying one nearby; restore the other three
            unmet += 1.0
            off = largest_deviation(r1, r2, r3, 0.0, size)
            going = not off <= SETTLED
        if not going:
            if i >= ROUNDS or off <= MET:
                break
            continue
        base = y
        column = fourth_column(y[0], y[1], u1, u2, c)
        factors = factorize(gram(y, c, column), i < ROUNDS)
        for _ in range(2):
            x1, x2, x3, x4, out = solve(factors, (r1, r2, r3, r4), limit)
            cut = max(cut, out)
            z = subtract(y, combination(base, c, column, (x1, x2, x3, x4)))
            q1, q2, q3, q4, v1, v2 = deviations(z, c, t)
            new = largest_deviation(q1, q2, q3, q4 if i < ROUNDS else 0.0, size)
            going = new < off
            if not going:
                break
            corrections += 1.0
            y, off = z, new
            r1, r2, r3, r4, u1, u2 = q1, q2, q3, q4, v1, v2
            going = not off <= SETTLED
            if not going:
                break
    return (y, corrections, min(cut, 1.0), unmet)


def project_unless_worse(start: Floats, limit: float, c: float, t: Floats4) -> tuple[Floats, float]:
    """Project a ``start`` that conserves gamma², 2l and E; return it unchanged if they would be lost.

    Also returns 1.0 if the targets are not met, else 0.0.
    """
    y, _, _, unmet = project(start, limit, c, t)
    r1, r2, r3, _, _, _ = deviations(y, c, t)
    if not largest_deviation(r1, r2, r3, 0.0, sizes(y, c)) <= WELL_CONSERVED:
        y = start
    return (y, unmet)


SYMMETRIC_ROUNDS = 12
"""Maximum number of iterations of the symmetric projection; three or four are typical."""
VANISHING = 2.0**-26
"""k relative to its terms, below which k² and its gradient, which vanishes at xi = 0, are round-off."""
SETTLED_CHANGES = EPS / 4.0
"""Tolerance for the changes of the integrals over a step, which are more accurate than the integrals."""
follow_precision(__name__, caps=("SYMMETRIC_ROUNDS",), VANISHING=0.5, SETTLED_CHANGES=1)
MAX_CORRECTION = 1.0
"""Largest length of a correction relative to that of the step: this times h² (omega² + c gamma), but at most 1."""
LIMITS = {
    "resonance": "If h is about the time of one revolution of the body, HK jumps so far that no correction of at most "
    "the length of HK's step restores the integrals. The counter `unmet` counts such steps.",
    "delone-sleeping": TRIPLE_ROOT.format("All four integrals may deviate"),
    "singular-step": "The linear system of HK is singular for the h of this case, so HK's new state has a size of "
    "1e15 or more. From such a state the integrals cannot be restored. The counter `unmet` counts such steps.",
    "huge": "If |omega| exceeds about 1e77, k² overflows, so no correction can be computed, and the integrals are not "
    "restored. The counter `unmet` counts such steps.",
}
COUNTERS = ("corrections", "short_corrections", "unmet")
"""Number of corrections; of steps with a shortened correction or an omitted integral; of steps that did not restore all
four values."""


def projected_step(s: Floats, h: float, p: Floats) -> Floats:
    """New omega, gamma, from these and the four target values; what the counters add."""
    w1, w2, w3, g1, g2, g3, t1, t2, t3, t4 = s
    c = p[0]
    old = (w1, w2, w3, g1, g2, g3)
    z: Floats = hk_kowalevski(old, h, p)
    reach = min(1.0, MAX_CORRECTION * (h * h) * sizes(z, c)[2])
    change = subtract(z, old)
    limit = (reach * reach) * dot(change, change)
    y, more, cut, missed = project(z, limit, c, (t1, t2, t3, t4))
    return (y[0], y[1], y[2], y[3], y[4], y[5], more, cut, missed)


@scheme(
    "hk-projected",
    top="kowalevski",
    title="HK projected onto all four integrals",
    order=2,
    explicit=True,
    self_adjoint=False,
    conserves=INTEGRALS,
    citation="Hairer, Lubich, Wanner, Geometric Numerical Integration, section IV.4 (projection methods)",
    formula=r"""
y' = z - D(z)\,x, \qquad z = \Phi^{\mathrm{HK}}_h(y), \qquad x \text{ such that } I(y') = I(y), \qquad
D = (\nabla I_1, \dots, \nabla I_4)
""",
    equations="y' = z - D(z) x, z = HK(y), D the gradients of gamma², 2l, E, k, and x such that all four are conserved",
    limits=LIMITS,
)
def build(top: Top, options: NoOptions) -> Stepper:
    """A step of HK, followed by the shortest correction that restores the initial values of gamma², 2l, E and k.

    HK is the Hirota-Kimura scheme (`hk`). Unlike HK, the projected scheme is not self-adjoint. Newton's method for the
    correction recomputes the gradients of the integrals after every two iterations. The equation of the step therefore
    holds only up to terms of fourth order in the multipliers x; these terms are below round-off in double precision but
    visible with 50 digits. On degenerate tori and at relative equilibria the four gradients are linearly dependent;
    there only independent integrals are restored. No iteration moves the state farther than HK's step did.

    A run reports the number of iterations (`corrections`) and the number of steps that did not restore all four values
    (`unmet`).
    """
    return stepper(projected_step, 6, 4, adds=False, counters=COUNTERS, enter=enter_with_targets)


def k_sq_column(y: Floats, c: float) -> Floats4:
    """Fourth column for k²/2, which unlike that for k is smooth everywhere."""
    x1, x2 = xi_of(y[0], y[1], y[3], y[4], c)
    return fourth_column(y[0], y[1], x1, x2, c)


def gram_sum(m: Floats, n: Floats) -> Floats:
    """Return m + n."""
    m11, m12, m13, m14, m22, m23, m24, m33, m34, m44 = m
    n11, n12, n13, n14, n22, n23, n24, n33, n34, n44 = n
    first = (m11 + n11, m12 + n12, m13 + n13, m14 + n14)
    return (*first, m22 + n22, m23 + n23, m24 + n24, m33 + n33, m34 + n34, m44 + n44)


def changes(old: Floats, new: Floats, c: float) -> Floats4:
    """Changes of the integrals by discrete gradients, because round-off is magnified near degenerate tori."""
    e: Floats = subtract(new, old)
    return directional_derivatives(axpy(old, 0.5, e), c, mean_column(old, e, c), e)


def symmetric_step(s: Floats, h: float, p: Floats) -> Floats:
    """New omega, gamma, from these and the four target values; what the counters add.

    The multipliers x are determined by a simplified Newton iteration: with D and D' at the old and the new state, the
    integrals of the new state change by (D^T D + D'^T D') x + O(h³).
    """
    w1, w2, w3, g1, g2, g3, t1, t2, t3, t4 = s
    corrections, unmet, plain = 0.0, 0.0, 0.0
    c = p[0]
    old = (w1, w2, w3, g1, g2, g3)
    size = sizes(old, c)
    o1, o2, o3, o4, _, _ = deviations(old, c, (t1, t2, t3, t4))
    four = t4 > VANISHING * size[2]
    column = k_sq_column(old, c)
    reach = min(1.0, MAX_CORRECTION * (h * h) * size[2])
    x1, x2, x3, x4 = 0.0, 0.0, 0.0, 0.0
    z: Floats = hk_kowalevski(old, h, p)
    first: Floats = z
    change = subtract(z, old)
    limit = (reach * reach) * dot(change, change)
    factors = factorize(gram_sum(gram(old, c, column), gram(z, c, k_sq_column(z, c))), four)
    y: Floats = z
    new: Floats = z
    off = 2.0**1000
    cut = 0.0
    for i in range(SYMMETRIC_ROUNDS):
        if i > 0:
            z = hk_kowalevski(add(old, combination(old, c, column, (x1, x2, x3, x4))), h, p)
            # gradients at the new state, by fixed-point iteration: each pass reduces the error by a factor x = O(h³)
            new = add(z, combination(new, c, k_sq_column(new, c), (x1, x2, x3, x4)))
            new = add(z, combination(new, c, k_sq_column(new, c), (x1, x2, x3, x4)))
        r1, r2, r3, r4 = changes(old, new, c)
        r1, r2, r3, r4 = r1 + o1, r2 + o2, r3 + o3, r4 + (t4 + 0.5 * o4) * o4
        now = largest_deviation(r1, r2, r3, r4 / t4 if four else 0.0, size)
        if not now < off:
            break
        y, off = new, now
        if off <= SETTLED_CHANGES:
            break
        e1, e2, e3, e4, out = solve(factors, (r1, r2, r3, r4), limit)
        cut = max(cut, out)
        corrections += 1.0
        x1, x2, x3, x4 = x1 - e1, x2 - e2, x3 - e3, x4 - e4
    cut = min(cut, 1.0)
    if not four or not off <= MET:
        y, more, cut, missed = project(first, limit, c, (t1, t2, t3, t4))
        corrections += more
        unmet += missed
        plain += 1.0
    return (y[0], y[1], y[2], y[3], y[4], y[5], corrections, cut, unmet, plain)


@scheme(
    "hk-symproj",
    top="kowalevski",
    title="HK symmetrically projected onto all four integrals",
    order=2,
    explicit=False,
    self_adjoint=True,
    conserves=INTEGRALS,
    citation="Hairer 2000 (symmetric projection methods)",
    formula=r"""
y' = \Phi^{\mathrm{HK}}_h\bigl(y + D(y)\,x\bigr) + D(y')\,x, \qquad x \text{ such that } I(y') = I(y), \qquad
D = (\nabla I_1, \dots, \nabla I_4)
""",
    equations="y' = HK(y + D(y) x) + D(y') x, D the gradients of gamma², 2l, E, k², x such that all are conserved",
    limits=LIMITS,
)
def build_symmetric(top: Top, options: NoOptions) -> Stepper:
    """A step of HK between two shifts: the first leaves the level set of the integrals, the second returns to it.

    HK is the Hirota-Kimura scheme (`hk`). The shifts are along the gradients of gamma², 2l, E and k². The scheme is
    self-adjoint, because HK is self-adjoint and both shifts have the same multipliers x. For k = 0 (Delone's motion),
    or if the iteration does not restore the values of the four integrals, the scheme takes a step of `hk-projected`
    instead.

    A run reports the number of iterations (`corrections`), the number of steps that did not restore all four values
    (`unmet`), and the number of steps of `hk-projected` (`plain_projections`).
    """
    counters = (*COUNTERS, "plain_projections")
    return stepper(symmetric_step, 6, 4, adds=False, counters=counters, enter=enter_with_targets)
