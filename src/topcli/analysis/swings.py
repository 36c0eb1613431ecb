"""Swings, the deep minima of a component: times, spacings, and the number of oscillations in a run."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, Top
from topcli.errors import UsageError
from topcli.field.integrals import slopes

LEVELS, MIDDLE = (0.25, 0.5, 0.75), 0.1
"""Levels in the range of a component, and half the part of the range around them that is on neither side."""
RESTS, NEGLIGIBLE = 0.01, 1e-6
"""Largest ranges of a component at rest: relative to its own size, and to the largest component."""
UNEVEN = 0.1
"""Ratio of the smallest to the largest of four spacings below which the quartic through five points is not used."""

LARGEST_CHANGE, UNCLEAR, REST = 0.6, 0.5, 1e-9
"""Largest change of a component from row to row, relative to its range, in rows that show its oscillations: five rows
an oscillation. Distance of an extremum from the middle of the range that leaves its side open, relative to its height
above the rows. Largest change, relative to the largest component, of a component at rest."""


def _vertex(x: Array, y: Array) -> float:
    """Position of the minimum near 0 of the quartic through five points; x rises, and the third point is (0, 0).

    Where the points are too uneven for a quartic, of the parabola through the middle three, within these.
    """
    gaps = np.diff(x)
    if not gaps.min() >= UNEVEN * gaps.max():  # nan included
        x, y = x[1:4], y[1:4]
    try:
        slope = np.polyder(np.linalg.solve(np.vander(x), y))
        zeros = np.roots(slope)
    except np.linalg.LinAlgError:  # two points at almost the same time, or not finite
        return 0.0
    inside = zeros[np.abs(zeros.imag) < 1e-9].real
    inside = np.clip(inside[np.polyval(np.polyder(slope), inside) > 0.0], x[0], x[-1])
    return float(inside[np.argmin(np.abs(inside))]) if len(inside) else 0.0


def _depths(values: Array) -> tuple[Array, Array]:
    """Values (m,) relative to the middle of their range, extremes by parabolas, and by how much these exceed rows."""
    slope, bend = 0.5 * (values[2:] - values[:-2]), np.diff(values, 2)
    turns = np.diff(values)[1:] * np.diff(values)[:-1] < 0.0
    beyond = np.pad(np.where(turns, -0.5 * slope**2 / np.where(turns, bend, 1.0), 0.0), 1)
    extended = values + beyond
    return extended - 0.5 * (extended.min() + extended.max()), np.abs(beyond)


def minima_times(t: Array, values: Array) -> Array:
    """Times of the deep minima of ``values`` (m,) sampled at times ``t`` (m,), rising or falling, even or not.

    A deep minimum is the lowest point of a stretch below mid-range that begins and ends within the record.
    Its time is that of the minimum of the quartic through the five samples around it, with an error of fourth
    order in the sampling interval. Where the intervals between these differ by more than a factor of ten, it is that
    of the parabola through three samples.
    """
    if len(values) < 5 or not np.isfinite(values).all():
        return np.empty(0)
    low = _depths(values)[0] < 0.0
    edges = (np.flatnonzero(low[1:] != low[:-1]) + 1)[int(low[0]) :].tolist()
    times = []
    for start, end in zip(edges[::2], edges[1::2], strict=False):
        at = int(start + np.argmin(values[start:end]))
        at = min(max(at, 2), len(values) - 3)
        dt = 0.25 * (t[at + 2] - t[at - 2])
        x = (t[at - 2 : at + 3] - t[at]) / dt
        times.append(t[at] + dt * _vertex(x, values[at - 2 : at + 3] - values[at]))
    return np.array(times)


def swing_times(top: Top, t: Array, states: Array) -> Array:
    """Times of the swings of ``top``, the deep minima of its component ``swing``, in rows at times ``t`` (m,).

    Raises UsageError if the rows are too far apart to show them: where this component passes the middle of its range,
    at the first row and at the last, it changes by a large part of its range from row to row, or would at the rate of
    the equations of motion, which rows that skip whole oscillations do not show; or it is unclear whether it turns
    above or below the middle. ``states`` has the shape (m, d).
    """
    place = top.components.index(top.swing)
    values = states[:, place]
    if len(t) > 1 and np.isfinite(values).all():
        (depths, beyond), width = _depths(values), float(np.ptp(values))
        low = depths < 0.0
        rows = np.unique(np.append(np.flatnonzero(low[1:] != low[:-1]), [0, len(t) - 2]))
        gaps = np.abs(t[rows + 1] - t[rows])
        rates = np.fmax(*(np.abs(slopes(top, states[ends])[:, place]) for ends in (rows, rows + 1)))
        changes = np.fmax(np.abs(values[rows + 1] - values[rows]), rates * gaps)
        coarse = changes > max(LARGEST_CHANGE * width, REST * float(np.abs(states[rows]).max()))
        unclear = np.abs(depths) < UNCLEAR * beyond
        if coarse.any() or unclear.any():
            apart = f"rows {float(gaps.max()):.3g} apart in time"
            raise UsageError(f"{apart} are too few to show the swings of {top.swing}; record more of them")
    return minima_times(t, values)


def first_swing_spacing(times: Array) -> float | None:
    """Time from the first of the swings at ``times`` (m,) to the second; None for fewer than two.

    The first spacing instead of the mean, because the drift of a scheme changes it from swing to swing.
    """
    return abs(float(times[1] - times[0])) if len(times) > 1 else None


def oscillations(lows: Array, highs: Array) -> tuple[float, int]:
    """Least number of oscillations of the slowest component of a motion, in halves, and the index of this component.

    Parameters
    ----------
    lows, highs : ndarray, shape (d, m)
        Smallest and largest values of the components within m stretches of time, one after the other.

    Returns
    -------
    float
        Half the number of times that the component passes one of the ``LEVELS`` of its range, the most frequented, from
        ``MIDDLE`` of the range on one side to as much on the other; 0 if all components rest.
    int
        Index of the component; 0 if all rest.
    """
    slowest = np.inf, 0
    largest = max(np.abs(lows).max(initial=0.0), np.abs(highs).max(initial=0.0))
    for j, (low, high) in enumerate(zip(lows, highs, strict=True)):
        bottom, top = low.min(), high.max()
        width = top - bottom
        if width > max(RESTS * max(abs(bottom), abs(top)), NEGLIGIBLE * largest):
            levels = [(bottom + (level - MIDDLE) * width, bottom + (level + MIDDLE) * width) for level in LEVELS]
            count = max(passages(low < under, high > over) for under, over in levels)
            slowest = min(slowest, (0.5 * count, j))
    return slowest if slowest[0] < np.inf else (0.0, 0)


def passages(below: NDArray[np.bool_], above: NDArray[np.bool_]) -> float:
    """Least number of passages between two sides, of which these are visited in stretches of time (m,) each."""
    at_low = at_high = 0.0
    for low, high in zip(below.tolist(), above.tolist(), strict=True):
        if low and high:
            at_low, at_high = at_high + 1.0, at_low + 1.0
        elif low:
            at_low, at_high = min(at_low, at_high + 1.0), np.inf
        elif high:
            at_low, at_high = np.inf, min(at_high, at_low + 1.0)
    return min(at_low, at_high)


def spacing_law(eps: Array) -> Array:
    """Time between swings of the Kowalevski top at the distances ``eps`` (m,) from the paper's homoclinic orbit.

    To leading order, for the paper's initial state with gamma_3(0) = eps.
    """
    return 2.0 * np.sqrt(2.0) * np.log(8.0 * np.sqrt(7.0) / eps)
