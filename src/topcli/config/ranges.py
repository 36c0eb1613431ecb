"""Lists and ranges of values for ensembles and sweeps, and the time ``T`` of a run, which gives N = T/h."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, BeforeValidator, Field, model_validator

from topcli.config.document import STRICT, Document, as_integer, describe
from topcli.errors import UsageError

MAX_SWEEP_ROWS = 10**7
EXAMPLE = "[0.1, 0.2] or {from: 0.1, to: 1, count: 10}"


class Interval(BaseModel):
    """Interval from which a parameter of the top is drawn, uniform in the values or in their logarithms."""

    model_config = STRICT

    first: float = Field(alias="from")
    """the first value"""
    last: float = Field(alias="to")
    """the last value"""
    spacing: Literal["linear", "log"] = "linear"
    """linear or logarithmic (log)"""

    @model_validator(mode="after")
    def check_signs(self) -> Self:
        """Refuse logarithms of numbers of different signs."""
        if self.spacing == "log" and not self.first * self.last > 0.0:
            ends = f"{self.first!r} and {self.last!r}"
            raise ValueError(f"from and to must be both positive or both negative for spacing: log, not {ends}")
        return self

    def value(self, share: float) -> float:
        """Value at ``share`` (0 to 1) of the way, rounded to 15 digits.

        The rounding makes the values independent of the machine's logarithms, and 0.001 of 0.0010000000000000002.
        """
        first, last = self.first, self.last
        if self.spacing == "log":
            value = math.copysign(math.exp(math.log(abs(first)) * (1.0 - share) + math.log(abs(last)) * share), first)
        else:
            value = first * (1.0 - share) + last * share
        return float(f"{value:.15g}")


class Range(Interval):
    """Evenly spaced values, both ends included."""

    count: Annotated[int, Field(ge=1, le=MAX_SWEEP_ROWS), BeforeValidator(as_integer)]
    """the number of values"""

    @model_validator(mode="after")
    def check_ends(self) -> Self:
        """Refuse several values without two ends."""
        if self.count > 1 and self.first == self.last:
            raise ValueError(f"from and to are both {self.first!r}; a range of {self.count} values needs two ends")
        return self

    def values(self) -> list[float]:
        """Return the values in order."""
        inner = (self.value(i / (self.count - 1)) for i in range(1, self.count - 1))
        return [self.first, *inner, self.last][: self.count]

    def spaced(self) -> list[float]:
        """Return the values of an ensemble; those of a linear range have all their digits, as in ``numpy.linspace``."""
        return self.values() if self.spacing == "log" else np.linspace(self.first, self.last, self.count).tolist()


def is_range(raw: object) -> bool:
    """True if ``raw`` is meant as a range."""
    return isinstance(raw, dict) and not raw.keys().isdisjoint(("from", "to", "count", "spacing"))


def read_axis(raw: object, document: Document, *path: str | int) -> list[Any] | Range:
    """Return a list of values or a range, at ``path``."""
    if is_range(raw):
        return document.read(Range, raw, *path)
    if isinstance(raw, list) and raw:
        return raw
    document.fault(path, f"must be a list of values or a range, not {describe(raw)}; for example {EXAMPLE}")


MAX_STEPS = 10**12
WHOLE_NUMBER = 4.0 * 2.0**-52
"""Relative deviation of T/h from a whole number that is accepted, for the rounding of T, h and their quotient."""


def steps_of(T: float, h: float, adapted: Literal["T", "h"] = "T") -> int:
    """Return the number of steps T/h, a whole number within round-off (4 ulp).

    >>> steps_of(50, 0.001)
    50000

    Raises UsageError with the nearest values that fit of the one of the two that is ``adapted``.
    """
    ratio = T / h
    if 0.5 <= ratio <= MAX_STEPS + 0.5 and abs(ratio - (N := round(ratio))) <= WHOLE_NUMBER * N:
        return N
    if not 0.0 < ratio <= MAX_STEPS:
        raise UsageError(f"T/h = {T:g}/{h:g} = {ratio:.6g} steps; must be from 1 to {MAX_STEPS}")
    counts = [N for N in (math.floor(ratio), math.floor(ratio) + 1) if 1 <= N <= MAX_STEPS]
    near = " or ".join(f"{adapted} = {_shortest(T, h, N, adapted)} (N = {N})" for N in counts)
    raise UsageError(f"T/h = {T:g}/{h:g} = {ratio:.9g} is not a whole number of steps; nearest: {near}")


def _shortest(T: float, h: float, N: int, adapted: str) -> str:
    """Fewest digits of the T or h that gives N steps."""
    value = N * h if adapted == "T" else T / N
    texts = (f"{value:.{digits}g}" for digits in range(6, 18))
    ratios = ((text, float(text) / h if adapted == "T" else T / float(text)) for text in texts)
    return next((text for text, ratio in ratios if abs(ratio - N) <= WHOLE_NUMBER * N), f"{value:g}")
