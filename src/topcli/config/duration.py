"""The time ``T`` to run, given in the place of the number of steps ``N``: N = T/h."""

from __future__ import annotations

import math
from collections.abc import Callable

from topcli.errors import UsageError

MAX_STEPS = 10**12
ROUND_OFF = 4.0 * 2.0**-52
"""Relative deviation of T/h from a whole number that is accepted, for the rounding of T, h and their quotient."""


def duration_fault(h: float, N: int) -> str:
    """Reason why N steps of h cannot be run; empty if they can."""
    return "" if math.isfinite(N * h) else f"N*h = {N} * {h!r} is not finite; take fewer or smaller steps"


def steps_of(T: float, h: float) -> int:
    """Return the number of steps T/h, a whole number within round-off (4 ulp).

    >>> steps_of(50, 0.001)
    50000

    Raises UsageError with the nearest T that fit.
    """
    N = _whole(T, h)
    if N is not None:
        return N
    ratio = T / h
    if ratio < 0.0:
        raise UsageError(f"must have the sign of h = {h:g}, not {T:g}")
    if not ratio <= MAX_STEPS:
        raise UsageError(f"T/h = {T:g}/{h:g} = {ratio:.6g} steps; must be at most {MAX_STEPS}")
    counts = [N for N in (math.floor(ratio), math.floor(ratio) + 1) if 1 <= N <= MAX_STEPS]
    near = " or ".join(f"T = {_shortest(N * h, lambda T, N=N: _whole(T, h) == N)} (N = {N})" for N in counts)
    raise UsageError(f"T/h = {T:g}/{h:g} = {ratio:.9g} is not a whole number of steps; nearest: {near}")


def steps_over(T: float, h: float) -> int:
    """Return the number of steps T/h where h is to be adapted to a given T. Raises UsageError with the nearest h."""
    N = _whole(T, h)
    if N is not None:
        return N
    ratio = T / h
    if not 0.0 < ratio <= MAX_STEPS:
        return steps_of(T, h)
    counts = [N for N in (math.floor(ratio) + 1, math.floor(ratio)) if 1 <= N <= MAX_STEPS]
    near = " or ".join(f"h = {_shortest(T / N, lambda h, N=N: _whole(T, h) == N)} (N = {N})" for N in counts)
    raise UsageError(f"T/h = {T:g}/{h:g} = {ratio:.9g} is not a whole number of steps; nearest: {near}")


def _whole(T: float, h: float) -> int | None:
    """Number of steps T/h; None if it is not a whole number from 1 to ``MAX_STEPS`` within round-off."""
    ratio = T / h
    if not 0.5 <= ratio <= MAX_STEPS + 0.5:
        return None
    N = round(ratio)
    return N if 1 <= N <= MAX_STEPS and abs(ratio - N) <= ROUND_OFF * N else None


def _shortest(value: float, fits: Callable[[float], bool]) -> str:
    """Return the fewest digits of ``value`` that still fit."""
    texts = (f"{value:.{digits}g}" for digits in range(6, 17))
    return next((text for text in texts if fits(float(text))), repr(value))
