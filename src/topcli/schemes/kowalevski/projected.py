"""HK for the Kowalevski top, projected onto the level set of its four integrals, by standard or symmetric projection.

Performance:
- D^T D is computed from a few sums and factorized in scalars, without arrays or LAPACK;
- HK leaves the level set by O(h³), and one correction with the gradients at HK's point reduces this to O(h⁶): two
  corrections with one factorization are typical.

Robustness: the target values are those of the initial state, so that nothing accumulates. Integrals with dependent
gradients are omitted, and xi replaces a vanishing k (``projection``). No correction is longer than HK's step, and a
correction that does not reduce the deviations is discarded; the step is then HK's and is counted.
"""

from __future__ import annotations

from topcli.arithmetic.six_vectors import add, axpy, dot, subtract
from topcli.arithmetic.tolerances import follow_precision
from topcli.contracts import Floats, NoOptions, Stepper, Top
from topcli.schemes.kowalevski.four_integrals import (
    EPS,
    Floats4,
    Gram,
    combination,
    directional_derivatives,
    enter_with_targets,
    factorize,
    fourth_column,
    gram,
    mean_column,
    sizes,
    solve,
    xi_of,
)
from topcli.schemes.kowalevski.hk import hk_kowalevski
from topcli.schemes.kowalevski.projection import MET, TRIPLE_ROOT, deviations, largest_deviation, project
from topcli.schemes.layout import stepper
from topcli.schemes.registry import scheme

SYMMETRIC_ROUNDS = 12
"""Maximum number of iterations of the symmetric projection; three or four are typical."""
VANISHING = 2.0**-26
"""k relative to its terms, below which k² and its gradient, which vanishes at xi = 0, are round-off."""
SETTLED_CHANGES = EPS / 4.0
"""Tolerance for the changes of the integrals over a step, which are more accurate than the integrals."""
follow_precision(__name__, caps=("SYMMETRIC_ROUNDS",), VANISHING=0.5, SETTLED_CHANGES=1)
MAX_CORRECTION = 1.0
"""Largest length of a correction relative to that of the step: this times h² (omega² + c gamma), but at most 1."""
CONSERVES = ("gamma_sq", "two_l", "energy", "k_sq")
LIMITS = {
    "resonance": "With steps of about one revolution HK jumps so far that no correction as short as its own step "
    "restores the integrals; counted as unmet.",
    "delone-sleeping": TRIPLE_ROOT.format("All four may be"),
    "singular-step": "HK's step is singular for this h, and from a state of size 1e15 or more the integrals cannot be "
    "restored; counted as unmet.",
    "huge": "Beyond |omega| of about 1e77 k² overflows: no correction can be assessed, and the integrals are not "
    "restored; counted as unmet.",
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
    conserves=CONSERVES,
    citation="Hairer, Lubich, Wanner, Geometric Numerical Integration, section IV.4 (projection methods)",
    formula=r"""
y' = z - D(z)\,x, \qquad z = \Phi^{\mathrm{HK}}_h(y), \qquad x \text{ such that } I(y') = I(y), \qquad
D = (\nabla I_1, \dots, \nabla I_4)
""",
    equations="y' = z - D(z) x, z = HK(y), D the gradients of gamma², 2l, E, k, and x such that all four are conserved",
    limits=LIMITS,
)
def build(top: Top, options: NoOptions) -> Stepper:
    """HK, followed by the shortest correction that restores the initial values of gamma², 2l, E and k.

    Not self-adjoint. After every two corrections the gradients are renewed at the corrected state, so that the equation
    holds up to terms of the order of x⁴: below round-off in double precision, visible at 50 digits. Where the four
    gradients are linearly dependent (degenerate tori, relative equilibria) only independent integrals are used. A
    correction is never longer than HK's step. The numbers of corrections and of steps that did not restore all four
    values are reported.
    """
    return stepper(projected_step, 6, 4, adds=False, counters=COUNTERS, enter=enter_with_targets)


def k_sq_column(y: Floats, c: float) -> Floats4:
    """Fourth column for k²/2, which unlike that for k is smooth everywhere."""
    x1, x2 = xi_of(y[0], y[1], y[3], y[4], c)
    return fourth_column(y[0], y[1], x1, x2, c)


def gram_sum(m: Gram, n: Gram) -> Gram:
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
    conserves=CONSERVES,
    citation="Hairer 2000 (symmetric projection methods)",
    formula=r"""
y' = \Phi^{\mathrm{HK}}_h\bigl(y + D(y)\,x\bigr) + D(y')\,x, \qquad x \text{ such that } I(y') = I(y), \qquad
D = (\nabla I_1, \dots, \nabla I_4)
""",
    equations="y' = HK(y + D(y) x) + D(y') x, D the gradients of gamma², 2l, E, k², x such that all are conserved",
    limits=LIMITS,
)
def build_symmetric(top: Top, options: NoOptions) -> Stepper:
    """HK between two shifts along the gradients of gamma², 2l, E and k², away from their level set and back to it.

    Self-adjoint, because HK is. For k = 0 (Delone's motion), and if the iteration does not restore the four values, the
    step is that of hk-projected. The numbers of corrections, of steps that did not restore all four values, and of
    non-symmetric projections are reported.
    """
    counters = (*COUNTERS, "plain_projections")
    return stepper(symmetric_step, 6, 4, adds=False, counters=counters, enter=enter_with_targets)
