"""Folders of sweeps as ``topcli sweep`` writes them, made without its help."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq


def write_rows(
    folder: Path,
    keys: Mapping[str, Sequence[Any]],
    measures: Mapping[str, Sequence[float]],
    *,
    outcome: Sequence[str] | None = None,
    current: Sequence[bool] | None = None,
    log: Sequence[str] = (),
    order: Sequence[int] | None = None,
) -> Path:
    """Write ``rows.parquet`` into ``folder``, the rows in the given ``order``; the folder."""
    count = len(next(iter(keys.values())))
    columns = {
        "row": list(range(count)),
        **keys,
        "outcome": outcome or ["completed"] * count,
        "message": [""] * count,
        **measures,
        "digest": [f"{i:064x}" for i in range(count)],
        "cpu": ["a processor"] * count,
        "current": current or [True] * count,
    }
    about = {"name": folder.name, "keys": list(keys), "measures": list(measures), "log": list(log), "digest": "0" * 64}
    table = pa.table({name: pa.array(list(values)) for name, values in columns.items()})
    table = table.take(pa.array(order if order is not None else range(count)))
    folder.mkdir(parents=True, exist_ok=True)
    pq.write_table(table.replace_schema_metadata({"topcli.sweep": json.dumps(about)}), folder / "rows.parquet")
    return folder
