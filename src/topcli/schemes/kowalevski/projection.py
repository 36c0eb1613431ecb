"""Projection of a state of the Kowalevski top onto the values of its four integrals: the shortest way, or none.

An integral whose gradient depends on the others' is left out (``four_integrals``); no correction is longer
than allowed, and none is kept that does not bring the integrals closer. For xi = 0 k has no gradient, and where k is
about as small as its deviation that turns within the correction: there the two components of xi take its place.
"""

from __future__ import annotations

import math

from topcli.contracts import Floats
from topcli.schemes.kowalevski.four_integrals import (
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
    xi_of,
)
from topcli.schemes.kowalevski.lie_poisson import changing_xi

ROUNDS = 3
"""Factorizations before k is given up; one is the rule."""
ROUNDS_WITHOUT_K = 2
"""Factorizations for the other three after that."""
ROUNDS_FOR_XI = 5
"""Corrections with xi in the place of k; two are the rule."""
TURNING = 2.0**-4
"""Deviation of k, in units of k, from which on xi takes its place."""
SETTLED = EPS
"""Largest deviation from the values aimed at, in units of ``sizes``: about the round-off of evaluating them."""
MET = 8.0 * EPS
"""Deviations that still count as met."""
NO_WORSE = 64.0 * EPS
"""Deviation of gamma², 2l and E beyond which a state that keeps these is better than its projection."""
TINY = 1e-300


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


def onto_xi(start: Floats, limit: float, c: float, t: Four) -> tuple[Floats, float, float, float]:
    """``onto`` for a k so small that its direction turns within the projection: onto both components of one xi.

    That is the xi with the direction of the start's. For k = 0, where the gradient of k does not exist and that of k²
    vanishes, xi = 0 is two equations with gradients of their own.
    """
    y: Floats = start
    size = sizes(y, c)
    x1, x2 = xi_of(y[0], y[1], y[3], y[4], c)
    now = math.sqrt(x1 * x1 + x2 * x2)
    scale = t[3] / now if now > 0.0 else 0.0
    p1, p2 = scale * x1, scale * x2
    i1, i2, i3 = first_three(y, c)
    off = worst(i1 - t[0], i2 - t[1], i3 - t[2], abs(x1 - p1) + abs(x2 - p2), size)
    corrections, cut = 0.0, 0.0
    nothing = (0.0, 0.0, 0.0, 0.0)
    for _ in range(ROUNDS_FOR_XI):
        if off <= SETTLED:
            break
        factors = factorized(gram(y, c, nothing), False)
        n1, n2, n3, _, _ = solved(factors, (i1 - t[0], i2 - t[1], i3 - t[2], 0.0), limit)
        z: Floats = moved(y, combination(y, c, nothing, (n1, n2, n3, 0.0)))
        x1, x2 = xi_of(z[0], z[1], z[3], z[4], c)
        e, dependent = changing_xi(z, x1 - p1, x2 - p2, c)
        length = length_sq(e)
        if length > limit:
            s = math.sqrt(limit / length)
            e = (s * e[0], s * e[1], s * e[2], s * e[3], s * e[4], s * e[5])
            dependent = 1.0
        z = moved(z, e)
        x1, x2 = xi_of(z[0], z[1], z[3], z[4], c)
        i1, i2, i3 = first_three(z, c)
        new = worst(i1 - t[0], i2 - t[1], i3 - t[2], abs(x1 - p1) + abs(x2 - p2), size)
        if not new < off:
            break
        y, off = z, new
        corrections += 1.0
        cut = max(cut, dependent)
    return (y, corrections, cut, 0.0 if off <= MET else 1.0)


def onto(start: Floats, limit: float, c: float, t: Four) -> tuple[Floats, float, float, float]:
    """The projection of ``start`` onto the values ``t``, and how much to add to each of the counters."""
    y: Floats = start
    size = sizes(y, c)
    x1, x2 = xi_of(y[0], y[1], y[3], y[4], c)
    if not abs(math.sqrt(x1 * x1 + x2 * x2) - t[3]) < TURNING * t[3]:
        return onto_xi(start, limit, c, t)
    corrections, unmet = 0.0, 0.0
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
    return (y, corrections, min(cut, 1.0), unmet)


def onto_but_no_worse(start: Floats, limit: float, c: float, t: Four) -> tuple[Floats, float]:
    """The projection of a ``start`` that keeps gamma², 2l and E, or the start if it would lose them; whether unmet."""
    y, _, _, unmet = onto(start, limit, c, t)
    r1, r2, r3, _, _, _ = with_k(y, c, t)
    if not worst(r1, r2, r3, 0.0, sizes(y, c)) <= NO_WORSE:
        y = start
    return (y, unmet)
