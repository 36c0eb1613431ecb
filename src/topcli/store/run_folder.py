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
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from topcli.errors import RunError, UsageError

MANIFEST = "manifest.json"
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
            and self.manifest.get("outcome") != "interrupted"
            and all(_size(self.folder / name) == size for name, size in self.manifest.get("files", {"": 0}).items())
        )

    def replaceable(self, digest: str, code: str) -> bool:
        """Whether a new run by the same code of the same experiment may take this one's place and nothing be lost."""
        own = {MANIFEST, *self.manifest.get("files", {})}
        return (
            self.same_experiment(digest)
            and self.manifest.get("code") == code
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
    """What to tell the user of a failed write, and of what was ``kept`` of it."""
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


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


class RunWriter:
    """A run folder in the making: fill ``folder``, then ``commit``; left without a commit it vanishes.

    What stands at the target by then is replaced when it is the same experiment by the same code, and otherwise set
    aside under ``<name>.<its digest>``, whoever put it there meanwhile.
    Raises UsageError when the output folder cannot be written to.
    """

    def __init__(self, out: Path, name: str) -> None:
        self.out, self.target = out, out / name
        self.set_aside: Path | None = None
        self._prefix = f".{name}.part-"
        self.folder = out / f"{self._prefix}{os.getpid()}-{secrets.token_hex(4)}"

    def __enter__(self) -> RunWriter:
        require_writable(self.out)
        try:
            for left in self.out.glob(f"{self._prefix}*"):
                pid = left.name[len(self._prefix) :].partition("-")[0]
                if pid.isdigit() and not _alive(int(pid)):
                    shutil.rmtree(left, ignore_errors=True)
            self.folder.mkdir()
        except OSError as error:
            raise io_failure(error, self.out) from None
        return self

    def __exit__(self, *exception: object) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)

    def write(self, name: str, text: str) -> None:
        """Write one text file of the folder. Raises OSError."""
        (self.folder / name).write_text(text, encoding="utf-8")

    def commit(self, manifest: dict[str, Any]) -> StoredRun:
        """Write the manifest, flush everything to the disk and put the folder in its place. Raises OSError."""
        files = sorted(entry.name for entry in self.folder.iterdir())
        complete = {
            "manifest_version": MANIFEST_VERSION,
            **manifest,
            "files": {name: _size(self.folder / name) for name in files},
        }
        for name in files:
            _sync(self.folder / name)
        self.write(MANIFEST, json.dumps(complete, indent=1, ensure_ascii=False) + "\n")
        _sync(self.folder / MANIFEST)
        _sync(self.folder)
        self._put_in_place(complete["digest"], complete["code"])
        _sync(self.out)
        return StoredRun(self.target, complete)

    def _put_in_place(self, digest: str, code: str) -> None:
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
            if earlier is not None and earlier.replaceable(digest, code):
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
