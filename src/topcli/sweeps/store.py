"""Folder of a sweep: finished rows in a SQLite file, to which batches are added, and the table made of them at the end.

The folder holds ``manifest.json``, ``sweep.yaml`` (the resolved sweep file), ``rows.db`` (finished rows, those of
earlier sweep files and of earlier code included) and, once the sweep has ended, ``rows.parquet``. A row is found by the
digest of what it computes, so that rows of different definitions never mix. SQLite's rollback journal is used on all
disks: a batch takes about a second, so that a write-ahead log would gain nothing, and it needs a local disk.
"""

from __future__ import annotations

import os
import sqlite3
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from topcli.config.files import scene_files, sweep_files
from topcli.config.sweep import Group, Sweep, load_sweep
from topcli.contracts import Array, Outcome
from topcli.errors import RunError, UsageError, nearest, quoted
from topcli.store.files import json_text, sealed, sha256_of, write_text, write_whole
from topcli.store.provenance import environment, git_commit, now
from topcli.store.results import (
    MANIFEST,
    MANIFEST_VERSION,
    SWEEP,
    stored_results,
)

SWEEP_FILE, DATABASE, ROWS_FILE = "sweep.yaml", "rows.db", "rows.parquet"
COMPLETED, FAILED = Outcome.COMPLETED.value, "failed"
"""Outcomes of a row; ``failed``, if an error or the end of its worker ended it, is no result: it runs again."""
DRAWN = "drawn."
"""Beginning of the columns of drawn values."""
_CREATE = """CREATE TABLE IF NOT EXISTS rows
(digest BLOB PRIMARY KEY, outcome TEXT, message TEXT, numbers BLOB, checksum INTEGER) WITHOUT ROWID"""

StoredRow = tuple[str, str, bytes]
"""Outcome, message and measures (float64) of a finished row."""


class RowStore:
    """Finished rows by digest, open in one process at a time."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / DATABASE
        with self._failures():
            self._file = sqlite3.connect(self.path)
            self._file.execute("PRAGMA synchronous = FULL")
            self._file.execute(_CREATE)

    def __enter__(self) -> RowStore:
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()

    @contextmanager
    def _failures(self) -> Iterator[None]:
        """Report what SQLite cannot do. Raises RunError."""
        try:
            yield
        except sqlite3.OperationalError as error:
            raise RunError(f"{self.path}: {error}; the rows finished before are kept") from None
        except (sqlite3.DatabaseError, TypeError, ValueError) as error:  # types or texts of a changed row
            raise RunError(f"{self.path}: damaged ({error}); run again with --force to begin anew") from None

    def add(self, digests: Sequence[bytes], rows: Sequence[StoredRow]) -> None:
        """Add finished rows, all or none; they are on the disk afterwards. Raises RunError."""
        entries = [(digest, *row, _checksum(digest, *row)) for digest, row in zip(digests, rows, strict=True)]
        with self._failures(), self._file:
            self._file.executemany("INSERT OR REPLACE INTO rows VALUES (?, ?, ?, ?, ?)", entries)

    def read(self) -> dict[bytes, StoredRow]:
        """All rows. Raises RunError."""
        rows: dict[bytes, StoredRow] = {}
        with self._failures():
            for digest, outcome, message, numbers, checksum in self._file.execute("SELECT * FROM rows"):
                if checksum != _checksum(digest, outcome, message, numbers):
                    raise sqlite3.DatabaseError("a row has changed")
                rows[digest] = outcome, message, numbers
        return rows


def _checksum(digest: bytes, outcome: str, message: str, numbers: bytes) -> int:
    return zlib.crc32(b"\0".join([digest, f"{outcome}\0{message}".encode(errors="surrogatepass"), numbers]))


def write_manifest(folder: Path, sweep: Sweep, ended: bool = False, **entries: Any) -> None:
    """Write the manifest of a sweep, with the checksums of its files if it has ``ended``. Raises OSError."""
    content = {"manifest_version": MANIFEST_VERSION, "kind": SWEEP, "name": sweep.name, "digest": sweep.digest}
    content |= {"key": sweep.digest[:8], "measures": list(sweep.measures), "outcome": None}
    content |= {"ended": now()} if ended else {}
    content |= {"environment": environment(), **git_commit(), **entries}
    paths = [folder / name for name in (ROWS_FILE, SWEEP_FILE, DATABASE) if ended]
    content["files"] = {path.name: {"size": path.stat().st_size, "sha256": sha256_of(path)} for path in paths}
    write_text(folder / MANIFEST, json_text(sealed(content)))


def write_table(
    folder: Path, sweep: Sweep, groups: Sequence[Group], digests: Sequence[bytes], rows: Mapping[bytes, StoredRow]
) -> dict[str, int]:
    """Write ``rows.parquet``, a line for each finished row of the sweep; return the numbers of rows by outcome.

    Raises OSError.
    """
    import pandas as pd

    # values of the keys, and drawn values, of all rows
    numbers = np.concatenate([group.numbers for group in groups])
    columns: dict[str, Any] = {key: [value for group in groups for value in group.values[key]] for key in sweep.keys}
    table = pd.DataFrame(columns, index=pd.Index(numbers, name="row")).sort_index()
    for key in sweep.keys:
        if table[key].dtype == object:  # numbers and texts
            table[key] = table[key].astype("str")
    drawn: dict[str, Array] = {}
    for group in groups:
        for name, values in sweep.drawn(group).items():
            drawn.setdefault(DRAWN + name, np.full(len(digests), np.nan))[group.numbers] = values
    table = table.assign(**drawn)

    # results of the rows that are finished
    table = table[np.array([digest in rows for digest in digests], dtype=bool)].reset_index()
    finished = [digest for digest in digests if digest in rows]
    outcomes, messages, numbers = zip(*(rows[digest] for digest in finished), strict=True) if finished else ((),) * 3
    table["outcome"], table["message"] = list(outcomes), list(messages)
    table[list(sweep.measures)] = np.frombuffer(b"".join(numbers)).reshape(len(finished), len(sweep.measures))
    table["digest"] = [digest.hex() for digest in finished]
    table.attrs = {"name": sweep.name, "keys": list(sweep.keys), "measures": list(sweep.measures)}
    write_whole(folder / ROWS_FILE, lambda path: table.to_parquet(path, index=False, write_page_checksum=True))
    return dict(Counter(outcomes))


def is_sweep(folder: Path) -> bool:
    """True if ``folder`` is that of a sweep."""
    return os.path.isfile(folder / SWEEP_FILE)


def stored_sweep_file(folder: Path, overrides: Sequence[str] = ()) -> Sweep:
    """Return the sweep in ``folder``. Raises UsageError for a folder without one."""
    if not is_sweep(folder):
        raise UsageError(f"{folder}: is not the folder of a sweep; give one such as results/NAME")
    return load_sweep(folder / SWEEP_FILE, overrides)


def missing_result(place: str, results: Path) -> UsageError:
    """Error for a ``place`` where nothing is stored, with the command that computes it or the nearest stored names."""
    name, names = Path(place).name, list(stored_results(results))
    command = "run" if name in scene_files() else "sweep" if name in sweep_files() else ""
    near = f"; {nearest(name, names, 'topcli list runs')}" if names else ""
    if os.path.lexists(usual := Path("results") / place):
        near = f"; did you mean {usual}?"
    hint = f"; run it first: topcli {command} {name}" if command and name == place else near
    return UsageError(f"{quoted(place)}: no such file or folder, and no run of this name in {results}{hint}")
