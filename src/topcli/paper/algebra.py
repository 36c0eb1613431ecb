"""Exact numbers for identities: rational, Gaussian rational, and with a derivative along the motion.

Vectors and matrices are arrays of such numbers.
"""

from __future__ import annotations

import inspect
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[Any]


@dataclass(frozen=True)
class PairNumber:
    """Number ``first + second u`` with parts of any kind and u² = ``square``."""

    first: Any
    second: Any = Fraction(0)
    square: ClassVar[int]

    @classmethod
    def of(cls, value: Any) -> Self:
        """Pair of any number."""
        return value if isinstance(value, cls) else cls(value)

    @property
    def bar(self) -> Self:
        """Conjugate, with -u."""
        return type(self)(self.first, -self.second)

    def __add__(self, other: Any) -> Self:
        if isinstance(other, np.ndarray):
            return NotImplemented
        other = self.of(other)
        return type(self)(self.first + other.first, self.second + other.second)

    __radd__ = __add__

    def __neg__(self) -> Self:
        return type(self)(-self.first, -self.second)

    def __sub__(self, other: Any) -> Self:
        return self + -other

    def __rsub__(self, other: Any) -> Self:
        return other + -self

    def __mul__(self, other: Any) -> Self:
        if isinstance(other, np.ndarray):
            return NotImplemented
        other = self.of(other)
        return type(self)(
            self.first * other.first + self.square * self.second * other.second,
            self.first * other.second + self.second * other.first,
        )

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Self:
        other = self.of(other)
        quotient, norm = self * other.bar, (other * other.bar).first
        return type(self)(quotient.first / norm, quotient.second / norm)


class Gauss(PairNumber):
    """Complex number."""

    square = -1


class Dual(PairNumber):
    """Value of a function of the state and its rate of change along the motion; also a multiple of epsilon, e² = 0."""

    square = 0


I_UNIT = Gauss(Fraction(0), Fraction(1))
dual: Callable[..., Numbers] = np.frompyfunc(Dual, 2, 1)
"""Array of duals from an array of values and one of rates."""


def rates(values: Any) -> list[Any]:
    """Rates of change of some functions of the state."""
    return [Dual.of(value).second for value in values]


def size_of(value: Any) -> float:
    """Magnitude of an exact number; the sum of those of its parts if it is a pair."""
    return size_of(value.first) + size_of(value.second) if isinstance(value, PairNumber) else float(abs(value))


def largest(values: Any) -> float:
    """Largest magnitude among the numbers of nested sequences of equal lengths."""
    return max(map(size_of, np.ravel(np.array(values, dtype=object))))


def exact(*values: Any) -> Numbers:
    """Array of numbers as they are."""
    return np.array(values, dtype=object)


def plane(v: Any) -> Any:
    """First two components of a vector as a complex number: omega of omega_1, omega_2; complex floats of arrays."""
    return v[0] + 1j * v[1] if isinstance(v[0], np.ndarray) else Gauss(v[0], v[1])


def cross(u: Numbers, v: Numbers) -> Numbers:
    """Vector product."""
    j, k = [1, 2, 0], [2, 0, 1]
    return u[j] * v[k] - u[k] * v[j]


def commutator(a: Numbers, b: Numbers) -> Numbers:
    """Commutator ab - ba."""
    return a @ b - b @ a


class Draws:
    """Rational numbers at random from a set of some hundred, the same for the same ``seed``."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)

    def _fraction(self, low: int, high: int, *denominators: int) -> Fraction:
        sign = self._random.choice((-1, 1))
        return Fraction(sign * self._random.randint(low, high), self._random.choice(denominators))

    def number(self) -> Fraction:
        """Number between -9 and 9, not zero."""
        return self._fraction(1, 27, 3, 4, 5, 7, 8)

    def positive(self) -> Fraction:
        """Number above zero."""
        return abs(self.number())

    def small(self) -> Fraction:
        """Number between -1.6 and 1.6, not zero."""
        return self._fraction(1, 16, 10, 11, 13)

    def moment(self) -> Fraction:
        """Number from 1 up to, not including, 2: three of them are moments of inertia of a body."""
        return 1 + Fraction(self._random.randint(0, 9), 10)

    def step(self) -> Fraction:
        """Length of a step, from 1/20 to 1/7, of either sign."""
        return Fraction(self._random.choice((-1, 1)), self._random.randint(7, 20))

    def numbers(self, count: int) -> Numbers:
        """Array of numbers."""
        return exact(*(self.number() for _ in range(count)))

    def vector(self) -> Numbers:
        """Three numbers."""
        return self.numbers(3)

    def moments(self) -> Numbers:
        """Three numbers above zero."""
        return abs(self.numbers(3))

    def circle(self) -> Numbers:
        """Cosine and sine of an angle, both rational."""
        t = self.number()
        return exact(1 - t * t, 2 * t) / (1 + t * t)

    def unit(self) -> Numbers:
        """Unit vector with rational components."""
        u, v = self.number(), self.number()
        return exact(2 * u, 2 * v, 1 - u * u - v * v) / (1 + u * u + v * v)

    def state(self) -> Numbers:
        """Vectors omega and gamma in one array."""
        return self.numbers(6)

    def top(self) -> tuple[Numbers, Numbers]:
        """Moments of inertia, and mg times the vector to the centre of gravity, of any top."""
        return self.moments(), self.vector()

    def euler_top(self) -> tuple[Numbers, Numbers]:
        """Moments and gravity of a top without gravity."""
        return self.moments(), exact(0, 0, 0)

    def lagrange_top(self) -> tuple[Numbers, Numbers]:
        """Moments and gravity of a top with A = B and gravity on the third axis."""
        A, C, z0 = self.positive(), self.positive(), self.number()
        return exact(A, A, C), exact(0, 0, z0)

    def kowalevski_top(self) -> tuple[Numbers, Numbers]:
        """Moments and gravity of a top with A = B = 2C and gravity c0 on the first axis."""
        C, c0 = self.positive(), self.number()
        return exact(2 * C, 2 * C, C), exact(c0, 0, 0)

    def point(self, function: Callable[..., Any], **known: Any) -> dict[str, Any]:
        """Arguments of a function: those in ``known``, the others drawn as its parameters' names say, in their order.

        >>> Draws(1).point(lambda h, x0: 0)
        {'h': Fraction(-19, 3), 'x0': Fraction(4, 7)}
        """
        return {name: known[name] if name in known else DRAWN[name](self) for name in arguments(function)}


DRAWN: Mapping[str, Callable[[Draws], Any]] = {
    **dict.fromkeys(("h", "c0", "x0"), Draws.number),
    "C": Draws.positive,
    **dict.fromkeys(("m", "n", "a", "w", "v", "c", "e", "g"), Draws.vector),
    "moments": Draws.moments,
    "unit": Draws.unit,
    "turn": Draws.circle,
    "old": Draws.state,
    "top": Draws.top,
    "euler_top": Draws.euler_top,
    "lagrange_top": Draws.lagrange_top,
    "kowalevski_top": Draws.kowalevski_top,
}
"""Draw of each variable of the paper's formulas: old and new omega w and v, gamma c and e, momentum m and n, ..."""


@cache
def arguments(function: Callable[..., Any]) -> tuple[str, ...]:
    """Names of the parameters of a function that have no default."""
    parameters = inspect.signature(function).parameters.values()
    return tuple(parameter.name for parameter in parameters if parameter.default is parameter.empty)
