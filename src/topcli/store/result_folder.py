"""The right to compute a result: ``results/NAME`` holds one result, complete or on its way.

1. ``manifest.json`` is there from the first moment and says what the folder holds: experiment, code and outcome.
2. Who computes holds a lock, the file ``.NAME.lock`` beside the folder; who wants the same waits and finds the result.
3. To run an experiment again is to continue it from its last checkpoint; a complete result is up to date.
4. No result is deleted, complete or not. One that has to make way, for ``force`` or because the code differs, is
   renamed to NAME-KEY, by the key of what it holds. A different experiment makes way only for ``force``.

A folder is what its manifest says, whatever happens: files are complete on the disk before the manifest that lists
them, and parts of tables before the checkpoint that counts them.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import itertools
import os
import secrets
import shutil
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Protocol

from numpy.typing import NDArray

from topcli.errors import RunError, UsageError
from topcli.store.files import (
    DamagedError,
    io_failure,
    read_arrays,
    require_writable,
    sha256_of,
    sync,
    write_arrays,
    write_text,
)
from topcli.store.provenance import environment, now
from topcli.store.results import MANIFEST, MANIFEST_VERSION, SWEEP, UNFINISHED, StoredResult, manifest_text, read_result

POLL_SECONDS = 0.1
"""Seconds between two looks at a lock that another process holds."""
_UNCOMPARED = ("name", "output.format")


class _Identity(Protocol):
    """Resolved ``config``, ``digest`` of what it computes and of the ``code``, and a short ``key`` of both digests."""

    @property
    def config(self) -> dict[str, Any]: ...
    @property
    def digest(self) -> str: ...
    @property
    def code(self) -> str: ...
    @property
    def key(self) -> str: ...


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
    def claim(
        cls,
        path: Path,
        identity: _Identity,
        *,
        force: bool = False,
        stop: Callable[[], bool] = lambda: False,
        tell: Callable[[str], None] = lambda line: None,
    ) -> ResultFolder:
        """Folder of the result with this identity at ``path``: complete, or ready to compute or to continue it.

        While another process computes there, wait until ``stop()``. Raises UsageError if something else is at
        ``path`` that may not be renamed, and RunError if the place is damaged or cannot be written.
        """
        before = _result_at(path)
        if before and before.complete and not force and _same(before, identity) and not _rests(path):
            return cls(before)
        require_writable(path.parent)
        lock, waited = _wait_for_lock(path, identity, force, stop, tell)
        try:
            for torn in path.glob(".manifest.*"):  # of a process that was killed while it wrote a manifest
                torn.unlink()
            stored, aside = _result_at(path), None
            if waited and stored and not (before and before.complete and _run(before) == _run(stored)):
                force = False  # another process has just computed, or begun, what was to be computed
            if stored is None:
                _require_free(path)
            elif _valuable(stored):
                _require_same(stored, identity, force)
                if force or not _same(stored, identity):
                    stored, aside = None, set_aside(stored)
                elif stored.complete:
                    _remove_rests(path)  # its process was killed before it could do so
                    release(path, lock)
                    return cls(stored)
            if stored is None or not _valuable(stored):
                stored = _begun(path, identity)
            (path / UNFINISHED).mkdir(exist_ok=True)
        except BaseException as error:
            release(path, lock)
            if isinstance(error, OSError):
                raise io_failure(error, path, "nothing was lost") from None
            raise
        return cls(stored, lock, aside)

    @staticmethod
    def outlook(path: Path, identity: _Identity, force: bool = False) -> str:
        """Words for the action that ``claim`` would lead to. Raises UsageError and RunError as ``claim``."""
        stored = _result_at(path)
        if being_computed(path):
            return "another process is computing it"
        if stored is None:
            _require_free(path)
            return "will run"
        if not _valuable(stored):
            return "will run"
        _require_same(stored, identity, force)
        if force or not _same(stored, identity):
            return "will run; the earlier result is renamed, not overwritten"
        return "up to date" if stored.complete else "will continue from its last checkpoint"

    def __enter__(self) -> ResultFolder:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Release the lock; a folder in which nothing was stored is removed. Raises RunError for a failed write."""
        if self._lock is None:
            return
        folder, kept = self.stored.folder, "run again to continue from the last checkpoint"
        with contextlib.suppress(OSError):
            if not _valuable(self.stored):
                kept = "nothing of this run was stored"
                _remove_rests(folder)
                (folder / MANIFEST).unlink()
                folder.rmdir()
        release(folder, self._lock)
        self._lock = None
        if isinstance(error, OSError):
            raise io_failure(error, folder, kept) from error

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
        self.stored = _with_manifest(self.stored.folder, self.stored.folder, {**self.stored.manifest, **entries})


def being_computed(path: Path) -> bool:
    """True if a process computes the result at ``path``."""
    try:
        handle = os.open(_lock_path(path), os.O_RDWR)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(handle)
    return False


def difference(there: Mapping[str, Any], here: Mapping[str, Any]) -> str:
    """First differences of two resolved configs in half a line, such as ``h: 0.001 stored, 0.002 requested``."""
    old, new = flattened(there), flattened(here)
    keys = [key for key in {**old, **new} if old.get(key) != new.get(key) and key not in _UNCOMPARED]
    shown = [f"{key}: {old.get(key, 'nothing')} stored, {new.get(key, 'nothing')} requested" for key in keys[:3]]
    return "; ".join(shown) + ("; ..." if len(keys) > 3 else "")


def flattened(data: Any, path: str = "") -> dict[str, Any]:
    """Values of a config by their dotted keys."""
    if not isinstance(data, dict):
        return {path: data}
    return {k: v for key, value in data.items() for k, v in flattened(value, f"{path}.{key}" if path else key).items()}


def _same(stored: StoredResult, identity: _Identity) -> bool:
    """True if a result has this identity, in the same format."""
    old, new = (config.get("output", {}).get("format") for config in (stored.manifest["config"], identity.config))
    digests = stored.manifest.get("digest"), stored.manifest.get("code")
    return digests == (identity.digest, identity.code) and old == new


def _run(stored: StoredResult) -> str:
    """Random word that tells a result from another of the same identity."""
    return stored.manifest["run"]


def _rests(path: Path) -> bool:
    return (path / UNFINISHED).exists()


def _valuable(stored: StoredResult) -> bool:
    """True if a folder holds more than an empty beginning: a result, a checkpoint, or any other file."""
    others = set(os.listdir(stored.folder)) - {MANIFEST, UNFINISHED}
    return stored.outcome is not None or stored.checkpoint.exists() or bool(others)


def _result_at(path: Path) -> StoredResult | None:
    """Result at ``path``, if there is one. Raises UsageError for a sweep, and RunError for a damaged manifest."""
    stored = read_result(path)
    if stored and stored.manifest.get("kind") == SWEEP:
        raise UsageError(f"{path}: holds a sweep; choose another name with --set name=NAME")
    return stored


def _require_free(path: Path) -> None:
    """Raise UsageError if anything is at ``path`` but an empty folder."""
    if os.path.lexists(path) and (path.is_symlink() or not path.is_dir() or any(path.iterdir())):
        raise UsageError(f"{path}: exists and is no result of topcli; choose another name with --set name=NAME")


def _require_same(stored: StoredResult, identity: _Identity, force: bool) -> None:
    """Raise UsageError if a folder holds a different experiment, unless it may be renamed.

    An equal config with another digest is the same experiment with other code of the user.
    """
    if stored.manifest.get("digest") == identity.digest or force:
        return
    if other := difference(stored.manifest["config"], identity.config):
        raise UsageError(
            f"{stored.folder}: holds a different experiment ({other})",
            "choose another name with --set name=NAME, or rename the earlier result with --force",
        )


def _begun(path: Path, identity: _Identity) -> StoredResult:
    """New result at ``path``, which is free or holds an empty beginning."""
    manifest = {"manifest_version": MANIFEST_VERSION, "name": path.name, "run": secrets.token_hex(8)}
    manifest |= {"digest": identity.digest, "code": identity.code, "key": identity.key, "config": identity.config}
    manifest |= {"outcome": None, "files": {}, "started": now(), "environment": environment()}
    if (path / MANIFEST).exists():
        _remove_rests(path)
        stored = _with_manifest(path, path, manifest)
    else:  # under another name at first, so that no folder is ever without a manifest
        new = path.with_name(f".{path.name}.new")
        shutil.rmtree(new, ignore_errors=True)
        new.mkdir()
        stored = _with_manifest(new, path, manifest)
        new.rename(path)
        sync(path.parent)
    return stored


def _with_manifest(folder: Path, path: Path, manifest: dict[str, Any]) -> StoredResult:
    """Write a manifest into ``folder``; the result that it describes, at ``path``."""
    write_text(folder / MANIFEST, manifest_text(manifest))
    return StoredResult(path, manifest)


def _remove_rests(path: Path) -> None:
    """Remove what is needed only to continue."""
    if _rests(path):
        for one in (path / UNFINISHED).iterdir():
            one.unlink()
        (path / UNFINISHED).rmdir()


def set_aside(stored: StoredResult) -> Path:
    """New path of a folder, which is renamed by the key of what it holds."""
    path = stored.folder
    for number in itertools.count(1):
        aside = path.with_name(f"{path.name}-{stored.manifest['key']}" + (f"-{number}" if number > 1 else ""))
        if os.path.lexists(aside):
            continue
        try:
            path.rename(aside)
        except OSError as error:
            if error.errno not in (errno.EEXIST, errno.ENOTEMPTY, errno.ENOTDIR):  # taken meanwhile
                raise
        else:
            return aside
    raise AssertionError("unreachable: the names do not end")


def _lock_path(path: Path) -> Path:
    return path.with_name(f".{path.name}.lock")


def _wait_for_lock(
    path: Path, identity: _Identity, force: bool, stop: Callable[[], bool], tell: Callable[[str], None]
) -> tuple[int, bool]:
    """Lock for ``path``, and True if another process held it before. Raises RunError if it is told to stop."""
    for attempt in itertools.count():
        if (lock := locked(path)) is not None:
            return lock, attempt > 0
        if stored := _result_at(path):
            _require_same(stored, identity, force)
        if attempt == 1:  # the first time it may have been a process that only looked
            tell(f"{path}: another process is computing this result; waiting for it")
        if stop():
            raise RunError(f"{path}: another process is computing this result")
        time.sleep(POLL_SECONDS)
    raise AssertionError("unreachable: it waits without end")


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
