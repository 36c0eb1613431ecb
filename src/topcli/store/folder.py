"""Run folder: its inspection, and writing under a temporary name until it is complete.

A folder ``<out>/<name>/`` holds ``series.parquet`` (or ``.csv``), ``report.json``, ``report.md``, ``config.yaml`` and,
written last, ``manifest.json``. A folder without a manifest is an unfinished run and is never read as a result. An
earlier result is never lost.
"""

from __future__ import annotations

import contextlib
import errno
import itertools
import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from topcli.errors import RunError, TopcliError, UsageError
from topcli.store.checkpoint import CHECKPOINT, Checkpoint, read_checkpoint
from topcli.store.files import DamagedError, io_failure, json_text, named, require_writable, sync, write_text
from topcli.store.manifest import MANIFEST, DamagedRun, StoredRun, check_file, read_run, sealed_manifest, stored_run
from topcli.store.parts import (
    LOCK,
    TEMPORARIES,
    Lock,
    Part,
    is_result,
    linked_file,
    lock_new,
    new_part,
    parts_of,
    remove_own,
    remove_remains,
    take_lock,
)
from topcli.store.series import damaged

FAULTS = NO_FOLDER, UNREADABLE, OCCUPIED = "no folder", "unreadable", "occupied"
"""Obstacles to a run: the output folder is a file, the place cannot be read, or holds something else."""
_KEPT = "its last checkpoint is kept; --resume continues it when writing is possible again"


@dataclass(frozen=True)
class Resumable:
    """A run to continue after ``done`` steps: one that was stopped before its end, or one that was killed.

    ``checkpoint`` is None for a complete run that only has to be renamed into its place. ``about`` is its manifest, or
    the data of the checkpoint.
    """

    where: StoredRun | Part
    done: int
    checkpoint: Checkpoint | None
    about: dict[str, Any]


@dataclass(frozen=True)
class Folder:
    """One look at the place of the run ``name`` in ``out``, which changes nothing there.

    Attributes
    ----------
    fault : tuple of str or None
        Kind of obstacle to writing a run there, one of ``FAULTS``, and what is wrong; None if there is none.
    run : StoredRun or None
        Finished run in the place.
    damage : mapping
        Damaged files of that run and their faults.
    linked : bool
        True if the place is a symbolic link.
    parts : tuple of Part
        Runs in progress, and what killed processes left.
    sources : tuple of Resumable
        Runs of this name that can be continued, in the place, in parts and set aside.
    damaged_checkpoint : Path or None
        A checkpoint from which nothing can be continued, if there is no source.
    """

    out: Path
    name: str
    fault: tuple[str, str] | None = None
    run: StoredRun | None = None
    damage: Mapping[str, str] = field(default_factory=dict)
    linked: bool = False
    parts: tuple[Part, ...] = ()
    sources: tuple[Resumable, ...] = ()
    damaged_checkpoint: Path | None = None

    @property
    def target(self) -> Path:
        """Path of the place."""
        return self.out / self.name

    @classmethod
    def look(cls, out: Path, name: str) -> Folder:
        """Look at the place."""
        target = out / name
        try:
            if out.exists() and not out.is_dir():
                return cls(out, name, (NO_FOLDER, "is not a folder"))
            run = read_run(target)
            foreign = run is None and target.exists() and (not target.is_dir() or any(target.iterdir()))
        except OSError as error:
            wrong = f"{str(error.filename or target)[:400]}: {(error.strerror or str(error)).lower()}"
            return cls(out, name, (UNREADABLE, wrong))
        if isinstance(run, DamagedRun):
            return cls(out, name, (OCCUPIED, f"holds a damaged run ({run.reason})"))
        if foreign:
            return cls(out, name, (OCCUPIED, "exists and is not a finished run"))
        parts = tuple(parts_of(out, name))
        places, aside = [target], f"{name}."
        with contextlib.suppress(OSError):
            places += sorted(out / entry for entry in os.listdir(out) if entry.startswith(aside))
        sources = (*_left_by_killed(parts), *_interrupted(places, name))
        left = [] if sources else [*(part.folder for part in parts if not part.alive), *places]
        damaged_checkpoint = next((path for folder in left if (path := folder / CHECKPOINT).exists()), None)
        damage = run.damage(quick=True) if run else {}
        return cls(out, name, None, run, damage, target.is_symlink(), parts, sources, damaged_checkpoint)


def _left_by_killed(parts: tuple[Part, ...]) -> Iterator[Resumable]:
    for part in parts:
        if part.alive:
            continue
        stored = stored_run(part.folder)
        if stored is not None and not stored.interrupted:
            yield Resumable(part, stored.manifest.get("step", 0), None, stored.manifest)
        elif checkpoint := read_checkpoint(part.folder):
            yield Resumable(part, checkpoint.done, checkpoint, checkpoint.about)


def _interrupted(places: list[Path], name: str) -> Iterator[Resumable]:
    for place in places:
        stored = stored_run(place)
        if stored is None or not stored.interrupted or stored.manifest["name"] != name:
            continue
        if checkpoint := read_checkpoint(place):
            yield Resumable(stored, checkpoint.done, checkpoint, checkpoint.about)


def _own(name: str, run: StoredRun) -> bool:
    """True if ``name`` is a file of the run, not one that a user added to its folder."""
    return name in {MANIFEST, CHECKPOINT, LOCK, *run.manifest["files"]}


def replaceable(existing: StoredRun, new: Mapping[str, Any]) -> bool:
    """True if a run with the manifest ``new`` may replace ``existing`` without loss.

    It must be of the same experiment and code. An interrupted run does not replace one that got further.
    """
    further = new.get("outcome") == "interrupted" and not (
        existing.interrupted and existing.manifest.get("step", 0) <= new.get("step", 0)
    )
    return existing.same(new) and not further and all(_own(name, existing) for name in os.listdir(existing.folder))


def _superseded(part: Part, manifest: Mapping[str, Any]) -> bool:
    """True if the run with this ``manifest`` got at least as far as the run of a killed process in ``part``."""
    left = read_checkpoint(part.folder)
    if left is None:
        stored = stored_run(part.folder)
        return stored is not None and replaceable(stored, manifest)
    reached = manifest.get("outcome") != "interrupted" or left.done <= manifest.get("step", 0)
    return reached and all(left.about.get(key) == manifest[key] for key in ("digest", "code"))


class RunWriter:
    """Writer of a run folder: fill ``folder``, then ``commit``.

    Without a commit the folder is removed, unless it holds a checkpoint. An existing run at the target is replaced if
    it is of the same experiment and code and nothing is lost. Any other is renamed to ``<name>.<its digest>`` if the
    writer may ``displace`` it; else it stays, the new run is kept under such a name, and RunError is raised. Of
    identical copies one is kept.

    ``source`` is a folder to continue from: that of a killed process is taken over; an interrupted run is copied and
    stays unchanged until the commit. The run continues from ``checkpoint``, or is already ``complete`` and only has to
    be renamed. ``about`` is shown to other processes: the ``digest`` and ``code`` of the run. ``sha256`` holds known
    checksums of written files.

    Raises UsageError if the output folder cannot be written to or another process works in ``source``, and RunError
    if ``source`` is damaged.
    """

    def __init__(
        self,
        out: Path,
        name: str,
        about: dict[str, Any] | None = None,
        source: StoredRun | Part | None = None,
        displace: bool = True,
    ) -> None:
        self.out, self.name, self.target = out, name, out / name
        self.set_aside: Path | None = None
        self.folder = new_part(out, name)
        self.checkpoint: Checkpoint | None = None
        self.complete: StoredRun | None = None
        self.sha256: dict[str, str] = {}
        self._about, self._source = about or {}, source
        self._displace = displace or source is not None
        self._lock: Lock | None = None

    def __enter__(self) -> RunWriter:
        require_writable(self.out)
        try:
            remove_remains(self.out, self.name)
            if isinstance(self._source, Part):
                self._take_over(self._source)
            else:
                self.folder.mkdir()
                self._lock = lock_new(self.folder, self._about)
                if self._source is not None:
                    self._copy(self._source)
        except (OSError, TopcliError) as error:
            kept = _KEPT
            if not isinstance(self._source, Part):
                remove_own(self.folder)
                kept = "nothing was written" if self._source is None else "the interrupted run is unchanged"
            if self._lock is not None:
                self._lock.release()
            if isinstance(error, OSError):
                raise io_failure(error, self.out, kept) from None
            raise
        if self._source is not None:
            self.checkpoint = read_checkpoint(self.folder)
        return self

    def _take_over(self, part: Part) -> None:
        if link := linked_file(part.folder):
            raise UsageError(f"{link}: is not a regular file; remove it to resume this run")
        self._lock = take_lock(part.folder, self._about)
        if self._lock is None:
            raise UsageError(f"{self.target}: another process has just begun to continue this run")
        os.rename(part.folder, self.folder)
        for name in os.listdir(self.folder):
            if TEMPORARIES.fullmatch(name):
                (self.folder / name).unlink()
        self.complete = stored_run(self.folder)
        if self.complete is not None and self.complete.interrupted:
            (self.folder / MANIFEST).unlink()
            self.complete = None

    def _copy(self, run: StoredRun) -> None:
        for path in (run.series, run.folder / CHECKPOINT):  # the checkpoint last: it refers to the series
            try:
                check_file(path, run.manifest["files"].get(path.name, {"size": -1}))
            except DamagedError as error:
                raise damaged(path, str(error)) from None
            shutil.copyfile(path, self.folder / path.name)
            sync(self.folder / path.name)

    def __exit__(self, *exception: object) -> None:
        if not (self.folder / CHECKPOINT).exists() and not (self.folder / MANIFEST).exists():
            remove_own(self.folder)
        if self._lock is not None:
            self._lock.release()

    @property
    def finished(self) -> bool:
        """True if the folder is complete and only has to be renamed into place."""
        return (self.folder / MANIFEST).exists()

    def failure(self, error: OSError, kept: str = "nothing of this run was stored") -> RunError:
        """Error to report after a failed write; says which data are kept."""
        if self.finished:
            kept = f"the finished run is kept in {self.folder}, and --resume puts it in its place"
        elif not self.folder.exists() and (self.target / MANIFEST).exists():
            kept = "the finished run is stored in its folder"
        elif left := read_checkpoint(self.folder):
            kept = f"{_KEPT} (up to step {left.done})"
        return io_failure(error, self.target, kept)

    def commit(self, manifest: Mapping[str, Any], texts: Mapping[str, str]) -> StoredRun:
        """Write ``texts`` by file name and the manifest, flush all to the disk and rename the folder into place.

        The checkpoint is removed after the manifest has been written, unless the run is interrupted.
        Raises OSError, and RunError if another process has put a different run there.
        """
        for name, text in texts.items():
            path = self.folder / name
            try:
                path.write_text(text, encoding="utf-8")
            except OSError as error:
                raise named(error, path) from None
        kept = {CHECKPOINT} if manifest.get("outcome") == "interrupted" else set()
        files = sorted(name for name in os.listdir(self.folder) if is_result(name) or name in kept)
        complete = sealed_manifest(self.folder, manifest, {name: self.sha256.get(name) for name in files})
        for name in files:
            sync(self.folder / name)
        write_text(self.folder / MANIFEST, json_text(complete))
        return self.put_in_place(complete)

    def put_in_place(self, manifest: dict[str, Any]) -> StoredRun:
        """Rename the folder with this ``manifest`` into place. Raises OSError, and RunError like ``commit``."""
        for name in {LOCK, CHECKPOINT} - set(manifest["files"]):
            (self.folder / name).unlink(missing_ok=True)
        self._rename(manifest)
        sync(self.out)
        for part in parts_of(self.out, self.name):
            if not part.alive and _superseded(part, manifest):
                remove_own(part.folder)
        return StoredRun(self.target, manifest)

    def _rename(self, manifest: dict[str, Any]) -> None:
        """Rename into place, after renaming an existing run. Every rename is atomic, so nothing is lost."""
        superseded: list[Path] = []
        while True:
            try:
                os.rename(self.folder, self.target)
                break
            except OSError as error:
                if error.errno not in (errno.EEXIST, errno.ENOTEMPTY):
                    raise
            if not self._displace and self._outdone(manifest):
                break
            try:
                aside = self._move_aside(self.target)
            except FileNotFoundError:
                continue  # another process moved it first
            earlier = stored_run(aside)
            if earlier is not None and replaceable(earlier, manifest):
                superseded.append(aside)
            else:
                self.set_aside = self._one_copy(aside)
        for old in superseded:
            remove_own(old)

    def _outdone(self, manifest: dict[str, Any]) -> bool:
        """True if another process has meanwhile put the same run at the target; this copy is then removed.

        Raises RunError if it has put a different one there, which stays.
        """
        existing = stored_run(self.target)
        if existing is None:
            return False
        same_format = existing.manifest["series"] == manifest["series"]
        if same_format and existing.complete(manifest) and not existing.damage(quick=True):
            remove_own(self.folder)
            return True
        if existing.manifest["digest"] == manifest["digest"]:
            return False
        kept = self._one_copy(self._move_aside(self.folder))
        raise RunError(
            f"{self.target}: another process has meanwhile put a different experiment there; this run is kept as {kept}"
        )

    def _asides(self, run: StoredRun | None) -> Iterator[Path]:
        """Paths to which ``run`` may be moved aside, in the order to try them."""
        first = f"{self.name}.{run.manifest['digest'][:8] if run else 'unfinished'}"
        return (self.out / (first if k == 1 else f"{first}.{k}") for k in itertools.count(1))

    def _move_aside(self, folder: Path) -> Path:
        """Rename ``folder`` to the first free one of ``_asides``. Raises OSError."""
        for aside in self._asides(stored_run(folder)):
            if os.path.lexists(aside):
                continue
            try:
                os.rename(folder, aside)
            except OSError as error:
                if error.errno not in (errno.EEXIST, errno.ENOTEMPTY, errno.ENOTDIR):
                    raise
            else:
                return aside
        raise AssertionError("unreachable: the names do not end")

    def _one_copy(self, aside: Path) -> Path:
        """Remove the run at ``aside`` if an identical copy is there already; the path of the copy that remains."""
        run = stored_run(aside)
        if run is None or any(not _own(name, run) for name in os.listdir(aside)):
            return aside
        for before in self._asides(run):
            if before == aside or not os.path.lexists(before):
                break
            earlier = stored_run(before)
            if earlier is not None and earlier.identical(run.manifest) and not earlier.damage():
                remove_own(aside)
                return before
        return aside
