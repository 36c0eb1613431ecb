"""Meaning of the constants of the source code in numbers other than doubles, and numbers as texts.

A constant of the source code stands for what its author meant: 0.1 is one tenth, and 1/6, which Python's compiler
replaces by the nearest double, is one sixth. A double that meets such a number later is accepted only if it is a short
binary fraction (0.5, 2.0), which means the same in every arithmetic; any other double would bring in an error of 1e-17
unnoticed, and is refused.
"""

from __future__ import annotations

import math
from decimal import Decimal
from fractions import Fraction
from functools import cache

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


def exact_text(value: Fraction) -> str:
    """Text from which ``Fraction`` makes the same number, hexadecimal for large ones, whose conversion is fast."""
    return f"{value.numerator:x}/{value.denominator:x}"


def from_exact_text(text: str) -> Fraction:
    """Number that ``exact_text`` has written."""
    numerator, denominator = text.split("/")
    return Fraction(int(numerator, 16), int(denominator, 16))


def integer_text(value: int) -> str:
    """Decimal text of an integer of any length; ``str`` refuses those of more than 4300 digits."""
    return format(Decimal(value), "f")


def fraction_from(text: str) -> Fraction:
    """Number of a decimal text or of a quotient of integers, of any length."""
    numerator, slash, denominator = text.partition("/")
    number = Fraction(Decimal(numerator))
    return number / Fraction(Decimal(denominator)) if slash else number


def decimal_text(value: Fraction, digits: int) -> str:
    """Decimal form of a number, correctly rounded to ``digits`` significant digits: ``-1.25e-1``."""
    if not value:
        return "0." + "0" * (digits - 1) + "e+0"
    size = abs(value)
    exponent = math.floor((size.numerator.bit_length() - size.denominator.bit_length()) * math.log10(2.0))
    while size >= Fraction(10) ** (exponent + 1):
        exponent += 1
    while size < Fraction(10) ** exponent:
        exponent -= 1
    whole = round(size / Fraction(10) ** (exponent - digits + 1))
    if whole == 10**digits:
        whole, exponent = whole // 10, exponent + 1
    text = integer_text(whole)
    return f"{'-' if value < 0 else ''}{text[0]}.{text[1:]}e{exponent:+d}"
