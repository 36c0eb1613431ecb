"""The right to compute a result: ``results/NAME`` holds one result, complete or on its way.

1. ``manifest.json`` is there from the first moment and says what the folder holds: experiment, code and outcome.
2. Who computes holds a lock, the file ``.NAME.lock`` beside the folder; others are refused meanwhile.
3. To run an experiment again is to continue it from its last checkpoint; a complete result is up to date.
4. No result is deleted, complete or not. One that has to make way, for ``force`` or because the code differs, is
   renamed to NAME-KEY, by the key of what it holds. A different experiment makes way only for ``force``.

A folder is what its manifest says, whatever happens: files are complete on the disk before the manifest that lists
them, and parts of tables before the checkpoint that counts them.
"""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import os
import time
from collections.abc import Iterable, Mapping
from enum import StrEnum
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from topcli.errors import RunError, UsageError
from topcli.store.files import (
    DamagedError,
    io_failure,
    json_text,
    read_arrays,
    require_writable,
    sealed,
    sha256_of,
    sync,
    write_arrays,
    write_text,
)
from topcli.store.identity import Identity
from topcli.store.provenance import environment, now
from topcli.store.results import MANIFEST, MANIFEST_VERSION, SWEEP, UNFINISHED, StoredResult, read_result

LOOK_SECONDS = 0.1
"""Seconds after which a process that only looked at a lock does not hold it any more."""
_UNCOMPARED = ("name", "output.format")


class Action(StrEnum):
    """Action of a run at the place of its result, in words for a dry run."""

    COMPUTE = "will run"
    RENAME = "will run; the earlier result is renamed, not overwritten"
    CONTINUE = "will continue from its last checkpoint"
    UP_TO_DATE = "up to date"


class ResultFolder:
    """A result and the right to write it, from ``claim`` to the end of a ``with`` block.

    Attributes
    ----------
    stored : StoredResult
        Folder of the result and its manifest, which says what the folder holds.
    complete : bool
        True if there is nothing to compute.
    working : Path
        Folder for unfinished tables.
    set_aside : Path or None
        Path to which an earlier result was renamed.
    """

    def __init__(self, stored: StoredResult, lock: int | None = None, set_aside: Path | None = None) -> None:
        self.stored, self.complete, self.set_aside = stored, lock is None, set_aside
        self.working, self._lock = stored.folder / UNFINISHED, lock

    @classmethod
    def claim(cls, path: Path, identity: Identity, *, force: bool = False) -> ResultFolder:
        """Folder of the result with this identity at ``path``: complete, or ready to compute or to continue it.

        Raises UsageError if something else is at ``path`` that may not be renamed, and RunError if another process
        computes there, or if the place is damaged or cannot be written.
        """
        stored, action = _outlook(path, identity, force)
        if action is Action.UP_TO_DATE and not (path / UNFINISHED).exists():
            return cls(stored)
        require_writable(path.parent)
        lock = locked(path)
        if lock is None:
            time.sleep(LOOK_SECONDS)
            lock = locked(path)
        if lock is None:
            raise RunError(f"{path}: another process is computing this result; run again after its end")
        try:
            for torn in path.glob(".manifest.*"):  # of a process that was killed while it wrote a manifest
                torn.unlink()
            stored, action = _outlook(path, identity, force)
            if action is Action.UP_TO_DATE:
                _remove_rests(path)  # its process was killed before it could do so
                release(path, lock)
                return cls(stored)
            aside = set_aside(stored) if action is Action.RENAME else None
            if action is not Action.CONTINUE:
                stored = _begun(path, identity)
            (path / UNFINISHED).mkdir(exist_ok=True)
        except BaseException as error:
            with contextlib.suppress(OSError):
                path.rmdir()  # if it is empty
            release(path, lock)
            if isinstance(error, OSError):
                raise io_failure(error, path, "nothing was lost") from None
            raise
        return cls(stored, lock, aside)

    @staticmethod
    def outlook(path: Path, identity: Identity, force: bool = False) -> str:
        """Words for the action that ``claim`` would lead to. Raises UsageError and RunError as ``claim``."""
        if being_computed(path):
            return "another process is computing it"
        return _outlook(path, identity, force)[1]

    def __enter__(self) -> ResultFolder:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Release the lock; a folder in which nothing was stored is removed. Raises RunError for a failed write."""
        if self._lock is None:
            return
        folder, consequence = self.stored.folder, "run again to continue from the last checkpoint"
        with contextlib.suppress(OSError):
            if not _valuable(self.stored):
                consequence = "nothing of this run was stored"
                _remove_rests(folder)
                (folder / MANIFEST).unlink()
                folder.rmdir()
        release(folder, self._lock)
        self._lock = None
        if isinstance(error, OSError):
            raise io_failure(error, folder, consequence) from error

    def checkpoint(self) -> dict[str, NDArray[Any]]:
        """Arrays of the last ``save``; empty if there is none. Raises RunError if they are damaged."""
        path = self.stored.checkpoint
        try:
            return read_arrays(path)
        except FileNotFoundError:
            return {}
        except (OSError, DamagedError) as error:
            raise RunError(f"{path}: damaged ({error}); run again with --force to start from step 0") from None

    def save(self, state: Mapping[str, NDArray[Any] | float]) -> None:
        """Replace the checkpoint by these arrays and numbers. Raises OSError.

        What they refer to, such as parts of tables, must be on the disk.
        """
        write_arrays(self.stored.checkpoint, state)

    def finish(self, entries: Mapping[str, Any], texts: Mapping[str, str], tables: Iterable[Path] = ()) -> None:
        """Store the result: ``tables``, which are moved out of ``working``, ``texts`` by file name, and the manifest.

        ``entries`` of the manifest are the ``outcome`` and whatever else describes the result. What is needed to
        continue is removed unless the outcome is ``interrupted``. Raises OSError.
        """
        folder, files = self.stored.folder, {}
        if self.stored.outcome is not None:  # the files of an interrupted run are about to be replaced
            self._write_manifest({"outcome": None, "files": {}})
        for table in tables:
            sync(table)
            os.replace(table, folder / table.name)
            files[table.name] = folder / table.name
        for name, text in texts.items():
            files[name] = folder / name
            files[name].write_text(text, encoding="utf-8")
            sync(files[name])
        listed = {
            name: {"size": files[name].stat().st_size, "sha256": sha256_of(files[name])} for name in sorted(files)
        }
        self._write_manifest({**entries, "ended": now(), "files": listed})
        if self.stored.complete:
            _remove_rests(folder)

    def _write_manifest(self, entries: Mapping[str, Any]) -> None:
        self.stored = _with_manifest(self.stored.folder, {**self.stored.manifest, **entries})


def being_computed(path: Path) -> bool:
    """True if a process computes the result at ``path``."""
    if not _lock_path(path).exists():
        return False
    lock = locked(path)
    if lock is not None:
        release(path, lock)
    return lock is None


def difference(there: Mapping[str, Any], here: Mapping[str, Any]) -> str:
    """First differences of two resolved configs in half a line, such as ``h: 0.001 stored, 0.002 requested``."""
    old, new = flattened(there), flattened(here)
    keys = [key for key in {**old, **new} if old.get(key) != new.get(key) and key not in _UNCOMPARED]
    texts = [f"{key}: {old.get(key, 'nothing')} stored, {new.get(key, 'nothing')} requested" for key in keys[:3]]
    return "; ".join(texts) + ("; ..." if len(keys) > 3 else "")


def flattened(data: Any, path: str = "") -> dict[str, Any]:
    """Values of a config by their dotted keys."""
    if not isinstance(data, dict):
        return {path: data}
    return {k: v for key, value in data.items() for k, v in flattened(value, f"{path}.{key}" if path else key).items()}


def _outlook(path: Path, identity: Identity, force: bool) -> tuple[Any, Action]:
    """Result at ``path``, None if there is none, and the action that follows.

    Raises UsageError if something else is there that may not be renamed, and RunError for a damaged manifest.
    """
    stored = read_result(path)
    if stored is None:
        foreign = os.path.islink(path) or os.path.isfile(path) or _files(path)
        if foreign and read_result(path) is None:  # another process may have begun meanwhile
            raise UsageError(f"{path}: exists and is no result of topcli; choose another name with --set name=NAME")
        return None, Action.COMPUTE
    if stored.manifest.get("kind") == SWEEP:
        raise UsageError(f"{path}: holds a sweep; choose another name with --set name=NAME")
    if not _valuable(stored):
        return stored, Action.COMPUTE

    # an equal config with another digest is the same experiment with other code of the user
    digest, code, config = (stored.manifest[key] for key in ("digest", "code", "config"))
    if digest != identity.digest and not force and (other := difference(config, identity.config)):
        raise UsageError(
            f"{path}: holds a different experiment ({other})",
            "choose another name with --set name=NAME, or rename the earlier result with --force",
        )
    form, new_form = (each.get("output", {}).get("format") for each in (config, identity.config))
    if force or (digest, code, form) != (identity.digest, identity.code, new_form):
        return stored, Action.RENAME
    return stored, Action.UP_TO_DATE if stored.complete else Action.CONTINUE


def _files(folder: Path) -> list[str]:
    """Names in a folder, but for hidden ones, such as that of a manifest that is being written."""
    return [path.name for path in folder.glob("[!.]*")] if os.path.isdir(folder) else []


def _valuable(stored: StoredResult) -> bool:
    """True if a folder holds more than an empty beginning: a result, a checkpoint, or any other file."""
    others = {*_files(stored.folder)} - {MANIFEST, UNFINISHED}
    return stored.outcome is not None or stored.checkpoint.exists() or bool(others)


def _begun(path: Path, identity: Identity) -> StoredResult:
    """New result at ``path``, which is free or holds an empty beginning."""
    path.mkdir(exist_ok=True)
    _remove_rests(path)
    manifest = {"manifest_version": MANIFEST_VERSION, "name": path.name, "digest": identity.digest}
    manifest |= {"code": identity.code, "key": identity.key, "config": identity.config}
    manifest |= {"outcome": None, "files": {}, "started": now(), "environment": environment()}
    stored = _with_manifest(path, manifest)
    sync(path.parent)
    return stored


def _with_manifest(path: Path, manifest: dict[str, Any]) -> StoredResult:
    """Write the manifest of the result at ``path``."""
    write_text(path / MANIFEST, json_text(sealed(manifest)))
    return StoredResult(path, manifest)


def _remove_rests(path: Path) -> None:
    """Remove what is needed only to continue."""
    if (path / UNFINISHED).exists():
        for rest in (path / UNFINISHED).iterdir():
            rest.unlink()
        (path / UNFINISHED).rmdir()


def set_aside(stored: StoredResult) -> Path:
    """New path of a folder, which is renamed by the key of what it holds; the caller has its lock."""
    base = f"{stored.folder.name}-{stored.manifest['key']}"
    names = itertools.chain([base], (f"{base}-{number}" for number in itertools.count(2)))
    aside = next(path for path in map(stored.folder.with_name, names) if not os.path.lexists(path))
    return stored.folder.rename(aside)


def _lock_path(path: Path) -> Path:
    return path.with_name(f".{path.name}.lock")


def locked(path: Path) -> int | None:
    """Descriptor of the lock file for ``path``, which this process holds now; None if another one holds it.

    The system releases the lock when the process ends, for whatever reason. The file is removed after use; a lock on a
    file that is no longer in its place is therefore none.
    """
    handle = os.open(_lock_path(path), os.O_RDWR | os.O_CREAT, 0o666)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(handle), os.stat(_lock_path(path))):
            return handle
    except (BlockingIOError, FileNotFoundError):
        pass
    except OSError as error:
        os.close(handle)
        raise RunError(f"{path}: the file system has no locks ({error.strerror}); choose another --out") from None
    os.close(handle)
    return None


def release(path: Path, lock: int) -> None:
    """Remove the lock file, unless it is another one by now, and release the lock."""
    with contextlib.suppress(OSError):
        if os.path.samestat(os.fstat(lock), os.stat(_lock_path(path))):
            _lock_path(path).unlink()
    os.close(lock)
