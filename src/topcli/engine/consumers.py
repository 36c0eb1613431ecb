"""Consumers, which a driver feeds with rows: the watch of the energy, and those that hold rows in memory.

The watch gives the outcome ``left_motion`` to trajectories that stay finite but leave their energy surface.

The energy of a top is the invariant that ``Top.energy`` names, or a multiple of it; a top without one is not judged.
A trajectory has left the motion as soon as a recorded state's energy differs from the first one's by more than
``LEAVING_FACTOR`` times its scale there, the sum of the magnitudes of its terms. Where these vanish or nearly do (at
rest with the centre of gravity level), the limit is the scale with each component as large as its vector.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, Invariant, Top
from topcli.engine.integration import Integration
from topcli.engine.rows import Plan, Rows

State = dict[str, NDArray[Any]]
"""Arrays by name, from which work continues that was stopped."""


class Consumer:
    """Something that is fed with the rows of one plan after the other; every method may be left out."""

    def begin(self, plan: Plan) -> None:
        """Make ready for the trajectories of a plan."""

    def add(self, rows: Rows) -> Any:
        """Evaluate rows, those of a trajectory in the order of time; called in several threads at once.

        The states are views that are overwritten afterwards. The result goes to ``take``.
        """

    def take(self, result: Any) -> None:
        """Take a result of ``add``; called in one thread, in the order of the trajectories and of time."""

    def end(self, run: Integration) -> None:
        """Take note of the end of all trajectories of the plan."""

    def state(self) -> State:
        """Arrays from which ``restore`` continues, called when no row is on its way."""
        return {}

    def restore(self, state: State) -> None:
        """Continue from a ``state()``, after ``begin``."""


LEAVING_FACTOR = 100.0


def energy_of(top: Top) -> Invariant | None:
    """Invariant of ``top`` that is its energy or a multiple of it; None for a top without one."""
    return next((invariant for invariant in top.invariants() if invariant.name == top.energy), None)


def energy_limits(top: Top, states: Array) -> Array:
    """Deviations of the energy (m,) beyond which motions that start in ``states`` (m, d) have left it.

    Infinite for a top without energy and where the energy or its scale is not usable.
    """
    energy = energy_of(top)
    if energy is None:
        return np.full(len(states), np.inf)
    lengths = states.copy()
    with np.errstate(all="ignore"):
        for start, stop in top.vectors.values():
            lengths[:, start:stop] = np.linalg.norm(states[:, start:stop], axis=1)[:, None]
        scale, in_any_direction = energy.scale(np.concatenate([states, lengths])).reshape(2, -1)
        limits = np.maximum(LEAVING_FACTOR * scale, in_any_direction)
        judged = np.isfinite(limits) & (limits > 0.0) & np.isfinite(energy.value(states))
    return np.where(judged, limits, np.inf)


class EnergyWatch(Consumer):
    """First recorded steps at which the trajectories are beyond their limits; ``drive`` always has one."""

    def begin(self, plan: Plan) -> None:
        """Take the energies and limits of the initial states."""
        states = plan.states[:, : len(plan.top.components)].astype(np.float64)
        self._energy, self._limits = plan.top.energy, np.full(len(states), np.inf)
        if self._energy in plan.functions:
            self._limits = energy_limits(plan.top, states)
        self._first = np.zeros(len(states))
        self.left = np.full(len(states), -1, dtype=np.int64)

    @np.errstate(all="ignore")
    def add(self, rows: Rows) -> None:
        """Compare the energies of rows with the limits."""
        rows = rows.tallied
        here = slice(rows.first, rows.first + len(rows.lengths))
        limits = self._limits[here]
        if not len(rows) or np.isinf(limits).all():
            return
        energy = rows[self._energy]
        if rows.n[0] == 0:
            self._first[here] = energy[:, 0]
        first = self._first[here]
        if (energy.max(axis=1) - first <= limits).all() and (first - energy.min(axis=1) <= limits).all():
            return  # the usual case; a nan is in none
        beyond = ~(np.abs(energy - first[:, None]) <= limits[:, None])
        beyond &= np.isfinite(limits[:, None]) & rows.reached
        left = np.flatnonzero(beyond.any(axis=1) & (self.left[here] < 0))
        self.left[rows.first + left] = rows.n[beyond[left].argmax(axis=1)]

    def end(self, run: Integration) -> None:
        """Mark the trajectories that have left."""
        run.endings.mark_left(self.left)

    def state(self) -> State:
        """First energies, and first steps beyond the limits."""
        return {"first": self._first.copy(), "left": self.left.copy()}

    def restore(self, state: State) -> None:
        """Continue from a ``state()``."""
        self._first[:], self.left[:] = state["first"], state["left"]


class Memory(Consumer):
    """The states of all rows of a plan in memory, or the columns ``names``.

    Attributes
    ----------
    n : ndarray, shape (m,)
        Step numbers of the rows of a trajectory that takes all steps; of a single one, of the rows that it reached.
    states : ndarray, shape (B, m, d)
        States; nan after the last row that one of several trajectories reached. With ``names`` there are none.
    columns : dict of str to ndarray, shape (B, m)
        Columns, likewise.
    """

    def __init__(self, names: Sequence[str] | None = None) -> None:
        self._names = names

    def begin(self, plan: Plan) -> None:
        """Make room for the rows of a plan."""
        self.n, (count, d) = np.arange(0, plan.N + 1, plan.every, dtype=np.int64), plan.states.shape
        rows = len(self.n) if self._names is None else 0
        self.states = np.empty((count, rows, d), dtype=plan.states.dtype)
        self.columns = {name: np.full((count, len(self.n)), np.nan) for name in self._names or ()}

    def add(self, rows: Rows) -> None:
        """Copy rows, or their columns, into place."""
        if not len(rows):
            return
        start = int(rows.n[0]) // rows.plan.every
        here = slice(rows.first, rows.first + len(rows.lengths)), slice(start, start + len(rows))
        if self._names is None:
            np.copyto(self.states[here], rows.recorded, where=rows.reached[..., None])
        for name in self._names or ():
            np.copyto(self.columns[name][here], rows[name], where=rows.reached)

    def end(self, run: Integration) -> None:
        """Leave out the states that were not reached."""
        lengths = np.searchsorted(self.n, run.last_n, side="right").tolist()
        if self._names is None and len(lengths) == 1:
            self.n, self.states = self.n[: lengths[0]], self.states[:, : lengths[0]]
        for i, length in enumerate(lengths):
            self.states[i, length:] = np.nan


class Pieces(Consumer):
    """Rows whose number is not known before, such as crossings, in memory as they come."""

    def begin(self, plan: Plan) -> None:
        """Begin anew."""
        self.pieces: list[Rows] = []

    def add(self, rows: Rows) -> Rows:
        """Hand the rows over."""
        return rows

    def take(self, result: Rows) -> None:
        """Append the rows."""
        self.pieces.append(result)
