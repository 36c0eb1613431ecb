"""Folders of sweeps as ``topcli sweep`` writes them, made without its help."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd


def write_rows(
    folder: Path,
    keys: Mapping[str, Sequence[Any]],
    measures: Mapping[str, Sequence[float]],
    *,
    outcome: Sequence[str] = (),
) -> Path:
    """Write ``rows.parquet`` into ``folder``; the folder."""
    count = len(next(iter(keys.values())))
    outcomes = list(outcome) or ["completed"] * count
    rows = pd.DataFrame({"row": range(count), **keys, "outcome": outcomes, "message": "", **measures, "digest": "0"})
    rows.attrs = {"name": folder.name, "keys": list(keys), "measures": list(measures)}
    folder.mkdir(parents=True, exist_ok=True)
    rows.to_parquet(folder / "rows.parquet", index=False)
    return folder
