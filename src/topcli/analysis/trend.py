"""Line fitted to the deviations of a run: its slope, and the error of the slope under oscillations or random walks.

The line is fitted with Hann weights: an oscillation of period P in a run of length T leaks into the slope only as
(P/T)^3, while into a line of equal weights (``numpy.polyfit``) it leaks as P/T. The standard error of the slope is the
largest of three:

*within the run*  how uncertain the residuals make the slope. Two models of them are compared: a *linear trend* with
                  noise or an oscillation that does not grow, whose error allows for correlation (Newey, West 1987),
                  and a *random walk* of independent increments, as from rounding errors, which has a slope in every
                  run even without a drift.
*between parts*   the largest difference between the slope and those of the halves and thirds of the run, scaled to its
                  length. In most cases the residuals are not noise but a slow oscillation of the motion, and each part
                  covers a different phase of it.
*at the ends*     half of the change of level, over the length of the run, where the deviation at an end is outside its
                  range in the middle of the run: the Hann weights hardly see the first and the last 5 % of the run.
                  A change of level there that is smaller than this range looks like an oscillation.

The linear trend is chosen only if it is ``EVIDENCE`` times as likely. The test uses the ``LOW`` slowest components of
the residuals, then all of them: in white noise all are equally large, in a random walk the slower ones are larger
(Müller, Watson, Econometrica 76 (2008) 979).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array

LAGS = 8
WALK_LAGS = 2
"""Correlated lags of the increments of a random walk: means over neighbouring blocks share half a block each."""
LOW = 8
SPLITS = (2, 3)
"""Numbers of parts of a run whose slopes have to agree."""
END, EDGE = 32, 10
"""The level at an end is the mean over a 32nd of the blocks; the middle leaves out a tenth at each end."""
UNSEEN = 1.5
"""Ratio of a change within the last 5 % of a run to the mean that the last 32nd shows of it, 1.45 for a ramp."""
SLACK, EXCESS = 0.15, 6.0
"""A level counts from 15 % of the range beyond the range of the middle on, and then up to six times the excess."""
EVIDENCE = 5.0
LINEAR, WALK = "linear trend", "random walk"


@dataclass(frozen=True)
class Trend:
    """A line through block means: ``slope``, and its standard errors ``within`` the run and ``between`` its parts.

    ``model`` is that of the residuals. ``ends`` is half of the change at the ends of the run, per unit time.
    """

    slope: float
    within: float
    between: float
    model: str
    ends: float = 0.0

    @property
    def scatter(self) -> float:
        """Standard error of the slope without changes at the ends."""
        return max(self.within, self.between)

    @property
    def error(self) -> float:
        """Standard error of the slope, the largest of the three."""
        return max(self.scatter, self.ends)

    @property
    def margin(self) -> float:
        """Half the width of the confidence interval of the slope, 95 %."""
        return 2.0 * self.error

    @property
    def bound(self) -> float:
        """Bound of the magnitude of the mean rate of change, with 95 % confidence."""
        return abs(self.slope) + self.margin


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


def trend(t: Array, values: Array) -> Trend | None:
    """Hann-weighted line through ``values`` (m,) at evenly spaced times ``t`` (m,); None for fewer than 8 points."""
    m, line = len(t), hann_line(t)
    if line is None:
        return None
    weight, influence = line
    s = t - weight @ t
    slope = float(influence @ values)
    residual = values - (weight @ values) - slope * s
    walks = _walks(residual)
    if walks:
        reach = np.cumsum(influence[::-1])[-2::-1]  # of each increment into the slope
        variance = _long_run(np.diff(residual), WALK_LAGS) / (m - 2.0 - WALK_LAGS) * float(reach @ reach)
    else:
        lags = min(LAGS, m // 4)
        variance = _long_run(influence * residual, lags)
        variance *= m / (m - 2.0 * (lags + 1))  # residuals of a fit are smaller than the noise
    between = _disagreement(slope, t, values)
    return Trend(slope, math.sqrt(max(variance, 0.0)), between, WALK if walks else LINEAR)


def with_ends(
    fit: Trend | None, t: Array, means: Array, weights: NDArray[Any], lows: Array, highs: Array
) -> Trend | None:
    """The trend with the change of level at the ends of the run; None without a trend.

    Parameters
    ----------
    fit : Trend or None
        Line fitted to the block means.
    t, means, weights, lows, highs : ndarray, shape (m,)
        Times of the blocks, means over them, numbers of rows that they represent, and their smallest and
        largest values.
    """
    if fit is None:
        return None
    m, line = len(t), fit.slope * (t - t[0])
    width, edge = max(m // END, 1), max(m // EDGE, 1)
    full = m - int(weights[-1] < weights[-2])  # a last block that is not full averages less than the others
    sums, counts = (np.cumsum(np.append(0.0, part[:full])) for part in (weights * (means - line), weights))
    levels = (sums[width:] - sums[:-width]) / (counts[width:] - counts[:-width])
    # means average over fast oscillations; single values show a change that comes after most of the last block
    changes = np.maximum(_changes_of_level(levels, levels, edge), _changes_of_level(lows - line, highs - line, edge))
    return replace(fit, ends=0.5 * float(changes.sum()) / abs(float(t[-1] - t[0])))


def _changes_of_level(lows: Array, highs: Array, edge: int) -> Array:
    """Changes of level (2,) at the first and last of stretches with these extremes (m,), against the range of others.

    ``edge`` stretches at each end are left out of that range. The change to a value beyond it is at most that from the
    other end of the range.
    """
    ends, middle = [0, -1], slice(edge, -edge)
    low, high = lows[middle].min(), highs[middle].max()
    excess = np.maximum(np.maximum(highs[ends] - high, low - lows[ends]) - SLACK * (high - low), 0.0)
    return np.minimum(EXCESS * excess, UNSEEN * np.maximum(highs[ends] - low, high - lows[ends]))


def _disagreement(slope: float, t: Array, values: Array) -> float:
    """Largest difference between the slope and those of the parts, each with a Hann window of its own.

    It is scaled to the length of the run by the power -3/2, with which the standard error of the slope of white noise
    goes.
    """
    differences, gap = [], abs(float(t[1] - t[0]))
    for count in SPLITS:
        edges = [part * len(t) // count for part in range(count + 1)]
        for part in map(slice, edges, edges[1:]):
            since = np.abs(t[part] - t[part][0])  # the last block may be shorter than the others
            weight = gap * np.sin(np.pi * (since + 0.5 * gap) / (since[-1] + 0.5 * gap + 0.5 * gap)) ** 2
            of_part = float(_line(t[part], weight)[1] @ values[part])
            differences.append(abs(of_part - slope) / count**1.5)
    return max(differences)


def _long_run(values: Array, lags: int) -> float:
    """Variance of the sum of ``values`` (m,), correlated over up to ``lags`` places."""
    variance = float(values @ values)
    for lag in range(1, lags + 1):
        variance += 2.0 * (1.0 - lag / (lags + 1)) * float(values[lag:] @ values[:-lag])
    return variance


@cache
def _slow_components(m: int, q: int) -> tuple[Array, Array, float]:
    """The q slowest polynomials (m, q) orthonormal to each other and to all lines, and a random walk's weights of them.

    The weights are the inverse of the covariance (q, q) of the components of a walk with increments of unit variance,
    and half the logarithm of the determinant of the covariance.
    """
    x = np.linspace(-1.0, 1.0, m)
    legendre = [np.ones(m), x]  # by their recurrence, without importing numpy.polynomial
    for k in range(1, q + 1):
        legendre.append(((2 * k + 1) * x * legendre[k] - k * legendre[k - 1]) / (k + 1))
    slow = np.linalg.qr(np.stack(legendre, axis=1))[0][:, 2:]
    tails = np.cumsum(slow[::-1], axis=0)[::-1]
    covariance = tails.T @ tails
    return slow, np.linalg.inv(covariance), 0.5 * float(np.linalg.slogdet(covariance)[1])


def _sizes_in_slow(residual: Array, q: int) -> tuple[float, float, float]:
    """Squared sizes of the q slowest components of the residual (m,) as white noise and as a walk, and half the log."""
    slow, inverse, half_log = _slow_components(len(residual), q)
    z = slow.T @ residual
    return float(z @ z), float(z @ inverse @ z), half_log


def sizes_in_all(residual: Array) -> tuple[float, float, float]:
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


def _walks(residual: Array) -> bool:
    """True unless the residual (m,) of a line is ``EVIDENCE`` times as likely from white noise as from a random walk.

    The test uses the slow components, then all of them. Both likelihoods are those of the components' direction,
    without their common size.
    """
    m, size = len(residual), float(np.abs(residual).max())
    if not 0.0 < size < math.inf:
        return False
    few = min(LOW, m // 3)
    for q in (few, m - 2):
        white, walk, half_log = _sizes_in_slow(residual / size, q) if q == few else sizes_in_all(residual / size)
        if not (white > 0.0 and walk > 0.0):
            return False
        if half_log + 0.5 * q * math.log(walk / white) > math.log(EVIDENCE):
            return False
    return True
