"""Test whether a run left its energy surface while its state stayed finite (outcome ``left_motion``).

The energy of a top is the invariant that ``Top.energy`` names, or a multiple of it; a top without one is not judged.
A trajectory has left the motion as soon as a recorded state's energy differs from the first one's by more than
``LEAVING_FACTOR`` times its scale there, the sum of the magnitudes of its terms. Where these vanish or nearly do (at
rest with the centre of gravity level), the limit uses the largest scale that vectors of the same lengths can have along
the axes.
"""

from __future__ import annotations

import itertools
import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, Invariant, Top

LEAVING_FACTOR = 100.0


def energy_of(top: Top) -> Invariant | None:
    """Invariant of ``top`` that is its energy or a multiple of it; None for a top without one."""
    return next((invariant for invariant in top.invariants() if invariant.name == top.energy), None)


@cache
def _along_axes(vectors: tuple[tuple[int, int], ...], d: int) -> NDArray[np.bool_]:
    """For every choice of an axis for each vector, True at the components (d,) along these axes."""
    places = np.array(list(itertools.product(*(range(start, stop) for start, stop in vectors))))
    return (places[:, :, None] == np.arange(d)).any(axis=1)


def energy_limits(top: Top, states: Array) -> Array:
    """Deviations of the energy (m,) beyond which motions that start in ``states`` (m, d) have left it.

    Infinite for a top without energy and where the energy or its scale is not usable.
    """
    energy = energy_of(top)
    if energy is None:
        return np.full(len(states), math.inf)
    with np.errstate(all="ignore"):
        vectors = tuple(top.vectors.values())
        lengths, rest = np.zeros_like(states), states.copy()
        for start, stop in vectors:
            lengths[:, start:stop] = np.linalg.norm(states[:, start:stop], axis=1)[:, None]
            rest[:, start:stop] = 0.0
        turned = np.where(_along_axes(vectors, states.shape[1])[:, None], lengths, rest)
        tried = np.concatenate([states[None], turned])
        scales = energy.scale(tried.reshape(-1, states.shape[1])).reshape(tried.shape[:2])
        limits = np.maximum(LEAVING_FACTOR * scales[0], scales[1:].max(axis=0))
        judged = np.isfinite(limits) & (limits > 0.0) & np.isfinite(energy.value(states))
    return np.where(judged, limits, math.inf)


def first_beyond(deviation: Array, limit: float) -> int | None:
    """Index of the first ``deviation`` (m,) whose magnitude exceeds ``limit`` or is nan; None if there is none."""
    if math.isinf(limit):
        return None
    beyond = ~(np.abs(deviation) <= limit)
    return int(np.argmax(beyond)) if beyond.any() else None


class EnergyWatch:
    """Watch of one motion of ``top`` from ``y0`` (d,); ``left`` is the first recorded step beyond its limit."""

    def __init__(self, top: Top, y0: Array) -> None:
        start = np.array([y0], dtype=np.float64)
        self._energy, self._limit = energy_of(top), float(energy_limits(top, start)[0])
        self._first = float(self._energy.value(start)[0]) if self._energy and math.isfinite(self._limit) else 0.0
        self.left: int | None = None

    def add(self, n: NDArray[np.int64], states: Array) -> None:
        """Add rows: step numbers (m,) and states (m, d)."""
        if self.left is not None or self._energy is None or not len(n) or math.isinf(self._limit):
            return
        with np.errstate(all="ignore"):
            at = first_beyond(self._energy.value(states) - self._first, self._limit)
        if at is not None:
            self.left = int(n[at])


def step_of_leaving(top: Top, n: NDArray[np.int64], states: Array) -> int | None:
    """First of the step numbers ``n`` (m,) whose state (m, d) has left the motion; None if there is none.

    The first row is the initial state.
    """
    watch = EnergyWatch(top, states[0])
    watch.add(n, states)
    return watch.left
