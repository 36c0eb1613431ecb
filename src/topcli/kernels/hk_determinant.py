"""Determinants of the linear systems that HK's steps solve, each with the size of its terms.

More slots may follow the state. The formulas are those of the steps themselves: inlined beside one, they cost what the
comparison costs.
"""

from __future__ import annotations

from topcli.contracts import Floats
from topcli.kernels.dd import two_prod, two_sum
from topcli.kernels.euler_poisson import implicit_matrix
from topcli.kernels.fused import fma
from topcli.kernels.hk_kowalevski import coefficients


def kowalevski_determinant(state: Floats, h: float, p: Floats) -> tuple[float, float]:
    """That of ``hk_kowalevski``'s two equations; where it is small, both of its terms are as large."""
    w, g = (state[0], state[1], state[2]), (state[3], state[4], state[5])
    m11, m12, m21, m22, _, _, _, _ = coefficients(w, g, h, p[0])
    term = m11 * m22
    return (fma(-m12, m21, term), 2.0 * abs(term))


def heavy_determinant(state: Floats, h: float, p: Floats) -> tuple[float, float]:
    """That of ``hk_heavy``'s three equations for omega; ``p`` is (A, B, C, mg x0, mg y0, mg z0)."""
    w1, w2, w3, g1, g2, g3 = state[0], state[1], state[2], state[3], state[4], state[5]
    d = 0.5 * h
    m11, m12, m13, m21, m22, m23, m31, m32, m33 = implicit_matrix((d * w1, d * w2, d * w3), (g1, g2, g3), d, p)
    t1 = m11 * (m22 * m33 - m23 * m32)
    t2 = m12 * (m23 * m31 - m21 * m33)
    t3 = m13 * (m21 * m32 - m22 * m31)
    return (t1 + t2 + t3, abs(t1) + (abs(t2) + abs(t3)))


def euler_determinant(state: Floats, h: float, p: Floats) -> tuple[float, float]:
    """Delta of ``hk_increment``; ``p`` is (A, B, C, alpha1, alpha2, alpha3)."""
    w1, w2, w3 = state[0], state[1], state[2]
    d = 0.5 * h
    c1, c2, c3 = d * p[3], d * p[4], d * p[5]
    u1 = c1 * (w2 * w3)
    k1 = c2 * c3
    b1 = k1 * (w1 * w1)
    b2 = (c3 * c1) * (w2 * w2)
    b3 = (c1 * c2) * (w3 * w3)
    last = (2.0 * k1) * (u1 * w1)
    return ((1.0 - b1) - ((b2 + b3) + last), (1.0 + abs(b1)) + ((abs(b2) + abs(b3)) + abs(last)))


def lagrange_determinant(state: Floats, h: float, p: Floats) -> tuple[float, float]:
    """What ``hk_lagrange`` divides by to find the change of gamma3; ``p`` is ((A - C)/A, mg z0/A)."""
    w1, w2, s, g1, g2, g3 = state[0], state[1], state[2], state[3], state[4], state[5]
    d = 0.5 * h
    f = d * p[1]
    K = d * (p[0] * s)
    D2 = d * s + K
    S = D2 - K
    K = D2 - S
    sk, sk_low = two_prod(S, K)
    kk, _ = two_prod(K, K)
    q, _ = two_sum(1.0, kk)
    rq = 1.0 / q
    F = f * rq
    z = (d * f) * g3
    b = (z + sk_low) + sk
    D1 = 1.0 - b
    DD = D1 * D1 + D2 * D2
    Q1 = -d * (w2 + K * w1)
    Q2 = d * (w1 - K * w2)
    V1 = -F * (K * g1 + g2) - w1
    V2 = F * (K * g2 - g1) + w2
    U1 = V1 * D1 + V2 * D2
    U2 = V2 * D1 - V1 * D2
    rest = d * (Q1 * U2 + Q2 * U1)
    return (DD - rest, DD + abs(rest))
