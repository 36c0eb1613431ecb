"""Part folders ``.<name>.part-<pid>-<random>``: runs in progress, and remains of killed processes.

A process holds an exclusive lock on the file ``lock`` in its part folder. The system releases the lock when the process
ends for any reason, so a lock that can be taken has no owner. On file systems without locks the process number is used.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import secrets
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from topcli.store.checkpoint import CHECKPOINT, TEMPORARY
from topcli.store.manifest import MANIFEST, DamagedError, read_json

try:
    import fcntl
except ImportError:  # not a POSIX system
    fcntl = None

LOCK = "lock"
RESERVE = "reserve"
RESERVED = 1 << 18
"""Bytes that suffice for the reports, a footer and a checkpoint."""
_OWNER = re.compile(r"(\d+)-[0-9a-f]{8}")
_RESULTS = re.compile(r"(series|trajectories|points)\.(parquet|csv)|report\.(json|md)|config\.yaml")
_OURS = frozenset([MANIFEST, CHECKPOINT, LOCK, RESERVE])
_TEMPORARY = re.compile(rf"\.manifest\.\d+\.json|{re.escape(TEMPORARY)}|\.{LOCK}")
"""Names of files that a killed process may leave half-written."""


def is_result(name: str) -> bool:
    """True for the names of a run's results."""
    return _RESULTS.fullmatch(name) is not None


def is_temporary(name: str) -> bool:
    """True for the names of files that a killed process may leave half-written."""
    return _TEMPORARY.fullmatch(name) is not None


def remove_own(folder: Path) -> None:
    """Remove the files of a run, and the folder if nothing else is in it; other files are never removed."""
    with contextlib.suppress(OSError):
        for name in os.listdir(folder):
            if name in _OURS or is_result(name) or is_temporary(name):
                with contextlib.suppress(OSError):
                    os.unlink(folder / name)
        os.rmdir(folder)


def linked_file(folder: Path) -> Path | None:
    """Path in ``folder`` with the name of a run's file that is not a regular file, such as a link; None if none is."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if (entry.name in _OURS or is_result(entry.name)) and not entry.is_file(follow_symlinks=False):
                return folder / entry.name
    return None


def _prefix(name: str) -> str:
    return f".{name}.part-"


def is_part(folder: Path) -> bool:
    """True if ``folder`` exists and has the name of a part folder."""
    before, _, after = folder.absolute().name.rpartition(".part-")
    return before.startswith(".") and _OWNER.fullmatch(after) is not None and folder.is_dir()


def new_part(out: Path, name: str) -> Path:
    """Unused path for a part folder of this process."""
    return out / f"{_prefix(name)}{os.getpid()}-{secrets.token_hex(4)}"


def _parts(out: Path, name: str) -> list[Path]:
    prefix = _prefix(name)
    try:
        with os.scandir(out) as entries:
            found = [
                entry.name
                for entry in entries
                if entry.name.startswith(prefix)
                and _OWNER.fullmatch(entry.name[len(prefix) :])
                and entry.is_dir(follow_symlinks=False)
            ]
    except OSError:
        return []
    return [out / name for name in sorted(found)]


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


class Lock:
    """Lock that this process holds on a folder, until ``release`` or its end."""

    def __init__(self, handle: int) -> None:
        self._handle = handle

    def release(self) -> None:
        """Release the lock; repeated calls do nothing."""
        if self._handle >= 0:
            os.close(self._handle)
            self._handle = -1


def _exclusive(handle: int) -> bool | None:
    """Take the lock of the open file. True if it was free; None if the file system has no locks."""
    if fcntl is None:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _sign(handle: int, about: dict[str, Any]) -> None:
    os.ftruncate(handle, 0)
    os.pwrite(handle, json.dumps({"pid": os.getpid(), **about}).encode(), 0)


def lock_new(folder: Path, about: dict[str, Any]) -> Lock:
    """Lock a folder that this process has just created, with ``about`` in the lock file. Raises OSError."""
    unnamed = folder / f".{LOCK}"
    handle = os.open(unnamed, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
    _exclusive(handle)
    _sign(handle, about)
    os.replace(unnamed, folder / LOCK)  # visible to others only after it is locked
    return Lock(handle)


def owner(folder: Path) -> dict[str, Any]:
    """Content of the lock file of ``folder``: ``pid``, ``digest``, ``code``; empty if it is missing or damaged."""
    try:
        found = read_json(folder / LOCK)
    except (OSError, DamagedError):
        return {}
    pid = found.get("pid")
    return found if isinstance(pid, int) and 0 < pid < 1 << 31 else {}


def lock_left(folder: Path, about: dict[str, Any] | None = None) -> Lock | None:
    """Lock a folder that another process may have left; None if a process still works there or locked it first.

    With ``about`` this process becomes the owner in the lock file.
    """
    named = _OWNER.search(folder.name)
    made_here = not (folder / LOCK).exists()
    if made_here and named and _alive(int(named[1])):
        return None  # its process is about to lock it, or to rename it into place
    pid = owner(folder).get("pid", 0)
    try:
        handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
    except OSError:
        return None
    taken = _exclusive(handle)
    if taken is None:
        taken = not (pid > 0 and _alive(pid))
    with contextlib.suppress(OSError):
        if taken and os.path.samestat(os.fstat(handle), os.stat(folder / LOCK)):
            if about is not None:
                _sign(handle, about)
            return Lock(handle)
    os.close(handle)
    return None


def lock_folder(folder: Path, about: dict[str, Any]) -> Lock | None:
    """Lock an existing folder, with ``about`` in the lock file; None if another process holds it. Raises OSError.

    The file remains, because removing it could let two processes lock two files of the same name.
    """
    pid = owner(folder).get("pid", 0)
    handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
    taken = _exclusive(handle)
    if taken is None:
        taken = pid in (0, os.getpid()) or not _alive(pid)
    if not taken:
        os.close(handle)
        return None
    _sign(handle, about)
    return Lock(handle)


def take_lock(folder: Path, about: dict[str, Any] | None = None) -> Lock | None:
    """``lock_left``, tried twice if the owner is dead but the lock is taken, as by another process that inspects it."""
    lock = lock_left(folder, about)
    if lock is None and (folder / LOCK).exists() and not _alive(owner(folder).get("pid") or os.getpid()):
        time.sleep(0.05)
        lock = lock_left(folder, about)
    return lock


def reserve(folder: Path) -> None:
    """Reserve space, once, so that results can be completed when the disk is full. Raises OSError."""
    path = folder / RESERVE
    if not path.exists():
        path.write_bytes(bytes(RESERVED))


def release_reserve(folder: Path) -> None:
    """Free the reserved space."""
    (folder / RESERVE).unlink(missing_ok=True)


@dataclass(frozen=True)
class Part:
    """A part folder, the content of its lock file, and True for ``alive`` if that process still works there."""

    folder: Path
    owner: dict[str, Any]
    alive: bool

    @property
    def name(self) -> str:
        """Name of the run."""
        return self.folder.name.removeprefix(".").rpartition(".part-")[0]

    @property
    def worth_keeping(self) -> bool:
        """True if there is a checkpoint to continue from, or a manifest, which is written last."""
        return (self.folder / CHECKPOINT).exists() or (self.folder / MANIFEST).exists()


def is_working(folder: Path) -> bool:
    """True if a process works in a part folder; changes nothing there."""
    named = _OWNER.search(folder.name)
    pid = owner(folder).get("pid") or (int(named[1]) if named else 0)
    try:
        handle = os.open(folder / LOCK, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return pid > 0 and _alive(pid)
    try:
        free = _exclusive(handle)
    finally:
        os.close(handle)
    return not free if free is not None else pid > 0 and _alive(pid)


def all_parts(out: Path) -> list[Part]:
    """Part folders in ``out``, by name; none is removed."""
    try:
        with os.scandir(out) as entries:
            folders = [out / entry.name for entry in entries if not entry.is_symlink() and is_part(out / entry.name)]
    except OSError:
        return []
    found = [Part(folder, owner(folder), is_working(folder)) for folder in folders]
    return sorted(found, key=lambda part: (part.name, part.folder.name))


def parts_of(out: Path, name: str) -> list[Part]:
    """Part folders of the run ``name``; those of dead processes from which nothing can be continued are removed."""
    found = []
    for folder in _parts(out, name):
        said = owner(folder)
        lock = take_lock(folder)
        part = Part(folder, said, lock is None)
        if lock is not None and not part.worth_keeping:
            remove_own(folder)
        elif folder.exists():
            found.append(part)
        if lock is not None:
            lock.release()
    return found
