"""HK for the Kowalevski top, projected onto the surface of its four integrals, plainly or symmetrically.

What makes it fast:
- D^T D is formed from a handful of sums and factorized in scalars; no array, no LAPACK;
- HK misses the surface by O(h³), and a correction with the gradients at HK's point leaves O(h⁶): two corrections with
  one factorization are the rule.

What makes it safe: the values aimed at are those of the initial state, carried along, so that nothing accumulates; an
integral whose gradient depends on the others' is left out, and xi takes the place of a vanishing k
(``projection``); no correction is longer than HK's own step, and none is kept that does not bring the
integrals closer. Then the step is HK's, and it is counted.
"""

from __future__ import annotations

from topcli.contracts import Floats, NoOptions, Stepper, Top
from topcli.schemes.kowalevski.four_integrals import (
    EPS,
    Four,
    Six,
    combination,
    components,
    factorized,
    fourth_column,
    gram,
    length_sq,
    mean_column,
    sizes,
    solved,
    targets_with_k,
    xi_of,
)
from topcli.schemes.kowalevski.hk import hk_kowalevski
from topcli.schemes.kowalevski.projection import MET, moved, onto, with_k, worst
from topcli.schemes.registry import scheme

SYMMETRIC_ROUNDS = 12
"""Rounds of the symmetric projection's iteration at most; three or four are the rule."""
VANISHING = 2.0**-26
"""k in units of its terms below which k² is round-off, and its gradient, which vanishes at xi = 0, too."""
CLOSE = EPS / 4.0
"""The same for the changes of the integrals over a step, which are known better than the integrals."""
REACH = 1.0
"""A correction's largest length: this times h² (omega² + c gamma), but no more than 1, of the step's own length."""
CONSERVES = ("gamma_sq", "two_l", "energy", "k_sq")
LIMITS = {
    "resonance": "With steps of about a turn HK jumps so far that no correction as short as its own step reaches the "
    "values; counted as unmet.",
    "singular-step": "HK's step is singular at this h, and from a state of size 1e15 and beyond there is no way back "
    "to the values; counted as unmet.",
    "huge": "Beyond |omega| of about 1e77 k² leaves the range of a double: no correction can be judged, and the values "
    "are not met; counted as unmet.",
}
COUNTERS = ("corrections", "short_corrections", "unmet")
"""Corrections made; steps where one was cut or left an integral out; steps that did not meet all four values."""


def projected_step(s: Floats, h: float, p: Floats) -> Floats:
    """omega, gamma; the four values aimed at; the counters."""
    w1, w2, w3, g1, g2, g3, t1, t2, t3, t4, corrections, short, unmet = s
    c = p[0]
    old = (w1, w2, w3, g1, g2, g3)
    z: Floats = hk_kowalevski(old, h, p)
    reach = min(1.0, REACH * (h * h) * sizes(z, c)[2])
    limit = (reach * reach) * length_sq(moved(z, old))
    y, more, cut, missed = onto(z, limit, c, (t1, t2, t3, t4))
    return (y[0], y[1], y[2], y[3], y[4], y[5], t1, t2, t3, t4, corrections + more, short + cut, unmet + missed)


def enter_projected(y: Floats, h: float, p: Floats) -> Floats:
    """The physical state with the values of its integrals, and the counters at zero."""
    return (y[0], y[1], y[2], y[3], y[4], y[5], *targets_with_k(y, p), 0.0, 0.0, 0.0)


def leave(s: Floats, h: float, p: Floats) -> Floats:
    """Omega and gamma."""
    return (s[0], s[1], s[2], s[3], s[4], s[5])


@scheme(
    "hk-projected",
    top="kowalevski",
    title="HK projected onto all four integrals",
    order=2,
    explicit=True,
    self_adjoint=False,
    conserves=CONSERVES,
    citation="Hairer, Lubich, Wanner, Geometric Numerical Integration, section IV.4 (projection methods)",
    equations="y' = z - D(z) x with z = HK(y), the gradients D of gamma², 2l, E, k, and x such that all four are kept",
    limits=LIMITS,
)
def build(top: Top, options: NoOptions) -> Stepper:
    """HK, then the shortest way back to the values that gamma², 2l, E and k had at the start.

    Not self-adjoint. Where the four gradients are linearly dependent (degenerate tori, relative equilibria) as many
    integrals are used as are independent; the step is never further from HK's than HK's from its start. The run
    reports the corrections made, and the steps whose integrals were not all met.
    """
    return Stepper(projected_step, 13, enter_projected, leave, COUNTERS)


def added(y: Floats, v: Floats) -> Six:
    """y + v."""
    return (y[0] + v[0], y[1] + v[1], y[2] + v[2], y[3] + v[3], y[4] + v[4], y[5] + v[5])


def halved(v: Floats) -> Six:
    """v/2."""
    return (0.5 * v[0], 0.5 * v[1], 0.5 * v[2], 0.5 * v[3], 0.5 * v[4], 0.5 * v[5])


def column_of_k_sq(y: Floats, c: float) -> Four:
    """The fourth column for k²/2, smooth everywhere, unlike that for k."""
    x1, x2 = xi_of(y[0], y[1], y[3], y[4], c)
    return fourth_column(y[0], y[1], x1, x2, c)


def symmetric_step(s: Floats, h: float, p: Floats) -> Floats:
    """omega, gamma; the four values aimed at; the counters.

    The multipliers x are found by a simplified Newton iteration: with D of the old and of the new state, the integrals
    of the new one change by (D^T D + D'^T D') x + O(h³).
    """
    w1, w2, w3, g1, g2, g3, t1, t2, t3, t4, corrections, short, unmet, plain = s
    c = p[0]
    old = (w1, w2, w3, g1, g2, g3)
    size = sizes(old, c)
    o1, o2, o3, o4, _, _ = with_k(old, c, (t1, t2, t3, t4))
    four = t4 > VANISHING * size[2]
    column = column_of_k_sq(old, c)
    m11, m12, m13, m14, m22, m23, m24, m33, m34, m44 = gram(old, c, column)
    reach = min(1.0, REACH * (h * h) * size[2])
    x1, x2, x3, x4 = 0.0, 0.0, 0.0, 0.0
    z: Floats = hk_kowalevski(old, h, p)
    first: Floats = z
    limit = (reach * reach) * length_sq(moved(z, old))
    new_column = column_of_k_sq(z, c)
    n11, n12, n13, n14, n22, n23, n24, n33, n34, n44 = gram(z, c, new_column)
    factors = factorized(
        (
            m11 + n11,
            m12 + n12,
            m13 + n13,
            m14 + n14,
            m22 + n22,
            m23 + n23,
            m24 + n24,
            m33 + n33,
            m34 + n34,
            m44 + n44,
        ),
        four,
    )
    y: Floats = z
    new: Floats = z
    off = 2.0**1000
    cut = 0.0
    for i in range(SYMMETRIC_ROUNDS):
        if i > 0:
            z = hk_kowalevski(added(old, combination(old, c, column, (x1, x2, x3, x4))), h, p)
            # the new state's own gradients: each round makes what is left of them smaller by the size of x, O(h³)
            new = added(z, combination(new, c, column_of_k_sq(new, c), (x1, x2, x3, x4)))
            new = added(z, combination(new, c, column_of_k_sq(new, c), (x1, x2, x3, x4)))
        # the integrals' changes by discrete gradients: their own round-off would be magnified near degenerate tori
        e: Floats = moved(new, old)
        r1, r2, r3, r4 = components(added(old, halved(e)), c, mean_column(old, e, c), e)
        r1, r2, r3, r4 = r1 + o1, r2 + o2, r3 + o3, r4 + (t4 + 0.5 * o4) * o4
        now = worst(r1, r2, r3, r4 / t4 if four else 0.0, size)
        if not now < off:
            break
        y, off = new, now
        if off <= CLOSE:
            break
        e1, e2, e3, e4, out = solved(factors, (r1, r2, r3, r4), limit)
        cut = max(cut, out)
        corrections += 1.0
        x1, x2, x3, x4 = x1 - e1, x2 - e2, x3 - e3, x4 - e4
    cut = min(cut, 1.0)
    if not four or not off <= MET:
        y, more, cut, missed = onto(first, limit, c, (t1, t2, t3, t4))
        corrections += more
        unmet += missed
        plain += 1.0
    return (y[0], y[1], y[2], y[3], y[4], y[5], t1, t2, t3, t4, corrections, short + cut, unmet, plain)


def enter_symmetric(y: Floats, h: float, p: Floats) -> Floats:
    """The physical state with the values of its integrals, and the counters at zero."""
    return (*enter_projected(y, h, p), 0.0)


@scheme(
    "hk-symproj",
    top="kowalevski",
    title="HK symmetrically projected onto all four integrals",
    order=2,
    explicit=False,
    self_adjoint=True,
    conserves=CONSERVES,
    citation="Hairer 2000 (symmetric projection methods)",
    equations="y' = HK(y + D(y) x) + D(y') x, D the gradients of gamma², 2l, E, k², and x such that all four are kept",
    limits=LIMITS,
)
def build_symmetric(top: Top, options: NoOptions) -> Stepper:
    """HK between two shifts along the gradients of gamma², 2l, E and k², off their surface and back onto it.

    Its own inverse under h -> -h, because HK is. For k = 0 (Delone's motion), and where the iteration does not meet the
    four values, the step is hk-projected's. The run reports the corrections made, the steps that did not meet all four
    values, and the plain projections.
    """
    return Stepper(symmetric_step, 14, enter_symmetric, leave, (*COUNTERS, "plain_projections"))
