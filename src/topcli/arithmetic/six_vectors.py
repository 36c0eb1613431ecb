"""Vectors of six components, such as omega and gamma or their change in a step."""

from __future__ import annotations

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
