"""Long runs: when to write a checkpoint, what there is to go on from, and why it is refused."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.drift import InvariantTally
from topcli.config.models import Experiment
from topcli.engine.loop import Position, Run
from topcli.errors import UsageError
from topcli.store.checkpoint import CHECKPOINT, Checkpoint, read_checkpoint, write_checkpoint
from topcli.store.growing import damaged
from topcli.store.manifest import StoredRun, stored_run
from topcli.store.parts import Part, parts_of, release_reserve, reserve
from topcli.store.provenance import environment, now
from topcli.store.run_folder import RunWriter, require_place
from topcli.store.series import SeriesWriter

CHECKPOINT_SECONDS = 10.0
"""Between two checkpoints; the first comes after half of it."""
COST = 100.0
"""A checkpoint is not written before this many times the seconds that the last one took: at most 1% of the run."""


BATCH = 256
"""Rows that are gathered before they are tallied and written: a row alone costs as much as some thousand steps."""


class Batch:
    """Rows not yet tallied and written: step numbers and states; a checkpoint holds them, too."""

    def __init__(self, start: Checkpoint | None = None) -> None:
        self._pieces: list[tuple[NDArray[Any], NDArray[Any]]] = []
        self._rows = 0
        if start is not None and len(start.rows[0]):
            self.add(*start.rows)

    def add(self, n: NDArray[Any], states: NDArray[Any]) -> None:
        """Gather rows: step numbers (m,) and states (m, d); copied unless they are enough by themselves."""
        self._pieces.append((n.copy(), states.copy()) if len(n) < BATCH else (n, states))
        self._rows += len(n)

    @property
    def enough(self) -> bool:
        """Whether it is time to take them."""
        return self._rows >= BATCH

    def rows(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """All that is gathered."""
        if len(self._pieces) == 1:
            return self._pieces[0]
        if not self._pieces:
            return np.empty(0, dtype=np.int64), np.empty((0, 0))
        return np.concatenate([n for n, _ in self._pieces]), np.concatenate([states for _, states in self._pieces])

    def take(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """The same, which are then no longer held."""
        rows = self.rows()
        self._pieces, self._rows = [], 0
        return rows


@dataclass(frozen=True)
class Source:
    """Something to go on from: a run stopped before its end, or one that was killed; after ``done`` steps.

    ``checkpoint`` is None for a run that lacks nothing but its place.
    """

    where: StoredRun | Part
    done: int
    checkpoint: Checkpoint | None
    about: dict[str, Any]

    @property
    def folder(self) -> Path:
        """Where it lies."""
        return self.where.folder


def _sources(out: Path, name: str) -> Iterator[Source]:
    for part in parts_of(out, name):
        stored = stored_run(part.folder)
        if part.alive:
            continue
        if stored is not None and not stored.interrupted:
            yield Source(part, stored.manifest.get("step", 0), None, stored.manifest)
        elif checkpoint := read_checkpoint(part.folder):
            yield Source(part, checkpoint.done, checkpoint, checkpoint.about)
    for folder in _standing(out, name):
        stored = stored_run(folder)
        if stored is not None and stored.interrupted and stored.manifest.get("name") == name:
            checkpoint = read_checkpoint(folder)
            if checkpoint is not None:
                yield Source(stored, checkpoint.done, checkpoint, checkpoint.about)


def _standing(out: Path, name: str) -> Iterator[Path]:
    """The folder of the run ``name``, and those of the runs that were set aside for it."""
    yield out / name
    with contextlib.suppress(OSError), os.scandir(out) as entries:
        yield from (out / found for found in sorted(e.name for e in entries if e.name.startswith(f"{name}.")))


def _flat(data: Any, path: str = "") -> dict[str, Any]:
    if not isinstance(data, dict):
        return {path: data}
    found: dict[str, Any] = {}
    for key, value in data.items():
        found |= _flat(value, f"{path}.{key}" if path else key)
    return found


def difference(there: dict[str, Any], here: dict[str, Any]) -> str:
    """What differs between two resolved configs, in half a line: ``h: 0.001 there, 0.002 here``."""
    one, other = _flat(there), _flat(here)
    keys = [key for key in dict.fromkeys([*one, *other]) if one.get(key) != other.get(key)]
    told = [f"{key}: {one.get(key, 'nothing')} there, {other.get(key, 'nothing')} here" for key in keys]
    return "; ".join(told[:3]) + ("; ..." if len(told) > 3 else "")


def find_source(experiment: Experiment, out: Path, code: str) -> Source | None:
    """The unfinished run of ``experiment`` by this ``code`` in ``out`` that got furthest; None for none, or no need.

    Raises UsageError when another process is running it, or when what is there belongs to a different experiment or
    other code, and RunError when it is damaged.
    """
    name, digest = experiment.name, experiment.digest
    standing = require_place(out, name)
    if standing is not None and standing.up_to_date(digest, code):
        return None
    found = list(_sources(out, name))
    fitting = [s for s in found if s.about.get("digest") == digest and s.about.get("code") == code]
    if running := running_process(experiment, out):
        raise UsageError(f"{out / name}: process {running} is running this experiment now; there is nothing to resume")
    if fitting:
        return max(fitting, key=lambda source: (source.checkpoint is None, source.done))
    if not found:
        _refuse_damaged(out, name)
        return None
    other = max(found, key=lambda source: (source.about.get("digest") == digest, source.done))
    if other.about.get("digest") == digest:
        why = f"was made by other code of the scheme {experiment.scheme.name}"
    else:
        told = difference(other.about.get("config", {}), experiment.resolved())
        why = f"is of a different experiment ({told})"
    raise UsageError(
        f"{other.folder}: the unfinished run, at step {other.done}, {why}; nothing was written and it is kept",
        "resume it with the config and code that it was begun with, or start again without --resume",
    )


def _refuse_damaged(out: Path, name: str) -> None:
    """Raises RunError if there is a checkpoint, of which it is known that nothing can be continued from it."""
    for folder in [*(part.folder for part in parts_of(out, name) if not part.alive), *_standing(out, name)]:
        if (folder / CHECKPOINT).exists():
            raise damaged(folder / CHECKPOINT, "or written by another version of topcli")


def running_process(experiment: Experiment, out: Path) -> int | None:
    """The number of another process that is running the same experiment into ``out``; None when there is none."""
    for part in parts_of(out, experiment.name):
        if part.alive and part.owner.get("digest") == experiment.digest:
            return part.owner["pid"]
    return None


def say_what_could_be_resumed(experiment: Experiment, out: Path, code: str, tell: Callable[[str], None]) -> None:
    """Tell, before a run starts afresh, of what ``--resume`` would go on from, or of who runs the same."""
    if not parts_of(out, experiment.name) and not (out / experiment.name / CHECKPOINT).exists():
        return
    if running := running_process(experiment, out):
        tell(f"{experiment.name}: process {running} is running this experiment too")
    fitting = [s for s in _sources(out, experiment.name) if s.about.get("digest") == experiment.digest]
    best = max((s for s in fitting if s.about.get("code") == code), key=lambda source: source.done, default=None)
    if best is not None:
        tell(
            f"{experiment.name}: starts afresh; an unfinished run of it is there at step {best.done} of "
            f"{experiment.N}, which --resume would continue"
        )


@dataclass
class Checkpoints:
    """Takes the state of a run down: on the disk every so many ``seconds``, in memory behind every row group.

    ``about`` goes into every checkpoint. ``kept`` is the last step that the disk can go on from, None for none;
    ``last`` is the last state that could be written out and gone on from should the disk be full.
    """

    writer: RunWriter
    about: dict[str, Any]
    seconds: float = CHECKPOINT_SECONDS
    clock: Callable[[], float] = time.monotonic
    kept: int | None = None
    last: Checkpoint | None = None

    def __post_init__(self) -> None:
        self._due = self.clock() + 0.5 * self.seconds
        self._length = self.last.series.length if self.last else 0
        self._earlier: Checkpoint | None = None
        if self.last:
            self.kept = self.last.done

    def consider(self, run: Run, tally: InvariantTally, series: SeriesWriter, batch: Batch) -> None:
        """Between two chunks: write a checkpoint when it is time. Raises OSError."""
        if self.clock() >= self._due:
            reserve(self.writer.folder)
            self.save(run, tally, series, batch)
        elif series.length != self._length:
            self._length = series.length
            self._remember(run, tally, series, batch, flush=False)

    def _remember(
        self, run: Run, tally: InvariantTally, series: SeriesWriter, batch: Batch, flush: bool
    ) -> Checkpoint | None:
        position = run.position()
        if position is None:
            return None
        about = {
            **self.about,
            "run_seconds": run.run_seconds,
            "chunks": [position.chunk_rows, position.chunk_steps, position.into],
        }
        self._earlier = self.last
        self.last = Checkpoint(
            position.done, position.work, tally.state(), series.mark(flush=flush), batch.rows(), about
        )
        return self.last

    def save(self, run: Run, tally: InvariantTally, series: SeriesWriter, batch: Batch) -> None:
        """Write a checkpoint now; none after a failed step, which is the run's end. Raises OSError."""
        began = self.clock()
        checkpoint = self._remember(run, tally, series, batch, flush=True)
        if checkpoint is None:
            return
        write_checkpoint(self.writer.folder, checkpoint)
        self.kept, self._length = checkpoint.done, checkpoint.series.length
        now = self.clock()
        self._due = now + (max(self.seconds, COST * (now - began)) if self.seconds else 0.0)

    def to_save(self) -> list[Checkpoint]:
        """When the disk is full: the states that may still be written out, the furthest first, after making room.

        None from before what the disk already goes on from: writing it would cut the series off too early.
        """
        release_reserve(self.writer.folder)
        known = [state for state in (self.last, self._earlier) if state is not None]
        return [state for state in known if state.done >= (self.kept or 0)]


def position_of(checkpoint: Checkpoint) -> Position:
    """Where the engine goes on."""
    return Position(checkpoint.done, checkpoint.work, *checkpoint.about["chunks"])


def begun(experiment: Experiment, identity: dict[str, str], start: Checkpoint | None) -> dict[str, Any]:
    """What every checkpoint of a run tells: experiment, code, environment, when it began, where it was resumed."""
    resumed = [*start.about["resumed"], {"step": start.done, "at": now()}] if start else []
    return {
        **identity,
        "name": experiment.name,
        "config": experiment.resolved(),
        "environment": environment(),
        "started": start.about["started"] if start else now(),
        "resumed": resumed,
    }


def checked_start(
    experiment: Experiment,
    writer: RunWriter,
    source: Source | None,
    identity: dict[str, str],
    tell: Callable[[str], None],
) -> Checkpoint | None:
    """Where a run to be resumed goes on from, now that nobody else works there; None to start afresh. Tells which.

    Raises UsageError when what was found is no longer there.
    """
    if source is None:
        tell(f"{experiment.name}: nothing to resume; starts afresh")
        return None
    start = writer.checkpoint
    if start is None or not start.belongs_to(identity["digest"], identity["code"]):
        raise UsageError(f"{source.folder}: changed while it was being resumed; try again")
    tell(f"{experiment.name}: continues from step {start.done} of {experiment.N}")
    told = difference(start.about["environment"], environment())
    if told:
        tell(f"{experiment.name}: begun elsewhere ({told}): the last bits may differ from an uninterrupted run's")
    return start
