"""The straightforward forms of the kernels and the steps, written from the paper's lines and not for speed.

``dEulerPoisson``, ``hk_general`` and ``hk_block`` use nothing but + - * / and run on floats, Fractions and
``Exact``; ``hk_block``, ``hybrid_polar`` and ``hybrid_cmath`` are also the baselines of ``benchmarks/steps.py``,
and therefore scalar and flat.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any

Vector = Sequence[Any]


class Exact:
    """A rational number that takes floats for what they are, so that a kernel runs in exact arithmetic."""

    __slots__ = ("value",)

    def __init__(self, value: Any) -> None:
        self.value = value.value if isinstance(value, Exact) else Fraction(value)

    def __add__(self, other: Any) -> Exact:
        return Exact(self.value + Exact(other).value)

    def __sub__(self, other: Any) -> Exact:
        return Exact(self.value - Exact(other).value)

    def __rsub__(self, other: Any) -> Exact:
        return Exact(Exact(other).value - self.value)

    def __mul__(self, other: Any) -> Exact:
        return Exact(self.value * Exact(other).value)

    def __truediv__(self, other: Any) -> Exact:
        return Exact(self.value / Exact(other).value)

    def __rtruediv__(self, other: Any) -> Exact:
        return Exact(Exact(other).value / self.value)

    def __pow__(self, n: int) -> Exact:
        return Exact(self.value**n)

    def __neg__(self) -> Exact:
        return Exact(-self.value)

    __radd__ = __add__
    __rmul__ = __mul__


def exactly(function: Callable[..., Any], *arguments: Any) -> list[Fraction]:
    """The values of a kernel of + - * / in exact arithmetic; tuples among the arguments are taken item by item."""
    made = [tuple(map(Exact, a)) if isinstance(a, (tuple, list)) else Exact(a) for a in arguments]
    return [Exact(x).value for x in function(*made)]


def solve(matrix: Sequence[Vector], right: Vector) -> list[Any]:
    """A general linear system by Gauss's elimination with pivoting."""
    n = len(right)
    rows = [[*row, b] for row, b in zip(matrix, right, strict=True)]
    for i in range(n):
        pivot = max(range(i, n), key=lambda r: abs(rows[r][i]))
        rows[i], rows[pivot] = rows[pivot], rows[i]
        for r in range(i + 1, n):
            factor = rows[r][i] / rows[i][i]
            rows[r] = [a - factor * b for a, b in zip(rows[r], rows[i], strict=True)]
    x = [rows[0][0] * 0] * n
    for i in reversed(range(n)):
        x[i] = (rows[i][n] - sum(rows[i][j] * x[j] for j in range(i + 1, n))) / rows[i][i]
    return x


def d_euler_poisson(old: Vector, new: Vector, h: Any, c: Any, *, misprinted: bool = False) -> list[Any]:
    """Left minus right side of the paper's dEulerPoisson with A = B = 2, C = 1, mg(x0, y0, z0) = (c, 0, 0)."""
    w1, w2, w3, g1, g2, g3 = old
    W1, W2, W3, G1, G2, G3 = new
    last = g1 * W2 if misprinted else g2 * W1
    return [
        W1 - w1 - h / 4 * (W2 * w3 + w2 * W3),
        W2 - w2 + h / 4 * (W3 * w1 + w3 * W1) - h * c / 4 * (G3 + g3),
        W3 - w3 + h * c / 2 * (G2 + g2),
        G1 - g1 - h / 2 * (G2 * w3 + g2 * W3 - G3 * w2 - g3 * W2),
        G2 - g2 - h / 2 * (G3 * w1 + g3 * W1 - G1 * w3 - g1 * W3),
        G3 - g3 - h / 2 * (G1 * w2 + g1 * W2 - G2 * w1 - last),
    ]


def hk_general(state: Vector, h: Any, p: Vector) -> list[Any]:
    """The HK step by a general solver of the 6x6 system, which is read off ``d_euler_poisson`` column by column."""
    zero = state[0] * 0
    constant = d_euler_poisson(state, [zero] * 6, h, p[0])
    columns = []
    for i in range(6):
        unit = [zero + (1 if j == i else 0) for j in range(6)]
        columns.append([a - b for a, b in zip(d_euler_poisson(state, unit, h, p[0]), constant, strict=True)])
    return solve(list(zip(*columns, strict=True)), [-b for b in constant])


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


def polar_root_sign(re, im, p1, p2):
    """The paper's root with the paper's rule: flipped when the signs of the two arguments differ."""
    r, phi = math.sqrt(math.hypot(re, im)), 0.5 * math.atan2(im, re)
    x, y = r * math.cos(phi), r * math.sin(phi)
    if (math.atan2(y, x) >= 0.0) != (math.atan2(p2, p1) >= 0.0):
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


def rotation_matrix(t1: float, t2: float, t3: float) -> list[list[float]]:
    """The paper's R(theta) of Method C; the axis does not exist at theta = 0."""
    theta = math.sqrt(t1 * t1 + t2 * t2 + t3 * t3)
    n1, n2, n3 = t1 / theta, t2 / theta, t3 / theta
    c, s = math.cos(theta), math.sin(theta)
    return [
        [n1 * n1 + (1 - n1 * n1) * c, n1 * n2 * (1 - c) + n3 * s, n1 * n3 * (1 - c) - n2 * s],
        [n2 * n1 * (1 - c) - n3 * s, n2 * n2 + (1 - n2 * n2) * c, n2 * n3 * (1 - c) + n1 * s],
        [n3 * n1 * (1 - c) + n2 * s, n3 * n2 * (1 - c) - n1 * s, n3 * n3 + (1 - n3 * n3) * c],
    ]


def gamma_a(state: Vector, h: float) -> tuple[float, ...]:
    """Method A by the inverse matrix."""
    d = 0.5 * h
    return cayley_matrix(d * state[0], d * state[1], d * state[2], *state[3:])


def gamma_b(state: Vector, h: float) -> tuple[float, ...]:
    """Method B on the paper's chart, with complex numbers."""
    w1, w2, w3, g1, g2, g3 = state
    omega, z = complex(w1, w2), complex(g1, g2) / (1 + g3)
    z = z + h * 0.5j * (omega - 2 * w3 * z - omega.conjugate() * z * z)
    size = abs(z) ** 2
    return (2 * z.real / (1 + size), 2 * z.imag / (1 + size), (1 - size) / (1 + size))


def gamma_c(state: Vector, h: float) -> tuple[float, ...]:
    """Method C by the paper's matrix."""
    rows = rotation_matrix(h * state[0], h * state[1], h * state[2])
    return tuple(sum(r * g for r, g in zip(row, state[3:], strict=True)) for row in rows)


def bohlin_plain(state: Vector, h: float, p: Vector, gamma: Callable[..., Any], root: Callable[..., Any]) -> Any:
    """Bohlin's method in the paper's three steps, with the prediction (direct) in complex numbers."""
    w1, w2, w3, _, g2, g3 = state
    c = p[0]
    n1, n2, n3 = gamma(state, h)
    v3 = w3 - h / 2 * c * (n2 + g2)
    predicted = complex(w1, w2) - 0.5j * h * (w3 * complex(w1, w2) - c * g3)
    re, im = bohlin_square(state, n1, n2, v3, h, c)
    x, y = root(re, im, predicted.real, predicted.imag)
    return (x, y, v3, n1, n2, n3)
