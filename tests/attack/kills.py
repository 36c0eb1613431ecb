"""Kill runs, ensembles and sweeps at the n-th operation on the disk, call them again, and look at what each kill left.

What falls on the n-th operation is one of ``faults.HOW``: a kill before, within or after it, lost power, a full disk.
Every case follows from the seed, whatever the speed of the machine.
"""

from __future__ import annotations

import functools
import os
import random
import shutil
from dataclasses import dataclass, field
from pathlib import Path

from attack.command import Said
from attack.faults import HOW, Disk
from attack.judge import Content, content, wrong_content
from attack.sandbox import Case, Sandbox
from attack.scenes import ENSEMBLE, NAME, Scene, Scenes, done_in_fork, experiment
from attack.studies import SWEEP, SweepScene, sweep_content
from topcli.runs.run import run_experiment
from topcli.store.checkpoint import read_checkpoint
from topcli.store.manifest import stored_run
from topcli.store.parts import parts_of

KILLED = -9


def reached(out: Path, name: str, steps: int) -> int:
    """The furthest step of a run of ``steps`` steps that can be gone on from."""
    standing = stored_run(out / name)
    found = [0]
    if standing is not None and standing.manifest["config"]["N"] == steps:
        found.append(standing.manifest.get("step", steps))
    for part in parts_of(out, name):
        assert not part.alive, "the folder of a dead process counts as one of a living"
        left, stored = read_checkpoint(part.folder), stored_run(part.folder)
        found += [left.done] if left else []
        found += [stored.manifest.get("step", steps)] if stored else []
    return max(found)


@dataclass
class Start:
    """Content of the folder before a run, the part ``old`` that must not be lost, and the run that is killed."""

    scene: Scene
    before: Path
    old: list[Content] = field(default_factory=list)

    @property
    def steps(self) -> int:
        """Steps of the run."""
        return self.scene.expected.manifest["config"]["N"]

    def argv(self, step: int) -> list[str]:
        """The call that runs, or goes on from ``step``; an ensemble is not resumed but run again."""
        again = self.scene.name == ENSEMBLE or (bool(self.old) and not step)
        frequent = ["--checkpoint-every", "0", "--force" if again else "--resume"]
        return ["run", str(self.scene.config), "--out", "out", *frequent]

    def check(self, out: Path, before: int) -> int:
        """Look at what a kill left; the step that can be gone on from, which was ``before`` earlier."""
        if (out / self.scene.name).exists():
            content(out / self.scene.name)  # a folder in place must be whole
        for old in self.old:
            asides = [path for path in out.glob(f"{self.scene.name}*") if not wrong_content(old, path)]
            assert asides, "an earlier finished run was lost"
        now = reached(out, self.scene.name, self.steps)
        assert now >= before, f"went back from step {before} to {now}"
        return now

    def wrong(self, out: Path) -> str:
        """Difference of the end from that of a run that was never killed."""
        hidden = [path.name for path in out.iterdir() if path.name.startswith(".")]
        return wrong_content(self.scene.expected, out / self.scene.name) or (f"left behind: {hidden}" if hidden else "")


@dataclass
class SweepStart:
    """Content of the folder before a sweep, and the sweep that is killed."""

    scene: SweepScene
    before: Path

    def argv(self, step: int) -> list[str]:
        """The call, which also continues."""
        return ["sweep", str(self.scene.config), "--out", "out", "--threads", "1", "--json"]

    def check(self, out: Path, before: int) -> int:
        """The number of finished rows, which was ``before`` earlier; none is in the journal twice."""
        digests = self.scene.finished(out)
        assert len(digests) == len(set(digests)), "a row ran twice"
        assert len(digests) >= before, f"{before} rows were finished, and then {len(digests)}"
        return len(digests)

    def wrong(self, out: Path) -> str:
        """Difference of the end from that of a sweep that was never killed."""
        hidden = [path.name for path in (out / SWEEP).rglob(".*")]
        return self.scene.expected.differs(sweep_content(out / SWEEP)) or (f"left behind: {hidden}" if hidden else "")


Starting = Start | SweepStart


@functools.cache
def starts(scenes: Scenes) -> list[Starting]:
    """All that is killed: runs beside nothing, beside a different run, interrupted and precise ones; many; sweeps."""
    empty, different, many = (scenes.base / "starts" / name for name in ("empty", "different", "different-ensemble"))
    empty.mkdir(parents=True)
    done_in_fork(lambda: run_experiment(experiment(steps=900), different))
    shutil.copytree(different / NAME, many / ENSEMBLE)
    old = [content(different / NAME)]
    finished = (scenes.run(f"finished-{kind}") for kind in ("parquet", "csv", "ensemble", "precise", "rational"))
    parquet, csv, ensemble, *precise = finished
    interrupted = scenes.run("interrupted-csv")
    return [
        *(Start(one, empty) for one in (parquet, csv, ensemble, *precise)),
        Start(interrupted, interrupted.before),
        Start(parquet, different, old),
        Start(ensemble, many, old),
        *(SweepStart(one, one.before if one.kind == "edited-sweep" else empty) for one in scenes.sweeps),
    ]


@functools.cache
def operations(scenes: Scenes, kind: int) -> tuple[int, int]:
    """Number of operations of a call from one of the starts that nothing disturbs, and its exit code."""
    begin, box = starts(scenes)[kind], Sandbox(scenes.base / f"undisturbed-{os.getpid()}", Case(""))
    shutil.copytree(begin.before, box.out)
    disk = Disk(box.out)
    said = box.call(*begin.argv(0), prepare=disk.install)
    assert said.code in (0, 1, 3), said.err
    shutil.rmtree(box.folder)
    return len(disk.operations()), said.code


def kill(scenes: Scenes, draw: random.Random, box: Sandbox) -> None:
    """Disturb a call from one of the starts a few times, and let it end."""
    kind = draw.randrange(len(starts(scenes)))
    begin = starts(scenes)[kind]
    (span, code), step, powerless = operations(scenes, kind), begin.check(begin.before, 0), False
    shutil.copytree(begin.before, box.out)
    box.case.label = f"{begin.scene.kind} {begin.scene.name}"
    for number in range(draw.choice((1, 1, 2, 3))):
        how = draw.choice(HOW)
        disk = Disk(box.out, draw.randint(1, span if not number else span // 2 + 1), how)
        said = box.call(*begin.argv(step), prepare=disk.install)
        done = disk.operations()
        box.case.how += f"{how} {disk.at}/{span}{f' {done[-1]}' if len(done) >= disk.at else ''}; "
        if len(done) < disk.at:
            break  # it had ended before
        look(box, said, how)
        powerless |= how == "power"
        try:
            step = begin.check(box.out, 0 if powerless else step)
        except (AssertionError, ValueError) as error:
            box.fault("kill", f"{error}")
            return
    said = box.call(*begin.argv(step))
    if said.code != code:
        box.fault("kill", f"called again it exits with {said.code}: {said.err[:300]}")
    elif wrong := begin.wrong(box.out):
        box.fault("wrong rows", f"differs from the one that was never killed: {wrong}")


def look(box: Sandbox, said: Said, how: str) -> None:
    """Call the commands that look at what is left."""
    if how.startswith("full"):
        if said.code not in (0, 1, 3):
            box.fault("exit code", f"on a full disk it exits with {said.code}")
    elif said.code != KILLED:
        box.fault("kill", f"exits with {said.code}: {said.err[:300]}")
    box.call("list", "runs", "--results", "out")
    left = sorted(path for path in box.out.iterdir() if path.is_dir())
    said = box.call("verify", *(f"out/{path.name}" for path in left)) if left else said
    torn = how == "power" or "journal.jsonl: damaged: 1 damaged lines" in said.err  # an incomplete last line
    if left and said.code == 1 and not torn:
        box.fault("kill", f"verify finds damage: {said.err[:300]}")
