"""Report on invariants: deviations of trajectories from quantities that the exact flow conserves.

One tally serves single runs, ensembles and rows of sweeps: all sums are arrays over invariants and trajectories, fed
with pieces of rows in fixed memory. Sums over blocks add their rows one after the other, so that a slope depends
neither on the pieces in which the rows come nor on the trajectories beside them.

The verdicts on a single run:

*exact*     no deviation beyond the round-off bound ``ROUND_OFF_ULPS * eps * sqrt(steps) * scale``, where scale is
            the largest sum of magnitudes of the terms that make up the invariant (Brouwer's law: independent
            rounding errors add up as sqrt(steps)).
*lost*      the deviation is of the order of the invariant itself: more than ``LOST`` times the first value, or times
            ``TERMS`` of the scale where the first value is a smaller difference of large terms.
*undecided* deviations beyond round-off, but the recorded rows are too few for a slope, or the run covers fewer than
            ``OSCILLATIONS`` oscillations of the motion (of its slowest component): what looks like a drift may be a
            part of an oscillation, and a drift may not have begun. Or the slope of the deviation in time
            (``analysis.trend``) is between ``DOUBTFUL`` and ``SIGNIFICANCE`` standard errors, or makes up less than
            ``PART`` of the range of the deviation.
*drifting*  the slope is more than ``SIGNIFICANCE`` standard errors, and makes up more of the range.
*no drift seen*  the slope is not larger than ``DOUBTFUL`` standard errors, changes at the ends left out of these. With
            95 % confidence, the mean rate of change over the run is at most the slope and two standard errors. This
            does not cover a change in the first or last tenth of the run that is smaller than the range of the
            oscillation.

*unjudged*  numbers that are not finite, or no step at all; or an invariant of motions on a level (``Invariant.on``)
            where this one does not begin.

How often these verdicts are wrong is measured by ``benchmarks/verdicts.py``.

The slope is fitted to block means, ``BLOCKS`` or up to twice as many.

Of a series whose times need not be even, recorded by an adaptive method or thinned, the rows are joined into bins of
equal length in time, and the line is fitted to the means of the bins. A row weighs as much as the time that it
represents, half of each gap to its neighbours, so that the fit approximates the integrals over time of an even series,
and an oscillation leaks into the slope as little as there. A gap without rows counts for at most one bin, so that the
rows at its ends do not decide the slope. In 400 simulations each with 64 and 150 rows (drawn uniformly, in a
cluster, without the middle fifth, with logarithmic gaps, with oscillating gaps), random walks without drift exceeded
the standard errors of *drifting* in at most 1 of 100, white noise never.
"""

from __future__ import annotations

import errno
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.columns import invariant_values
from topcli.analysis.leaving import energy_limits, first_beyond
from topcli.analysis.swings import oscillations
from topcli.analysis.trend import Trend, hann_line, trend, with_ends
from topcli.contracts import Array, Invariant, Top
from topcli.table import plus_minus, rounded_up, two_digits

ROUND_OFF_ULPS = 20.0
SIGNIFICANCE = 4.0
DOUBTFUL = 2.5
OSCILLATIONS = 2.0
PART = 1.0 / 3.0
LOST = 0.25
TERMS = 0.1
BLOCKS = 64
QUANTILES = {"min": 0.0, "5 %": 0.05, "median": 0.5, "95 %": 0.95, "max": 1.0}
DEVIATIONS = ("max_deviation", "rms_deviation", "final_deviation")

ULP = float(np.finfo(np.float64).eps)
_EXTREMES = ("block_lows", "block_highs")
_SUMS = ("first", "low", "high", "scale", "squares", "limit", "left", "rows", "steps", "width", "sums", *_EXTREMES)
"""Arrays of a tally that change with its rows."""


@dataclass(frozen=True)
class InvariantRow:
    """Report on one invariant: dimensionless deviations from the first value.

    ``relative`` figures are None if the first value is 0, ``drift`` figures if there are too few rows.
    """

    name: str
    symbol: str
    first: float
    min: float
    max: float
    max_deviation: float
    max_deviation_relative: float | None
    rms_deviation: float
    rms_deviation_relative: float | None
    drift: float | None
    """Linear drift per unit time."""
    drift_error: float | None
    """One standard error of ``drift``."""
    drift_bound: float | None
    """Bound of the magnitude of the mean rate of change over the run, with 95 % confidence."""
    drift_over_run: float | None
    """``drift`` times the length of the run."""
    model: str | None
    """Model of the deviation beside the drift, which determines its error: "linear trend" or "random walk"."""
    round_off_bound: float
    verdict: str
    statement: str
    """The verdict with its figures, as it can be quoted."""
    reason: str

    def as_dict(self) -> dict[str, Any]:
        """Plain data, ready for JSON."""
        return asdict(self)


def round_off_bound(steps: Any, scale: Any, eps: float = ULP) -> Any:
    """Largest deviation that rounding explains after ``steps`` steps; numbers or arrays."""
    return ROUND_OFF_ULPS * eps * np.sqrt(np.maximum(steps, 1)) * scale


class InvariantTally:
    """Deviations of ``invariants`` along ``count`` trajectories of step h, fed with pieces in the order of time.

    Rows are those of every k-th step, from step 0 on, whose state is the reference. With the ``top``, ``left``
    (count,) are the first recorded steps at which each state has left its energy surface, -1 for never. Blocks that
    fill up are joined in pairs, unless they are wide enough for the ``last`` recorded step from the beginning; without
    ``drifts`` there are none. Different trajectories may be added from different threads if ``last`` is known.
    """

    def __init__(
        self,
        invariants: Sequence[Invariant],
        h: float,
        top: Top | None = None,
        count: int = 1,
        last: int = 0,
        drifts: bool = True,
    ) -> None:
        self.invariants, self._h, self._top, self._drifts = tuple(invariants), h, top, drifts
        shape = (len(self.invariants), count)
        self.first, self.low, self.high, self.final_deviation = (np.full(shape, np.nan) for _ in range(4))
        self.scale, self.squares = np.zeros(shape), np.zeros(shape)
        self.limit, self.left = np.full(count, np.inf), np.full(count, -1, dtype=np.int64)
        self.rows, self.steps = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
        self.width = np.ones(1, dtype=np.int64)
        while last // self.width[0] >= 2 * BLOCKS:
            self.width *= 2
        self.sums = np.zeros((*shape, 2 * BLOCKS if drifts else 0))
        self._observed = drifts and count == 1
        self.block_lows, self.block_highs = (np.empty((0, 2 * BLOCKS)) for _ in _EXTREMES)

    def add(
        self,
        n: NDArray[np.int64],
        states: Array,
        values: Mapping[str, Array] | None = None,
        first: int = 0,
        kept: NDArray[np.int64] | None = None,
    ) -> None:
        """Add rows of the trajectories from ``first`` on: step numbers (m,), states (trajectories, m, d) or (m, d).

        Only the first ``kept[i]`` rows of each count, by default all. ``values`` (trajectories * m,) are those of the
        invariants by name, if they have been evaluated before; a run in another precision, whose deviations a
        difference of doubles would not show, gives these instead.
        """
        m = len(n)
        if not m:
            return
        flat = np.ascontiguousarray(states).reshape(-1, states.shape[-1])
        count = len(flat) // m
        if values is None:
            values = invariant_values(self.invariants, flat)
        kept = np.full(count, m) if kept is None else kept
        here = slice(first, first + count)
        beyond = None if (kept == m).all() else np.arange(m) >= kept[:, None]
        fresh = (self.rows[here] == 0) & (kept > 0)
        places, deviations = self._places(n, count) if self._drifts else n, []
        with np.errstate(all="ignore"):  # huge states give figures that are not finite
            for i, invariant in enumerate(self.invariants):
                of_rows = values[invariant.name].reshape(count, m)
                for sums in (self.first, self.low, self.high):
                    sums[i, here] = np.where(fresh, of_rows[:, 0], sums[i, here])
                start = self.first[i, here, None]
                deviation, scale = of_rows - start, invariant.scale(flat).reshape(count, m)
                if beyond is not None:
                    of_rows = np.where(beyond, start, of_rows)
                    deviation[beyond] = scale[beyond] = 0.0
                self.low[i, here] = np.minimum(self.low[i, here], of_rows.min(axis=1))  # unlike min() it keeps a nan
                self.high[i, here] = np.maximum(self.high[i, here], of_rows.max(axis=1))
                if self._top is not None and invariant.name == self._top.energy:
                    if fresh.any():
                        limits = energy_limits(self._top, flat[::m])
                        self.limit[here] = np.where(fresh, limits, self.limit[here])
                    largest = np.maximum(self.high[i, here] - start[:, 0], start[:, 0] - self.low[i, here])
                    over = ~(largest <= self.limit[here]) & (self.left[here] < 0)
                    for j in np.flatnonzero(over).tolist():
                        at = first_beyond(deviation[j], float(self.limit[first + j]))
                        self.left[first + j] = -1 if at is None else n[at]
                if self._drifts:
                    sums = self.sums[i, here]
                    weights = np.concatenate([sums.ravel(), deviation.ravel()])
                    sums[:] = np.bincount(places, weights=weights).reshape(sums.shape)
                self.scale[i, here] = np.maximum(self.scale[i, here], scale.max(axis=1))
                self.squares[i, here] += np.einsum("ij,ij->i", deviation, deviation)
                deviations.append(deviation[0])
        if self._observed and kept[0]:
            self._observe(n[: kept[0]], flat[: kept[0]], [deviation[: kept[0]] for deviation in deviations])
        self.rows[here] += kept
        self.steps[here] = np.where(kept > 0, n[np.maximum(kept, 1) - 1], self.steps[here])

    def _observe(self, n: NDArray[np.int64], states: Array, deviations: Sequence[Array]) -> None:
        """Add rows of the only trajectory at the steps n to the ranges of its components and deviations in the blocks.

        ``states`` are of shape (m, d), each of the ``deviations`` of shape (m,).
        """
        d = states.shape[1]
        if not len(self.block_lows):
            self.block_lows = np.full((d + len(deviations), 2 * BLOCKS), np.inf)
            self.block_highs = -self.block_lows
        blocks = n // self.width[0]
        starts = np.flatnonzero(np.diff(blocks, prepend=-1))
        for ends, least in ((self.block_lows, np.minimum), (self.block_highs, np.maximum)):
            at = ends[:, blocks[starts]]
            at[:d] = least(at[:d], least.reduceat(states, starts, axis=0).T)
            for i, deviation in enumerate(deviations, start=d):
                at[i] = least(at[i], least.reduceat(deviation, starts))
            ends[:, blocks[starts]] = at

    def _places(self, n: NDArray[np.int64], count: int) -> NDArray[np.int64]:
        """Places of the sums of ``count`` trajectories, then those to which their rows at the steps ``n`` belong."""
        size = 2 * BLOCKS
        while n[-1] // self.width[0] >= size:
            self.width *= 2
            self.sums = _joined(self.sums, np.add, 0.0)
            self.block_lows = _joined(self.block_lows, np.minimum, np.inf)
            self.block_highs = _joined(self.block_highs, np.maximum, -np.inf)
        rows = np.arange(count)[:, None] * size + n // self.width[0]
        return np.concatenate([np.arange(count * size), rows.ravel()])

    def finish(self, states: Array) -> None:
        """Compute the final deviations from the last states (trajectories, d)."""
        values = invariant_values(self.invariants, states)
        with np.errstate(all="ignore"):
            for i, invariant in enumerate(self.invariants):
                self.final_deviation[i] = values[invariant.name] - self.first[i]

    @property
    def left_step(self) -> int | None:
        """First recorded step at which the only trajectory has left its energy surface; None for never."""
        return None if self.left[0] < 0 else int(self.left[0])

    @property
    def max_deviation(self) -> Array:
        """Largest deviations (invariants, trajectories); nan for a trajectory without a row."""
        with np.errstate(all="ignore"):
            return np.maximum(self.high - self.first, self.first - self.low)

    @property
    def rms_deviation(self) -> Array:
        """Root mean square deviations (invariants, trajectories); nan for a trajectory without a row."""
        with np.errstate(all="ignore"):
            return np.sqrt(self.squares / self.rows)

    @property
    def within_round_off(self) -> NDArray[np.bool_]:
        """True where the largest deviation is within the round-off bound (invariants, trajectories).

        False for a trajectory without a step, which is not judged.
        """
        bound = round_off_bound(self.steps, self.scale)
        return (self.max_deviation <= bound) & np.isfinite(bound) & (self.steps > 0)

    def _blocks(self, rows: int, last: int) -> tuple[NDArray[np.bool_], NDArray[np.int64], Array]:
        """Blocks that ``rows`` rows up to the step ``last`` fill, their numbers of rows and mean times."""
        every = last // max(rows - 1, 1) or 1
        edges = np.minimum(-(-np.arange(2 * BLOCKS + 1) * self.width // every), rows)  # first row of each block
        counts = np.diff(edges)
        filled = counts > 0
        return filled, counts[filled], 0.5 * (every * (edges[:-1] + edges[1:] - 1))[filled] * self._h

    def slopes(self, rows: int, last: int) -> Array:
        """Drifts per unit time (invariants, trajectories) of trajectories with all ``rows`` rows up to step ``last``.

        They are nan for the others, and for fewer than 8 blocks.
        """
        made = np.full(self.first.shape, np.nan)
        filled, counts, t = self._blocks(rows, last)
        line = hann_line(t) if self._drifts else None
        if line is not None:
            whole = np.flatnonzero(self.rows == rows)
            for i, sums in enumerate(self.sums):
                means = np.ascontiguousarray(sums[whole][:, filled]) / counts
                # one by one, because a product of matrices rounds differently from one of vectors
                made[i, whole] = [line[1] @ mean for mean in means]
        return made

    def _off_level(self, i: int, origins: Mapping[str, float]) -> str:
        """Condition that the motion has to meet for invariant ``i`` and does not; empty if it does."""
        index = {one.name: j for j, one in enumerate(self.invariants)}
        for name, level in self.invariants[i].on.items():
            value = origins.get(name, 0.0) + float(self.first[index[name], 0])
            if abs(value - level) > round_off_bound(1, float(self.scale[index[name], 0])):
                symbol = self.invariants[index[name]].symbol
                return f"conserved only where {symbol} = {level:g}, and this motion has {symbol} = {value:.6g}"
        return ""

    def row(
        self, i: int, fit: Trend | None, short: str, steps: int, span: float, eps: float, origins: Mapping[str, float]
    ) -> InvariantRow:
        """Report on invariant ``i`` of the only trajectory, with the line ``fit`` through its deviations.

        ``short`` says what the run is too short for, if it is; ``steps`` of the method take the time ``span``; ``eps``
        is the rounding error of the arithmetic, and ``origins`` are added to the values of the invariants they name.
        """
        origin = origins.get(self.invariants[i].name, 0.0)
        deviation, rms = float(self.max_deviation[i, 0]), float(self.rms_deviation[i, 0])
        scale, spread = float(self.scale[i, 0]), float(self.high[i, 0] - self.low[i, 0])
        bound = float(round_off_bound(steps, scale, eps))
        first = origin + float(self.first[i, 0])
        size = abs(first)
        if reason := self._off_level(i, origins):
            verdict, statement = "unjudged", f"unjudged: {reason}"
        else:
            verdict, statement, reason = _verdict(deviation, spread, bound, max(size, TERMS * scale), fit, short, span)
        return InvariantRow(
            name=self.invariants[i].name,
            symbol=self.invariants[i].symbol,
            first=first,
            min=origin + float(self.low[i, 0]),
            max=origin + float(self.high[i, 0]),
            max_deviation=deviation,
            max_deviation_relative=deviation / size if size else None,
            rms_deviation=rms,
            rms_deviation_relative=rms / size if size else None,
            drift=fit.slope if fit else None,
            drift_error=fit.error if fit else None,
            drift_bound=fit.bound if fit and verdict != "undecided" else None,
            drift_over_run=fit.slope * span if fit else None,
            model=fit.model if fit else None,
            round_off_bound=bound,
            verdict=verdict,
            statement=statement,
            reason=reason,
        )

    def report(
        self, steps: int | None = None, eps: float = ULP, origins: Mapping[str, float] | None = None
    ) -> list[InvariantRow]:
        """Report on the only trajectory, one row per invariant; ``steps`` of the method, if not the last step number.

        ``origins`` are the first values by name, if deviations were added.
        """
        rows, last = int(self.rows[0]), int(self.steps[0])
        if not rows:
            return []
        with np.errstate(all="ignore"):
            filled, counts, t = self._blocks(rows, last)
            lows, highs = self.block_lows[:, filled], self.block_highs[:, filled]
            d = len(lows) - len(self.invariants)
            means = self.sums[:, 0, filled] / counts
            fits = [
                with_ends(trend(t, level), t, level, counts, low, high)
                for level, low, high in zip(means, lows[d:], highs[d:], strict=True)
            ]
            taken, span = last if steps is None else steps, last * self._h
            short = self.shortness(lows[:d], highs[:d], span)
            return [self.row(i, fit, short, taken, span, eps, origins or {}) for i, fit in enumerate(fits)]

    def shortness(self, lows: Array, highs: Array, span: float) -> str:
        """Oscillations that a run over the time ``span`` covers, if they are too few, and the length that it needs.

        Empty if the run is long enough.

        ``lows`` and ``highs`` (d, m) are those of the components of the motion in stretches of time.
        """
        covered, slowest = oscillations(lows, highs)
        if covered >= OSCILLATIONS:
            return ""
        name = self._top.components[slowest] if self._top else f"component {slowest + 1}"
        length = abs(span) * OSCILLATIONS / max(covered, 0.5)
        part = {0.0: "no oscillation", 0.5: "half an oscillation", 1.0: "one oscillation"}
        return f"covers {part.get(covered, f'{covered:g} oscillations')} of {name}; run T >= {rounded_up(length):g}"

    def state(self) -> dict[str, NDArray[Any]]:
        """Current sums in arrays of a fixed size, from which ``restore`` continues bit for bit."""
        return {name: getattr(self, name).copy() for name in _SUMS}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continue from a ``state()``. Raises KeyError or ValueError if it has another form."""
        for name in _SUMS:
            if name not in _EXTREMES and state[name].shape != getattr(self, name).shape:
                raise ValueError("the sums of the invariant report have another form")
            setattr(self, name, np.array(state[name]))


def _joined(blocks: Array, join: np.ufunc, empty: float) -> Array:
    """Blocks (..., m) joined in pairs, with as many empty ones after them."""
    joined = join(blocks[..., 0::2], blocks[..., 1::2])
    return np.concatenate([joined, np.full_like(joined, empty)], axis=-1)


def _verdict(
    deviation: float, spread: float, bound: float, size: float, fit: Trend | None, short: str, span: float
) -> tuple[str, str, str]:
    """Verdict on a deviation from an invariant of this ``size``, its statement with figures, and its reason.

    ``deviation`` is the largest, and ``spread`` the difference between the largest and the smallest value.
    """
    if not (math.isfinite(deviation) and math.isfinite(bound)):
        reason = "the invariant or its terms are not finite"
        return "unjudged", f"unjudged: {reason}", reason
    if deviation > LOST * size:
        statement = f"lost (deviation {deviation:.1e})"
        reason = f"max deviation {deviation:.1e} exceeds {LOST:g} times the invariant's size {size:.1e}"
        return "lost", statement, reason
    if deviation <= bound:
        if span == 0.0:
            return "unjudged", "unjudged: no recorded step", "the run has no recorded step"
        reason = f"max deviation {deviation:.1e} is within the round-off bound {bound:.1e}"
        return "exact", f"exact (deviation {deviation:.1e} is round-off)", reason
    beyond = f"max deviation {deviation:.1e} exceeds the round-off bound {bound:.1e}"
    if fit is None:
        return "undecided", "undecided: too few rows for a slope", f"{beyond}; too few rows for a slope"
    if short:
        return "undecided", f"undecided: {short}", f"{beyond}; the run {short}"
    ratio = abs(fit.slope) / fit.error if fit.error else math.inf
    reason = f"{beyond}; slope {fit.slope:.1e} ± {fit.error:.1e} ({ratio:.1f} standard errors, {fit.model})"
    if ratio > SIGNIFICANCE and abs(fit.slope * span) > PART * spread:
        return "drifting", f"drifting ({plus_minus(fit.slope, fit.margin)} per unit time, 95 %)", reason
    if abs(fit.slope) > DOUBTFUL * fit.scatter:
        why = (
            "a slope that may belong to a slow oscillation"
            if fit.ends <= fit.scatter
            else "changes at an end of the run"
        )
        doubt = f"{why}; run T >= {rounded_up(2.0 * abs(span)):g}"
        return "undecided", f"undecided: {doubt}", f"{reason}, {doubt}"
    return "no drift seen", f"no drift seen (below {two_digits(rounded_up(fit.bound))} per unit time, 95 %)", reason


def invariant_report(
    invariants: Sequence[Invariant], n: NDArray[np.int64], h: float, states: Array, top: Top | None = None
) -> list[InvariantRow]:
    """Report on rows held in memory: step numbers (m,), states (m, d), of the ``top`` if its names shall be used."""
    tally = InvariantTally(invariants, h, top)
    tally.add(n, states)
    return tally.report()


def measure_columns(tally: InvariantTally, N: int, every: int) -> dict[str, Array]:
    """``first.<invariant>``, ``drift.``, ``max_deviation.``, ``rms_deviation.``, ``final_deviation.`` (trajectories,).

    A whole trajectory has ``N`` steps and a row for every ``every``-th. One that lacks some has no drift, but nan.
    """
    figures = {name: getattr(tally, name) for name in ("first", *DEVIATIONS)}
    figures["drift"] = tally.slopes(N // every + 1, N // every * every)
    return {
        f"{name}.{invariant.name}": values[i]
        for i, invariant in enumerate(tally.invariants)
        for name, values in figures.items()
    }


class EnsembleSummary:
    """Summary of the invariants of an ensemble, gathered tally by tally.

    Quantiles need all values: these are stored in ``spool``, an empty binary file that the caller opens and closes.
    ``rows`` reads them back one measure at a time, with nine bytes per trajectory in memory.
    """

    def __init__(self, spool: io.BufferedRandom | io.BytesIO) -> None:
        self._spool = spool
        self._counts: list[int] = []
        self._invariants: tuple[Invariant, ...] = ()
        self._judged, self._within = 0, np.zeros(1, dtype=np.int64)

    def add(self, tally: InvariantTally) -> None:
        """Add a finished tally; all have the same invariants, of different tops. Raises OSError."""
        self._invariants = tally.invariants
        self._within = self._within + tally.within_round_off.sum(axis=1)
        self._judged += int((tally.steps > 0).sum())
        self._counts.append(len(tally.steps))
        self._spool.write(np.stack([getattr(tally, name) for name in DEVIATIONS]).tobytes())

    def _quantiles(self, measure: int, invariant: int) -> dict[str, float | None]:
        """Quantiles of the magnitudes of a measure of an invariant over all trajectories."""
        values = np.empty(sum(self._counts))
        rows, filled, start = len(self._invariants), 0, 0
        for count in self._counts:
            self._spool.seek(start + 8 * count * (measure * rows + invariant))
            if self._spool.readinto(values[filled : filled + count].data) < 8 * count:
                raise OSError(errno.EIO, "the stored deviations cannot be read back")
            filled += count
            start += 8 * count * len(DEVIATIONS) * rows
        return quantiles(np.abs(values, out=values), QUANTILES)

    def rows(self) -> list[dict[str, Any]]:
        """Quantiles of the measures of each invariant over the trajectories, and the number within round-off."""
        return [
            {
                "name": invariant.name,
                "symbol": invariant.symbol,
                "judged": self._judged,
                "within_round_off": int(self._within[i]),
                **{measure: self._quantiles(k, i) for k, measure in enumerate(DEVIATIONS)},
            }
            for i, invariant in enumerate(self._invariants)
        ]


def quantiles(values: Array, levels: Mapping[str, float]) -> dict[str, float | None]:
    """Quantiles of ``values`` (m,) without nan at named ``levels`` from 0 to 1; None if nothing else is there.

    ``values`` is overwritten.
    """
    known = values[~np.isnan(values)]
    if not len(known):
        return dict.fromkeys(levels)
    # observed values instead of means of two, which would be useless beside an infinity
    at_levels = np.quantile(known, list(levels.values()), method="inverted_cdf", overwrite_input=True)
    return dict(zip(levels, at_levels.tolist(), strict=True))


BINS = 2 * BLOCKS


def represented_times(t: Array) -> Array:
    """Length of time (m,) that each of the rows at times ``t`` (m,) represents, at most a bin."""
    half = 0.5 * np.minimum(np.abs(np.diff(t)), abs(t[-1] - t[0]) / BINS)
    return np.append(half[0], half) + np.append(half, half[-1])


def uneven_report(
    invariants: Sequence[Invariant], t: Array, states: Array, steps: int, top: Top | None = None
) -> tuple[list[InvariantRow], int | None]:
    """Report on rows at uneven times.

    Parameters
    ----------
    invariants : sequence of Invariant
        Invariants to report on.
    t : ndarray, shape (m,)
        Times, all rising or all falling, at least two.
    states : ndarray, shape (m, d)
        States at these times.
    steps : int
        Steps of the method behind the rows, for the round-off bound.
    top : Top, optional
        Top whose energy surface is watched.

    Returns
    -------
    list of InvariantRow
        One for each invariant.
    int or None
        Index of the first row that has left the energy surface of the first one; None for none or without ``top``.
    """
    lengths = represented_times(t)
    bins = np.minimum(np.abs(t - t[0]) / abs(t[-1] - t[0]) * BINS, BINS - 1).astype(np.int64)
    values = invariant_values(invariants, states)
    by_bin = np.bincount(bins, weights=lengths, minlength=BINS).astype(np.float64)
    filled = by_bin > 0.0
    total = by_bin[filled]

    def means(of_rows: Array) -> Array:
        return np.bincount(bins, weights=lengths * of_rows, minlength=BINS)[filled] / total

    tally = InvariantTally(invariants, 1.0, top, drifts=False)
    tally.add(np.arange(len(t)), states, values)
    with np.errstate(all="ignore"):  # huge states: the verdict covers values that are not finite
        centres, span = means(t - t[0]), float(t[-1] - t[0])
        order = np.argsort(bins, kind="stable")
        starts = np.searchsorted(bins[order], np.flatnonzero(filled))
        deviations = [values[invariant.name] - tally.first[i] for i, invariant in enumerate(invariants)]
        columns, d = np.column_stack([states, *deviations])[order], states.shape[1]
        lows, highs = (least.reduceat(columns, starts, axis=0).T for least in (np.minimum, np.maximum))
        short = tally.shortness(lows[:d], highs[:d], span)
        fits = [
            with_ends(trend(centres, level, total), centres, level, total, low, high)
            for level, low, high in zip(map(means, deviations), lows[d:], highs[d:], strict=True)
        ]
        return [tally.row(i, fit, short, steps, span, ULP, {}) for i, fit in enumerate(fits)], tally.left_step
