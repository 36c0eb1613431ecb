"""A tile of an ensemble: trajectories side by side, as many as one call of the compiled loop takes on.

A trajectory whose sum in that loop is not finite is taken back to where its chunk began and goes through the time loop
of single runs, which tells the step of the failure; it then stays where it is, and its lane repeats a neighbour.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, Outcome, Stepper
from topcli.engine.loop import CALL_SECONDS
from topcli.engine.native import Native

if TYPE_CHECKING:
    from topcli.engine.ensemble import EnsembleRun


@dataclass(frozen=True)
class Piece:
    """Consecutive recorded rows of neighbouring trajectories.

    ``first`` is the number of the first trajectory, ``n`` (m,) the step numbers, ``states`` (trajectories, m, d);
    of trajectory ``first + i`` the first ``kept[i]`` rows were reached. ``states`` is a view into a buffer that the
    next piece made in the same thread overwrites.
    """

    first: int
    n: NDArray[np.int64]
    states: Array
    kept: NDArray[np.int64]


class Tile:
    """The working states of trajectories ``first`` to ``stop - 1`` of ``run``, and how they advance."""

    def __init__(self, run: EnsembleRun[Any], stepper: Stepper, lanes: Native, first: int, stop: int) -> None:
        self.run, self.stepper, self.lanes = run, stepper, lanes
        self.first, self.count = first, stop - first
        self.alive = np.zeros(run.tile, dtype=bool)
        self.alive[: self.count] = True
        self.done = 0
        self.uncounted = stepper.width - len(stepper.counters)
        self.work = np.zeros((stepper.width + 1, run.tile))
        p = tuple(run.p.tolist())
        begun = run.y0[first:stop].tolist()
        if stepper.enter:
            begun = [stepper.enter(tuple(y), run.h, p) for y in begun]
        self.work[:-1, : self.count] = np.array(begun).T
        self._fill()

    def _fill(self) -> None:
        """Let the lanes of no living trajectory repeat one that lives: their numbers must not be extreme ones."""
        if self.alive.any() and not self.alive.all():
            self.work[:, ~self.alive] = self.work[:, [int(np.argmax(self.alive))]]

    def initial_piece(self) -> Piece:
        """The initial states alone."""
        return Piece(
            self.first,
            np.zeros(1, dtype=np.int64),
            self.run.y0[self.first : self.first + self.count, None],
            np.ones(self.count, dtype=np.int64),
        )

    def advance(self, n: NDArray[np.int64], steps: int, until_record: int, buffer: Array) -> NDArray[np.int64]:
        """Take ``steps`` steps, fewer if asked to stop, with the rows of step numbers ``n`` (m,) in ``buffer``.

        ``buffer`` has shape (tile, m, d); the first rows of all are the initial states. Return the number of rows that
        each trajectory reached.
        """
        run, d, before = self.run, self.run.y0.shape[1], self.done
        started = int(before == 0)
        saved = self.work[:-1].copy()
        self.work[-1] = 0.0
        if started:
            buffer[: self.count, 0] = run.y0[self.first : self.first + self.count]
        out, stride = buffer.reshape(-1)[started * d :], buffer.shape[1] * d
        steps = self._advance(out, steps, until_record, stride)
        self.done = before + steps
        reached = np.where(self.alive, started + max(0, (steps - until_record) // run.every + 1), 0)
        for j in np.flatnonzero(~np.isfinite(self.work[-1]) & self.alive):
            reached[j] = started + self._by_itself(int(j), saved[:, j].copy(), buffer[j, started:], steps, until_record)
        some = np.flatnonzero(reached[: self.count])
        at = reached[some] - 1
        run.last[self.first + some], run.last_n[self.first + some] = buffer[some, at], n[at]
        self._fill()
        return reached[: self.count]

    def _advance(self, out: Array, steps: int, until_record: int, stride: int) -> int:
        """Take up to ``steps`` steps, in calls that grow as long as they are short; the steps taken."""
        run, d, taken = self.run, self.run.y0.shape[1], 0
        while True:
            rows = max(0, (taken - until_record) // run.every + 1)
            size, until = min(steps - taken, run.call_steps), until_record + rows * run.every - taken
            start = time.perf_counter()
            self.lanes(self.work, out[rows * d :], run.params, run.h, size, run.every, until, stride)
            now = time.perf_counter()
            taken += size
            if taken == steps or (now - run.chunk_began > CALL_SECONDS and run.stop()):
                return taken
            run.call_steps = int(max(1, min(8 * size, size * CALL_SECONDS / max(now - start, 1e-9))))

    def _by_itself(self, j: int, work: Array, rows: Array, steps: int, until_record: int) -> int:
        """Repeat lane ``j``'s steps in the time loop of single runs into ``rows``; the number of rows reached."""
        run, loop = self.run, self.run.single_loop()
        out = np.empty(max(rows.size, rows.shape[1]))
        taken = loop.drive(work, out, run.p, run.h, steps, run.every, until_record)
        good = steps if taken >= 0 else -taken - 1
        reached = max(0, (good - until_record) // run.every + 1)
        rows[:reached] = out[: reached * rows.shape[1]].reshape(reached, rows.shape[1])
        if taken >= 0:
            self.work[:-1, j] = work
        else:
            self.alive[j] = False
            step = self.done - steps - taken
            run.endings.put(self.first + j, loop.failure(work), step, work[self.uncounted :])
        return reached

    def end(self) -> None:
        """Note how the living trajectories ended and where they are."""
        run, leave = self.run, self.stepper.leave
        living = np.flatnonzero(self.alive)
        completed = self.done >= run.N
        outcome = Outcome.COMPLETED if completed else Outcome.INTERRUPTED
        run.endings.put(self.first + living, outcome, self.done, self.work[self.uncounted : -1, living].T)
        unrecorded = living[run.last_n[self.first + living] != run.N] if completed else living[:0]
        if len(unrecorded):  # step N is not among the recorded ones
            p = tuple(run.p.tolist())
            states = self.work[:-1, unrecorded].T.tolist()
            run.last[self.first + unrecorded] = [leave(tuple(y), run.h, p) for y in states] if leave else states
            run.last_n[self.first + unrecorded] = run.N


def advance_together(tiles: Sequence[Tile], steps: int, until_record: int) -> Piece:
    """Take ``steps`` steps with each of neighbouring ``tiles``; the piece of all rows recorded on the way."""
    first = tiles[0]
    run, done = first.run, first.done
    n = np.arange(done + until_record, done + steps + 1, run.every, dtype=np.int64)
    if done == 0:
        n = np.concatenate([np.zeros(1, dtype=np.int64), n])
    buffer = run.rows_buffer(len(tiles) * run.tile, len(n))
    each = buffer.reshape(len(tiles), run.tile, len(n), -1)
    kept = [tile.advance(n, steps, until_record, rows) for tile, rows in zip(tiles, each, strict=True)]
    return Piece(first.first, n, buffer[: sum(map(len, kept))], np.concatenate(kept))
