"""A table on its way to one Parquet or CSV file, continued after a kill.

Rows are encoded in row groups of a fixed size: the file depends neither on the pieces in which they come nor on how
often the run was stopped. An unfinished Parquet file cannot be read, however. Rows therefore go a second way, into
parts: files ``NAME.000017.arrow`` (Arrow IPC, uncompressed, which pandas and polars read), one from each checkpoint to
the next. To continue after a kill is to encode the parts again. A table that is finished before its first row group is
full and before its first checkpoint has no parts.
"""

from __future__ import annotations

import contextlib
import mmap
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
MANY_PIECES = 32
"""Pieces of rows from which on they are short, and are copied into one."""


class GrowingTable:
    """Table ``name`` in ``folder``, to which rows are added until ``finish`` completes its file; a context manager.

    ``metadata`` goes into the schema of the Parquet file. Every method may raise OSError.
    """

    def __init__(self, folder: Path, name: str, metadata: Mapping[str, str], form: str = "parquet") -> None:
        self.name, self._folder, self._metadata, self._form = name, folder, metadata, form
        self._rest: list[Any] = []
        """Arrow tables of rows that are in a part, but do not yet fill a row group."""
        self._fresh: list[Any] = []
        """Arrow tables of rows that are in no part."""
        self._rows = 0
        """Rows of both lists."""
        self._parts: list[int] = []
        """Checksums of the complete parts."""
        self._part: tuple[BinaryIO, Any] | None = None
        self._parquet: tuple[BinaryIO, Any] | None = None

    def __enter__(self) -> GrowingTable:
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
        if rows := len(next(iter(columns.values()))):
            self._fresh.append(arrow_table(columns))
            self._rows += rows
            if self._rows >= ROW_GROUP:
                self._save()

    def commit(self) -> dict[str, NDArray[Any]]:
        """Bring all rows to the disk; the state from which ``restore`` continues."""
        self._save()
        if self._part:
            file, writer = self._part
            writer.close()
            file.flush()
            os.fsync(file.fileno())
            file.close()
            self._part = None
            self._parts.append(_checksum(self._part_path(len(self._parts))))
        return {f"{self.name}.parts": np.array(self._parts, dtype=np.int64)}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continue from a state of ``commit``; later parts are overwritten. Raises RunError for an unreadable part."""
        import pyarrow as pa

        self._parts = state[f"{self.name}.parts"].tolist()
        for number, checksum in enumerate(self._parts):
            path = self._part_path(number)
            try:
                if _checksum(path) != checksum:
                    raise OSError("its checksum differs from the checkpoint's")
                with pa.memory_map(str(path)) as file:
                    self._encode(pa.ipc.open_file(file).read_all())
            except (OSError, pa.ArrowException) as error:
                raise RunError(f"{path}: damaged ({error}); run again with --force to start from step 0") from None

    def finish(self, columns: Sequence[str], metadata: Mapping[str, str]) -> Path:
        """Complete the file, with more ``metadata``, and return its path; without rows it has these ``columns``."""
        import pyarrow as pa

        empty = {name: np.empty(0, dtype=column_type(name)) for name in columns}
        table = pa.concat_tables([*self._rest, *self._fresh] or [arrow_table(empty)])
        file, writer = self._opened(table.schema)
        if len(table):
            writer.write_table(table)
        writer.add_key_value_metadata(dict(metadata))
        writer.close()
        file.close()
        self._parquet = None
        path = self._folder / f"{self.name}.parquet"
        return path if self._form == "parquet" else _to_csv(path)

    def _part_path(self, number: int) -> Path:
        return self._folder / f"{self.name}.{number:06d}.arrow"

    def _save(self) -> None:
        """Write the fresh rows to the current part, which begins here if there is none, and encode them."""
        import pyarrow as pa

        if not self._fresh:
            return
        rows = pa.concat_tables(self._fresh)
        rows = rows.combine_chunks() if len(self._fresh) > MANY_PIECES else rows
        self._fresh = []
        if self._part is None:
            file = self._part_path(len(self._parts)).open("wb")
            self._part = file, pa.ipc.new_file(file, rows.schema)
        self._part[1].write_table(rows)
        self._encode(rows)

    def _encode(self, rows: Any) -> None:
        """Write the row groups that are full with these rows to the Parquet file."""
        import pyarrow as pa

        table = pa.concat_tables([*self._rest, rows])
        whole = len(table) // ROW_GROUP * ROW_GROUP
        for start in range(0, whole, ROW_GROUP):
            self._opened(table.schema)[1].write_table(table.slice(start, ROW_GROUP))
        self._rest, self._rows = [table.slice(whole)], len(table) - whole

    def _opened(self, schema: Any) -> tuple[BinaryIO, Any]:
        """Parquet file, which is begun at the first call, and its writer."""
        import pyarrow.parquet as pq

        if self._parquet is None:
            file = (self._folder / f"{self.name}.parquet").open("wb")
            schema = schema.with_metadata(dict(self._metadata))
            self._parquet = file, pq.ParquetWriter(file, schema, **parquet_options(schema.names))
        return self._parquet


def _checksum(path: Path) -> int:
    """CRC-32 of a file that is not empty. Raises OSError, also for an empty one."""
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            return zlib.crc32(content)
    except ValueError:
        raise OSError("it is empty") from None


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
