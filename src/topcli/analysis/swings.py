"""Swings: deep minima of a component, located between the samples, and their spacing."""

from __future__ import annotations

import numpy as np

from topcli.contracts import Array

EVEN = np.arange(-2.0, 3.0)
QUARTIC = np.array([[1, -4, 6, -4, 1], [-2, 4, 0, -4, 2], [-1, 16, -30, 16, -1], [2, -16, 0, 16, -2]]) / 24.0
"""Coefficients of x⁴, x³, x², x of the quartic through five points at x = -2, ..., 2."""
UNEVEN = 0.1
"""Ratio of the smallest to the largest of four spacings below which the quartic through five points is not used."""


def _lowest(x: Array, y: Array) -> float:
    """Position of the minimum of the parabola through three points, the second at (0, 0); within the points."""
    before, after = float(y[0] / x[0]), float(y[2] / x[2])
    bend = (after - before) / float(x[2] - x[0])
    if not 0.0 < bend < np.inf:
        return 0.0
    return min(max(0.5 * (float(x[0]) - before / bend), float(x[0])), float(x[2]))


def _vertex(x: Array, y: Array) -> float:
    """Position of the minimum near 0 of the quartic through five points; x rises, and the third point is (0, 0).

    Where the points are too uneven for a quartic, the parabola through the middle three.
    """
    gaps = np.diff(x)
    if not gaps.min() >= UNEVEN * gaps.max():  # nan included
        with np.errstate(all="ignore"):
            return _lowest(x[1:4], y[1:4])
    fit = QUARTIC if np.abs(x - EVEN).max() < 1e-6 else np.linalg.inv(np.vander(x))[:4]
    slope = fit @ y * [4.0, 3.0, 2.0, 1.0]
    roots = np.roots(slope)
    inside = roots[np.abs(roots.imag) < 1e-9].real
    inside = inside[np.polyval(slope[:3] * [3.0, 2.0, 1.0], inside) > 0.0]
    return float(inside[np.argmin(np.abs(inside))]) if len(inside) else 0.0


def minima_times(t: Array, values: Array) -> Array:
    """Times of the deep minima of ``values`` (m,) sampled at times ``t`` (m,), rising or falling, even or not.

    A deep minimum is the lowest point of a stretch below mid-range that begins and ends within the record.
    Its time is that of the minimum of the quartic through the five samples around it, with an error of fourth
    order in the sampling interval. Where the intervals between these differ by more than a factor of ten, it is that
    of the parabola through three samples.
    """
    if len(values) < 5 or not np.isfinite(values).all():
        return np.empty(0)
    low = values < 0.5 * (values.min() + values.max())
    edges = np.flatnonzero(low[1:] != low[:-1]) + 1
    if low[0]:
        edges = edges[1:]
    times = []
    for start, end in zip(edges[::2], edges[1::2], strict=False):
        at = int(start + np.argmin(values[start:end]))
        at = min(max(at, 2), len(values) - 3)
        dt = 0.25 * (t[at + 2] - t[at - 2])
        x = (t[at - 2 : at + 3] - t[at]) / dt
        times.append(t[at] + dt * _vertex(x, values[at - 2 : at + 3] - values[at]))
    return np.array(times)


def swing_spacing(t: Array, values: Array) -> float | None:
    """Time from the first deep minimum to the second; None if the record holds fewer than two.

    The first spacing instead of the mean, because the drift of a scheme changes it from swing to swing.
    """
    times = minima_times(t, values)
    return abs(float(times[1] - times[0])) if len(times) > 1 else None


def spacing_law(eps: Array) -> Array:
    """Time between swings of the Kowalevski top at the distances ``eps`` (m,) from the paper's homoclinic orbit.

    To leading order, for the paper's initial state with gamma_3(0) = eps.
    """
    return 2.0 * np.sqrt(2.0) * np.log(8.0 * np.sqrt(7.0) / eps)
