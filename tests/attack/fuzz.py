"""Mutated configs and sweep files: planned, and some of those accepted also run.

An accepted config must mean what another reader of YAML and TOML reads in it, must survive being written out and read
again, and its rows must be those of the scheme's step in plain Python.
"""

from __future__ import annotations

import json
import math
import random
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import ruamel.yaml
import scipy.integrate  # noqa: F401 (all of these are imported once, here, and not in every fork)

from attack.command import Said
from attack.damage import Sandbox
from attack.mutations import SWEEPS, mutant
from attack.scenes import Scenes
from attack.studies import sweep_content
from topcli.config.ensemble import EnsembleExperiment
from topcli.config.load import load, load_named
from topcli.config.models import Experiment
from topcli.contracts import Stepper
from topcli.engine.loop import plain_loop
from topcli.store.manifest import stored_run
from topcli.store.series import read_series

STEPS = 12
"""Steps of those that are run."""
MOST_RUN = 200
"""Trajectories of an ensemble that is run."""
MOST_ROWS = 60
"""Rows of a sweep that is run."""


def _flat(data: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(data, (dict, list)):
        items = data.items() if isinstance(data, dict) else enumerate(data)
        for key, value in items:
            yield from _flat(value, f"{path}.{key}")
    else:
        yield path, data


def _read_otherwise(path: Path) -> Any:
    """The data of a config by another reader; None where that one refuses."""
    try:
        text = path.read_bytes().decode("utf-8-sig")
        if path.suffix == ".toml":
            return tomllib.loads(text.replace("\r\n", "\n"))
        return ruamel.yaml.YAML(typ="safe", pure=True).load(text)
    except Exception:  # it may refuse more than topcli does
        return None


def misread(path: Path, experiment: Experiment | EnsembleExperiment) -> str:
    """A number of the config that the experiment has otherwise than another reader; empty when there is none."""
    read = dict(_flat(_read_otherwise(path)))
    for key, value in _flat(experiment.resolved()):
        other = read.get(key, value)
        numbers = all(isinstance(one, (int, float)) and not isinstance(one, bool) for one in (value, other))
        given = key.startswith((".h", ".N", ".top", ".output", ".initial.omega"))
        if given and numbers and float(other) != float(value):
            return f"{key[1:]} is {value!r} and not {other!r}"
    return ""


def read_back(experiment: Experiment | EnsembleExperiment, folder: Path) -> str:
    """Difference after the config is written out and read again; empty if there is none."""
    path = folder / "again.yaml"
    path.write_text(experiment.to_yaml(), encoding="utf-8")
    return "" if load(path).digest == experiment.digest else "read back it is another experiment"


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
    if outcome != "completed" or experiment.precision != "double":
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


def _config(draw: random.Random, box: Sandbox, path: Path) -> None:
    said = box.call("run", path.name, "--dry-run", "--out", "out", *(["--json"] if draw.random() < 0.3 else []))
    if said.code != 0 or draw.random() > 0.4:
        return
    experiment = load(path)
    for text in filter(None, (misread(path, experiment), read_back(experiment, box.folder))):
        box.fault("misread", text)
    first = experiment.first if isinstance(experiment, EnsembleExperiment) else experiment
    if getattr(experiment, "count", 1) > MOST_RUN or not math.isfinite(first.h * STEPS):
        return
    short = [f"N={STEPS}", "output.every=1"]
    said = box.call("run", path.name, "--out", "out", *(word for one in short for word in ("--set", one)))
    run = load_named(str(path), short) if said.code in (0, 1) else None
    if isinstance(run, Experiment) and (text := wrong_run(run, said, box.out)):
        box.fault("wrong rows", text)


def _sweep(box: Sandbox, path: Path) -> None:
    said = box.call("sweep", path.name, "--dry-run", "--json", "--out", "out")
    if said.code not in (0, 2):
        box.fault("exit code", f"--dry-run exits with {said.code}")
    elif said.code == 0 and (plan := json.loads(said.out))["rows"] <= MOST_ROWS:
        options = ("--out", "out", "--threads", "1", "--time-limit", "2", "--quiet")
        code = box.call("sweep", path.name, *options).code
        rows = sweep_content(box.out / plan["name"])
        if code not in (0, 1, 3):
            box.fault("exit code", f"an accepted sweep exits with {code}")
        elif isinstance(rows, str) or len(rows.rows) != plan["rows"]:
            box.fault("wrong rows", f"{plan['rows']} rows planned, then {rows if isinstance(rows, str) else 'fewer'}")


def fuzz(scenes: Scenes, draw: random.Random, box: Sandbox) -> None:
    """Plan a mutated file, and run it if it is accepted and short."""
    file, content, made_by = mutant(draw)
    box.out.mkdir()
    path = box.folder / file
    path.write_bytes(content)
    box.case.label, box.case.how, box.case.spoilt = file, made_by, content
    _sweep(box, path) if file in SWEEPS else _config(draw, box, path)
