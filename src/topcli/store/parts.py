"""Folders ``.<name>.part-<pid>-<random>`` of unfinished runs, also of killed processes.

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
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from topcli.store.checkpoint import CHECKPOINT
from topcli.store.files import DamagedError, read_json
from topcli.store.manifest import MANIFEST

try:
    import fcntl
except ImportError:  # not a POSIX system
    fcntl = None

LOCK = "lock"
_PART = re.compile(r"\.(.+)\.part-(\d+)-[0-9a-f]{8}")
_RESULTS = re.compile(r"(series|trajectories|points)\.(parquet|csv)|report\.(json|md)|config\.yaml|source\.[\w.-]+")
_OURS = frozenset([MANIFEST, CHECKPOINT, LOCK])
TEMPORARIES = re.compile(rf"\.manifest\.\d+\.json|\.checkpoint\.\d+\.npz|\.{LOCK}")
"""Names of files that a killed process may leave half-written."""


def is_result(name: str) -> bool:
    """True for the names of a run's results."""
    return _RESULTS.fullmatch(name) is not None


def remove_own(folder: Path) -> None:
    """Remove the files of a run, and the folder if nothing else is in it; other files are never removed."""
    with contextlib.suppress(OSError):
        for name in os.listdir(folder):
            if name in _OURS or is_result(name) or TEMPORARIES.fullmatch(name):
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


def _sign(handle: int, about: Mapping[str, Any]) -> None:
    os.ftruncate(handle, 0)
    os.pwrite(handle, json.dumps({"pid": os.getpid(), **about}).encode(), 0)


def lock_new(folder: Path, about: Mapping[str, Any]) -> Lock:
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
        content = read_json(folder / LOCK)
    except (OSError, DamagedError):
        return {}
    pid = content.get("pid")
    return content if isinstance(pid, int) and 0 < pid < 1 << 31 else {}


def take_lock(folder: Path, about: Mapping[str, Any] | None = None, create: bool = True) -> Lock | None:
    """Lock an existing folder; None if another process works there or locked it first. Raises OSError.

    With ``about`` this process becomes the owner in the lock file; unless ``create``, nothing changes in the folder.
    The file remains after a release, because removing it could let two processes lock two files of the same name. The
    lock is tried twice if its owner is dead, because another process may just be looking.
    """
    lock = _lock(folder, about, create)
    if lock is None and not _alive(owner(folder).get("pid") or os.getpid()):
        time.sleep(0.05)
        lock = _lock(folder, about, create)
    return lock


def _lock(folder: Path, about: Mapping[str, Any] | None, create: bool) -> Lock | None:
    path, part = folder / LOCK, _PART.fullmatch(folder.name)
    if part and not path.exists():
        if _alive(int(part[2])):
            return None  # its process is about to lock it, or to rename it into place
        if not create:
            return Lock(-1)
    pid = owner(folder).get("pid", 0)
    mode = os.O_RDWR | os.O_CREAT if create else os.O_RDONLY
    handle = os.open(path, mode | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
    free = _exclusive(handle)
    if free is None:  # a part is new for each run of a process, another folder is not
        free = not pid or not _alive(pid) or (pid == os.getpid() and not part)
    try:
        if free and os.path.samestat(os.fstat(handle), os.stat(path)):
            if about is not None:
                _sign(handle, about)
            return Lock(handle)
    except FileNotFoundError:  # its owner has just removed the folder
        pass
    except OSError:
        os.close(handle)
        raise
    os.close(handle)
    return None


@dataclass(frozen=True)
class Part:
    """Part folder with the content of its lock file; ``alive`` is True if the process of the file still runs."""

    folder: Path
    owner: dict[str, Any]
    alive: bool

    @classmethod
    def at(cls, folder: Path) -> Part:
        """The part in ``folder``, where nothing changes."""
        signed, part = owner(folder), _PART.fullmatch(folder.name)
        try:
            lock = take_lock(folder, create=False)
        except OSError:
            pid = signed.get("pid") or (int(part[2]) if part else 0)
            return cls(folder, signed, pid > 0 and _alive(pid))
        if lock is not None:
            lock.release()
        return cls(folder, signed, lock is None)

    @property
    def name(self) -> str:
        """Name of the run."""
        part = _PART.fullmatch(self.folder.name)
        return part[1] if part else ""


def new_part(out: Path, name: str) -> Path:
    """Unused path for a part folder of this process."""
    return out / f".{name}.part-{os.getpid()}-{secrets.token_hex(4)}"


def is_part(folder: Path) -> bool:
    """True if ``folder`` exists and has the name of a part folder."""
    return _PART.fullmatch(folder.absolute().name) is not None and folder.is_dir()


def worth_keeping(folder: Path) -> bool:
    """True if a part has a checkpoint to continue from, or a manifest, which is written last."""
    return (folder / CHECKPOINT).exists() or (folder / MANIFEST).exists()


def _part_folders(out: Path, name: str | None) -> list[Path]:
    """Part folders in ``out``, of the run ``name`` or of all, by name."""
    try:
        with os.scandir(out) as entries:
            return sorted(
                out / entry.name
                for entry in entries
                if entry.name[0] == "."
                and (part := _PART.fullmatch(entry.name))
                and name in (None, part[1])
                and entry.is_dir(follow_symlinks=False)
            )
    except OSError:
        return []


def parts_of(out: Path, name: str | None = None) -> list[Part]:
    """Part folders of the run ``name``, or of all runs, in which nothing changes.

    Of the run ``name``, those of dead processes from which nothing can be continued are left out.
    """
    parts = map(Part.at, _part_folders(out, name))
    return [
        part for part in parts if part.folder.exists() and (part.alive or worth_keeping(part.folder) or name is None)
    ]


def remove_remains(out: Path, name: str) -> None:
    """Remove the part folders of dead processes from which nothing can be continued."""
    for folder in _part_folders(out, name):
        with contextlib.suppress(OSError):
            if (lock := take_lock(folder)) is not None:
                if not worth_keeping(folder):
                    remove_own(folder)
                lock.release()
