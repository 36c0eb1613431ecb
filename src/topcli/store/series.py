"""Time series on disk: Parquet or CSV, written chunk by chunk, read back column by column.

Parquet columns are stored with zstd at its quick level -1 after a byte-stream split and without dictionaries: for
smooth float64 series that is both smaller and several times faster to write than the defaults, and bit-exact.
CSV numbers are the shortest that read back to the same bits.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from topcli.errors import RunError

ROW_GROUP = 131_072
"""Rows a Parquet row group: what is held in memory until written."""

FORMATS = ("parquet", "csv")

INTEGERS = ("n", "trajectory")
"""Columns of whole numbers."""
WORDS = ("outcome",)
"""Columns of text."""


def _arrow_type(name: str) -> Any:
    import pyarrow as pa

    return pa.int64() if name in INTEGERS else pa.string() if name in WORDS else pa.float64()


def arrow_table(data: Mapping[str, np.ndarray], metadata: Mapping[str, str] | None = None) -> Any:
    """A pyarrow table over the arrays (m,) of ``data``, without copying and without importing pandas."""
    import pyarrow as pa

    arrays, fields = [], []
    for name, values in data.items():
        if values.dtype.kind == "U":
            arrays.append(pa.array(values.tolist(), pa.string()))
            fields.append(pa.field(name, pa.string(), nullable=False))
            continue
        kind = pa.from_numpy_dtype(values.dtype)
        contiguous = np.ascontiguousarray(values)
        arrays.append(pa.Array.from_buffers(kind, len(contiguous), [None, pa.py_buffer(contiguous)]))
        fields.append(pa.field(name, kind, nullable=False))
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=dict(metadata or {})))


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
        "column_encoding": encodings,
        "write_statistics": ["trajectory"] if "trajectory" in names else False,  # to find one of many row groups
    }


def write_parquet(path: Path, data: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> None:
    """Write whole arrays (m,) as one Parquet file with ``metadata`` in its schema. Raises OSError."""
    import pyarrow.parquet as pq

    pq.write_table(arrow_table(data, metadata), path, **_parquet_options(data))


class SeriesWriter:
    """Write a series of the columns ``names`` in pieces to ``path``; a context manager. Raises OSError."""

    def __init__(self, path: Path, names: Sequence[str], metadata: Mapping[str, str]) -> None:
        self._path, self._names, self._metadata = path, list(names), dict(metadata)
        self._pieces: list[dict[str, np.ndarray]] = []
        self._held = 0
        self._writer: Any = None

    def __enter__(self) -> SeriesWriter:
        import pyarrow as pa

        schema = pa.schema(
            [pa.field(name, _arrow_type(name), nullable=False) for name in self._names],
            metadata=self._metadata,
        )
        if self._path.suffix == ".csv":
            import pyarrow.csv as csv

            bare = csv.WriteOptions(quoting_style="none", quoting_header="none")
            self._writer = csv.CSVWriter(str(self._path), schema, write_options=bare)
        else:
            import pyarrow.parquet as pq

            self._writer = pq.ParquetWriter(str(self._path), schema, **_parquet_options(self._names))
        return self

    def write(self, data: Mapping[str, np.ndarray]) -> None:
        """Append rows: an array (m,) for every column. The arrays may be views; they are copied."""
        self._pieces.append({name: np.array(data[name]) for name in self._names})
        self._held += len(next(iter(data.values())))
        if self._held >= ROW_GROUP:
            self._flush()

    def end_group(self) -> None:
        """Write what is held: in Parquet, a row group ends here."""
        self._flush()

    def _flush(self) -> None:
        if not self._held:
            return
        joined = {name: np.concatenate([piece[name] for piece in self._pieces]) for name in self._names}
        self._pieces, self._held = [], 0
        self._writer.write_table(arrow_table(joined, self._metadata))

    def finish(self, metadata: Mapping[str, str]) -> None:
        """Write what is held and, in Parquet, the ``metadata`` that is known only at the end."""
        self._flush()
        if hasattr(self._writer, "add_key_value_metadata"):
            self._writer.add_key_value_metadata(dict(metadata))

    def __exit__(self, *exception: object) -> None:
        if self._writer is not None:
            self._writer.close()


def read_series(path: Path, names: Sequence[str] | None = None) -> dict[str, np.ndarray]:
    """Columns of a series written here, each (m,); all of them when ``names`` is None.

    Raises RunError when the file is missing or damaged.
    """
    import pyarrow as pa

    try:
        return _read_columns(path, names)
    except (OSError, KeyError, pa.ArrowException) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise RunError(f"{path}: cannot be read ({reason[:120]}); run again with --force") from None


def _read_columns(path: Path, names: Sequence[str] | None) -> dict[str, np.ndarray]:
    if path.suffix == ".csv":
        import pyarrow.csv as csv

        with path.open(encoding="utf-8") as file:
            header = file.readline().strip().split(",")
        # the types are known: a column of whole numbers is still one of floats
        types = csv.ConvertOptions(column_types={name: _arrow_type(name) for name in header})
        table = csv.read_csv(path, convert_options=types)
    else:
        import pyarrow.parquet as pq

        table = pq.read_table(path, columns=list(names) if names is not None else None)
    wanted = table.column_names if names is None else names
    return {name: table.column(name).to_numpy() for name in wanted}


def read_metadata(path: Path) -> dict[str, str]:
    """The metadata in a Parquet file's schema; empty when there is no such file or it cannot be read."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        found = pq.read_schema(path).metadata or {}
    except (OSError, pa.ArrowException):
        return {}
    return {key.decode(): value.decode() for key, value in found.items()}
