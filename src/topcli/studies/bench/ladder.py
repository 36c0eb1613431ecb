"""Ladders: the settings that a scheme is tried with, from coarse to fine."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from pydantic import BaseModel

from topcli.contracts import Array, Scheme
from topcli.errors import UsageError

TOLERANCES = ("tol", "rtol")
"""An adaptive scheme's ladder goes over the first of these options that it has; ``atol`` follows in proportion."""
FIRST_TOLERANCE, LAST_TOLERANCE = 1e-2, 1e-18
RUNGS = 60
"""At most so many rungs; long before that a budget or round-off ends a ladder."""


@dataclass(frozen=True)
class Rung:
    """One setting: the ``value`` of h or of the tolerance, as ``steps`` in each interval and the ``options``."""

    value: float
    steps: int = 1
    options: tuple[tuple[str, float], ...] = ()


def _limits(model: type[BaseModel], key: str) -> tuple[float, float]:
    """The least and the largest value that an option takes, as its declaration says."""
    low, high = 0.0, math.inf
    for constraint in model.model_fields[key].metadata:
        low = max(low, getattr(constraint, "ge", None) or 0.0, math.nextafter(getattr(constraint, "gt", None) or 0, 1))
        for name in ("le", "lt"):
            limit = getattr(constraint, name, None)
            high = high if limit is None else min(high, limit if name == "le" else math.nextafter(limit, 0))
    return low, high


def tolerance_option(scheme: Scheme) -> str | None:
    """The option that the ladder of an adaptive scheme goes over; None for a scheme of fixed steps.

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
    """Half decades of the tolerance within its limits, and the least that it may be."""
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


def _step_ladder(order: int, y0: Array, interval: float) -> Iterator[Rung]:
    """Finer and finer steps that divide the interval: by halves to order 2, by the root of it above.

    The first is some four over the largest component of the state, the angle of a step about four radians: coarser is
    of no use to anybody.
    """
    ratio = 2.0 if order <= 2 else math.sqrt(2.0)
    size = max(float(max(abs(y) for y in y0)), 1e-300)
    first = max(1.0, math.ceil(0.25 * interval * size))
    before = 0
    for k in range(RUNGS):
        steps = round(first * ratio**k)
        if steps > before and steps * interval < 2.0**52:
            yield Rung(interval / steps, steps)
            before = steps


def ladder(scheme: Scheme, y0: Array, interval: float) -> Iterator[Rung]:
    """The rungs of ``scheme`` for states that start at ``y0`` and are looked at every ``interval``, coarse to fine.

    Steps h for a scheme of fixed steps; half decades of its tolerance for an adaptive one. Raises UsageError for an
    adaptive scheme that has none.
    """
    name = tolerance_option(scheme)
    if name is not None:
        return _tolerance_ladder(scheme, name)
    return _step_ladder(scheme.order or 1, y0, interval)
