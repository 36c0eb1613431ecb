"""Steps of the general Euler-Poisson equations: the HK scheme and the implicit midpoint rule.

With I = (A, B, C), g = mg(x0, y0, z0), d = h/2 and a = d omega both schemes meet the same linear problem. Poisson's
equation gives the change of gamma from that of omega by the inverse of 1 - (. x a), which exists for every a, and
what is left are three equations for the change of omega, with the matrix::

    K delta = delta - d I^-1 (I omega x delta + I delta x omega + zeta x g),   zeta - zeta x a = d gamma x delta

Everything is solved for *changes* of the state: rounding errors are then of the size of the change, and the one
addition state + change rounds without bias.
"""

from __future__ import annotations

import math

from topcli.contracts import Floats
from topcli.kernels.dd import two_sum
from topcli.kernels.increments import plain6
from topcli.kernels.so3 import Vector, cayley_increment

Matrix = tuple[float, float, float, float, float, float, float, float, float]

NEWTON = 25
"""Newton iterations before a step is given up; three or four are the rule."""
SETTLED = 2.0**-33
"""The last change, in units of omega, that ends the iteration: Newton squares it, far below the last bit."""


def resolvent(a1: float, a2: float, a3: float, b1: float, b2: float, b3: float) -> Vector:
    """The z that solves z - z x a = b: z = (b + b x a + (a.b) a) / (1 + a.a)."""
    r = 1.0 / ((1.0 + a1 * a1) + (a2 * a2 + a3 * a3))
    k = a1 * b1 + a2 * b2 + a3 * b3
    return (
        r * (b1 + (b2 * a3 - b3 * a2) + k * a1),
        r * (b2 + (b3 * a1 - b1 * a3) + k * a2),
        r * (b3 + (b1 * a2 - b2 * a1) + k * a3),
    )


def solve3(m: Matrix, r1: float, r2: float, r3: float) -> Vector:
    """The x of three equations m x = r, by Cramer's rule; ``m`` row by row."""
    m11, m12, m13, m21, m22, m23, m31, m32, m33 = m
    c11 = m22 * m33 - m23 * m32
    c12 = m23 * m31 - m21 * m33
    c13 = m21 * m32 - m22 * m31
    q = 1.0 / (m11 * c11 + m12 * c12 + m13 * c13)
    return (
        q * (r1 * c11 + r2 * (m13 * m32 - m12 * m33) + r3 * (m12 * m23 - m13 * m22)),
        q * (r1 * c12 + r2 * (m11 * m33 - m13 * m31) + r3 * (m13 * m21 - m11 * m23)),
        q * (r1 * c13 + r2 * (m12 * m31 - m11 * m32) + r3 * (m11 * m22 - m12 * m21)),
    )


def implicit_matrix(a: Vector, gamma: Vector, d: float, p: Floats) -> Matrix:
    """The matrix K above, row by row, for a = d omega and gamma; ``p`` is (A, B, C, mg x0, mg y0, mg z0)."""
    a1, a2, a3 = a
    A, B, C, x, y, z = p
    e1, e2, e3 = d * gamma[0], d * gamma[1], d * gamma[2]
    s11, s21, s31 = resolvent(a1, a2, a3, 0.0, e3, -e2)
    s12, s22, s32 = resolvent(a1, a2, a3, -e3, 0.0, e1)
    s13, s23, s33 = resolvent(a1, a2, a3, e2, -e1, 0.0)
    f1, f2, f3 = 1.0 / A, 1.0 / B, 1.0 / C
    k1, k2, k3 = f1 * (B - C), f2 * (C - A), f3 * (A - B)
    f1, f2, f3 = d * f1, d * f2, d * f3
    return (
        1.0 - f1 * (s21 * z - s31 * y),
        -k1 * a3 - f1 * (s22 * z - s32 * y),
        -k1 * a2 - f1 * (s23 * z - s33 * y),
        -k2 * a3 - f2 * (s31 * x - s11 * z),
        1.0 - f2 * (s32 * x - s12 * z),
        -k2 * a1 - f2 * (s33 * x - s13 * z),
        -k3 * a2 - f3 * (s11 * y - s21 * x),
        -k3 * a1 - f3 * (s12 * y - s22 * x),
        1.0 - f3 * (s13 * y - s23 * x),
    )


def angular_acceleration(o1: float, o2: float, o3: float, q1: float, q2: float, q3: float, p: Floats) -> Vector:
    """I^-1 (I omega x omega + gamma x g) at omega = o, gamma = q.

    The differences of moments carry their own rounding errors along: the three must add up to zero, or the energy
    would drift by an ulp per unit time.
    """
    A, B, C, x, y, z = p
    k1, r1 = two_sum(B, -C)
    k2, r2 = two_sum(C, -A)
    k3, r3 = two_sum(A, -B)
    o23, o31, o12 = o2 * o3, o3 * o1, o1 * o2
    return (
        ((k1 * o23 + r1 * o23) + (q2 * z - q3 * y)) / A,
        ((k2 * o31 + r2 * o31) + (q3 * x - q1 * z)) / B,
        ((k3 * o12 + r3 * o12) + (q1 * y - q2 * x)) / C,
    )


def hk_heavy_change(state: Floats, h: float, p: Floats) -> Floats:
    """The change in one HK step (Sogo, dEulerPoisson, last sign corrected); ``p`` is (A, B, C, mg x0, mg y0, mg z0).

    The change of gamma is that of the BS step (omega kept) plus a part linear in the change of omega. Singular,
    hence not finite, only for steps far beyond any use.
    """
    w1, w2, w3, g1, g2, g3 = state
    A, B, C, x, y, z = p
    d = 0.5 * h
    a1, a2, a3 = d * w1, d * w2, d * w3
    b1, b2, b3 = cayley_increment(a1, a2, a3, g1, g2, g3)
    t1, t2, t3 = g1 + 0.5 * b1, g2 + 0.5 * b2, g3 + 0.5 * b3
    u1, u2, u3 = solve3(
        implicit_matrix((a1, a2, a3), (g1, g2, g3), d, p),
        (h / A) * ((B - C) * w2 * w3 + (t2 * z - t3 * y)),
        (h / B) * ((C - A) * w3 * w1 + (t3 * x - t1 * z)),
        (h / C) * ((A - B) * w1 * w2 + (t1 * y - t2 * x)),
    )
    z1, z2, z3 = resolvent(a1, a2, a3, d * (g2 * u3 - g3 * u2), d * (g3 * u1 - g1 * u3), d * (g1 * u2 - g2 * u1))
    return (u1, u2, u3, b1 + z1, b2 + z2, b3 + z3)


hk_heavy = plain6(hk_heavy_change)
"""The HK step from (omega, gamma)."""


def midpoint_change(
    state: Floats, h: float, p: Floats
) -> tuple[float, float, float, float, float, float, float, float]:
    """The change in one step of the implicit midpoint rule; ``p`` is (A, B, C, mg x0, mg y0, mg z0).

    Returns the change, then 0.0 or, when Newton's iteration did not settle, nan, then the number of iterations.

    Given the mean omega, Poisson's equation is Cayley's rotation of gamma; Newton's iteration finds the half change
    v of omega. At its end omega's change is computed afresh from the equations, so that what is left of the
    iteration's error is of the size of a rounding error of the change.
    """
    w1, w2, w3, g1, g2, g3 = state
    A, B, C, x, y, z = p
    d = 0.5 * h
    gravity = (abs(x) + abs(y) + abs(z)) * (abs(g1) + abs(g2) + abs(g3)) * (1.0 / A + 1.0 / B + 1.0 / C)
    tolerance = SETTLED * (abs(w1) + abs(w2) + abs(w3) + abs(d) * gravity)
    v1, v2, v3 = 0.0, 0.0, 0.0
    status = math.nan
    iterations = 0.0
    for _ in range(NEWTON):
        iterations += 1.0
        o1, o2, o3 = w1 + v1, w2 + v2, w3 + v3
        a1, a2, a3 = d * o1, d * o2, d * o3
        b1, b2, b3 = cayley_increment(a1, a2, a3, g1, g2, g3)
        q1, q2, q3 = g1 + 0.5 * b1, g2 + 0.5 * b2, g3 + 0.5 * b3
        f1, f2, f3 = angular_acceleration(o1, o2, o3, q1, q2, q3, p)
        e1, e2, e3 = solve3(implicit_matrix((a1, a2, a3), (q1, q2, q3), d, p), d * f1 - v1, d * f2 - v2, d * f3 - v3)
        v1, v2, v3 = v1 + e1, v2 + e2, v3 + e3
        if abs(e1) + abs(e2) + abs(e3) <= tolerance:
            status = 0.0
            break
    o1, o2, o3 = w1 + v1, w2 + v2, w3 + v3
    b1, b2, b3 = cayley_increment(d * o1, d * o2, d * o3, g1, g2, g3)
    f1, f2, f3 = angular_acceleration(o1, o2, o3, g1 + 0.5 * b1, g2 + 0.5 * b2, g3 + 0.5 * b3, p)
    return (h * f1, h * f2, h * f3, b1, b2, b3, status, iterations)


def midpoint(state: Floats, h: float, p: Floats) -> tuple[float, float, float, float, float, float, float, float]:
    """One step of the implicit midpoint rule: the new state, then status and iterations of ``midpoint_change``."""
    w1, w2, w3, g1, g2, g3 = state
    x1, x2, x3, y1, y2, y3, status, iterations = midpoint_change(state, h, p)
    return (w1 + x1, w2 + x2, w3 + x3, g1 + y1, g2 + y2, g3 + y3, status, iterations)
