"""Linear systems in three unknowns."""

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
