"""The invariant report: deviations of a run from what the exact flow conserves.

All sums are accumulated chunk by chunk in fixed memory. The verdicts:

*exact*     no deviation beyond the round-off bound ``ROUND_OFF_ULPS * eps * sqrt(steps) * scale``, where scale is
            the largest sum of magnitudes of the terms that make up the invariant (Brouwer's law: independent
            rounding errors add up as sqrt(steps)).
*lost*      the deviation is of the order of the invariant itself: more than ``LOST`` times the first value, or times
            ``TERMS`` of the scale where the first value is a smaller difference of large terms.
*drifting*  the slope of the deviation in time stands out from its noise by more than ``SIGNIFICANCE`` standard errors,
            and over the run it carries the deviation further than twice the scatter about it.
*bounded*   deviations beyond round-off, but no significant slope over this run.

*unjudged*  deviations beyond round-off but too few rows for a slope, numbers that are not finite, or no step at all.

The slope is fitted to block means, ``BLOCKS`` or up to twice as many, with Hann weights: an oscillation of period P
in a run of length T leaks into the slope only as (P/T)^3. Its standard error depends on the
rest of the deviation, for which two models are compared:

*linear trend*  noise or an oscillation that does not grow; its error allows for correlation (Newey, West 1987);
*random walk*   independent increments, as from rounding errors: every single walk shows some slope, without meaning.

The linear trend is chosen only if it is ``EVIDENCE`` times as likely. The test uses the ``LOW`` slowest components of
the residuals, then all of them: in white noise all are equally large, in a random walk the slower ones are larger
(Müller, Watson, Econometrica 76 (2008) 979). In 4,000 simulations each with 64 to 128 blocks, random walks without
drift were taken for linear trends in 4 of 100 cases and exceeded ``SIGNIFICANCE`` standard errors in 2 of 100 (in 22
to 30 of 100 by the error of a linear trend); white noise was never taken for a random walk and exceeded them in 1 of
4,000.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.columns import invariant_values
from topcli.analysis.leaving import energy_limits, first_beyond
from topcli.contracts import Array, Invariant, Top

ROUND_OFF_ULPS = 20.0
SIGNIFICANCE = 5.0
LOST = 0.25
TERMS = 0.1
BLOCKS = 64
LAGS = 8
WALK_LAGS = 2
"""Correlated lags of the increments of a random walk: means over neighbouring blocks share half a block each."""
LOW = 8
EVIDENCE = 5.0
LINEAR, WALK = "linear trend", "random walk"

_EPS = float(np.finfo(np.float64).eps)


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
    drift_over_run: float | None
    """``drift`` times the length of the run."""
    model: str | None
    """Model of the deviation beside the drift, which determines its error: "linear trend" or "random walk"."""
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
    """A line through block means: ``slope`` with its standard ``error`` by ``model``, and rms ``scatter`` about it."""

    slope: float
    error: float
    scatter: float
    model: str


def hann_line(t: Array) -> tuple[Array, Array] | None:
    """Hann weights of points at evenly spaced ``t`` (m,), and the influence of each on the slope of the fitted line.

    None for fewer than 8 points.
    """
    m = len(t)
    if m < 8 or t[-1] == t[0]:
        return None
    return _line(t, np.sin(np.pi * (np.arange(m) + 0.5) / m) ** 2)


def _line(t: Array, weight: Array) -> tuple[Array, Array]:
    """Normalized weights, and the influence of each point on the slope of the line fitted with them."""
    weight = weight / weight.sum()
    s = t - weight @ t
    return weight, weight * s / (weight @ s**2)


def trend(t: Array, values: Array, lengths: Array | None = None) -> Trend | None:
    """Hann-weighted line through ``values`` (m,) at times ``t`` (m,), rising or falling; None for too few points.

    Points are evenly spaced, unless the ``lengths`` (m,) of time that they represent are given: the weights are then
    proportional to them, and the increments of a random walk have variances proportional to the spacing. Fewer than
    eight points, or weights that are worth fewer, are too few.
    """
    m = len(t)
    line, gaps, count = hann_line(t), None, float(m)
    if line is None:
        return None
    if lengths is not None:
        weight, gaps = _uneven_weights(t, lengths)
        line = _line(t, weight)
        count = min(1.5 / float(line[0] @ line[0]), count)  # of m Hann weights the squares add up to 1.5 / m
        if not count >= 8:  # nan included
            return None
    weight, influence = line
    s = t - weight @ t
    slope = float(influence @ values)
    residual = values - (weight @ values) - slope * s
    scatter = math.sqrt(float(weight @ residual**2))
    if _walks(residual, gaps):
        reach = np.cumsum(influence[::-1])[-2::-1]  # of each increment into the slope
        increments = np.diff(residual)
        if gaps is not None:
            reach, increments = reach * np.sqrt(gaps), increments / np.sqrt(gaps)
        variance = _long_run(increments, WALK_LAGS) / (m - 2.0 - WALK_LAGS) * float(reach @ reach)
        return Trend(slope, math.sqrt(max(variance, 0.0)), scatter, WALK)
    lags = min(LAGS, int(count) // 4)
    variance = _long_run(influence * residual, lags)
    variance *= count / (count - 2.0 * (lags + 1))  # residuals of a fit are smaller than the noise
    return Trend(slope, math.sqrt(max(variance, 0.0)), scatter, LINEAR)


def _uneven_weights(t: Array, lengths: Array) -> tuple[Array, Array]:
    """Weights (m,) of points at times ``t`` (m,) that represent ``lengths`` of time (m,), by a Hann window in time.

    Also their spacings (m - 1,) in units of the mean.
    """
    since = np.abs(t - t[0])
    before, after = 0.5 * lengths[0], 0.5 * lengths[-1]
    weight = lengths * np.sin(np.pi * (since + before) / (since[-1] + before + after)) ** 2
    return weight, np.diff(since) * ((len(t) - 1) / since[-1])


def _long_run(values: Array, lags: int) -> float:
    """Variance of the sum of ``values`` (m,), correlated over up to ``lags`` places."""
    variance = float(values @ values)
    for lag in range(1, lags + 1):
        variance += 2.0 * (1.0 - lag / (lags + 1)) * float(values[lag:] @ values[:-lag])
    return variance


def _slow_components(m: int, q: int, gaps: Array | None = None) -> tuple[Array, Array, float]:
    """The q slowest polynomials (m, q) orthonormal to each other and to all lines, and a random walk's weights of them.

    The weights are the inverse of the covariance of the walk's components (q, q), and half the logarithm of the
    determinant of the covariance. The points are evenly spaced and the increments of unit variance, unless spacings are
    given, ``gaps`` (m - 1,), which are also the variances.
    """
    x = np.linspace(-1.0, 1.0, m)
    if gaps is not None:
        since = np.append(0.0, np.cumsum(gaps))
        x = 2.0 * since / since[-1] - 1.0
    legendre = [np.ones(m), x]  # by their recurrence, without importing numpy.polynomial
    for k in range(1, q + 1):
        legendre.append(((2 * k + 1) * x * legendre[k] - k * legendre[k - 1]) / (k + 1))
    slow = np.linalg.qr(np.stack(legendre, axis=1))[0][:, 2:]
    tails = np.cumsum(slow[::-1], axis=0)[::-1]
    if gaps is not None:
        tails[1:] *= np.sqrt(gaps)[:, None]  # tails[0] is zero: the columns are orthogonal to a constant
    covariance = tails.T @ tails
    return slow, np.linalg.inv(covariance), 0.5 * float(np.linalg.slogdet(covariance)[1])


@cache
def _even_components(m: int, q: int) -> tuple[Array, Array, float]:
    """The slow components of m evenly spaced points."""
    return _slow_components(m, q)


def _sizes_in_slow(residual: Array, q: int, gaps: Array | None) -> tuple[float, float, float]:
    """Squared sizes of the q slowest components of the residual (m,) as white noise and as a walk, and half the log."""
    m = len(residual)
    slow, inverse, half_log = _even_components(m, q) if gaps is None else _slow_components(m, q, gaps)
    z = slow.T @ residual
    return float(z @ z), float(z @ inverse @ z), half_log


def _sizes_in_all(residual: Array) -> tuple[float, float, float]:
    """As ``_sizes_in_slow`` for all m - 2 components of the residual (m,), in closed form.

    White noise is measured by the distance from the nearest line. A walk with increments of unit variance is measured
    by its increments about their mean, the generalized least squares fit of a line: with D the differences and X the
    lines, the inverse of the covariance of the m values is D'D, its determinant is 1, and that of the m - 2 components
    is det(X'D'DX) / det(X'X) = 12 / (m²(m + 1)).
    """
    m = len(residual)
    level = residual - residual.mean()
    x = np.arange(m) - 0.5 * (m - 1)
    off_line = level - (x @ level) / (x @ x) * x
    increments = np.diff(off_line)
    increments -= increments.mean()
    return float(off_line @ off_line), float(increments @ increments), 0.5 * math.log(12.0 / (m * m * (m + 1.0)))


def _walks(residual: Array, gaps: Array | None) -> bool:
    """True unless the residual (m,) of a line is ``EVIDENCE`` times as likely from white noise as from a random walk.

    The test uses the slow components, then all of them. Both likelihoods are those of the components' direction,
    without their common size.
    """
    m, size = len(residual), float(np.abs(residual).max())
    if not 0.0 < size < math.inf:
        return False
    few = min(LOW, m // 3)
    for q in (few, m - 2):
        closed = q != few and gaps is None
        white, walk, half_log = _sizes_in_all(residual / size) if closed else _sizes_in_slow(residual / size, q, gaps)
        if not (white > 0.0 and walk > 0.0):
            return False
        if half_log + 0.5 * q * math.log(walk / white) > math.log(EVIDENCE):
            return False
    return True


def round_off_bound(steps: Any, scale: Any, eps: float = _EPS) -> Any:
    """Largest deviation that rounding explains after ``steps`` steps; numbers or arrays."""
    return ROUND_OFF_ULPS * eps * np.sqrt(steps) * scale


NUMBERS = 7
"""Scalars in the state of a tally, beside its sums over blocks."""


class InvariantSums:
    """Running sums of one invariant's deviation from its ``first`` value."""

    def __init__(self, invariant: Invariant, first: float) -> None:
        self.invariant, self.first, self.limit, self.left = invariant, first, math.inf, math.nan
        self.low = self.high = first
        self.scale = 0.0
        self.squares = 0.0
        self.sums = np.zeros(2 * BLOCKS)

    def add(self, n: NDArray[np.int64], states: Array, values: Array) -> Array:
        """Add rows with their numbers, states and values; return their deviations (m,)."""
        deviation = values - self.first
        self.low = float(np.minimum(self.low, values.min()))  # unlike min() it keeps a nan
        self.high = float(np.maximum(self.high, values.max()))
        if math.isnan(self.left) and not max(self.high - self.first, self.first - self.low) <= self.limit:
            at = first_beyond(deviation, self.limit)
            self.left = math.nan if at is None else float(n[at])
        self.scale = float(np.maximum(self.scale, self.invariant.scale(states).max()))
        self.squares += float(deviation @ deviation)
        return deviation

    def row(
        self, fit: Trend | None, rows: int, steps: int, span: float, eps: float = _EPS, origin: float = 0.0
    ) -> InvariantRow:
        """Report on ``rows`` rows with the line ``fit`` through them, over ``span`` of time and ``steps`` steps.

        ``eps`` is the rounding error of the arithmetic, ``origin`` is added to the values.
        """
        deviation = float(np.maximum(self.high - self.first, self.first - self.low))
        rms = math.sqrt(self.squares / rows)
        bound = float(round_off_bound(max(steps, 1), self.scale, eps))
        first = origin + self.first
        size = abs(first)
        verdict, reason = _verdict(deviation, bound, max(size, TERMS * self.scale), fit, span)
        return InvariantRow(
            name=self.invariant.name,
            symbol=self.invariant.symbol,
            first=first,
            min=origin + self.low,
            max=origin + self.high,
            max_deviation=deviation,
            max_deviation_relative=deviation / size if size else None,
            rms_deviation=rms,
            rms_deviation_relative=rms / size if size else None,
            drift=fit.slope if fit else None,
            drift_error=fit.error if fit else None,
            drift_over_run=fit.slope * span if fit else None,
            model=fit.model if fit else None,
            scatter=fit.scatter if fit else None,
            round_off_bound=bound,
            verdict=verdict,
            reason=reason,
        )

    def numbers(self) -> Array:
        """State of the tally, (NUMBERS + 2 * BLOCKS,)."""
        few = [self.first, self.low, self.high, self.scale, self.squares, self.limit, self.left]
        return np.concatenate([np.array(few), self.sums])

    def restore(self, numbers: Array) -> None:
        """Restore the state that ``numbers()`` returned."""
        few = numbers[:NUMBERS].tolist()
        self.first, self.low, self.high, self.scale, self.squares, self.limit, self.left = few
        self.sums = np.array(numbers[NUMBERS:])


def sums_from(invariants: Sequence[Invariant], states: Array, top: Top | None) -> list[InvariantSums]:
    """Sums of all ``invariants`` that begin with their values in the first of ``states`` (m, d).

    With the ``top``, those of its energy watch for a motion that leaves its energy surface.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        found = [InvariantSums(invariant, float(invariant.value(states[:1])[0])) for invariant in invariants]
    if top is not None:
        limit = float(energy_limits(top, states[:1])[0])
        for one in found:
            one.limit = limit if one.invariant.name == top.energy else math.inf
    return found


class InvariantTally:
    """Report on ``invariants`` over a run with step size h, fed with chunks of rows.

    The run's length need not be known: blocks that fill up are joined in pairs. With the ``top``, ``left`` is the first
    recorded step at which the state has left its energy surface, None for never.

    A run in another precision, with the rounding error ``eps``, passes the deviations from its ``origins``, the first
    values, instead of the values: a difference of two doubles would not show them.
    """

    def __init__(
        self,
        invariants: Sequence[Invariant],
        h: float,
        top: Top | None = None,
        eps: float = _EPS,
        origins: Mapping[str, float] | None = None,
    ) -> None:
        self._invariants, self._h, self._top = invariants, h, top
        self._eps, self._origins = eps, origins
        self._width = 1
        self._tallies: list[InvariantSums] = []
        self._counts = np.zeros(2 * BLOCKS)
        self._steps_in = np.zeros(2 * BLOCKS)
        self._last = 0

    def add(self, n: NDArray[np.int64], states: Array, values: Mapping[str, Array] | None = None) -> None:
        """Add rows: step numbers (m,) and states (m, d). The very first row is the reference.

        ``values`` (m,) are those of the invariants by name, if they have been evaluated before; with ``origins`` they
        are deviations.
        """
        if not len(n):
            return
        values = invariant_values(self._invariants, states) if values is None else values
        if not self._tallies:
            self._tallies = sums_from(self._invariants, states[:1], self._top)
            if self._origins:
                for tally in self._tallies:
                    tally.first = tally.low = tally.high = 0.0
        while int(n[-1]) // self._width >= 2 * BLOCKS:
            self._width *= 2
            for sums in (self._counts, self._steps_in, *(tally.sums for tally in self._tallies)):
                sums[:] = np.concatenate([sums[0::2] + sums[1::2], np.zeros(BLOCKS)])
        block = n // self._width
        self._counts += np.bincount(block, minlength=2 * BLOCKS)
        self._steps_in += np.bincount(block, weights=n, minlength=2 * BLOCKS)
        self._last = int(n[-1])
        with np.errstate(over="ignore", invalid="ignore"):  # huge states: the verdict covers values that are not finite
            for tally in self._tallies:
                deviation = tally.add(n, states, values[tally.invariant.name])
                tally.sums += np.bincount(block, weights=deviation, minlength=2 * BLOCKS)

    @property
    def left(self) -> int | None:
        """First recorded step at which the energy was beyond its limit; None for never."""
        return next((int(tally.left) for tally in self._tallies if not math.isnan(tally.left)), None)

    def state(self) -> dict[str, NDArray[Any]]:
        """Current sums in arrays of a fixed size, from which ``restore`` continues bit for bit."""
        return {
            "steps": np.array([self._width, self._last], dtype=np.int64),
            "blocks": np.array([self._counts, self._steps_in]),
            "invariants": np.array([tally.numbers() for tally in self._tallies]),
        }

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continue from a ``state()``. Raises ValueError if it belongs to other invariants or has another form."""
        numbers = state["invariants"]
        known = numbers.shape in ((0,), (len(self._invariants), NUMBERS + 2 * BLOCKS))
        if not known or state["blocks"].shape != (2, 2 * BLOCKS):
            raise ValueError("the sums of the invariant report have another form")
        self._width, self._last = state["steps"].tolist()
        self._counts, self._steps_in = np.array(state["blocks"])
        self._tallies = []
        for invariant, one in zip(self._invariants, numbers, strict=False):
            self._tallies.append(InvariantSums(invariant, math.nan))
            self._tallies[-1].restore(one)

    def rows(self, steps: int | None = None) -> list[InvariantRow]:
        """Report with one row per invariant, in their order; ``steps`` of the method, if not the last step number."""
        filled = self._counts > 0
        counts = self._counts[filled]
        taken = self._last if steps is None else steps
        with np.errstate(all="ignore"):
            t, span = self._steps_in[filled] / counts * self._h, self._last * self._h
            fits = [trend(t, tally.sums[filled] / counts) for tally in self._tallies]
            rows = int(counts.sum())
            return [
                tally.row(fit, rows, taken, span, self._eps, (self._origins or {}).get(tally.invariant.name, 0.0))
                for tally, fit in zip(self._tallies, fits, strict=True)
            ]


def _verdict(deviation: float, bound: float, size: float, fit: Trend | None, span: float) -> tuple[str, str]:
    """Verdict on a deviation from an invariant of this ``size``, and its reason."""
    if not (math.isfinite(deviation) and math.isfinite(bound)):
        return "unjudged", "the invariant or its terms are not finite"
    if deviation > LOST * size:
        return "lost", f"max deviation {deviation:.1e} exceeds {LOST:g} times the invariant's size {size:.1e}"
    if deviation <= bound:
        if span == 0.0:
            return "unjudged", "the run has no recorded step"
        return "exact", f"max deviation {deviation:.1e} is within the round-off bound {bound:.1e}"
    beyond = f"max deviation {deviation:.1e} exceeds the round-off bound {bound:.1e}"
    if fit is None:
        return "unjudged", f"{beyond}; too few rows for a slope"
    moved = fit.slope * span
    ratio = abs(fit.slope) / fit.error if fit.error else math.inf
    fitted = (
        f"slope {fit.slope:.1e} ± {fit.error:.1e} ({ratio:.1f} standard errors, {fit.model}), {moved:.1e} over the run"
    )
    drifting = ratio > SIGNIFICANCE and abs(moved) > 2.0 * fit.scatter
    return "drifting" if drifting else "bounded", f"{beyond}; {fitted}, scatter {fit.scatter:.1e}"


def invariant_report(
    invariants: Sequence[Invariant], n: NDArray[np.int64], h: float, states: Array
) -> list[InvariantRow]:
    """Report on rows held in memory: step numbers (m,), states (m, d)."""
    tally = InvariantTally(invariants, h)
    tally.add(n, states)
    return tally.rows()
