"""Kowalevski top as a Lie-Poisson system: changes of the state that conserve gamma², 2l and E, and Newton matrix.

With m = (2 w1, 2 w2, w3) the bracket maps the gradient (a, b) of a function with respect to (m, gamma) to its
Hamiltonian vector field J(a, b) = (m x a + gamma x b, gamma x a), which conserves gamma² and m.gamma = 2l. The vector
field of the motion is F = J grad E, and J is antisymmetric: along J(a, b), a function with Hamiltonian field X changes
at the rate -(a, b).X. Hence

- J(a, b) also conserves E if (a, b) is normal to F;
- among these directions, that with (a, b) equal to the component of X normal to F changes the function with field X
  the most, at the rate of minus the square of that component. It vanishes only where X and F are parallel: on
  degenerate tori and at relative equilibria.

This direction needs no matrix and no division. Because the three integrals are quadratic, a change that is normal to
their gradients at the mean of two states conserves them from one state to the other.
"""

from __future__ import annotations

from topcli.arithmetic.tolerances import follow_precision
from topcli.arithmetic.vectors import Floats6, axpy, dot, scaled
from topcli.contracts import Floats
from topcli.schemes.kowalevski.four_integrals import Floats4

DEPENDENT = 2.0**-40
"""Squared sine of the angle between two vector fields, below which it is round-off."""
TINY = 1e-300
follow_precision(__name__, DEPENDENT=1, TINY=20)
Direction = tuple[Floats6, float, float]
NewtonMatrix = tuple[
    tuple[float, float, float, float, float, float, float, float, float],
    tuple[float, float, float, float, float, float, float, float, float],
    tuple[float, float, float],
    float,
    float,
]


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
    if not det > DEPENDENT * (uu * vv):
        return (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 1.0
    a, b = (uv * r2 - vv * r1) / det, (uv * r1 - uu * r2) / det
    return bracket(y, axpy(scaled(a, u), b, v)), 0.0


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
