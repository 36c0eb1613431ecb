"""The complex plane of Kowalevski's xi: the turn by a small angle, and the square root on a chosen branch."""

from __future__ import annotations

import math

from topcli.kernels.so3 import cosc_of_square, sinc_of_square

Complex = tuple[float, float]

NEVER_ZERO = 1e-290
"""Keeps 0/0 out of the root of 0; far below the last bit of any other denominator met there."""


def turn_increment(chi: float, x: float, y: float) -> Complex:
    """(e^{-i chi} - 1)(x + i y): the change of a complex number turned back by the angle chi.

    As an increment its error shrinks with chi, so the modulus is kept without bias.
    """
    t = chi * chi
    s = chi * sinc_of_square(t)
    k = t * cosc_of_square(t)
    return (s * y - k * x, -(s * x + k * y))


def root_nearest(x: float, y: float, p1: float, p2: float) -> Complex:
    """The square root of x + i y that lies nearest to p1 + i p2.

    With m = (|z| + |x|)/2 one of the two roots is (m + i y/2)/sqrt(m) for x >= 0 and (y/2 + i m)/sqrt(m)
    for x < 0: no cancellation and no angle. The division y/(2 m) and the choice of the sign do not wait for
    sqrt(m). The root of 0 is 0. Beyond |z| = 1e154 the result is inf or nan.
    """
    m = 0.5 * (math.sqrt(x * x + y * y) + abs(x))
    b = 0.5 * y
    ratio = b / (m + NEVER_ZERO)
    t = math.sqrt(m)
    if x >= 0.0:
        if m * p1 + b * p2 < 0.0:
            t = -t
        return (t, ratio * t)
    if b * p1 + m * p2 < 0.0:
        t = -t
    return (ratio * t, t)


def root_sign(x: float, y: float, p1: float, p2: float) -> Complex:
    """The square root of x + i y whose argument has the sign of the argument of p1 + i p2 (Sogo, section 3.2.2).

    The signs are those of atan2, in (-pi, pi], with zero counted as plus. Where the root crosses the real
    axis between prediction and result this rule takes the wrong root; ``root_nearest`` does not.
    """
    w1, w2 = root_nearest(x, y, 1.0, 0.0)
    if (math.atan2(w2, w1) >= 0.0) != (math.atan2(p2, p1) >= 0.0):
        return (-w1, -w2)
    return (w1, w2)
