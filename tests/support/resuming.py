"""Small runs that are cut short, for the tests of ``--resume``."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from conftest import ROOT
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.runs.decision import RunOptions
from topcli.runs.run import run_experiment

HK = ROOT / "configs" / "kowalevski_hk.yaml"
NAME = "kowalevski_hk"
FILES = ["config.yaml", "manifest.json", "report.json", "report.md"]


def small(*overrides: str) -> Experiment:
    return load_experiment(HK, ["N=300", *overrides])


def after(chunks: int) -> Callable[[], bool]:
    """A ``stop`` that returns True after a number of chunks."""
    asked = iter(range(10**6))
    return lambda: next(asked) >= chunks


def content(folder: Path) -> dict[str, object]:
    """Everything a run folder says apart from times."""
    report = json.loads((folder / "report.json").read_text())
    del report["seconds"]
    (path,) = folder.glob("series.*")
    manifest = json.loads((folder / "manifest.json").read_text())
    fields = {key: manifest[key] for key in ("digest", "code", "outcome", "message", "files", "config", "environment")}
    fields["files"] = sorted(fields["files"])
    return {"report": report, "series": path.read_bytes(), "config": (folder / "config.yaml").read_text(), **fields}


def killed(out: Path, experiment: Experiment, chunks: int) -> Path:
    """Folder left by a process killed after a number of chunks, with a checkpoint after each."""

    class Killed(BaseException):
        pass

    def progress(done: int, total: int) -> None:
        if chunks <= done // 23:
            raise Killed

    with pytest.raises(Killed):
        run_experiment(experiment, out, RunOptions(force=True, checkpoint_every=0.0, on_progress=progress))
    (folder,) = out.glob(f".{experiment.name}.part-*")
    return folder
