"""One motion however it is computed: step by step in Python, in one piece, in many, in a batch, stopped and resumed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conftest import random_states
from resuming import after
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Outcome, Stepper, stopping_when
from topcli.engine.consumers import Memory
from topcli.engine.drive import drive, orbit
from topcli.engine.loops import interpreted
from topcli.engine.machine import Machine
from topcli.engine.rows import Plan
from topcli.runs.run import RunOptions, run_experiment
from topcli.store.series import read_series

N = 97
CASES = [
    ("kowalevski", scheme)
    for scheme in (
        "hk",
        {"name": "hk", "compensated": True},
        {"name": "hk", "project": 1},
        "taylor",
        "exact",
        "backlund",
        {"name": "backlund", "nodes": "exact"},
        "bohlin-b",
        "hk+suzuki4",
        "dop853",
    )
] + [("euler", "hk"), ("euler", "midpoint"), ("lagrange", "hk"), ("heavy", "splitting"), ("clebsch", "midpoint")]
Rows = dict[int, bytes]


def rows_of(n: Any, states: Any) -> Rows:
    return {int(k): np.asarray(y, dtype=float).tobytes() for k, y in zip(n, states, strict=True)}


def in_python(one: Experiment, tmp: Path) -> Rows:
    method, d = one.method(), len(one.top.components)
    if not isinstance(method, Stepper):
        return {}
    p = np.array(one.top.constants())
    loop = interpreted(method, d, len(p))
    work, out = np.zeros(method.width), np.empty(N * d)
    loop.enter(np.array(one.y0), work, p, one.h)
    loop.take_steps(work, out, p, one.h, N, 1, 1)
    return rows_of(range(1, N + 1), out.reshape(N, d))


def sparse(one: Experiment, tmp: Path) -> Rows:
    n, states, _ = orbit(one.top, one.method(), one.y0, one.h, N, 7)
    assert n.tolist() == list(range(0, N + 1, 7))
    return rows_of(n, states)


def stored(one: Experiment, tmp: Path, options: Callable[[], RunOptions] = RunOptions) -> Rows:
    folder = run_experiment(one, tmp, options()).stored.folder
    series = read_series(next(folder.glob("series.*")))
    assert series["n"].tolist() == list(range(N + 1))
    assert np.array_equal(series["t"], series["n"] * one.h)
    return rows_of(series["n"], np.column_stack([series[name] for name in one.top.components]))


def resumed(one: Experiment, tmp: Path) -> Rows:
    for chunks in (1, 2):
        with stopping_when(after(chunks)):
            run_experiment(one, tmp, RunOptions(checkpoint_every=0.0))
    result = run_experiment(one, tmp, RunOptions(checkpoint_every=0.0))
    assert result.status in ("continued", "up to date")
    return stored(one, tmp)


def in_a_batch(one: Experiment, tmp: Path) -> Rows:
    d = len(one.top.components)
    others = random_states(66, seed=2)[:, :d] if d <= 6 else np.tile(one.y0, (66, 1))
    others[40] = one.y0
    memory = Memory()
    run = drive(Plan(one.top, Machine(one.top, one.method()), others, one.h, N, 3), [memory])
    return rows_of(memory.n, memory.states[40]) | rows_of([N], [run.last[40]])


WAYS = {"python": in_python, "sparse": sparse, "stored": stored, "resumed": resumed, "batch": in_a_batch}


@pytest.mark.slow
@pytest.mark.usefixtures("small_chunks")
@pytest.mark.parametrize(("form", "scheme"), CASES, ids=str)
def test_same_bits(form: str, scheme: Any, tmp_path: Path) -> None:
    base = load_experiment({"kowalevski": "kowalevski_generic_hk", "clebsch": "clebsch_gentle"}.get(form, f"{form}_hk"))
    one = load_experiment({**base.resolved(), "scheme": scheme, "h": 0.03, "N": N, "name": "one", "output": {}})
    n, states, ending = orbit(one.top, one.method(), one.y0, one.h, N)
    whole = rows_of(n, states)
    assert len(whole) == N + 1
    assert ending.outcome is Outcome.COMPLETED
    for name, way in WAYS.items():
        found = way(one, tmp_path / name)
        assert {k: v for k, v in found.items() if whole[k] != v} == {}, name
        assert found or name == "python"
