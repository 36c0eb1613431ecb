"""Closed-form motion of the Lagrange top.

Both forms reduce to the system m' = nu p x a, a' = m x a with p = e_z. The inertial form has nu = 1; the body form is
the same with m = -omega, a = gamma in a frame that rotates by alpha omega3 about the axis. With P = m.p, S = m.a,
N = a², E = m²/2 + nu u, the nutation u = a.p satisfies

    u'² = 2 (E - nu u)(N - u²) - S² - N P² + 2 S P u.

The angle of the horizontal part of a, with chi' = (N P - S u)/(N - u²), or of m, with theta' = nu (S - P u)/(2 E -
2 nu u - P²), is the integral of a periodic analytic function, whose Fourier series is summed until it converges to
round-off. Of the two angles, the one whose denominator stays further from zero is used; the other vector then follows
without a second integral. Two kinds of motion are refused: those asymptotic to the upright position, and those that are
planar to within about 1e-4 but not exactly, whose angles change by almost half a revolution in a very short time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.elliptic import Argument, phase
from topcli.arithmetic.multiprecision import Real, cubic_roots, digits, mp, real
from topcli.contracts import Array, Floats, NoOptions, Sampler, Top
from topcli.errors import RunError
from topcli.schemes.registry import closed_form

MAX_SAMPLES = 1 << 15
_NOTHING = 1e-30
"""Squares that vanish are below this, relative to the largest, because of rounding."""
CUBIC_DIGITS = 120
_REFUSED = "lagrange, scheme exact: {}; use scheme 'taylor'"


class AsymptoticError(RunError):
    """The motion tends to rest."""


class Oscillation(NamedTuple):
    """Solution of (dx/dt)² = Q(x) between two zeros of Q: x = lower + gap sn², or upper - gap sn² if it ``hangs``.

    ``gap`` is 0 if x is at rest.
    """

    lower: Real
    upper: Real
    gap: float
    argument: Argument
    hangs: bool

    @property
    def period(self) -> float:
        """Period of x in time."""
        return float(2 * self.argument.quarter / self.argument.rate) if self.gap else 1.0

    def turns(self, n: NDArray[Any], h: float) -> tuple[NDArray[np.int64], Array]:
        """Whole periods of x and the rest, in [-1/2, 1/2], after ``n`` (m,) steps of ``h``."""
        with digits():
            period = 2 * self.argument.quarter
            return phase(self.argument.start / period, self.argument.rate * real(h) / period, n)

    def at(self, turn: Array) -> tuple[Array, Array, Array, Array, Array]:
        """x - lower, upper - x, dx/dt, sn, cn at phases (m,); sn and cn up to the same sign."""
        sn, cn, dn = self.argument.at(turn)
        near, far = self.gap * sn * sn, self.gap * cn * cn
        rate = 2.0 * self.gap * float(self.argument.rate) * sn * cn * dn
        return (far, near, -rate, sn, cn) if self.hangs else (near, far, rate, sn, cn)


def oscillation(q: Sequence[Real], x0: Real, rising: bool) -> Oscillation:
    """Motion with (dx/dt)² = Q(x) from ``x0``, rising or falling, for a cubic ``q``, the highest degree first.

    Raises AsymptoticError, or RunError if the zeros cannot be resolved.
    """
    a, b, c, d = q
    tiny, size = mp.mpf(10) ** (10 - mp.dps), sum(map(abs, q)) * max(1, abs(x0)) ** 3

    def value(x: Real) -> Real:
        return ((a * x + b) * x + c) * x + d

    if abs(value(x0)) <= tiny * size and abs((3 * a * x0 + 2 * b) * x0 + c) <= tiny * size:
        return Oscillation(x0, x0, 0.0, Argument.of(mp.mpf(0), mp.mpf(0), mp.mpf(1)), False)
    # turning points are roots of the cubic, or of the quadratic that is left without gravity
    if a:
        g2, g3 = (b * b / 3 - a * c) / 4, (a * b * c / 3 - 2 * b**3 / 27 - a * a * d) / 16
        roots = sorted((4 * e.real - b / 3) / a for e in cubic_roots(g2, g3, True))
        far, (low, high) = (roots[2], roots[:2]) if a > 0 else (roots[0], roots[1:])
        length = abs(far - (low if a > 0 else high))
        m1, rate = abs(far - (high if a > 0 else low)) / length, mp.sqrt(abs(a) * length) / 2
    else:
        root = mp.sqrt(c * c - 4 * b * d)
        low, high = sorted(((root - c) / (2 * b), (-root - c) / (2 * b)))
        m1, rate = mp.mpf(1), mp.sqrt(-b) / 2
    if not m1 > 1e-32:
        raise AsymptoticError(_REFUSED.format("the motion is asymptotic to rest and not periodic"))
    if max(abs(value(low)), abs(value(high))) > 1e-40 * size:
        raise RunError(_REFUSED.format("the turning points cannot be resolved, because gravity is too weak"))
    hangs, gap = bool(a < 0), high - low
    s2, c2 = (min(max(abs(x0 - x) / gap, mp.mpf(0)), mp.mpf(1)) for x in ((high, low) if hangs else (low, high)))
    with digits():
        start = mp.sqrt(s2) * mp.elliprf(c2, c2 + m1 * s2, 1)
        return Oscillation(low, high, float(gap), Argument.of(start if rising != hangs else -start, rate, m1), hangs)


def _least(squares: Sequence[Real], vanishes: bool) -> float:
    """Ratio of the smaller to the larger of two squares; zero if it is only round-off, because one ``vanishes``."""
    small, large = min(squares), max(squares)
    return float(small / large) if large > 0 and not (vanishes and small <= large * _NOTHING) else 0.0


class _Constants(NamedTuple):
    """Constants of one motion, rounded once; pairs are the values at the minimum and the maximum of u."""

    nutation: Oscillation
    nu: float
    P: float
    S: float
    lower: float
    upper: float
    down: float
    """sqrt(N) + u at the minimum."""
    up: float
    """sqrt(N) - u at the maximum."""
    momentum: float
    """Smallest square of the horizontal part of m, 2 (E - nu u) - P²."""
    axis_turn: tuple[float, float]
    """N P - S u."""
    momentum_turn: tuple[float, float]
    """S - P u."""
    axis_least: float
    momentum_least: float
    """Smallest square of the horizontal part of m, relative to the largest; ``axis_least`` is the same for a."""

    def squares(self, rise: Array, fall: Array) -> tuple[Array, Array]:
        """Squares of the horizontal parts of a and m, as sums and products of non-negative terms."""
        return (self.up + fall) * (self.down + rise), self.momentum + 2.0 * abs(self.nu) * (
            fall if self.nu > 0.0 else rise
        )

    def turns(self, rise: Array, fall: Array) -> tuple[Array, Array]:
        """N P - S u and S - P u, computed from the nearer turning point."""
        near = rise < fall
        axis = np.where(near, self.axis_turn[0] - self.S * rise, self.axis_turn[1] + self.S * fall)
        return axis, np.where(near, self.momentum_turn[0] - self.P * rise, self.momentum_turn[1] + self.P * fall)


@lru_cache(maxsize=64)
def _constants(y0: Floats, nu: float) -> _Constants:
    m, a, g = [Fraction(v) for v in y0[:3]], [Fraction(v) for v in y0[3:]], Fraction(nu)
    P, (S, N, square) = m[2], (sum(x * y for x, y in zip(*both, strict=True)) for both in ((m, a), (a, a), (m, m)))
    E = square / 2 + g * a[2]
    q = 2 * g, -2 * E, 2 * S * P - 2 * g * N, 2 * E * N - S * S - N * P * P
    upright, spins = S * S == N * P * P, 2 * g * S == P * (2 * E - P * P)
    # near an upright axis roots almost coincide, and their differences need many digits
    with digits(CUBIC_DIGITS):
        nutation = oscillation([real(v) for v in q], real(a[2]), m[0] * a[1] - m[1] * a[0] >= 0)
        ends, root = (nutation.lower, nutation.upper), mp.sqrt(real(N))
        up, down = ([max(root + sign * u, mp.mpf(0)) for u in ends] for sign in (-1, 1))
        momentum = [max(real(2 * E - P * P) - real(2 * g) * u, mp.mpf(0)) for u in ends]
        P, S, N = (real(v) for v in (P, S, N))

        def pair(x: Real, y: Real) -> tuple[float, float]:
            return float(x - y * ends[0]), float(x - y * ends[1])

        axis_least = _least([x * y for x, y in zip(up, down, strict=True)], upright)
        heights = float(ends[0]), float(ends[1]), float(down[0]), float(up[1]), float(min(momentum))
        angles = pair(N * P, S), pair(S, P), axis_least, _least(momentum, spins)
        return _Constants(nutation, nu, float(P), float(S), *heights, *angles)


class _Angle(NamedTuple):
    """Angle whose rate has the period of the nutation: mean rate, and Fourier series of the periodic part."""

    mean: float
    harmonics: NDArray[np.complex128]

    def periodic(self, turn: Array) -> Array:
        """Periodic part at the phases (m,), in periods."""
        z = np.exp(2j * math.pi * (turn + 0.5))
        total: NDArray[np.complex128] = np.zeros(len(z), dtype=np.complex128)
        for coefficient in self.harmonics[::-1]:
            total = (total + coefficient) * z
        return total.real


@lru_cache(maxsize=64)
def _angle(c: _Constants, by_axis: bool) -> _Angle:
    """Integral of the rate by the trapezoidal rule, doubling the number of samples; raise RunError at the limit."""
    samples, frequency = 32, 2.0 * math.pi / c.nutation.period
    while samples <= MAX_SAMPLES:
        rise, fall, *_ = c.nutation.at(np.linspace(-0.5, 0.5, samples, endpoint=False))
        which = 0 if by_axis else 1
        rate = (1.0 if by_axis else c.nu) * c.turns(rise, fall)[which] / c.squares(rise, fall)[which]
        series = np.fft.rfft(rate) / samples
        order = np.arange(1, samples // 2)
        harmonics = 2.0 * series[1 : samples // 2] / (1j * order * frequency)
        round_off = 1e-16 * (1.0 + float(np.abs(rate).max()) / frequency)
        if np.abs(harmonics[samples // 4 :]).max() <= round_off:
            large = np.flatnonzero(np.abs(harmonics) > 0.01 * round_off)
            return _Angle(float(series[0].real), harmonics[: large[-1] + 1 if len(large) else 0])
        samples *= 2
    why = "almost planar motion: both the axis and the angular momentum pass too close to the vertical"
    raise RunError(_REFUSED.format(why))


def _motion(y0: Floats, h: float, n: NDArray[np.int64], nu: float) -> Array:
    """Solution (m, a) of m' = nu p x a, a' = m x a from ``y0`` after n steps (m,), shape (m, 6)."""
    c = _constants(y0, nu)
    (j, turn), (j0, begin) = c.nutation.turns(n, h), c.nutation.turns(np.zeros(1), h)
    rise, fall, rate, sn, cn = c.nutation.at(turn)
    axis_sq, momentum_sq = c.squares(rise, fall)
    axis_now, momentum_now = complex(y0[3], y0[4]), complex(y0[0], y0[1])
    if c.axis_least == c.momentum_least == 0.0:
        # at rest upright, or planar motion: the horizontal parts stay on a line and change sign
        *_, sn0, cn0 = c.nutation.at(begin)
        way = 1j if c.nutation.hangs else -1j
        along = axis_now * np.sign(sn0[0]) if axis_now else momentum_now * np.sign(cn0[0]) / way
        along = np.where((j - j0) % 2, -along, along) / (abs(along) or 1.0)
        a, m = along * np.sqrt(axis_sq) * np.sign(sn), way * along * np.sqrt(momentum_sq) * np.sign(cn)
    else:
        by_axis = c.axis_least >= c.momentum_least
        now, square = (axis_now, axis_sq) if by_axis else (momentum_now, momentum_sq)
        angle = _angle(c, by_axis)
        length = np.sqrt(square)
        turned = np.exp(1j * (angle.mean * h * n + (angle.periodic(turn) - angle.periodic(begin)))) * (now / abs(now))
        # the other vector follows without a second integral
        other = turned * (c.turns(rise, fall)[1] + (-1j if by_axis else 1j) * rate) / length
        a, m = (turned * length, other) if by_axis else (other, turned * length)
    height = np.where(rise < fall, c.lower + rise, c.upper - fall)
    return np.column_stack([m.real, m.imag, np.full(len(n), c.P), a.real, a.imag, height])


def inertial_states(y0: Array, h: float, n: NDArray[np.int64], p: Floats) -> Array:
    """States (m, 6) of the inertial form after n steps (m,) from ``y0`` (6,).

    Raises RunError for a motion that is not covered (see the module docstring).
    """
    return _motion(tuple(map(float, y0)), float(h), n, float(p[0]))


def body_states(y0: Array, h: float, n: NDArray[np.int64], p: Floats) -> Array:
    """States (m, 6) of the body form after n steps (m,) from ``y0`` (6,); ``p`` are the constants of the top.

    In a frame that rotates by alpha omega3 about the axis, m = -omega and a = gamma satisfy the equations of the
    inertial frame with (1 - alpha) omega3 in place of omega3. Raises RunError like ``inertial_states``.
    """
    alpha, nu = float(p[0]), float(p[1])
    w1, w2, s, *gamma = map(float, y0)
    spin = s - alpha * s
    m1, m2, _, a1, a2, a3 = _motion((-w1, -w2, -spin, *gamma), float(h), n, nu).T
    turned = np.exp(-1j * (alpha * s * h) * n)
    omega, vertical = -(m1 + 1j * m2) * turned, (a1 + 1j * a2) * turned
    return np.column_stack([omega.real, omega.imag, np.full(len(n), s), vertical.real, vertical.imag, a3])


@closed_form(top=("lagrange", "lagrange/inertial"))
def build_lagrange(top: Top, options: NoOptions) -> Sampler:
    r"""Closed form by elliptic functions.

    The scheme computes gamma3, or a·p in the inertial frame, by Jacobi functions, and the angle of precession by a
    Fourier series.

    The nutation is accurate to round-off at any time, and the angle of precession to a few ulp of its size, which grows
    with time. The scheme refuses motions that tend to the upright position, because they are not periodic, and motions
    in which the axis stays nearly, but not exactly, in a vertical plane.

    Source
    ------
    Lagrange 1788; Whittaker, Analytical Dynamics, section 71

    Equations
    ---------
    (Euler) and (Poisson) of the paper with A = B, x0 = y0 = 0; in the inertial frame m' = p x a, a' = m x a

    Formula
    -------
    \dot u^2 = (2E - s^2 - 2u)(1 - u^2) - (l - su)^2, \qquad
    u = u_1 + (u_2 - u_1)\,\mathrm{sn}^2\Bigl(\sqrt{\tfrac{u_3 - u_1}{2}}\;(t + t_0)\,;\ k\Bigr), \quad
    k^2 = \frac{u_2 - u_1}{u_3 - u_1}

    u = \gamma_3 = a\cdot p, \quad s = m\cdot e_3 = m\cdot a, \quad l = m\cdot\gamma = m\cdot p, \quad
    E = \tfrac12 m^2 + u, \qquad u_1 \leq u_2 \leq u_3 \text{ the zeros of } \dot u^2; \quad A = \mu = 1

    Limits
    ------
    huge
        The nutation of a body that rotates very fast is too small to be resolved. The motion is refused, and the
        message names the scheme `taylor`.
    sleeping-threshold (lagrange)
        The scheme refuses motions that tend to the upright position, because their period is infinite. At the stability
        limit of the upright top it also refuses motions within 1e-6 of the upright position, because their period is
        too long to resolve.
    """
    return Sampler(body_states if top.form == "lagrange" else inertial_states)
