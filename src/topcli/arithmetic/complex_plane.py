"""The complex plane of Kowalevski's xi: the turn by a small angle, and the square root on a chosen branch."""

from __future__ import annotations

import math

from topcli.arithmetic.fused import fma
from topcli.arithmetic.rotations import sinc_cosc

Complex = tuple[float, float]
NEVER_ZERO = 1e-290
"""Keeps 0/0 out of the root of 0; far below the last bit of any other denominator met there."""


def turn_increment(chi: float, x: float, y: float) -> Complex:
    """(e^{-i chi} - 1)(x + i y): the change of a complex number turned back by the angle chi.

    As an increment its error shrinks with chi, so the modulus is kept without bias.
    """
    t = chi * chi
    sinc, cosc = sinc_cosc(t)
    return (fma(sinc, chi * y, -(cosc * (t * x))), -fma(sinc, chi * x, cosc * (t * y)))


def turn_added(chi: float, x: float, y: float, a: float, b: float) -> Complex:
    """a + i b + ``turn_increment``, for an a + i b that is known long before chi: two operations after the sine."""
    t = chi * chi
    sinc, cosc = sinc_cosc(t)
    return (fma(sinc, chi * y, fma(-cosc, t * x, a)), fma(-sinc, chi * x, fma(-cosc, t * y, b)))


def root_nearest(x: float, y: float, p1: float, p2: float) -> Complex:
    """The square root of 2 (x + i y) that lies nearest to p1 + i p2.

    Half of the number goes in because m = |x + i y| + |x| is what its root is made of: one of the two is
    (m + i y)/sqrt(m) for x >= 0 and (y + i m)/sqrt(m) for x < 0, with no cancellation and no angle. The division y/m
    and the choice of the sign do not wait for sqrt(m). The root of 0 is 0. Beyond |x + i y| = 1e154 the result is inf
    or nan.
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
    """The square root of 2 (x + i y) whose argument has the sign of the argument of p1 + i p2 (Sogo, section 3.2.2).

    The signs are those of atan2, in (-pi, pi], with zero counted as plus. Where the root crosses the real
    axis between prediction and result this rule takes the wrong root; ``root_nearest`` does not.
    """
    w1, w2 = root_nearest(x, y, 1.0, 0.0)
    if (math.atan2(w2, w1) >= 0.0) != (math.atan2(p2, p1) >= 0.0):
        return (-w1, -w2)
    return (w1, w2)
