"""Determinants of the linear systems that HK's steps solve, each with the size of its terms.

More slots may follow the state. The formulas are those of the steps themselves: inlined beside one, they cost what the
comparison costs.
"""

from __future__ import annotations

from topcli.contracts import Floats
from topcli.kernels.euler_poisson import implicit_matrix
from topcli.kernels.fused import fma
from topcli.kernels.hk_kowalevski import coefficients
from topcli.kernels.hk_lagrange import pivot


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
    """Delta of ``hk_quotient``; ``p`` is (A, B, C, alpha1, alpha2, alpha3)."""
    w1, w2, w3 = state[0], state[1], state[2]
    d = 0.5 * h
    c1, c2, c3 = d * p[3], d * p[4], d * p[5]
    a1 = (c2 * c3) * w1
    a2 = (c3 * c1) * w2
    a3 = (c1 * c2) * w3
    b2 = a2 * w2
    b3 = a3 * w3
    t1 = ((2.0 * c1) * w2) * w3
    value = fma(-a1, t1, fma(-a1, w1, 1.0)) - (b2 + b3)
    return (value, (1.0 + abs(a1 * w1)) + ((abs(b2) + abs(b3)) + abs(a1 * t1)))


def lagrange_determinant(state: Floats, h: float, p: Floats) -> tuple[float, float]:
    """What ``hk_lagrange`` divides by to find the change of gamma3; ``p`` is ((A - C)/A, mg z0/A)."""
    value, DD, _, _, _, _, _, _, _, _, _, _, _ = pivot(
        (state[0], state[1], state[2], state[3], state[4], state[5]), h, p
    )
    return (value, DD + abs(DD - value))
