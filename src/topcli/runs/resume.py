"""Long runs: when to write a checkpoint, which unfinished run to continue, and why one is refused."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from topcli.config.models import OUTSIDE_IDENTITY, name_fault
from topcli.engine.loop import Position, Run
from topcli.errors import UsageError
from topcli.runs.identity import Identity
from topcli.runs.recorder import Recorder
from topcli.store.checkpoint import CHECKPOINT, Checkpoint, read_checkpoint, write_checkpoint
from topcli.store.manifest import StoredRun, stored_run
from topcli.store.parts import Part, parts_of, release_reserve, reserve
from topcli.store.provenance import environment, now
from topcli.store.run_folder import RunWriter, require_place
from topcli.store.series import damaged

CHECKPOINT_SECONDS = 10.0
"""Seconds between two checkpoints; the first one comes after half of it."""
COST = 100.0
"""The next checkpoint waits at least this many times the seconds that the last one took: at most 1% of the run."""


@dataclass(frozen=True)
class Source:
    """A run to continue after ``done`` steps: one that was stopped before its end, or one that was killed.

    ``checkpoint`` is None for a complete run that only has to be renamed into its place.
    """

    where: StoredRun | Part
    done: int
    checkpoint: Checkpoint | None
    about: dict[str, Any]

    @property
    def folder(self) -> Path:
        """Folder of the run."""
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
    for folder in _places(out, name):
        stored = stored_run(folder)
        if stored is not None and stored.interrupted and stored.manifest.get("name") == name:
            checkpoint = read_checkpoint(folder)
            if checkpoint is not None:
                yield Source(stored, checkpoint.done, checkpoint, checkpoint.about)


def _places(out: Path, name: str) -> Iterator[Path]:
    """Folder of the run ``name``, and those of earlier runs of that name that were set aside."""
    yield out / name
    with contextlib.suppress(OSError), os.scandir(out) as entries:
        yield from (out / found for found in sorted(e.name for e in entries if e.name.startswith(f"{name}.")))


def flattened(data: Any, path: str = "") -> dict[str, Any]:
    """Values of a resolved config by their dotted keys."""
    if not isinstance(data, dict):
        return {path: data}
    found: dict[str, Any] = {}
    for key, value in data.items():
        found |= flattened(value, f"{path}.{key}" if path else key)
    return found


def difference(there: dict[str, Any], here: dict[str, Any]) -> str:
    """First differences in half a line, such as ``h: 0.001 there, 0.002 here``; empty if both are equal.

    The keys of a resolved config that do not belong to the identity of a run are left out.
    """
    one, other = flattened(there), flattened(here)
    keys = [key for key in dict.fromkeys([*one, *other]) if one.get(key) != other.get(key)]
    keys = [key for key in keys if key not in OUTSIDE_IDENTITY]
    found = [f"{key}: {one.get(key, 'nothing')} there, {other.get(key, 'nothing')} here" for key in keys]
    return "; ".join(found[:3]) + ("; ..." if len(found) > 3 else "")


def find_source(identity: Identity, out: Path) -> Source | None:
    """Unfinished run in ``out`` of the same experiment and code that got furthest; None if there is none to continue.

    Raises UsageError if another process is running it, or if an unfinished run of that name is of a different
    experiment or other code, and RunError if it is damaged.
    """
    name, config = identity.name, identity.config
    existing = require_place(out, name)
    if existing is not None and existing.up_to_date(identity.digests):
        return None
    found = list(_sources(out, name))
    if running := running_process(identity, out):
        raise UsageError(f"{out / name}: process {running} is running this experiment now; there is nothing to resume")
    if fitting := [source for source in found if identity.same(source.about)]:
        best = max(fitting, key=lambda source: (source.checkpoint is None, source.done))
        _require_format(best, config["output"]["format"])
        return best
    if not found:
        _refuse_damaged(out, name)
        return None
    other = max(found, key=lambda source: (source.about.get("digest") == identity.digest, source.done))
    if other.about.get("digest") == identity.digest:
        why = f"was made by other code of the scheme {config['scheme']['name']}"
    elif differs := difference(other.about.get("config", {}), config):
        why = f"is of a different experiment ({differs})"
    else:
        why = "was begun by another version of topcli"
    raise UsageError(
        f"{other.folder}: the unfinished run, at step {other.done}, {why}; nothing was written and it is kept",
        "resume it with its own config and code, or start again without --resume",
    )


def config_to_resume(out: Path, name: str) -> dict[str, Any] | None:
    """Config of the unfinished run ``name`` in ``out`` that got furthest, or of the finished one; None without a run.

    Raises UsageError if another process is computing the only one.
    """
    if name_fault(name):
        return None
    found = sorted(_sources(out, name), key=lambda source: source.done)
    if found:
        return found[-1].about["config"]
    if running := next((part.owner.get("pid") for part in parts_of(out, name) if part.alive), None):
        raise UsageError(f"{out / name}: process {running} is computing this run now; there is nothing to resume")
    finished = stored_run(out / name)
    return finished.manifest["config"] if finished else None


def _require_format(source: Source, wanted: str) -> None:
    """Raise UsageError if the rows of an unfinished run are in another format than ``wanted``."""
    output = source.about["config"].get("output", {})
    if (found := output.get("format", wanted)) != wanted:
        raise UsageError(
            f"{source.folder}: the unfinished run, at step {source.done}, is written as {found}, not {wanted}",
            f"resume it with --format {found}; once finished, it is rewritten if {wanted} is asked for",
        )


def _refuse_damaged(out: Path, name: str) -> None:
    """Raise RunError if there is a checkpoint; it is known that none can be continued."""
    for folder in [*(part.folder for part in parts_of(out, name) if not part.alive), *_places(out, name)]:
        if (folder / CHECKPOINT).exists():
            raise damaged(folder / CHECKPOINT, "or written by another version of topcli")


def running_process(identity: Identity, out: Path) -> int | None:
    """Process number of another process that runs the same experiment into ``out``; None if there is none."""
    for part in parts_of(out, identity.name):
        if part.alive and part.owner.get("digest") == identity.digest:
            return part.owner["pid"]
    return None


def report_unfinished(identity: Identity, out: Path, tell: Callable[[str], None]) -> None:
    """Before a run starts at step 0, report what ``--resume`` would continue, or which process runs the same."""
    name, N = identity.name, identity.config["N"]
    if not parts_of(out, name) and not (out / name / CHECKPOINT).exists():
        return
    if running := running_process(identity, out):
        tell(f"{name}: process {running} is running this experiment too")
    fitting = (source for source in _sources(out, name) if identity.same(source.about))
    best = max(fitting, key=lambda source: source.done, default=None)
    if best is not None:
        tell(f"{name}: starting from step 0; --resume would continue an unfinished run at step {best.done} of {N}")


@dataclass
class Checkpoints:
    """Save the state of a run: on the disk every ``seconds``, in memory after every row group.

    ``about`` goes into every checkpoint. ``last`` is the last state that could still be written if the disk is full.
    """

    writer: RunWriter
    about: dict[str, Any]
    seconds: float = CHECKPOINT_SECONDS
    clock: Callable[[], float] = time.monotonic
    last: Checkpoint | None = None

    def __post_init__(self) -> None:
        self._due = self.clock() + 0.5 * self.seconds
        self._length = self.last.series.length if self.last else 0
        self._earlier: Checkpoint | None = None

    def consider(self, run: Run, recorder: Recorder) -> None:
        """Write a checkpoint if it is due; to be called between two chunks. Raises OSError."""
        if self.clock() >= self._due:
            reserve(self.writer.folder)
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
        self.last = Checkpoint(position.done, recorder.stored(position.work), *recorder.state(flush), about)
        return self.last

    def save(self, run: Run, recorder: Recorder) -> None:
        """Write a checkpoint now, except after a failed step, which ends the run. Raises OSError."""
        began = self.clock()
        checkpoint = self._remember(run, recorder, flush=True)
        if checkpoint is None:
            return
        write_checkpoint(self.writer.folder, checkpoint)
        self._length = checkpoint.series.length
        ended = self.clock()
        self._due = ended + (max(self.seconds, COST * (ended - began)) if self.seconds else 0.0)

    def to_save(self) -> Iterator[Checkpoint]:
        """Yield states that may still be written if the disk is full, the furthest first, after making room.

        States before the checkpoint that is on the disk by then are left out: writing one would cut the series off
        too early.
        """
        release_reserve(self.writer.folder)
        for state in (self.last, self._earlier):
            on_disk = read_checkpoint(self.writer.folder)
            if state is not None and state.done >= (on_disk.done if on_disk else 0):
                yield state


def position_of(checkpoint: Checkpoint, recorder: Recorder) -> Position:
    """Position at which the time loop continues."""
    return Position(checkpoint.done, recorder.loaded(checkpoint.work), *checkpoint.about["chunks"])


def checkpoint_data(identity: Identity, start: Checkpoint | None) -> dict[str, Any]:
    """Plain data in every checkpoint of a run: experiment, code, environment, when it was started and resumed."""
    resumed = [*start.about["resumed"], {"step": start.done, "at": now()}] if start else []
    return {
        **identity.digests,
        "name": identity.name,
        "config": identity.config,
        "environment": environment(),
        "started": start.about["started"] if start else now(),
        "resumed": resumed,
    }


def checked_start(
    identity: Identity, writer: RunWriter, source: Source | None, tell: Callable[[str], None]
) -> Checkpoint | None:
    """Checkpoint of a run to be resumed, now that this process holds its lock; None to start from step 0.

    Reports which. Raises UsageError if the folder has changed since ``source`` was found.
    """
    name = identity.name
    if source is None:
        tell(f"{name}: nothing to resume; starting from step 0")
        return None
    start = writer.checkpoint
    if start is None or not identity.same(start.about):
        raise UsageError(f"{source.folder}: changed while it was being resumed; try again")
    tell(f"{name}: continues from step {start.done} of {identity.config['N']}")
    if found := difference(start.about["environment"], environment()):
        tell(f"{name}: started in another environment ({found}); the last bits may differ from an uninterrupted run")
    return start
