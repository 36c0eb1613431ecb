"""Numbers of a config as they are written, for precisions other than double.

A number may have any number of digits, and may be a fraction such as 1/3. ``auto`` and ``normalize`` are carried out
with a few digits more than the precision of the run.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from decimal import Context, Decimal
from fractions import Fraction
from typing import Any

from topcli.config.document import Document
from topcli.config.text import WrittenFloat
from topcli.contracts import Top
from topcli.engine.numbers import NotRationalError
from topcli.errors import shortened

_NUMBER = re.compile(r"[-+]?(\d+/0*[1-9]\d*|(\.\d+|\d+(\.\d*)?)([eE][-+]?\d{1,3})?)")
GUARD = 5
"""Decimal digits beyond the precision with which a completed component is written."""


@dataclass(frozen=True)
class WrittenNumbers:
    """Step size, parameters of the top, and initial state, as they are written."""

    h: Fraction
    parameters: Mapping[str, Fraction]
    y0: tuple[Fraction, ...]

    def resolved(self, top: Top) -> dict[str, Any]:
        """Return the sections h, top and initial of a config; numbers that are not short decimals are texts."""
        parameters = {name: shown(value) for name, value in self.parameters.items()}
        return {
            "h": shown(self.h),
            "top": top.section(parameters),
            "initial": top.initial_section([shown(x) for x in self.y0]),
        }


def shown(value: Fraction) -> float | str:
    """Return a number as a float, if its shortest decimal text is exact, or as a text from which it can be read."""
    with suppress(OverflowError):
        if Fraction(repr(float(value))) == value:
            return float(value)
    quotient = f"{_integer(value.numerator)}/{_integer(value.denominator)}"
    decimal = _rounded(value, len(quotient))
    return str(decimal.normalize(Context(prec=len(quotient)))) if Fraction(decimal) == value else quotient


def _integer(value: int) -> str:
    """Decimal text of an integer of any length; ``str`` refuses those of more than 4300 digits."""
    return format(Decimal(value), "f")


def fraction_from(text: str) -> Fraction:
    """Number of a decimal text or of a quotient of integers, of any length."""
    numerator, slash, denominator = text.partition("/")
    number = Fraction(Decimal(numerator))
    return number / Fraction(Decimal(denominator)) if slash else number


def _rounded(value: Fraction, digits: int) -> Decimal:
    """Number rounded to significant decimal ``digits``."""
    return Context(prec=digits).divide(Decimal(value.numerator), Decimal(value.denominator))


def root_of(value: Fraction, precision: int | str) -> Fraction:
    """Square root to ``GUARD`` digits more than the precision. Raises NotRationalError if it must be rational."""
    if isinstance(precision, int):
        digits = precision + GUARD
        return Fraction(Context(prec=digits).sqrt(_rounded(value, 2 * digits)))
    root = Fraction(math.isqrt(value.numerator), math.isqrt(value.denominator))
    if root * root != value:
        text = shortened(_integer(value.numerator) + f"/{_integer(value.denominator)}" * (value.denominator != 1))
        hint = "write a unit vector of rational numbers, such as [0.6, 0, 0.8] or [2/7, 3/7, 6/7]"
        raise NotRationalError(f"the square root of {text} is not rational; {hint}")
    return root


def with_written_numbers(value: Any) -> Any:
    """Copy of plain data in which texts that are numbers are numbers that know their text."""
    if isinstance(value, dict):
        return {key: with_written_numbers(item) for key, item in value.items()}
    if isinstance(value, list):
        return [with_written_numbers(item) for item in value]
    if isinstance(value, str) and _NUMBER.fullmatch(value):
        with suppress(OverflowError):  # too large for a double, which a fault will say
            number = WrittenFloat(float(fraction_from(value)))
            number.text = value
            return number
    return value


def fraction_of(value: float) -> Fraction:
    """Number as it is written in the config."""
    return fraction_from(value.text if isinstance(value, WrittenFloat) else repr(value))


def read_written(
    data: Mapping[str, Any], top: Top, y0: Sequence[float], precision: int | str, document: Document
) -> WrittenNumbers:
    """Return the numbers of a valid config, whose initial state in doubles is ``y0``; faults of vectors are added."""
    declared, initial = top.parameters_in(data["top"]), data["initial"]
    parameters = {
        name: fraction_of(declared[name] if isinstance(declared.get(name), int | float) else value)
        for name, value in top.model_dump().items()
        if isinstance(value, float)
    }
    state = list(map(fraction_of, y0))
    for name, (start, stop) in top.vectors.items():
        raw = initial[name] if isinstance(initial[name], list) else [initial[name]]
        vector = [Fraction(0) if isinstance(value, str) else fraction_of(value) for value in raw]
        auto = next((index for index, value in enumerate(raw) if isinstance(value, str)), None)
        square = sum((value * value for value in vector), Fraction(0))
        with document.at("initial", name):
            if auto is not None:
                root = root_of(max(1 - square, Fraction(0)), precision)
                vector[auto] = root if y0[start + auto] >= 0.0 else -root
            elif name in top.unit_vectors and initial.get("normalize"):
                length = root_of(square, precision)
                vector = [value / length for value in vector]
        state[start:stop] = vector
    return WrittenNumbers(fraction_of(data["h"]), parameters, tuple(state))
