"""Numbers that carry the size of their terms, which is the scale of round-off in a sum.

``Sized(x, abs(x))`` in place of ``x`` in a formula gives the value of the formula and, in ``size``, the same formula
with all terms positive. Round-off in the value is a few units in the last place of that size, however small the value.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np


class Operators:
    """Operators that follow from the sum, the product and the negative."""

    __slots__ = ()

    def __radd__(self, other: Any) -> Any:
        return self + other

    def __rmul__(self, other: Any) -> Any:
        return self * other

    def __pos__(self) -> Any:
        return self

    def __sub__(self, other: Any) -> Any:
        return self + -other

    def __rsub__(self, other: Any) -> Any:
        return -self + other  # pyright: ignore[reportOperatorIssue]


class Sized(Operators):
    """A number or array ``value`` with the ``size`` of its terms; it has the arithmetic of numbers."""

    __slots__ = ("size", "value")

    def __init__(self, value: Any, size: Any = None) -> None:
        self.value = value
        self.size = abs(value) if size is None else size

    @staticmethod
    def of(value: Any) -> Sized:
        """A number as it is if it is sized, else with its magnitude."""
        return value if isinstance(value, Sized) else Sized(value)

    def __add__(self, other: Any) -> Sized:
        added = Sized.of(other)
        return Sized(self.value + added.value, self.size + added.size)

    def __mul__(self, other: Any) -> Sized:
        factor = Sized.of(other)
        return Sized(self.value * factor.value, self.size * factor.size)

    def __neg__(self) -> Sized:
        return Sized(-self.value, self.size)

    def __truediv__(self, other: Any) -> Sized:
        divisor = Sized.of(other).value
        return Sized(self.value / divisor, self.size / abs(divisor))

    def __rtruediv__(self, other: Any) -> Sized:
        return Sized.of(other) / self

    def __pow__(self, exponent: Any) -> Sized:
        value = self.value**exponent
        return Sized(value, self.size**exponent if exponent >= 0 else abs(value))

    def __abs__(self) -> Sized:
        return Sized(abs(self.value), self.size)

    def __array_ufunc__(self, ufunc: Callable[..., Any], method: str, *inputs: Any, **options: Any) -> Sized:
        """The arithmetic of arrays with sized numbers, and functions: their terms are not looked into."""
        arithmetic = {
            np.add: lambda a, b: a + b,
            np.subtract: lambda a, b: a - b,
            np.multiply: lambda a, b: a * b,
            np.divide: lambda a, b: a / b,
        }
        if ufunc in arithmetic:
            return arithmetic[ufunc](*map(Sized.of, inputs))
        return Sized(ufunc(*(Sized.of(x).value for x in inputs)))
