"""Columns of time series on disk, as Parquet or CSV: types and encodings, reading, and the rows of a picture.

Parquet columns are compressed by zstd at its fast level -1 after a byte-stream split and without dictionaries. For
smooth float64 series this is bit-exact, smaller than with the defaults, and several times faster to write. Pages carry
checksums, which are verified on every read; by default pyarrow does neither and reads a flipped bit as a number.
Numbers in CSV are the shortest that read back to the same bits.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from topcli.contracts import Array
from topcli.errors import RunError

INTEGERS = ("n", "trajectory", "left_motion")
"""Names of integer columns."""
WORDS = ("outcome",)
"""Names of text columns."""
STRETCHES = 500
"""Stretches into which a long series is divided: more than a small picture has pixels across."""
PIECE = 1 << 17
"""Rows that are read together, about."""


def _arrow_type(name: str) -> Any:
    import pyarrow as pa

    return pa.int64() if name in INTEGERS else pa.string() if name in WORDS else pa.float64()


def arrow_table(data: Mapping[str, np.ndarray]) -> Any:
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
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields))


def column_type(name: str) -> type:
    """Type in NumPy of the elements of a column."""
    return np.int64 if name in INTEGERS else object if name in WORDS else np.float64


def parquet_options(names: Iterable[str]) -> dict[str, Any]:
    """Options of pyarrow with which columns are encoded and compressed."""
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


def csv_options() -> Any:
    """Options of pyarrow for CSV without quotation marks."""
    import pyarrow.csv as csv

    return csv.WriteOptions(quoting_style="none", quoting_header="none")


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Raise RunError for a file that cannot be read within the block."""
    import pyarrow as pa

    try:
        yield
    except (OSError, KeyError, ValueError, TypeError, pa.ArrowException) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise RunError(f"{path}: cannot be read ({reason[:120]}); run again with --force") from None


def read_series(path: Path, names: Sequence[str] | None = None) -> dict[str, np.ndarray]:
    """Columns ``names`` of a series, each (m,); by default all of them.

    Raises RunError if the file is missing or damaged.
    """
    import pyarrow.csv as csv
    import pyarrow.parquet as pq

    with _readable(path):
        if path.suffix == ".csv":
            table = csv.read_csv(path, convert_options=_csv_types(path))
        else:
            with pq.ParquetFile(path, page_checksum_verification=True) as file:
                table = file.read(columns=None if names is None else list(names))
        return {name: table.column(name).to_numpy() for name in (table.column_names if names is None else names)}


def series_names(path: Path) -> list[str]:
    """Names of the columns of a series. Raises RunError if the file is missing or damaged."""
    import pyarrow.parquet as pq

    with _readable(path):
        if path.suffix == ".csv":
            with path.open(encoding="utf-8") as file:
                return file.readline().strip().split(",")
        return list(pq.read_schema(path).names)


def _csv_types(path: Path) -> Any:
    """Explicit types of the columns; without them a column of whole floats would be read as integers."""
    import pyarrow.csv as csv

    return csv.ConvertOptions(column_types={name: _arrow_type(name) for name in series_names(path)})


def series_pieces(path: Path, names: Sequence[str], rows: int) -> Iterator[Mapping[str, np.ndarray]]:
    """Yield the columns ``names`` of a series in pieces of at most ``rows`` rows; a CSV file is one piece.

    Raises RunError if the file is damaged.
    """
    import pyarrow.parquet as pq

    if path.suffix == ".csv":
        yield read_series(path, names)
        return
    with _readable(path), pq.ParquetFile(path, page_checksum_verification=True) as file:
        for batch in file.iter_batches(batch_size=rows, columns=list(names)):
            yield {name: batch.column(name).to_numpy(zero_copy_only=False) for name in names}


def read_metadata(path: Path) -> dict[str, str]:
    """Metadata in the schema of a Parquet file; empty if the file is missing or cannot be read."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        metadata = pq.read_schema(path).metadata or {}
    except (OSError, pa.ArrowException):
        return {}
    return {key.decode(): value.decode() for key, value in metadata.items()}


def envelope(path: Path, names: Sequence[str], stretches: int = STRETCHES) -> dict[str, Array]:
    """Columns ``names`` at the rows that a picture needs, in order; all rows of a short series.

    Minima and maxima of every stretch and both ends are included. Raises RunError if the series is damaged.
    """
    size = -(-len(read_series(path, names[:1])[names[0]]) // stretches)
    if size <= 2 * len(names) + 2:  # the extremes would be about as many as the rows
        return read_series(path, names)
    pieces = [_extremes(piece, size) for piece in series_pieces(path, names, size * max(1, PIECE // size))]
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in names}


def _extremes(columns: Mapping[str, Array], size: int) -> dict[str, Array]:
    """Rows with the smallest or largest number of a column in each stretch of ``size`` rows, and the ends of these."""
    rows = len(next(iter(columns.values())))
    starts = np.arange(0, rows, size)
    needed = [starts, np.minimum(starts + size, rows) - 1]
    for values in columns.values():
        for filling, extreme in ((np.inf, np.argmin), (-np.inf, np.argmax)):
            numbers = np.where(np.isnan(values), filling, values)
            padded = np.pad(numbers, (0, -rows % size), constant_values=filling)
            needed.append(np.minimum(starts + extreme(padded.reshape(-1, size), axis=1), rows - 1))
    chosen = np.unique(np.concatenate(needed))
    return {name: values[chosen] for name, values in columns.items()}
