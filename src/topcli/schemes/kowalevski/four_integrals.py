"""Four integrals of the Kowalevski top, their gradients, and changes of the state that conserve three of them.

With C = 1 the integrals are gamma²/2, 2l = 2 (w1 g1 + w2 g2) + w3 g3, E = w1² + w2² + w3²/2 + c g1, and k²/2 or k,
k = |xi|, xi = (w1 + i w2)² - c (g1 + i g2). Their gradients are the columns of a 6x4 matrix D, which is never stored;
``column`` denotes the four nontrivial numbers of its fourth column ``(a1, a2, 0, b1, b2, 0)``.

On degenerate tori the four gradients are linearly dependent, and nearby they are almost so. D^T D is therefore
factorized one integral after the other. An integral is used only if its gradient has a sufficient component normal to
the previous ones, and the correction along a direction is limited to a given length: with nearly dependent gradients
the round-off of the integrals would change the state considerably. The order is that of the report, so that k² is
omitted first.

**The top as a Lie-Poisson system.** With m = (2 w1, 2 w2, w3) the bracket maps the gradient (a, b) of a function with
respect to (m, gamma) to its Hamiltonian vector field J(a, b) = (m x a + gamma x b, gamma x a), which conserves gamma²
and m.gamma = 2l. The vector field of the motion is F = J grad E, and J is antisymmetric: along J(a, b), a function with
Hamiltonian field X changes at the rate -(a, b).X. Hence

- J(a, b) also conserves E if (a, b) is normal to F;
- among these directions, that with (a, b) equal to the component of X normal to F changes the function with field X
  the most, at the rate of minus the square of that component. It vanishes only where X and F are parallel: on
  degenerate tori and at relative equilibria.

This direction needs no matrix and no division. Because the three integrals are quadratic, a change that is normal to
their gradients at the mean of two states conserves them from one state to the other.
"""

from __future__ import annotations

import math

from topcli.arithmetic.fused import follow_precision
from topcli.arithmetic.vectors import Floats6, Matrix, Vector, axpy, dot, scaled
from topcli.contracts import Floats

INTEGRALS = ("gamma_sq", "two_l", "energy", "k_sq")
EPS = 2.0**-52
DEPENDENT = 2.0**-44
"""Squared sine of the angle between a gradient and the span of the previous ones, below which it is round-off."""
follow_precision(__name__, EPS=1, DEPENDENT=1)
Floats4 = tuple[float, float, float, float]


def xi_of(w1: float, w2: float, g1: float, g2: float, c: float) -> tuple[float, float]:
    """Kowalevski's xi = (w1 + i w2)² - c (g1 + i g2)."""
    return ((w1 - w2) * (w1 + w2) - c * g1, 2.0 * w1 * w2 - c * g2)


def first_three(y: Floats, c: float) -> Vector:
    """gamma²/2, 2l and E for C = 1."""
    w1, w2, w3, g1, g2, g3 = y
    return (
        0.5 * (g1 * g1 + (g2 * g2 + g3 * g3)),
        2.0 * (w1 * g1 + w2 * g2) + w3 * g3,
        (w1 * w1 + w2 * w2) + (0.5 * (w3 * w3) + c * g1),
    )


def sizes(y: Floats, c: float) -> Vector:
    """Sizes of the terms of gamma²/2, 2l, and E or k, relative to which round-off is measured."""
    w = abs(y[0]) + abs(y[1]) + abs(y[2])
    g = abs(y[3]) + abs(y[4]) + abs(y[5])
    return (g * g, w * g, w * w + abs(c) * g)


def fourth_column(w1: float, w2: float, u1: float, u2: float, c: float) -> Floats4:
    """``(a1, a2, b1, b2)`` of the gradient of Re(conj(u) xi), which is that of k²/2 for u = xi, of k for u = xi/k."""
    return (2.0 * (u1 * w1 + u2 * w2), 2.0 * (u2 * w1 - u1 * w2), -c * u1, -c * u2)


def mean_column(y: Floats, e: Floats, c: float) -> Floats4:
    """``(a1, a2, b1, b2)`` of the mean gradient of k²/2 between y and y + e, by Simpson's rule for a cubic."""
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


def combination(y: Floats, c: float, column: Floats4, x: Floats4) -> Floats6:
    """D x, the linear combination of the gradients at ``y`` with the weights ``x``."""
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


def directional_derivatives(y: Floats, c: float, column: Floats4, v: Floats) -> Floats4:
    """D^T v, the derivatives of the integrals at ``y`` in the direction ``v``."""
    w1, w2, w3, g1, g2, g3 = y
    a1, a2, b1, b2 = column
    v1, v2, v3, v4, v5, v6 = v
    return (
        g1 * v4 + (g2 * v5 + g3 * v6),
        (2.0 * (g1 * v1 + g2 * v2) + g3 * v3) + (2.0 * (w1 * v4 + w2 * v5) + w3 * v6),
        (2.0 * (w1 * v1 + w2 * v2) + w3 * v3) + c * v4,
        (a1 * v1 + a2 * v2) + (b1 * v4 + b2 * v5),
    )


def gram(y: Floats, c: float, column: Floats4) -> Floats:
    """Elements 11, 12, 13, 14, 22, 23, 24, 33, 34, 44 of D^T D."""
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


def factorize(m: Floats, fourth: bool) -> Floats:
    """Factorize ``m`` = L diag L^T; the inverse pivot of an omitted integral is 0.

    Returns the inverse pivots i1, i2, i3, i4 and l21, l31, l41, l32, l42, l43. The fourth integral is used only if
    ``fourth`` is true. A pivot must exceed ``DEPENDENT`` times the diagonal element; the comparisons are written such
    that a nan omits the integral.
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


def bounded_component(r: float, i: float, limit: float) -> Vector:
    """Component of the solution for the residual ``r`` and the inverse pivot ``i``, with squared length <= ``limit``.

    Returns the part of the residual that is corrected, the component, and 1.0 if that part is not all of ``r``.
    """
    z = r * i
    length = r * z
    if length <= limit and i > 0.0:
        return r, z, 0.0
    if length > limit:
        cut = math.sqrt(limit / length)
        return cut * r, cut * z, 1.0
    return 0.0, 0.0, 1.0


def solve(f: Floats, r: Floats4, limit: float) -> Floats:
    """Solve D^T D x = r for the integrals in use; return x and the number of integrals that are not fully corrected.

    D x is the shortest correction that changes the integrals by ``r``. Its components in the directions of the
    factorization are orthogonal; the squared length of each is limited to ``limit``.
    """
    i1, i2, i3, i4, l21, l31, l41, l32, l42, l43 = f
    r1, z1, o1 = bounded_component(r[0], i1, limit)
    r2, z2, o2 = bounded_component(r[1] - l21 * r1, i2, limit)
    r3, z3, o3 = bounded_component((r[2] - l31 * r1) - l32 * r2, i3, limit)
    _, z4, o4 = bounded_component(((r[3] - l41 * r1) - l42 * r2) - l43 * r3, i4, limit)
    x3 = z3 - l43 * z4
    x2 = z2 - (l32 * x3 + l42 * z4)
    x1 = z1 - (l21 * x2 + (l31 * x3 + l41 * z4))
    return (x1, x2, x3, z4, (o1 + o2) + (o3 + o4))


def target_values(y: Floats, p: Floats) -> Floats4:
    """gamma²/2, 2l, E and k of the state."""
    xi, eta = xi_of(y[0], y[1], y[3], y[4], p[0])
    i1, i2, i3 = first_three((y[0], y[1], y[2], y[3], y[4], y[5]), p[0])
    return (i1, i2, i3, math.hypot(xi, eta))


def enter_with_targets(y: Floats, h: float, p: Floats) -> Floats:
    """Physical state and target values of the integrals."""
    return (*y, *target_values(y, p))


PARALLEL = 2.0**-40
"""Squared sine of the angle between two vector fields, below which it is round-off."""
TINY = 1e-300
follow_precision(__name__, PARALLEL=1, TINY=20)
Direction = tuple[Floats6, float, float]
NewtonMatrix = tuple[Matrix, Matrix, Vector, float, float]


def momentum_field(y: Floats, c: float) -> Floats6:
    """Vector field F of the motion, for (m, gamma)."""
    w1, w2, w3, g1, g2, g3 = y
    return (
        w2 * w3,
        c * g3 - w3 * w1,
        -c * g2,
        g2 * w3 - g3 * w2,
        g3 * w1 - g1 * w3,
        g1 * w2 - g2 * w1,
    )


def hamiltonian_field(y: Floats, column: Floats4) -> Floats6:
    """Hamiltonian field, for (m, gamma), of a function with the gradient ``(a1, a2, 0, b1, b2, 0)`` in omega, gamma."""
    w1, w2, w3, g1, g2, g3 = y
    a1, a2, b1, b2 = column
    p1, p2 = 0.5 * a1, 0.5 * a2
    return (
        -(w3 * p2 + g3 * b2),
        w3 * p1 + g3 * b1,
        (w1 * a2 - w2 * a1) + (g1 * b2 - g2 * b1),
        -g3 * p2,
        g3 * p1,
        g1 * p2 - g2 * p1,
    )


def bracket(y: Floats, v: Floats6) -> Floats6:
    """J v for v = (a, b), converted to a change of omega and gamma."""
    w1, w2, w3, g1, g2, g3 = y
    a1, a2, a3, b1, b2, b3 = v
    return (
        (w2 * a3 - 0.5 * (w3 * a2)) + 0.5 * (g2 * b3 - g3 * b2),
        (0.5 * (w3 * a1) - w1 * a3) + 0.5 * (g3 * b1 - g1 * b3),
        2.0 * (w1 * a2 - w2 * a1) + (g1 * b2 - g2 * b1),
        g2 * a3 - g3 * a2,
        g3 * a1 - g1 * a3,
        g1 * a2 - g2 * a1,
    )


def conserving_direction(y: Floats, f: Floats6, column: Floats4) -> Direction:
    """Direction J(|F|² X - (F.X) F), for the function with the gradient ``column`` and the Hamiltonian field X.

    Also returns the magnitude of its rate of change of the function, |F|² |X|² - (F.X)², and the upper bound |F|² |X|².
    """
    x = hamiltonian_field(y, column)
    ff, fx, xx = dot(f, f), dot(f, x), dot(x, x)
    normal = axpy(scaled(ff, x), -fx, f)
    return bracket(y, normal), ff * xx - fx * fx, ff * xx


def xi_fields(y: Floats, c: float) -> tuple[Floats6, Floats6]:
    """Components normal to F of the Hamiltonian fields of Re xi and Im xi; independent even for xi = 0."""
    f = momentum_field(y, c)
    w1, w2 = 2.0 * y[0], 2.0 * y[1]
    u, v = hamiltonian_field(y, (w1, -w2, -c, 0.0)), hamiltonian_field(y, (w2, w1, 0.0, -c))
    ff = dot(f, f) + TINY
    return axpy(u, -dot(f, u) / ff, f), axpy(v, -dot(f, v) / ff, f)


def xi_correction(y: Floats, r1: float, r2: float, c: float) -> tuple[Floats6, float]:
    """Change of the state that changes xi by r1 + i r2 and conserves gamma², 2l and E, to first order; then 0.0.

    If the two fields are dependent, the change is zero, followed by 1.0.
    """
    u, v = xi_fields(y, c)
    uu, uv, vv = dot(u, u), dot(u, v), dot(v, v)
    det = uu * vv - uv * uv
    if not det > PARALLEL * (uu * vv):
        return (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 1.0
    a, b = (uv * r2 - vv * r1) / det, (uv * r1 - uu * r2) / det
    return bracket(y, axpy(scaled(a, u), b, v)), 0.0


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


def newton_matrix(m: Floats, d: float, c: float) -> NewtonMatrix:
    """Factorize z - d f'(m) z = r for ``newton_solve``, with the derivative f' of the vector field of the motion.

    With a = d omega and e = d gamma at ``m``, Poisson's equation gives the change of gamma as R (r + e x z), where R is
    the inverse of 1 - (. x a); three equations for omega remain. Returns R, the adjugate of their matrix, e, d c, and
    the inverse of the determinant.
    """
    a1, a2, a3 = d * m[0], d * m[1], d * m[2]
    e1, e2, e3 = d * m[3], d * m[4], d * m[5]
    q = 1.0 / ((1.0 + a1 * a1) + (a2 * a2 + a3 * a3))
    r11, r12, r13 = q * (1.0 + a1 * a1), q * (a1 * a2 + a3), q * (a1 * a3 - a2)
    r21, r22, r23 = q * (a1 * a2 - a3), q * (1.0 + a2 * a2), q * (a2 * a3 + a1)
    r31, r32, r33 = q * (a1 * a3 + a2), q * (a2 * a3 - a1), q * (1.0 + a3 * a3)
    k = d * c
    half = 0.5 * k
    m12, m13 = -0.5 * a3, -0.5 * a2
    m21 = 0.5 * a3 - half * (r32 * e3 - r33 * e2)
    m22 = 1.0 - half * (r33 * e1 - r31 * e3)
    m23 = 0.5 * a1 - half * (r31 * e2 - r32 * e1)
    m31 = k * (r22 * e3 - r23 * e2)
    m32 = k * (r23 * e1 - r21 * e3)
    m33 = 1.0 + k * (r21 * e2 - r22 * e1)
    c11, c12, c13 = m22 * m33 - m23 * m32, m23 * m31 - m21 * m33, m21 * m32 - m22 * m31
    return (
        (r11, r12, r13, r21, r22, r23, r31, r32, r33),
        (
            c11,
            m13 * m32 - m12 * m33,
            m12 * m23 - m13 * m22,
            c12,
            m33 - m13 * m31,
            m13 * m21 - m23,
            c13,
            m12 * m31 - m32,
            m22 - m12 * m21,
        ),
        (e1, e2, e3),
        k,
        1.0 / (c11 + (m12 * c12 + m13 * c13)),
    )


def newton_solve(n: NewtonMatrix, r: Floats6) -> Floats6:
    """Solve z - d f' z = r for z."""
    (r11, r12, r13, r21, r22, r23, r31, r32, r33), (c11, c21, c31, c12, c22, c32, c13, c23, c33), e, k, q = n
    e1, e2, e3 = e
    x, y, z, u, v, w = r
    y = y + (0.5 * k) * (r31 * u + (r32 * v + r33 * w))
    z = z - k * (r21 * u + (r22 * v + r23 * w))
    z1 = q * (c11 * x + (c21 * y + c31 * z))
    z2 = q * (c12 * x + (c22 * y + c32 * z))
    z3 = q * (c13 * x + (c23 * y + c33 * z))
    u = u + (e2 * z3 - e3 * z2)
    v = v + (e3 * z1 - e1 * z3)
    w = w + (e1 * z2 - e2 * z1)
    return (
        z1,
        z2,
        z3,
        r11 * u + (r12 * v + r13 * w),
        r21 * u + (r22 * v + r23 * w),
        r31 * u + (r32 * v + r33 * w),
    )
