"""The HK step and the hybrid from the paper's lines, scalar and flat: baselines that the fast steps are timed with."""

from __future__ import annotations

import cmath
import math


def hk_block(state, h, p):
    """The HK step by block elimination: gamma' = P + Q omega' by Cayley's inverse, then Cramer's rule for omega'."""
    w1, w2, w3, g1, g2, g3 = state
    c = p[0]
    d = 0.5 * h
    a1, a2, a3 = d * w1, d * w2, d * w3
    n = 1.0 / (1.0 + a1 * a1 + a2 * a2 + a3 * a3)
    i11, i12, i13 = (1.0 + a1 * a1) * n, (a1 * a2 + a3) * n, (a1 * a3 - a2) * n
    i21, i22, i23 = (a1 * a2 - a3) * n, (1.0 + a2 * a2) * n, (a2 * a3 + a1) * n
    i31, i32, i33 = (a1 * a3 + a2) * n, (a2 * a3 - a1) * n, (1.0 + a3 * a3) * n
    p1 = i11 * g1 + i12 * g2 + i13 * g3
    p2 = i21 * g1 + i22 * g2 + i23 * g3
    p3 = i31 * g1 + i32 * g2 + i33 * g3
    q11, q12, q13 = d * (i12 * g3 - i13 * g2), d * (i13 * g1 - i11 * g3), d * (i11 * g2 - i12 * g1)
    q21, q22, q23 = d * (i22 * g3 - i23 * g2), d * (i23 * g1 - i21 * g3), d * (i21 * g2 - i22 * g1)
    q31, q32, q33 = d * (i32 * g3 - i33 * g2), d * (i33 * g1 - i31 * g3), d * (i31 * g2 - i32 * g1)
    f = d * c
    k = 0.5 * f
    e = 0.5 * d
    m12, m13 = -e * w3, -e * w2
    m21, m22, m23 = e * w3 - k * q31, 1.0 - k * q32, e * w1 - k * q33
    m31, m32, m33 = f * q21, f * q22, 1.0 + f * q23
    r1, r2, r3 = w1, w2 + k * (g3 + p3), w3 - f * (g2 + p2)
    c1 = m22 * m33 - m23 * m32
    c2 = m23 * m31 - m21 * m33
    c3 = m21 * m32 - m22 * m31
    det = c1 + m12 * c2 + m13 * c3
    x1 = (r1 * c1 + m12 * (m23 * r3 - r2 * m33) + m13 * (r2 * m32 - m22 * r3)) / det
    x2 = ((r2 * m33 - m23 * r3) + r1 * c2 + m13 * (m21 * r3 - r2 * m31)) / det
    x3 = ((m22 * r3 - r2 * m32) + m12 * (r2 * m31 - m21 * r3) + r1 * c3) / det
    return (
        x1,
        x2,
        x3,
        p1 + q11 * x1 + q12 * x2 + q13 * x3,
        p2 + q21 * x1 + q22 * x2 + q23 * x3,
        p3 + q31 * x1 + q32 * x2 + q33 * x3,
    )


def cayley_matrix(a1, a2, a3, g1, g2, g3):
    """The g' that solves g' - g = (g' + g) x a, by the inverse matrix."""
    n = 1.0 / (1.0 + a1 * a1 + a2 * a2 + a3 * a3)
    b1 = g1 + g2 * a3 - g3 * a2
    b2 = g2 + g3 * a1 - g1 * a3
    b3 = g3 + g1 * a2 - g2 * a1
    return (
        ((1.0 + a1 * a1) * b1 + (a1 * a2 + a3) * b2 + (a1 * a3 - a2) * b3) * n,
        ((a1 * a2 - a3) * b1 + (1.0 + a2 * a2) * b2 + (a2 * a3 + a1) * b3) * n,
        ((a1 * a3 + a2) * b1 + (a2 * a3 - a1) * b2 + (1.0 + a3 * a3) * b3) * n,
    )


def polar_root(re, im, p1, p2):
    """The paper's w = sqrt(R) e^{i Phi/2}, its sign such that it lies nearest to p1 + i p2."""
    r = math.sqrt(math.hypot(re, im))
    phi = 0.5 * math.atan2(im, re)
    x = r * math.cos(phi)
    y = r * math.sin(phi)
    if x * p1 + y * p2 < 0.0:
        return (-x, -y)
    return (x, y)


def bohlin_square(old, g1n, g2n, v3, h, c):
    """e^{-i chi} (omega² - c gamma) + c gamma', in real and imaginary part."""
    w1, w2, w3, g1, g2, _ = old
    chi = 0.5 * h * (v3 + w3)
    re = w1 * w1 - w2 * w2 - c * g1
    im = 2.0 * w1 * w2 - c * g2
    cos = math.cos(chi)
    sin = math.sin(chi)
    return cos * re + sin * im + c * g1n, cos * im - sin * re + c * g2n


def hybrid_polar(state, h, p):
    """The hybrid as the paper says it: block elimination, Cayley's matrix, then polar coordinates and libm."""
    w1, w2, w3, g1, g2, g3 = state
    v1, v2, v3, _, _, _ = hk_block(state, h, p)
    k = 0.25 * h
    n1, n2, n3 = cayley_matrix(k * (v1 + w1), k * (v2 + w2), k * (v3 + w3), g1, g2, g3)
    re, im = bohlin_square(state, n1, n2, v3, h, p[0])
    x, y = polar_root(re, im, v1, v2)
    return (x, y, v3, n1, n2, n3)


def hybrid_cmath(state, h, p):
    """The hybrid with Python's complex numbers: cmath.exp and cmath.sqrt."""
    w1, w2, w3, g1, g2, g3 = state
    v1, v2, v3, _, _, _ = hk_block(state, h, p)
    k = 0.25 * h
    n1, n2, n3 = cayley_matrix(k * (v1 + w1), k * (v2 + w2), k * (v3 + w3), g1, g2, g3)
    omega = complex(w1, w2)
    xi = omega * omega - p[0] * complex(g1, g2)
    root = cmath.sqrt(cmath.exp(complex(0.0, -0.5 * h * (v3 + w3))) * xi + p[0] * complex(n1, n2))
    if root.real * v1 + root.imag * v2 < 0.0:
        root = -root
    return (root.real, root.imag, v3, n1, n2, n3)
