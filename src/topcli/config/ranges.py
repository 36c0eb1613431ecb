"""Lists and ranges of values for ensembles and sweeps, and the time ``T`` of a run, which gives N = T/h."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, BeforeValidator, Field, PlainValidator, model_validator

from topcli.config.document import STRICT, as_integer, describe, number_of, read_model
from topcli.errors import UsageError

MAX_SWEEP_ROWS = 10**7
EARLIER = {"start": "from", "stop": "to"}
"""Words for the ends of a range that are not read, each with the one that is."""
EXAMPLE = "[0.1, 0.2] or {from: 0.1, to: 1, count: 10}"


class Interval(BaseModel):
    """Interval from which a parameter of the top is drawn, uniform in the values or in their logarithms."""

    model_config = STRICT

    first: float = Field(alias="from", description="the first value")
    last: float = Field(alias="to", description="the last value")
    spacing: Literal["linear", "log"] = Field(default="linear", description="linear or logarithmic (log)")

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

    count: Annotated[int, Field(ge=1, le=MAX_SWEEP_ROWS), BeforeValidator(as_integer)] = Field(
        description="the number of values"
    )

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


def is_range(raw: object) -> bool:
    """True if ``raw`` is meant as a range."""
    return isinstance(raw, dict) and bool({"from", "to", "count", "spacing", *EARLIER} & raw.keys())


def read_axis(raw: object) -> list[Any] | Range:
    """Return a list of values or a range. Raises ValueError, also as pydantic's ValidationError."""
    if isinstance(raw, dict) and EARLIER.keys() & raw.keys():
        ends = {EARLIER.get(key, key): value for key, value in raw.items()}
        words = ", ".join(f"{key}: {value}" for key, value in ends.items() if not isinstance(value, (dict, list)))
        raise ValueError(f"a range has the keys from, to and count; write {{{words}}}")
    if is_range(raw):
        return read_model(Range, raw)
    if not isinstance(raw, list) or not raw:
        raise ValueError(f"must be a list of values or a range, not {describe(raw)}; for example {EXAMPLE}")
    return raw


def read_numbers(raw: object) -> list[float] | Range:
    """Return a list of finite numbers or a range. Raises as ``read_axis``."""
    axis = read_axis(raw)
    if isinstance(axis, Range):
        return axis
    numbers = [number_of(value) for value in axis]
    for value, number in zip(axis, numbers, strict=True):
        if number is None or not math.isfinite(number):
            raise ValueError(f"must be finite numbers, not {describe(value)}")
    return [number for number in numbers if number is not None]


_Listed = Annotated[list[float], Field(min_length=1)]
Numbers = Annotated[Any, PlainValidator(read_numbers, json_schema_input_type=_Listed | Range)]
"""Type of an axis of numbers."""


MAX_STEPS = 10**12
WHOLE_NUMBER = 4.0 * 2.0**-52
"""Relative deviation of T/h from a whole number that is accepted, for the rounding of T, h and their quotient."""


def duration_fault(h: float, N: int) -> str:
    """Reason why N steps of h cannot be run; empty if they can."""
    return "" if math.isfinite(N * h) else f"N*h = {N} * {h!r} is not finite; take fewer or smaller steps"


def steps_of(T: float, h: float, adapted: Literal["T", "h"] = "T") -> int:
    """Return the number of steps T/h, a whole number within round-off (4 ulp).

    >>> steps_of(50, 0.001)
    50000

    Raises UsageError with the nearest values that fit of the one of the two that is ``adapted``.
    """
    N = _whole(T, h)
    if N is not None:
        return N
    ratio = T / h
    if not 0.0 < ratio <= MAX_STEPS:
        raise UsageError(f"T/h = {T:g}/{h:g} = {ratio:.6g} steps; must be from 1 to {MAX_STEPS}")
    counts = [N for N in (math.floor(ratio), math.floor(ratio) + 1) if 1 <= N <= MAX_STEPS]
    near = " or ".join(f"{adapted} = {_shortest(T, h, N, adapted)} (N = {N})" for N in counts)
    raise UsageError(f"T/h = {T:g}/{h:g} = {ratio:.9g} is not a whole number of steps; nearest: {near}")


def _whole(T: float, h: float) -> int | None:
    """Number of steps T/h; None if it is not a whole number from 1 to ``MAX_STEPS`` within round-off."""
    ratio = T / h
    if not 0.5 <= ratio <= MAX_STEPS + 0.5:
        return None
    N = round(ratio)
    return N if 1 <= N <= MAX_STEPS and abs(ratio - N) <= WHOLE_NUMBER * N else None


def _shortest(T: float, h: float, N: int, adapted: str) -> str:
    """Fewest digits of the T or h that gives N steps."""
    value = N * h if adapted == "T" else T / N
    texts = (f"{value:.{digits}g}" for digits in range(6, 18))
    return next(text for text in texts if (_whole(float(text), h) if adapted == "T" else _whole(T, float(text))) == N)
