"""What is done with vectors of floats, by machine code (``vector_ir``) or by Python (``vector_plain``)."""

from __future__ import annotations

from typing import Any, Protocol

Vector = Any
Scalar = Any


class Operations(Protocol):
    """Vectors of ``lanes`` floats, scalars, and arrays of vectors with one name and an index each."""

    lanes: int

    def constant(self, values: tuple[float, ...]) -> Vector:
        """A vector known beforehand."""

    def splat(self, x: Scalar) -> Vector:
        """A scalar in every lane."""

    def number(self, x: float) -> Scalar:
        """A scalar known beforehand."""

    def add(self, x: Any, y: Any) -> Any:
        """The sum of two vectors or scalars; likewise ``sub`` and ``mul``."""

    def sub(self, x: Any, y: Any) -> Any:
        """x - y."""

    def mul(self, x: Any, y: Any) -> Any:
        """x y."""

    def fma(self, x: Any, y: Any, z: Any) -> Any:
        """x y + z, rounded once where the processor can."""

    def negative(self, x: Vector) -> Vector:
        """-x."""

    def permute(self, x: Vector, lanes: tuple[int, ...]) -> Vector:
        """The lanes of x at the indices; 0.0 at -1."""

    def store(self, name: str, index: int, x: Vector) -> None:
        """Keep x as number ``index`` of the array ``name``."""

    def load(self, name: str, index: int) -> Vector:
        """What was kept."""

    def cut(self) -> None:
        """What stands before is to be done before: a compiler that reorders everything makes long sums waited for."""

    def logarithm(self, x: Vector) -> Scalar:
        """The base-2 logarithm of the largest magnitude in x to 0.09; -1023 for 0.0, 1024 and more for inf and nan."""

    def power(self, x: Scalar) -> Scalar:
        """2^x, to 0.3 percent, for -1022 < x < 1023."""

    def least(self, x: Scalar, y: Scalar) -> Scalar:
        """The smaller one; likewise ``largest``."""

    def largest(self, x: Scalar, y: Scalar) -> Scalar:
        """The larger one."""


Pair = tuple[Vector, Vector]
"""A vector to more than a double: the number, and what is missing in it."""


def two_sum(o: Operations, x: Vector, z: Vector) -> Pair:
    """The sum of two vectors, and what it rounds."""
    rounded = o.add(x, z)
    part = o.sub(rounded, x)
    return rounded, o.add(o.sub(x, o.sub(rounded, part)), o.sub(z, part))


def total(o: Operations, x: Pair, z: Pair) -> Pair:
    """The sum."""
    rounded, missing = two_sum(o, x[0], z[0])
    return rounded, o.add(missing, o.add(x[1], z[1]))


def product(o: Operations, x: Pair, z: Pair) -> Pair:
    """The product."""
    rounded, missing = scaled(o, x[0], z)
    return rounded, o.fma(x[1], z[0], missing)


def scaled(o: Operations, factor: Vector, x: Pair) -> Pair:
    """The product with a vector that is exact."""
    rounded = o.mul(factor, x[0])
    return rounded, o.fma(factor, x[1], o.fma(factor, x[0], o.negative(rounded)))
