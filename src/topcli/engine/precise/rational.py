"""Rational numbers: arithmetic without rounding."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from fractions import Fraction
from types import ModuleType
from typing import Any

from topcli.contracts import heed_stop
from topcli.engine.precise.numbers import (
    RATIONAL,
    NotRationalError,
    StrayDoubleError,
    gmpy2_if_installed,
    is_short,
    meaning,
)
from topcli.engine.precise.texts import integer_text
from topcli.errors import shortened

_longest: ContextVar[int] = ContextVar("longest", default=0)
"""Binary digits that no number may exceed; 0 for no limit."""


class TooLongError(ArithmeticError):
    """A number longer than the limit of ``at_most``."""


@contextmanager
def at_most(bits: int) -> Iterator[None]:
    """Raise TooLongError for a number whose numerator or denominator has more than ``bits`` binary digits.

    The numbers of a composed step may grow by a power of ten thousands within that step, so a limit that is looked at
    after the step comes too late.
    """
    token = _longest.set(bits)
    try:
        yield
    finally:
        _longest.reset(token)


LONG = 1 << 14
"""Binary digits from which on an operation takes so long that each one heeds a request to stop."""


class Exact:
    """Rational number that refuses doubles other than short binary fractions."""

    __slots__ = ("q",)

    def __init__(self, q: Any) -> None:
        self.q = q
        if q.denominator.bit_length() > LONG:
            heed_stop()
        if (limit := _longest.get()) and self.length > limit:
            raise TooLongError(f"{self.length} binary digits")

    def _other(self, other: Any) -> Any:
        if type(other) is Exact:
            return other.q
        if isinstance(other, int):
            return other
        if isinstance(other, float):
            if not is_short(other):
                raise StrayDoubleError(other)
            return Fraction(other)
        return NotImplemented

    def __add__(self, other: Any) -> Any:
        value = self._other(other)
        return NotImplemented if value is NotImplemented else Exact(self.q + value)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        value = self._other(other)
        return NotImplemented if value is NotImplemented else Exact(self.q - value)

    def __rsub__(self, other: Any) -> Any:
        value = self._other(other)
        return NotImplemented if value is NotImplemented else Exact(value - self.q)

    def __mul__(self, other: Any) -> Any:
        value = self._other(other)
        return NotImplemented if value is NotImplemented else Exact(self.q * value)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        value = self._other(other)
        return NotImplemented if value is NotImplemented else Exact(self.q / value)

    def __rtruediv__(self, other: Any) -> Any:
        value = self._other(other)
        return NotImplemented if value is NotImplemented else Exact(value / self.q)

    def __pow__(self, power: int) -> Exact:
        if not isinstance(power, int):
            raise NotRationalError(f"the power {power!r} of a rational number is not rational")
        return Exact(self.q**power)

    def __neg__(self) -> Exact:
        return Exact(-self.q)

    def __pos__(self) -> Exact:
        return self

    def __abs__(self) -> Exact:
        return Exact(abs(self.q))

    def __eq__(self, other: object) -> bool:
        return bool(self.q == self._other(other))

    def __hash__(self) -> int:
        return hash(self.q)

    def __lt__(self, other: Any) -> bool:
        return bool(self.q < self._other(other))

    def __le__(self, other: Any) -> bool:
        return bool(self.q <= self._other(other))

    def __gt__(self, other: Any) -> bool:
        return bool(self.q > self._other(other))

    def __ge__(self, other: Any) -> bool:
        return bool(self.q >= self._other(other))

    def __bool__(self) -> bool:
        return bool(self.q)

    def __float__(self) -> float:
        try:
            return float(self.q)
        except OverflowError:
            return math.inf if self.q > 0 else -math.inf

    def __int__(self) -> int:
        return int(self.q)

    def __repr__(self) -> str:
        return f"Exact({self.q})"

    @property
    def length(self) -> int:
        """Binary digits of the numerator or of the denominator, whichever is longer."""
        return max(self.q.numerator.bit_length(), self.q.denominator.bit_length())


class Rationals:
    """Arithmetic without rounding; the numbers are gmpy2's where it is installed, otherwise Python's fractions."""

    name = RATIONAL
    eps = 0.0
    bits = 0

    def __init__(self) -> None:
        gmpy2 = gmpy2_if_installed()
        self._made: Callable[[int, int], Any] = gmpy2.mpq if gmpy2 else Fraction
        self.library = f"gmpy2 {gmpy2.version()}" if gmpy2 else "fractions"
        self.math = ModuleType("math")
        self.math.__dict__.update(fabs=abs)

    def active(self) -> AbstractContextManager[Any]:
        """Context without effect."""
        return nullcontext()

    def number(self, value: Fraction) -> Exact:
        """The number itself."""
        return Exact(self._made(value.numerator, value.denominator))

    def fma(self, a: Any, b: Any, c: Any) -> Any:
        """Return a b + c."""
        return a * b + c

    def finite(self, x: Any) -> bool:
        """True: every rational number is finite."""
        return True

    def root(self, x: Any) -> Exact:
        """Square root of the square of a rational number; raises NotRationalError for any other."""
        value = self.fraction(x)
        parts = math.isqrt(max(value.numerator, 0)), math.isqrt(value.denominator)
        if Fraction(*parts) ** 2 != value:
            below = "" if value.denominator == 1 else f"/{integer_text(value.denominator)}"
            text = shortened(f"{integer_text(value.numerator)}{below}")
            raise NotRationalError(f"the square root of {text} is not rational")
        return self.number(Fraction(*parts))

    def fraction(self, x: Any) -> Fraction:
        """Value as Python's fraction."""
        value = x.q if isinstance(x, Exact) else x
        return Fraction(int(value.numerator), int(value.denominator))

    def tolerance(self, value: float, power: float) -> Exact:
        """The tolerance itself: there is no rounding error that it could follow."""
        return self.number(meaning(value))

    def cap(self, value: int) -> int:
        """The same number of iterations."""
        return value
