"""Small stored results of every kind, for the tests of pages."""

from __future__ import annotations

from pathlib import Path

import topcli
from topcli.config.load import load, load_experiment
from topcli.config.models import Experiment
from topcli.config.sweep import load_sweep
from topcli.runs.run import run_experiment
from topcli.sweeps.run_sweep import SweepOptions, run_sweep

START = {"omega": [2, 0, 0], "gamma": ["auto", 0, 0.1]}
BASE = {"top": "kowalevski", "initial": START, "h": 0.01, "N": 400}


def experiment(name: str, scheme: str = "hk", **changes: object) -> Experiment:
    return load_experiment({**BASE, "name": name, "scheme": scheme, **changes})


def store_run(out: Path, name: str, scheme: str = "hk", **changes: object) -> Path:
    """Run folder of the Kowalevski top near its homoclinic orbit."""
    return run_experiment(experiment(name, scheme, **changes), out).stored.folder


def store_ensemble(out: Path, name: str = "many", count: int = 12) -> Path:
    loaded = load({**BASE, "name": name, "scheme": "hk", "ensemble": {"random": {"count": count, "gamma": "sphere"}}})
    return run_experiment(loaded, out).stored.folder


def store_sweep(out: Path, name: str = "sweep") -> Path:
    base = {key: value for key, value in BASE.items() if key not in ("h", "N")} | {"scheme": "hk", "T": 4}
    grid = {"h": [0.04, 0.02, 0.01], "scheme": ["hk", "rk4"]}
    study = load_sweep({"name": name, "base": base, "grid": grid, "measure": ["max_deviation.energy", "max_error"]}, ())
    return run_sweep(study, out, SweepOptions()).folder


def store_comparison(path: Path) -> Path:
    topcli.compare("hk", "hk:h=0.02", "hybrid", config={**BASE, "name": "compared", "scheme": "hk"}).save(path)
    return path
