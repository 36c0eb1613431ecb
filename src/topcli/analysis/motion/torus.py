"""Torus of a Kowalevski motion as a surface, with the lines of the flows of its energy and of k².

On the torus the two angles of s1 and s2 at equal phases grow linearly under both flows. The Hamiltonian k² turns them
at the rates B/D and -A/D, with A, B the integrals of |s - E/6| ds/|w| (signed as s1 - E/6 and E/6 - s2) over the ovals
and D = A b + B a (``actions``); the energy at b/(4 D) and a/(4 D), in revolutions.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from topcli.contracts import Array, Floats
from topcli.schemes.kowalevski.inversion import Lattice
from topcli.schemes.kowalevski.separated_motion import SeparatedMotion
from topcli.schemes.kowalevski.separation import DIGITS, curve, integrals


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
        from topcli.schemes.kowalevski.multiprecision import digits

        motion = SeparatedMotion(y, c)
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

    def states(self, one: Array, two: Array) -> Array:
        """States at the phases (...), shape (..., 6)."""
        one, two = np.broadcast_arrays(one - np.round(one), two - np.round(two))
        with np.errstate(all="ignore"):
            found = self.motion._evaluate(self.motion.course, (one.ravel(), two.ravel()))
        return found.reshape(*one.shape, 6)

    def surface(self, rows: int, columns: int) -> Array:
        """States (rows, columns, 6) at equidistant phases over one period of both."""
        one = np.arange(rows) * (self.periods[0] / rows)
        two = np.arange(columns) * (self.periods[1] / columns)
        return self.states(one[:, None], two[None, :])

    def motion_line(self, returns: float, points: int) -> Array:
        """States (points, 6) of the motion from its start, for a number of periods of the second angle."""
        time = np.linspace(0.0, returns * self.periods[1] / self.energy_rates[1], points)
        return self.states(*(begin + rate * time for begin, rate in zip(self.start, self.energy_rates, strict=True)))

    def energy_lines(self, count: int, points: int, middle: float = 0.0) -> Array:
        """States (count, points, 6) on lines of the flow of the energy, each over one period of the second angle.

        The middle of the lines is ``middle`` periods after the start of the motion.
        """
        return self._lines(self.energy_rates, 1, count, points, middle)

    def k_sq_lines(self, count: int, points: int) -> Array:
        """States (count, points, 6) on lines of the flow of k², each over one period of the first angle."""
        return self._lines(self.k_sq_rates, 0, count, points)

    def _lines(self, rates: tuple[float, float], axis: int, count: int, points: int, middle: float = 0.0) -> Array:
        """Lines that are equidistant where they cross the phase of the start, which the first of them passes."""
        along = np.linspace(middle - 0.5, middle + 0.5, points)[None, :] * self.periods[axis]
        across = np.arange(count)[:, None] * (self.periods[1 - axis] / count) + along * (rates[1 - axis] / rates[axis])
        phases = (along, across) if axis == 0 else (across, along)
        return self.states(phases[0] + self.start[0], phases[1] + self.start[1])
