"""The folder of a run: its files, and what they say of the run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from resuming import FILES, small
from topcli.config.load import load_experiment
from topcli.runs.run import run_experiment
from topcli.store.series import read_metadata, read_series


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_a_run_folder_is_complete(tmp_path: Path, suffix: str) -> None:
    experiment = small(f"output.format={suffix}")
    result = run_experiment(experiment, tmp_path)
    assert sorted(p.name for p in result.stored.folder.iterdir()) == sorted([*FILES, f"series.{suffix}"])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["kowalevski_hk"]
    assert load_experiment(result.stored.folder / "config.yaml").digest == experiment.digest
    manifest = json.loads((result.stored.folder / "manifest.json").read_text())
    assert manifest["digest"] == experiment.digest
    assert {"topcli", "python", "numpy", "numba", "platform", "cpu"} <= set(manifest["environment"])
    assert manifest["outcome"] == "completed"
    assert manifest["started"] <= manifest["ended"]
    data = read_series(result.stored.series)
    assert len(data["t"]) == 301
    assert (data["t"] == data["n"] * 1e-3).all()
    assert (data["k_sq"][0], data["gamma3"][0]) == (result.report["invariants"][3]["first"], 1e-3)
    if suffix == "parquet":
        about = read_metadata(result.stored.series)
        assert json.loads(about["topcli.config"]) == experiment.resolved()
        assert about["topcli.digest"] == experiment.digest
