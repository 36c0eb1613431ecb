"""The folders that are attacked: finished and unfinished runs, and a cache of machine code, small enough to copy.

Rows reach the disk in small pieces and are looked at between a few steps, so that a short run has many checkpoints.
"""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow.csv
import pyarrow.parquet  # noqa: F401 (imported once, here, and not in every fork)

from attack.command import fork
from attack.judge import Content, content
from attack.studies import SweepScene, sweep_scenes
from topcli.config.load import load, load_experiment
from topcli.config.models import Experiment
from topcli.config.text import to_yaml
from topcli.engine import run
from topcli.runs.decision import RunOptions
from topcli.runs.run import run_experiment
from topcli.store import series
from topcli.sweeps import journal, row_results
from topcli.sweeps import run as sweep_run

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
NAME = "kowalevski_hk"
ENSEMBLE = "kowalevski_ensemble"
OTHER = "beside"
"""A run that nobody harms, in every folder of runs."""
STEPS = 2000
SHORT = {
    "top": {"kind": "kowalevski", "c0": 1},
    "initial": {"omega": ["1/3", "1/5", 2], "gamma": [0.6, 0, 0.8]},
    "scheme": "hk",
    "h": 0.01,
}
PRECISE: dict[str, dict[str, object]] = {
    "precise": {"precision": 30, "N": 60},
    "rational": {"precision": "rational", "N": 5, "max_digits": 3000},
}
"""Runs in other arithmetics than double."""


def small_pieces() -> None:
    """Make chunks and row groups of this process, and of its forks, small."""
    run.CHUNK_STEPS = 100
    run.PRECISE_STEPS = 10
    series.ROW_GROUP = 350
    row_results.PER_WORKER = 12
    sweep_run.TABLE_SECONDS = 0.0
    journal.SYNC_SECONDS = 0.0


def wait(pid: int) -> int:
    """The exit code of a process, negative for a signal."""
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def done_in_fork(work: Callable[[], object]) -> None:
    """Do something in a process of its own, which must succeed."""
    code = wait(fork(lambda: int(work() is NotImplemented)))
    if code:
        raise RuntimeError(f"the attack could not be prepared: exit code {code}")


def experiment(suffix: str = "parquet", steps: int = STEPS) -> Experiment:
    """The single run that is attacked."""
    return load_experiment(CONFIGS / f"{NAME}.yaml", [f"N={steps}", f"output.format={suffix}"])


def write_configs(folder: Path) -> dict[str, Path]:
    """Write the configs of the attacked runs, which the commands are called with, by the kind of run."""
    many = load(CONFIGS / f"{ENSEMBLE}.yaml", ["N=40", "ensemble.random.count=50", "ensemble.store=trajectories"])
    texts = {suffix: experiment(suffix).to_yaml() for suffix in ("parquet", "csv")} | {"ensemble": many.to_yaml()}
    texts |= {kind: to_yaml({"name": NAME, **SHORT, **keys}) for kind, keys in PRECISE.items()}
    found = {kind: folder / kind / f"{ENSEMBLE if kind == 'ensemble' else NAME}.yaml" for kind in texts}
    for kind, path in found.items():
        path.parent.mkdir(parents=True)
        path.write_text(texts[kind], encoding="utf-8")
    return found


def killed_run(out: Path, one: Any, steps: int) -> None:
    """Leave what a process leaves that is killed after ``steps`` steps, with a checkpoint after each chunk."""

    def progress(done: int, total: int) -> None:
        if done >= steps:
            os.kill(os.getpid(), signal.SIGKILL)

    run_experiment(one, out, RunOptions(checkpoint_every=0.0, on_progress=progress))


def interrupted_run(out: Path, one: Any, chunks: int) -> None:
    """Interrupt a run after some chunks."""
    asked = iter(range(STEPS))
    run_experiment(one, out, RunOptions(stop=lambda: next(asked) == chunks))


@dataclass
class Scene:
    """A folder ``out`` of run folders as it is before the attack, and the run that its attacked one is, or becomes."""

    kind: str
    name: str
    config: Path
    before: Path
    expected: Content

    @property
    def finished(self) -> bool:
        """True if nothing is left to be done."""
        return self.kind.startswith("finished")

    def folder(self, out: Path) -> Path:
        """The attacked folder in a copy ``out`` of it."""
        hidden = list(out.glob(f".{self.name}.part-*"))
        return hidden[0] if hidden else out / self.name


@dataclass(eq=False)
class Scenes:
    """All that is attacked, under ``base``."""

    base: Path
    runs: list[Scene]
    sweeps: list[SweepScene]

    @property
    def config(self) -> Path:
        """The config of the single run."""
        return self.base / "configs" / "parquet" / f"{NAME}.yaml"

    def run(self, name: str) -> Scene:
        """The scene of a folder of runs, such as ``finished-csv``."""
        return next(one for one in self.runs if one.before.name == name)


def prepare(base: Path) -> Scenes:
    """Make everything under ``base``. Raises RuntimeError when a plain run fails already."""
    configs = base / "configs"
    os.environ["MPLCONFIGDIR"] = str(base / "matplotlib")
    other = load_experiment(CONFIGS / f"{NAME}.yaml", ["N=30", f"name={OTHER}"])
    done_in_fork(lambda: run_experiment(other, base / "beside"))
    runs = []
    for kind, config in write_configs(configs).items():
        one = load(config)
        whole = base / f"reference-{kind}"
        done_in_fork(lambda one=one, whole=whole: run_experiment(one, whole))
        expected = content(whole / one.name)
        lives: dict[str, Callable[[Path], object]] = {"finished": lambda out, one=one: run_experiment(one, out)}
        if kind in ("parquet", "csv"):
            lives |= {
                "killed": lambda out, one=one: killed_run(out, one, 1100),
                "killed-late": lambda out, one=one: killed_run(out, one, 1900),
                "interrupted": lambda out, one=one: interrupted_run(out, one, 12),
            }
        for life, make in lives.items():
            before = base / "before" / f"{life}-{kind}"
            shutil.copytree(base / "beside", before)
            wait(fork(lambda make=make, before=before: int(make(before) is NotImplemented)))
            runs.append(Scene(life, one.name, config, before, expected))
    return Scenes(base, runs, sweep_scenes(base, configs))
