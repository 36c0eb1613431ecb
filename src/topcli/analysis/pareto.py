"""Speed against error: the points that no other beats, and what a given error costs along a curve of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

MAX_GAP = 100.0
"""Between two points whose errors differ by more than this factor nothing is interpolated: the finer one counts."""


@dataclass(frozen=True)
class Point:
    """One measurement: the ``error`` reached, the ``seconds`` it took, and the ``setting`` (h or tolerance) it had."""

    error: float
    seconds: float
    setting: float


def pareto_front(points: Sequence[Point]) -> list[int]:
    """Indices of the points that no other beats or equals in both error and seconds, by falling error.

    Of equal points the first counts. Points whose error or seconds are not positive and finite are left out; an error
    of 0 is a finite one.
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
    """The geometric mean of two positive numbers with the weight ``share`` on ``high``."""
    return math.exp((1.0 - share) * math.log(low) + share * math.log(high))


def at_error(points: Sequence[Point], error: float) -> Point | None:
    """What the ``error`` (> 0) costs: a point of at most this error, interpolated on the front of ``points``.

    Straight lines in the logarithms, as errors are powers of h and of the tolerance. An error larger than that of the
    cheapest point costs what that point costs; one smaller than all is not reached: None. Across a gap wider than
    ``MAX_GAP`` the finer point is taken as it is.
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
