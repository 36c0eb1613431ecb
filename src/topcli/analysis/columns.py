"""Recorded rows of a series: columns by name, and the first row whose state has left its energy surface.

Columns are ``n``, ``t``, the components of the state, the invariants, and the attitude: the unit quaternion, or Euler's
angles, of the rotation from the body's frame to space.

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
