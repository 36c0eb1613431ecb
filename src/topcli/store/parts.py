"""Run folders in the making, ``.<name>.part-<pid>-<random>``: who works in them, and what killed processes left.

A process holds an exclusive lock on the file ``lock`` in its folder. The system takes the lock away when the process
ends, however it ends: a lock that can be taken is nobody's. Where there are no such locks the process number counts.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import secrets
import shutil
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from topcli.store.checkpoint import CHECKPOINT

try:
    import fcntl
except ImportError:  # not a POSIX system
    fcntl = None

MANIFEST = "manifest.json"
LOCK = "lock"
RESERVE = "reserve"
RESERVED = 1 << 18
"""Bytes: room for the reports, a footer and a checkpoint."""
_OWNER = re.compile(r"(\d+)-[0-9a-f]{8}")


def _prefix(name: str) -> str:
    return f".{name}.part-"


def new_part(out: Path, name: str) -> Path:
    """A free name for a folder of this process."""
    return out / f"{_prefix(name)}{os.getpid()}-{secrets.token_hex(4)}"


def _parts(out: Path, name: str) -> list[Path]:
    prefix = _prefix(name)
    try:
        entries = sorted(out.iterdir())
    except OSError:
        return []
    return [e for e in entries if e.name.startswith(prefix) and _OWNER.fullmatch(e.name[len(prefix) :])]


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


class Lock:
    """A lock that this process holds on a folder, until ``release`` or its end."""

    def __init__(self, handle: int) -> None:
        self._handle = handle

    def release(self) -> None:
        """Give the lock back; a second time does nothing."""
        if self._handle >= 0:
            os.close(self._handle)
            self._handle = -1


def _exclusive(handle: int) -> bool | None:
    """Take the lock of the open file: whether it was to be had; None where the file system has no locks."""
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
    """Lock a folder that this process has just made, saying what it is for. Raises OSError."""
    unnamed = folder / f".{LOCK}"
    handle = os.open(unnamed, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
    _exclusive(handle)
    _sign(handle, about)
    os.replace(unnamed, folder / LOCK)  # whoever sees the file sees it locked
    return Lock(handle)


def owner(folder: Path) -> dict[str, Any]:
    """What the lock file of ``folder`` says: ``pid``, ``digest``, ``code``; empty when it says nothing."""
    try:
        told = json.loads((folder / LOCK).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return told if isinstance(told, dict) else {}


def lock_left(folder: Path, about: dict[str, Any] | None = None) -> Lock | None:
    """Lock a folder that another process may have left; None when one still works there, or another was faster.

    With ``about`` the lock file then speaks of this process.
    """
    named = _OWNER.search(folder.name)
    made_here = not (folder / LOCK).exists()
    if made_here and named and _alive(int(named[1])):
        return None  # about to lock it, or about to put it in its place
    pid = owner(folder).get("pid", 0)
    try:
        handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError:
        return None
    taken = _exclusive(handle)
    if taken is None:
        taken = not (isinstance(pid, int) and pid > 0 and _alive(pid))
    with contextlib.suppress(OSError):
        if taken and os.path.samestat(os.fstat(handle), os.stat(folder / LOCK)):
            if about is not None:
                _sign(handle, about)
            return Lock(handle)
    os.close(handle)
    return None


def take_lock(folder: Path, about: dict[str, Any] | None = None) -> Lock | None:
    """``lock_left``, with a second look when somebody holds the lock who does not work there: he looks about, too."""
    lock = lock_left(folder, about)
    if lock is None and (folder / LOCK).exists() and not _alive(int(owner(folder).get("pid", 0)) or os.getpid()):
        time.sleep(0.05)
        lock = lock_left(folder, about)
    return lock


def reserve(folder: Path) -> None:
    """Set some space aside, once, so that a full disk leaves enough to close what was written. Raises OSError."""
    path = folder / RESERVE
    if not path.exists():
        path.write_bytes(bytes(RESERVED))


def release_reserve(folder: Path) -> None:
    """Give the space back."""
    (folder / RESERVE).unlink(missing_ok=True)


@dataclass(frozen=True)
class Part:
    """A folder in the making: its ``owner`` (see ``owner``), and whether that process still works there."""

    folder: Path
    owner: dict[str, Any]
    alive: bool

    @property
    def worth_keeping(self) -> bool:
        """Whether there is a checkpoint to go on from, or a manifest that was written last of all."""
        return (self.folder / CHECKPOINT).exists() or (self.folder / MANIFEST).exists()


def parts_of(out: Path, name: str) -> list[Part]:
    """The folders in the making of the run ``name``, after sweeping away what is dead and of no use."""
    found = []
    for folder in _parts(out, name):
        said = owner(folder)
        lock = take_lock(folder)
        part = Part(folder, said, lock is None)
        if lock is not None and not part.worth_keeping:
            shutil.rmtree(folder, ignore_errors=True)
        elif folder.exists():
            found.append(part)
        if lock is not None:
            lock.release()
    return found
