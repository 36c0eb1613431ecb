"""The life of a run: however often it is stopped, killed and run again, its files are those of an uninterrupted one."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pyarrow.parquet as pq
import pytest

from conftest import Said
from custom_tops import VOLTERRA
from resuming import Killed, after, content, killed, life
from topcli.config.load import load
from topcli.contracts import Outcome, stopping_when
from topcli.runs import plans, run
from topcli.runs.run import RunOptions, run_experiment
from topcli.store.results import intact_result

pytestmark = pytest.mark.usefixtures("small_chunks")

START = {"omega": [0.7, -0.4, 1.3], "gamma": [0.6, 0.48, 0.64]}
BASE = {"name": "life", "top": "kowalevski", "initial": START, "scheme": "hk", "h": 0.02, "N": 120}
MANY = {"count": 70, "seed": 3, "gamma": "sphere", "omega": {"near": 0.3}}
SECTION = {"section": {"component": "gamma2", "direction": "both"}, "N": 600}
QUANTITIES = {"quantities": {"spin": "sqrt(omega1**2 + omega3**2)", "phase": "omega3*t + c0*h"}}
FAILING = {"states": [{"omega": [1e200 if i % 4 == 1 else 0.5, 0, 1]} for i in range(40)]}
EULER = {"top": "euler", "initial": {"omega": [0.4, 1.0, 0.3]}}


def many(store: str = "trajectories", **changes: Any) -> dict[str, Any]:
    return {"ensemble": {"random": MANY, "store": store}, "output": {"every": 5}, **changes}


CASES: dict[str, dict[str, Any]] = {
    "single": {},
    "backwards": {"scheme": "hybrid", "h": -0.02},
    "iterative with counters": {"scheme": "hybrid-sym"},
    "thinned, with a tail": {"N": 405, "output": {"every": 7}},
    "csv": {"output": {"format": "csv", "columns": ["t", "k_sq"]}},
    "quantities": {"output": QUANTITIES},
    "attitude": {"N": 240, "output": {"attitude": "quaternion", "every": 3}},
    "attitude of a series": {"scheme": "taylor", "N": 40, "output": {"attitude": "euler-angles"}},
    "exact": {**EULER, "scheme": "exact"},
    "interpreted": {"scheme": "dop853", "N": 70},
    "modified integrals": EULER,
    "failing": {"scheme": "rk2", "h": 0.2, "initial": {**START, "omega": [3.0, 2.0, 1.0]}},
    "off its energy surface": {"h": 2.0, "N": 300},
    "section": SECTION | {"output": QUANTITIES},
    "ensemble": many(),
    "ensemble in csv": many(output={"every": 5, "format": "csv", **QUANTITIES}),
    "last states": many("final", N=123),
    "statistics": many("statistics"),
    "ensemble with a section": {**many(), **SECTION, "output": QUANTITIES},
    "ensemble with failures": many(scheme="rk2", ensemble={"states": FAILING["states"]}),
    "grid of parameters": many(ensemble={"grid": {"top.c0": [0.5, 1.0, 2.0], "omega1": [0.1, 0.2, 0.3]}}),
    "one by one": many(ensemble={"random": {**MANY, "count": 5}}, scheme="dop853", N=20),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_any_lives_end_with_the_same_files(case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stopped after its first chunk, killed and stopped on the way; what it leaves when stopped can be read."""
    monkeypatch.setattr(plans, "plans", lambda experiment, block=32, cut=plans.plans: cut(experiment, block))
    monkeypatch.setattr(run, "plans", plans.plans)
    experiment, chunks = load({**BASE, **CASES[case]}), list[tuple[int, ...]]()
    whole = run_experiment(experiment, tmp_path / "whole", RunOptions(on_progress=lambda *steps: chunks.append(steps)))
    expected, result = content(whole.stored.folder), None
    assert len(chunks) >= 3
    assert chunks == sorted(chunks)
    third = max(2, len(chunks) // 3)
    for number, (until, kill) in enumerate([(1, False), (third, True), (third, False), (2, True), (10**9, False)]):
        if result and result.stored.complete:
            break
        with contextlib.suppress(Killed):
            result = life(experiment, tmp_path, until, kill)
            assert intact_result(tmp_path / "life").outcome is result.outcome
            assert result.status == ("continued" if number else "ran")
    assert content(tmp_path / "life") == expected
    assert life(experiment, tmp_path).status == "up to date"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["life", "whole"]


def test_checkpoints_wait_for_their_time_and_a_hundred_times_their_cost(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every 10 s, the first after half of that: one that takes 0.05 s delays none, one of 0.2 s the next to 20 s."""
    now, costs, saved = [0.0], iter([0.05, 0.2, 0.0]), list[float]()
    monkeypatch.setattr("topcli.runs.run.time", SimpleNamespace(monotonic=lambda: now[0]))

    def store(state: Any) -> None:
        saved.append(now[0])
        now[0] += next(costs)

    folder: Any = SimpleNamespace(save=store)
    save = run.Checkpoints(folder, RunOptions(checkpoint_every=10.0))
    chunk: Any = SimpleNamespace(run=SimpleNamespace(plan=SimpleNamespace(precise=None)), stopping=False, state=dict)
    for now[0] in (4.9, 5.0, 15.0, 15.1, 35.2, 35.4):
        save(0, chunk)
    assert saved == [5.0, 15.1, 35.4]


@pytest.mark.slow
@pytest.mark.parametrize("threads", [1, 2])
def test_an_ensemble_may_be_stopped_at_any_call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, threads: int) -> None:
    """Also while a trajectory that fails is computed alone, and while another thread ends a later tile."""
    changes = {
        "scheme": "rk2",
        "h": 0.2,
        "ensemble": {"random": {**MANY, "omega": {"near": 3.0}}, "store": "trajectories"},
    }
    experiment = load({**BASE, **many(), **changes})
    expected = content(run_experiment(experiment, tmp_path / "whole").stored.folder)
    monkeypatch.setattr("topcli.engine.integration.CALL_SECONDS", 0.0)
    for asked in (0, 1, 2, 5, 11, 17, 30, 50, 70, 90, 110):
        with stopping_when(after(asked)):
            run_experiment(experiment, tmp_path, RunOptions(threads=threads))
    run_experiment(experiment, tmp_path)
    assert content(tmp_path / "life") == expected


def test_other_precisions_begin_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("topcli.engine.integration.CALL_SECONDS", 0.0)
    experiment = load({**BASE, "precision": 30, "N": 12})
    assert life(experiment, tmp_path, 1).outcome is Outcome.INTERRUPTED
    again = life(experiment, tmp_path)
    assert (again.status, again.outcome) == ("ran", Outcome.COMPLETED)
    assert pq.read_metadata(again.stored.series).num_rows == 13


def test_a_dry_run_says_what_would_happen(cli: Callable[..., Said], in_tmp: Path) -> None:
    (in_tmp / "life.yaml").write_text(VOLTERRA)
    out, experiment = in_tmp / "results", load("life.yaml")

    def said(*more: str) -> str:
        before = {path: path.stat().st_mtime_ns for path in out.rglob("*")}
        one = cli("run", "life.yaml", "--dry-run", *more)
        assert {path: path.stat().st_mtime_ns for path in out.rglob("*")} == before
        return (one.out + one.err).splitlines()[0].removesuffix(": 401 rows in results/life")

    assert said() == "life: will run"
    killed(out, experiment)
    assert said() == "life: will continue from its last checkpoint"
    life(experiment, out, 5)
    assert said() == "life: will continue from its last checkpoint"
    assert said("--set", "h=0.02", "--set", "name=life").startswith("error: results/life: holds a different experiment")
    seen: list[str] = []
    run_experiment(experiment, out, RunOptions(on_progress=lambda *steps: seen.append(said())))
    assert set(seen) == {"life: another process is computing it"}
    assert said() == "life: up to date"
    for more in (["--force"], ["--set", "output.format=csv", "--set", "name=life"]):
        assert said(*more) == "life: will run; the earlier result is renamed, not overwritten"
