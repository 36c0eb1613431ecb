"""Recorded rows of a series: columns by name, swings, and the first row whose state has left its energy surface.

Columns are ``n``, ``t``, the components of the state, the invariants, and the attitude: the unit quaternion, or Euler's
angles, of the rotation from the body's frame to space.

Swings are deep minima of a component, located between the samples.

Runs whose state stays finite but leaves its energy surface have the outcome ``left_motion``. The energy of a top is the
invariant that ``Top.energy`` names, or a multiple of it; a top without one is not judged. A trajectory has left the
motion as soon as a recorded state's energy differs from the first one's by more than ``LEFT`` times its scale there,
the sum of the magnitudes of its terms. Where these vanish or nearly do (at rest with the centre of gravity level), the
limit uses the largest scale that vectors of the same lengths can have along the axes.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, Invariant, Top
from topcli.errors import UsageError, nearest, quoted


def column_names(top: Top) -> list[str]:
    """Names of all columns that a run of ``top`` can record, in order."""
    return ["n", "t", *top.components, *(invariant.name for invariant in top.invariants())]


_ASCII = str.maketrans({"²": "^2", "·": ".", "γ": "gamma", "ω": "omega", "κ": "kappa", "₃": "3"})


def spellings(name: str, symbol: str) -> list[str]:
    """Accepted spellings of an invariant's column: its name, its symbol, and the symbol in ASCII.

    >>> spellings("gamma_sq", "γ²")
    ['gamma_sq', 'γ²', 'gamma^2']
    """
    return list(dict.fromkeys((name, symbol, symbol.translate(_ASCII))))


def invariant_values(invariants: Iterable[Invariant], states: Array) -> dict[str, Array]:
    """Values (m,) of each invariant along states (m, d), by name; infinite or nan ones come without a warning."""
    with np.errstate(all="ignore"):
        return {invariant.name: invariant.value(states) for invariant in invariants}


def columns(
    top: Top,
    n: NDArray[np.int64],
    h: float,
    states: Array,
    names: Iterable[str],
    modified: Iterable[Invariant] = (),
    values: Mapping[str, Array] | None = None,
) -> dict[str, NDArray[Any]]:
    """Columns by name, computed from recorded rows.

    Parameters
    ----------
    top : Top
        Top whose components and invariants are the columns.
    n : ndarray of int64, shape (m,)
        Step numbers.
    h : float
        Step size.
    states : ndarray, shape (m, d)
        Recorded states.
    names : iterable of str
        Columns to compute; no other column is computed.
    modified : iterable of Invariant, optional
        Integrals of the scheme, which have columns too.
    values : mapping of str to ndarray, shape (m,), optional
        Values of invariants by name, if they have been evaluated before, and of columns that are not functions of
        the state.

    Returns
    -------
    dict of str to ndarray, shape (m,)

    Raises
    ------
    UsageError
        For an unknown name.
    """
    values = values or {}
    invariants = {invariant.name: invariant for invariant in (*top.invariants(), *modified)}
    made: dict[str, NDArray[Any]] = {}
    for name in names:
        if name == "n":
            made[name] = n
        elif name == "t":
            made[name] = n * h
        elif name in top.components:
            made[name] = states[:, top.components.index(name)]
        elif name in values:
            made[name] = values[name]
        elif name in invariants:
            made[name] = invariant_values([invariants[name]], states)[name]
        else:
            known = dict.fromkeys(("n", "t", *top.components, *invariants, *values))
            raise UsageError(f"no column {quoted(name)}; {nearest(name, known)}")
    return made


QUATERNION = "quaternion"
ATTITUDES: Mapping[str, tuple[str, ...]] = {
    QUATERNION: ("q0", "q1", "q2", "q3"),
    "euler-angles": ("psi", "theta", "phi"),
}
"""Names of the columns by the form of the attitude."""
SYMBOLS = {name: f"q_{name[1]}" for name in ATTITUDES[QUATERNION]}
SYMBOLS |= {"psi": r"\psi", "theta": r"\theta", "phi": r"\varphi"}
"""LaTeX of the columns."""


def attitude_columns(form: str, q: Array) -> dict[str, Array]:
    """Columns (m,) by name of the attitudes ``q`` (m, 4), unit quaternions, in one of the forms of ``ATTITUDES``."""
    from topcli.arithmetic.quaternions import euler_angles

    values = q.T if form == QUATERNION else euler_angles(q)
    return dict(zip(ATTITUDES[form], values, strict=True))


def quaternions_of(columns: Mapping[str, Array]) -> Array | None:
    """Unit quaternions (m, 4) of recorded columns of either form; None if there are none."""
    if all(name in columns for name in ATTITUDES[QUATERNION]):
        return np.column_stack([columns[name] for name in ATTITUDES[QUATERNION]])
    if all(name in columns for name in ATTITUDES["euler-angles"]):
        psi, theta, phi = (0.5 * columns[name] for name in ATTITUDES["euler-angles"])
        return np.column_stack(
            [
                np.cos(theta) * np.cos(psi + phi),
                np.sin(theta) * np.cos(psi - phi),
                np.sin(theta) * np.sin(psi - phi),
                np.cos(theta) * np.sin(psi + phi),
            ]
        )
    return None


LEFT = 100.0


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
        limits = np.maximum(LEFT * scales[0], scales[1:].max(axis=0))
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
