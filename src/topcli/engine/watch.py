"""Watch of the energy: the outcome ``left_motion`` of trajectories that stay finite but leave their energy surface.

The energy of a top is the invariant that ``Top.energy`` names, or a multiple of it; a top without one is not judged.
A trajectory has left the motion as soon as a recorded state's energy differs from the first one's by more than
``LEAVING_FACTOR`` times its scale there, the sum of the magnitudes of its terms. Where these vanish or nearly do (at
rest with the centre of gravity level), the limit is the scale with each component as large as its vector.
"""

from __future__ import annotations

import numpy as np

from topcli.contracts import Array, Invariant, Top
from topcli.engine.consumer import Consumer, State
from topcli.engine.integration import Integration
from topcli.engine.plan import Plan
from topcli.engine.rows import Rows

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
        limits = np.maximum(LEAVING_FACTOR * energy.scale(states), energy.scale(lengths))
        judged = np.isfinite(limits) & (limits > 0.0) & np.isfinite(energy.value(states))
    return np.where(judged, limits, np.inf)


class Watch(Consumer):
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
