"""Cache of object code on disk; files that another user could have written are not used.

A user who can write a file here decides what later processes execute. The folder and each file are therefore opened
without following a symbolic link at the end of the path, and used only if they are a folder and a regular file, owned
by the effective user, that nobody else may write. The folders above are not checked: a temporary folder is open to all,
and some systems make folders writable by the group. What is stored and not trusted is computed again and not stored.
"""

from __future__ import annotations

import hashlib
import json
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

CACHE_ENTRIES = 1024
"""Number of entries that the cache keeps; the oldest ones are removed."""
CODE = ".o"
"""Suffix of object code."""
_DIRECTORY = getattr(os, "O_DIRECTORY", 0)
_NOFOLLOW = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0)


@dataclass(frozen=True)
class ObjectCode:
    """An object file with the name and signature of its function, and the external symbols that it needs."""

    code: bytes
    symbol: str
    signature: str
    needs: tuple[str, ...]


class UntrustedError(OSError):
    """A folder or file that must not be used; the message gives the reason."""


def cache_folder() -> Path:
    """Folder of the object code: ``$NUMBA_CACHE_DIR/topcli`` when that is set, else in the user's cache folder."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen:
        return Path(chosen) / "topcli"
    from platformdirs import user_cache_path

    return user_cache_path("topcli") / "kernels"


def _distrust(about: os.stat_result) -> str:
    """Reason not to use a file or folder; empty if there is none."""
    if hasattr(os, "geteuid") and about.st_uid != os.geteuid():
        return f"it belongs to the user with number {about.st_uid}, not to {os.geteuid()}"
    if about.st_mode & 0o022:
        return f"others may write it (mode {stat.S_IMODE(about.st_mode):o})"
    return ""


@contextmanager
def _opened(folder: Path) -> Iterator[int]:
    """Descriptor of the folder. Raises UntrustedError or OSError."""
    if folder.is_symlink():
        raise UntrustedError(f"{folder} is a symbolic link")
    handle = os.open(folder, os.O_RDONLY | _DIRECTORY | _NOFOLLOW)
    try:
        if reason := _distrust(os.fstat(handle)):
            raise UntrustedError(f"{folder}: {reason}")
        yield handle
    finally:
        os.close(handle)


def _content(folder: int, name: str) -> bytes:
    """Content of a file. Raises UntrustedError or OSError."""
    handle = os.open(name, os.O_RDONLY | _NOFOLLOW | getattr(os, "O_NONBLOCK", 0), dir_fd=folder)
    with os.fdopen(handle, "rb") as file:
        about = os.fstat(handle)
        if not stat.S_ISREG(about.st_mode):
            raise UntrustedError(f"{name} is not a regular file")
        if reason := _distrust(about):
            raise UntrustedError(f"{name}: {reason}")
        return file.read()


def _key(identity: str) -> str:
    return hashlib.sha256(identity.encode()).hexdigest()


def stored_content(name: str) -> bytes | None:
    """Content of the file ``name`` of the cache; None if it is absent, not trusted, or not as it was stored."""
    try:
        with _opened(cache_folder()) as folder:
            digest, _, rest = _content(folder, name).partition(b"\n")
            if hashlib.sha256(rest).hexdigest().encode() != digest:
                return None
            with suppress(OSError):
                os.utime(name, dir_fd=folder)
            return rest
    except OSError:
        return None


def store_content(name: str, rest: bytes) -> None:
    """Store a file atomically in the cache, with its checksum; do nothing if the folder cannot be used."""
    path = cache_folder()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileExistsError):
            path.mkdir(mode=0o700)
        with _opened(path) as folder:
            temporary = f"{name.partition('.')[0]}.{os.getpid()}.{os.urandom(4).hex()}.tmp"
            handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _NOFOLLOW, 0o600, dir_fd=folder)
            try:
                with os.fdopen(handle, "wb") as file:
                    file.write(hashlib.sha256(rest).hexdigest().encode() + b"\n" + rest)
                os.replace(temporary, name, src_dir_fd=folder, dst_dir_fd=folder)
            except BaseException:
                with suppress(OSError):
                    os.unlink(temporary, dir_fd=folder)
                raise
            _remove_oldest(folder, name[name.index(".") :])
    except OSError:
        pass


def stored_code(identity: str, signature: str) -> ObjectCode | None:
    """Stored object code with this ``identity``, for a function of this signature; None if absent or damaged."""
    key = _key(identity)
    rest = stored_content(f"{key}{CODE}")
    if rest is None:
        return None
    header, _, code = rest.partition(b"\n")
    try:
        about = json.loads(header)
        if about["key"] != key or about["signature"] != signature:
            return None
        return ObjectCode(code, str(about["symbol"]), signature, tuple(map(str, about["needs"])))
    except (ValueError, KeyError, TypeError, RecursionError):
        return None


def store_code(identity: str, code: ObjectCode) -> None:
    """Store object code atomically; do nothing if the folder cannot be used."""
    key = _key(identity)
    about = {"key": key, "signature": code.signature, "symbol": code.symbol, "needs": code.needs}
    store_content(f"{key}{CODE}", json.dumps(about).encode() + b"\n" + code.code)


def _entries(folder: int, suffixes: tuple[str, ...]) -> list[tuple[str, os.stat_result]]:
    """Names and ``lstat`` results of the files with one of the ``suffixes``, newest first."""
    entries = []
    for name in os.listdir(folder):
        if name.endswith(suffixes):
            with suppress(OSError):
                entries.append((name, os.stat(name, dir_fd=folder, follow_symlinks=False)))
    return sorted(entries, key=lambda entry: entry[1].st_mtime_ns, reverse=True)


def _remove_oldest(folder: int, suffix: str) -> None:
    for name, _ in _entries(folder, (suffix,))[CACHE_ENTRIES:]:
        with suppress(OSError):
            os.unlink(name, dir_fd=folder)


def cache_problem() -> str:
    """Reason not to use the current user's cache; empty if there is none."""
    try:
        with _opened(cache_folder()):
            return ""
    except FileNotFoundError:
        return ""
    except OSError as error:
        return str(error)
