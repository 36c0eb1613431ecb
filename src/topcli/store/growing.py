"""Append-only file with a running SHA-256, which a later process verifies up to a mark, cuts there and continues.

The SHA-256 at the mark is in the checkpoint, so that rows damaged between two processes are never continued.
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
    """Error for a file of rows that cannot be resumed."""
    return RunError(
        f"{path}: damaged ({reason[:120]}); nothing was deleted; run without --resume to start again from step 0"
    )


def named(error: OSError, path: Path) -> OSError:
    """The same error, with ``path`` as its file name if it has none."""
    error.filename = error.filename or str(path)
    return error


class GrowingFile:
    """File at ``path`` to append to, after the first ``length`` bytes, whose SHA-256 is ``sha256``.

    Raises RunError if these bytes are damaged, and OSError.
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
        """Open file, for reading."""
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
