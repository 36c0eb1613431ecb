"""Operations on vectors of floats, in terms of which the Taylor series is written."""

from __future__ import annotations

from typing import Any, Protocol

Vector = Any
Scalar = Any


class Operations(Protocol):
    """Operations on scalars, vectors of ``lanes`` floats, and named arrays of vectors."""

    lanes: int

    def constant(self, values: tuple[float, ...]) -> Vector:
        """Return a vector constant."""

    def splat(self, x: Scalar) -> Vector:
        """Return a vector with the scalar in every lane."""

    def number(self, x: float) -> Scalar:
        """Return a scalar constant."""

    def add(self, x: Any, y: Any) -> Any:
        """Return the sum of two vectors or of two scalars; ``sub`` and ``mul`` likewise."""

    def sub(self, x: Any, y: Any) -> Any:
        """Return x - y."""

    def mul(self, x: Any, y: Any) -> Any:
        """Return x y."""

    def fma(self, x: Any, y: Any, z: Any) -> Any:
        """Return x y + z, rounded once if the processor has fma."""

    def negative(self, x: Vector) -> Vector:
        """Return -x."""

    def permute(self, x: Vector, lanes: tuple[int, ...]) -> Vector:
        """Return the lanes of x at the indices; 0.0 at index -1."""

    def store(self, name: str, index: int, x: Vector) -> None:
        """Store x at position ``index`` of the array ``name``."""

    def load(self, name: str, index: int) -> Vector:
        """Return the stored vector."""

    def barrier(self) -> None:
        """Scheduling barrier: keep earlier instructions ahead of this point."""

    def logarithm(self, x: Vector) -> Scalar:
        """Return log2 of the largest magnitude in x, to within 0.09; -1023 for 0.0, at least 1024 for inf and nan."""

    def power(self, x: Scalar) -> Scalar:
        """Return 2^x with a relative error of 0.3 percent, for -1022 < x < 1023."""

    def least(self, x: Scalar, y: Scalar) -> Scalar:
        """Return the smaller of two scalars."""

    def largest(self, x: Scalar, y: Scalar) -> Scalar:
        """Return the larger of two scalars."""


Pair = tuple[Vector, Vector]
"""Vector in more than double precision: high and low part."""


def two_sum(o: Operations, x: Vector, z: Vector) -> Pair:
    """Return the rounded sum of two vectors and its rounding error."""
    rounded = o.add(x, z)
    part = o.sub(rounded, x)
    return rounded, o.add(o.sub(x, o.sub(rounded, part)), o.sub(z, part))


def pair_add(o: Operations, x: Pair, z: Pair) -> Pair:
    """Return the sum of two pairs."""
    rounded, missing = two_sum(o, x[0], z[0])
    return rounded, o.add(missing, o.add(x[1], z[1]))


def pair_mul(o: Operations, x: Pair, z: Pair) -> Pair:
    """Return the product of two pairs."""
    rounded, missing = pair_scale(o, x[0], z)
    return rounded, o.fma(x[1], z[0], missing)


def pair_scale(o: Operations, factor: Vector, x: Pair) -> Pair:
    """Return the product of an exact vector and a pair."""
    rounded = o.mul(factor, x[0])
    return rounded, o.fma(factor, x[1], o.fma(factor, x[0], o.negative(rounded)))
