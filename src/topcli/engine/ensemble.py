"""Trajectories of one scheme from many initial states, stepped several at a time by vector instructions.

A tile holds ``TILE`` working states as a structure of arrays. The loop over them is inside the loop over the steps, and
the compiler vectorises it. The step is the function that single runs compile, and nothing in it is contracted or
reordered, hence a trajectory has the same bits in an ensemble as in a single run. A step with loops or branches that
cannot become selections is not vectorised, but its results are the same.

``engine/tile.py`` describes the compiled loop of a tile and what happens to trajectories that fail in it.

Two threads are nearly twice as fast as one because each thread gets one task instead of one per tile, rows are recorded
in place without a copy by the interpreter, and each thread has one buffer for them, which stays in its cache.

Methods that are not a compiled step (closed forms, steps in the interpreter) run trajectory by trajectory in the time
loop of single runs.
"""

from __future__ import annotations

import math
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from topcli.contracts import Array, Method, Outcome, Sampler, Stepper, Top
from topcli.engine.loop import Loop, loop_of, more_parameters, step_refused
from topcli.engine.native import CompileError, native
from topcli.engine.run import Endings, Run
from topcli.engine.tile import (
    LANES_SIGNATURE,
    Lanes,
    Piece,
    RowBuffer,
    Tile,
    TileContext,
    advance_together,
    plain_lanes,
)

TILE = 64
"""Trajectories side by side: enough to hide the latency of a step's longest chain, few enough for the first cache."""
SMALL_TILE = 8
"""The same for ensembles so small that most of a tile would be empty: one vector of eight."""
GROUP = 16
"""Tiles that advance together, a chunk at a time, shared out among the threads. A constant, because the order of the
pieces depends on it and must not depend on the machine."""
PIECE_ROWS = 512
"""Recorded rows of a trajectory in a piece; a thread holds TILE times as many in memory."""
PIECE_STEPS = 1 << 14
"""Most steps of a piece."""
BLOCK = 1 << 14
"""Trajectories of a large ensemble that are drawn, run, tallied and written before the next ones, to bound the memory.
A multiple of GROUP * TILE, so that tiles are those of one large block."""
TILE_FIRST_CALL = 1
"""Steps of the first call of compiled code for a tile; later calls take more while they are short."""

Kept = TypeVar("Kept")


_most_threads: int | None = None


def limit_threads(count: int) -> None:
    """Let ``default_threads`` be at most ``count`` in this process."""
    global _most_threads
    _most_threads = count


def default_threads() -> int:
    """Number of CPUs that this process may use, or the limit if there is a lower one."""
    try:
        cpus = len(os.sched_getaffinity(0))
    except AttributeError:  # not on every system
        cpus = os.cpu_count() or 1
    return min(cpus, _most_threads or cpus)


def tile_of(count: int) -> int:
    """Number of trajectories side by side in an ensemble of ``count``."""
    return TILE if count > TILE // 2 else SMALL_TILE


class EnsembleCode:
    """Machine code of ``method`` for ``top``, which several runs may share: the loops over a tile and of single runs.

    ``lanes`` is None without ``side_by_side`` and for a method that is not a compiled step. ``seconds`` is the time to
    compile or load, ``cached`` is true if all code came from disk.
    """

    def __init__(self, top: Top, method: Method, tile: int, side_by_side: bool = True) -> None:
        self.method, self.tile = method, tile
        self.p = np.array(top.constants(), dtype=np.float64)
        self._d = len(top.components)
        self._lock, self._loop = threading.Lock(), None
        self.lanes: Lanes | None = None
        self.seconds, self.cached = 0.0, True
        if side_by_side and isinstance(method, Stepper) and not method.plain:
            try:
                code = native(plain_lanes(method, self._d, len(self.p), tile), LANES_SIGNATURE)
            except CompileError as error:
                raise step_refused(method, self._d, error) from None
            self.lanes = Lanes(method, code, np.concatenate([self.p, more_parameters(method)]), tile)
            self.seconds, self.cached = code.seconds, code.cached

    def with_constants(self, top: Top, method: Method) -> EnsembleCode:
        """The same machine code for another top of the same class and its ``method``, which is the ``same_method``."""
        other = copy(self)
        other.method, other.p = method, np.array(top.constants(), dtype=np.float64)
        other._lock = threading.Lock()
        if isinstance(method, Stepper):
            if self.lanes:
                params = np.concatenate([other.p, more_parameters(method)])
                other.lanes = replace(self.lanes, stepper=method, params=params)
            if self._loop:
                other._loop = self._loop.of(method)
        return other

    def single_loop(self) -> Loop:
        """Time loop of single runs, compiled when the first trajectory needs it."""
        with self._lock:
            if self._loop is None:
                self._loop = loop_of(self.method, self._d, len(self.p))
                self.seconds += self._loop.seconds
                self.cached &= self._loop.cached
            return self._loop


@dataclass(frozen=True)
class Execution:
    """Execution of an ensemble; none of it changes the bits of a trajectory.

    ``stop()`` is called between chunks and within long ones; once it returns true, the unfinished trajectories are
    ``interrupted``, not all of them at the same step. ``threads`` is the number of threads, by default all CPUs.
    ``tile`` is ``tile_of`` the count of all blocks. A piece holds the rows of one tile; with ``wide`` it may hold those
    of several, if they are few. ``code`` is that of the method, if the caller has it already.
    """

    stop: Callable[[], bool] = lambda: False
    threads: int | None = None
    tile: int | None = None
    wide: bool = False
    code: EnsembleCode | None = None


class EnsembleRun(TileContext, Generic[Kept]):
    """Trajectories of ``method`` from the states ``y0`` (m, d): iterate, then read ``endings``.

    ``begin(y0)`` replaces the trajectories and keeps the code and buffers, so that a large ensemble runs block by
    block.

    ``on_piece(piece)`` is called for every piece of recorded rows, in one of the threads of the ``execution``.
    Iteration yields (its result, trajectory-steps done so far) in an order that does not depend on the threads. The
    pieces of a trajectory come in the order of time.

    Afterwards ``endings`` holds an Ending for each trajectory, and ``last`` (m, d) with ``last_n`` (m,) the state at
    step N, or the last recorded one of a trajectory that ended before.
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
        on_piece: Callable[[Piece], Kept],
        execution: Execution = Execution(),
    ) -> None:
        self.top, self.method, self.h, self.N, self.every = top, method, float(h), N, every
        self.on_piece, self.stop, self.wide = on_piece, execution.stop, execution.wide
        self.threads = execution.threads or default_threads()
        self.begin(y0)
        self.code = execution.code or EnsembleCode(top, method, execution.tile or tile_of(len(self.y0)))
        self.p, self.tile, self.run_seconds = self.code.p, self.code.tile, 0.0
        self.buffer = RowBuffer()

    def begin(self, y0: Array) -> None:
        """Take the initial states ``y0`` (m, d), and forget the endings of earlier trajectories."""
        self.y0 = np.array(y0, dtype=np.float64, order="C")
        m = len(self.y0)
        self.endings = Endings(m, self.h, () if isinstance(self.method, Sampler) else self.method.counters)
        self.last, self.last_n = self.y0.copy(), np.zeros(m, dtype=np.int64)

    def single_loop(self) -> Loop:
        """Time loop of single runs, compiled when the first trajectory needs it."""
        return self.code.single_loop()

    @property
    def compile_seconds(self) -> float:
        """Time to compile or load the code."""
        return self.code.seconds

    @property
    def cached(self) -> bool:
        """True if all code came from disk."""
        return self.code.cached

    @property
    def side_by_side(self) -> bool:
        """True if pieces hold whole tiles, False if each holds rows of one trajectory."""
        return self.code.lanes is not None

    @property
    def interrupted(self) -> bool:
        """True if any trajectory was interrupted."""
        return Outcome.INTERRUPTED in self.endings.outcomes

    def __iter__(self) -> Iterator[tuple[Kept, int]]:
        """Yield the result of ``on_piece`` and the trajectory-steps done, piece by piece."""
        lanes = self.code.lanes
        if lanes is None:
            yield from self._one_by_one()
            return
        self.call_steps = TILE_FIRST_CALL
        m, size = len(self.y0), GROUP * self.tile
        with ThreadPoolExecutor(max(1, self.threads - 1)) as pool:
            for start in range(0, m, size):
                ends = range(start, min(start + size, m), self.tile)
                group = [Tile(self, lanes, first, min(first + self.tile, m)) for first in ends]
                yield from self._together(group, pool, start)

    def _together(self, group: Sequence[Tile], pool: ThreadPoolExecutor, before: int) -> Iterator[tuple[Kept, int]]:
        """Advance the tiles of a group to the end, a chunk at a time."""
        every, N = self.every, self.N
        count = sum(tile.count for tile in group)
        done = 0
        living = list(group)
        while living and done < N and not self.stop():
            until_record = every - done % every
            steps = min(N - done, PIECE_STEPS, until_record + (PIECE_ROWS - 1) * every)

            def advance(tiles: Sequence[Tile], steps: int = steps, until_record: int = until_record) -> Kept:
                return self.on_piece(advance_together(tiles, steps, until_record))

            start = self.chunk_began = time.perf_counter()
            pieces = self._shared_out(advance, self._neighbours(living, 1 + steps // every), pool)
            self.run_seconds += time.perf_counter() - start
            done += steps
            for piece in pieces:
                yield piece, before * N + count * done
            if any(tile.done < done for tile in living):  # stopped within the chunk
                break
            living = [tile for tile in living if tile.alive.any()]
        if not done:  # stopped before the first chunk: record the initial states nevertheless
            for tile in group:
                yield self.on_piece(tile.initial_piece()), before * N
        for tile in group:
            tile.end()

    def _neighbours(self, tiles: Sequence[Tile], rows: int) -> list[list[Tile]]:
        """Group the tiles one by one, or if ``wide`` as many adjacent ones as leave no thread idle.

        A piece of few ``rows`` costs its consumer as much as one of a few hundred.
        """
        most = min(len(tiles) // self.threads, PIECE_ROWS // rows) if self.wide else 1
        neighbours: list[list[Tile]] = []
        for tile in tiles:
            last = neighbours[-1] if neighbours else []
            if last and len(last) < most and last[-1].first + self.tile == tile.first:
                last.append(tile)
            else:
                neighbours.append([tile])
        return neighbours

    def _shared_out(
        self, advance: Callable[[list[Tile]], Kept], tiles: Sequence[list[Tile]], pool: ThreadPoolExecutor
    ) -> list[Kept]:
        """Results of ``advance`` for each of ``tiles``, in their order; every thread takes the next one that is left.

        One task per thread instead of one per tile: with two threads a task costs as much as 500 steps of a trajectory.
        """
        left = deque(range(len(tiles)))
        collected: dict[int, Kept] = {}

        def work() -> None:
            while True:
                try:
                    i = left.popleft()
                except IndexError:
                    return
                collected[i] = advance(tiles[i])

        others = [pool.submit(work) for _ in range(min(self.threads, len(tiles)) - 1)]
        try:
            work()
        finally:
            left.clear()  # matters after a failure only
        for other in others:
            other.result()
        return [collected[i] for i in range(len(tiles))]

    def _one_by_one(self) -> Iterator[tuple[Kept, int]]:
        """Run trajectory after trajectory in the time loop of single runs."""
        stride = math.gcd(self.every, self.N)  # so that step N is among the rows
        for i in range(len(self.y0)):
            run = Run(self.top, self.single_loop(), self.y0[i], self.h, self.N, stride, self.stop)
            for chunk in run:
                asked = chunk.n % self.every == 0
                if len(chunk.n) and (asked[-1] or chunk.n[-1] == self.N):
                    self.last[i], self.last_n[i] = chunk.states[-1], chunk.n[-1]
                elif asked.any():
                    at = int(np.flatnonzero(asked)[-1])
                    self.last[i], self.last_n[i] = chunk.states[at], chunk.n[at]
                n = chunk.n[asked]
                piece = Piece(i, n, chunk.states[asked][None], np.array([len(n)]))
                yield self.on_piece(piece), i * self.N + chunk.done
            ending = run.ending
            assert ending is not None
            self.endings.put(i, ending.outcome, ending.step, list(ending.counters.values()))
            self.run_seconds += run.run_seconds
            if ending.outcome is Outcome.INTERRUPTED:
                return
