"""The changes of omega in one step of the Euler top, all in closed form or by Newton's method on three unknowns.

Notation: d = h/2, alpha_1 = (B - C)/A and so on in turn, c_i = d alpha_i, u_i = c_i omega_j omega_k (half of Euler's
rule), i, j, k cyclic. Every function returns omega' - omega (or half of it): what is left to round at the size of
omega itself is one addition, so that round-off is a random walk.

The matrix of both HK and Newton's method for the midpoint rule is M = 1 - [c_i (omega_k e_j + omega_j e_k)]. With
b_i = c_j c_k omega_i² and v_i = omega_i + u_i the solution of M x = r is

    x_i = ((1 - b_i) r_i + c_i (v_k r_j + v_j r_k))/Delta,    Delta = 1 - (b_1 + b_2 + b_3) - 2 u_1 c_2 c_3 omega_1.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from topcli.kernels.fused import fma

Floats = tuple[float, ...]
Vector = tuple[float, float, float]
Residual = Callable[[Vector, Floats, Vector], Vector]
Correction = Callable[[Vector, Floats, Vector, Vector], Vector]
Solve = Callable[[Vector, Floats, Vector], Vector]

NEWTON_LIMIT = 40
HALVINGS = 12
LAST_STEP = 1e-16
"""Newton's method is done when the square of its correction is below this, relative to the square of the change: it
doubles the digits, so that what is left is below the last bit."""

NEGLIGIBLE = 1e-60
"""Or below this, relative to the square of omega: on the way into a steady rotation the change itself dies out."""


def hk_quotient(w1: float, w2: float, w3: float, c1: float, c2: float, c3: float) -> tuple[float, Vector]:
    """2/Delta and what it is multiplied by in the change of the HK scheme: the solution of M x = 2 u, in closed form.

    With c_i v_j u_k and its kin multiplied out the numerators are u_i (1 + b_i) + c_i (omega_j u_k + omega_k u_j). The
    last term could be omega_i (b_j + b_k), but b's coefficients are rounded, the same in every step, and what that does
    would add up. What the division waits for stands first: the rest is then computed while it runs.
    """
    a1 = (c2 * c3) * w1
    t1 = (2.0 * c1) * w2
    a2 = (c3 * c1) * w2
    a3 = (c1 * c2) * w3
    b2 = a2 * w2
    b3 = a3 * w3
    t1 = t1 * w3
    r = 2.0 / (fma(-a1, t1, fma(-a1, w1, 1.0)) - (b2 + b3))
    b1 = a1 * w1
    u1 = 0.5 * t1
    u2 = c2 * (w3 * w1)
    u3 = c3 * (w1 * w2)
    return r, (
        fma(c1, fma(w2, u3, w3 * u2), fma(b1, u1, u1)),
        fma(c2, fma(w3, u1, w1 * u3), fma(b2, u2, u2)),
        fma(c3, fma(w1, u2, w2 * u1), fma(b3, u3, u3)),
    )


def hk_increment(w1: float, w2: float, w3: float, c1: float, c2: float, c3: float) -> Vector:
    """omega' - omega of the HK scheme."""
    r, (n1, n2, n3) = hk_quotient(w1, w2, w3, c1, c2, c3)
    return (r * n1, r * n2, r * n3)


def hk_gamma_increment(
    a1: float, a2: float, a3: float, x1: float, x2: float, x3: float, g1: float, g2: float, g3: float
) -> Vector:
    """gamma' - gamma of the HK scheme, linear once omega' is known: y - y x a = gamma x (2 a + x).

    ``a`` is d omega and ``x`` is d (omega' - omega). The solution is y = (b + b x a + a (a.b))/(1 + a.a).
    """
    s1 = fma(2.0, a1, x1)
    s2 = fma(2.0, a2, x2)
    s3 = fma(2.0, a3, x3)
    b1 = fma(g2, s3, -(g3 * s2))
    b2 = fma(g3, s1, -(g1 * s3))
    b3 = fma(g1, s2, -(g2 * s1))
    r = 1.0 / (fma(a1, a1, 1.0) + fma(a2, a2, a3 * a3))
    along = a1 * b1 + fma(a2, b2, a3 * b3)
    return (
        r * fma(a1, along, b1 + fma(b2, a3, -(b3 * a2))),
        r * fma(a2, along, b2 + fma(b3, a1, -(b1 * a3))),
        r * fma(a3, along, b3 + fma(b1, a2, -(b2 * a1))),
    )


def hk_step(s: Floats, h: float, p: Floats) -> Floats:
    """The HK step, p = (A, B, C, alpha_1, alpha_2, alpha_3); each component is rounded once."""
    w1, w2, w3 = s
    d = 0.5 * h
    r, (n1, n2, n3) = hk_quotient(w1, w2, w3, d * p[3], d * p[4], d * p[5])
    return (fma(r, n1, w1), fma(r, n2, w2), fma(r, n3, w3))


def hk_gamma_step(s: Floats, h: float, p: Floats) -> Floats:
    """The HK step with gamma carried along; omega is that of ``hk_step``."""
    w1, w2, w3, g1, g2, g3 = s
    d = 0.5 * h
    r, (n1, n2, n3) = hk_quotient(w1, w2, w3, d * p[3], d * p[4], d * p[5])
    f = d * r
    y1, y2, y3 = hk_gamma_increment(d * w1, d * w2, d * w3, f * n1, f * n2, f * n3, g1, g2, g3)
    return (fma(r, n1, w1), fma(r, n2, w2), fma(r, n3, w3), g1 + y1, g2 + y2, g3 + y3)


def bs_increment(
    w1: float, w2: float, w3: float, A: float, B: float, C: float, d: float, c1: float, c2: float, c3: float
) -> Vector:
    """omega' - omega of m' - m = d (m' + m) x omega: Cayley's rotation of m, divided by the moments.

    m x omega is written with the differences of the moments, so that it vanishes exactly for a spherical top.
    """
    b1 = A * (c1 * (w2 * w3))
    b2 = B * (c2 * (w3 * w1))
    b3 = C * (c3 * (w1 * w2))
    a1 = d * w1
    a2 = d * w2
    a3 = d * w3
    r = 2.0 / ((1.0 + a1 * a1) + (a2 * a2 + a3 * a3))
    return (
        r * (b1 + (b2 * a3 - b3 * a2)) / A,
        r * (b2 + (b3 * a1 - b1 * a3)) / B,
        r * (b3 + (b1 * a2 - b2 * a1)) / C,
    )


def midpoint_residual(w: Vector, q: Floats, z: Vector) -> Vector:
    """By how much half a change z misses z_i = c_i (omega_j + z_j)(omega_k + z_k); q = (c_1, c_2, c_3)."""
    y1 = w[0] + z[0]
    y2 = w[1] + z[1]
    y3 = w[2] + z[2]
    return (q[0] * (y2 * y3) - z[0], q[1] * (y3 * y1) - z[1], q[2] * (y1 * y2) - z[2])


def midpoint_correction(w: Vector, q: Floats, z: Vector, r: Vector) -> Vector:
    """Newton's correction of z for the residual r: M x = r at omega + z."""
    y1 = w[0] + z[0]
    y2 = w[1] + z[1]
    y3 = w[2] + z[2]
    c1, c2, c3 = q
    r1, r2, r3 = r
    v1 = y1 + c1 * (y2 * y3)
    v2 = y2 + c2 * (y3 * y1)
    v3 = y3 + c3 * (y1 * y2)
    k1 = c2 * c3
    b1 = k1 * (y1 * y1)
    b2 = (c3 * c1) * (y2 * y2)
    b3 = (c1 * c2) * (y3 * y3)
    f = 1.0 / ((1.0 - b1) - ((b2 + b3) + (2.0 * k1) * (y1 * (c1 * (y2 * y3)))))
    return (
        f * ((1.0 - b1) * r1 + c1 * (v3 * r2 + v2 * r3)),
        f * ((1.0 - b2) * r2 + c2 * (v1 * r3 + v3 * r1)),
        f * ((1.0 - b3) * r3 + c3 * (v2 * r1 + v1 * r2)),
    )


def implicit_residual(w: Vector, q: Floats, x: Vector) -> Vector:
    """By how much a change x misses m' - m = d (m' + m) x omega', divided by the moments.

    x_i = c_i ((omega_j + x_j)(omega_k + x_k) + omega_j omega_k) + e_i (m_j x_k - m_k x_j) with e_i = d/I_i and m of
    the old state; q = (c_1, c_2, c_3, e_1, e_2, e_3, m_1, m_2, m_3).
    """
    c1, c2, c3, e1, e2, e3, m1, m2, m3 = q
    w1, w2, w3 = w
    x1, x2, x3 = x
    return (
        (c1 * ((w2 + x2) * (w3 + x3) + w2 * w3) - x1) + e1 * (m2 * x3 - m3 * x2),
        (c2 * ((w3 + x3) * (w1 + x1) + w3 * w1) - x2) + e2 * (m3 * x1 - m1 * x3),
        (c3 * ((w1 + x1) * (w2 + x2) + w1 * w2) - x3) + e3 * (m1 * x2 - m2 * x1),
    )


def implicit_correction(w: Vector, q: Floats, x: Vector, r: Vector) -> Vector:
    """Newton's correction of x for the residual r, by Cramer's rule."""
    c1, c2, c3, e1, e2, e3, m1, m2, m3 = q
    y1 = w[0] + x[0]
    y2 = w[1] + x[1]
    y3 = w[2] + x[2]
    r1, r2, r3 = r
    n12 = e1 * m3 - c1 * y3
    n13 = -e1 * m2 - c1 * y2
    n23 = e2 * m1 - c2 * y1
    n21 = -e2 * m3 - c2 * y3
    n31 = e3 * m2 - c3 * y2
    n32 = -e3 * m1 - c3 * y1
    k1 = 1.0 - n23 * n32
    k2 = n23 * n31 - n21
    k3 = n21 * n32 - n31
    f = 1.0 / (k1 + n12 * k2 + n13 * k3)
    return (
        f * (k1 * r1 + (n13 * n32 - n12) * r2 + (n12 * n23 - n13) * r3),
        f * (k2 * r1 + (1.0 - n13 * n31) * r2 + (n13 * n21 - n23) * r3),
        f * (k3 * r1 + (n12 * n31 - n32) * r2 + (1.0 - n12 * n21) * r3),
    )


def square(x: Vector) -> float:
    """x.x"""
    return x[0] * x[0] + (x[1] * x[1] + x[2] * x[2])


def newton(residual: Residual, correction: Correction) -> Solve:
    """A solver of ``residual(w, q, x) = 0`` for x from a start, by Newton's method with halved steps as a safeguard.

    A correction is halved until the residual shrinks. Without convergence the result is NaN: the run then ends
    there and says so.
    """

    def solve(w: Vector, q: Floats, start: Vector) -> Vector:
        x = start
        r = residual(w, q, x)
        size = square(r)
        floor = NEGLIGIBLE * square(w)
        for _ in range(NEWTON_LIMIT):
            d1, d2, d3 = correction(w, q, x, r)
            tried = (x[0] + d1, x[1] + d2, x[2] + d3)
            if square((d1, d2, d3)) <= LAST_STEP * square(tried) + floor:
                return tried
            left = residual(w, q, tried)
            t = 1.0
            for _ in range(HALVINGS):
                if square(left) < size:
                    break
                t = 0.5 * t
                tried = (x[0] + t * d1, x[1] + t * d2, x[2] + t * d3)
                left = residual(w, q, tried)
            x = tried
            r = left
            size = square(r)
        return (math.nan, math.nan, math.nan)

    return solve


midpoint_half = newton(midpoint_residual, midpoint_correction)
"""(omega' - omega)/2 of the midpoint rule, ``midpoint_half(omega, (c_1, c_2, c_3), start)``."""

implicit_increment = newton(implicit_residual, implicit_correction)
"""omega' - omega of the BS scheme with the new omega, ``implicit_increment(omega, q, start)``."""
