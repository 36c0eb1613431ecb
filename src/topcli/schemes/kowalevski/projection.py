"""Projection of a state of the Kowalevski top onto given values of its four integrals, by the shortest correction.

Integrals with dependent gradients are omitted (``four_integrals``). The length of a correction is limited, and a
correction that does not reduce the deviations is discarded. For xi = 0 the gradient of k does not exist, and if k is
about as small as its deviation, the direction of the gradient changes within the correction; the condition on k is then
replaced by one on both components of xi.
"""

from __future__ import annotations

import math

from topcli.arithmetic.six_vectors import dot, scaled, subtract
from topcli.arithmetic.tolerances import follow_precision
from topcli.contracts import Floats
from topcli.schemes.kowalevski.four_integrals import (
    EPS,
    Floats4,
    combination,
    factorize,
    first_three,
    fourth_column,
    gram,
    sizes,
    solve,
    xi_of,
)
from topcli.schemes.kowalevski.lie_poisson import xi_correction

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
TRIPLE_ROOT = (
    "For k = 0 and E = 2 l² at once, the gradients of gamma², 2l, E and of both components of xi are linearly "
    "dependent on the whole orbit. {} off by more than round-off; counted as unmet."
)
"""Limit of the projections onto the four integrals in the case ``delone-sleeping``."""


def deviations(y: Floats, c: float, t: Floats4) -> tuple[float, float, float, float, float, float]:
    """Deviations of gamma²/2, 2l, E and k from ``t``, and the direction xi/k, taken as 1 for xi = 0."""
    x, v = xi_of(y[0], y[1], y[3], y[4], c)
    k = math.sqrt(x * x + v * v)
    if k > 0.0:
        u1, u2 = x / k, v / k
    else:
        u1, u2 = 1.0, 0.0
    i1, i2, i3 = first_three(y, c)
    return (i1 - t[0], i2 - t[1], i3 - t[2], k - t[3], u1, u2)


def largest_deviation(r1: float, r2: float, r3: float, r4: float, s: tuple[float, float, float]) -> float:
    """Largest deviation relative to the sizes ``s``; a size of 0 is replaced by a tiny number."""
    return max(max(abs(r1) / (s[0] + TINY), abs(r2) / (s[1] + TINY)), max(abs(r3), abs(r4)) / (s[2] + TINY))


def project_with_xi(start: Floats, limit: float, c: float, t: Floats4) -> tuple[Floats, float, float, float]:
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


def project(start: Floats, limit: float, c: float, t: Floats4) -> tuple[Floats, float, float, float]:
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
