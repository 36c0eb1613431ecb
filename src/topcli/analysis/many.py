"""Deviations of the invariants of each trajectory of an ensemble, accumulated piece by piece.

They are, for every trajectory and invariant: the first value; the largest and the root mean square deviation from it
over the recorded rows; the deviation at the end; its drift; and a flag for a largest deviation within the round-off
bound of ``analysis.drift``. The memory does not depend on the number of steps.
"""

from __future__ import annotations

import errno
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.drift import BLOCKS, hann_line, round_off_bound
from topcli.analysis.leaving import energy_limits, first_beyond
from topcli.contracts import Array, Invariant, Top

Spool = io.BufferedRandom | io.BytesIO
QUANTILES = {"min": 0.0, "5 %": 0.05, "median": 0.5, "95 %": 0.95, "max": 1.0}
MEASURES = ("max_deviation", "rms_deviation", "final_deviation")


class BlockSums:
    """Sums of deviations (invariants, trajectories) over the blocks of a run whose ``last`` recorded step is known.

    Each sum adds its rows one after the other, so that its bits do not depend on the pieces in which they come.
    """

    def __init__(self, shape: tuple[int, int], last: int) -> None:
        self._width, self._last = 1, last
        while last // self._width >= 2 * BLOCKS:
            self._width *= 2
        self._sums = np.zeros((*shape, 2 * BLOCKS))

    def add(self, i: int, first: int, n: NDArray[np.int64], deviation: Array) -> None:
        """Add rows of invariant ``i``: steps ``n`` (m,), ``deviation`` (trajectories, m) of those from ``first`` on."""
        count, size = len(deviation), 2 * BLOCKS
        sums = self._sums[i, first : first + count]
        before = np.arange(count * size)
        places = np.arange(count)[:, None] * size + n // self._width
        sums[:] = np.bincount(
            np.concatenate([before, places.ravel()]), weights=np.concatenate([sums.ravel(), deviation.ravel()])
        ).reshape(count, size)

    def slopes(self, every: int, h: float) -> Array:
        """Slopes of the lines fitted to the means over the blocks; nan for fewer than 8 blocks.

        The rows are those of every ``every``-th step, up to the last.
        """
        found = np.full(self._sums.shape[:2], np.nan)
        edges = -(-np.arange(2 * BLOCKS + 1) * self._width // every)  # first row of each block
        edges = np.minimum(edges, self._last // every + 1)
        counts = np.diff(edges)
        filled = counts > 0
        line = hann_line(0.5 * (every * (edges[:-1] + edges[1:] - 1))[filled] * h)
        if line is not None:
            # one by one, because a product of matrices rounds differently from one of vectors
            for place in np.ndindex(*found.shape):
                found[place] = line[1] @ (self._sums[place][filled] / counts[filled])
        return found


class EnsembleTally:
    """Deviations of ``invariants`` along ``count`` trajectories, fed with pieces of rows in the order of time.

    With the ``top``, ``left`` (count,) are the first recorded steps at which each state has left its energy surface, -1
    for never. With the number ``last`` of the last step that is recorded, ``slopes`` fits the drifts. Different
    trajectories may be added from different threads.
    """

    def __init__(
        self, invariants: Sequence[Invariant], count: int, top: Top | None = None, last: int | None = None
    ) -> None:
        self.invariants, self._top = tuple(invariants), top
        self._limit = np.full(count, np.inf)
        self.left = np.full(count, -1, dtype=np.int64)
        shape = (len(self.invariants), count)
        self.first = np.full(shape, np.nan)
        self.max_deviation, self._squares, self._scale = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        self.final_deviation = np.full(shape, np.nan)
        self._rows, self._steps = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
        self._blocks = None if last is None else BlockSums(shape, last)

    def add(
        self,
        first: int,
        n: NDArray[np.int64],
        states: Array,
        kept: NDArray[np.int64],
        values: Mapping[str, Array] | None = None,
    ) -> None:
        """Add rows of the trajectories from ``first`` on: step numbers (m,), states (trajectories, m, d).

        Only the first ``kept[i]`` rows of each count. A trajectory's very first row is its reference. ``values``
        (trajectories * m,) are those of the invariants by name, if they have been evaluated before.
        """
        count, m, d = states.shape
        if not m:
            return
        here = slice(first, first + count)
        beyond = None if (kept == m).all() else np.arange(m) >= kept[:, None]
        flat = np.ascontiguousarray(states).reshape(count * m, d)
        fresh = (self._rows[here] == 0) & (kept > 0)
        with np.errstate(all="ignore"):  # huge states give figures that are not finite
            for i, invariant in enumerate(self.invariants):
                found = (invariant.value(flat) if values is None else values[invariant.name]).reshape(count, m)
                self.first[i, here] = np.where(fresh, found[:, 0], self.first[i, here])
                deviation = found - self.first[i, here, None]
                scale = invariant.scale(flat).reshape(count, m)
                if beyond is not None:
                    deviation[beyond] = 0.0
                    scale[beyond] = 0.0
                largest = np.maximum(deviation.max(axis=1), -deviation.min(axis=1))
                self.max_deviation[i, here] = np.maximum(self.max_deviation[i, here], largest)
                if self._top is not None and invariant.name == self._top.energy:
                    if fresh.any():
                        self._limit[here] = np.where(fresh, energy_limits(self._top, states[:, 0]), self._limit[here])
                    self._note_leaving(first, n, deviation, ~(largest <= self._limit[here]))
                if self._blocks is not None:
                    self._blocks.add(i, first, n, deviation)
                self._scale[i, here] = np.maximum(self._scale[i, here], scale.max(axis=1))
                self._squares[i, here] += np.einsum("ij,ij->i", deviation, deviation)
        self._rows[here] += kept
        self._steps[here] = np.where(kept > 0, n[np.maximum(kept, 1) - 1], self._steps[here])

    def _note_leaving(self, first: int, n: NDArray[np.int64], deviation: Array, over: NDArray[np.bool_]) -> None:
        """Store the leaving step of the trajectories ``over`` their limit that have not left before."""
        for j in np.flatnonzero(over & (self.left[first : first + len(over)] < 0)).tolist():
            at = first_beyond(deviation[j], float(self._limit[first + j]))
            if at is not None:
                self.left[first + j] = n[at]

    def finish(self, states: Array) -> None:
        """Compute the final deviations from the last states (trajectories, d).

        All figures of a trajectory that was never begun become nan.
        """
        with np.errstate(all="ignore"):
            for i, invariant in enumerate(self.invariants):
                self.final_deviation[i] = invariant.value(states) - self.first[i]
        never = self._rows == 0
        self.max_deviation[:, never] = self._squares[:, never] = np.nan

    def slopes(self, every: int, h: float) -> Array:
        """Drifts per unit time (invariants, trajectories), fitted as in ``analysis.drift``; nan if not summed.

        Every ``every``-th step is recorded. The drift of a trajectory that lacks some of these rows means nothing.
        """
        return np.full(self.first.shape, np.nan) if self._blocks is None else self._blocks.slopes(every, h)

    @property
    def rms_deviation(self) -> Array:
        """Root mean square deviations (invariants, trajectories)."""
        return np.sqrt(self._squares / np.maximum(self._rows, 1))

    @property
    def within_round_off(self) -> NDArray[np.bool_]:
        """True where the largest deviation is within the round-off bound (invariants, trajectories).

        False for a trajectory without a step, which is not judged.
        """
        steps = self._steps[None, :]
        bound = round_off_bound(np.maximum(steps, 1), self._scale)
        return (self.max_deviation <= bound) & np.isfinite(bound) & (steps > 0)

    @property
    def rows(self) -> NDArray[np.int64]:
        """Number of recorded rows of each trajectory."""
        return self._rows

    @property
    def begun(self) -> NDArray[np.bool_]:
        """True for each trajectory with at least one row."""
        return self._rows > 0

    @property
    def judged(self) -> NDArray[np.bool_]:
        """True for each trajectory with a recorded step."""
        return self._steps > 0


def measure_columns(tally: EnsembleTally, N: int, every: int, h: float) -> dict[str, Array]:
    """``<invariant>_first``, ``_max_deviation``, ``_rms_deviation``, ``_final_deviation``, ``_drift`` (trajectories,).

    A whole trajectory has ``N`` steps and a row for every ``every``-th. One that lacks some has no drift, but nan.
    """
    figures = {name: getattr(tally, name) for name in ("first", *MEASURES)}
    figures["drift"] = np.where(tally.rows == N // every + 1, tally.slopes(every, h), np.nan)
    return {
        f"{invariant.name}_{name}": values[i]
        for i, invariant in enumerate(tally.invariants)
        for name, values in figures.items()
    }


class EnsembleSummary:
    """Summary of the invariants of an ensemble, gathered tally by tally.

    Quantiles need all values: these are stored in ``spool``, an empty binary file that the caller opens and closes.
    ``rows`` reads them back one measure at a time, with nine bytes per trajectory in memory.
    """

    def __init__(self, spool: Spool) -> None:
        self._spool = spool
        self._counts: list[int] = []
        self._invariants: tuple[Invariant, ...] = ()
        self._judged, self._within = 0, np.zeros(0, dtype=np.int64)

    def add(self, tally: EnsembleTally) -> None:
        """Add a finished tally; all have the same invariants, of different tops. Raises OSError."""
        if not self._counts:
            self._invariants, self._within = tally.invariants, np.zeros(len(tally.invariants), dtype=np.int64)
        within, judged = tally.within_round_off, tally.judged
        self._within += within.sum(axis=1)
        self._judged += int(judged.sum())
        self._counts.append(len(judged))
        self._spool.write(np.stack([getattr(tally, name) for name in MEASURES]).tobytes())

    def _values(self, measure: int, invariant: int) -> Array:
        """A measure of an invariant over all trajectories (m,)."""
        made = np.empty(sum(self._counts))
        rows, filled, start = len(self._invariants), 0, 0
        for count in self._counts:
            self._spool.seek(start + 8 * count * (measure * rows + invariant))
            if self._spool.readinto(made[filled : filled + count].data) < 8 * count:
                raise OSError(errno.EIO, "the stored deviations cannot be read back")
            filled += count
            start += 8 * count * len(MEASURES) * rows
        return made

    def _quantiles(self, measure: int, invariant: int) -> dict[str, float | None]:
        """Quantiles of the magnitudes of a measure of an invariant."""
        values = self._values(measure, invariant)
        return quantiles(np.abs(values, out=values), QUANTILES)

    def rows(self) -> list[dict[str, Any]]:
        """Quantiles of the measures of each invariant over the trajectories, and the number within round-off."""
        return [
            {
                "name": invariant.name,
                "symbol": invariant.symbol,
                "judged": self._judged,
                "within_round_off": int(self._within[i]),
                **{measure: self._quantiles(k, i) for k, measure in enumerate(MEASURES)},
            }
            for i, invariant in enumerate(self._invariants)
        ]


def quantiles(values: Array, levels: Mapping[str, float]) -> dict[str, float | None]:
    """Quantiles of ``values`` (m,) without nan at named ``levels`` from 0 to 1; None if nothing else is there.

    ``values`` is overwritten.
    """
    missing = np.isnan(values)
    known = values[~missing] if missing.any() else values
    if not len(known):
        return dict.fromkeys(levels)
    # observed values instead of means of two, which would be useless beside an infinity
    found = np.quantile(known, list(levels.values()), method="inverted_cdf", overwrite_input=True)
    return dict(zip(levels, found.tolist(), strict=True))
