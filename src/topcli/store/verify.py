"""Comparison of the files of a run folder, finished or not, with their recorded checksums."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from topcli.errors import RunError, UsageError, nearest
from topcli.store.checkpoint import CHECKPOINT, read_checkpoint
from topcli.store.files import json_text, sha256_of
from topcli.store.manifest import MANIFEST, DamagedRun, StoredRun, all_runs, read_run, stored_sweep
from topcli.store.parts import is_part, parts_of


@dataclass(frozen=True)
class CheckedFile:
    """One file of a run; ``reason`` describes the damage or, if it is whole, how it was checked."""

    name: str
    damaged: bool
    reason: str


@dataclass(frozen=True)
class CheckedRun:
    """A run folder, ``finished`` or not, and its files."""

    folder: Path
    finished: bool
    files: tuple[CheckedFile, ...]

    @property
    def damaged(self) -> bool:
        """True if any file is damaged."""
        return any(file.damaged for file in self.files)

    def data(self) -> dict[str, Any]:
        """Plain data, ready for JSON."""
        state = "damaged" if self.damaged else "whole"
        files = [asdict(file) for file in self.files]
        return {"folder": str(self.folder), "finished": self.finished, "state": state, "files": files}


def _finished(run: StoredRun) -> CheckedRun:
    damage = run.damage()
    if MANIFEST not in damage and (run.folder / MANIFEST).read_bytes() != json_text(run.manifest).encode():
        damage[MANIFEST] = "its text has changed since it was written"
    names = (MANIFEST, *run.manifest["files"])
    return CheckedRun(
        run.folder, True, tuple(CheckedFile(name, name in damage, damage.get(name, "")) for name in names)
    )


def _unfinished(folder: Path) -> CheckedRun:
    """Check the files from which an unfinished run can be continued."""
    checkpoint = read_checkpoint(folder)
    if checkpoint is None:
        there = (folder / CHECKPOINT).exists()
        reason = "cannot be read" if there else "missing: there is nothing to resume"
        return CheckedRun(folder, False, (CheckedFile(CHECKPOINT, there, reason),))
    files = [CheckedFile(CHECKPOINT, False, f"step {checkpoint.done}")]
    length = checkpoint.series.length
    series = next((path for path in sorted(folder.glob("series.*"))), folder / "series")
    if length:
        try:
            size = series.stat().st_size
            whole = size >= length and sha256_of(series, length) == checkpoint.series.sha256
            reason = f"{length} of {size} bytes belong to the checkpoint"
            if not whole:
                short = f"{size} bytes, {length} at the checkpoint"
                reason = short if size < length else f"the SHA-256 of its first {length} bytes differs"
            files.append(CheckedFile(series.name, not whole, reason))
        except OSError as error:
            files.append(CheckedFile(series.name, True, f"cannot be read ({error.strerror})"))
    return CheckedRun(folder, False, tuple(files))


def check_run(folder: Path) -> CheckedRun | None:
    """Check every file of the run or finished sweep in ``folder``; None if there is neither."""
    run = read_run(folder)
    if isinstance(run, DamagedRun):
        return CheckedRun(folder, True, (CheckedFile(MANIFEST, True, run.reason.removeprefix(f"{MANIFEST}: ")),))
    if run is not None:
        return _finished(run)
    if (sweep := stored_sweep(folder)) is not None:
        return _finished(sweep)
    return _unfinished(folder) if is_part(folder) else None


def intact_run(folder: Path) -> StoredRun:
    """Run in ``folder``, with all its checksums compared.

    Raises UsageError if there is none, and RunError if it is damaged.
    """
    run = read_run(folder)
    if isinstance(run, DamagedRun):
        raise RunError(f"{folder}: {run.reason}; run again with --force")
    if run is None:
        if is_part(folder) or parts_of(folder.parent, folder.name):
            raise UsageError(f"{folder}: the run is unfinished; topcli run --resume continues it")
        hint = ""
        if not os.path.isdir(folder) and not folder.suffix and len(folder.parts) == 1:
            hint = "; give the folder of a run, such as results/NAME"
        elif inside := next(iter(all_runs(folder)), None):
            hint = f"; give one of the runs in it, such as {inside.folder}"
        elif names := [one.folder.name for one in all_runs(folder.parent)]:
            hint = f"; {nearest(folder.name, names)}"
        raise UsageError(f"{folder}: no run is stored here (manifest.json is missing){hint}")
    for name, reason in run.damage().items():
        raise RunError(f"{folder / name}: damaged: {reason}; run again with --force")
    return run


def intact_sweep(folder: Path) -> StoredRun:
    """Finished sweep in ``folder``, with all its checksums compared.

    Raises UsageError if it is not finished, and RunError if it is damaged.
    """
    sweep = stored_sweep(folder)
    if sweep is None:
        raise UsageError(f"{folder}: the sweep is not finished; topcli sweep continues it")
    for name, reason in sweep.damage().items():
        raise RunError(f"{folder / name}: damaged: {reason}; topcli sweep writes it again")
    return sweep
