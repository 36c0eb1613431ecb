"""Pareto front of speed and error, and the cost of a given error on it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

MAX_GAP = 100.0
"""Largest ratio of errors of two neighbouring points that are interpolated; beyond it, the finer one counts."""


@dataclass(frozen=True)
class Point:
    """One measurement: the ``error`` reached, the ``seconds`` taken, and the ``setting`` (h or tolerance)."""

    error: float
    seconds: float
    setting: float


def pareto_front(points: Sequence[Point]) -> list[int]:
    """Indices of the points that no other beats or equals in both error and seconds, by decreasing error.

    The first of equal points counts. Points whose error or seconds are not positive and finite are left out; an error
    of 0 is kept.
    """
    usable = [
        i
        for i, point in enumerate(points)
        if math.isfinite(point.error) and point.error >= 0.0 and 0.0 < point.seconds < math.inf
    ]
    front: list[int] = []
    best = math.inf
    for i in sorted(usable, key=lambda i: (points[i].seconds, points[i].error, i)):
        if points[i].error < best:
            best = points[i].error
            front.append(i)
    return front


def _between(low: float, high: float, share: float) -> float:
    """Geometric mean of two positive numbers with the weight ``share`` on ``high``."""
    return math.exp((1.0 - share) * math.log(low) + share * math.log(high))


def at_error(points: Sequence[Point], error: float) -> Point | None:
    """Point of at most the given ``error`` (> 0), interpolated on the front of ``points``.

    The interpolation is linear in the logarithms, as errors are powers of h and of the tolerance. For an error larger
    than that of the cheapest point, it is that point; for one smaller than all, None. Across a gap wider than
    ``MAX_GAP`` it is the finer point.
    """
    front = [points[i] for i in pareto_front(points)]
    if not front or front[-1].error > error:
        return None
    if front[0].error <= error:
        return front[0]
    fine = next(i for i, point in enumerate(front) if point.error <= error)
    a, b = front[fine - 1], front[fine]
    if b.error == 0.0 or a.error > MAX_GAP * b.error or not (a.setting > 0.0 and b.setting > 0.0):
        return b
    share = math.log(a.error / error) / math.log(a.error / b.error)
    return Point(error, _between(a.seconds, b.seconds, share), _between(a.setting, b.setting, share))
