"""Run folders: written under a temporary name, whole or not at all; an earlier result is never lost.

A folder ``<out>/<name>/`` holds ``series.parquet`` (or ``.csv``), ``report.json``, ``report.md``, ``config.yaml`` and,
written last, ``manifest.json``. A folder without a manifest is an unfinished run and never read as a result.
"""

from __future__ import annotations

import errno
import json
import os
import secrets
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from topcli.errors import RunError, UsageError
from topcli.store.checkpoint import CHECKPOINT, Checkpoint, read_checkpoint, sync
from topcli.store.parts import LOCK, MANIFEST, Lock, Part, lock_new, new_part, parts_of, release_reserve, take_lock

MANIFEST_VERSION = 1


@dataclass(frozen=True)
class StoredRun:
    """A finished run folder and its manifest."""

    folder: Path
    manifest: dict[str, Any]

    @property
    def series(self) -> Path:
        """The file that holds the time series."""
        return self.folder / str(self.manifest["series"])

    def report(self) -> dict[str, Any]:
        """The content of ``report.json``. Raises RunError when it is missing or damaged."""
        path = self.folder / "report.json"
        try:
            return json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise RunError(f"{path}: cannot be read ({error}); run again with --force") from None

    def same_experiment(self, digest: str) -> bool:
        """Whether this is a run of the experiment with this digest."""
        return self.manifest.get("digest") == digest

    def up_to_date(self, digest: str, code: str) -> bool:
        """Whether nothing would change by running again: the same experiment and code, ended by itself, all there."""
        return (
            self.same_experiment(digest)
            and self.manifest.get("code") == code
            and not self.interrupted
            and all(_size(self.folder / name) == size for name, size in self.manifest.get("files", {"": 0}).items())
        )

    @property
    def interrupted(self) -> bool:
        """Whether the run was stopped before its end."""
        return self.manifest.get("outcome") == "interrupted"

    def replaceable(self, new: Mapping[str, Any]) -> bool:
        """Whether a run with the manifest ``new`` may take this one's place and nothing be lost.

        It must be of the same experiment by the same code; an interrupted one does not replace one that got further.
        """
        own = {MANIFEST, CHECKPOINT, LOCK, *self.manifest.get("files", {})}
        further = new.get("outcome") == "interrupted" and not (
            self.interrupted and self.manifest.get("step", 0) <= new.get("step", 0)
        )
        return (
            self.same_experiment(new["digest"])
            and self.manifest.get("code") == new.get("code")
            and not further
            and all(entry.name in own for entry in self.folder.iterdir())
        )


def stored_run(folder: Path) -> StoredRun | None:
    """The finished run in ``folder``; None when there is no folder, no manifest, or not one of ours."""
    try:
        manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(manifest, dict) or "digest" not in manifest or "series" not in manifest:
        return None
    return StoredRun(folder, manifest)


def stored_runs(out: Path) -> list[StoredRun]:
    """The finished runs in the folders of ``out``, by name."""
    try:
        folders = sorted(entry for entry in out.iterdir() if entry.is_dir() and not entry.name.startswith("."))
    except OSError:
        return []
    return [run for run in map(stored_run, folders) if run]


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file under a temporary name of the same suffix, then put it in place. Raises OSError."""
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        write(temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def io_failure(error: OSError, path: Path, kept: str = "nothing was kept of this run") -> RunError:
    """What to tell the user of a failed write, and of what was ``kept`` of it.

    ``path`` is what was written; where the error names a file, that file in ``path``'s folder is told.
    """
    named = Path(error.filename).name if isinstance(error.filename, str) else ""
    if named and not named.startswith(".") and named != path.name:
        path = path / named
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return RunError(f"{path}: no space left on the device; {kept}")
    if error.errno == errno.EFBIG:
        return RunError(f"{path}: the file would exceed the size limit; {kept}")
    return RunError(f"{path}: cannot be written ({error.strerror or error}); {kept}")


def _size(path: Path) -> int:
    """The size of a file; -1 when there is none."""
    try:
        return path.stat().st_size
    except OSError:
        return -1


def _superseded(part: Part, manifest: Mapping[str, Any]) -> bool:
    """Whether the run with this ``manifest`` has got at least as far as what a killed process left in ``part``."""
    left = read_checkpoint(part.folder)
    if left is None:
        stored = stored_run(part.folder)
        return stored is not None and stored.replaceable(manifest)
    reached = manifest.get("outcome") != "interrupted" or left.done <= manifest.get("step", 0)
    return left.belongs_to(manifest["digest"], manifest["code"]) and reached


def require_writable(out: Path) -> None:
    """Make the folder ``out`` if need be. Raises UsageError when it cannot be written to."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / f".probe-{os.getpid()}-{secrets.token_hex(4)}"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise UsageError(
            f"output folder {out}: cannot be written to ({error.strerror}); choose another with --out"
        ) from None


class RunWriter:
    """A run folder in the making: fill ``folder``, then ``commit``.

    Left without a commit it vanishes, unless it holds a checkpoint to go on from. What stands at the target by then is
    replaced when it is the same experiment by the same code and nothing is lost by it, and otherwise set aside under
    ``<name>.<its digest>``, whoever put it there meanwhile.

    ``source`` is a folder to go on from: one that a killed process left, which is taken over, or an interrupted run,
    which is copied and stays what it is until the commit. ``checkpoint`` is then where to go on from, or ``complete``
    the run that lacked nothing but its place.
    ``about`` is what others are told of this run: its ``digest`` and ``code``.
    Raises UsageError when the output folder cannot be written to or another process works in ``source``.
    """

    def __init__(
        self, out: Path, name: str, about: dict[str, Any] | None = None, source: StoredRun | Part | None = None
    ) -> None:
        self.out, self.name, self.target = out, name, out / name
        self.set_aside: Path | None = None
        self.folder = new_part(out, name)
        self.checkpoint: Checkpoint | None = None
        self.complete: StoredRun | None = None
        self._about, self._source = about or {}, source
        self._lock: Lock | None = None

    def __enter__(self) -> RunWriter:
        require_writable(self.out)
        try:
            parts_of(self.out, self.name)
            if isinstance(self._source, Part):
                self._take_over(self._source)
            else:
                self.folder.mkdir()
                self._lock = lock_new(self.folder, self._about)
                if self._source is not None:
                    self._copy(self._source)
        except OSError as error:
            shutil.rmtree(self.folder, ignore_errors=True)
            raise io_failure(error, self.out) from None
        if self._source is not None:
            self.checkpoint = read_checkpoint(self.folder)
        return self

    def _take_over(self, part: Part) -> None:
        self._lock = take_lock(part.folder, self._about)
        if self._lock is None:
            raise UsageError(f"{self.target}: another process has just begun to continue this run")
        os.rename(part.folder, self.folder)
        for unnamed in self.folder.glob(".*"):  # what was being written when the process ended
            unnamed.unlink()
        self.complete = stored_run(self.folder)
        if self.complete is not None and self.complete.interrupted:
            (self.folder / MANIFEST).unlink()
            self.complete = None

    def _copy(self, run: StoredRun) -> None:
        for path in (run.series, run.folder / CHECKPOINT):  # the checkpoint last: it vouches for the series
            shutil.copyfile(path, self.folder / path.name)
            sync(self.folder / path.name)

    def __exit__(self, *exception: object) -> None:
        if not (self.folder / CHECKPOINT).exists() and not (self.folder / MANIFEST).exists():
            shutil.rmtree(self.folder, ignore_errors=True)
        if self._lock is not None:
            self._lock.release()

    def write(self, name: str, text: str) -> None:
        """Write one text file of the folder. Raises OSError that names it."""
        path = self.folder / name
        try:
            path.write_text(text, encoding="utf-8")
        except OSError as error:
            error.filename = error.filename or str(path)
            raise

    def commit(self, manifest: dict[str, Any]) -> StoredRun:
        """Write the manifest, flush everything to the disk and put the folder in its place. Raises OSError.

        Until the manifest is there the checkpoint is; a checkpoint is kept where there is something to go on from.
        """
        release_reserve(self.folder)
        aside = {LOCK, MANIFEST} if manifest.get("outcome") == "interrupted" else {LOCK, MANIFEST, CHECKPOINT}
        files = sorted(entry.name for entry in self.folder.iterdir() if entry.name not in aside)
        complete = {
            "manifest_version": MANIFEST_VERSION,
            **manifest,
            "files": {name: _size(self.folder / name) for name in files},
        }
        for name in files:
            sync(self.folder / name)
        write_whole(
            self.folder / MANIFEST,
            lambda path: path.write_text(json.dumps(complete, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"),
        )
        sync(self.folder / MANIFEST)
        sync(self.folder)
        return self.put_in_place(complete)

    def put_in_place(self, manifest: dict[str, Any]) -> StoredRun:
        """Put the folder, which holds this ``manifest``, in its place. Raises OSError."""
        for name in {LOCK, CHECKPOINT} - set(manifest["files"]):
            (self.folder / name).unlink(missing_ok=True)
        self._rename(manifest)
        sync(self.out)
        for part in parts_of(self.out, self.name):
            if not part.alive and _superseded(part, manifest):
                shutil.rmtree(part.folder, ignore_errors=True)
        return StoredRun(self.target, manifest)

    def _rename(self, manifest: dict[str, Any]) -> None:
        """Rename into place; first move aside, whole, what stands there. Every rename is atomic, so nothing is lost."""
        superseded: list[Path] = []
        while True:
            try:
                os.rename(self.folder, self.target)
                break
            except OSError as error:
                if error.errno not in (errno.EEXIST, errno.ENOTEMPTY):
                    raise
            aside = self._free_name()
            try:
                os.rename(self.target, aside)
            except FileNotFoundError:
                continue  # another process moved it first
            earlier = stored_run(aside)
            if earlier is not None and earlier.replaceable(manifest):
                superseded.append(aside)
            else:
                self.set_aside = aside
        for old in superseded:
            shutil.rmtree(old, ignore_errors=True)

    def _free_name(self) -> Path:
        earlier = stored_run(self.target)
        digest = str(earlier.manifest["digest"])[:8] if earlier else "unfinished"
        aside, count = self.target.with_name(f"{self.target.name}.{digest}"), 1
        while aside.exists():
            count += 1
            aside = self.target.with_name(f"{self.target.name}.{digest}.{count}")
        return aside
