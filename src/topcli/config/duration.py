"""The duration T of a run in place of its number of steps N."""

from __future__ import annotations

import math

TOLERANCE = 1e-9
"""Relative distance of T/h from a whole number that rounding of T and h may explain."""


def steps_of(T: float, h: float) -> tuple[int, str]:
    """Return N = T/h rounded, and the reason why there is no such N; the reason is empty if there is one.

    >>> steps_of(50.0, 0.001)
    (50000, '')
    """
    ratio = T / h if h else math.nan
    if not math.isfinite(ratio):
        return 0, f"T/h = {T!r}/{h!r} is not finite"
    N = round(ratio)
    if ratio < 0.0:
        return 0, f"T = {T!r} and h = {h!r} must have the same sign"
    if N < 1 or abs(ratio - N) > TOLERANCE * N:
        near = max(N, 1)
        return 0, f"T/h = {ratio:.10g} is not a whole number; the nearest N is {near} (T = {near * h:.10g})"
    return N, ""
