"""Steps of HK and the midpoint rule derived by hand: ``steps_generated.py`` compares those generated with them.

Lagrange: one complex unknown after another is eliminated, and expressions in omega3 alone are made exact. Heavy: gamma
is eliminated by a Cayley rotation, and the 3x3 system for omega is solved by Cramer's rule. Midpoint rule: the same
elimination in each iteration of Newton's method.
"""

from __future__ import annotations

import math

from topcli.arithmetic.fused import fma, two_prod, two_sum
from topcli.arithmetic.vectors import Matrix, Vector, cayley_increment, resolvent, solve3
from topcli.contracts import Floats


def pivot(state: Floats, h: float, p: Floats) -> Floats:
    """Divisor in the equation for y, and the intermediate results shared with the rest of the step.

    Returns the divisor, |D|**2, b, S, K, 1/(1 + K**2) and its low part, D1, D2, V1, V2, T1, T2.
    """
    w1, w2, s, g1, g2, g3 = state
    d = 0.5 * h
    f = d * p[1]

    # functions of omega3 only
    K = d * (p[0] * s)
    D2 = d * s + K
    S = D2 - K
    K = D2 - S  # now S + K = D2 exactly
    sk, sk_low = two_prod(S, K)
    kk, kk_low = two_prod(K, K)
    q, q_low = two_sum(1.0, kk)
    rq = 1.0 / q
    one, one_low = two_prod(rq, q)
    rq_low = rq * (((1.0 - one) - one_low) - rq * (q_low + kk_low))
    F = f * rq

    # D and P/2 use the same b, so that D + P/(2 g) = 1 + iK for w = 0; then Q/2 and 2 d V
    b = fma(d * f, g3, sk_low) + sk
    D1 = 1.0 - b
    DD = fma(D1, D1, D2 * D2)
    half = 0.5 * d
    Q1 = -half * fma(K, w1, w2)
    Q2 = half * fma(-K, w2, w1)
    V1 = h * fma(-F, fma(K, g1, g2), -w1)
    V2 = h * fma(F, fma(K, g2, -g1), w2)
    # conj(D) Q/2, then the divisor of y
    T1 = fma(Q1, D1, Q2 * D2)
    T2 = fma(Q2, D1, -(Q1 * D2))
    return (fma(-T1, V2, fma(-T2, V1, DD)), DD, b, S, K, rq, rq_low, D1, D2, V1, V2, T1, T2)


def hk_lagrange_change(state: Floats, h: float, p: Floats) -> Floats:
    """Change of omega and gamma in one HK step; omega3 is constant: x + -0.0 is x, for x = -0.0 too.

    The system is singular only for step sizes far too large to be useful.
    """
    w1, w2, _, g1, g2, g3 = state
    d = 0.5 * h
    f = d * p[1]
    divisor, DD, b, S, K, rq, rq_low, D1, D2, V1, V2, T1, T2 = pivot(state, h, p)
    F = f * rq
    rest = 1.0 / divisor
    r = 2.0 / DD
    e = d * g3
    P1 = fma(b, g1, fma(S, g2, -(e * w2)))
    P2 = fma(b, g2, fma(-S, g1, e * w1))
    # conj(D) P/2
    R1 = fma(P1, D1, P2 * D2)
    R2 = fma(P2, D1, -(P1 * D2))
    turn = fma(-f, fma(g1, g1, g2 * g2), fma(-K, fma(g1, w1, g2 * w2), fma(g1, w2, -(g2 * w1))))
    y = rest * fma(h * fma(rq, turn, rq_low * turn), DD, fma(R2, V1, R1 * V2))
    # X0 = -2i (K w + f g)/(1 + iK) and X1 = -i f/(1 + iK)
    t1 = fma(K, w1, f * g1)
    t2 = fma(K, w2, f * g2)
    X1 = 2.0 * fma(-K, t1, t2)
    X2 = -2.0 * fma(K, t2, t1)
    X1 = fma(rq, X1, rq_low * X1)
    X2 = fma(rq, X2, rq_low * X2)
    # Y = (P + y Q) conj(D)/|D|**2
    R1 = r * R1
    R2 = r * R2
    T1 = r * T1
    T2 = r * T2
    return (
        fma(y, F * fma(-K, T1, T2), fma(F, fma(-K, R1, R2), X1)),
        fma(y, -F * fma(K, T2, T1), fma(-F, fma(K, R2, R1), X2)),
        -0.0,
        fma(y, T1, R1),
        fma(y, T2, R2),
        y,
    )


def hk_heavy_change(state: Floats, h: float, p: Floats) -> Floats:
    """Change in one HK step (Sogo, dEulerPoisson, last sign corrected); ``p`` is (A, B, C, mg x0, mg y0, mg z0).

    The change of gamma is that of the BS step (omega constant) plus a term linear in the change of omega. The system is
    singular only for step sizes far too large to be useful.
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


def implicit_matrix(a: Vector, gamma: Vector, d: float, p: Floats) -> Matrix:
    """Matrix K, in row-major order, for a = d omega and gamma; ``p`` is (A, B, C, mg x0, mg y0, mg z0)."""
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
    """Angular acceleration I^-1 (I omega x omega + gamma x g) at omega = o, gamma = q.

    The differences of the moments are used with their rounding errors: the three must add up to zero, otherwise the
    energy drifts by an ulp per unit time.
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


NEWTON_LIMIT, SETTLED = 25, 2.0**-33


def midpoint_change(state: Floats, h: float, p: Floats) -> Floats:
    """Change in one step of the implicit midpoint rule; ``p`` is (A, B, C, mg x0, mg y0, mg z0).

    Returns the change, the status (0.0, or nan if Newton's iteration did not converge), and the number of iterations.

    Given the mean omega, Poisson's equation is a Cayley rotation of gamma; Newton's iteration finds half the change of
    omega, v. After the last iteration the change of omega is evaluated again from the equations, so that the remaining
    error of the iteration is comparable to a rounding error of the change.
    """
    w1, w2, w3, g1, g2, g3 = state
    A, B, C, x, y, z = p
    d = 0.5 * h
    gravity = (abs(x) + abs(y) + abs(z)) * (abs(g1) + abs(g2) + abs(g3)) * (1.0 / A + 1.0 / B + 1.0 / C)
    tolerance = SETTLED * (abs(w1) + abs(w2) + abs(w3) + abs(d) * gravity)
    v1, v2, v3 = 0.0, 0.0, 0.0
    status = math.nan
    iterations = 0.0
    for _ in range(NEWTON_LIMIT):
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
