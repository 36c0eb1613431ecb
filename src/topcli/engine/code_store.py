"""Folder of stored machine code, which is not used if another user could have written a file in it.

Who can write a file here decides what later processes execute. The folder must therefore belong to the effective user,
and nobody else may write it; and the checksum of a file, which covers its name too, must agree.
"""

from __future__ import annotations

import hashlib
import os
from contextlib import suppress
from pathlib import Path

ENTRIES = 1024
"""Number of files that the folder keeps; the oldest ones are removed."""


def cache_folder() -> Path:
    """Folder of the machine code: ``$NUMBA_CACHE_DIR/topcli`` if that is set, else in the user's cache folder."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen:
        return Path(chosen) / "topcli"
    from platformdirs import user_cache_path

    return user_cache_path("topcli") / "kernels"


def cache_problem() -> str:
    """Reason not to use the folder; empty if there is none."""
    try:
        about = cache_folder().stat()
    except FileNotFoundError:
        return ""
    except OSError as error:
        return str(error)
    if hasattr(os, "geteuid") and about.st_uid != os.geteuid():
        return f"it belongs to the user with number {about.st_uid}, not to {os.geteuid()}"
    return f"others may write it (mode {about.st_mode & 0o777:o})" if about.st_mode & 0o022 else ""


def _checksum(name: str, content: bytes) -> bytes:
    return hashlib.sha256(name.encode() + content).digest()


def stored_code(name: str) -> bytes | None:
    """Content of a file of the folder; None if it is absent, or not as it was stored, or the folder is not trusted."""
    with suppress(OSError):
        data = b"" if cache_problem() else (cache_folder() / name).read_bytes()
        if data[:32] == _checksum(name, data[32:]):
            return data[32:]
    return None


def store_code(name: str, content: bytes) -> None:
    """Store a file atomically; do nothing if the folder cannot be used."""
    folder = cache_folder()
    temporary = folder / f"{name}.{os.getpid()}.{os.urandom(4).hex()}"
    with suppress(OSError):
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        if cache_problem():
            return
        try:
            with open(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
                file.write(_checksum(name, content) + content)
            temporary.replace(folder / name)
        finally:
            temporary.unlink(missing_ok=True)
        for old in sorted(folder.iterdir(), key=lambda path: -path.stat().st_mtime_ns)[ENTRIES:]:
            old.unlink(missing_ok=True)
