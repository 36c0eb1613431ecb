"""One HK step of the Lagrange top: the 6x6 linear system, eliminated in closed form.

With d = h/2, alpha = (A - C)/A = ``p[0]``, nu = mg z0/A = ``p[1]``, s = omega3, k = alpha s and complex numbers
w = omega1 + i omega2, g = gamma1 + i gamma2, the discrete equations (Sogo, dEulerPoisson with A = B, x0 = y0 = 0,
last sign corrected) leave s as it is and are linear in the changes X of w, Y of g and y of gamma3:

    X = -i d (k (2 w + X) + nu (2 g + Y))
    Y = -i d s (2 g + Y) + i d (2 gamma3 w + y w + gamma3 X)
    y = d Im(2 conj(g) w + conj(Y) w + conj(g) X)

Write K = d k, S = d s, z = d**2 nu gamma3, D = (1 + iS)(1 + iK) - z. Then

1. the first gives X (1 + iK) = -i (2 K w + d nu (2 g + Y));
2. put into the second, D Y = P + y Q with P = 2 ((z + S K - i S) g + i d gamma3 w), Q = i d (1 + iK) w;
3. put into the third, y (1 - d Im(Q V/D)) = d Im(2 conj(g) w + conj(g) X0 + P V/D), where X = X0 + X1 Y and
   V = conj(g) X1 - conj(w). Multiplied by |D|**2 so that both divisions start at the same time.

S and K are the same in every step, and so are the rounding errors of what is computed from them alone: they would add
up as N and not as its square root. Hence S + K is made exact, and 1/(1 + K**2) and S K carry their errors along; all
of that is computed once, before the loop.
"""

from __future__ import annotations

from topcli.contracts import Floats
from topcli.kernels.dd import two_prod, two_sum
from topcli.kernels.increments import carried_sum


def hk_lagrange_change(state: Floats, h: float, p: Floats) -> tuple[float, float, float, float, float]:
    """The change of omega1, omega2 and gamma in one HK step; omega3 has none.

    Singular, hence not finite, only for steps far beyond any use.
    """
    w1, w2, s, g1, g2, g3 = state
    d = 0.5 * h
    f = d * p[1]

    # of omega3 alone
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

    # D, its inverse square modulus, and P; b is in both, so that D + P/(2 g) = 1 + iK where w = 0
    z = (d * f) * g3
    b = (z + sk_low) + sk
    D1 = 1.0 - b
    DD = D1 * D1 + D2 * D2
    r = 1.0 / DD
    e = d * g3
    P1 = 2.0 * ((b * g1 + S * g2) - e * w2)
    P2 = 2.0 * ((b * g2 - S * g1) + e * w1)
    Q1 = -d * (w2 + K * w1)
    Q2 = d * (w1 - K * w2)
    # X0 = -2i (K w + f g)/(1 + iK) and X1 = -i f/(1 + iK)
    t1 = K * w1 + f * g1
    t2 = K * w2 + f * g2
    T1 = 2.0 * (t2 - K * t1)
    T2 = -2.0 * (t1 + K * t2)
    X1 = rq * T1 + rq_low * T1
    X2 = rq * T2 + rq_low * T2
    # V and V conj(D)
    V1 = -F * (K * g1 + g2) - w1
    V2 = F * (K * g2 - g1) + w2
    U1 = V1 * D1 + V2 * D2
    U2 = V2 * D1 - V1 * D2
    turn = 2.0 * (g1 * w2 - g2 * w1) + (g1 * X2 - g2 * X1)
    y = d * (turn * DD + (P1 * U2 + P2 * U1)) / (DD - d * (Q1 * U2 + Q2 * U1))
    # Y = (P + y Q) conj(D)/|D|**2
    N1 = P1 + y * Q1
    N2 = P2 + y * Q2
    Y1 = r * (N1 * D1 + N2 * D2)
    Y2 = r * (N2 * D1 - N1 * D2)
    return (X1 + F * (Y2 - K * Y1), X2 - F * (Y1 + K * Y2), Y1, Y2, y)


def hk_lagrange(state: Floats, h: float, p: Floats) -> Floats:
    """The HK step from (omega, gamma)."""
    w1, w2, w3, g1, g2, g3 = state
    x1, x2, y1, y2, y3 = hk_lagrange_change(state, h, p)
    return (w1 + x1, w2 + x2, w3, g1 + y1, g2 + y2, g3 + y3)


def hk_lagrange_compensated(s: Floats, h: float, p: Floats) -> Floats:
    """The HK step with what the sums have lost: of omega1, omega2 and gamma, for omega3 is handed on as it is."""
    w1, w2, w3, g1, g2, g3, e1, e2, e4, e5, e6 = s
    x1, x2, y1, y2, y3 = hk_lagrange_change((w1, w2, w3, g1, g2, g3), h, p)
    w1, e1 = carried_sum(w1, e1, x1)
    w2, e2 = carried_sum(w2, e2, x2)
    g1, e4 = carried_sum(g1, e4, y1)
    g2, e5 = carried_sum(g2, e5, y2)
    g3, e6 = carried_sum(g3, e6, y3)
    return (w1, w2, w3, g1, g2, g3, e1, e2, e4, e5, e6)


def enter_compensated(y: Floats, h: float, p: Floats) -> Floats:
    """The physical state, nothing lost yet."""
    return (*y, 0.0, 0.0, 0.0, 0.0, 0.0)
