"""Time series on disk, as Parquet or CSV: written in pieces, read by columns.

Parquet columns are compressed by zstd at its fast level -1 after a byte-stream split and without dictionaries. For
smooth float64 series this is bit-exact, smaller than with the defaults, and several times faster to write. Pages carry
checksums, which are verified on every read; by default pyarrow does neither and reads a flipped bit as a number.
Numbers in CSV are the shortest that read back to the same bits.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from topcli.errors import RunError
from topcli.store.files import named
from topcli.store.footer import MAGIC, UNFINISHED, merged_footer

if TYPE_CHECKING:
    import pyarrow.parquet as pq

ROW_GROUP = 131_072
"""Rows of a Parquet row group, which are held in memory until written."""

INTEGERS = ("n", "trajectory", "left_motion")
"""Names of integer columns."""
WORDS = ("outcome",)
"""Names of text columns."""


def _arrow_type(name: str) -> Any:
    import pyarrow as pa

    return pa.int64() if name in INTEGERS else pa.string() if name in WORDS else pa.float64()


def arrow_table(data: Mapping[str, np.ndarray], metadata: Mapping[str, str] | None = None) -> Any:
    """pyarrow table of the arrays (m,) of ``data``, without copying them and without importing pandas."""
    import pyarrow as pa

    arrays, fields = [], []
    for name, values in data.items():
        if values.dtype.kind in "OU":
            arrays.append(pa.array(values.tolist(), pa.string()))
            fields.append(pa.field(name, pa.string(), nullable=False))
            continue
        kind = pa.from_numpy_dtype(values.dtype)
        contiguous = np.ascontiguousarray(values)
        arrays.append(pa.Array.from_buffers(kind, len(contiguous), [None, pa.py_buffer(contiguous)]))
        fields.append(pa.field(name, kind, nullable=False))
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=dict(metadata or {})))


def _kind(name: str) -> type:
    """numpy type of the elements of a column."""
    return np.int64 if name in INTEGERS else object if name in WORDS else np.float64


def _parquet_options(names: Iterable[str]) -> dict[str, Any]:
    names = list(names)
    encodings = {
        name: "DELTA_BINARY_PACKED" if name in INTEGERS else "PLAIN" if name in WORDS else "BYTE_STREAM_SPLIT"
        for name in names
    }
    return {
        "compression": "zstd",
        "compression_level": -1,
        "data_page_size": 1 << 23,
        "use_dictionary": False,
        "write_page_checksum": True,
        "column_encoding": encodings,
        "write_statistics": ["trajectory"] if "trajectory" in names else False,  # to find its row groups
    }


def write_parquet(path: Path, data: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> None:
    """Write whole arrays (m,) as one Parquet file with ``metadata`` in its schema. Raises OSError."""
    import pyarrow.parquet as pq

    pq.write_table(arrow_table(data, metadata), path, **_parquet_options(data))


@dataclass(frozen=True)
class SeriesMark:
    """Position in a series: the length of the file in bytes, its SHA-256, and the rows (m,) held in memory."""

    length: int
    held: dict[str, np.ndarray]
    sha256: str


class _Held:
    """Rows not yet written, in one growing array for each column, so that small pieces are cheap to add."""

    def __init__(self, names: Sequence[str]) -> None:
        self.rows = 0
        self._columns = {name: np.empty(0, dtype=_kind(name)) for name in names}

    def add(self, data: Mapping[str, np.ndarray]) -> None:
        count = len(next(iter(data.values())))
        for name, column in self._columns.items():
            if self.rows + count > len(column):
                grown = np.empty(max(2 * len(column), self.rows + count), dtype=column.dtype)
                grown[: self.rows] = column[: self.rows]
                self._columns[name] = column = grown
            column[self.rows : self.rows + count] = data[name]
        self.rows += count

    def all(self) -> dict[str, np.ndarray]:
        """Views of the columns."""
        return {name: column[: self.rows] for name, column in self._columns.items()}

    def drop(self) -> None:
        self.rows = 0


class SeriesWriter:
    """Write a series of the columns ``names`` in pieces to ``path``; a context manager. Raises OSError.

    Rows are held in memory until they fill a row group. ``mark()`` is the current position. A later writer with that
    mark as ``start`` verifies the file up to there, cuts off the rest and continues; the final file is the same as if
    it had never stopped. It raises RunError if the rows before the mark are damaged.
    """

    def __init__(
        self, path: Path, names: Sequence[str], metadata: Mapping[str, str], start: SeriesMark | None = None
    ) -> None:
        self._path, self._names, self._metadata = path, list(names), dict(metadata)
        self._csv = path.suffix == ".csv"
        self._held = _Held(self._names)
        self._start = start
        self._file: GrowingFile | None = None

    def __enter__(self) -> SeriesWriter:
        start = self._start or SeriesMark(0, {}, "")
        self._file = GrowingFile(self._path, start.length, start.sha256)
        if self._start:
            self._held.add(self._start.held)
        return self

    @property
    def length(self) -> int:
        """Length of the file in bytes."""
        return self._file.length if self._file else 0

    @property
    def sha256(self) -> str:
        """SHA-256 of the file so far."""
        assert self._file is not None
        return self._file.sha256

    def write(self, data: Mapping[str, np.ndarray]) -> None:
        """Append rows: an array (m,) for every column, which is copied."""
        self._held.add(data)
        if self._held.rows >= ROW_GROUP:
            self.end_group()

    def end_group(self) -> None:
        """Write the rows held in memory; in Parquet, a row group ends here."""
        if self._held.rows:
            rows = self._encoded(self._held.all())
            self._append(*((rows,) if self._csv else (rows[: -len(MAGIC)], UNFINISHED)))
            self._held.drop()

    def _append(self, *pieces: bytes | memoryview) -> None:
        """Append to the file, wholly or not at all."""
        assert self._file is not None
        self._file.append(*pieces)

    def _encoded(self, rows: Mapping[str, np.ndarray], metadata: Mapping[str, str] | None = None) -> memoryview:
        """The rows as text, or as a Parquet file; the last one has the ``metadata`` of the whole."""
        import pyarrow as pa

        sink = pa.BufferOutputStream()
        if self._csv:
            import pyarrow.csv as csv

            bare = csv.WriteOptions(include_header=self.length == 0, quoting_style="none", quoting_header="none")
            csv.write_csv(arrow_table(rows), sink, bare)
            return memoryview(sink.getvalue())
        import pyarrow.parquet as pq

        table = arrow_table(rows, self._metadata if metadata is not None else None)
        options = _parquet_options(self._names)
        with pq.ParquetWriter(sink, table.schema, store_schema=metadata is not None, **options) as writer:
            if table.num_rows:
                writer.write_table(table)
            if metadata is not None:
                writer.add_key_value_metadata(dict(metadata))
        return memoryview(sink.getvalue())

    def mark(self, flush: bool = True) -> SeriesMark:
        """Current position in the series; with ``flush`` the file is flushed to the disk first. Raises OSError."""
        assert self._file is not None
        if flush:
            self._file.sync()
        held = {name: column.copy() for name, column in self._held.all().items()}
        return SeriesMark(self.length, held, self.sha256)

    def finish(self, metadata: Mapping[str, str]) -> None:
        """Write the rows held in memory and, in Parquet, the ``metadata`` that is known only at the end."""
        if self._csv or self.length == 0:
            self._append(self._encoded(self._held.all(), metadata))
            self._held.drop()
            return
        self.end_group()
        self._held.drop()
        assert self._file is not None
        last = bytes(self._encoded(self._held.all(), metadata))
        try:
            footer = merged_footer(self._file.file, self.length, last)
        except (ValueError, IndexError) as error:  # another process wrote to the file meanwhile
            raise damaged(self._path, str(error)) from None
        self._append(footer)

    def __exit__(self, *exception: object) -> None:
        if self._file is not None:
            self._file.close()


def open_parquet(path: Path) -> pq.ParquetFile:
    """Open a Parquet file whose pages are compared with their checksums when they are read.

    The footer has no checksum, and pyarrow would read fewer rows where a bit of their number is flipped; so the number
    of all rows is compared with that of the row groups. Raises ValueError if they disagree.
    """
    import pyarrow.parquet as pq

    file = pq.ParquetFile(path, page_checksum_verification=True)
    rows = sum(file.metadata.row_group(group).num_rows for group in range(file.num_row_groups))
    if rows != file.metadata.num_rows:
        file.close()
        raise ValueError(f"{file.metadata.num_rows} rows in all, but {rows} in its row groups")
    return file


def read_series(path: Path, names: Sequence[str] | None = None) -> dict[str, np.ndarray]:
    """Columns ``names`` of a series, each (m,); by default all of them.

    Raises RunError if the file is missing or damaged.
    """
    import pyarrow as pa

    try:
        return _read_columns(path, names)
    except (OSError, KeyError, ValueError, TypeError, pa.ArrowException) as error:
        raise _unreadable(path, error) from None


def _unreadable(path: Path, error: Exception) -> RunError:
    reason = str(error).splitlines()[0] if str(error) else type(error).__name__
    return RunError(f"{path}: cannot be read ({reason[:120]}); run again with --force")


def series_names(path: Path) -> list[str]:
    """Names of the columns of a series. Raises RunError if the file is missing or damaged."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        if path.suffix == ".csv":
            with path.open(encoding="utf-8") as file:
                return file.readline().strip().split(",")
        return list(pq.read_schema(path).names)
    except (OSError, ValueError, pa.ArrowException) as error:
        raise _unreadable(path, error) from None


def _csv_types(path: Path) -> Any:
    """Explicit types of the columns; without them a column of whole floats would be read as integers."""
    import pyarrow.csv as csv

    return csv.ConvertOptions(column_types={name: _arrow_type(name) for name in series_names(path)})


def _read_columns(path: Path, names: Sequence[str] | None) -> dict[str, np.ndarray]:
    if path.suffix == ".csv":
        import pyarrow.csv as csv

        table = csv.read_csv(path, convert_options=_csv_types(path))
    else:
        with open_parquet(path) as file:
            table = file.read(columns=None if names is None else list(names))
    wanted = table.column_names if names is None else names
    return {name: table.column(name).to_numpy() for name in wanted}


def series_pieces(path: Path, names: Sequence[str] | None = None) -> Iterator[dict[str, np.ndarray]]:
    """Yield the rows of a series piece by piece: the row groups of a Parquet file, blocks of about 1 MB of a CSV file.

    Only the columns ``names`` are read, by default all. Raises RunError if the file is damaged.
    """
    import pyarrow as pa

    try:
        if path.suffix == ".csv":
            import pyarrow.csv as csv

            tables = csv.open_csv(path, convert_options=_csv_types(path))
        else:
            file = open_parquet(path)
            groups = range(file.num_row_groups)
            tables = (file.read_row_group(group, columns=None if names is None else list(names)) for group in groups)
        for table in tables:
            wanted = table.schema.names if names is None else names
            yield {name: table.column(name).to_numpy(zero_copy_only=False) for name in wanted}
    except (OSError, KeyError, ValueError, TypeError, pa.ArrowException) as error:
        raise _unreadable(path, error) from None


def series_length(path: Path) -> int:
    """Number of rows of a series. Raises RunError if the file is missing or damaged."""
    import pyarrow as pa

    try:
        if path.suffix == ".csv":
            with path.open("rb") as file:
                return max(0, sum(block.count(b"\n") for block in iter(lambda: file.read(1 << 20), b"")) - 1)
        with open_parquet(path) as file:
            return file.metadata.num_rows
    except (OSError, ValueError, pa.ArrowException) as error:
        raise _unreadable(path, error) from None


def read_metadata(path: Path) -> dict[str, str]:
    """Metadata in the schema of a Parquet file; empty if the file is missing or cannot be read."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        metadata = pq.read_schema(path).metadata or {}
    except (OSError, pa.ArrowException):
        return {}
    return {key.decode(): value.decode() for key, value in metadata.items()}


_BLOCK = 1 << 20


def damaged(path: Path, reason: str) -> RunError:
    """Error for a file of rows that cannot be resumed."""
    return RunError(
        f"{path}: damaged ({reason[:120]}); nothing was deleted; run without --resume to start again from step 0"
    )


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


def write_table(path: Path, columns: Mapping[str, Sequence[Any]], metadata: Mapping[str, str]) -> None:
    """Write ``columns`` of text or numbers, of equal lengths, with ``metadata`` in the schema. Raises OSError."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    arrays, fields = [], []
    for name, values in columns.items():
        kind = pa.string() if any(isinstance(value, str) for value in values) else pa.float64()
        arrays.append(pa.array(list(values), kind))
        fields.append(pa.field(name, kind))
    table = pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=dict(metadata)))
    pq.write_table(table, path, write_page_checksum=True)
