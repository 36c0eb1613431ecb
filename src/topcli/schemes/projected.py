"""HK for the Kowalevski top, projected onto the surface of its four integrals.

What makes it fast:
- D^T D is formed from a handful of sums and factorized in scalars; no array, no LAPACK;
- HK misses the surface by O(h³), and a correction with the gradients at HK's point leaves O(h⁶): two corrections with
  one factorization are the rule.

What makes it safe: the values aimed at are those of the initial state, carried along, so that nothing accumulates; an
integral whose gradient depends on the others' is left out (``kernels/four_integrals.py``); no correction is longer
than HK's own step, and none is kept that does not bring the integrals closer. Then the step is HK's, and it is counted.
"""

from __future__ import annotations

import math

from topcli.contracts import Floats, NoOptions, Stepper, Top
from topcli.kernels.four_integrals import (
    EPS,
    Four,
    Six,
    combination,
    factorized,
    first_three,
    fourth_column,
    gram,
    length_sq,
    sizes,
    solved,
    targets_with_k,
    xi_of,
)
from topcli.kernels.hk_kowalevski import hk_kowalevski
from topcli.schemes.registry import scheme

ROUNDS = 3
"""Factorizations before k is given up; one is the rule."""
ROUNDS_WITHOUT_K = 2
"""Factorizations for the other three after that."""
SETTLED = EPS
"""Largest deviation from the values aimed at, in units of ``sizes``: about the round-off of evaluating them."""
MET = 8.0 * EPS
"""Deviations that still count as met."""
TINY = 1e-300
REACH = 1.0
"""A correction's largest length: this times h² (omega² + c gamma), but no more than 1, of the step's own length."""
CONSERVES = ("gamma_sq", "two_l", "energy", "k_sq")
COUNTERS = ("corrections", "short_corrections", "unmet")
"""Corrections made; steps where one was cut or left an integral out; steps that did not meet all four values."""


def with_k(y: Floats, c: float, t: Four) -> tuple[float, float, float, float, float, float]:
    """Deviations of gamma²/2, 2l, E and k from ``t``, and the direction xi/k, which is 1 for xi = 0."""
    x, v = xi_of(y[0], y[1], y[3], y[4], c)
    k = math.sqrt(x * x + v * v)
    if k > 0.0:
        u1, u2 = x / k, v / k
    else:
        u1, u2 = 1.0, 0.0
    i1, i2, i3 = first_three(y, c)
    return (i1 - t[0], i2 - t[1], i3 - t[2], k - t[3], u1, u2)


def worst(r1: float, r2: float, r3: float, r4: float, s: tuple[float, float, float]) -> float:
    """The largest deviation in units of the sizes ``s``; a size of 0 counts as the least float."""
    return max(max(abs(r1) / (s[0] + TINY), abs(r2) / (s[1] + TINY)), max(abs(r3), abs(r4)) / (s[2] + TINY))


def moved(y: Floats, v: Floats) -> Six:
    """y - v."""
    return (y[0] - v[0], y[1] - v[1], y[2] - v[2], y[3] - v[3], y[4] - v[4], y[5] - v[5])


def projected_step(s: Floats, h: float, p: Floats) -> Floats:
    """omega, gamma; the four values aimed at; the counters."""
    w1, w2, w3, g1, g2, g3, t1, t2, t3, t4, corrections, short, unmet = s
    c = p[0]
    t = (t1, t2, t3, t4)
    y: Floats = hk_kowalevski((w1, w2, w3, g1, g2, g3), h, p)
    size = sizes(y, c)
    reach = min(1.0, REACH * (h * h) * size[2])
    limit = (reach * reach) * length_sq(moved(y, (w1, w2, w3, g1, g2, g3)))
    r1, r2, r3, r4, u1, u2 = with_k(y, c, t)
    off = worst(r1, r2, r3, r4, size)
    going = not off <= SETTLED
    cut = 0.0
    for i in range(ROUNDS + ROUNDS_WITHOUT_K):
        if i == ROUNDS and not off <= MET:
            # k has no gradient at xi = 0 and turns its own where xi is small: the other three are still to be met
            unmet += 1.0
            off = worst(r1, r2, r3, 0.0, size)
            going = not off <= SETTLED
        if not going:
            if i >= ROUNDS or off <= MET:
                break
            continue
        base = y
        column = fourth_column(y[0], y[1], u1, u2, c)
        factors = factorized(gram(y, c, column), i < ROUNDS)
        for _ in range(2):
            x1, x2, x3, x4, out = solved(factors, (r1, r2, r3, r4), limit)
            cut = max(cut, out)
            z = moved(y, combination(base, c, column, (x1, x2, x3, x4)))
            q1, q2, q3, q4, v1, v2 = with_k(z, c, t)
            new = worst(q1, q2, q3, q4 if i < ROUNDS else 0.0, size)
            going = new < off
            if not going:
                break
            corrections += 1.0
            y, off = z, new
            r1, r2, r3, r4, u1, u2 = q1, q2, q3, q4, v1, v2
            going = not off <= SETTLED
            if not going:
                break
    return (y[0], y[1], y[2], y[3], y[4], y[5], t1, t2, t3, t4, corrections, short + min(cut, 1.0), unmet)


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
)
def build(top: Top, options: NoOptions) -> Stepper:
    """HK, then the shortest way back to the values that gamma², 2l, E and k had at the start.

    Not self-adjoint. Where the four gradients are linearly dependent (degenerate tori, relative equilibria) as many
    integrals are used as are independent; the step is never further from HK's than HK's from its start. The run
    reports the corrections made, and the steps whose integrals were not all met.
    """
    return Stepper(projected_step, 13, enter_projected, leave, COUNTERS)
