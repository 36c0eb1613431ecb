"""The invariant report: how well a run keeps what the exact flow conserves.

Everything is accumulated chunk by chunk in fixed memory. The verdicts:

*exact*     no deviation beyond the round-off bound ``ROUND_OFF_ULPS * eps * sqrt(steps) * scale``, where scale is
            the largest sum of magnitudes of the terms that make up the invariant (Brouwer's law: independent
            rounding errors add up as sqrt(steps)).
*drifting*  the deviation has grown beyond ``RUNAWAY`` times the size of the invariant's terms at the start; or the
            slope of the deviation in time stands out from its noise by more than ``SIGNIFICANCE`` standard errors,
            and over the run it carries the deviation further than twice the scatter about it.
*bounded*   deviations beyond round-off, but no significant slope over this run.

*unjudged*  deviations beyond round-off, but too few rows for a slope, or numbers that are not finite.

The slope is fitted to block means, ``BLOCKS`` or up to twice as many, with Hann weights: an oscillation of period P
in a run of length T leaks into the slope only as (P/T)^3. Its standard error allows for correlated residuals (Newey
and West 1987).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, Invariant

ROUND_OFF_ULPS = 20.0
SIGNIFICANCE = 5.0
RUNAWAY = 1e3
BLOCKS = 64
LAGS = 8

_EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True)
class InvariantRow:
    """The report on one invariant; everything dimensionless, deviations from the first value.

    ``relative`` figures are None when the first value is 0; ``drift`` figures when there are too few rows.
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
    drift_over_run: float | None
    """``drift`` times the length of the run."""
    scatter: float | None
    """Root mean square of the block means about the fitted line."""
    round_off_bound: float
    verdict: str
    reason: str

    def as_dict(self) -> dict[str, Any]:
        """Plain data, ready for JSON."""
        return asdict(self)


@dataclass(frozen=True)
class Trend:
    """A line through block means: ``slope`` with its standard ``error``, and the rms ``scatter`` about it."""

    slope: float
    error: float
    scatter: float


def trend(t: Array, values: Array) -> Trend | None:
    """The Hann-weighted line through ``values`` (m,) at evenly spaced ``t`` (m,); None for fewer than 8 points."""
    m = len(t)
    if m < 8 or t[-1] == t[0]:
        return None
    weight = np.sin(np.pi * (np.arange(m) + 0.5) / m) ** 2
    weight /= weight.sum()
    s = t - weight @ t
    influence = weight * s / (weight @ s**2)
    slope = float(influence @ values)
    residual = values - (weight @ values) - slope * s
    scores = influence * residual
    lags = min(LAGS, m // 4)
    variance = float(scores @ scores)
    for lag in range(1, lags + 1):
        variance += 2.0 * (1.0 - lag / (lags + 1)) * float(scores[lag:] @ scores[:-lag])
    variance *= m / (m - 2.0 * (lags + 1))  # residuals of a fit are smaller than the noise
    scatter = math.sqrt(float(weight @ residual**2))
    return Trend(slope, math.sqrt(max(variance, 0.0)), scatter)


def round_off_bound(steps: Any, scale: Any) -> Any:
    """The largest deviation that rounding explains after so many ``steps``; numbers or arrays."""
    return ROUND_OFF_ULPS * _EPS * np.sqrt(steps) * scale


class _Tally:
    """Running sums of one invariant's deviation."""

    def __init__(self, invariant: Invariant, first: float) -> None:
        self.invariant, self.first = invariant, first
        self.low = self.high = first
        self.scale = self.first_scale = 0.0
        self.squares = 0.0
        self.sums = np.zeros(2 * BLOCKS)

    def add(self, states: Array, block: NDArray[np.int64]) -> None:
        values = self.invariant.value(states)
        deviation = values - self.first
        self.low = float(np.minimum(self.low, values.min()))  # unlike min() it keeps a nan
        self.high = float(np.maximum(self.high, values.max()))
        scales = self.invariant.scale(states)
        self.first_scale = self.first_scale or float(scales[0])
        self.scale = float(np.maximum(self.scale, scales.max()))
        self.squares += float(deviation @ deviation)
        self.sums += np.bincount(block, weights=deviation, minlength=2 * BLOCKS)

    def numbers(self) -> Array:
        """Everything that rows have changed, (6 + 2 * BLOCKS,)."""
        six = [self.first, self.low, self.high, self.scale, self.first_scale, self.squares]
        return np.concatenate([np.array(six), self.sums])

    def restore(self, numbers: Array) -> None:
        """Be as one was when these were the ``numbers()``."""
        self.first, self.low, self.high, self.scale, self.first_scale, self.squares = numbers[:6].tolist()
        self.sums = np.array(numbers[6:])


class InvariantTally:
    """The report on ``invariants`` over a run of steps of size h, fed with chunks of rows.

    The run's length need not be known: blocks that fill up are joined in pairs.
    """

    def __init__(self, invariants: Sequence[Invariant], h: float) -> None:
        self._invariants, self._h = invariants, h
        self._width = 1
        self._tallies: list[_Tally] = []
        self._counts = np.zeros(2 * BLOCKS)
        self._steps_in = np.zeros(2 * BLOCKS)
        self._last = 0

    def add(self, n: NDArray[np.int64], states: Array) -> None:
        """Take in rows: step numbers (m,) and states (m, d). The first row ever is the reference."""
        if not len(n):
            return
        if not self._tallies:
            with np.errstate(over="ignore", invalid="ignore"):
                firsts = [float(invariant.value(states[:1])[0]) for invariant in self._invariants]
            self._tallies = list(map(_Tally, self._invariants, firsts))
        while int(n[-1]) // self._width >= 2 * BLOCKS:
            self._width *= 2
            for sums in (self._counts, self._steps_in, *(tally.sums for tally in self._tallies)):
                sums[:] = np.concatenate([sums[0::2] + sums[1::2], np.zeros(BLOCKS)])
        block = n // self._width
        self._counts += np.bincount(block, minlength=2 * BLOCKS)
        self._steps_in += np.bincount(block, weights=n, minlength=2 * BLOCKS)
        self._last = int(n[-1])
        with np.errstate(over="ignore", invalid="ignore"):  # huge states: the report says that it is not finite
            for tally in self._tallies:
                tally.add(states, block)

    def state(self) -> dict[str, NDArray[Any]]:
        """Everything taken in so far, in arrays of a fixed size: what ``restore`` goes on from, bit for bit."""
        return {
            "steps": np.array([self._width, self._last], dtype=np.int64),
            "blocks": np.array([self._counts, self._steps_in]),
            "invariants": np.array([tally.numbers() for tally in self._tallies]),
        }

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Go on from a ``state()``. Raises ValueError when it is of other invariants or another form."""
        numbers = state["invariants"]
        known = numbers.shape in ((0,), (len(self._invariants), 6 + 2 * BLOCKS))
        if not known or state["blocks"].shape != (2, 2 * BLOCKS):
            raise ValueError("the sums of the invariant report are of another form")
        self._width, self._last = state["steps"].tolist()
        self._counts, self._steps_in = np.array(state["blocks"])
        self._tallies = []
        for invariant, one in zip(self._invariants, numbers, strict=False):
            self._tallies.append(_Tally(invariant, math.nan))
            self._tallies[-1].restore(one)

    def rows(self) -> list[InvariantRow]:
        """The report, one row an invariant in their order."""
        with np.errstate(all="ignore"):
            return [self._row(tally) for tally in self._tallies]

    def _row(self, tally: _Tally) -> InvariantRow:
        filled = self._counts > 0
        counts = self._counts[filled]
        fit = trend(self._steps_in[filled] / counts * self._h, tally.sums[filled] / counts)
        deviation = float(np.maximum(tally.high - tally.first, tally.first - tally.low))
        rms = math.sqrt(tally.squares / float(counts.sum()))
        bound = float(round_off_bound(max(self._last, 1), tally.scale))
        span = self._last * self._h
        verdict, reason = _verdict(deviation, bound, RUNAWAY * tally.first_scale, fit, span)
        size = abs(tally.first)
        return InvariantRow(
            name=tally.invariant.name,
            symbol=tally.invariant.symbol,
            first=tally.first,
            min=tally.low,
            max=tally.high,
            max_deviation=deviation,
            max_deviation_relative=deviation / size if size else None,
            rms_deviation=rms,
            rms_deviation_relative=rms / size if size else None,
            drift=fit.slope if fit else None,
            drift_error=fit.error if fit else None,
            drift_over_run=fit.slope * span if fit else None,
            scatter=fit.scatter if fit else None,
            round_off_bound=bound,
            verdict=verdict,
            reason=reason,
        )


def _verdict(deviation: float, bound: float, runaway: float, fit: Trend | None, span: float) -> tuple[str, str]:
    if not (math.isfinite(deviation) and math.isfinite(bound)):
        return "unjudged", "the invariant or its terms are not finite"
    if deviation > runaway:
        return "drifting", f"max deviation {deviation:.1e} exceeds {RUNAWAY:g} times the terms at the start"
    if deviation <= bound:
        if span == 0.0:
            return "unjudged", "there is no step to judge by"
        return "exact", f"max deviation {deviation:.1e} is within the round-off bound {bound:.1e}"
    beyond = f"max deviation {deviation:.1e} exceeds the round-off bound {bound:.1e}"
    if fit is None:
        return "unjudged", f"{beyond}; too few rows for a slope"
    moved = fit.slope * span
    ratio = abs(fit.slope) / fit.error if fit.error else math.inf
    told = f"slope {fit.slope:.1e} ± {fit.error:.1e} ({ratio:.1f} standard errors), {moved:.1e} over the run"
    drifting = ratio > SIGNIFICANCE and abs(moved) > 2.0 * fit.scatter
    return "drifting" if drifting else "bounded", f"{beyond}; {told}, scatter {fit.scatter:.1e}"


def invariant_report(
    invariants: Sequence[Invariant], n: NDArray[np.int64], h: float, states: Array
) -> list[InvariantRow]:
    """The report on recorded rows that are all in memory: step numbers (m,), states (m, d)."""
    tally = InvariantTally(invariants, h)
    tally.add(n, states)
    return tally.rows()
