"""The state of a batch on its way: working states in tiles, advanced by the generated loops of machine code.

A tile holds neighbouring trajectories that advance together. Its working states are a structure of arrays, so that the
loop over steps and lanes becomes vector instructions. That loop cannot stop for one lane; it adds all numbers of each
working state to a sum, which an infinity or a nan in any step makes infinite or nan. A lane whose sum is not finite
goes back to the start of the call and repeats its steps in the loop of single trajectories, with one of two results:

- A step fails. The ending is stored, and from then on the lane copies a living neighbour, so that the vector
  instructions meet no extreme numbers.
- No step fails. Vector code computes both sides of every branch, and gives nan where a single run takes a rare one,
  such as a call of libm for a large angle. The lane takes the state of the single run and continues.

The step is the function that single runs compile, nothing in it is contracted or reordered, and the remaining calls of
libm are made for one trajectory after the other: a trajectory has the same bits alone and in a batch. Intel's vector
library SVML would change last bits; numba uses it only where the package icc-rt is installed, which topcli does not
require, and not with NUMBA_DISABLE_INTEL_SVML=1.

Times are n h, never accumulated; the first recorded row is the initial state itself. A batch advances in chunks whose
ends are fixed step numbers, so that the order of its rows depends neither on the clock nor on a stop, which comes
between two tiles. A call for a single trajectory may end anywhere: where it ends changes no bit of any row.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, Outcome, StopAsked, stop_asked
from topcli.engine.endings import Endings
from topcli.engine.rows import Plan, Rows
from topcli.errors import SchemeCodeError

ROWS = 1 << 15
"""Most rows of a piece, over all of its trajectories."""
ROWS_ALONE = 1 << 16
"""The same for a single trajectory."""
CHUNK_STEPS = 1 << 14
"""Most steps of a chunk of a batch: some milliseconds for a tile, which no stop cuts short."""
CALL_SECONDS = 0.25
"""Approximate longest time of a call."""


class Stretch(NamedTuple):
    """Steps that a tile is to take: at most ``steps``, with a row after ``until`` of them, then after every ``every``.

    ``out`` (size, rows, d) is the buffer of the rows, ``begun`` of which are already there.
    """

    steps: int
    every: int
    until: int
    out: Array
    begun: int

    def rows(self, steps: int) -> int:
        """Number of rows recorded in the first ``steps`` steps."""
        return max(0, (steps - self.until) // self.every + 1)


class Integration:
    """The trajectories of a plan on their way; that of a single one ends soon after a request to stop.

    Attributes
    ----------
    work : ndarray, shape (tiles, slabs, width + 1, lanes)
        Working states; the last row of a slab gathers the sums that reveal a failure. A call of machine code advances
        one slab. A tile of few rows has several slabs, because a piece of few rows costs its consumers as much as one
        of hundreds.
    done : ndarray of int64, shape (tiles,)
        Steps done; -1 before the row of the initial states.
    alive : ndarray of bool, shape (tiles, slabs * lanes)
        True for the trajectories that have not failed.
    endings : Endings
        Endings of the trajectories that have ended.
    last, last_n : ndarray, shapes (B, d) and (B,)
        Last recorded state, or that after step N, and its step.
    seconds : ndarray, shape (tiles,)
        Time of the machine code.
    """

    def __init__(
        self,
        plan: Plan,
        threads: int = 1,
        start: Mapping[str, NDArray[Any]] | None = None,
    ) -> None:
        assert plan.machine is not None
        self.plan, self.machine, count = plan, plan.machine, len(plan.states)
        self.lanes = self.machine.lanes_for(count)
        most = ROWS // (self.lanes * (plan.N // plan.every + 1)) if self.lanes > 1 else 1
        slabs = start["work"].shape[1] if start else max(1, min(most, -(-count // (self.lanes * threads))))
        self.size, tiles = slabs * self.lanes, -(-count // (slabs * self.lanes))
        self._fit = max(1, (ROWS if self.lanes > 1 else ROWS_ALONE) // self.size)
        self._chunk = min(CHUNK_STEPS, self._fit * plan.every) if self.lanes > 1 else plan.N
        states = np.zeros((tiles * self.size, self.machine.width + 1), dtype=plan.states.dtype)
        states[:count, :-1] = self.machine.entered(plan.states, plan.step)
        self.work = np.ascontiguousarray(states.reshape(tiles, slabs, self.lanes, -1).swapaxes(2, 3))
        self.done, self.seconds = np.full(tiles, -1, dtype=np.int64), np.zeros(tiles)
        self.alive = np.arange(tiles * self.size).reshape(tiles, self.size) < count
        self.endings = Endings.of_none(count, float(plan.h), self.machine.counters)
        self.last, self.last_n = plan.states.copy(), np.zeros(count, dtype=np.int64)
        self._call_steps = plan.N if self.lanes == 1 and self.machine.loop.returns_early else 1
        self._buffers = threading.local()
        if start:
            for name, array in self._arrays().items():
                array[:] = start[name]
        for tile in range(tiles):
            self._fill_idle(tile)

    @property
    def waiting(self) -> list[int]:
        """Tiles that have steps to take in the next chunk; of trajectories that advance one by one, the first."""
        living = np.flatnonzero(self.alive.any(axis=1) & (self.done < self.plan.N))
        if not len(living) or self.lanes == 1:
            return living[:1].tolist()
        return living[self.done[living] < self._end_of_chunk(int(self.done[living].min()))].tolist()

    def _end_of_chunk(self, done: int) -> int:
        """Step number at which the chunk ends that follows ``done`` steps."""
        return min(self.plan.N, (max(done, 0) // self._chunk + 1) * self._chunk)

    @property
    def taken(self) -> int:
        """Steps done, of all trajectories together."""
        return int(self.done.clip(0) @ self.alive.sum(axis=1) + self.endings.step.sum())

    @property
    def times(self) -> dict[str, Any]:
        """Seconds to ``compile`` or load the code, whether all of it came from disk, and to ``run`` it."""
        return {**self.machine.seconds, "run": float(self.seconds.sum())}

    def advance(self, tile: int) -> Rows:
        """Take the next steps of a tile, up to the end of its chunk, and return the rows recorded on the way.

        The rows are views into a buffer that the next call in the same thread overwrites.
        """
        plan, done, first = self.plan, max(int(self.done[tile]), 0), tile * self.size
        end, every, begun = plan.N - plan.N % plan.every, plan.every, int(self.done[tile] < 0)
        if tail := done >= end:  # no row comes any more, but the state after step N is needed
            end, every = plan.N, plan.N - done
        until = every - done % every if not tail else every
        steps = min(end, self._end_of_chunk(done)) - done
        steps = min(steps, until + (self._fit - 1) * every)
        n = np.arange(done + until - begun * every, done + steps + 1, every, dtype=np.int64)  # from 0, if begun
        out, here = self._buffer(len(n)), slice(first, min(first + self.size, len(plan.states)))
        count, alive = here.stop - first, self.alive[tile].copy()
        if begun:
            out[:count, 0] = plan.states[here]
        take = self._alone if self.lanes == 1 else self._side_by_side
        taken, reached = take(tile, Stretch(steps, every, until, out, begun))
        self.done[tile] = done + taken
        self._fill_idle(tile)
        lengths = np.where(alive, reached + begun, 0)[:count]
        some = np.flatnonzero(lengths)
        at = lengths[some] - 1
        self.last[first + some], self.last_n[first + some] = out[some, at], n[at]
        if tail:
            lengths = np.minimum(lengths, begun)
        rows = int(lengths.max(initial=0))
        return Rows(plan, n[:rows], out[:count, :rows], first, lengths)

    def _buffer(self, rows: int) -> Array:
        """The calling thread's buffer of rows (size, rows, d), which stays in its processor's cache."""
        shape = (self.size, rows, self.plan.states.shape[1])
        if getattr(self._buffers, "size", -1) < math.prod(shape):
            self._buffers.size = math.prod(shape)
            self._buffers.numbers = np.empty(self._buffers.size, dtype=self.plan.states.dtype)
        return self._buffers.numbers[: math.prod(shape)].reshape(shape)

    def _alone(self, tile: int, stretch: Stretch) -> tuple[int, NDArray[np.int64]]:
        """Advance a tile of one trajectory, for about ``CALL_SECONDS`` at most.

        The calls of the loop grow while they are short. Return the steps taken and the number of rows reached (1,).
        """
        loop, work, out = self.machine.loop, self.work[tile, 0, :-1, 0], stretch.out[0, stretch.begun :].reshape(-1)
        taken, now, d, (steps, every, until, *_) = 0, time.perf_counter(), self.plan.states.shape[1], stretch
        deadline = now + CALL_SECONDS
        while taken < steps and now <= deadline and not stop_asked():
            rows, size, before = stretch.rows(taken), min(steps - taken, self._call_steps), now
            begin, left = out[rows * d :], until + rows * every - taken
            try:
                went = loop.take_steps(work, begin, self.machine.p, self.plan.step, size, every, left)
            except StopAsked:  # a step during which it is raised counts as not taken
                break
            now = time.perf_counter()
            self.seconds[tile] += now - before
            if went < 0:
                taken -= went + 1
                self._failed(tile, 0, work, taken + 1)
                break
            taken += went
            if went < size:
                break
            self._call_steps = int(max(1, min(8 * size, size * CALL_SECONDS / max(now - before, 1e-9))))
        return taken, np.array([stretch.rows(taken)])

    def _side_by_side(self, tile: int, stretch: Stretch) -> tuple[int, NDArray[np.int64]]:
        """Advance a tile by the loop over lanes; return the steps taken and the numbers of rows reached (size,)."""
        work, alive, began = self.work[tile], self.alive[tile], time.perf_counter()
        code, h, (steps, every, until, out, begun) = self.machine.lanes(self.lanes).checked, self.plan.h, stretch
        before, stride, params = work[:, :-1].copy(), out[0].size, self.machine.params
        work[:, -1] = 0.0
        for slab in np.flatnonzero(alive.reshape(-1, self.lanes).any(axis=1)).tolist():
            begin = out[slab * self.lanes :].reshape(-1)[begun * out.shape[2] :]
            code(work[slab], begin, params, h, steps, every, until, stride)

        # lanes whose sum is not finite repeat their steps alone
        reached = np.full(self.size, stretch.rows(steps))
        for j in np.flatnonzero(~np.isfinite(work[:, -1]).ravel() & alive).tolist():
            slab, lane = divmod(j, self.lanes)
            alone, row = before[slab, :, lane].copy(), out[j, begun:].reshape(-1)
            went = self.machine.loop.take_steps(alone, row, self.machine.p, h, steps, every, until)
            if went >= 0:
                work[slab, :-1, lane] = alone
            else:
                reached[j] = stretch.rows(-went - 1)
                self._failed(tile, j, alone, -went)
        self.seconds[tile] += time.perf_counter() - began
        return steps, reached

    def _failed(self, tile: int, j: int, work: Array, step: int) -> None:
        """Store the ending of trajectory ``j`` of a tile, whose next step number ``step`` left ``work`` (width,)."""
        loop, i, counters = self.machine.loop, tile * self.size + j, len(self.endings.counters)
        self._end(i, loop.failure(work), max(int(self.done[tile]), 0) + step, work[len(work) - counters :])
        self.alive[tile, j] = False

    def _end(self, which: Any, outcome: Outcome, step: Any, counts: Array) -> None:
        """Store the endings of the trajectories ``which``. Raises SchemeCodeError for a count that is none."""
        numbers = counts.astype(np.float64)
        if not np.isfinite(numbers).all():
            name = self.endings.counters[int(np.argmin(np.isfinite(numbers).reshape(-1, counts.shape[-1]).all(axis=0)))]
            raise SchemeCodeError(f"the counter {name!r} is not finite at step {np.max(step)}; counters are finite")
        self.endings.put(which, outcome, step, numbers)

    def _fill_idle(self, tile: int) -> None:
        """Copy a living trajectory into the idle lanes of each slab, whose numbers must not be extreme."""
        alive = self.alive[tile].reshape(-1, self.lanes)
        for slab in np.flatnonzero(alive.any(axis=1) & ~alive.all(axis=1)):
            lanes = self.work[tile, slab]
            lanes[:, ~alive[slab]] = lanes[:, [int(np.argmax(alive[slab]))]]

    def finish(self) -> Endings:
        """Endings of all trajectories; those that have steps to take are interrupted."""
        tile, j = np.nonzero(self.alive)
        slab, lane = np.divmod(j, self.lanes)
        counts = self.work[tile, slab, self.work.shape[2] - 1 - len(self.endings.counters) : -1, lane]
        done = self.done.clip(0)[tile]
        for outcome in (Outcome.COMPLETED, Outcome.INTERRUPTED):
            chosen = (done >= self.plan.N) == (outcome is Outcome.COMPLETED)
            self._end((tile * self.size + j)[chosen], outcome, done[chosen], counts[chosen])
        return self.endings

    def state(self) -> dict[str, NDArray[Any]]:
        """All of it as arrays, from which another integration of the plan continues bit for bit."""
        return {name: array.copy() for name, array in self._arrays().items()}

    def _arrays(self) -> dict[str, NDArray[Any]]:
        names = ("work", "last", "done", "alive", "last_n", "seconds")
        ended = {"outcome": self.endings.outcome, "step": self.endings.step, "counts": self.endings.counts}
        return {name: getattr(self, name) for name in names} | ended
