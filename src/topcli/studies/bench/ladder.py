"""Ladders: the settings of a scheme to measure, from coarse to fine."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from pydantic import BaseModel

from topcli.contracts import Array, Scheme
from topcli.errors import UsageError

TOLERANCES = ("tol", "rtol")
"""The ladder of an adaptive scheme varies the first of these options that it has, and ``atol`` in proportion."""
FIRST_TOLERANCE, LAST_TOLERANCE = 1e-2, 1e-18
RUNGS = 60
"""Largest number of rungs; a budget or round-off ends a ladder long before."""


@dataclass(frozen=True)
class Rung:
    """One setting: the ``value`` of h or of the tolerance, as ``steps`` in each interval and the ``options``."""

    value: float
    steps: int = 1
    options: tuple[tuple[str, float], ...] = ()


def _limits(model: type[BaseModel], key: str) -> tuple[float, float]:
    """Return the smallest and largest value that the declaration of an option allows."""
    low, high = 0.0, math.inf
    for constraint in model.model_fields[key].metadata:
        low = max(low, getattr(constraint, "ge", None) or 0.0, math.nextafter(getattr(constraint, "gt", None) or 0, 1))
        for name in ("le", "lt"):
            limit = getattr(constraint, name, None)
            high = high if limit is None else min(high, limit if name == "le" else math.nextafter(limit, 0))
    return low, high


def tolerance_option(scheme: Scheme) -> str | None:
    """Return the option that the ladder of an adaptive scheme varies; None for a scheme of fixed steps.

    Raises UsageError for an adaptive scheme without such an option.
    """
    if not scheme.adaptive:
        return None
    for name in TOLERANCES:
        if name in scheme.options.model_fields:
            return name
    raise UsageError(
        f"scheme {scheme.name!r} is adaptive and has no option {' or '.join(TOLERANCES)} to measure it over"
    )


def _tolerance_ladder(scheme: Scheme, name: str) -> Iterator[Rung]:
    """Yield half decades of the tolerance within its limits, and its smallest value."""
    low, high = _limits(scheme.options, name)
    least = max(low, LAST_TOLERANCE)
    values = [float(f"{mantissa}e{e}") for e in range(0, -400, -1) for mantissa in ("1", "0.32")]
    values = [v for v in values if least * (1.0 + 1e-9) < v <= min(high, FIRST_TOLERANCE)]
    fields = scheme.options.model_fields
    for value in [*values, least]:
        options = [(name, value)]
        if "atol" in fields and isinstance(fields["atol"].default, float) and isinstance(fields[name].default, float):
            lowest, highest = _limits(scheme.options, "atol")
            scaled = value * fields["atol"].default / fields[name].default
            options.append(("atol", min(max(scaled, lowest), highest)))
        yield Rung(value, 1, tuple(options))


def _step_ladder(order: int | None, y0: Array, interval: float) -> Iterator[Rung]:
    """Yield finer and finer steps that divide the interval, by a factor 2 up to order 2 and otherwise sqrt(2).

    The first is about four over the largest component of the state, an angle of four radians per step; nobody needs a
    coarser one.
    """
    ratio = 2.0 if order is not None and order <= 2 else math.sqrt(2.0)
    size = max(float(max(abs(y) for y in y0)), 1e-300)
    first = max(1.0, math.ceil(0.25 * interval * size))
    before = 0
    for k in range(RUNGS):
        steps = round(first * ratio**k)
        if steps > before and steps * interval < 2.0**52:
            yield Rung(interval / steps, steps)
            before = steps


def ladder(scheme: Scheme, y0: Array, interval: float) -> Iterator[Rung]:
    """Yield the rungs of ``scheme``, coarse to fine, from the state ``y0`` with a comparison every ``interval``.

    Steps h for a scheme of fixed steps; half decades of its tolerance for an adaptive one. Raises UsageError for an
    adaptive scheme that has none.
    """
    name = tolerance_option(scheme)
    if name is not None:
        return _tolerance_ladder(scheme, name)
    return _step_ladder(scheme.order, y0, interval)
