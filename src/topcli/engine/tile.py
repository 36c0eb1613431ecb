"""A tile of an ensemble: the trajectories that one call of the compiled loop advances side by side.

The compiled loop of a tile goes over the steps and, within each, over the trajectories (the lanes of the tile); the
compiler turns this inner loop into vector instructions. It cannot stop for one lane, so it checks nothing: it adds all
numbers of the working state of each lane to a sum, which an infinity or a nan in any step makes infinite or nan.

After the call ``Tile.advance`` looks at the sums. A lane whose sum is not finite goes back to the start of the chunk
and repeats its steps alone in the time loop of single runs (``engine/loop.py``), with one of two results:

- A step fails. The ending of this trajectory is stored, and from then on its lane copies a living neighbour, so that
  the vector instructions meet no extreme numbers.
- No step fails. Vector code computes both sides of every branch; where single runs take a rare branch, such as a call
  of libm for a large angle, it gives nan instead. The lane takes the state of the single run and continues.

The bits are those of single runs: additions and multiplications are not contracted, and remaining calls of libm are
made for one trajectory after the other. Intel's vector library SVML would change last bits; numba uses it only where
the package icc-rt is installed, which topcli does not require, and not with NUMBA_DISABLE_INTEL_SVML=1.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.fused import fma
from topcli.arithmetic.vectors import VECTOR_VARIANTS
from topcli.contracts import Array, Outcome, Stepper, same_state
from topcli.engine.loop import Loop
from topcli.engine.native import Native
from topcli.engine.run import Endings, in_calls, recorded_rows
from topcli.engine.source import compilable_copy

LONE_FIRST_CALL = 64
"""Steps of the first call of the single loop for a lane that repeats its steps alone."""


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


class RowBuffer(threading.local):
    """A growing buffer of recorded rows for each thread: few pages, which stay in its processor's cache."""

    def __init__(self) -> None:
        self._numbers = np.empty(0)

    def rows(self, lanes: int, rows: int, d: int) -> Array:
        """The calling thread's buffer with shape (lanes, rows, d); its content is arbitrary."""
        size = lanes * rows * d
        if len(self._numbers) < size:
            self._numbers = np.empty(size)
        return self._numbers[:size].reshape(lanes, rows, d)


@dataclass(frozen=True)
class Lanes:
    """Compiled loop over a tile of ``width`` lanes: ``code`` for the ``stepper``.

    ``params`` holds the constants of the top and ``more_parameters``.
    """

    stepper: Stepper
    code: Native
    params: Array
    width: int


class TileContext:
    """Problem, buffers and results that the tiles of an ensemble share.

    Trajectories start in ``y0`` (m, d); ``p`` are the constants of the top. ``endings``, ``last`` (m, d) and ``last_n``
    (m,) are filled by the tiles, each its own part.
    """

    p: Array
    h: float
    N: int
    every: int
    stop: Callable[[], bool]
    buffer: RowBuffer
    y0: Array
    endings: Endings
    last: Array
    last_n: NDArray[np.int64]
    call_steps: int
    """Steps of the next call of the compiled loop."""
    chunk_began: float
    """Clock reading at the start of the current chunk."""

    def single_loop(self) -> Loop:
        """Time loop of single runs."""
        raise NotImplementedError


class Tile:
    """Working states of the trajectories ``first`` to ``stop - 1`` of an ensemble."""

    def __init__(self, context: TileContext, lanes: Lanes, first: int, stop: int) -> None:
        self.context, self.lanes, stepper = context, lanes, lanes.stepper
        self.first, self.count = first, stop - first
        self.alive = np.zeros(lanes.width, dtype=bool)
        self.alive[: self.count] = True
        self.done = 0
        self.uncounted = stepper.width - len(stepper.counters)
        self.work = np.zeros((stepper.width + 1, lanes.width))
        p = (*context.p.tolist(), *stepper.doubles)
        begun = context.y0[first:stop].tolist()
        if stepper.enter:
            begun = [stepper.enter(tuple(y), context.h, p) for y in begun]
        self.work[:-1, : self.count] = np.array(begun).T
        self._fill()

    def _fill(self) -> None:
        """Copy a living trajectory into the idle lanes, whose numbers must not be extreme."""
        if self.alive.any() and not self.alive.all():
            self.work[:, ~self.alive] = self.work[:, [int(np.argmax(self.alive))]]

    def initial_piece(self) -> Piece:
        """The initial states alone."""
        return Piece(
            self.first,
            np.zeros(1, dtype=np.int64),
            self.context.y0[self.first : self.first + self.count, None],
            np.ones(self.count, dtype=np.int64),
        )

    def advance(self, n: NDArray[np.int64], steps: int, until_record: int, buffer: Array) -> NDArray[np.int64]:
        """Take ``steps`` steps, fewer if asked to stop, and record the rows of step numbers ``n`` (m,) in ``buffer``.

        ``buffer`` has shape (width, m, d). The first row of a trajectory's first chunk is its initial state. Return the
        number of rows that each trajectory reached.
        """
        context, d, before = self.context, self.context.y0.shape[1], self.done
        started = int(before == 0)
        saved = self.work[:-1].copy()
        self.work[-1] = 0.0
        if started:
            buffer[: self.count, 0] = context.y0[self.first : self.first + self.count]
        out, stride = buffer.reshape(-1)[started * d :], buffer.shape[1] * d
        steps = self._advance(out, steps, until_record, stride)
        self.done = before + steps
        reached = np.where(self.alive, started + recorded_rows(steps, until_record, context.every), 0)
        for j in np.flatnonzero(~np.isfinite(self.work[-1]) & self.alive):
            reached[j] = started + self._by_itself(int(j), saved[:, j].copy(), buffer[j, started:], steps, until_record)
        some = np.flatnonzero(reached[: self.count])
        at = reached[some] - 1
        context.last[self.first + some], context.last_n[self.first + some] = buffer[some, at], n[at]
        self._fill()
        return reached[: self.count]

    def _advance(self, out: Array, steps: int, until_record: int, stride: int) -> int:
        """Take up to ``steps`` steps, in calls that grow while they are short; return the steps taken."""
        context, lanes, d = self.context, self.lanes, self.context.y0.shape[1]

        def call(taken: int, rows: int, size: int, until: int) -> int:
            lanes.code.checked(self.work, out[rows * d :], lanes.params, context.h, size, context.every, until, stride)
            return size

        taken, _, context.call_steps = in_calls(
            call, steps, context.every, until_record, context.call_steps, context.chunk_began, context.stop
        )
        return taken

    def _by_itself(self, j: int, work: Array, rows: Array, steps: int, until_record: int) -> int:
        """Repeat the steps of lane ``j`` in the time loop of single runs, fewer if asked to stop.

        Return the number of ``rows`` reached.
        """
        context, loop, d = self.context, self.context.single_loop(), rows.shape[1]
        out = np.empty(max(rows.size, d))

        def call(taken: int, reached: int, size: int, until: int) -> int:
            return loop.drive(work, out[reached * d :], context.p, context.h, size, context.every, until)

        went, _, _ = in_calls(
            call, steps, context.every, until_record, LONE_FIRST_CALL, context.chunk_began, context.stop
        )
        good = went if went >= 0 else -went - 1
        reached = recorded_rows(good, until_record, context.every)
        rows[:reached] = out[: reached * d].reshape(reached, d)
        if good == steps:
            self.work[:-1, j] = work
        else:
            self.alive[j] = False
            outcome, step = (Outcome.INTERRUPTED, good) if went >= 0 else (loop.failure(work), good + 1)
            context.endings.put(self.first + j, outcome, self.done - steps + step, work[self.uncounted :])
        return reached

    def end(self) -> None:
        """Store the endings and last states of the living trajectories."""
        context, leave = self.context, self.lanes.stepper.leave
        living = np.flatnonzero(self.alive)
        completed = self.done >= context.N
        outcome = Outcome.COMPLETED if completed else Outcome.INTERRUPTED
        context.endings.put(self.first + living, outcome, self.done, self.work[self.uncounted : -1, living].T)
        unrecorded = living[context.last_n[self.first + living] != context.N] if completed else living[:0]
        if len(unrecorded):  # step N is not among the recorded ones
            p = tuple(context.p.tolist())
            states = self.work[:-1, unrecorded].T.tolist()
            context.last[self.first + unrecorded] = [leave(tuple(y), context.h, p) for y in states] if leave else states
            context.last_n[self.first + unrecorded] = context.N


def advance_together(tiles: Sequence[Tile], steps: int, until_record: int) -> Piece:
    """Take ``steps`` steps with each of neighbouring ``tiles``; return the piece of all rows recorded on the way."""
    first = tiles[0]
    context, done = first.context, first.done
    n = np.arange(done + until_record, done + steps + 1, context.every, dtype=np.int64)
    if done == 0:
        n = np.concatenate([np.zeros(1, dtype=np.int64), n])
    width = first.lanes.width
    buffer = context.buffer.rows(len(tiles) * width, len(n), context.y0.shape[1])
    each = buffer.reshape(len(tiles), width, len(n), -1)
    kept = [tile.advance(n, steps, until_record, rows) for tile, rows in zip(tiles, each, strict=True)]
    return Piece(first.first, n, buffer[: sum(map(len, kept))], np.concatenate(kept))


LANES_SIGNATURE = "pppdqqqq"

_TEMPLATE = """
def make(step, leave):
    def drive(work, out, params, h, steps, every, until_record, stride):
        {set_p}
        k = 0
        left = until_record
        part = h
        for i in range(steps):
            for stage in range({count}):
                {each_part}
                for j in range({tile}):
                    s = step(({work_items}), part, p)
                    {store_s}
                    work[{check} + j] += {sum_s}
            left -= 1
            if left == 0:
                for j in range({tile}):
                    y = leave(({work_items}), h, p)
                    {record}
                k += {row}
                left = every
        return steps

    return drive
"""


@cache
def _template(width: int, checked: int, d: int, constants: int, tile: int, staged: bool) -> Callable[..., Any]:
    newline = "\n" + " " * 20
    text = _TEMPLATE.format(
        set_p=f"p = ({''.join(f'params[{i}], ' for i in range(constants))})",
        tile=tile,
        count=f"int(params[{constants}])" if staged else "1",
        # without stages, terms of h alone are computed before the loop; otherwise every step would wait for them
        each_part=f"part = params[{constants} + 1 + stage] * h" if staged else "",
        work_items="".join(f"work[{i * tile} + j], " for i in range(width)),
        store_s=newline.join(f"work[{i * tile} + j] = s[{i}]" for i in range(width)),
        check=width * tile,
        sum_s=" + ".join(f"s[{i}]" for i in range(checked)),
        record=newline.join(f"out[k + j * stride + {i}] = y[{i}]" for i in range(d)),
        row=d,
    )
    scope: dict[str, Any] = {}
    exec(
        compile(text, f"<lanes {width}/{checked}/{d}/{constants}/{tile}{' in stages' if staged else ''}>", "exec"),
        scope,
    )
    return scope["make"]


def plain_lanes(stepper: Stepper, d: int, constants: int, tile: int) -> Callable[..., int]:
    """The loop over steps and lanes as a plain Python function over indexable buffers.

    ``work`` holds ``width`` rows of ``tile`` numbers and one more, which gathers the sums of the states; ``out`` gets
    ``d`` numbers for every recorded step of a trajectory, whose rows follow each other and begin ``stride`` numbers
    after those of the trajectory before. ``params`` holds the constants, then ``more_parameters``.
    """
    inlined = {id(kernel): stand_in for kernel, stand_in in VECTOR_VARIANTS.items()} | {id(fma): fma}
    step = compilable_copy(stepper.stages[0] if stepper.stages else stepper.step, lambda kernel: kernel, inlined)
    # all but the counters, which are always finite: the nan of a rare branch may be in any other slot
    checked = stepper.width - len(stepper.counters)
    constants += len(stepper.constants)
    make = _template(stepper.width, checked, d, constants, tile, bool(stepper.stages))
    return make(step, stepper.leave or same_state)
