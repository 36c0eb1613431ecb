"""The invariant report of a series whose times need not be even: recorded by an adaptive method, or thinned.

The rows are joined into bins of equal length in time, and the line is fitted to the means of the bins. A row weighs as
much as the time that it represents, half of each gap to its neighbours, so that the fit approximates the integrals over
time of an even series, and an oscillation leaks into the slope as little as there. A gap without rows counts for at
most one bin, so that the rows at its ends do not decide the slope.

In 400 simulations each with 40, 150 and 3,000 rows (drawn uniformly, in a cluster, without the middle fifth, with
logarithmic gaps, with oscillating gaps), random walks without drift exceeded the standard errors of a verdict in 1 to 2
of 100, white noise in at most 1 of 100 (40 rows in a cluster), else in at most 1 of 400.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from topcli.analysis.columns import invariant_values
from topcli.analysis.tally import BLOCKS, ULP, InvariantRow, InvariantTally
from topcli.analysis.trend import trend
from topcli.contracts import Array, Invariant, Top

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
        deviations = (values[invariant.name] - tally.first[i] for i, invariant in enumerate(invariants))
        fits = [trend(centres, means(deviation), total) for deviation in deviations]
        return [tally.row(i, fit, steps, span, ULP) for i, fit in enumerate(fits)], tally.left_step
