"""Mutated configs, in processes that try them one after another: planned, and some of those accepted also run.

An accepted config must mean what another reader of YAML and TOML reads in it, must survive being written out and read
again, and its rows must be those of the scheme's step in plain Python.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import signal
import tempfile
import time
import tomllib
import traceback
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import ruamel.yaml
import scipy.integrate  # noqa: F401 (all of these are imported once, here, and not in every process)
import typer.main

from attack.command import HEED, LIMIT, Said, Watch, content_of, fork, in_process, redirect
from attack.judge import Faults, Finding, judged
from attack.mutations import Mutant, draw_for, mutant
from topcli.config.ensemble import EnsembleExperiment
from topcli.config.load import load, load_named
from topcli.config.models import Experiment
from topcli.contracts import Stepper
from topcli.engine.loop import plain_loop
from topcli.runs import ensemble, run  # noqa: F401 (imported here like those above)
from topcli.store.manifest import stored_run
from topcli.store.series import read_series

BATCH = 250
"""Configs that one process tries."""
STEPS = 12
"""Steps of those that are run."""
MOST_RUN = 200
"""Trajectories of an ensemble that is run."""


def _flat(data: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(data, (dict, list)):
        items = data.items() if isinstance(data, dict) else enumerate(data)
        for key, value in items:
            yield from _flat(value, f"{path}.{key}")
    else:
        yield path, data


def _read_otherwise(file: str, text: bytes) -> Any:
    """The data of a config by another reader; None where that one refuses."""
    try:
        if file.endswith(".toml"):
            return tomllib.loads(text.decode("utf-8-sig").replace("\r\n", "\n"))
        return ruamel.yaml.YAML(typ="safe", pure=True).load(text.decode("utf-8-sig"))
    except Exception:  # it may refuse more than topcli does
        return None


def misread(case: Mutant, experiment: Experiment | EnsembleExperiment) -> str:
    """A number of the config that the experiment has otherwise than another reader; empty when there is none."""
    read = dict(_flat(_read_otherwise(case.file, case.content)))
    for path, value in _flat(experiment.resolved()):
        other = read.get(path, value)
        numbers = all(isinstance(one, (int, float)) and not isinstance(one, bool) for one in (value, other))
        if (
            path.startswith((".h", ".N", ".top", ".output", ".initial.omega"))
            and numbers
            and float(other) != float(value)
        ):
            return f"{path[1:]} is {value!r} and not {other!r}"
    return ""


def read_back(experiment: Experiment | EnsembleExperiment, folder: Path) -> str:
    """Difference after the config is written out and read again; empty if there is none."""
    path = folder / "again.yaml"
    path.write_text(experiment.to_yaml(), encoding="utf-8")
    again = load(path)
    return "" if again.digest == experiment.digest else "read back it is another experiment"


def wrong_run(experiment: Experiment, said: Said, out: Path) -> str:
    """Fault of the folder of a short run; empty if there is none."""
    stored = stored_run(out / experiment.name)
    if stored is None:
        return "" if said.code else "it exited with 0 and there is no run folder"
    outcome, rows = stored.manifest["outcome"], read_series(stored.series)
    if (outcome == "completed") != (said.code == 0):
        return f"outcome {outcome}, exit code {said.code}"
    method, top = experiment.method(), experiment.top
    names = [name for name in top.components if name in rows]
    if "n" in rows and outcome == "completed" and rows["n"].tolist() != list(range(STEPS + 1)):
        return f"recorded the steps {rows['n'].tolist()[:20]}"
    if any(rows[name][0] != experiment.y0[top.components.index(name)] for name in names):
        return "the first row is not the initial state"
    if outcome != "completed":
        return ""
    if not isinstance(method, Stepper):
        return next((f"{name} is not finite" for name in names if not np.isfinite(rows[name]).all()), "")
    p, d = np.array(top.constants()), len(top.components)
    enter, drive = plain_loop(method, d, len(p))
    work, found = np.zeros(method.width), np.empty(STEPS * d)
    with np.errstate(all="ignore"):
        enter(np.array(experiment.y0), work, p, experiment.h)
        if drive(work.tolist(), found, p.tolist(), experiment.h, STEPS, 1, 1) != STEPS:
            return "the step in plain Python fails"
    plain = found.reshape(STEPS, d)
    for name in names:
        other = plain[:, top.components.index(name)]
        if rows[name][1:].tobytes() != other.tobytes():
            step = int(np.argmax(rows[name][1:] != other)) + 1
            return f"{name} is {rows[name][step]!r} at step {step}, in plain Python {other[step - 1]!r}"
    return ""


class Trier:
    """Tries one config after another in this process, with ``folder`` to work in."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.folder, self.seed = folder, seed
        self.streams = (tempfile.TemporaryFile(), tempfile.TemporaryFile())  # noqa: SIM115 (for the whole process)
        redirect(*self.streams)
        self.touched: list[str] = []
        self.watch = Watch(self.touched.append)
        typer.main.get_command = cache(typer.main.get_command)  # the commands are built once and not for every call

    def say(self, argv: list[str]) -> Said:
        """Call the command in this process."""
        for stream in self.streams:
            stream.seek(0)
            stream.truncate()
        self.touched.clear()
        began = time.monotonic()
        with self.watch.over([self.folder / "out", Path(os.environ["NUMBA_CACHE_DIR"])]):
            code = in_process(argv)
        slow = time.monotonic() - began > LIMIT
        out, err = (content_of(stream) for stream in self.streams)
        return Said(tuple(argv), code, out, err, tuple(self.touched), slow)

    def attempt(self, index: int) -> tuple[bool, Faults]:
        """Try config ``index``: True if it was accepted, and the faults."""
        case, draw = mutant(self.seed, index), draw_for(self.seed, "how", index)
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir()
        os.chdir(self.folder)
        Path(case.file).write_bytes(case.content)
        said = self.say(["run", case.file, "--dry-run", "--out", "out", *(["--json"] if draw.random() < 0.3 else [])])
        faults, checked = judged(said), draw.random() < 0.4
        if said.code == 0 and checked:
            experiment = load(case.file)
            faults += [("misread", text) for text in [misread(case, experiment)] if text]
            faults += [("misread", text) for text in [read_back(experiment, self.folder)] if text]
            if getattr(experiment, "count", 1) <= MOST_RUN and math.isfinite(step_size(experiment) * STEPS):
                faults += self.run(case)
        return said.code == 0, faults

    def run(self, case: Mutant) -> Faults:
        """Run a config over few steps."""
        short = [f"N={STEPS}", "output.every=1"]
        said = self.say(["run", case.file, "--out", "out", *(word for one in short for word in ("--set", one))])
        faults = judged(said)
        if not faults and said.code in (0, 1):
            experiment = load_named(case.file, short)
            if isinstance(experiment, Experiment):
                faults += [("wrong rows", text) for text in [wrong_run(experiment, said, Path("out"))] if text]
        return faults


def step_size(experiment: Experiment | EnsembleExperiment) -> float:
    """The h of an experiment or an ensemble."""
    return (experiment.first if isinstance(experiment, EnsembleExperiment) else experiment).h


@dataclass
class Batch:
    """Configs that a process tries; it writes a line before and after each into ``log``."""

    indices: list[int]
    log: Path
    pid: int = 0
    seen: int = 0
    since: float = 0.0
    asked: bool = False

    def begin(self, folder: Path, seed: int) -> None:
        """Start the process."""

        def work() -> int:
            log = self.log.open("w", buffering=1, encoding="utf-8")
            trier = Trier(folder, seed)
            for index in self.indices:
                log.write(f"{index}\n")
                try:
                    accepted, faults = trier.attempt(index)
                except Exception as error:  # of this harness, or of a function of topcli that it calls itself
                    where = traceback.extract_tb(error.__traceback__)[-1]
                    seen = f"{type(error).__name__} {error} at {where.filename}:{where.lineno}"
                    accepted, faults = False, [("exception", seen)]
                log.write(json.dumps([accepted, faults]) + "\n")
            return 0

        self.log.write_text("")
        self.seen, self.since, self.asked = 0, time.monotonic(), False
        self.pid = fork(work)

    def ended(self) -> str | None:
        """None while it works; else how it ended, empty for well.

        A hanging process is asked to end by SIGTERM, which a run heeds and after which the others are tried,
        and is killed when it does not.
        """
        pid, status = os.waitpid(self.pid, os.WNOHANG)
        if pid:
            code = os.waitstatus_to_exitcode(status)
            if self.asked and code == -signal.SIGTERM:
                return "hang"
            return signal.Signals(-code).name if code < 0 else f"exit code {code}" if code else ""
        if (size := self.log.stat().st_size) != self.seen:
            self.seen, self.since, self.asked = size, time.monotonic(), False
        elif not self.asked and time.monotonic() - self.since > LIMIT + 1.0:
            os.kill(self.pid, signal.SIGTERM)
            self.asked = True
        elif time.monotonic() - self.since > LIMIT + 1.0 + HEED:
            os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)
            return "hang"
        return None

    def results(self) -> list[tuple[int, bool, Faults]]:
        """The results so far: index, whether accepted, faults."""
        lines = self.log.read_text(encoding="utf-8").splitlines()
        pairs = zip(lines[::2], lines[1::2], strict=False)
        return [(int(index), *json.loads(result)) for index, result in pairs]


def fuzz(seed: int, indices: list[int], base: Path, kept: Path, workers: int) -> tuple[dict[str, int], list[Finding]]:
    """Try the configs ``indices``; counts, and what was found. Configs that show something are left in ``kept``."""
    base.mkdir(parents=True)
    waiting = [indices[i : i + BATCH] for i in range(0, len(indices), BATCH)][::-1]
    free, running = [base / f"work-{i}" for i in range(workers)], {}
    counts, findings = {"configs": 0, "accepted": 0}, []
    while waiting or running:
        while waiting and free:
            folder = free.pop()
            batch = Batch(waiting.pop(), folder.with_suffix(".log"))
            batch.begin(folder, seed)
            running[folder] = batch
        for folder, batch in list(running.items()):
            how = batch.ended()
            if how is None:
                continue
            del running[folder]
            free.append(folder)
            done = batch.results()
            for index, accepted, faults in done:
                counts["configs"] += 1
                counts["accepted"] += accepted
                findings += [Finding(kind, f"fuzz {index}", text) for kind, text in faults]
            if how:
                died, *rest = batch.indices[len(done) :]
                counts["configs"] += 1
                kind = how if how == "hang" else "signal" if how.startswith("SIG") else "harness"
                findings.append(Finding(kind, f"fuzz {died}", f"{how} while it was tried"))
                if rest:
                    waiting.append(rest)
        time.sleep(0.01)
    for index in sorted({int(finding.case.split()[1]) for finding in findings}):
        keep(mutant(seed, index), kept, index, [f for f in findings if f.case == f"fuzz {index}"])
    return counts, findings


def keep(case: Mutant, folder: Path, index: int, findings: list[Finding]) -> None:
    """Keep a config that shows something, with what it shows."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"fuzz-{index}-{case.file}").write_bytes(case.content)
    about = {"made by": case.made_by, "findings": [asdict(finding) for finding in findings]}
    (folder / f"fuzz-{index}.json").write_text(json.dumps(about, indent=1), encoding="utf-8")
