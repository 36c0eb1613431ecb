"""Journal of a sweep: finished rows, appended in blocks; a killed process loses only rows not yet written.

Each line of ``journal.jsonl`` is a block: the CRC-32 of its text, and the text, a JSON object with the rows by columns.
An incomplete last line, of a process that was killed while it wrote, is cut off when the journal is opened. Rows are
known by their digest; if a digest occurs twice, the later row counts.
"""

from __future__ import annotations

import json
import os
import re
import time
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.errors import RunError
from topcli.store.files import io_failure

JOURNAL = "journal.jsonl"
SYNC_SECONDS = 2.0
"""Longest time between two flushes to the disk; what the process has written outlives the process at once."""
KEPT_BLOCKS = 24
"""Parsed blocks that are kept while rows are read back."""
DIGEST = "S16"
"""First 16 bytes of a digest."""
COMPLETED = "completed"
_TEXT = re.compile(r"[0-9a-f]{64}").fullmatch

Names = NDArray[np.bytes_]


def short_digest(digest: str) -> bytes:
    """First 16 bytes of a digest of 64 hexadecimal digits."""
    return bytes.fromhex(digest[:32])


@dataclass(frozen=True)
class FinishedRows:
    """Finished rows by columns.

    ``digest``, ``outcome``, ``message`` and ``code`` have an entry for each row; so have the entries of ``keys``, the
    varied keys, and of ``values``, the measures. ``cpu`` is the processor that computed them.
    """

    digest: Sequence[str]
    outcome: Sequence[str]
    message: Sequence[str]
    code: Sequence[str]
    keys: Mapping[str, Sequence[Any]]
    values: Mapping[str, Sequence[float]]
    cpu: str

    def text(self) -> str:
        """The block as one line of JSON."""
        return json.dumps(self.__dict__, separators=(",", ":"))


ENTRY = np.dtype([("digest", DIGEST), ("completed", "?")] + [(n, "i4") for n in ("code", "measures", "block", "place")])
"""Finished row in an ``Index``."""


@dataclass(frozen=True)
class Index:
    """Finished rows by digest, sorted: where each is in the journal, and what decides if it has to run again.

    ``rows`` are of the type ``ENTRY``: ``block`` and ``place`` are the number of its block and its position there;
    ``code`` and ``measures`` index ``codes`` and ``measured``, the names of the measures that a block holds.
    """

    rows: NDArray[np.void]
    codes: list[str]
    measured: list[frozenset[str]]

    def find(self, digests: Names) -> NDArray[np.int64]:
        """Positions of ``digests`` (m,) in the index; -1 for those that are not in it."""
        known = self.rows["digest"]
        if not len(known):
            return np.full(len(digests), -1, dtype=np.int64)
        at = np.minimum(np.searchsorted(known, digests), len(known) - 1)
        return np.where(known[at] == digests, at, -1)


class Journal:
    """The journal in ``folder``: read it, append blocks to it, read rows back; a context manager.

    ``damaged`` is the number of lines that cannot be read. With ``write`` the caller must hold the lock of the folder.
    ``clock`` gives the seconds that ``SYNC_SECONDS`` is compared with.
    """

    def __init__(self, folder: Path, write: bool = False, clock: Callable[[], float] = time.monotonic) -> None:
        self.path, self._write, self._clock = folder / JOURNAL, write, clock
        self._offsets: list[tuple[int, int]] = []
        self._entries: list[NDArray[np.void]] = []
        self._codes: dict[str, int] = {}
        self._measured: dict[frozenset[str], int] = {}
        self._parsed: dict[int, FinishedRows] = {}
        self._synced = clock()
        self._end = self.damaged = 0
        self._handle = -1

    def __enter__(self) -> Journal:
        try:
            flags = os.O_RDWR | os.O_CREAT if self._write else os.O_RDONLY
            self._handle = os.open(self.path, flags | getattr(os, "O_NOFOLLOW", 0), 0o666)
        except FileNotFoundError:
            return self
        except OSError as error:
            raise RunError(f"{self.path}: cannot be opened ({error.strerror})") from None
        for offset, line in self._lines():
            self._end = offset + len(line)
            block = _parse(line)
            if block is None:
                self.damaged += 1
            else:
                self._note(offset, len(line), block)
        if self._write and os.fstat(self._handle).st_size > self._end:
            os.ftruncate(self._handle, self._end)
        return self

    def __exit__(self, *exception: object) -> None:
        if self._handle >= 0:
            if self._write:
                os.fsync(self._handle)
            os.close(self._handle)
            self._handle = -1

    def _lines(self) -> Iterator[tuple[int, bytes]]:
        """Yield the complete lines of the file and their offsets."""
        offset = 0
        with os.fdopen(os.dup(self._handle), "rb") as file:
            file.seek(0)
            for line in file:
                if line.endswith(b"\n"):
                    yield offset, line
                offset += len(line)

    def _note(self, offset: int, length: int, block: FinishedRows) -> None:
        entries = np.empty(len(block.digest), dtype=ENTRY)
        entries["digest"] = [short_digest(digest) for digest in block.digest]
        entries["completed"] = [outcome == COMPLETED for outcome in block.outcome]
        entries["code"] = [self._codes.setdefault(code, len(self._codes)) for code in block.code]
        entries["measures"] = self._measured.setdefault(frozenset(block.values), len(self._measured))
        entries["block"], entries["place"] = len(self._offsets), np.arange(len(entries))
        self._offsets.append((offset, length))
        self._entries.append(entries)

    def append(self, block: FinishedRows) -> None:
        """Append a block of rows. Raises RunError if it cannot be written."""
        text = block.text().encode()
        line = b"%08x %s\n" % (zlib.crc32(text), text)
        try:
            written = 0
            while written < len(line):
                written += os.pwrite(self._handle, line[written:], self._end + written)
            if self._clock() - self._synced >= SYNC_SECONDS:
                os.fsync(self._handle)
                self._synced = self._clock()
        except OSError as error:
            os.ftruncate(self._handle, self._end)
            raise io_failure(error, self.path, "the rows finished before are kept") from None
        self._note(self._end, len(line), block)
        self._end += len(line)

    def index(self) -> Index:
        """Index of all rows in the journal."""
        rows = np.concatenate([np.empty(0, dtype=ENTRY), *self._entries])
        rows = rows[np.argsort(rows["digest"], kind="stable")]
        latest = np.append(rows["digest"][1:] != rows["digest"][:-1], True)[: len(rows)]
        return Index(rows[latest], list(self._codes), list(self._measured))

    def block(self, number: int) -> FinishedRows:
        """Rows of the line ``number``, read back. Raises RunError if the file has changed."""
        block = self._parsed.pop(number, None)
        if block is None:
            offset, length = self._offsets[number]
            block = _parse(os.pread(self._handle, length, offset))
            if block is None:
                raise RunError(f"{self.path}: block {number} has changed since it was read")
            if len(self._parsed) >= KEPT_BLOCKS:
                del self._parsed[next(iter(self._parsed))]
        self._parsed[number] = block
        return block


def _parse(line: bytes) -> FinishedRows | None:
    """Rows of a line; None if the line is damaged or holds no rows by columns."""
    try:
        if line[:9] != b"%08x " % zlib.crc32(line[9:-1]):
            return None
        block = FinishedRows(**json.loads(line[9:-1]))
        columns = (block.outcome, block.message, block.code, *block.keys.values(), *block.values.values())
        whole = all(len(column) == len(block.digest) for column in columns) and all(map(_TEXT, block.digest))
        texts = (*block.outcome, *block.message, *block.code, block.cpu, *block.keys, *block.values)
        numbers = (value for column in block.values.values() for value in column)
        whole &= all(isinstance(text, str) for text in texts) and all(
            isinstance(number, float | int) for number in numbers
        )
        return block if whole else None
    except (ValueError, TypeError, AttributeError, RecursionError):
        return None


def damaged_lines(path: Path) -> int:
    """Number of lines of a journal that cannot be read, an incomplete last one included. Raises OSError."""
    with path.open("rb") as file:
        return sum(not line.endswith(b"\n") or _parse(line) is None for line in file)
