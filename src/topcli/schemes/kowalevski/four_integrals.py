"""The Kowalevski top's four integrals and their gradients, and a projection that knows when these are dependent.

With C = 1 the integrals are gamma²/2, 2l = 2 (w1 g1 + w2 g2) + w3 g3, E = w1² + w2² + w3²/2 + c g1, and k²/2 or k,
k = |xi|, xi = (w1 + i w2)² - c (g1 + i g2). Their gradients are the columns of a 6x4 matrix D. It is never stored:
of its fourth column, ``(a1, a2, 0, b1, b2, 0)``, only four numbers are not plain.

On degenerate tori the four gradients are linearly dependent, and near them almost so. D^T D is therefore factorized
one integral after the other; what is left of an integral's gradient beside those before it decides whether the
integral is used at all, and the correction along a direction is cut to a given length: with nearly dependent gradients
the round-off of the integrals would move the state far. The order is that of the report: k² is the first to go.
"""

from __future__ import annotations

import math

from topcli.contracts import Floats

EPS = 2.0**-52
DEPENDENT = 2.0**-44
"""Squared sine of the angle between a gradient and the span of those before it, below which it is round-off."""
Four = tuple[float, float, float, float]
Six = tuple[float, float, float, float, float, float]
Gram = tuple[float, float, float, float, float, float, float, float, float, float]
Factors = tuple[float, float, float, float, float, float, float, float, float, float]


def xi_of(w1: float, w2: float, g1: float, g2: float, c: float) -> tuple[float, float]:
    """Kowalevski's xi."""
    return ((w1 - w2) * (w1 + w2) - c * g1, 2.0 * w1 * w2 - c * g2)


def first_three(y: Floats, c: float) -> tuple[float, float, float]:
    """gamma²/2, 2l and E for C = 1."""
    w1, w2, w3, g1, g2, g3 = y
    return (
        0.5 * (g1 * g1 + (g2 * g2 + g3 * g3)),
        2.0 * (w1 * g1 + w2 * g2) + w3 * g3,
        (w1 * w1 + w2 * w2) + (0.5 * (w3 * w3) + c * g1),
    )


def sizes(y: Floats, c: float) -> tuple[float, float, float]:
    """Sizes of the terms that make up gamma²/2, 2l, and E or k: what their round-off is measured against."""
    w = abs(y[0]) + abs(y[1]) + abs(y[2])
    g = abs(y[3]) + abs(y[4]) + abs(y[5])
    return (g * g, w * g, w * w + abs(c) * g)


def fourth_column(w1: float, w2: float, u1: float, u2: float, c: float) -> Four:
    """``(a1, a2, b1, b2)`` of the gradient of Re(conj(u) xi): of k²/2 for u = xi, of k for u = xi/k."""
    return (2.0 * (u1 * w1 + u2 * w2), 2.0 * (u2 * w1 - u1 * w2), -c * u1, -c * u2)


def mean_column(y: Floats, e: Floats, c: float) -> Four:
    """``(a1, a2, b1, b2)`` of the mean gradient of k²/2 between y and y + e: Simpson's rule on a cubic."""
    w1, w2, g1, g2 = y[0], y[1], y[3], y[4]
    m1, m2 = w1 + 0.5 * e[0], w2 + 0.5 * e[1]
    n1, n2 = w1 + e[0], w2 + e[1]
    x1, x2 = xi_of(w1, w2, g1, g2, c)
    p1, p2, r1, r2 = fourth_column(w1, w2, x1, x2, c)
    x1, x2 = xi_of(m1, m2, g1 + 0.5 * e[3], g2 + 0.5 * e[4], c)
    q1, q2, s1, s2 = fourth_column(m1, m2, x1, x2, c)
    x1, x2 = xi_of(n1, n2, g1 + e[3], g2 + e[4], c)
    u1, u2, t1, t2 = fourth_column(n1, n2, x1, x2, c)
    k = 1.0 / 6.0
    return (
        k * ((p1 + u1) + 4.0 * q1),
        k * ((p2 + u2) + 4.0 * q2),
        k * ((r1 + t1) + 4.0 * s1),
        k * ((r2 + t2) + 4.0 * s2),
    )


def combination(y: Floats, c: float, column: Four, x: Four) -> Six:
    """D x, the gradients at ``y`` added up with the weights ``x``."""
    w1, w2, w3, g1, g2, g3 = y
    a1, a2, b1, b2 = column
    x1, x2, x3, x4 = x
    t2 = 2.0 * x2
    t3 = 2.0 * x3
    return (
        t2 * g1 + (t3 * w1 + x4 * a1),
        t2 * g2 + (t3 * w2 + x4 * a2),
        x2 * g3 + x3 * w3,
        (x1 * g1 + t2 * w1) + (x3 * c + x4 * b1),
        (x1 * g2 + t2 * w2) + x4 * b2,
        x1 * g3 + x2 * w3,
    )


def components(y: Floats, c: float, column: Four, v: Floats) -> Four:
    """D^T v, the rates of change of the integrals at ``y`` along ``v``."""
    w1, w2, w3, g1, g2, g3 = y
    a1, a2, b1, b2 = column
    v1, v2, v3, v4, v5, v6 = v
    return (
        g1 * v4 + (g2 * v5 + g3 * v6),
        (2.0 * (g1 * v1 + g2 * v2) + g3 * v3) + (2.0 * (w1 * v4 + w2 * v5) + w3 * v6),
        (2.0 * (w1 * v1 + w2 * v2) + w3 * v3) + c * v4,
        (a1 * v1 + a2 * v2) + (b1 * v4 + b2 * v5),
    )


def gram(y: Floats, c: float, column: Four) -> Gram:
    """D^T D: 11, 12, 13, 14, 22, 23, 24, 33, 34, 44."""
    w1, w2, w3, g1, g2, g3 = y
    a1, a2, b1, b2 = column
    gg = g1 * g1 + g2 * g2
    ww = w1 * w1 + w2 * w2
    wg = w1 * g1 + w2 * g2
    g33 = g3 * g3
    w33 = w3 * w3
    wg3 = w3 * g3
    return (
        gg + g33,
        2.0 * wg + wg3,
        c * g1,
        g1 * b1 + g2 * b2,
        4.0 * (gg + ww) + (g33 + w33),
        (4.0 * wg + wg3) + 2.0 * (c * w1),
        2.0 * ((g1 * a1 + g2 * a2) + (w1 * b1 + w2 * b2)),
        (4.0 * ww + w33) + c * c,
        2.0 * (w1 * a1 + w2 * a2) + c * b1,
        (a1 * a1 + a2 * a2) + (b1 * b1 + b2 * b2),
    )


def factorized(m: Gram, fourth: bool) -> Factors:
    """L and the inverse pivots of L diag L^T = ``m``, with 0 for the inverse pivot of an integral that is left out.

    Returns i1, i2, i3, i4, l21, l31, l41, l32, l42, l43. ``fourth`` says whether the fourth integral may be used. Only
    what exceeds ``DEPENDENT`` of the diagonal is a pivot; comparisons are written so that nan leaves out.
    """
    m11, m12, m13, m14, m22, m23, m24, m33, m34, m44 = m
    i1 = 1.0 / m11 if m11 > 0.0 else 0.0
    l21, l31, l41 = m12 * i1, m13 * i1, m14 * i1
    d2 = m22 - l21 * m12
    i2 = 1.0 / d2 if d2 > DEPENDENT * m22 else 0.0
    e32, e42 = m23 - l31 * m12, m24 - l41 * m12
    l32, l42 = e32 * i2, e42 * i2
    d3 = (m33 - l31 * m13) - l32 * e32
    i3 = 1.0 / d3 if d3 > DEPENDENT * m33 else 0.0
    e43 = (m34 - l41 * m13) - l42 * e32
    l43 = e43 * i3
    d4 = ((m44 - l41 * m14) - l42 * e42) - l43 * e43
    i4 = 1.0 / d4 if fourth and d4 > DEPENDENT * m44 else 0.0
    return (i1, i2, i3, i4, l21, l31, l41, l32, l42, l43)


def along(r: float, i: float, limit: float) -> tuple[float, float, float]:
    """One component of the solution for the residual ``r`` and the inverse pivot ``i``, cut to the length allowed.

    Returns the residual that it takes care of, the component, and 1.0 where that is not all.
    """
    z = r * i
    length = r * z
    if length <= limit and i > 0.0:
        return r, z, 0.0
    if length > limit:
        cut = math.sqrt(limit / length)
        return cut * r, cut * z, 1.0
    return 0.0, 0.0, 1.0


def solved(f: Factors, r: Four, limit: float) -> tuple[float, float, float, float, float]:
    """The x of D^T D x = r over the integrals in use, and how many are not met in full.

    D x is then the shortest correction that changes the integrals by ``r``. Its parts along the directions of the
    factorization are normal to each other; the square of each one's length is kept within ``limit``.
    """
    i1, i2, i3, i4, l21, l31, l41, l32, l42, l43 = f
    r1, z1, o1 = along(r[0], i1, limit)
    r2, z2, o2 = along(r[1] - l21 * r1, i2, limit)
    r3, z3, o3 = along((r[2] - l31 * r1) - l32 * r2, i3, limit)
    _, z4, o4 = along(((r[3] - l41 * r1) - l42 * r2) - l43 * r3, i4, limit)
    x3 = z3 - l43 * z4
    x2 = z2 - (l32 * x3 + l42 * z4)
    x1 = z1 - (l21 * x2 + (l31 * x3 + l41 * z4))
    return (x1, x2, x3, z4, (o1 + o2) + (o3 + o4))


def length_sq(v: Floats) -> float:
    """The squared Euclidean length."""
    return (v[0] * v[0] + (v[1] * v[1] + v[2] * v[2])) + (v[3] * v[3] + (v[4] * v[4] + v[5] * v[5]))


def targets_with_k(y: Floats, p: Floats) -> Four:
    """gamma²/2, 2l, E and k of the state."""
    xi, eta = xi_of(y[0], y[1], y[3], y[4], p[0])
    i1, i2, i3 = first_three((y[0], y[1], y[2], y[3], y[4], y[5]), p[0])
    return (i1, i2, i3, math.hypot(xi, eta))
