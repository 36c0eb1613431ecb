"""Exact numbers for identities: rational, Gaussian rational, and with a derivative along the motion."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

Vector = tuple[Any, Any, Any]
Matrix = tuple[tuple[Any, ...], ...]


@dataclass(frozen=True)
class Gauss:
    """Complex number ``re + i im`` with parts of any kind."""

    re: Any
    im: Any = Fraction(0)

    def __add__(self, other: Any) -> Gauss:
        other = gauss(other)
        return Gauss(self.re + other.re, self.im + other.im)

    __radd__ = __add__

    def __neg__(self) -> Gauss:
        return Gauss(-self.re, -self.im)

    def __sub__(self, other: Any) -> Gauss:
        return self + -gauss(other)

    def __rsub__(self, other: Any) -> Gauss:
        return gauss(other) - self

    def __mul__(self, other: Any) -> Gauss:
        other = gauss(other)
        return Gauss(self.re * other.re - self.im * other.im, self.re * other.im + self.im * other.re)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Gauss:
        other = gauss(other)
        size = other.re * other.re + other.im * other.im
        found = self * other.bar
        return Gauss(found.re / size, found.im / size)

    @property
    def bar(self) -> Gauss:
        """Complex conjugate."""
        return Gauss(self.re, -self.im)


I_UNIT = Gauss(Fraction(0), Fraction(1))


def gauss(value: Any) -> Gauss:
    """Complex number of any number."""
    return value if isinstance(value, Gauss) else Gauss(value)


@dataclass(frozen=True)
class Dual:
    """Value of a function of the state and its ``rate`` along the motion."""

    value: Any
    rate: Any = Fraction(0)

    def __add__(self, other: Any) -> Dual:
        other = _dual(other)
        return Dual(self.value + other.value, self.rate + other.rate)

    __radd__ = __add__

    def __neg__(self) -> Dual:
        return Dual(-self.value, -self.rate)

    def __sub__(self, other: Any) -> Dual:
        return self + -_dual(other)

    def __rsub__(self, other: Any) -> Dual:
        return _dual(other) - self

    def __mul__(self, other: Any) -> Dual:
        other = _dual(other)
        return Dual(self.value * other.value, self.value * other.rate + self.rate * other.value)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Dual:
        other = _dual(other)
        rate = (self.rate * other.value - self.value * other.rate) / (other.value * other.value)
        return Dual(self.value / other.value, rate)


def _dual(value: Any) -> Dual:
    return value if isinstance(value, Dual) else Dual(value)


def gradients(functions: Callable[[Sequence[Dual]], Sequence[Dual]], state: Sequence[Any]) -> list[tuple[Any, ...]]:
    """Gradients of several functions of a state, at one point."""
    columns = []
    for i in range(len(state)):
        found = functions([Dual(x, Fraction(int(j == i))) for j, x in enumerate(state)])
        columns.append([_dual(value).rate for value in found])
    return list(zip(*columns, strict=True))


class Draws:
    """Rational numbers at random from a set of some hundred, the same for the same ``seed``."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)

    def number(self) -> Fraction:
        """Number between -9 and 9, not zero."""
        sign = self._random.choice((-1, 1))
        return Fraction(sign * self._random.randint(1, 27), self._random.choice((3, 4, 5, 7, 8)))

    def positive(self) -> Fraction:
        """Number above zero."""
        return abs(self.number())

    def small(self) -> Fraction:
        """Number between -1.6 and 1.6, not zero."""
        return Fraction(self._random.choice((-1, 1)) * self._random.randint(1, 16), self._random.choice((10, 11, 13)))

    def moment(self) -> Fraction:
        """Number from 1 up to, not including, 2: three of them are moments of inertia of a body."""
        return 1 + Fraction(self._random.randint(0, 9), 10)

    def step(self) -> Fraction:
        """Length of a step, from 1/20 to 1/7, of either sign."""
        return Fraction(self._random.choice((-1, 1)), self._random.randint(7, 20))

    def vector(self) -> Vector:
        """Three numbers."""
        return self.number(), self.number(), self.number()

    def moments(self) -> Vector:
        """Three numbers above zero."""
        return self.positive(), self.positive(), self.positive()

    def circle(self) -> tuple[Fraction, Fraction]:
        """Cosine and sine of an angle, both rational."""
        t = self.number()
        return (1 - t * t) / (1 + t * t), 2 * t / (1 + t * t)

    def unit(self) -> Vector:
        """Unit vector with rational components."""
        u, v = self.number(), self.number()
        size = 1 + u * u + v * v
        return 2 * u / size, 2 * v / size, (1 - u * u - v * v) / size


def cross(u: Vector, v: Vector) -> Vector:
    """Vector product."""
    return (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])


def dot(u: Sequence[Any], v: Sequence[Any]) -> Any:
    """Scalar product."""
    return sum((a * b for a, b in zip(u, v, strict=True)), Fraction(0))


def plus(u: Sequence[Any], v: Sequence[Any]) -> tuple[Any, ...]:
    """Sum of two vectors."""
    return tuple(a + b for a, b in zip(u, v, strict=True))


def minus(u: Sequence[Any], v: Sequence[Any]) -> tuple[Any, ...]:
    """Difference of two vectors."""
    return tuple(a - b for a, b in zip(u, v, strict=True))


def times(factor: Any, u: Sequence[Any]) -> tuple[Any, ...]:
    """Multiple of a vector."""
    return tuple(factor * a for a in u)


def weighted(moments: Sequence[Any], u: Sequence[Any]) -> Vector:
    """Diagonal matrix of ``moments`` times a vector: the angular momentum of an angular velocity."""
    return moments[0] * u[0], moments[1] * u[1], moments[2] * u[2]


def product(a: Matrix, b: Matrix) -> Matrix:
    """Matrix product."""
    columns = list(zip(*b, strict=True))
    return tuple(tuple(dot(row, column) for column in columns) for row in a)


def commutator(a: Matrix, b: Matrix) -> Matrix:
    """Commutator ab - ba."""
    return tuple(minus(x, y) for x, y in zip(product(a, b), product(b, a), strict=True))


def flat(a: Matrix) -> tuple[Any, ...]:
    """Elements of a matrix, row by row."""
    return tuple(x for row in a for x in row)


def size_of(value: Any) -> float:
    """Magnitude of an exact number; the sum of those of its parts if it is complex."""
    return size_of(value.re) + size_of(value.im) if isinstance(value, Gauss) else float(abs(value))
