"""Numbers other than doubles: binary floating point of any precision (mpmath) and rational numbers.

A constant of the source code stands for what its author meant: 0.1 is one tenth, and 1/6, which Python's compiler
replaces by the nearest double, is one sixth. A double that meets such a number later is accepted only if it is a short
binary fraction (0.5, 2.0), which means the same in every arithmetic; any other double would bring in an error of 1e-17
unnoticed, and is refused.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager
from fractions import Fraction
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any, Protocol

from topcli.errors import UsageError

DOUBLE, RATIONAL = "double", "rational"
FEWEST_DIGITS, MOST_DIGITS = 18, 150
"""Range of ``precision``. Deviations are reported as doubles; the squares of those beyond it would underflow."""
MAX_DIGITS = 10_000
"""Default number of digits at which a run in rational numbers stops."""
SHORT = 2**20
"""Bound on the odd part of the numerator of a short binary fraction."""
DENOMINATOR = 1000
"""Largest denominator of a constant that the compiler has folded."""
FUNCTIONS = frozenset(
    ("acos", "asin", "atan", "atan2", "cbrt", "cos", "cosh", "exp", "hypot", "log", "sin", "sinh", "tan", "tanh")
)
IRRATIONAL = FUNCTIONS | {"sqrt", "pow", "pi", "e", "nan", "inf", "isnan", "isfinite"}
"""Attributes of ``math`` that rational numbers do not have."""


class NotRationalError(UsageError):
    """A step that cannot be taken in rational numbers (exit code 2)."""


def is_short(value: float) -> bool:
    """True if a double is a binary fraction with a short numerator, such as 0.5 or 2.0**-52."""
    if not math.isfinite(value):
        return False
    numerator = abs(value.as_integer_ratio()[0])
    return numerator < SHORT or numerator // (numerator & -numerator) < SHORT


@cache
def meaning(value: float) -> Fraction:
    """Rational number that a constant of the source code stands for."""
    if is_short(value):
        return Fraction(value)
    simple = Fraction(value).limit_denominator(DENOMINATOR)
    return simple if float(simple) == value else Fraction(repr(value))


class StrayDoubleError(UsageError):
    """A double that is no short binary fraction met a number of another arithmetic (exit code 2)."""

    def __init__(self, value: float) -> None:
        super().__init__(f"precision: the double {float(value)!r}, computed somewhere, has no exact meaning")


class Arithmetic(Protocol):
    """Operations that a run needs beside those of the numbers themselves."""

    name: str
    eps: float
    """Rounding error, as ``sys.float_info.epsilon`` for doubles; 0 for rational numbers."""
    bits: int
    """Binary digits; 0 for rational numbers."""
    math: ModuleType
    """Replacement for the module ``math``."""
    library: str
    """Package that computes, with its version."""

    def active(self) -> AbstractContextManager[Any]:
        """Context in which the numbers compute with this precision."""
        ...

    def number(self, value: Fraction) -> Any:
        """Number nearest to ``value``."""
        ...

    @property
    def fma(self) -> Callable[[Any, Any, Any], Any]:
        """Function a b + c, rounded once."""
        ...

    @property
    def finite(self) -> Callable[[Any], bool]:
        """Function that is true of a number that is neither infinite nor nan."""
        ...

    @property
    def root(self) -> Callable[[Any], Any]:
        """Square root; raises NotRationalError if it is not rational."""
        ...

    def fraction(self, x: Any) -> Fraction:
        """Exact value of a finite number."""
        ...

    def tolerance(self, value: float, power: float) -> Any:
        """Tolerance for doubles, scaled as the given power of the rounding error."""
        ...

    def cap(self, value: int) -> int:
        """Maximum number of iterations for doubles, scaled with the number of digits."""
        ...


def gmpy2_if_installed() -> Any:
    """Module gmpy2; None if it is not installed."""
    try:
        return import_module("gmpy2")
    except ImportError:
        return None
