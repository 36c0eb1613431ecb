"""Run of a scheme in chunks of steps, in constant memory; progress and interruptions come between chunks.

Times are t = n*h, never accumulated. The first row recorded is the initial state itself. The endings of many
trajectories are arrays of a few bytes each; an ``Ending`` is made on access.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, Ending, Method, Outcome, StopAsked, Top, stopping_when
from topcli.engine.loop import Loop, loop_of
from topcli.errors import SchemeCodeError

OUTCOMES = tuple(Outcome)
"""Outcomes in the order of their codes in ``Endings.outcome``."""
CODES = {outcome: code for code, outcome in enumerate(OUTCOMES)}
ARRAYS = ("outcome", "step", "counts", "begun", "left")
"""Arrays of ``Endings`` with a row for each trajectory."""
NO_FAILURE = (Outcome.COMPLETED, Outcome.INTERRUPTED)


class Endings(Sequence[Ending]):
    """Endings of ``count`` trajectories of step ``h``, each interrupted at step 0 until ``put`` replaces it.

    ``outcome`` (m,) holds codes, ``step`` (m,) step numbers, ``counts`` (m, counters) the events named in
    ``counters``; a trajectory that is not ``begun`` (m,) counted none. ``left`` (m,) are the first recorded steps at
    which the states were far off their energy surface, -1 for never.
    """

    def __init__(self, count: int, h: float, counters: Sequence[str] = ()) -> None:
        self.h, self.counters = h, tuple(counters)
        self.outcome: NDArray[np.int8] = np.full(count, CODES[Outcome.INTERRUPTED], dtype=np.int8)
        self.step: NDArray[np.int64] = np.zeros(count, dtype=np.int64)
        self.counts: NDArray[np.int64] = np.zeros((count, len(self.counters)), dtype=np.int64)
        self.begun: NDArray[np.bool_] = np.zeros(count, dtype=bool)
        self.left: NDArray[np.int64] = np.full(count, -1, dtype=np.int64)

    @classmethod
    def joined(cls, parts: Sequence[Endings]) -> Endings:
        """Endings of ``parts`` in their order; all have the same step and counters."""
        endings = cls(0, parts[0].h, parts[0].counters)
        for name in ARRAYS:
            setattr(endings, name, np.concatenate([getattr(part, name) for part in parts]))
        return endings

    def put(self, where: Any, outcome: Outcome, step: int, counts: Any) -> None:
        """Store the ending of the trajectories at ``where`` (an index or several), with ``counts`` (m, counters)."""
        self.outcome[where], self.step[where] = CODES[outcome], step
        self.counts[where], self.begun[where] = counts, True

    def mark_left(self, left: NDArray[np.int64]) -> None:
        """Store ``left`` (m,); completed trajectories that left their motion get the outcome ``left_motion``."""
        self.left[:] = left
        completed = self.outcome == CODES[Outcome.COMPLETED]
        self.outcome[completed & (left >= 0)] = CODES[Outcome.LEFT_MOTION]

    def of(self, which: NDArray[np.int64]) -> Endings:
        """Endings of the trajectories numbered ``which`` (k,) alone."""
        endings = Endings(0, self.h, self.counters)
        for name in ARRAYS:
            setattr(endings, name, getattr(self, name)[which])
        return endings

    @property
    def failed(self) -> NDArray[np.int64]:
        """Numbers of the trajectories that ended neither completed nor interrupted."""
        return np.flatnonzero(~np.isin(self.outcome, [CODES[outcome] for outcome in NO_FAILURE]))

    @property
    def outcomes(self) -> dict[Outcome, int]:
        """Number of trajectories by outcome, for the outcomes that occur."""
        counts = np.bincount(self.outcome, minlength=len(OUTCOMES)).tolist()
        return {outcome: count for outcome, count in zip(OUTCOMES, counts, strict=True) if count}

    @property
    def totals(self) -> dict[str, int]:
        """Events counted over all trajectories; empty if none was begun."""
        if not self.begun.any():
            return {}
        return dict(zip(self.counters, self.counts.sum(axis=0).tolist(), strict=True))

    def __len__(self) -> int:
        return len(self.outcome)

    @overload
    def __getitem__(self, index: int) -> Ending: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[Ending, ...]: ...

    def __getitem__(self, index: int | slice) -> Ending | tuple[Ending, ...]:
        if isinstance(index, slice):
            return tuple(self[i] for i in range(*index.indices(len(self))))
        step = int(self.step[index])
        counted = self.counts[index].tolist() if self.begun[index] else []
        counters = dict(zip(self.counters, counted, strict=False))
        ending = Ending(OUTCOMES[self.outcome[index]], step, step * self.h, counters)
        left = int(self.left[index])
        return ending if left < 0 else replace(ending, left=left, left_t=left * self.h)


CHUNK_ROWS = 8192
CHUNK_STEPS = 1 << 19
"""Steps between two checks of clock and keyboard: some tens of milliseconds."""
PLAIN_STEPS = 1 << 9
"""The same for steps that run in the interpreter."""
PLAIN_NANOSECONDS = 1e8
"""Time for which they are timed at once."""
PRECISE_STEPS = 1 << 4
"""The same for steps in another arithmetic."""
CALL_SECONDS = 0.25
"""Approximate longest time between two calls of ``stop``."""
SAMPLED_STATES = 5000
"""States of a closed form that are timed together."""
FIRST_CALL = 1
"""Steps of the first call of compiled code; later calls take up to eight times those of the one before."""


@dataclass(frozen=True)
class Chunk:
    """Consecutive recorded rows after ``done`` steps: step numbers ``n`` (m,) and ``states`` (m, d).

    A chunk that is not ``whole`` was cut short by an interruption; a resumed run begins with the rest of it.
    The arrays are views into buffers that the next chunk overwrites.
    """

    n: NDArray[np.int64]
    states: Array
    done: int
    whole: bool = True


def recorded_rows(steps: int, until_record: int, every: int) -> int:
    """Number of rows recorded in ``steps`` steps: after ``until_record`` of them, then after every ``every``."""
    return max(0, (steps - until_record) // every + 1)


def next_call_steps(size: int, seconds: float) -> int:
    """Steps of the next call of compiled code, after a call of ``size`` steps that took ``seconds``."""
    return int(max(1, min(8 * size, size * CALL_SECONDS / max(seconds, 1e-9))))


def in_calls(
    call: Callable[[int, int, int, int], int],
    steps: int,
    every: int,
    until_record: int,
    size: int,
    began: float,
    stop: Callable[[], bool],
) -> tuple[int, bool, int]:
    """Take up to ``steps`` steps in calls that grow while they are short, the first of ``size`` steps.

    ``call(taken, rows, size, until_record)`` takes ``size`` steps, after ``taken`` steps and ``rows`` recorded rows,
    and returns the number of steps taken or minus the number of the failed one. Return the same for all calls, True if
    ``stop()`` ended them, and the size of the next call. ``began`` is a clock reading before the first of them.
    """
    taken = 0
    try:
        while True:
            rows, count = recorded_rows(taken, until_record, every), min(steps - taken, size)
            start = time.perf_counter()
            went = call(taken, rows, count, until_record + rows * every - taken)
            now = time.perf_counter()
            if went < 0:
                return went - taken, False, size
            taken += went
            if went < count or taken == steps:
                return taken, False, size
            if now - began > CALL_SECONDS and stop():
                return taken, True, size
            size = next_call_steps(count, now - start)
    except StopAsked:
        return taken, True, size


class Recorded(NamedTuple):
    """All recorded rows of a run, step numbers ``n`` (m,) and ``states`` (m, d), and its ``ending``."""

    n: NDArray[np.int64]
    states: Array
    ending: Ending


@dataclass(frozen=True)
class Position:
    """State from which a run can continue: the number of steps ``done`` and the whole working state.

    Later chunks are cut as they would have been without the stop, because sums over rows depend in their last bits on
    the cut: ``into`` steps of the current chunk are done.
    """

    done: int
    work: Array
    chunk_rows: int
    chunk_steps: int
    into: int = 0


class Run:
    """One run of a compiled scheme: iterate it for chunks, then read ``ending`` and the seconds.

    ``y0`` is the physical initial state in the order of ``top.components``; N steps of size ``h``, every
    ``every``-th recorded. ``stop()`` is called between chunks, and within chunks that take long; once it returns true,
    the run ends as ``interrupted``. With ``start``, the ``position()`` of an earlier equal run, the run continues from
    there, bit for bit. ``method`` may be its time loop, if the caller has that already. Numbers of another arithmetic
    (``engine.precise``) are kept as objects: ``y0``, ``h`` and the constants of ``top`` are then of this arithmetic.
    A chunk has at most ``chunk_rows`` rows.
    """

    def __init__(
        self,
        top: Top,
        method: Method | Loop,
        y0: Sequence[float] | NDArray[Any],
        h: float,
        N: int,
        every: int = 1,
        stop: Callable[[], bool] = lambda: False,
        start: Position | None = None,
        chunk_rows: int = CHUNK_ROWS,
    ) -> None:
        self.top, self.h, self.N, self.every = top, float(h), N, every
        self._stop = stop
        self._step: Any = self.h if isinstance(h, int | float) else h
        self._type: Any = np.float64 if isinstance(h, int | float) else np.object_
        self._y0 = np.array(y0, dtype=self._type)
        self._p = np.array(top.constants(), dtype=self._type)
        self._loop = method if isinstance(method, Loop) else loop_of(method, len(self._y0), len(self._p))
        self.compile_seconds = self._loop.seconds
        self.cached = self._loop.cached
        self.run_seconds = 0.0
        self.ending: Ending | None = None
        chunk_steps = CHUNK_STEPS if self._loop.compiled else PLAIN_STEPS
        if self._type is np.object_:
            chunk_steps = PRECISE_STEPS
        nothing: Any = np.zeros(self._loop.width, dtype=self._type)
        self._position = start or Position(-1, nothing, chunk_rows, chunk_steps)
        if len(self._position.work) != self._loop.width:
            raise ValueError(f"a working state of {len(self._position.work)} numbers, not {self._loop.width}")
        self._failed = False
        self._call_steps = N if self._loop.returns_early else FIRST_CALL if self._loop.compiled else 1

    def position(self) -> Position | None:
        """Copy of the current position; None after a failure and before the first row, where a run cannot continue."""
        if self._failed or self._position.done < 0:
            return None
        return replace(self._position, work=self._position.work.copy())

    def _end(self, outcome: Outcome, step: int, work: Array) -> None:
        names = self._loop.counters
        slots = dict(zip(names, work[len(work) - len(names) :], strict=True))
        if wrong := [name for name, value in slots.items() if not math.isfinite(value)]:
            raise SchemeCodeError(f"the counter {wrong[0]!r} is {slots[wrong[0]]} at step {step}; counters are finite")
        counts = {name: int(value) for name, value in slots.items()}
        advise = self._loop.advice if outcome is Outcome.NO_CONVERGENCE else None
        advice = advise(work.tolist(), self.h) if advise else ""
        self.ending = Ending(outcome, step, step * self.h, counts, advice=advice)

    def __iter__(self) -> Iterator[Chunk]:
        """Chunks of recorded rows; the last one is followed by ``ending`` being set."""
        d, every, N = len(self._y0), self.every, self.N
        work, chunk_rows, chunk_steps = (
            self._position.work.copy(),
            self._position.chunk_rows,
            self._position.chunk_steps,
        )
        out = np.empty(chunk_rows * d, dtype=self._type)
        if self._position.done < 0:
            with np.errstate(all="ignore"):
                self._loop.enter(self._y0, work, self._p, self._step)
            self._position = Position(0, work, chunk_rows, chunk_steps)
            yield Chunk(np.zeros(1, dtype=np.int64), self._y0[None, :], 0)
        done, into = self._position.done, self._position.into
        outcome = Outcome.COMPLETED
        while done < N and outcome is Outcome.COMPLETED:
            if self._stop():
                outcome = Outcome.INTERRUPTED
                break
            began = done - into
            end = began + min(N - began, chunk_steps, every - began % every + (chunk_rows - 1) * every)
            to_record = every - done % every
            taken, stopped = self._advance(work, out, end - done, to_record)
            before = done
            if taken < 0:
                outcome, done = self._loop.failure(work), done - taken
                last_good = done - 1
                self._failed = True
            else:
                done = last_good = done + taken
                outcome = Outcome.INTERRUPTED if stopped else outcome
                into = done - began if stopped else 0
                self._position = Position(done, work, chunk_rows, chunk_steps, into)
            n = np.arange(before + to_record, last_good + 1, every, dtype=np.int64)
            yield Chunk(n, out[: len(n) * d].reshape(len(n), d), last_good, not stopped)
        self._end(outcome, done, work)

    def collect(self) -> Recorded:
        """Run to the end and return the recorded rows, copied, with the ending."""
        n: list[NDArray[np.int64]] = [np.empty(0, dtype=np.int64)]
        states: list[Array] = [np.empty((0, len(self._y0)))]
        for chunk in self:
            n.append(chunk.n.copy())
            states.append(chunk.states.copy())
        assert self.ending is not None
        return Recorded(np.concatenate(n), np.concatenate(states), self.ending)

    def _advance(self, work: Array, out: Array, steps: int, to_record: int) -> tuple[int, bool]:
        """Take up to ``steps`` steps of a chunk, in calls that grow while they are short.

        Return (the steps taken or minus the number of the failed one, True if the run was stopped).
        """
        loop, d = self._loop, len(self._y0)

        def call(taken: int, rows: int, size: int, until: int) -> int:
            return loop.drive(work, out[rows * d :], self._p, self._step, size, self.every, until)

        begin = time.perf_counter()
        try:
            with stopping_when(lambda: time.perf_counter() - begin > CALL_SECONDS and self._stop()):
                taken, stopped, self._call_steps = in_calls(
                    call, steps, self.every, to_record, self._call_steps, begin, self._stop
                )
            return taken, stopped
        finally:
            self.run_seconds += time.perf_counter() - begin


def nanoseconds_per_step(
    runs: Sequence[tuple[Top, Method, Sequence[float], float]],
    steps: int = 50_000,
    repetitions: int = 9,
    clock: Callable[[], int] = time.perf_counter_ns,
) -> list[float]:
    """Median warm time of one step, in nanoseconds, for each (top, method, y0, h), measured in turn.

    Nothing is recorded while the clock runs, and the repetitions are interleaved so that a change of the machine's
    speed affects all of them. A trajectory that blows up is timed up to that point; a step that runs in the interpreter
    is timed over as many as take a tenth of a second. Of a closed form the time of one state is returned.
    """
    prepared = []
    for top, method, y0, h in runs:
        p = np.array(top.constants(), dtype=np.float64)
        loop = loop_of(method, len(y0), len(p))
        prepared.append((loop, np.array(y0, dtype=np.float64), p, h, np.zeros(loop.width)))
    sampled = np.empty(SAMPLED_STATES * max((len(y0) for _, y0, *_ in prepared), default=0))
    times: list[list[float]] = [[] for _ in prepared]
    interpreted = [1] * len(prepared)
    for repetition in range(repetitions + 1):
        for i, (loop, y0, p, h, work) in enumerate(prepared):
            loop.enter(y0, work, p, h)
            start = clock()
            count = steps if loop.compiled else min(steps, interpreted[i])
            if loop.sampled:
                count = min(steps, SAMPLED_STATES)
                taken = loop.drive(work, sampled[: count * len(y0)], p, h, count, 1, 1)
            else:
                taken = 0
                while not taken:  # a block may return before its first step is done
                    taken = loop.drive(work, work, p, h, count, count + 1, count + 1)
            elapsed = clock() - start
            if not repetition:
                interpreted[i] = min(PLAIN_STEPS, 1 + int(PLAIN_NANOSECONDS / max(elapsed, 1)))
            else:
                times[i].append(elapsed / max(1, abs(taken)))
    return [float(np.median(of_run)) for of_run in times]
