"""Vectors of three and six components: rotations by small angles as increments, linear systems, complex numbers.

The rotations integrate Poisson's equation, dgamma/dt = gamma x omega, so a positive angle rotates *against* the
rotation vector. The functions return the **change** of the vector instead of the rotated vector. The change is
proportional to the angle, and so are its rounding errors; the one remaining addition ``gamma + change`` rounds without
bias. The error of |gamma| is then a random walk, whereas the product of matrix and vector drifts. Complex numbers are
pairs of floats.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from topcli.arithmetic.fused import fma, follow_precision, unlikely

_Pair = tuple[float, float]
Vector = tuple[float, float, float]
SMALL_ANGLE_SQ = 0.6168502750680849
"""(pi/4)**2; up to this limit the polynomials below are accurate to about the last bit."""


def cross(x1: float, x2: float, x3: float, a1: float, a2: float, a3: float) -> Vector:
    """Vector product x x a."""
    return (fma(x2, a3, -(x3 * a2)), fma(x3, a1, -(x1 * a3)), fma(x1, a2, -(x2 * a1)))


def cayley_quotient(a1: float, a2: float, a3: float, g1: float, g2: float, g3: float) -> tuple[float, Vector]:
    """Factor and vector whose product is ``cayley_increment``."""
    b1, b2, b3 = cross(g1, g2, g3, a1, a2, a3)
    c1, c2, c3 = cross(b1, b2, b3, a1, a2, a3)
    return 2.0 / (fma(a1, a1, 1.0) + fma(a2, a2, a3 * a3)), (b1 + c1, b2 + c2, b3 + c3)


def cayley_increment(a1: float, a2: float, a3: float, g1: float, g2: float, g3: float) -> Vector:
    """Solve d = (2 g + d) x a for d: one BS step g' - g = (g' + g) x a (Sogo, Method A).

    ``a`` is h/2 omega for the BS scheme and h/4 (omega' + omega) for the modified one. Because a is normal to
    b = g x a, the closed form is d = 2 (b + b x a) / (1 + a.a).
    """
    r, (x1, x2, x3) = cayley_quotient(a1, a2, a3, g1, g2, g3)
    return (r * x1, r * x2, r * x3)


def cayley_rotated(a1: float, a2: float, a3: float, g1: float, g2: float, g3: float) -> Vector:
    """Rotated vector g + ``cayley_increment``, rounded once per component."""
    r, (x1, x2, x3) = cayley_quotient(a1, a2, a3, g1, g2, g3)
    return (fma(r, x1, g1), fma(r, x2, g2), fma(r, x3, g3))


def sinc_cosc_polynomials(t: float) -> _Pair:
    """``sinc_cosc`` for t up to SMALL_ANGLE_SQ, by the polynomials of fdlibm; exactly 1 and 1/2 at 0.

    The evaluation order makes the dependency chain four operations long; the last two operations of each result round
    at the size of the result.
    """
    u = t * t
    low = fma(t, 8.33333333332248946124e-03, -1.66666666666666324348e-01)
    mid = fma(t, 2.75573137070700676789e-06, -1.98412698298579493134e-04)
    high = fma(t, 1.58969099521155010221e-10, -2.50507602534068634195e-08)
    sinc = fma(t * u, fma(u, high, mid), fma(t, low, 1.0))
    low = fma(t, 1.38888888888741095749e-03, -4.16666666666666019037e-02)
    mid = fma(t, 2.75573143513906633035e-07, -2.48015872894767294178e-05)
    high = fma(t, 1.13596475577881948265e-11, -2.08757232129817482790e-09)
    return sinc, fma(t * u, fma(u, high, mid), fma(t, low, 0.5))


def sinc_cosc(t: float) -> _Pair:
    """Return sin(x)/x and (1 - cos(x))/x**2 as functions of t = x*x >= 0: polynomials for small t, else libm."""
    if unlikely(not t <= SMALL_ANGLE_SQ):
        x = math.sqrt(t)
        half = math.sin(0.5 * x)
        return math.sin(x) / x, 2.0 * half * half / t
    return sinc_cosc_polynomials(t)


def sinc_cosc_small(t: float) -> _Pair:
    """``sinc_cosc`` for t up to SMALL_ANGLE_SQ, nan beyond."""
    sinc, cosc = sinc_cosc_polynomials(t)
    return (sinc, cosc) if t <= SMALL_ANGLE_SQ else (math.nan, math.nan)


VECTOR_VARIANTS: dict[Callable[..., Any], Callable[..., Any]] = {sinc_cosc: sinc_cosc_small}
"""Replacements for functions in vectorised code, where several trajectories share a vector and a call of libm behind a
branch would be made for each of them at every step. A nan in the result means that the trajectory needs a scalar step.
"""


def rodrigues_increment(a1: float, a2: float, a3: float, g1: float, g2: float, g3: float) -> Vector:
    """Increment R(a) g - g of the rotation by the angle |a| about a (Sogo, Method C); exactly zero at a = 0.

    R(a) g - g = S b + K (b x a) with b = g x a, S = sin|a|/|a| and K = (1 - cos|a|)/|a|**2. The axis a/|a|, undefined
    at a = 0, is not needed.
    """
    sinc, cosc = sinc_cosc(a1 * a1 + fma(a2, a2, a3 * a3))
    b1, b2, b3 = cross(g1, g2, g3, a1, a2, a3)
    c1, c2, c3 = cross(b1, b2, b3, a1, a2, a3)
    return (sinc * b1 + cosc * c1, sinc * b2 + cosc * c2, sinc * b3 + cosc * c3)


def orthogonal_rodrigues_increment(a1: float, a2: float, a3: float, g1: float, g2: float, g3: float) -> Vector:
    """``rodrigues_increment`` without the defect of the rounded coefficients S and K, for angles that hardly change.

    The length of the part of g normal to a changes in proportion to S**2 - 2 K + |a|**2 K**2, which is zero but for
    rounding; corrections of S and K scale it back.
    """
    t = a1 * a1 + fma(a2, a2, a3 * a3)
    sinc, cosc = sinc_cosc(t)
    u, ss = t * cosc, sinc * sinc
    half = 0.5 * (fma(cosc, u, fma(-2.0, cosc, ss)) + fma(sinc, sinc, -ss))
    b_low, c_low = -half * (t * sinc), fma(-half, u, half)
    b1, b2, b3 = cross(g1, g2, g3, a1, a2, a3)
    c1, c2, c3 = cross(b1, b2, b3, a1, a2, a3)
    return (
        fma(sinc, b1, fma(cosc, c1, fma(c_low, c1, b_low * b1))),
        fma(sinc, b2, fma(cosc, c2, fma(c_low, c2, b_low * b2))),
        fma(sinc, b3, fma(cosc, c3, fma(c_low, c3, b_low * b3))),
    )


def resolvent(a1: float, a2: float, a3: float, b1: float, b2: float, b3: float) -> Vector:
    """Solve z - z x a = b for z: z = (b + b x a + (a.b) a) / (1 + a.a)."""
    r = 1.0 / ((1.0 + a1 * a1) + (a2 * a2 + a3 * a3))
    k = a1 * b1 + a2 * b2 + a3 * b3
    return (
        r * (b1 + (b2 * a3 - b3 * a2) + k * a1),
        r * (b2 + (b3 * a1 - b1 * a3) + k * a2),
        r * (b3 + (b1 * a2 - b2 * a1) + k * a3),
    )


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


Complex = tuple[float, float]
NEVER_ZERO = 1e-290
"""Avoids 0/0 in the square root of 0; far below the last bit of any other denominator that occurs there."""
follow_precision(__name__, NEVER_ZERO=20, SMALL_ANGLE_SQ=20)


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
