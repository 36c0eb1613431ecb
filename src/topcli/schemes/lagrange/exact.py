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
from dataclasses import dataclass
from decimal import Decimal, localcontext
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.elliptic import DIGITS, TURN, Oscillation, oscillation
from topcli.contracts import Array, Floats, NoOptions, Sampler, Top
from topcli.errors import RunError
from topcli.schemes.layout import LAGRANGE_AXIS
from topcli.schemes.registry import scheme

MAX_SAMPLES = 1 << 15
_NOTHING = 1e-26
"""Squares below this, relative to the largest, are zeros with rounding errors of the decimal arithmetic."""


def _dot(x: Sequence[Decimal], y: Sequence[Decimal]) -> Decimal:
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


def _least(low: Decimal, high: Decimal) -> float:
    """Ratio of the smaller to the larger of two squares; zero if it is only round-off."""
    small, large = min(low, high), max(low, high)
    return float(small / large) if large > 0 and small > large * Decimal(_NOTHING) else 0.0


@dataclass(frozen=True)
class _Constants:
    """Constants of one motion, rounded once; pairs are the values at the minimum and the maximum of u."""

    nutation: Oscillation
    nu: float
    P: float
    S: float
    lower: float
    upper: float
    down: tuple[float, float]
    """sqrt(N) + u."""
    up: tuple[float, float]
    """sqrt(N) - u."""
    momentum: tuple[float, float]
    """Square of the horizontal part of m, 2 (E - nu u) - P²."""
    axis_turn: tuple[float, float]
    """N P - S u."""
    momentum_turn: tuple[float, float]
    """S - P u."""
    axis_least: float
    momentum_least: float
    """Smallest square of the horizontal part of m, relative to the largest; ``axis_least`` is the same for a."""

    def squares(self, rise: Array, fall: Array) -> tuple[Array, Array]:
        """Squares of the horizontal parts of a and m, as sums and products of non-negative terms."""
        axis = (self.up[1] + fall) * (self.down[0] + rise)
        if self.nu > 0.0:
            return axis, self.momentum[1] + 2.0 * self.nu * fall
        return axis, self.momentum[0] - 2.0 * self.nu * rise

    def turns(self, rise: Array, fall: Array) -> tuple[Array, Array]:
        """N P - S u and S - P u, computed from the nearer turning point."""
        near = rise < fall
        axis = np.where(near, self.axis_turn[0] - self.S * rise, self.axis_turn[1] + self.S * fall)
        return axis, np.where(near, self.momentum_turn[0] - self.P * rise, self.momentum_turn[1] + self.P * fall)

    def heights(self, rise: Array, fall: Array) -> Array:
        """u, computed from the nearer turning point."""
        return np.where(rise < fall, self.lower + rise, self.upper - fall)


@lru_cache(maxsize=64)
def _constants(y0: Floats, h: float, nu: float) -> _Constants:
    with localcontext() as context:
        context.prec = DIGITS
        m, a = [Decimal(v) for v in y0[:3]], [Decimal(v) for v in y0[3:]]
        g, P, S, N = Decimal(nu), m[2], _dot(m, a), _dot(a, a)
        E = _dot(m, m) / 2 + g * a[2]
        root = N.sqrt()
        q = [Decimal(0), 2 * g, -2 * E, 2 * S * P - 2 * g * N, 2 * E * N - S * S - N * P * P]
        rising = m[0] * a[1] - m[1] * a[0] >= 0
        nutation = oscillation(q, a[2], rising, -root, Decimal(h))
        ends = (nutation.lower, nutation.upper)
        up, down = [root - u for u in ends], [root + u for u in ends]
        momentum = [2 * (E - g * u) - P * P for u in ends]

        def pair(values: Sequence[Decimal], floor: Decimal) -> tuple[float, float]:
            low, high = (float(max(v, floor)) for v in values)
            return low, high

        nothing, anything = Decimal(0), Decimal("-Infinity")
        return _Constants(
            nutation,
            nu,
            float(P),
            float(S),
            float(ends[0]),
            float(ends[1]),
            pair(down, nothing),
            pair(up, nothing),
            pair(momentum, nothing),
            pair([N * P - S * u for u in ends], anything),
            pair([S - P * u for u in ends], anything),
            _least(up[0] * down[0], up[1] * down[1]),
            _least(momentum[0], momentum[1]),
        )


@dataclass(frozen=True)
class _Angle:
    """Angle whose rate has the period of the nutation: mean rate per step, and Fourier series of the periodic part."""

    mean: float
    harmonics: NDArray[np.complex128]

    def periodic(self, phase: NDArray[np.uint64]) -> Array:
        """Periodic part at the phases (m,)."""
        z = np.exp(phase.view(np.int64) * (4j * math.pi / TURN))
        total: NDArray[np.complex128] = np.zeros(len(z), dtype=np.complex128)
        for coefficient in self.harmonics[::-1]:
            total = (total + coefficient) * z
        return total.real


def _rate(c: _Constants, by_axis: bool, phase: NDArray[np.uint64]) -> Array:
    rise, fall, *_ = c.nutation.at(phase)
    square = c.squares(rise, fall)[0 if by_axis else 1]
    turn = c.turns(rise, fall)[0 if by_axis else 1]
    return turn / square if by_axis else c.nu * turn / square


@lru_cache(maxsize=64)
def _angle(c: _Constants, by_axis: bool, h: float) -> _Angle:
    """Integral of the rate by the trapezoidal rule, doubling the number of samples; raise ValueError at the limit."""
    samples = 32
    while samples <= MAX_SAMPLES:
        phase = np.arange(samples, dtype=np.uint64) * np.uint64(TURN // 2 // samples)
        rate = _rate(c, by_axis, phase)
        series = np.fft.rfft(rate) / samples
        frequency = 2.0 * math.pi / c.nutation.period
        order = np.arange(1, samples // 2)
        harmonics = 2.0 * series[1 : samples // 2] / (1j * order * frequency)
        round_off = 1e-16 * (1.0 + float(np.abs(rate).max()) / frequency)
        if np.abs(harmonics[samples // 4 :]).max() <= round_off:
            kept = np.flatnonzero(np.abs(harmonics) > 0.01 * round_off)
            return _Angle(float(series[0].real) * h, harmonics[: kept[-1] + 1 if len(kept) else 0])
        samples *= 2
    raise ValueError("almost planar motion: both the axis and the angular momentum pass too close to the vertical")


def _motion(y0: Floats, h: float, n: NDArray[np.int64], nu: float) -> Array:
    """Solution (m, a) of m' = nu p x a, a' = m x a from ``y0`` after n steps (m,), shape (m, 6)."""
    c = _constants(y0, h, nu)
    phase, begin = c.nutation.phases(n), c.nutation.phases(np.zeros(1, dtype=np.int64))
    rise, fall, rate, sn, cn = c.nutation.at(phase)
    axis_sq, momentum_sq = c.squares(rise, fall)
    axis_now, momentum_now = complex(y0[3], y0[4]), complex(y0[0], y0[1])
    if c.axis_least == c.momentum_least == 0.0:
        # at rest upright, or planar motion: the horizontal parts stay on a line and change sign
        first, second = (sn, cn) if nu > 0.0 else (cn, sn)
        _, _, _, sn0, cn0 = c.nutation.at(begin)
        sign0, other0 = (sn0[0], cn0[0]) if nu > 0.0 else (cn0[0], sn0[0])
        along = axis_now * np.sign(sign0) if axis_now else 1j * momentum_now * np.sign(other0)
        along = along / abs(along) if along else 0.0
        a = along * np.sqrt(axis_sq) * np.sign(first)
        m = -1j * along * np.sqrt(momentum_sq) * np.sign(second)
    else:
        by_axis = c.axis_least >= c.momentum_least
        angle = _angle(c, by_axis, h)
        turned = np.exp(1j * (angle.mean * n + (angle.periodic(phase) - angle.periodic(begin))))
        momentum_turn = c.turns(rise, fall)[1]
        if by_axis:
            length = np.sqrt(axis_sq)
            turned = turned * (axis_now / abs(axis_now))
            a, m = turned * length, turned * (momentum_turn - 1j * rate) / length
        else:
            length = np.sqrt(momentum_sq)
            turned = turned * (momentum_now / abs(momentum_now))
            m, a = turned * length, turned * (momentum_turn + 1j * rate) / length
    height = c.heights(rise, fall)
    return np.column_stack([m.real, m.imag, np.full(len(n), c.P), a.real, a.imag, height])


def inertial_states(y0: Array, h: float, n: NDArray[np.int64], p: Floats) -> Array:
    """States (m, 6) of the inertial form after n steps (m,) from ``y0`` (6,).

    Raises RunError for a motion that is not covered (see the module docstring).
    """
    try:
        return _motion(tuple(map(float, y0)), float(h), n, float(p[0]))
    except ValueError as error:
        raise RunError(f"lagrange, scheme exact: {error}") from error


def body_states(y0: Array, h: float, n: NDArray[np.int64], p: Floats) -> Array:
    """States (m, 6) of the body form after n steps (m,) from ``y0`` (6,); ``p`` are the constants of the top.

    In a frame that rotates by alpha omega3 about the axis, m = -omega and a = gamma satisfy the equations of the
    inertial frame with (1 - alpha) omega3 in place of omega3. Raises RunError like ``inertial_states``.
    """
    alpha, nu = float(p[0]), float(p[1])
    w1, w2, s, *gamma = map(float, y0)
    spin = s - alpha * s
    try:
        found = _motion((-w1, -w2, -spin, *gamma), float(h), n, nu)
    except ValueError as error:
        raise RunError(f"lagrange, scheme exact: {error}") from error
    turned = np.exp(-1j * (alpha * s * h) * n)
    omega = -(found[:, 0] + 1j * found[:, 1]) * turned
    vertical = (found[:, 3] + 1j * found[:, 4]) * turned
    return np.column_stack([omega.real, omega.imag, np.full(len(n), s), vertical.real, vertical.imag, found[:, 5]])


@scheme(
    "exact",
    top="lagrange",
    title="Closed form by elliptic functions",
    order=None,
    explicit=True,
    self_adjoint=True,
    conserves=("gamma_sq", "m_gamma", "energy", "m_axis"),
    citation="Lagrange 1788; Whittaker, Analytical Dynamics, section 71",
    formula=LAGRANGE_AXIS,
    equations="(Euler) and (Poisson) of the paper with A = B, x0 = y0 = 0",
    limits={
        "sleeping-threshold": "The scheme refuses motions that tend to the upright position, because their period is "
        "infinite. At the stability limit of the upright top it also refuses motions within 1e-6 of the upright "
        "position, because their period is too long to resolve.",
    },
)
def build_exact(top: Top, options: NoOptions) -> Sampler:
    """The scheme computes gamma3 by Jacobi functions and the angle of precession by a Fourier series.

    Every state is accurate to round-off, at any time. The scheme refuses motions that tend to the upright position,
    because they are not periodic, and motions in which the axis stays nearly, but not exactly, in a vertical plane.
    """
    return Sampler(body_states)


@scheme(
    "exact",
    top="lagrange/inertial",
    title="Closed form by elliptic functions",
    order=None,
    explicit=True,
    self_adjoint=True,
    conserves=("a_sq", "m_p", "m_a", "energy"),
    citation="Lagrange 1788; Whittaker, Analytical Dynamics, section 71",
    formula=LAGRANGE_AXIS,
    equations="m' = p x a, a' = m x a",
)
def build_exact_inertial(top: Top, options: NoOptions) -> Sampler:
    """The scheme computes a·p by Jacobi functions and the angle of precession by a Fourier series.

    Every state is accurate to round-off, at any time. The scheme refuses motions that tend to the upright position,
    because they are not periodic, and motions in which the axis stays nearly, but not exactly, in a vertical plane.
    """
    return Sampler(inertial_states)
