"""A file that only grows, hashed as it grows, which a later process cuts at a mark, verifies and continues.

The SHA-256 at the mark lies in the checkpoint: rows that were damaged between two processes are never continued.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from pathlib import Path
from typing import BinaryIO

from topcli.errors import RunError

_BLOCK = 1 << 20


def damaged(path: Path, reason: str) -> RunError:
    """The error for rows that cannot be resumed."""
    return RunError(
        f"{path}: damaged ({reason[:120]}); nothing was deleted; run without --resume to start again from step 0"
    )


def named(error: OSError, path: Path) -> OSError:
    """The same error with the file it is about."""
    error.filename = error.filename or str(path)
    return error


class GrowingFile:
    """Append to the file at ``path``, from the mark ``length`` with the SHA-256 ``sha256`` if they are given.

    Raises RunError if the bytes before the mark are not those that were written, and OSError.
    """

    def __init__(self, path: Path, length: int = 0, sha256: str = "") -> None:
        self.path, self.length = path, length
        self._digest = hashlib.sha256()
        self._synced = length
        try:
            self._file: BinaryIO = path.open("r+b" if length else "w+b", buffering=0)
            if length:
                self._verify(sha256)
            self._file.truncate(length)
        except FileNotFoundError:
            raise (damaged(path, "missing") if length else FileNotFoundError(2, "no such folder", str(path))) from None
        except OSError as error:
            raise named(error, path) from None

    def _verify(self, sha256: str) -> None:
        left = self.length
        while left and (block := self._file.read(min(_BLOCK, left))):
            self._digest.update(block)
            left -= len(block)
        if left or self._digest.hexdigest() != sha256:
            self._file.close()
            reason = f"ends at byte {self.length - left} of {self.length}" if left else "its SHA-256 differs"
            raise damaged(self.path, reason)

    @property
    def sha256(self) -> str:
        """SHA-256 of the file so far."""
        return self._digest.hexdigest()

    @property
    def file(self) -> BinaryIO:
        """The open file, to be read from."""
        return self._file

    def append(self, *pieces: bytes | memoryview) -> None:
        """Append all of the pieces or none. Raises OSError."""
        try:
            self._file.seek(self.length)
            for piece in pieces:
                rest = memoryview(piece)
                while rest:
                    rest = rest[self._file.write(rest) :]
        except OSError as error:
            with contextlib.suppress(OSError):
                self._file.truncate(self.length)
            raise named(error, self.path) from None
        for piece in pieces:
            self._digest.update(piece)
            self.length += len(piece)

    def sync(self) -> None:
        """Flush the file to the disk. Raises OSError."""
        if self._synced != self.length:
            try:
                os.fsync(self._file.fileno())
            except OSError as error:
                raise named(error, self.path) from None
            self._synced = self.length

    def close(self) -> None:
        """Close the file."""
        self._file.close()
