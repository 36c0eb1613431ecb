"""Numbers with 60 digits and random points for the formulas of the paper.

Vectors and matrices are arrays of such numbers; complex numbers are those of mpmath.
"""

from __future__ import annotations

import inspect
import random
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
from mpmath.ctx_mp import MPContext
from numpy.typing import NDArray

Array60 = NDArray[Any]
"""Array of numbers with 60 digits."""

MP: Any = MPContext()
MP.dps = 60
I_UNIT, SMALL = MP.mpc(0, 1), MP.mpf(10) ** -20
"""Imaginary unit, and an increment whose square is negligible."""
conj: Callable[[Any], Any] = MP.conj


def exact(*values: Any) -> Array60:
    """Array of numbers as they are."""
    return np.array(values, dtype=object)


def digits60(value: Any) -> Any:
    """A fraction, an array of fractions, or a tuple of these, as numbers with 60 digits."""
    if isinstance(value, tuple):
        return tuple(map(digits60, value))
    return np.frompyfunc(MP.mpf, 1, 1)(value)


def plane(v: Any) -> Any:
    """First two components of a vector as a complex number: omega of omega_1, omega_2; complex floats of arrays."""
    return v[0] + 1j * v[1] if isinstance(v[0], np.ndarray) else MP.mpc(v[0], v[1])


def unit_complex(angle: Any) -> Any:
    """Complex number e^{i angle}."""
    return np.exp(1j * angle) if isinstance(angle, np.ndarray) else MP.expj(angle)


def vector_product(u: Array60, v: Array60) -> Array60:
    """Vector product."""
    j, k = [1, 2, 0], [2, 0, 1]
    return u[j] * v[k] - u[k] * v[j]


def commutator(a: Array60, b: Array60) -> Array60:
    """Commutator ab - ba."""
    return a @ b - b @ a


def largest(values: Any) -> float:
    """Largest magnitude among the numbers of nested sequences of equal lengths."""
    return max(float(abs(value)) for value in np.ravel(np.array(values, dtype=object)))


def derivative(function: Callable[..., Any], point: dict[str, Any], **rates: Array60) -> Array60:
    """Derivative of a function at a point some of whose variables move with these rates: a central difference."""
    up, down = (
        function(**point | {name: point[name] + step * rate for name, rate in rates.items()})
        for step in (SMALL, -SMALL)
    )
    return (exact(*up) - exact(*down)) / (2 * SMALL)


class Draws(random.Random):
    """Fractions at random, the same for the same seed."""

    def fraction(self, high: int, *denominators: int) -> Fraction:
        """Fraction of either sign with a numerator from 1 to ``high``."""
        sign = self.choice((-1, 1))
        return Fraction(sign * self.randint(1, high), self.choice(denominators))

    def number(self) -> Fraction:
        """Number between -9 and 9, not zero."""
        return self.fraction(27, 3, 4, 5, 7, 8)

    def vector(self, size: int = 3) -> Array60:
        """Array of numbers."""
        return exact(*(self.number() for _ in range(size)))

    def unit(self) -> Array60:
        """Unit vector with rational components."""
        u, v = self.number(), self.number()
        return exact(2 * u, 2 * v, 1 - u * u - v * v) / (1 + u * u + v * v)

    def variable(self, name: str) -> Any:
        """Value of a variable of a formula; by default a vector.

        A top is its moments of inertia, and mg times the vector to the centre of gravity.
        """
        match name:
            case "h" | "c0" | "x0":
                return self.number()
            case "C":
                return abs(self.number())
            case "moments":
                return abs(self.vector())
            case "unit":
                return self.unit()
            case "turn":  # cosine and sine of an angle
                t = self.number()
                return exact(1 - t * t, 2 * t) / (1 + t * t)
            case "old":
                return self.vector(6)
            case "top":
                return abs(self.vector()), self.vector()
            case "euler_top":
                return abs(self.vector()), exact(0, 0, 0)
            case "lagrange_top":
                A, C, z0 = abs(self.number()), abs(self.number()), self.number()
                return exact(A, A, C), exact(0, 0, z0)
            case "kowalevski_top":
                C, c0 = abs(self.number()), self.number()
                return exact(2 * C, 2 * C, C), exact(c0, 0, 0)
        return self.vector()

    def point(self, function: Callable[..., Any], **fixed: Any) -> dict[str, Any]:
        """Arguments of a function with 60 digits: those in ``fixed``, the others drawn in their order."""
        return {name: digits60(fixed[name] if name in fixed else self.variable(name)) for name in arguments(function)}


def arguments(function: Callable[..., Any]) -> list[str]:
    """Names of the parameters of a function that have no default."""
    parameters = inspect.signature(function).parameters.values()
    return [parameter.name for parameter in parameters if parameter.default is parameter.empty]
