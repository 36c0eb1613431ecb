"""Kill a run with SIGKILL at random moments, resume it, and look after every kill at what it left.

``python kills.py FOLDER KILLS SEED``. Each run is a fork of this process, so that a kill costs milliseconds and
falls anywhere: before the first checkpoint, within one, while the series is being written, while the folder is being
put in its place. Prints ``{"kills": ..., "finished": ..., "resumed": ...}``; raises AssertionError at what must not be.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import shutil
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pyarrow.csv
import pyarrow.parquet  # noqa: F401 (imported once, here, and not in every fork)

from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.engine import loop
from topcli.engine.driver import loop_of
from topcli.store import series
from topcli.store.checkpoint import read_checkpoint
from topcli.store.manifest import stored_run
from topcli.store.parts import parts_of
from topcli.studies.run import run_experiment

loop.CHUNK_STEPS = 100
series.ROW_GROUP = 350
HK = Path(__file__).resolve().parents[1] / "configs" / "kowalevski_hk.yaml"
NAME = "kowalevski_hk"


def fork(work: Callable[[], object]) -> int:
    """Start ``work`` in a process of its own; its number."""
    pid = os.fork()
    if not pid:
        try:
            work()
            os._exit(0)
        except BaseException as error:
            print(repr(error), file=sys.stderr)
            os._exit(1)
    return pid


def wait(pid: int) -> int:
    """The exit code of a process, negative for a signal."""
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def content(folder: Path) -> dict[str, str]:
    """What a run folder says, apart from times."""
    told = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.glob("series.*")}
    report = json.loads((folder / "report.json").read_text())
    del report["seconds"]
    return {**told, "report": json.dumps(report), "config": (folder / "config.yaml").read_text()}


def whole(folder: Path) -> bool:
    """Whether everything that the manifest names is there with its checksum."""
    run = stored_run(folder)
    return run is not None and not run.damage()


def reached(out: Path) -> int:
    """The furthest step that can be gone on from."""
    standing = stored_run(out / NAME)
    steps = [0]
    if standing is not None and standing.manifest["config"]["N"] == N:
        steps.append(standing.manifest["step"])
    for part in parts_of(out, NAME):
        assert not part.alive
        left, stored = read_checkpoint(part.folder), stored_run(part.folder)
        steps += [left.done] if left else []
        steps += [stored.manifest["step"]] if stored else []
    return max(steps)


N = 2000


class Scene:
    """What stands in the folder before: nothing, a different finished run, or the same run interrupted."""

    def __init__(self, base: Path, kind: str, suffix: str) -> None:
        self.kind = kind
        self.experiment: Experiment = load_experiment(HK, [f"N={N}", f"output.format={suffix}"])
        self.before, self.reference = base / f"before-{kind}-{suffix}", base / f"reference-{suffix}"
        asked = iter(range(100))
        other = load_experiment(HK, ["N=900"])
        standing: dict[str, Callable[[], object]] = {
            "nothing": lambda: self.before.mkdir(),
            "different": lambda: run_experiment(other, self.before),
            "interrupted": lambda: run_experiment(self.experiment, self.before, stop=lambda: next(asked) == 7),
        }
        loop_of(self.experiment.method(), 6, 1)
        assert wait(fork(standing[kind])) == 0
        if not self.reference.exists():
            assert wait(fork(lambda: run_experiment(self.experiment, self.reference))) == 0
        self.expected = content(self.reference / NAME)
        self.old = content(self.before / NAME) if kind == "different" else {}

    def attempt(self, out: Path) -> None:
        """Run or go on."""
        force = self.kind == "different"
        run_experiment(self.experiment, out, force=force, resume=True, checkpoint_every=0.0)

    def check(self, out: Path, before: int) -> int:
        """Look at what a kill left; the step that can be gone on from, which was ``before`` earlier."""
        target = out / NAME
        if target.exists():
            assert whole(target), "a folder in place that is not whole"
        if self.old:
            asides = [content(path) for path in out.glob(f"{NAME}*") if stored_run(path)]
            assert self.old in asides, "an earlier finished run was lost"
        now = reached(out)
        assert now >= before, f"went back from step {before} to {now}"
        return now


def main() -> None:
    """Kill so many times."""
    base, kills, seed = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    draw = random.Random(seed)
    scenes = [
        Scene(base, "nothing", "parquet"),
        Scene(base, "different", "parquet"),
        Scene(base, "interrupted", "csv"),
        Scene(base, "nothing", "csv"),
    ]
    began = time.perf_counter()
    assert wait(fork(lambda: scenes[0].attempt(base / "timed"))) == 0
    span = time.perf_counter() - began
    told = {"kills": 0, "finished": 0, "resumed": 0, "span": span}
    while told["kills"] < kills:
        scene = scenes[int(told["finished"]) % len(scenes)]
        out = base / "out"
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(scene.before, out)
        step, patience = scene.check(out, 0), 1.0
        while True:
            left = patience * span * (1.0 - 0.9 * step / N)
            pid = fork(lambda scene=scene, out=out: scene.attempt(out))
            # half of the kills are aimed at the second half of what is left, where folders change their places
            time.sleep(draw.uniform(0.0, left) if draw.random() < 0.5 else draw.uniform(0.5 * left, 1.1 * left))
            os.kill(pid, signal.SIGKILL)
            code = wait(pid)
            assert code in (0, -signal.SIGKILL), code
            if code == 0:
                break
            told["kills"] += 1
            told["resumed"] += step > 0
            earlier, step = step, scene.check(out, step)
            patience = 1.0 if step > earlier else 1.3 * patience
        assert content(out / NAME) == scene.expected, "differs from the run that was never killed"
        assert [path.name for path in out.iterdir() if path.name.startswith(".")] == [], "something was left behind"
        scene.check(out, N)
        told["finished"] += 1
    print(json.dumps(told))


if __name__ == "__main__":
    main()
