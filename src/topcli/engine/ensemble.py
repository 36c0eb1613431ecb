"""Many trajectories of one scheme: side by side in tiles, so that one machine instruction steps several at once.

A tile holds ``TILE`` working states as a structure of arrays; the loop over them stands inside the loop over the steps
and is the compiler's to vectorise. The step is the very function that single runs compile, and nothing in it is
contracted or reordered, hence a trajectory has the same bits in an ensemble as by itself. A step with loops or branches
that cannot be turned into selections is not vectorised; it is right all the same.

Nothing is checked in that loop: it adds up the working state, and an infinity or a nan anywhere makes the sum one.
A trajectory whose sum is not finite is taken back to where its chunk began and goes through the time loop of single
runs, which tells the step of the failure; it then stays where it is, and its lane repeats a neighbour.

What is no compiled step (closed forms, steps in the interpreter) runs trajectory by trajectory in that same loop.
"""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, Ending, Method, Outcome, Stepper, Top
from topcli.engine.driver import SIGNATURE, Loop, loop_of, step_refused
from topcli.engine.lanes import plain_lanes, stages_of
from topcli.engine.loop import Run
from topcli.engine.native import CompileError, Native, native

TILE = 64
"""Trajectories side by side: enough to hide the latency of a step's longest chain, few enough for the first cache."""
SMALL_TILE = 8
"""The same for ensembles so small that most of a tile would stand empty: one vector of eight."""
GROUP = 16
"""Tiles that advance together, a chunk at a time, shared out among the threads. A constant, because the order in which
pieces come depends on it, and must not depend on the machine."""
CHUNK_ROWS = 512
"""Recorded rows of a trajectory in a piece: what a group holds in memory is this times GROUP * TILE."""
CHUNK_STEPS = 1 << 14

Made = TypeVar("Made")


def default_threads() -> int:
    """The CPUs that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not every system tells
        return os.cpu_count() or 1


@dataclass(frozen=True)
class Piece:
    """Consecutive recorded rows of neighbouring trajectories.

    ``first`` is the number of the first trajectory, ``n`` (m,) the step numbers, ``states`` (trajectories, m, d);
    of trajectory ``first + i`` the first ``kept[i]`` rows were reached. ``states`` is a view into a buffer that the
    next piece of the same trajectories overwrites.
    """

    first: int
    n: NDArray[np.int64]
    states: Array
    kept: NDArray[np.int64]


class EnsembleRun(Generic[Made]):
    """Trajectories of ``method`` from the states ``y0`` (m, d): iterate, then read how they ended.

    ``made(piece)`` is called for every piece of recorded rows, in one of ``threads`` threads; iterating gives
    (what it returned, trajectory-steps done so far) in an order that does not depend on the threads. The pieces of a
    trajectory come in the order of time. ``stop()`` is asked between chunks; when it says so, the trajectories that
    are not at their end are ``interrupted``.

    Afterwards ``endings`` holds one Ending a trajectory, and ``last`` (m, d) with ``last_n`` (m,) the state at step N,
    or the last recorded one of a trajectory that ended before.
    """

    def __init__(
        self,
        top: Top,
        method: Method,
        y0: Array,
        h: float,
        N: int,
        every: int = 1,
        *,
        made: Callable[[Piece], Made],
        stop: Callable[[], bool] = lambda: False,
        threads: int | None = None,
    ) -> None:
        self.top, self.method, self.h, self.N, self.every = top, method, float(h), N, every
        self.y0 = np.array(y0, dtype=np.float64, order="C")
        self.made, self.stop = made, stop
        self.threads = threads or default_threads()
        m, d = self.y0.shape
        self.p = np.array(top.constants(), dtype=np.float64)
        self.endings = [Ending(Outcome.INTERRUPTED, 0, 0.0)] * m
        self.last, self.last_n = self.y0.copy(), np.zeros(m, dtype=np.int64)
        self.compile_seconds, self.cached, self.run_seconds = 0.0, True, 0.0
        self.tile = TILE if m > TILE // 2 else SMALL_TILE
        self._lock, self._loop = threading.Lock(), None
        self.lanes: Native | None = None
        self.params = self.p
        if isinstance(method, Stepper) and not method.plain:
            try:
                self.lanes = native(plain_lanes(method, d, len(self.p), self.tile), SIGNATURE)
            except CompileError as error:
                raise step_refused(method, d, error) from None
            self.params = np.concatenate([self.p, stages_of(method)[1]])
            self.compile_seconds, self.cached = self.lanes.seconds, self.lanes.cached

    def single_loop(self) -> Loop:
        """The time loop of single runs, made when the first trajectory needs it."""
        with self._lock:
            if self._loop is None:
                self._loop = loop_of(self.method, self.y0.shape[1], len(self.p))
                self.compile_seconds += self._loop.seconds
            return self._loop

    @property
    def side_by_side(self) -> bool:
        """Whether pieces hold whole tiles; else each holds rows of one trajectory."""
        return self.lanes is not None

    @property
    def interrupted(self) -> bool:
        """Whether any trajectory was interrupted."""
        return any(ending.outcome is Outcome.INTERRUPTED for ending in self.endings)

    def __iter__(self) -> Iterator[tuple[Made, int]]:
        """What ``made`` returned and the trajectory-steps done, piece by piece."""
        if self.lanes is None or not isinstance(self.method, Stepper):
            yield from self._one_by_one()
            return
        m = len(self.y0)
        size = GROUP * self.tile
        with ThreadPoolExecutor(self.threads) as pool:
            for start in range(0, m, size):
                ends = range(start, min(start + size, m), self.tile)
                group = [_Tile(self, self.method, self.lanes, first, min(first + self.tile, m)) for first in ends]
                yield from self._together(group, pool, start)

    def _together(self, group: Sequence[_Tile], pool: ThreadPoolExecutor, before: int) -> Iterator[tuple[Made, int]]:
        """Advance the tiles of a group to the end, a chunk at a time."""
        every, N = self.every, self.N
        count = sum(tile.count for tile in group)
        done = 0
        living = list(group)
        while living and done < N and not self.stop():
            until_record = every - done % every
            steps = min(N - done, CHUNK_STEPS, until_record + (CHUNK_ROWS - 1) * every)

            def advance(tile: _Tile, steps: int = steps, until_record: int = until_record) -> Made:
                return self.made(tile.advance(steps, until_record))

            start = time.perf_counter()
            pieces = list(pool.map(advance, living))
            self.run_seconds += time.perf_counter() - start
            done += steps
            for piece in pieces:
                yield piece, before * N + count * done
            living = [tile for tile in living if tile.alive.any()]
        if not done:  # stopped before the first chunk: the initial states are there nevertheless
            for tile in group:
                yield self.made(tile.initial_piece()), before * N
        for tile in group:
            tile.end()

    def _one_by_one(self) -> Iterator[tuple[Made, int]]:
        """Run trajectory after trajectory in the time loop of single runs."""
        stride = math.gcd(self.every, self.N)  # so that step N is among the rows
        for i, y0 in enumerate(self.y0):
            run = Run(self.top, self.method, y0, self.h, self.N, stride, self.stop)
            for chunk in run:
                asked = chunk.n % self.every == 0
                if len(chunk.n) and (asked[-1] or chunk.n[-1] == self.N):
                    self.last[i], self.last_n[i] = chunk.states[-1], chunk.n[-1]
                elif asked.any():
                    at = int(np.flatnonzero(asked)[-1])
                    self.last[i], self.last_n[i] = chunk.states[at], chunk.n[at]
                n = chunk.n[asked]
                piece = Piece(i, n, chunk.states[asked][None], np.array([len(n)]))
                yield self.made(piece), i * self.N + chunk.done
            assert run.ending is not None
            self.endings[i] = run.ending
            self.run_seconds += run.run_seconds
            self.compile_seconds += run.compile_seconds
            self.cached &= run.cached
            if run.ending.outcome is Outcome.INTERRUPTED:
                return


class _Tile:
    """The working states of trajectories ``first`` to ``stop - 1``, and the rows that they record."""

    def __init__(self, run: EnsembleRun[Any], stepper: Stepper, lanes: Native, first: int, stop: int) -> None:
        self.run, self.stepper, self.lanes = run, stepper, lanes
        self.first, self.count = first, stop - first
        self.alive = np.zeros(run.tile, dtype=bool)
        self.alive[: self.count] = True
        self.done = 0
        self.work = np.zeros((stepper.width + 1, run.tile))
        p = tuple(run.p.tolist())
        for j in range(self.count):
            y = tuple(run.y0[first + j].tolist())
            self.work[:-1, j] = stepper.enter(y, run.h, p) if stepper.enter else y
        self._fill()
        d = run.y0.shape[1]
        rows = min(CHUNK_ROWS, run.N // run.every)
        self.out = np.empty(max(rows, 1) * d * run.tile)
        self.rows = np.empty((run.tile, rows + 1, d))
        self.rows[: self.count, 0] = run.y0[first:stop]

    def _fill(self) -> None:
        """Let the lanes of no living trajectory repeat one that lives: their numbers must not be extreme ones."""
        if self.alive.any():
            self.work[:, ~self.alive] = self.work[:, [int(np.argmax(self.alive))]]

    def initial_piece(self) -> Piece:
        """The initial states alone."""
        return Piece(
            self.first,
            np.zeros(1, dtype=np.int64),
            self.rows[: self.count, :1],
            np.ones(self.count, dtype=np.int64),
        )

    def advance(self, steps: int, until_record: int) -> Piece:
        """Take so many steps; the rows recorded on the way, before the first step with the initial states."""
        run, d = self.run, self.run.y0.shape[1]
        before, self.done = self.done, self.done + steps
        started = int(before == 0)
        n = np.arange(before + until_record, self.done + 1, run.every, dtype=np.int64)
        m = len(n)
        reached = np.where(self.alive, started + m, 0)
        saved = self.work[:-1].copy()
        self.work[-1] = 0.0
        self.lanes(self.work, self.out, run.params, run.h, steps, run.every, until_record)
        rows = self.rows[:, : started + m]
        rows[:, started:] = self.out[: m * d * run.tile].reshape(m, d, run.tile).transpose(2, 0, 1)
        for j in np.flatnonzero(~np.isfinite(self.work[-1]) & self.alive):
            reached[j] = started + self._by_itself(int(j), saved[:, j].copy(), rows[j, started:], steps, until_record)
        if started:
            n = np.concatenate([np.zeros(1, dtype=np.int64), n])
        for j in np.flatnonzero(reached[: self.count]):
            run.last[self.first + j], run.last_n[self.first + j] = rows[j, reached[j] - 1], n[reached[j] - 1]
        self._fill()
        return Piece(self.first, n, rows[: self.count], reached[: self.count])

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
            self._ended(j, loop.failure(work), self.done - steps - taken, work)
        return reached

    def _ended(self, j: int, outcome: Outcome, step: int, work: Array) -> None:
        names = self.stepper.counters
        counts = {name: int(value) for name, value in zip(names, work[len(work) - len(names) :], strict=True)}
        self.run.endings[self.first + j] = Ending(outcome, step, step * self.run.h, counts)

    def end(self) -> None:
        """Note how the living trajectories ended and where they are."""
        run, leave = self.run, self.stepper.leave
        p = tuple(run.p.tolist())
        completed = self.done >= run.N
        for j in np.flatnonzero(self.alive):
            self._ended(int(j), Outcome.COMPLETED if completed else Outcome.INTERRUPTED, self.done, self.work[:-1, j])
            if completed:
                state = tuple(self.work[:-1, j].tolist())
                run.last[self.first + j] = leave(state, run.h, p) if leave else state
                run.last_n[self.first + j] = run.N
