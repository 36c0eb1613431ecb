"""Independent forms of the Lagrange top: conversion between its two frames, nutation of the maps in closed form."""

from __future__ import annotations

import math
from collections.abc import Sequence
from decimal import Decimal, localcontext

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.elliptic import DIGITS, Oscillation, oscillation
from topcli.contracts import Array
from topcli.tops.lagrange import Lagrange


def units(top: Lagrange) -> tuple[float, float]:
    """Units ``(momentum, time)`` of the inertial form of ``top``.

    From m' = mu p x a, a' = m x a/A: momentum = sqrt(A mu), time = sqrt(A/mu). The step of the inertial form is then
    h/time and its energy (E - C omega3²/2)/mu + (C omega3)²/(2 A mu). Raises ValueError unless mu > 0.
    """
    if not top.mu > 0.0:
        raise ValueError(f"lagrange: the inertial form needs mu > 0, not {top.mu!r}")
    return math.sqrt(top.A * top.mu), math.sqrt(top.A / top.mu)


def _rotate(x: Array, y: Array, cosine: Array, sine: Array) -> tuple[Array, Array]:
    return cosine * x - sine * y, sine * x + cosine * y


def _direction(x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Length of (x, y), and cosine and sine of its direction; (1, 0) if the length is 0."""
    length = np.hypot(x, y)
    safe = np.where(length > 0.0, length, 1.0)
    return length, np.where(length > 0.0, x / safe, 1.0), y / safe


def to_inertial(top: Lagrange, states: Array, precession: Array) -> tuple[Array, Array]:
    """Convert body-frame ``states`` (n, 6) of ``top`` to the inertial form; return its states (n, 6) and the spin (n,).

    The attitude in Euler angles is R = R_z(precession) R_x(theta) R_z(spin). (omega, gamma) determine theta and the
    spin but not the precession, shape (n,), which is therefore an argument; the spin is returned so that ``to_body``
    can invert the conversion. If the axis is vertical, only the combination of the two angles is defined; it is
    returned as the spin. Raises ValueError unless mu > 0.
    """
    momentum, _ = units(top)
    sine, cos_spin, sin_spin = _direction(states[:, 4], states[:, 3])
    cosine = states[:, 5]
    x, y = _rotate(top.A * states[:, 0], top.A * states[:, 1], cos_spin, sin_spin)
    z = top.C * states[:, 2]
    y, z = _rotate(y, z, cosine, sine)
    x, y = _rotate(x, y, np.cos(precession), np.sin(precession))
    a = (sine * np.sin(precession), -sine * np.cos(precession), cosine)
    spin = np.where(sine > 0.0, np.arctan2(sin_spin, cos_spin), np.copysign(1.0, cosine) * precession)
    return np.column_stack([x / momentum, y / momentum, z / momentum, *a]), spin


def to_body(top: Lagrange, states: Array, spin: Array) -> tuple[Array, Array]:
    """Convert inertial ``states`` (n, 6) to the body frame of ``top``; return states (n, 6) and precession (n,).

    Inverse of ``to_inertial``: (m, a) determine theta and the precession; the spin, shape (n,), is an argument. If the
    axis is vertical, the precession is taken as 0. m·a must be C omega3/sqrt(A mu) of ``top``, because it determines
    omega3. Raises ValueError unless mu > 0.
    """
    momentum, _ = units(top)
    sine, cos_precession, sin_precession = _direction(-states[:, 4], states[:, 3])
    cosine = states[:, 5]
    x, y = _rotate(states[:, 0], states[:, 1], cos_precession, -sin_precession)
    y, z = _rotate(y, states[:, 2], cosine, -sine)
    x, y = _rotate(x, y, np.cos(spin), -np.sin(spin))
    omega = (momentum * x / top.A, momentum * y / top.A, momentum * z / top.C)
    gamma = (sine * np.sin(spin), sine * np.cos(spin), cosine)
    return np.column_stack([*omega, *gamma]), np.arctan2(sin_precession, cos_precession)


def _dot(x: Sequence[Decimal], y: Sequence[Decimal]) -> Decimal:
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


def nutation_bs(y0: Sequence[float], h: float, n: NDArray[np.int64]) -> Array:
    """Nutation a.p of the BS map (Sogo, L1, L2) after n steps (m,) from (m, a) = ``y0`` (6,), in closed form.

    With D = (a x m).p and the modified energy E of the map, Y = D + h (N - u²)/2 satisfies
    Y² = 2 (E - u)(N - u²) - S² - N P² + 2 S P u + h² (N - u²)²/4, and a step is a translation on that elliptic curve.
    Raises ValueError if the motion is not periodic.
    """
    with localcontext() as context:
        context.prec = DIGITS
        m, a, H = [Decimal(float(v)) for v in y0[:3]], [Decimal(float(v)) for v in y0[3:]], Decimal(h)
        P, S, N, u = m[2], _dot(m, a), _dot(a, a), a[2]
        D = a[0] * m[1] - a[1] * m[0]
        E = _dot(m, m) / 2 + u + H * D / 2
        k = H * H / 4
        q = [k, Decimal(2), -2 * E - 2 * k * N, 2 * S * P - 2 * N, 2 * E * N - S * S - N * P * P + k * N * N]
        moved = oscillation(q, u, H * (D + H * (N - u * u) / 2) <= 0, -N.sqrt(), None)
    return _sampled(moved, n)


def nutation_hk(top: Lagrange, y0: Sequence[float], h: float, n: NDArray[np.int64]) -> Array:
    """Nutation gamma3 of the HK map after n steps (m,) from (omega, gamma) = ``y0`` (6,), in closed form.

    With u, v, r (scaled |omega|², omega.gamma and |gamma|² of the horizontal parts) quadratic polynomials c, b, a of
    z = (h/2)² nu gamma3 (Kimura, Hirota 2000), (h/2)³ nu (omega2 gamma1 - omega1 gamma2) is a root of c a - b², and a
    step is a translation on that elliptic curve. Raises ValueError for mu = 0 and if the motion is not periodic.
    """
    if top.mu == 0.0:
        raise ValueError("nutation_hk: mu = 0 is the free top, whose nutation under HK is not elliptic")
    with localcontext() as context:
        context.prec = DIGITS
        w1, w2, s, g1, g2, g3 = (Decimal(float(v)) for v in y0)
        A, C, d = Decimal(top.A), Decimal(top.C), Decimal(h) / 2
        K, S, f = d * (A - C) / A * s, d * s, d * d * Decimal(top.mu) / A
        u, v, r = d * d * (w1 * w1 + w2 * w2), d * f * (w1 * g1 + w2 * g2), f * f * (g1 * g1 + g2 * g2)
        z, T, KK = f * g3, 1 + K * S, 1 + K * K
        y = z + K * S - 1
        J = (v + K * u + K + S) / y
        R = y * r + 2 * v * (K * z + S * KK) + u * ((K * K - 1) * z + KK * T) + (z + T) * (y * y + (K + S) ** 2)
        c2 = y * (1 + u + J * J) / R
        c1, b1, b2, a2 = 2 * T * c2, J - 2 * K * T * c2, -K * c2, KK * c2
        a1 = 2 + 2 * T * (1 - K * K) * c2 - 2 * K * b1
        c0, b0, a0 = u - c1 * z - c2 * z * z, v - b1 * z - b2 * z * z, r - a1 * z - a2 * z * z
        q = [
            c2 * a2 - b2 * b2,
            c2 * a1 + c1 * a2 - 2 * b2 * b1,
            c2 * a0 + c1 * a1 + c0 * a2 - 2 * b2 * b0 - b1 * b1,
            c1 * a0 + c0 * a1 - 2 * b1 * b0,
            c0 * a0 - b0 * b0,
        ]
        if not a2 < 0:
            raise ValueError(f"nutation_hk: the step h = {h!r} is too large for this motion")
        # as a polynomial in gamma3; where gamma1² + gamma2² vanishes, Q = -b² <= 0
        q = [c * f ** (2 - i) for i, c in enumerate(q)]
        width = (a1 * a1 - 4 * a2 * a0).sqrt()
        low = min((-a1 - width) / (2 * a2 * f), (-a1 + width) / (2 * a2 * f))
        moved = oscillation(q, g3, (w2 * g1 - w1 * g2) * d >= 0, low, None)
    return _sampled(moved, n)


def _sampled(moved: Oscillation, n: NDArray[np.int64]) -> Array:
    rise, fall, *_ = moved.at(moved.phases(n))
    return np.where(rise < fall, float(moved.lower) + rise, float(moved.upper) - fall)
