"""Packaged scenes, random draws, runs of every kind, motions and a sweep with all measures: as they were recorded."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

import golden
import topcli
from stored_results import BASE, START
from test_golden_numbers import repeatable
from topcli.config.load import load, scene_files
from topcli.sweeps.aggregates import read_rows, sweep_table

DRAWS = {
    "sphere": {"omega": {"sphere": 2.0}, "gamma": "sphere"},
    "near": {"omega": {"near": 0.1}, "gamma": {"near": 0.2}},
    "energy": {"gamma": "sphere", "omega": {"energy": 5.0}},
}
RUNS: dict[str, dict[str, Any]] = {
    "quaternion": {"output": {"attitude": "quaternion"}},
    "angles": {"output": {"attitude": "euler-angles", "every": 7}, "scheme": "rk4"},
    "section": {"section": {"component": "gamma3", "value": 0.1}, "h": 0.05, "N": 3000},
    "quantities": {"output": {"quantities": {"a": "omega1**2 + c0*gamma1"}, "columns": ["t", "a", "energy"]}},
    "digits": {"precision": 30, "N": 40},
    "rational": {"precision": "rational", "N": 6, "top": "euler", "initial": {"omega": ["1/2", "2/5", "-3/10"]}},
    "blows up": {"scheme": "rk4", "h": 3.0, "initial": {"omega": [300, 200, 100], "gamma": [1, 0, 0]}},
    "backwards": {"scheme": "hybrid", "h": -0.02},
}
SWEEP = {
    "name": "s",
    "base": {"top": "kowalevski", "initial": START, "T": 20, "scheme": "hk"},
    "grid": {"h": [0.05, 0.02, 0.01], "scheme": ["hk", "rk4", "bohlin-a", "backlund"]},
    "random": {"count": 3, "omega": {"sphere": 1}, "seed": 4},
}


def test_scenes() -> None:
    scenes = {}
    for name, path in scene_files().items():
        experiment = load(path)
        states = experiment.ensemble.states[:3].tolist() if experiment.ensemble else list(experiment.y0)
        scenes[name] = {"config": experiment.resolved(), "digest": experiment.digest, "states": states}
    golden.check("scenes", scenes, rel=1e-15)


@pytest.mark.parametrize("law", DRAWS)
def test_draws(law: str) -> None:
    experiment = load({**BASE, "scheme": "hk", "ensemble": {"random": {"count": 40, "seed": 3, **DRAWS[law]}}})
    assert experiment.ensemble
    drawn = {"digest": experiment.digest, "states": experiment.ensemble.states.tolist()}
    golden.check(f"draws_{law}", drawn, rel=1e-14)


@pytest.mark.parametrize("kind", RUNS)
def test_runs(kind: str, tmp_path: Path) -> None:
    run = topcli.run({**BASE, "scheme": "hk", "name": "one", **RUNS[kind]}, tmp_path, progress=False)
    series = pq.read_table(run.folder / "series.parquet").to_pylist()
    files = sorted(path.name for path in run.folder.iterdir())
    manifest = json.loads((run.folder / "manifest.json").read_text())
    facts = {key: manifest.get(key) for key in ("digest", "outcome", "message", "step", "config")}
    rows = [repeatable(row) for row in (series[:1] + series[len(series) // 2 :][:1] + series[-1:])]
    repeated = repeatable(run.as_dict())
    repeated.pop("library", None)  # the version of mpmath
    data = {"files": files, "manifest": facts, "rows": rows, "count": len(series), "report": repeated}
    golden.check(f"run_{kind}", data, rel=1e-5)


@pytest.mark.parametrize(
    "scene",
    [
        "kowalevski_generic_hk",
        "kowalevski_hk",
        "kowalevski_torus",
        "euler_hk",
        "euler_tennis_racket",
        "lagrange_hk",
        "lagrange_sleeping",
        "lagrange_bs",
        "heavy_hk",
    ],
)
def test_motions(scene: str) -> None:
    golden.check(f"motion_{scene}", repeatable(topcli.motion(scene).as_dict()), rel=1e-5)


def test_sweep(tmp_path: Path) -> None:
    folder = topcli.sweep({**SWEEP, "measure": MEASURES}, tmp_path, progress=False).folder
    rows = read_rows(folder)
    table = pq.read_table(folder / "rows.parquet").to_pylist()
    data: dict[str, Any] = {"rows": [repeatable({**row, "digest": ""}) for row in table]}
    for aggregate in ("median", "mean", "max"):
        pivot = sweep_table(rows, ["scheme"], "h", ["max_error"], aggregate)
        data[aggregate] = {
            "title": pivot.heading,
            "lines": [pivot.cells().header, *pivot.cells().lines],
            "notes": [pivot.caption],
            "csv": pivot.text("csv").splitlines(),
            "latex": pivot.text("latex").splitlines(),
        }
    golden.check("sweep", data, rel=1e-5)


MEASURES = [
    "max_error",
    "final_error",
    "max_deviation.energy",
    "drift.energy",
    "swings",
    "median_swing_spacing",
    "first_swing_spacing",
    "reversal_defect",
    "max.omega1",
    "steps",
]
