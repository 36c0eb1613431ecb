"""Steps of HK derived by hand, with which ``steps_generated.py`` compares those generated from the field.

Lagrange: one complex unknown after another is eliminated, and expressions in omega3 alone are made exact. Heavy: gamma
is eliminated by a Cayley rotation, and the 3x3 system for omega is solved by Cramer's rule.
"""

from __future__ import annotations

from topcli.arithmetic.fused import fma, two_prod, two_sum
from topcli.arithmetic.vectors import cayley_increment, resolvent, solve3
from topcli.contracts import Floats
from topcli.schemes.any_top.midpoint import implicit_matrix


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
