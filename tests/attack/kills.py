"""Kill a run with SIGKILL at random moments, resume it, and look after every kill at what it left.

Each run is a fork of this process, so that a kill costs milliseconds and falls anywhere: before the first checkpoint,
within one, while the series is being written, while the folder is being put in its place. The moments cannot be
repeated; everything else follows from the seed.
"""

from __future__ import annotations

import itertools
import os
import random
import shutil
import time
from dataclasses import dataclass
from pathlib import Path

from attack.command import Running, Said, call, start
from attack.judge import Content, Faults, Finding, content, judged, wrong_content
from attack.mutations import draw_for
from attack.scenes import ENSEMBLE, NAME, STEPS, Scene, Scenes, done_in_fork, experiment
from topcli.store.checkpoint import read_checkpoint
from topcli.store.manifest import stored_run
from topcli.store.parts import parts_of
from topcli.studies.run import run_experiment


def reached(out: Path, name: str) -> int:
    """The furthest step that can be gone on from."""
    standing = stored_run(out / name)
    steps = [0]
    if standing is not None and standing.manifest["config"]["N"] == STEPS:
        steps.append(standing.manifest["step"])
    for part in parts_of(out, name):
        assert not part.alive, "the folder of a dead process counts as one of a living"
        left, stored = read_checkpoint(part.folder), stored_run(part.folder)
        steps += [left.done] if left else []
        steps += [stored.manifest.get("step", STEPS)] if stored else []
    return max(steps)


@dataclass
class Start:
    """Content of the folder before a run, the part ``old`` that must not be lost, and the run that is killed."""

    scene: Scene
    before: Path
    old: list[Content]

    @property
    def ensemble(self) -> bool:
        """True for an ensemble, which is not resumed but run again."""
        return self.scene.name == ENSEMBLE

    def options(self, step: int) -> list[str]:
        """Arguments of the command if the run can be resumed from ``step``."""
        if self.ensemble:
            return ["--force"]
        return ["--force"] if self.old and not step else ["--resume"]


def starts(scenes: Scenes) -> list[Start]:
    """All that is killed: runs beside nothing, beside a different run, and interrupted ones; ensembles."""
    base = scenes.base / "starts"
    empty, different, many = base / "empty", base / "different", base / "different-ensemble"
    empty.mkdir(parents=True)
    done_in_fork(lambda: run_experiment(experiment(steps=900), different))
    shutil.copytree(different / NAME, many / ENSEMBLE)
    parquet, csv, interrupted, ensemble = (
        next(one for one in scenes.runs if (one.kind, one.before.name.rpartition("-")[2]) == kind)
        for kind in (("finished", "parquet"), ("finished", "csv"), ("interrupted", "csv"), ("finished", "ensemble"))
    )
    old = [content(different / NAME)]
    return [
        Start(parquet, empty, []),
        Start(parquet, different, old),
        Start(interrupted, interrupted.before, []),
        Start(ensemble, empty, []),
        Start(csv, empty, []),
        Start(ensemble, many, old),
    ]


class Life:
    """A run from its first start to its end, killed on the way."""

    def __init__(self, begin: Start, folder: Path) -> None:
        self.begin, self.folder, self.out = begin, folder, folder / "out"
        self.name = begin.scene.name
        self.faults: Faults = []
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        shutil.copytree(begin.before, self.out)

    def argv(self, step: int) -> list[str]:
        """The call that runs, or goes on from ``step``."""
        frequent = ["--checkpoint-every", "0"]
        return ["run", str(self.begin.scene.config), "--out", "out", *frequent, *self.begin.options(step)]

    def start(self, step: int) -> Running:
        """Begin a call."""
        return start(self.argv(step), self.folder, [self.out, Path(os.environ["NUMBA_CACHE_DIR"])])

    def check(self, before: int) -> int:
        """Look at what a kill left; the step that can be gone on from, which was ``before`` earlier."""
        target = self.out / self.name
        if target.exists():
            content(target)  # a folder in place must be whole
        for old in self.begin.old:
            asides = [path for path in self.out.glob(f"{self.name}*") if not wrong_content(old, path)]
            assert asides, "an earlier finished run was lost"
        now = reached(self.out, self.name)
        assert now >= before, f"went back from step {before} to {now}"
        return now

    def refused(self) -> None:
        """An ensemble that was killed is not resumed, and says so."""
        said = call([*self.argv(0)[:-1], "--resume"], self.folder, [self.out])
        self.judge(said)
        assert said.code == 2, f"--resume of an ensemble exits with {said.code}"

    def judge(self, said: Said) -> None:
        """Judge what a call said, unless it was killed."""
        if said.code != -9:
            self.faults += judged(said)

    def go(self, draw: random.Random, span: float, kills: int) -> tuple[int, int]:
        """Kill up to a number of times, then let it end; return the kills and the number of resumed calls.

        ``span`` is the seconds of a whole run. Raises AssertionError and ValueError at what must not be.
        """
        step, patience, done, resumed = self.check(0), 1.0, 0, 0
        while True:
            left = patience * span * (1.0 - 0.9 * step / STEPS)
            running = self.start(step)
            if done < kills:
                # half of the kills are aimed at the second half of what is left, where folders change their places
                time.sleep(draw.uniform(0.0, left) if draw.random() < 0.5 else draw.uniform(0.5 * left, 1.1 * left))
                running.kill()
            said = running.finish()
            self.judge(said)
            assert said.code in (0, -9), f"{' '.join(said.argv)} exits with {said.code}: {said.err[:300]}"
            if said.code == 0:
                break
            done += 1
            resumed += step > 0
            self.judge(call(["list", "runs", "--out", "out"], self.folder, []))
            earlier, step = step, self.check(step)
            if self.begin.ensemble:
                self.refused()
            patience = 1.0 if step > earlier else 1.3 * patience
        wrong = wrong_content(self.begin.scene.expected, self.out / self.name)
        assert not wrong, f"differs from the run that was never killed: {wrong}"
        hidden = [path.name for path in self.out.iterdir() if path.name.startswith(".")]
        assert hidden == [], f"left behind: {hidden}"
        self.check(0)
        return done, resumed


def timed(begin: Start, folder: Path) -> float:
    """The seconds that a whole run takes."""
    life = Life(begin, folder)
    began = time.perf_counter()
    said = life.start(0).finish()
    assert said.code == 0, said.err
    return time.perf_counter() - began


def kills(scenes: Scenes, seed: int, count: int, kept: Path) -> tuple[dict[str, int], list[Finding]]:
    """Kill ``count`` times, in turn from each start; counts, and what was found."""
    begins, spans = starts(scenes), dict[int, float]()
    counts, findings = {"kills": 0, "finished": 0, "resumed": 0}, []
    for index in itertools.count():
        if counts["kills"] >= count:
            break
        kind = index % len(begins)
        spans[kind] = spans.get(kind) or timed(begins[kind], scenes.base / "timed")
        life = Life(begins[kind], scenes.base / "life")
        faults = life.faults
        try:
            done, resumed = life.go(draw_for(seed, "kills", index), spans[kind], count - counts["kills"])
            counts["kills"] += done
            counts["resumed"] += resumed
            counts["finished"] += 1
        except (AssertionError, ValueError) as error:
            counts["kills"] += 1
            faults.append(("kill", f"{life.begin.scene.kind} {life.name}: {error}"))
        if faults:
            kept.mkdir(parents=True, exist_ok=True)
            life.folder.rename(kept / f"kills-{index}")
        findings += [Finding(kind, f"kills {index}", text) for kind, text in dict.fromkeys(map(tuple, faults))]
    return counts, findings
