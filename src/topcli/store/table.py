"""Whole tables with columns of text, as Parquet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from topcli.errors import RunError


def write_table(path: Path, columns: Mapping[str, Sequence[Any]], metadata: Mapping[str, str]) -> None:
    """Write ``columns`` of text or numbers, equally long, with ``metadata`` in the schema. Raises OSError."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    arrays, fields = [], []
    for name, values in columns.items():
        kind = pa.string() if any(isinstance(value, str) for value in values) else pa.float64()
        arrays.append(pa.array(list(values), kind))
        fields.append(pa.field(name, kind))
    pq.write_table(pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=dict(metadata))), path)


def read_table(path: Path) -> dict[str, list[Any]]:
    """The columns of a table written here. Raises RunError when the file is missing or damaged."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        return pq.read_table(path).to_pydict()
    except (OSError, pa.ArrowException) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise RunError(f"{path}: cannot be read ({reason[:120]})") from None
