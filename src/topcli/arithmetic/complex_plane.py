"""Complex arithmetic on pairs of floats: rotation by a small angle, square root on a chosen branch."""

from __future__ import annotations

import math

from topcli.arithmetic.fused import fma
from topcli.arithmetic.rotations import sinc_cosc

Complex = tuple[float, float]
NEVER_ZERO = 1e-290
"""Avoids 0/0 in the square root of 0; far below the last bit of any other denominator that occurs there."""


def rotation_increment(chi: float, x: float, y: float) -> Complex:
    """Increment (e^{-i chi} - 1)(x + i y) of a complex number rotated by the angle -chi.

    The rounding error of the increment is proportional to chi, so the modulus is preserved without bias.
    """
    t = chi * chi
    sinc, cosc = sinc_cosc(t)
    return (fma(sinc, chi * y, -(cosc * (t * x))), -fma(sinc, chi * x, cosc * (t * y)))


def rotation_coefficients(chi: float) -> tuple[float, float, float, float]:
    """Return S = sin(chi), K = 1 - cos(chi), and their corrections.

    The rounded pair misses S² + (1 - K)² = 1 by some ulp of chi². Where the angle hardly changes from step to step, so
    does this defect, and lengths drift. The corrections, far below the last bits of S and K, scale it to zero.
    """
    t = chi * chi
    sinc, cosc = sinc_cosc(t)
    s, k = sinc * chi, cosc * t
    ss = s * s
    half = 0.5 * (fma(k, k, fma(-2.0, k, ss)) + fma(s, s, -ss))
    return s, k, -half * s, fma(-half, k, half)


def turned_increment(s: float, k: float, s_low: float, k_low: float, x: float, y: float) -> Complex:
    """``rotation_increment`` from ``rotation_coefficients``; a repeated rotation keeps the modulus without bias."""
    return (
        fma(s, y, -fma(k, x, fma(k_low, x, -(s_low * y)))),
        -fma(s, x, fma(k, y, fma(k_low, y, s_low * x))),
    )


def turned(s: float, k: float, x: float, y: float) -> Complex:
    """Rotated number, from S and K alone, some twenty cycles before the correction is known."""
    return (x + fma(s, y, -(k * x)), y - fma(s, x, k * y))


def add_rotation_increment(chi: float, x: float, y: float, a: float, b: float) -> Complex:
    """Return a + i b + ``rotation_increment``, for an a + i b known long before chi: two operations after the sine."""
    t = chi * chi
    sinc, cosc = sinc_cosc(t)
    return (fma(sinc, chi * y, fma(-cosc, t * x, a)), fma(-sinc, chi * x, fma(-cosc, t * y, b)))


def root_nearest(x: float, y: float, p1: float, p2: float) -> Complex:
    """Square root of 2 (x + i y) nearest to p1 + i p2.

    The argument is half of the radicand because the root follows from m = |x + i y| + |x|: one of the two roots is
    (m + i y)/sqrt(m) for x >= 0 and (y + i m)/sqrt(m) for x < 0, without cancellation and without an angle. The
    division y/m and the choice of the sign do not depend on sqrt(m). The root of 0 is 0. Beyond |x + i y| = 1e154 the
    result is inf or nan.
    """
    m = math.sqrt(x * x + y * y) + abs(x)
    ratio = y / (m + NEVER_ZERO)
    t = math.sqrt(m)
    if x >= 0.0:
        if fma(m, p1, y * p2) < 0.0:
            t = -t
        return (t, ratio * t)
    if fma(m, p2, y * p1) < 0.0:
        t = -t
    return (ratio * t, t)


def root_sign(x: float, y: float, p1: float, p2: float) -> Complex:
    """Square root of 2 (x + i y) whose argument has the same sign as that of p1 + i p2 (Sogo, section 3.2.2).

    The arguments are those of atan2, in (-pi, pi], and zero counts as positive. If the root crosses the real axis
    between prediction and result, this rule selects the wrong root; ``root_nearest`` does not.
    """
    w1, w2 = root_nearest(x, y, 1.0, 0.0)
    if (math.atan2(w2, w1) >= 0.0) != (math.atan2(p2, p1) >= 0.0):
        return (-w1, -w2)
    return (w1, w2)
