"""Unit quaternions (w, x, y, z), scalar part first; composed rotations keep unit length.

A quaternion q rotates the vector v to q v q*. Rotations near the identity are given as *turns*: the quaternion minus
one, (w - 1, x, y, z), whose small parts keep all their digits. ``turned_by`` adds the change to q and restores its
length, which therefore stays one to round-off, however many turns follow each other.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.floating[Any]]
Quaternion = tuple[float, float, float, float]
_Vector = tuple[float, float, float]
IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)


def product(p: Quaternion, q: Quaternion) -> Quaternion:
    """Hamilton product p q: first the rotation q, then p."""
    a, b, c, d = p
    w, x, y, z = q
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )


def conjugate(q: Quaternion) -> Quaternion:
    """Inverse rotation of a unit quaternion."""
    return (q[0], -q[1], -q[2], -q[3])


def rotate(q: Quaternion, v: _Vector) -> _Vector:
    """Rotated vector q v q*, as v plus its change."""
    w, x, y, z = q
    a = 2.0 * (y * v[2] - z * v[1])
    b = 2.0 * (z * v[0] - x * v[2])
    c = 2.0 * (x * v[1] - y * v[0])
    return (v[0] + (w * a + (y * c - z * b)), v[1] + (w * b + (z * a - x * c)), v[2] + (w * c + (x * b - y * a)))


def unit_turn(a: float, b: float, c: float) -> Quaternion:
    """Turn about (a, b, c) by the angle 2 arctan |(a, b, c)|, the Cayley transform: (1, a, b, c)/|(1, a, b, c)| - 1."""
    s = a * a + b * b + c * c
    length = math.sqrt(1.0 + s)
    return (-s / (length * (1.0 + length)), a / length, b / length, c / length)


def turn_upright(u: _Vector) -> Quaternion:
    """Shortest turn that carries the unit vector ``u`` to (0, 0, 1); half a turn if ``u`` is (0, 0, -1)."""
    if u[2] <= -1.0 + 1e-15:
        return (-1.0, 1.0, 0.0, 0.0)
    return unit_turn(u[1] / (1.0 + u[2]), -u[0] / (1.0 + u[2]), 0.0)


def upright(v: _Vector) -> Quaternion:
    """Shortest rotation that carries the direction of ``v`` to (0, 0, 1); the identity if ``v`` is zero."""
    size = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    if not size > 0.0:
        return IDENTITY
    t = turn_upright((v[0] / size, v[1] / size, v[2] / size))
    return (1.0 + t[0], t[1], t[2], t[3])


def turned_by(q: Quaternion, change: Quaternion) -> Quaternion:
    """Sum q + ``change``, scaled to unit length."""
    w, x, y, z = q[0] + change[0], q[1] + change[1], q[2] + change[2], q[3] + change[3]
    excess = 0.5 * (1.0 - (w * w + x * x + y * y + z * z))
    return (w + excess * w, x + excess * x, y + excess * y, z + excess * z)


def canonical_quaternion(q: Quaternion) -> Quaternion:
    """The one of q and -q, which are the same rotation, whose first number other than zero is positive."""
    for value in q:
        if value != 0.0:
            s = math.copysign(1.0, value)
            return (s * q[0] + 0.0, s * q[1] + 0.0, s * q[2] + 0.0, s * q[3] + 0.0)  # without negative zeros
    return q


def euler_angles(q: _Array) -> tuple[_Array, _Array, _Array]:
    """Euler's angles psi, theta, phi (m,) of unit quaternions (m, 4), in the sequence z-x-z.

    They are rotations by phi about the third axis, theta about the first, psi about the third. psi and phi are in
    (-pi, pi]; at theta = 0 and pi, where only their sum or difference is defined, phi is 0.
    """
    w, x, y, z = q.T
    theta = 2.0 * np.arctan2(np.hypot(x, y), np.hypot(w, z))
    half_sum, half_difference = np.arctan2(z, w), np.arctan2(y, x)
    flat, over = np.hypot(x, y) == 0.0, np.hypot(w, z) == 0.0
    psi = np.where(flat, 2.0 * half_sum, np.where(over, 2.0 * half_difference, half_sum + half_difference))
    phi = np.where(flat | over, 0.0, half_sum - half_difference)
    return _wrapped(psi), theta, _wrapped(phi)


def _wrapped(angle: _Array) -> _Array:
    """Angles (m,) of up to two revolutions, in (-pi, pi]."""
    angle = np.where(angle > math.pi, angle - 2.0 * math.pi, angle)
    return np.where(angle <= -math.pi, angle + 2.0 * math.pi, angle)
