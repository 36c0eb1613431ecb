"""Tally of invariants and quantities along the trajectories of a plan: deviations from the first value, their slopes.

Sums over blocks of steps add their rows one after the other, so that no figure depends on the pieces in which the rows
come, on the threads, or on an interruption. The slope is fitted to the means of ``BLOCKS`` or up to twice as many
blocks. A trajectory that is judged, even if it ends early, is summed in ``FINER`` times as many, which are joined in
the end as far as its length allows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.swings import oscillations
from topcli.analysis.trend import Trend, hann_line, trend, with_ends
from topcli.analysis.verdict import (
    NEEDS_EVEN_TIMES,
    OSCILLATIONS,
    TERMS,
    ULP,
    InvariantRow,
    judged,
    round_off_bound,
)
from topcli.contracts import Array, Invariant, Top
from topcli.engine.consumers import Consumer, EnergyWatch, State
from topcli.engine.endings import OUTCOMES, Endings
from topcli.engine.integration import Integration
from topcli.engine.rows import Plan, Rows
from topcli.table import rounded_up

BLOCKS, FINER = 64, 64
DEVIATIONS = ("max_deviation", "rms_deviation", "final_deviation")
QUANTILES = {"min": 0.0, "5 %": 0.05, "median": 0.5, "95 %": 0.95, "max": 1.0}
QUANTITY_FIGURES = ("first", "last", "min", "max", "mean")
"""Figures of a quantity."""
OF_INVARIANT = {
    "first": ("first value of NAME", "unit of NAME"),
    "max_deviation": ("largest deviation of NAME from its first value", "unit of NAME"),
    "rms_deviation": ("root mean square deviation of NAME from its first value", "unit of NAME"),
    "final_deviation": ("deviation of NAME from its first value after the last step", "unit of NAME"),
    "drift": ("slope of a line fitted to NAME, per unit time", "unit of NAME per time"),
}
"""Figures of the invariant NAME: columns of the table of trajectories and measures of sweeps, with meaning and unit."""
_SUMS = ("first", "low", "high", "last", "scale", "sums", "squares", "rows", "steps", "lows", "highs")


class Tally(Consumer):
    """Deviations of the invariants of a plan from their first values, and its quantities, by default all of them.

    The deviation of a quantity is its value: a difference from a large or infinite first value would say nothing.

    Attributes
    ----------
    first : ndarray, shape (observables, B)
        First values, in the arithmetic of the run; nan for a trajectory without a row.
    low, high, last : ndarray, shape (observables, B)
        Smallest, largest and last deviation; that of the state after step N, if it was reached.
    scale : ndarray, shape (invariants, B)
        Largest sums of the magnitudes of an invariant's terms.
    sums, squares : ndarray, shape (observables, B, blocks)
        Sums of the deviations, and of their squares, in blocks of ``width`` steps.
    rows, steps : ndarray of int64, shape (B,)
        Number of rows, and step number of the last one.
    lows, highs : ndarray, shape (d + invariants, blocks)
        Ranges of the components and of the deviations of a trajectory that is judged; otherwise (0, blocks).

    Without ``drifts`` there are no slopes. Only with ``judged`` is there a ``report``, on a single trajectory.
    """

    def __init__(self, names: Sequence[str] | None = None, drifts: bool = True, judged: bool = False) -> None:
        self._names, self._drifts, self._judged = names, drifts, judged

    def begin(self, plan: Plan) -> None:
        """Make room for the sums of the trajectories of a plan."""
        self.plan, count = plan, len(plan.states)
        places = {invariant.name: i for i, invariant in enumerate(plan.invariants)}
        self.names = list(plan.functions if self._names is None else self._names)
        self.invariants = [places[name] for name in self.names if name in places]
        self.width, blocks = 1, 2 * BLOCKS if self._drifts else 1
        while plan.N // self.width >= blocks:
            self.width *= 2
        if self._judged:
            finer = min(FINER, self.width)
            self.width, blocks = self.width // finer, blocks * finer
        shape = (len(self.names), count)
        self.first = np.full(shape, np.nan, dtype=plan.states.dtype)
        self.low, self.high, self.last = np.zeros(shape), np.zeros(shape), np.full(shape, np.nan)
        self.low[len(self.invariants) :], self.high[len(self.invariants) :] = np.inf, -np.inf
        self.scale = np.zeros((len(self.invariants), count))
        self.sums, self.squares = np.zeros((*shape, blocks)), np.zeros((*shape, blocks))
        self.rows, self.steps = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
        d = len(plan.top.components) + len(self.invariants) if self._judged else 0
        self.lows, self.highs = np.full((d, blocks), np.inf), np.full((d, blocks), -np.inf)

    @np.errstate(all="ignore")  # huge states give figures that are not finite
    def add(self, rows: Rows) -> None:
        """Add rows, of each trajectory up to the last one that it reached."""
        rows = rows.tallied
        if not len(rows):
            return
        n, lengths, here = rows.n, rows.lengths, slice(rows.first, rows.first + len(rows.lengths))
        beyond, some = None if rows.whole else ~rows.reached, lengths > 0
        fresh = some & (self.rows[here] == 0)

        # the places of the sums in the blocks that these rows touch, then those to which the rows are added
        block = (n // self.width).astype(np.int64)
        starts = np.flatnonzero(np.diff(block, prepend=-1))
        touched, size = block[starts], len(starts)
        local = np.concatenate([np.arange(size), np.repeat(np.arange(size), np.diff(starts, append=len(n)))])
        places = (np.arange(len(lengths))[:, None] * size + local).ravel()

        ranged = [] if len(self.lows) == 0 or not lengths[0] else list(rows.flat.T.astype(np.float64, copy=False))
        for i, name in enumerate(self.names):
            values = rows.numbers(name)
            self.first[i, here] = np.where(fresh, values[:, 0], self.first[i, here])
            quantity = i >= len(self.invariants)
            deviation = values.astype(np.float64) if quantity else self._differences(values, self.first[i, here, None])
            at_last = deviation[np.arange(len(lengths)), np.maximum(lengths, 1) - 1]
            self.last[i, here] = np.where(some, at_last, self.last[i, here])
            if beyond is not None:
                deviation = np.where(beyond, at_last[:, None], deviation)
            low = np.minimum(self.low[i, here], deviation.min(axis=1))  # unlike min() it keeps a nan
            high = np.maximum(self.high[i, here], deviation.max(axis=1))
            self.low[i, here] = np.where(some, low, self.low[i, here])
            self.high[i, here] = np.where(some, high, self.high[i, here])
            if beyond is not None:
                deviation[beyond] = 0.0
            for sums, added in ((self.sums[i, here], deviation), (self.squares[i, here], deviation * deviation)):
                weights = np.concatenate([sums[:, touched], added], axis=1).ravel()
                sums[:, touched] = np.bincount(places, weights=weights).reshape(-1, size)
            ranged += [] if quantity or not ranged else [deviation[0]]

        for k, invariant in enumerate(self.invariants):
            scale = rows.scale(invariant)
            if beyond is not None:
                scale[beyond] = 0.0
            self.scale[k, here] = np.maximum(self.scale[k, here], scale.max(axis=1))
        for i, values in enumerate(ranged):
            for ends, least in ((self.lows[i], np.minimum), (self.highs[i], np.maximum)):
                ends[touched] = least(ends[touched], least.reduceat(values, starts))
        self.rows[here] += lengths
        self.steps[here] = np.where(some, n[np.maximum(lengths, 1) - 1], self.steps[here])

    def _differences(self, values: Array, first: Array) -> Array:
        """Deviations as doubles, of ``values`` in the arithmetic of the run; nan where there is none."""
        if values.dtype != np.object_:
            return values - first
        first, deviations = np.broadcast_to(first, values.shape), np.full(values.shape, np.nan)
        there = ((values == values) & (first == first)).astype(bool)
        deviations[there] = values[there] - first[there]
        return deviations

    def end(self, run: Integration) -> None:
        """Take the last states instead of the last rows, which N steps may be no multiple of."""
        rows = Rows(self.plan, run.last_n, run.last[None])
        for i, name in enumerate(self.names):
            last = rows.numbers(name)[0]
            last = self._differences(last, self.first[i]) if i < len(self.invariants) else last.astype(np.float64)
            self.last[i] = np.where(self.rows > 0, last, np.nan)

    def state(self) -> State:
        """All sums, from which ``restore`` continues bit for bit."""
        return {name: getattr(self, name).copy() for name in _SUMS}

    def restore(self, state: State) -> None:
        """Continue from a ``state()``."""
        for name in _SUMS:
            getattr(self, name)[:] = state[name]

    @property
    def max_deviation(self) -> Array:
        """Largest deviations (observables, B); nan for a trajectory without a row."""
        return np.where(self.rows > 0, np.maximum(self.high, 0.0 - self.low), np.nan)

    @property
    def rms_deviation(self) -> Array:
        """Root mean square deviations (observables, B); nan for a trajectory without a row."""
        with np.errstate(all="ignore"):
            return np.sqrt(self.squares.sum(axis=-1) / self.rows)

    @property
    def within_round_off(self) -> NDArray[np.bool_]:
        """True where the largest deviation is within the round-off bound (invariants, B), after at least a step."""
        bound = round_off_bound(self.steps, self.scale)
        return (self.max_deviation[: len(self.scale)] <= bound) & np.isfinite(bound) & (self.steps > 0)

    def _blocks(self, rows: int, last: int) -> tuple[int, NDArray[np.bool_], NDArray[np.int64], Array]:
        """Number of blocks to join, joined blocks with rows, their numbers of rows and mean times.

        They are those of ``rows`` rows up to the step ``last``.
        """
        joined, every = 1, last // max(rows - 1, 1) or 1
        while last // (self.width * joined) >= 2 * BLOCKS:
            joined *= 2
        edges = np.arange(self.sums.shape[-1] // joined + 1) * self.width * joined
        edges = np.minimum(-(-edges // every), rows)  # first row of each block
        counts = np.diff(edges)
        filled = counts > 0
        return joined, filled, counts[filled], 0.5 * (every * (edges[:-1] + edges[1:] - 1))[filled] * self.plan.h

    def slopes(self) -> Array:
        """Drifts per unit time (observables, B); nan for trajectories that ended early and for fewer than 8 blocks."""
        every = max(self.plan.every, self.plan.tallied)
        rows, last = self.plan.N // every + 1, self.plan.N // every * every
        joined, filled, counts, t = self._blocks(rows, last)
        line, slopes = hann_line(t), np.full(self.low.shape, np.nan)
        if line is not None:
            whole = np.flatnonzero(self.rows == rows)
            means = _joined(self.sums[:, whole], joined, np.add)[..., filled] / counts
            terms = np.ascontiguousarray(means * line[1])  # of other layouts the order of sums depends on their number
            slopes[:, whole] = terms.sum(axis=-1)
        return slopes

    def columns(self) -> dict[str, Array]:
        """Figures (B,) of each invariant by name: ``first.NAME``, ``max_deviation.NAME`` and so on, ``drift.NAME``."""
        arrays = self.first, self.max_deviation, self.rms_deviation, self.last, self.slopes()
        figures = dict(zip(OF_INVARIANT, arrays, strict=True))
        return {
            f"{figure}.{self.names[i]}": values[i].astype(np.float64)
            for i in range(len(self.invariants))
            for figure, values in figures.items()
        }

    def quantities(self) -> dict[str, Array]:
        """Figures (B,) of the quantities: ``first.NAME``, ``last.NAME``, ``min.NAME``, ``max.NAME``, ``mean.NAME``."""
        columns = {}
        for i in range(len(self.invariants), len(self.names)):
            with np.errstate(all="ignore"):
                mean = self.sums[i].sum(axis=-1) / self.rows
            figures = (self.first[i].astype(np.float64), self.last[i], self.low[i], self.high[i], mean)
            for figure, values in zip(QUANTITY_FIGURES, figures, strict=True):
                columns[f"{figure}.{self.names[i]}"] = np.where(self.rows > 0, values, np.nan)
        return columns

    def report(self, steps: int | None = None) -> list[InvariantRow]:
        """Report on the only trajectory after ``steps`` (by default that of the last row), a row for each invariant."""
        rows, last, plan = int(self.rows[0]), int(self.steps[0]), self.plan
        if not rows:
            return []
        joined, filled, counts, t = self._blocks(rows, last)
        with np.errstate(all="ignore"):
            lows = _joined(self.lows, joined, np.minimum)[:, filled]
            highs = _joined(self.highs, joined, np.maximum)[:, filled]
            d, span = len(plan.top.components), last * plan.h
            short = shortness(lows[:d], highs[:d], span, plan.top.components)
            means = _joined(self.sums[:, 0], joined, np.add)[:, filled] / counts
            fits = [
                with_ends(trend(t, means[k]), t, means[k], counts, lows[d + k], highs[d + k])
                for k in range(len(self.invariants))
            ]
            return [self.row(k, fit, short, last if steps is None else steps, span) for k, fit in enumerate(fits)]

    def row(self, k: int, fit: Trend | None, short: str, steps: int, span: float) -> InvariantRow:
        """Report on invariant ``k`` of the only trajectory, with the line ``fit`` through its deviations.

        ``short`` says what the run is too short for, if it is; its ``steps`` take the time ``span``.
        """
        invariant, first = self.plan.invariants[self.invariants[k]], float(self.first[k, 0])
        low, high, rms = float(self.low[k, 0]), float(self.high[k, 0]), float(self.rms_deviation[k, 0])
        deviation, size, scale = float(self.max_deviation[k, 0]), abs(first), float(self.scale[k, 0])
        precise = self.plan.precise
        bound = float(round_off_bound(steps, scale, precise.arithmetic.eps if precise else ULP))
        # an integral that holds on a level only says nothing about motions beside it
        if reason := self._off_level(invariant.on):
            verdict, statement = "unjudged", f"unjudged: {reason}"
        else:
            size_of_terms = max(size, TERMS * scale)
            verdict, statement, reason = judged(deviation, high - low, bound, size_of_terms, fit, short, span)
        if precise and not precise.arithmetic.bits and verdict == "exact":  # numbers that are never rounded
            reason = f"equal at all {self.rows[0]} rows"
            statement = f"exact ({reason})"
        return InvariantRow(
            name=invariant.name,
            symbol=invariant.symbol,
            first=first,
            min=first + low,
            max=first + high,
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

    def _off_level(self, levels: Mapping[str, float]) -> str:
        """Condition on which an invariant is conserved and which the only trajectory does not meet; empty for none."""
        for name, level in levels.items():
            i = self.names.index(name)
            value = float(self.first[i, 0])
            if abs(value - level) > round_off_bound(1, float(self.scale[i, 0])):
                symbol = self.plan.invariants[self.invariants[i]].symbol
                return f"conserved only where {symbol} = {level:g}, and this motion has {symbol} = {value:.6g}"
        return ""


def _joined(blocks: Array, joined: int, join: np.ufunc) -> Array:
    """Blocks (..., m) joined ``joined`` by ``joined``."""
    return join.reduce(blocks.reshape(*blocks.shape[:-1], blocks.shape[-1] // joined, joined), axis=-1)


def shortness(lows: Array, highs: Array, span: float, components: Sequence[str]) -> str:
    """Oscillations that a run over the time ``span`` covers, if they are too few, and the length that it needs.

    Empty if the run is long enough. ``lows`` and ``highs`` (d, m) are those of the components in stretches of time.
    """
    covered, slowest = oscillations(lows, highs)
    if covered >= OSCILLATIONS:
        return ""
    length = abs(span) * OSCILLATIONS / max(covered, 0.5)
    part = {0.0: "no oscillation", 0.5: "half an oscillation", 1.0: "one oscillation"}
    covers = part.get(covered, f"{covered:g} oscillations")
    return f"covers {covers} of {components[slowest]}; run T >= {rounded_up(length):g}"


def tally_of(rows: Rows) -> Tally:
    """Tally of all observables of rows (c, m, d) held in memory, with a report on a single trajectory."""
    tally = Tally(judged=len(rows.plan.states) == 1)
    tally.begin(rows.plan)
    tally.add(rows)
    return tally


def series_rows(top: Top, invariants: Sequence[Invariant], n: NDArray[np.int64], h: float, states: Array) -> Rows:
    """Rows (1, m, d) of one trajectory in memory, after ``n`` (m,) steps of ``h`` in a row, with ``invariants``."""
    every = int(n[1] - n[0]) if len(n) > 1 else 1
    plan = Plan(top, None, states[:1], h, int(n[-1]) if len(n) else 0, every, invariants=tuple(invariants))
    return Rows(plan, n, states[None])


def invariant_report(
    top: Top,
    invariants: Sequence[Invariant],
    n: NDArray[np.int64],
    h: float,
    states: Array,
    steps: int | None = None,
    uneven_span: float | None = None,
) -> tuple[list[InvariantRow], int | None]:
    """Report on rows in memory, and the one of ``n`` at which they left their energy surface; None for never.

    ``steps`` of the method lie behind the rows, for the round-off bound, by default the last of ``n``. Rows at uneven
    times, which take the time ``uneven_span``, have no drift.
    """
    rows, even = series_rows(top, invariants, n, h, states), uneven_span is None
    tally, watch = Tally(drifts=even, judged=even), EnergyWatch()
    for consumer in (tally, watch):
        consumer.begin(rows.plan)
        consumer.add(rows)
    left, last = int(watch.left[0]), int(n[-1]) if steps is None else steps
    if uneven_span is None:
        report = tally.report(last)
    else:
        report = [tally.row(i, None, NEEDS_EVEN_TIMES, last, uneven_span) for i in range(len(tally.names))]
    return report, None if left < 0 else left


def trajectory_columns(tally: Tally, endings: Endings, varied: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Table of the trajectories of a plan: ``varied`` parameters, initial states, outcomes, figures of the tally."""
    plan, count = tally.plan, len(endings)
    columns: dict[str, NDArray[Any]] = {"trajectory": plan.first + np.arange(count, dtype=np.int64)}
    columns |= {f"top.{name}": np.full(count, float(getattr(plan.top, name))) for name in varied}
    columns |= {f"initial_{name}": plan.states[:, i] for i, name in enumerate(plan.top.components)}
    columns["outcome"] = np.array([outcome.value for outcome in OUTCOMES], dtype=object)[endings.outcome]
    return columns | {"n": endings.step, "left_motion": endings.left, **tally.columns(), **tally.quantities()}


def quantiles(values: Array) -> dict[str, float | None]:
    """``QUANTILES`` of the magnitudes of ``values`` (m,) without nan; None if nothing else is there."""
    magnitudes = np.abs(values[~np.isnan(values)])
    if not len(magnitudes):
        return dict.fromkeys(QUANTILES)
    # observed values instead of means of two, which would be useless beside an infinity
    levels = np.quantile(magnitudes, list(QUANTILES.values()), method="inverted_cdf", overwrite_input=True)
    return dict(zip(QUANTILES, levels.tolist(), strict=True))


def summary(plan: Plan, columns: Mapping[str, Array], within: NDArray[Any], judged: int) -> list[dict[str, Any]]:
    """Summary of the invariants of an ensemble: quantiles of the ``DEVIATIONS`` in ``columns`` (B,).

    Of the ``judged`` trajectories, ``within`` (invariants,) conserve each invariant to round-off.
    """
    return [
        {
            "name": invariant.name,
            "symbol": invariant.symbol,
            "judged": judged,
            "within_round_off": int(count),
            **{measure: quantiles(columns[f"{measure}.{invariant.name}"]) for measure in DEVIATIONS},
        }
        for invariant, count in zip(plan.invariants, within, strict=True)
    ]
