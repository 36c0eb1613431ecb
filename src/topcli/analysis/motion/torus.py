"""Torus of a Kowalevski motion: actions by quadrature, and the surface with the lines of two flows.

With x = s + E/3, Z = (2 x - E)² - k² and the two factors S = x (Z + G) - L² and Z/4 of Phi, the momentum conjugate
to x is

    pi(x) = (1/2) int dZ / sqrt(-Z (x Z + x G - L²)),    d pi/dE = (s - E/6)/w,    d pi/dk² = 1/(4 w),

so that (x1, pi1, x2, pi2) are canonical up to functions of x (Veselov, Novikov, Proc. Steklov Inst. 165 (1985) 53-65).
The actions are the integrals over the cycles of the torus, divided by 2 pi:

    J1 = (n1/pi) (int_a^b f dx + pi sqrt(a) - pi |L|/sqrt(G)),    J2 = (n2/pi) (int_-inf^r f dx - pi sqrt(r)),
    f = arcsin(sqrt(x |Z|/|x G - L²|))/sqrt(x),

where the terms with a and r are absent if the end of the oval is e4 or e5. J1 vanishes where the oval of s1 shrinks to
a point. The integral to minus infinity diverges; sqrt(y) ln(16 y²/G) - 4 sqrt(y), y = -x, is subtracted. Then
dE/dJ_i = 2 pi nu_i. The same cycles give other values in Euler angles, which are singular where gamma is parallel to
the third axis: they differ by multiples of 2l, a constant of the leaf.

On the torus the two angles of s1 and s2 at equal phases grow linearly under both flows. The Hamiltonian k² turns them
at the rates B/D and -A/D, with A, B the integrals of |s - E/6| ds/|w| (signed as s1 - E/6 and E/6 - s2) over the ovals
and D = A b + B a (the derivatives of the actions); the energy at b/(4 D) and a/(4 D), in revolutions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from topcli.contracts import Array, Floats
from topcli.schemes.kowalevski.closed_form.course import Lattice
from topcli.schemes.kowalevski.closed_form.curve import DIGITS, Real, curve, integrals, real
from topcli.schemes.kowalevski.closed_form.motion import SeparatedMotion
from topcli.schemes.kowalevski.closed_form.multiprecision import asin, asinh, cos_sin, digits, log, mpf, pi, quad, sqrt
from topcli.schemes.kowalevski.closed_form.oval import Oval
from topcli.schemes.kowalevski.closed_form.setup import separated_motion

WORKING_DIGITS = 20
"""Decimal digits of the quadrature (tanh-sinh, which allows for the logarithm at infinity)."""
INNER_DIGITS = 80
"""Decimal digits of the integrand, whose terms cancel to twice the digits of the quadrature near infinity."""


def actions(first: Oval, second: Oval, turns: tuple[int, int]) -> tuple[float, float]:
    """Actions J1, J2 of the cycles that pass ``turns`` half periods of s1 and of s2."""
    with digits(INNER_DIGITS):
        first_action, second_action = _of_first(first), _of_second(second)
        return float(turns[0] * first_action / pi), float(turns[1] * second_action / pi)


def _momentum(of: Oval, x: Real) -> Real:
    """Return f = arcsin(sqrt(x |Z|/|x G - L²|))/sqrt(x) at ``x``, analytic across x = 0."""
    exact = of.curve.of
    Z = (2 * x - 3 * real(exact.l1)) ** 2 - real(exact.k_sq)
    a = x * real(exact.G) - real(exact.L) ** 2
    if not Z or not a:
        return mpf(0)
    if not x:
        return sqrt(abs(Z / a))
    part = sqrt(abs(x * Z / a))
    return asin(min(part, mpf(1))) / sqrt(x) if x > 0 else asinh(part) / sqrt(-x)


def _integral(density: Callable[[Real], Real], anchors: Sequence[Real]) -> Real:
    """Integral between the ``anchors`` with ``WORKING_DIGITS``, of a density computed with ``INNER_DIGITS``."""

    def precise(theta: Real) -> Real:
        with digits(INNER_DIGITS):
            return density(theta)

    with digits(WORKING_DIGITS):
        return quad(precise, anchors)


def _root_of_end(of: Oval) -> Real:
    """Root of x at the end of the oval with theta = 0; x >= 0 there, but for rounding."""
    return sqrt(max(of.a + real(of.curve.of.l1), mpf(0)))


def _of_first(of: Oval) -> Real:
    exact = of.curve.of
    l1, total = real(exact.l1), mpf(0)

    def density(theta: Real) -> Real:
        C, S = cos_sin(theta)
        return _momentum(of, of.a + l1 + of.length * S * S) * 2 * of.length * S * C

    if of.length:
        total = _integral(density, of.anchors)
    if of.low < 3:
        total += pi * (_root_of_end(of) - abs(real(exact.L)) / sqrt(real(exact.G)))
    return total


def _of_second(of: Oval) -> Real:
    exact, H = of.curve.of, of.length
    l1, scale, root = real(exact.l1), 16 * H * H / real(exact.G), sqrt(H)

    def density(theta: Real) -> Real:
        C, S = cos_sin(theta)
        tan = S / C
        momentum = _momentum(of, of.a + l1 - H * tan * tan)
        return (2 * H * momentum * tan / C - root * tan * log(scale / C**4)) / C

    total = _integral(density, of.anchors) - (root * log(scale) - 4 * root)
    return total - pi * _root_of_end(of) if of.low < 3 else total


@dataclass(frozen=True)
class Torus:
    """Torus of a motion. Phases are in revolutions of the angles; ``periods`` are those after which states repeat.

    ``energy_rates`` and ``k_sq_rates`` are the rates of the two phases under the flows of the energy and of k².
    """

    motion: SeparatedMotion
    start: tuple[float, float]
    periods: tuple[float, float]
    energy_rates: tuple[float, float]
    k_sq_rates: tuple[float, float]

    @classmethod
    def of(cls, y: Floats, c: float) -> Torus:
        """Torus of the state ``y`` (6,), with omega and c gamma of the order of one.

        Raises RunError for motions that the closed form does not cover, and ValueError if the orbit is not on a torus.
        """
        motion = separated_motion(y, c)
        course = motion.course
        if not isinstance(course, Lattice) or any(course.first.touched) or any(course.second.touched):
            raise ValueError("the motion is on a separatrix, not on a torus")
        with digits(DIGITS):
            start = course.positions(np.zeros(1, dtype=np.int64), Fraction(0))
            roots = curve(integrals(y, c))
        P, a, Q, b = (float(v) for v in course.periods)
        sigma = float(roots.e[course.second.low].real + roots.e[course.first.low].real) / 2
        shift = sigma - float(roots.of.l1) / 2
        A, B = P + shift * a, Q - shift * b
        D = A * b + B * a
        first = 0.5 if course.first.low == 4 else 1.0
        return cls(
            motion, (float(start[0][0]), float(start[1][0])), (first, 1.0), (b / (4 * D), a / (4 * D)), (B / D, -A / D)
        )

    def states(self, first: Array, second: Array) -> Array:
        """States at the phases (...), shape (..., 6)."""
        first, second = np.broadcast_arrays(first - np.round(first), second - np.round(second))
        with np.errstate(all="ignore"):
            states = self.motion.at_positions((first.ravel(), second.ravel()))
        return states.reshape(*first.shape, 6)

    def surface(self, rows: int, columns: int) -> Array:
        """States (rows, columns, 6) at equidistant phases over one period of both."""
        first = np.arange(rows) * (self.periods[0] / rows)
        second = np.arange(columns) * (self.periods[1] / columns)
        return self.states(first[:, None], second[None, :])

    def motion_line(self, returns: float, points: int) -> Array:
        """States (points, 6) of the motion from its start, for a number of periods of the second angle."""
        time = np.linspace(0.0, returns * self.periods[1] / self.energy_rates[1], points)
        return self.states(*(begin + rate * time for begin, rate in zip(self.start, self.energy_rates, strict=True)))

    def energy_lines(self, count: int, points: int, middle: float = 0.0) -> Array:
        """States (count, points, 6) on lines of the flow of the energy, each over one period of the second angle.

        The first meets the motion ``middle`` periods after its start.
        """
        return self._lines(self.energy_rates, 1, count, points, middle)

    def k_sq_lines(self, count: int, points: int) -> Array:
        """States (count, points, 6) on lines of the flow of k², each over one period of the first angle."""
        return self._lines(self.k_sq_rates, 0, count, points)

    def turn(self, rates: tuple[float, float], axis: int) -> float:
        """Periods of the other angle over one period of the angle ``axis`` of a flow with these rates."""
        return rates[1 - axis] / rates[axis] * self.periods[axis] / self.periods[1 - axis]

    def _lines(self, rates: tuple[float, float], axis: int, count: int, points: int, middle: float = 0.0) -> Array:
        """Equidistant lines, each of which continues another; for this their direction is not quite that of the flow.

        Over one period a line leaves the flow by at most half the distance of two lines, by far less for a good count.
        """
        turn = self.turn(rates, axis)
        along = np.linspace(-0.5, 0.5, points)[None, :]
        closing = round(count * turn) / count
        across = np.arange(count)[:, None] / count + along * closing + middle * (turn - closing)
        across = across * self.periods[1 - axis]
        along = along * self.periods[axis]
        phases = (along, across) if axis == 0 else (across, along)
        return self.states(phases[0] + self.start[0], phases[1] + self.start[1])
