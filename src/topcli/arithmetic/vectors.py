"""Linear systems in three unknowns, and vectors of six components such as omega and gamma."""

from __future__ import annotations

from topcli.arithmetic.rotations import Vector

Matrix = tuple[float, float, float, float, float, float, float, float, float]


def solve3(m: Matrix, r1: float, r2: float, r3: float) -> Vector:
    """Solve m x = r for x by Cramer's rule; ``m`` in row-major order."""
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


Floats = tuple[float, ...]
Floats6 = tuple[float, float, float, float, float, float]


def add(v: Floats, w: Floats) -> Floats6:
    """Return v + w."""
    return (v[0] + w[0], v[1] + w[1], v[2] + w[2], v[3] + w[3], v[4] + w[4], v[5] + w[5])


def subtract(v: Floats, w: Floats) -> Floats6:
    """Return v - w."""
    return (v[0] - w[0], v[1] - w[1], v[2] - w[2], v[3] - w[3], v[4] - w[4], v[5] - w[5])


def scaled(s: float, v: Floats) -> Floats6:
    """Return s v."""
    return (s * v[0], s * v[1], s * v[2], s * v[3], s * v[4], s * v[5])


def axpy(v: Floats, s: float, w: Floats) -> Floats6:
    """Return v + s w."""
    return (v[0] + s * w[0], v[1] + s * w[1], v[2] + s * w[2], v[3] + s * w[3], v[4] + s * w[4], v[5] + s * w[5])


def dot(v: Floats, w: Floats) -> float:
    """Scalar product of two vectors."""
    return (v[0] * w[0] + (v[1] * w[1] + v[2] * w[2])) + (v[3] * w[3] + (v[4] * w[4] + v[5] * w[5]))


def norm1(v: Floats) -> float:
    """Sum of the magnitudes of the components."""
    return ((abs(v[0]) + abs(v[1])) + abs(v[2])) + ((abs(v[3]) + abs(v[4])) + abs(v[5]))
