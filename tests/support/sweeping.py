"""A small sweep of the Kowalevski top, the table of its rows, and measures of runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from topcli.config.models import Experiment
from topcli.config.sweep import load_sweep
from topcli.contracts import Array
from topcli.sweeps.batch import Batch, Measuring, evaluate
from topcli.sweeps.measures import resolve_measures
from topcli.sweeps.run_sweep import SweepOptions, SweepResult, run_sweep

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
    "measure": ["max_deviation.energy"],
}
MANY = {
    **DATA,
    "random": {"count": 40, "omega": {"sphere": 1}, "gamma": "sphere"},
    "measure": ["max_deviation.energy", "drift.energy", "swings"],
}


def sweep(out: Path, data: dict[str, Any] = DATA, **options: Any) -> SweepResult:
    return run_sweep(load_sweep(data), out, SweepOptions(**options))


def table(out: Path, name: str = "study") -> list[dict[str, Any]]:
    return pq.read_table(out / name / "rows.parquet").to_pylist()


def with_grid(**grid: Any) -> dict[str, Any]:
    return {**DATA, "grid": {**DATA["grid"], **grid}}


class Measured(dict[str, Array]):
    """Measures of a batch of runs by name; its faults are the run, the measure and the reason."""

    batch: Batch
    faults: list[tuple[int, str, str]]


def measured(experiment: Experiment, names: Sequence[str], states: Any = None) -> Measured:
    """Measures of runs from ``states``, by default from the initial state of the experiment."""
    measures = resolve_measures(names, experiment.top, experiment.scheme, experiment.options)
    states = np.array([experiment.y0] if states is None else states)
    batch = Measuring(experiment, measures).finished(states)
    values, faults = evaluate(measures, batch)
    found = Measured(values)
    found.batch, found.faults = batch, faults
    return found
