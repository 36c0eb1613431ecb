"""Ensembles as results: run folders, statistics, the Python interface and the command line."""

from __future__ import annotations

import json
import re
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import topcli
from cases import table_of
from conftest import ROOT, random_states
from topcli.analysis.tally import DEVIATIONS
from topcli.config.load import load
from topcli.config.models import Experiment
from topcli.contracts import Outcome, stopping_when
from topcli.errors import UsageError
from topcli.runs.recording import Recording
from topcli.runs.report import SHOWN_TRAJECTORIES
from topcli.runs.run import RunResult, run_experiment
from topcli.store.series import read_series

RANDOM = {"count": 70, "seed": 3, "gamma": "sphere", "omega": {"near": 0.3}}


def experiment(**changes: Any) -> Experiment:
    data = {
        "name": "some",
        "top": "kowalevski",
        "initial": {"omega": [0.7, -0.4, 1.3]},
        "ensemble": {"random": RANDOM},
        "scheme": "hk",
        "h": 0.02,
        "N": 200,
        "output": {"every": 10},
        **changes,
    }
    found = load(data)
    assert found.ensemble
    return found


def run(tmp_path: Path, **changes: Any) -> RunResult:
    return run_experiment(experiment(**changes), tmp_path)


def failing(count: int = 200) -> dict[str, Any]:
    """Initial states of which those with a huge omega blow up at once under rk2."""
    return {
        "scheme": "rk2",
        "ensemble": {"states": [{"omega": [1e200 if i % 4 == 1 else 0.5, 0, 1]} for i in range(count)]},
        "initial": {"gamma": [0.6, 0.48, 0.64]},
    }


def columns(path: Path) -> dict[str, np.ndarray]:
    return read_series(path)


def test_the_series_holds_single_runs(tmp_path: Path) -> None:
    found = experiment()
    stored = run_experiment(found, tmp_path).stored
    series = columns(stored.series)
    assert list(series) == ["trajectory", "n", "t", *found.top.components, "gamma_sq", "two_l", "energy", "k_sq"]
    assert np.array_equal(series["trajectory"], np.repeat(np.arange(70), 21))
    for i in (0, 63, 64, 69):
        rows = series["trajectory"] == i
        single = topcli.simulate(found.trajectory(i).resolved())
        for name in ("n", "t", *found.top.components, "k_sq"):
            assert np.array_equal(series[name][rows], single[name]), name


@pytest.mark.usefixtures("small_chunks")
def test_statistics_are_those_of_the_stored_trajectories(tmp_path: Path) -> None:
    """In pieces and without rows, against each single trajectory's own report."""
    found = experiment()
    stored = run_experiment(found, tmp_path / "rows").stored
    without = run(tmp_path / "none", ensemble={"random": RANDOM, "store": "statistics"})
    assert without.stored.manifest["series"] == "trajectories.parquet"
    assert not (without.stored.folder / "series.parquet").exists()
    table, other = columns(stored.folder / "trajectories.parquet"), columns(without.stored.series)
    assert all(np.array_equal(table[name], other[name]) for name in table)
    series = columns(stored.series)
    order = np.lexsort((series["n"], series["trajectory"]))
    states = np.stack([series[name][order] for name in found.top.components], axis=1).reshape(70, 21, 6)
    for i in range(70):
        assert tuple(table[f"initial_{name}"][i] for name in found.top.components) == tuple(states[i, 0])
        reports = topcli.simulate(found.trajectory(i).resolved()).invariant_rows()
        for one, invariant in zip(reports, found.top.invariants(), strict=True):
            assert table[f"first.{one.name}"][i] == one.first
            assert table[f"max_deviation.{one.name}"][i] == one.max_deviation
            assert table[f"rms_deviation.{one.name}"][i] == pytest.approx(one.rms_deviation, rel=1e-9, abs=0.0)
            last = invariant.value(states[i, -1:])[0] - one.first
            assert table[f"final_deviation.{one.name}"][i] == last
            assert table[f"drift.{one.name}"][i] == pytest.approx(one.drift, rel=1e-9, abs=0.0)
    for row in without.report["invariants"]:
        for measure in DEVIATIONS:
            values = np.sort(np.abs(table[f"{measure}.{row['name']}"]))
            assert row[measure] == {
                "min": values[0], "5 %": values[3], "median": values[34], "95 %": values[66], "max": values[-1]
            }  # fmt: skip


DOCUMENTED = re.compile(r"^\| `([^|]*)` \|", re.MULTILINE)


@pytest.mark.parametrize("varied", [False, True])
def test_the_documented_columns_are_the_stored_ones(tmp_path: Path, varied: bool) -> None:
    """In the order of the page, with the names that stand for several written out."""
    grid = {"grid": {"top.A": [2.0, 3.0], "top.c0": [1.0, 4.0], "omega1": [0.1, 0.2]}}
    changes = {"initial": {"omega": [1, 0, 0], "gamma": [0, 0, 1]}, "ensemble": grid} if varied else {}
    found = experiment(**changes)
    table = columns(run_experiment(found, tmp_path).stored.folder / "trajectories.parquet")
    page = (ROOT / "docs" / "sweeps.md").read_text().split("## The table of trajectories")[1].split("\n## ")[0]
    documented = DOCUMENTED.findall(page)
    named = {
        "top.PARAMETER": ["top.c0", "top.A"] if varied else [],
        "initial_COMPONENT": [f"initial_{name}" for name in found.top.components],
    }
    integrals = [name for name in documented if name.endswith(".INVARIANT")]
    plain = [name for name in documented if name not in integrals]
    wanted = [one for name in plain for one in named.get(name, [name])]
    wanted += [name.replace("INVARIANT", one.name) for one in found.top.invariants() for name in integrals]
    assert list(table) == wanted
    if varied:
        assert [*zip(table["top.c0"], table["top.A"], strict=True)][::2] == [*product((1.0, 4.0), (2.0, 3.0))]


def test_failures_are_reported_and_stay_alone(tmp_path: Path) -> None:
    """Counted over all, and named up to the twentieth."""
    result = run(tmp_path, **failing())
    report = result.report
    assert report["outcome"] == "blew_up"
    assert report["outcomes"] == {"completed": 150, "blew_up": 50}
    assert (
        "of 200 trajectories 150 completed, 50 blew up; the first of them, trajectory 1, blew up at step"
        in report["message"]
    )
    assert [failure["trajectory"] for failure in report["failures"]] == list(range(1, 4 * SHOWN_TRAJECTORIES, 4))
    series = columns(result.stored.series)
    rows = np.bincount(series["trajectory"], minlength=200)
    assert (np.delete(rows, range(1, 200, 4)) == 21).all()
    assert (rows[1::4] == 1).all()
    table = columns(result.stored.folder / "trajectories.parquet")
    assert list(table["outcome"]) == [("blew_up" if i % 4 == 1 else "completed") for i in range(200)]
    assert (table["n"][1::4] < 5).all()
    assert json.loads((result.stored.folder / "report.json").read_text()) == report


def test_seconds_of_several_tops_add_up_and_their_code_is_shared(tmp_path: Path) -> None:
    recording = Recording(experiment(), tmp_path, {})
    for compiling, cached, running in ((1.0, True, 2.0), (3.0, False, 4.0), (2.0, True, 8.0)):
        run: Any = SimpleNamespace(times={"compile": compiling, "compile_cached": cached, "run": running})
        recording.add_seconds(run)
    assert recording.seconds == {"compile": 3.0, "compile_cached": False, "run": 14.0}


@pytest.mark.parametrize(("scheme", "begun"), [("hk", 0), ("dop853", 1)])
def test_members_never_begun_are_not_zeros(scheme: str, begun: int, tmp_path: Path) -> None:
    """Stopped at once: only of those that are computed one by one the first is begun."""
    store = {"ensemble": {"random": RANDOM, "store": "final"}}
    with stopping_when(lambda: True):
        result = run_experiment(experiment(scheme=scheme, N=100, **store), tmp_path)
    report, table = result.report, columns(result.stored.folder / "trajectories.parquet")
    assert report["outcomes"] == {"interrupted": 70}
    assert not table["n"].any()
    for invariant in ("gamma_sq", "two_l", "energy", "k_sq"):
        for name in ("first", *DEVIATIONS):
            assert np.isfinite(table[f"{name}.{invariant}"]).tolist() == [i < begun for i in range(70)], name
    assert len(columns(result.stored.series)["n"]) == begun
    assert {(row["judged"], row["within_round_off"]) for row in report["invariants"]} == {(0, 0)}
    assert np.isfinite(table["initial_omega1"]).all()


def test_an_array_of_states() -> None:
    y0 = random_states(33, 9)
    found = topcli.simulate("kowalevski_hk", states=y0, h=0.01, N=50, threads=2)
    assert found.states.shape == (33, 51, 6)
    assert np.array_equal(found.initial, y0)
    assert np.array_equal(found["omega1"], found.states[:, :, 0])
    assert found.endings.outcomes == {Outcome.COMPLETED: 33}
    assert "33 completed" in repr(found)
    frame = found.to_pandas()
    assert len(frame) == 33 * 51
    assert frame["k_sq"].iloc[51] == found["k_sq"][1, 0]
    few = topcli.simulate("kowalevski_hk", states=y0, h=0.01, N=50, ensemble={"store": "statistics"})
    assert few.states.shape == (33, 0, 6)
    assert np.array_equal(few.last, found.states[:, -1])
    assert few.invariants().equals(found.invariants())
    with pytest.raises(UsageError, match="not stored"):
        few[0]


@pytest.mark.parametrize(
    ("options", "said"),
    table_of(r"""
{'states': [[1.0, 2.0]]}  has 6 components, not 2
{'states': [1.0]}  of shape
{'states': [['x', 'x', 'x', 'x', 'x', 'x']]}  array of numbers
{'states': [[1, 0, 0, 1, 0, 1e999]]}  finite
{'states': [[1, 0, 0, 1, 0, 0], [1, 0, 0, 1, 1, 0]]}  states\[1\]: gamma must be a unit vector
{'states': [[1, 0, 0, 1, 0, 0]], 'ensemble': {'grid': {'omega1': [1]}}}  keep one
{'states': [[1, 0, 0, 1, 0, 0]], 'ensemble': {'stor': 'final'}}  did you mean 'store'
{'ensemble': {'random': {'count': 1e6, 'gamma': 'sphere'}}, 'N': 1000000}  do not fit in memory
{'states': [[1, 0, 0, 1, 0, 0]], 'threads': 0}  threads must be at least 1
"""),
)
def test_mistakes_from_python(options: dict[str, Any], said: str) -> None:
    with pytest.raises(UsageError, match=said):
        topcli.simulate("kowalevski_hk", **options)


def test_exit_codes_count_failed_trajectories(cli, in_tmp: Path) -> None:
    some = experiment(**failing(8))
    (in_tmp / "some.yaml").write_text(some.to_yaml())
    said = cli("run", "some.yaml")
    assert said.code == 3
    assert "error: some: some trajectories failed; the rows before are kept" in said.err
    text = some.to_yaml().replace("omega: [0.5,", "omega: [1e200,").replace("name: some", "name: all")
    (in_tmp / "all.yaml").write_text(text)
    assert cli("run", "all.yaml").code == 1
