"""Recorder of a run: takes each row from the time loop once, for the report and the series."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.columns import attitude_columns, columns, invariant_values
from topcli.analysis.crossings import Crossings
from topcli.analysis.quantities import QuantityTally
from topcli.analysis.tally import InvariantTally
from topcli.config.models import SECTION_TALLY, Experiment
from topcli.contracts import Array, Ending, Method
from topcli.engine.run import CHUNK_ROWS, Chunk, Position, Run
from topcli.runs.report import left_motion
from topcli.store.checkpoint import Checkpoint, read_checkpoint, write_checkpoint
from topcli.store.series import SeriesMark, SeriesWriter

if TYPE_CHECKING:
    from topcli.analysis.algebraic_growth import DigitGrowth
    from topcli.engine.precise import PreciseRun

EVALUATED_ROWS = 256
"""Rows that are evaluated and written together: doing so for a single row costs as much as some thousand steps."""

SECTION_ROWS = 1 << 16
"""Rows of a chunk in which the crossings of a section are sought together."""

COST = 100.0
"""The next checkpoint waits at least this many times the seconds that the last one took: at most 1% of the run."""

Rows = tuple[NDArray[np.int64], Array]
"""Step numbers (m,) and states (m, d)."""


class PendingRows:
    """Rows waiting to be evaluated and written."""

    def __init__(self) -> None:
        self._pieces: list[Rows] = []
        self._count = 0

    def add(self, n: NDArray[np.int64], states: Array) -> None:
        """Append rows: step numbers (m,) and states (m, d); copied unless they fill the batch by themselves."""
        self._pieces.append((n.copy(), states.copy()) if len(n) < EVALUATED_ROWS else (n, states))
        self._count += len(n)

    @property
    def full(self) -> bool:
        """True if there are at least ``EVALUATED_ROWS``."""
        return self._count >= EVALUATED_ROWS

    def rows(self) -> Rows:
        """All rows of the batch."""
        if len(self._pieces) == 1:
            return self._pieces[0]
        if not self._pieces:
            return np.empty(0, dtype=np.int64), np.empty((0, 0))
        return np.concatenate([n for n, _ in self._pieces]), np.concatenate([states for _, states in self._pieces])

    def take(self) -> Rows:
        """All rows of the batch, which is empty afterwards."""
        rows = self.rows()
        self._pieces, self._count = [], 0
        return rows


class Recorder:
    """Pass the rows of a run on, batch by batch, to the ``tally`` of the report and the ``series``; a context manager.

    The invariants of a batch are evaluated once, for both. ``start`` is the checkpoint that an interrupted run
    continues from, bit for bit. Raises ValueError or KeyError for a checkpoint of another form, OSError if the series
    cannot be written, and RunError if its rows are damaged.
    """

    def __init__(
        self, experiment: Experiment, path: Path, metadata: Mapping[str, str], start: Checkpoint | None = None
    ) -> None:
        self._experiment = experiment
        self._modified = experiment.modified
        self._invariants = (*experiment.top.invariants(), *self._modified)
        self._names, self._quantities = experiment.recorded, experiment.quantities
        self.quantities = QuantityTally(self._quantities)
        self._batch = PendingRows()
        self.tally = self.new_tally()
        self._search = experiment.search()
        self.crossings = None if self._search is None else 0
        """Crossings of the section so far; None without one."""
        self.series = SeriesWriter(path, list(self._names), metadata, start.series if start else None)
        if start is not None:
            self.tally.restore(start.tally)
            self.quantities.restore(start.tally)
            if self._search is not None:
                self.crossings = int(start.tally["crossings"][0])
                self._search.last[:] = start.tally["section"]
            if len(start.rows[0]):
                self._batch.add(*start.rows)

    def new_tally(self) -> InvariantTally:
        """Tally of the report."""
        return InvariantTally(self._invariants, self._experiment.h, self._experiment.top)

    def position(self, start: Checkpoint) -> Position:
        """Position at which the time loop continues."""
        return Position(start.done, start.work, *start.about["chunks"])

    @property
    def growth(self) -> DigitGrowth | None:
        """Growth of the numbers of a run in rational numbers; None for any other."""
        return None

    def __enter__(self) -> Recorder:
        self.series.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        self.series.__exit__(*exception)

    def add(self, chunk: Chunk) -> None:
        """Record the rows of a chunk. A chunk cut short never completes a batch: sums depend on where rows are cut."""
        if len(chunk.n):
            self._batch.add(chunk.n, chunk.states)
        if chunk.whole and self._batch.full:
            self._pass_on()

    def _pass_on(self) -> None:
        self.series.write(self.evaluated(*self._batch.take()))

    def evaluated(self, n: NDArray[np.int64], states: Array) -> dict[str, NDArray[Any]]:
        """Add rows to the tally; return their columns. The invariants are evaluated once, for both."""
        top, h = self._experiment.top, self._experiment.h
        attitude: dict[str, NDArray[Any]] = {}
        if form := self._experiment.output.attitude:
            d = len(top.components)
            attitude = attitude_columns(form, states[:, d:])
            states = np.ascontiguousarray(states[:, :d])
        found = None
        if self._search is not None:
            found = self._search.add(n, states[None])
            self.crossings = (self.crossings or 0) + len(found.n)
            n, states = n[at := tallied_rows(n)], np.ascontiguousarray(states[at])
        values = invariant_values(self._invariants, states)
        self.tally.add(n, states, values)
        if found is not None:
            rows = crossing_columns(self._experiment, found, self._names)
            self.quantities.add(rows)
            return rows
        observed = {quantity.name: quantity.values(top, n, h, states) for quantity in self._quantities}
        if len(n):
            self.quantities.add(observed)
        return columns(top, n, h, states, self._names, self._modified, values | observed | attitude)

    def state(self, flush: bool) -> tuple[dict[str, NDArray[Any]], SeriesMark, Rows]:
        """Return the data of a checkpoint on the rows so far; with ``flush``, flush the series to the disk first."""
        sums = {**self.tally.state(), **self.quantities.state()}
        if self._search is not None:
            sums |= {"crossings": np.array([self.crossings]), "section": self._search.last.copy()}
        return sums, self.series.mark(flush=flush), self._batch.rows()

    def finish(self, ending: Ending) -> Ending:
        """Pass on the remaining rows and complete the series; the ending, with the step at which the motion was left.

        Raises OSError.
        """
        if len(self._batch.rows()[0]):
            self._pass_on()
        ending = ending.with_left(self.tally.left_step, self._experiment.h)
        left = {} if ending.left is None else {"topcli.left_motion": json.dumps(left_motion(ending))}
        self.series.finish({"topcli.outcome": ending.outcome.value, "topcli.message": ending.message, **left})
        return ending


def tallied_rows(n: NDArray[np.int64]) -> slice:
    """Rows after ``n`` (m,) steps that the invariant report of a section's run is about."""
    return slice(-int(n[0]) % SECTION_TALLY, None, SECTION_TALLY)


def crossing_columns(experiment: Experiment, found: Crossings, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Columns of crossings: ``n`` is the number of whole steps before each, ``t`` its time."""
    n, h, modified = found.n + found.theta, experiment.h, experiment.modified
    return columns(experiment.top, n, h, found.states, names, modified, {"n": found.n}, experiment.quantities)


def run_of(
    experiment: Experiment,
    method: Method,
    stop: Callable[[], bool] = lambda: False,
    start: Position | None = None,
    precise: PreciseRun | None = None,
) -> Run:
    """Time loop of an experiment in its precision; ``output.attitude`` appends the quaternion to its states."""
    top, y0, h, N, every = experiment.top, experiment.y0, experiment.h, experiment.N, experiment.output.every
    if precise is not None:
        return Run(precise.top, precise.loop, precise.y0, precise.h, N, every, stop, start)
    if not experiment.output.attitude:
        return Run(top, method, y0, h, N, every, stop, start, SECTION_ROWS if experiment.section else CHUNK_ROWS)
    from topcli.engine.attitude import attitude_loop, start_attitude

    loop = attitude_loop(top, experiment.scheme, experiment.options, method)
    return Run(top, loop, (*y0, *start_attitude(top, y0)), h, N, every, stop, start)


@dataclass
class Checkpoints:
    """Save the state of a run: on the disk every ``seconds``, in memory after every row group.

    ``about`` goes into every checkpoint. ``last`` is the last state that could still be written if the disk is full.
    """

    folder: Path
    about: dict[str, Any]
    seconds: float
    clock: Callable[[], float] = time.monotonic
    last: Checkpoint | None = None

    def __post_init__(self) -> None:
        self._due = self.clock() + 0.5 * self.seconds
        self._length = self.last.series.length if self.last else 0
        self._earlier: Checkpoint | None = None

    def consider(self, run: Run, recorder: Recorder) -> None:
        """Write a checkpoint if it is due; to be called between two chunks. Raises OSError."""
        if self.clock() >= self._due:
            self.save(run, recorder)
        elif recorder.series.length != self._length:
            self._length = recorder.series.length
            self._remember(run, recorder, flush=False)

    def _remember(self, run: Run, recorder: Recorder, flush: bool) -> Checkpoint | None:
        position = run.position()
        if position is None:
            return None
        chunks = [position.chunk_rows, position.chunk_steps, position.into]
        about = {**self.about, "run_seconds": run.run_seconds, "chunks": chunks}
        self._earlier = self.last
        self.last = Checkpoint(position.done, position.work, *recorder.state(flush), about)
        return self.last

    def save(self, run: Run, recorder: Recorder) -> None:
        """Write a checkpoint now, except after a failed step, which ends the run. Raises OSError."""
        began = self.clock()
        checkpoint = self._remember(run, recorder, flush=True)
        if checkpoint is None:
            return
        write_checkpoint(self.folder, checkpoint)
        self._length = checkpoint.series.length
        ended = self.clock()
        self._due = ended + (max(self.seconds, COST * (ended - began)) if self.seconds else 0.0)

    def to_save(self) -> Iterator[Checkpoint]:
        """Yield states that may still be written if the disk is full, the furthest first.

        States before the checkpoint that is on the disk by then are left out: writing one would cut the series off
        too early.
        """
        for state in (self.last, self._earlier):
            on_disk = read_checkpoint(self.folder)
            if state is not None and state.done >= (on_disk.done if on_disk else 0):
                yield state
