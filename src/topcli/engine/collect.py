"""Consumers that hold rows in memory, and orbits: the states of one trajectory under a method."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topcli.contracts import Array, Ending, Invariant, Method, Top
from topcli.engine.consumer import Consumer
from topcli.engine.drive import drive
from topcli.engine.integration import Integration
from topcli.engine.machine import Machine
from topcli.engine.plan import Plan
from topcli.engine.rows import Rows


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


class Orbit(NamedTuple):
    """Recorded rows of one trajectory, step numbers ``n`` (m,) and ``states`` (m, d), and its ``ending``."""

    n: NDArray[np.int64]
    states: Array
    ending: Ending


def orbit(
    top: Top,
    method: Method | Machine,
    y0: ArrayLike,
    h: float,
    N: int,
    every: int = 1,
    invariants: Sequence[Invariant] = (),
) -> Orbit:
    """Orbit of ``method`` from the state ``y0`` (d,) over N steps of ``h``, of which every ``every``-th is recorded.

    Instead of the method, its machine code may be given. The energy is watched if it is one of the ``invariants``.
    """
    states: Any = np.array([y0])
    if states.dtype != np.object_:
        states = states.astype(np.float64)
    memory = Memory()
    machine = method if isinstance(method, Machine) else Machine(top, method)
    plan = Plan(top, machine, states, h, N, every, invariants=tuple(invariants))
    run = drive(plan, [memory])
    return Orbit(memory.n, memory.states[0], run.endings[0])
