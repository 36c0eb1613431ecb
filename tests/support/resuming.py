"""Small runs that are stopped or killed on their way."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from conftest import ROOT
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import stopping_when
from topcli.runs.run import RunOptions, RunResult, run_experiment
from topcli.store.files import SEAL

HK = ROOT / "configs" / "kowalevski_hk.yaml"
NAME = "kowalevski_hk"
FILES = ["config.yaml", "manifest.json", "report.json"]
TIMES = (SEAL, "started", "ended", "continued", "seconds", "files")
"""Entries of a manifest that differ from run to run."""


class Killed(BaseException):
    """The end of a process, which nothing catches."""


def small(*overrides: str) -> Experiment:
    return load_experiment(HK, ["N=300", *overrides])


def life(experiment: Experiment, out: Path, chunks: int = 10**9, kill: bool = False) -> RunResult:
    """Run until ``chunks`` chunks are done, with a checkpoint after each; then stop, or raise Killed."""
    done = [0]

    def on_progress(steps: int, total: int) -> None:
        done[0] += 1
        if kill and done[0] >= chunks:
            raise Killed

    with stopping_when(lambda: not kill and done[0] >= chunks):
        return run_experiment(experiment, out, RunOptions(checkpoint_every=0.0, on_progress=on_progress))


def after(chunks: int) -> Callable[[], bool]:
    """A ``stop`` that returns True after being asked a number of times."""
    asked = iter(range(10**6))
    return lambda: next(asked) >= chunks


def killed(out: Path, experiment: Experiment, chunks: int = 3) -> Path:
    """Folder left by a process killed after a number of chunks, with a checkpoint after each."""
    with pytest.raises(Killed):
        life(experiment, out, chunks, kill=True)
    return out / experiment.name


def content(folder: Path) -> dict[str, Any]:
    """Everything that a folder says apart from times: bytes of files, the report and the manifest."""
    files: dict[str, Any] = {path.name: path.read_bytes() for path in folder.iterdir()}
    report, manifest = json.loads(files["report.json"]), json.loads(files["manifest.json"])
    names = sorted(manifest["files"])
    manifest = {key: value for key, value in manifest.items() if key not in TIMES}
    return {**files, "report.json": {**report, "seconds": None}, "manifest.json": manifest, "listed": names}
