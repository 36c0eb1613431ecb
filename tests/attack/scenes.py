"""The folders that are attacked: finished and unfinished runs, and a cache of machine code, small enough to copy.

Rows reach the disk in small pieces and are looked at between a few steps, so that a short run has many checkpoints.
"""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pyarrow.csv
import pyarrow.parquet  # noqa: F401 (imported once, here, and not in every fork)

from attack.command import Said, call, fork
from attack.judge import Content, content, judged
from attack.studies import SweepScene, sweep_scenes
from topcli.config.load import load, load_experiment
from topcli.config.models import Experiment
from topcli.config.text import to_yaml
from topcli.engine import run
from topcli.runs.decision import RunOptions
from topcli.runs.run import run_experiment
from topcli.store import series
from topcli.sweeps import evaluate, journal
from topcli.sweeps import run as sweep_run

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
NAME = "kowalevski_hk"
ENSEMBLE = "kowalevski_ensemble"
OTHER = "beside"
"""A run that nobody harms, in every folder of runs."""
STEPS = 2000
COMPILED = ("hk", "rk2", "bohlin-a", "ensemble")
"""Content of the cache of machine code: three schemes of single runs, and one of ensembles."""
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
    evaluate.PER_WORKER = 12
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


def write_configs(folder: Path) -> None:
    """Write the configs of the attacked runs, which the commands are called with."""
    for suffix in ("parquet", "csv"):
        (folder / suffix).mkdir(parents=True)
        (folder / suffix / f"{NAME}.yaml").write_text(experiment(suffix).to_yaml(), encoding="utf-8")
    many = load(CONFIGS / f"{ENSEMBLE}.yaml", ["N=40", "ensemble.random.count=50", "ensemble.store=trajectories"])
    (folder / f"{ENSEMBLE}.yaml").write_text(many.to_yaml(), encoding="utf-8")


def killed_run(out: Path, suffix: str, steps: int) -> None:
    """Leave what a process leaves that is killed after ``steps`` steps, with a checkpoint after each chunk."""

    def progress(done: int, total: int) -> None:
        if done >= steps:
            os.kill(os.getpid(), signal.SIGKILL)

    run_experiment(experiment(suffix), out, RunOptions(checkpoint_every=0.0, on_progress=progress))


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


@dataclass
class Scenes:
    """All that is attacked, under ``base``."""

    base: Path
    runs: list[Scene]
    sweeps: list[SweepScene]
    _codes: dict[str, Path] = field(default_factory=dict)

    @property
    def cache(self) -> Path:
        """A folder of machine code."""
        return self.base / "cache"

    def code(self, scheme: str) -> Path:
        """The file of the machine code of one of ``COMPILED``, within ``cache``; made when it is first asked for."""
        if scheme not in self._codes:
            import numba  # noqa: F401 (recompiling is the larger part of what a damaged cache costs)

            known = set(self.cache.rglob("*.o"))
            config = f"{ENSEMBLE}.yaml" if scheme == "ensemble" else f"parquet/{NAME}.yaml"
            change = [] if scheme == "ensemble" else ["--set", f"scheme={scheme}"]
            argv = ["run", str(self.base / "configs" / config), "--out", str(self.base / f"warm-{scheme}"), *change]
            must_be_fine(call(argv, self.base, [self.base], {"NUMBA_CACHE_DIR": str(self.cache)}, limit=300.0))
            made = max(set(self.cache.rglob("*.o")) - known, key=lambda path: path.stat().st_size)
            self._codes[scheme] = made.relative_to(self.cache)
        return self._codes[scheme]


def prepare(base: Path) -> Scenes:
    """Make everything under ``base``. Raises RuntimeError when a plain run fails already."""
    configs = base / "configs"
    write_configs(configs)
    os.environ["MPLCONFIGDIR"] = str(base / "matplotlib")
    reference: dict[str, Content] = {}
    runs = []
    for suffix in ("parquet", "csv"):
        whole = base / f"reference-{suffix}"
        done_in_fork(lambda suffix=suffix, whole=whole: run_experiment(experiment(suffix), whole))
        reference[suffix] = content(whole / NAME)
    many = load(configs / f"{ENSEMBLE}.yaml")
    done_in_fork(lambda: run_experiment(many, base / "reference-ensemble"))  # pyright: ignore[reportArgumentType]
    other = load_experiment(CONFIGS / f"{NAME}.yaml", ["N=30", f"name={OTHER}"])
    done_in_fork(lambda: run_experiment(other, base / "beside"))
    reference["ensemble"] = content(base / "reference-ensemble" / ENSEMBLE)

    def scene(kind: str, suffix: str, make: Callable[[Path], object]) -> None:
        before = base / "before" / f"{kind}-{suffix}"
        shutil.copytree(base / "beside", before)
        wait(fork(lambda: int(make(before) is NotImplemented)))
        name = ENSEMBLE if suffix == "ensemble" else NAME
        config = configs / (f"{ENSEMBLE}.yaml" if suffix == "ensemble" else f"{suffix}/{NAME}.yaml")
        runs.append(Scene(kind, name, config, before, reference[suffix]))

    for suffix in ("parquet", "csv"):
        asked = iter(range(STEPS))
        one = experiment(suffix)
        scene("finished", suffix, lambda out, one=one: run_experiment(one, out))
        scene("killed", suffix, lambda out, suffix=suffix: killed_run(out, suffix, 1100))
        scene("killed-late", suffix, lambda out, suffix=suffix: killed_run(out, suffix, 1900))
        scene(
            "interrupted",
            suffix,
            lambda out, one=one, asked=asked: run_experiment(one, out, RunOptions(stop=lambda: next(asked) == 12)),
        )
    scene("finished", "ensemble", lambda out: run_experiment(many, out))  # pyright: ignore[reportArgumentType]
    for kind, keys in PRECISE.items():
        path = configs / kind / f"{NAME}.yaml"
        path.parent.mkdir()
        data = {"name": NAME, **SHORT, **keys}
        path.write_text(to_yaml(data), encoding="utf-8")
        one = load(path)
        done_in_fork(lambda one=one, kind=kind: run_experiment(one, base / f"reference-{kind}"))  # pyright: ignore[reportArgumentType]
        reference[kind] = content(base / f"reference-{kind}" / NAME)
        scene("finished", kind, lambda out, one=one: run_experiment(one, out))  # pyright: ignore[reportArgumentType]
    return Scenes(base, runs, sweep_scenes(base, configs))


def must_be_fine(said: Said) -> None:
    """Raise RuntimeError unless a call of the preparation went well."""
    if said.code or judged(said):
        raise RuntimeError(f"the attack could not be prepared: {' '.join(said.argv)}: {said.code} {said.err}")
