"""A small sweep of the Kowalevski top, and the table of its rows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from topcli.config.sweep import load_sweep
from topcli.sweeps.run import SweepOptions, SweepResult, run_sweep

BASE: dict[str, Any] = {
    "top": "kowalevski",
    "initial": {"omega": [0.7, -0.4, 1.3], "gamma": [0.6, 0.48, 0.64]},
    "scheme": "hk",
    "h": 0.01,
    "N": 60,
}
DATA: dict[str, Any] = {
    "name": "study",
    "base": BASE,
    "grid": {"scheme": ["hk", "rk4"], "h": [0.01, 0.02]},
    "measure": ["deviation.energy"],
}
MANY = {
    **DATA,
    "random": {"count": 40, "omega": {"sphere": 1}, "gamma": "sphere"},
    "measure": ["deviation.energy", "drift.energy", "swings"],
}


def sweep(out: Path, data: dict[str, Any] = DATA, **options: Any) -> SweepResult:
    return run_sweep(load_sweep(data), out, SweepOptions(**options))


def table(out: Path, name: str = "study") -> list[dict[str, Any]]:
    return pq.read_table(out / name / "rows.parquet").to_pylist()


def with_grid(**grid: Any) -> dict[str, Any]:
    return {**DATA, "grid": {**DATA["grid"], **grid}}


def without_origin(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{key: value for key, value in row.items() if key not in ("row", "cpu", "scheme", "h")} for row in rows]
