"""A table on its way to one Parquet or CSV file, continued after a kill.

Rows are encoded as they come, in row groups of a fixed size: the file depends neither on the pieces in which they come
nor on how often the run was stopped. An unfinished Parquet file cannot be read, however. Rows therefore go a second
way, into parts: files ``NAME.000017.arrow`` (Arrow IPC, uncompressed, which pandas and polars read), one from each
checkpoint to the next. To continue after a kill is to encode the parts again. A table that is finished before its first
row group is full and before its first checkpoint has no parts.
"""

from __future__ import annotations

import contextlib
import os
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from topcli.errors import RunError
from topcli.store.series import arrow_table, column_type, csv_options, parquet_options

ROW_GROUP = 1 << 17
"""Rows of a Parquet row group, which are held in memory until written."""
GATHERED = 1 << 13
"""Rows that are passed on together."""
PARTS = ".parts"
"""End of the key under which the state of a table holds the checksums of its parts."""


class Table:
    """Table ``name`` in ``folder``, to which rows are added until ``finish`` completes its file; a context manager.

    ``metadata`` goes into the schema of the Parquet file. Every method may raise OSError.
    """

    def __init__(self, folder: Path, name: str, metadata: Mapping[str, str], form: str = "parquet") -> None:
        self.name, self._folder, self._metadata, self._form = name, folder, metadata, form
        self._sums: list[int] = []
        """Checksums of the parts that are complete."""
        self._pieces: list[Mapping[str, NDArray[Any]]] = []
        """Pieces of rows that are still to be gathered."""
        self._gathered = 0
        self._held: list[Any] = []
        """Arrow tables of rows that do not yet fill a row group; the first ``_saved`` of ``_rows`` are in a part."""
        self._rows = self._saved = 0
        self._part: tuple[BinaryIO, Any] | None = None
        self._parquet: tuple[BinaryIO, Any] | None = None

    def __enter__(self) -> Table:
        return self

    def __exit__(self, *exception: object) -> None:
        """Close the files as they are; a table that is not finished can only be restored."""
        for file, writer in filter(None, (self._part, self._parquet)):
            with contextlib.suppress(OSError, ValueError):  # on a full disk, or after another error of the writer
                writer.close()
            writer.is_open = False  # else its end would be written, and fail, once more when it is deleted
            with contextlib.suppress(OSError):
                file.close()

    def add(self, columns: Mapping[str, NDArray[Any]]) -> None:
        """Append rows: an array (m,) for each column, which must not change afterwards."""
        if not (rows := len(next(iter(columns.values())))):
            return
        self._pieces.append(columns)
        self._gathered += rows
        if self._gathered >= min(GATHERED, ROW_GROUP):
            self._gather()

    def commit(self) -> dict[str, NDArray[np.uint32]]:
        """Bring all rows to the disk; the state from which ``restore`` continues."""
        self._gather()
        self._save()
        if self._part:
            file, writer = self._part
            writer.close()
            file.flush()
            os.fsync(file.fileno())
            file.close()
            self._part = None
            self._sums.append(_checksum(_part_path(self._folder, self.name, len(self._sums))))
        return {self.name + PARTS: np.array(self._sums, dtype=np.uint32)}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continue from a state of ``commit``. Raises RunError if a part is damaged; later parts are overwritten."""
        import pyarrow as pa

        sums = state[self.name + PARTS]
        for name, fault in check_parts(self._folder, self.name, sums).items():
            raise RunError(f"{self._folder / name}: damaged ({fault}); run again with --force to start from step 0")
        for number in range(len(sums)):
            with pa.memory_map(str(_part_path(self._folder, self.name, number))) as file:
                self._hold(pa.ipc.open_file(file).read_all())
            self._saved = self._rows
            self._encode()
        self._sums = sums.tolist()

    def finish(self, columns: Sequence[str], metadata: Mapping[str, str]) -> Path:
        """Complete the file, with more ``metadata``, and return its path; without rows it has these ``columns``."""
        import pyarrow as pa

        self._gather()
        if not self._held:
            self._hold(arrow_table({name: np.empty(0, dtype=column_type(name)) for name in columns}))
        rest = pa.concat_tables(self._held)
        file, writer = self._opened(rest.schema)
        if len(rest):
            writer.write_table(rest)
        writer.add_key_value_metadata(dict(metadata))
        writer.close()
        file.close()
        self._parquet = None
        path = self._folder / f"{self.name}.parquet"
        return path if self._form == "parquet" else _to_csv(path)

    def _gather(self) -> None:
        """Make one Arrow table of the pieces, and write the row groups that are full now."""
        if not self._gathered:
            return
        rows, *others = self._pieces
        if others:
            rows = {name: np.concatenate([piece[name] for piece in self._pieces]) for name in rows}
        self._hold(arrow_table(rows))
        self._pieces, self._gathered = [], 0
        if self._rows >= ROW_GROUP:
            self._save()
            self._encode()

    def _hold(self, table: Any) -> None:
        self._held.append(table)
        self._rows += len(table)

    def _save(self) -> None:
        """Write the rows that are in no part to the current part, which begins here if there is none."""
        import pyarrow as pa

        if self._saved == self._rows:
            return
        table = pa.concat_tables(self._held).slice(self._saved)
        if self._part is None:
            file = _part_path(self._folder, self.name, len(self._sums)).open("wb")
            self._part = file, pa.ipc.new_file(file, table.schema)
        self._part[1].write_table(table)
        self._saved = self._rows

    def _encode(self) -> None:
        """Write the full row groups to the Parquet file; all rows must have been saved."""
        import pyarrow as pa

        table, whole = pa.concat_tables(self._held), self._rows - self._rows % ROW_GROUP
        for start in range(0, whole, ROW_GROUP):
            self._opened(table.schema)[1].write_table(table.slice(start, ROW_GROUP))
        self._held, self._rows = [table.slice(whole)], self._rows - whole
        self._saved = self._rows

    def _opened(self, schema: Any) -> tuple[BinaryIO, Any]:
        """Parquet file, which is begun at the first call, and its writer."""
        import pyarrow.parquet as pq

        if self._parquet is None:
            file = (self._folder / f"{self.name}.parquet").open("wb")
            schema = schema.with_metadata(dict(self._metadata))
            self._parquet = file, pq.ParquetWriter(file, schema, **parquet_options(schema.names))
        return self._parquet


def check_parts(folder: Path, table: str, sums: NDArray[Any]) -> dict[str, str]:
    """Damaged parts of a table by name, with the fault; ``sums`` (k,) are the checksums of all its parts."""
    faults = {}
    for number, expected in enumerate(sums):
        path = _part_path(folder, table, number)
        try:
            if _checksum(path) != expected:
                faults[path.name] = "its CRC-32 differs from that in the checkpoint"
        except FileNotFoundError:
            faults[path.name] = "missing"
        except (OSError, ValueError) as error:  # an empty file cannot be mapped
            faults[path.name] = str(error)[:120]
    return faults


def _part_path(folder: Path, table: str, number: int) -> Path:
    return folder / f"{table}.{number:06d}.arrow"


def _checksum(path: Path) -> int:
    """CRC-32 of a file, which takes half the time of SHA-256."""
    checksum = 0
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            checksum = zlib.crc32(block, checksum)
    return checksum


def _to_csv(path: Path) -> Path:
    """Write a Parquet file as CSV in its place, and return the new path."""
    import pyarrow.csv as csv
    import pyarrow.parquet as pq

    target = path.with_suffix(".csv")
    with (
        pq.ParquetFile(path) as source,
        target.open("wb") as file,
        csv.CSVWriter(file, source.schema_arrow, write_options=csv_options()) as writer,
    ):
        for group in range(source.num_row_groups):
            writer.write_table(source.read_row_group(group))
    path.unlink()
    return target
