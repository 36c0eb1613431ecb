"""The Kowalevski top as a Hamiltonian system: changes of the state that keep gamma², 2l and E, and Newton's matrix.

With m = (2 w1, 2 w2, w3) the bracket turns the gradient (a, b) of any function with respect to (m, gamma) into the
vector field J(a, b) = (m x a + gamma x b, gamma x a), which keeps gamma² and m.gamma = 2l. The field of the motion is
F = J grad E, and J is antisymmetric: J(a, b) changes a function whose own field is X at the rate -(a, b).X. Hence

- J(a, b) keeps E as well if (a, b) is normal to F;
- of these the one with the part of X normal to F changes the function with field X the most, at the rate of minus the
  square of that part. It vanishes only where X and F are parallel: on degenerate tori and in relative equilibria.

That takes no matrix and no division, and as the three integrals are quadratic, what is normal to their gradients at
the mean of two states changes neither of them on the way from one to the other.
"""

from __future__ import annotations

from topcli.contracts import Floats
from topcli.schemes.kowalevski.four_integrals import Four, Six

DEPENDENT = 2.0**-40
"""Squared sine of the angle between two fields below which it is round-off."""
TINY = 1e-300
Direction = tuple[Six, float, float]
Newton = tuple[
    tuple[float, float, float, float, float, float, float, float, float],
    tuple[float, float, float, float, float, float, float, float, float],
    tuple[float, float, float],
    float,
    float,
]


def field_of_m(y: Floats, c: float) -> Six:
    """F: the rates of change of (m, gamma)."""
    w1, w2, w3, g1, g2, g3 = y
    return (
        w2 * w3,
        c * g3 - w3 * w1,
        -c * g2,
        g2 * w3 - g3 * w2,
        g3 * w1 - g1 * w3,
        g1 * w2 - g2 * w1,
    )


def field_of(y: Floats, column: Four) -> Six:
    """The field, for (m, gamma), of a function with the gradient ``(a1, a2, 0, b1, b2, 0)`` by omega and gamma."""
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


def inner(u: Six, v: Six) -> float:
    """The scalar product."""
    return (u[0] * v[0] + (u[1] * v[1] + u[2] * v[2])) + (u[3] * v[3] + (u[4] * v[4] + u[5] * v[5]))


def bracket(y: Floats, v: Six) -> Six:
    """J v as a change of omega and gamma, for v = (a, b)."""
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


def keeping_three(y: Floats, f: Six, column: Four) -> Direction:
    """The direction J(|F|² X - (F.X) F), for the function with the gradient ``column`` and the field X.

    Also its rate, |F|² |X|² - (F.X)² with the sign changed, and |F|² |X|²: how much it would be at best.
    """
    x = field_of(y, column)
    ff, fx, xx = inner(f, f), inner(f, x), inner(x, x)
    normal = (
        ff * x[0] - fx * f[0],
        ff * x[1] - fx * f[1],
        ff * x[2] - fx * f[2],
        ff * x[3] - fx * f[3],
        ff * x[4] - fx * f[4],
        ff * x[5] - fx * f[5],
    )
    return bracket(y, normal), ff * xx - fx * fx, ff * xx


def fields_of_xi(y: Floats, c: float) -> tuple[Six, Six]:
    """The parts normal to F of the fields of Re xi and Im xi; they are independent for xi = 0 too."""
    f = field_of_m(y, c)
    w1, w2 = 2.0 * y[0], 2.0 * y[1]
    u, v = field_of(y, (w1, -w2, -c, 0.0)), field_of(y, (w2, w1, 0.0, -c))
    ff = inner(f, f) + TINY
    su, sv = inner(f, u) / ff, inner(f, v) / ff
    return (
        (u[0] - su * f[0], u[1] - su * f[1], u[2] - su * f[2], u[3] - su * f[3], u[4] - su * f[4], u[5] - su * f[5]),
        (v[0] - sv * f[0], v[1] - sv * f[1], v[2] - sv * f[2], v[3] - sv * f[3], v[4] - sv * f[4], v[5] - sv * f[5]),
    )


def changing_xi(y: Floats, r1: float, r2: float, c: float) -> tuple[Six, float]:
    """The change of the state that keeps gamma², 2l and E, to first order, and changes xi by r1 + i r2; then 0.0.

    Where the two fields are dependent: no change, and 1.0.
    """
    u, v = fields_of_xi(y, c)
    uu, uv, vv = inner(u, u), inner(u, v), inner(v, v)
    det = uu * vv - uv * uv
    if not det > DEPENDENT * (uu * vv):
        return (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 1.0
    a, b = (uv * r2 - vv * r1) / det, (uv * r1 - uu * r2) / det
    return (
        bracket(
            y,
            (
                a * u[0] + b * v[0],
                a * u[1] + b * v[1],
                a * u[2] + b * v[2],
                a * u[3] + b * v[3],
                a * u[4] + b * v[4],
                a * u[5] + b * v[5],
            ),
        ),
        0.0,
    )


def newton_matrix(m: Floats, d: float, c: float) -> Newton:
    """What ``newton_solved`` needs to solve z - d f'(m) z = r, f' being the derivative of the motion's field.

    With a = d omega and e = d gamma at ``m`` Poisson's equation gives the change of gamma as R (r + e x z), R the
    inverse of 1 - (. x a), and three equations for omega are left. Returns R, the adjugate of their matrix, e, d c,
    and the inverse of the determinant.
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


def newton_solved(n: Newton, r: Six) -> Six:
    """The z with z - d f' z = r."""
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
