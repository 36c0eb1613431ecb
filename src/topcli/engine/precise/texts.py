"""Numbers as texts: exact ones for checkpoints, rounded ones for tables."""

from __future__ import annotations

import math
from decimal import Decimal
from fractions import Fraction


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
