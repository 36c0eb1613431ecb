"""Tables with columns of numbers or text, as Parquet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any


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
