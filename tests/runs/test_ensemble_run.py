"""Ensembles as results: run folders, statistics, the Python interface and the command line."""

from __future__ import annotations

import json
import re
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import topcli
from cases import table_of
from conftest import ROOT, random_states
from topcli.analysis.tally import DEVIATIONS, quantiles
from topcli.config.load import load
from topcli.config.models import Experiment
from topcli.contracts import Outcome
from topcli.errors import UsageError
from topcli.runs.report import SHOWN_TRAJECTORIES
from topcli.runs.run import RunOptions, RunResult, run_experiment
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


def test_a_drift_needs_all_rows_and_eight_of_them(tmp_path: Path) -> None:
    """A trajectory that blew up has none, and its neighbours have theirs; nor has one of seven rows."""
    table = columns(run(tmp_path / "failing", **failing()).stored.folder / "trajectories.parquet")
    assert np.isnan(table["drift.energy"][1::4]).all()
    assert np.isfinite(np.delete(table["drift.energy"], range(1, 200, 4))).all()
    for rows, drifts in ((7, False), (8, True)):
        short = run(tmp_path / str(rows), N=10 * (rows - 1))
        found = columns(short.stored.folder / "trajectories.parquet")["drift.energy"]
        assert np.isfinite(found).tolist() == [drifts] * 70


DOCUMENTED = re.compile(r"^\| `([^|]*)` \|", re.MULTILINE)


@pytest.mark.parametrize("varied", [False, True])
def test_the_documented_columns_are_the_stored_ones(tmp_path: Path, varied: bool) -> None:
    """In the order of the page, with the names that stand for several written out."""
    grid = {"grid": {"top.c0": [1.0, 2.0], "omega1": [0.1, 0.2]}}
    changes = {"initial": {"omega": [1, 0, 0], "gamma": [0, 0, 1]}, "ensemble": grid} if varied else {}
    found = experiment(**changes)
    table = columns(run_experiment(found, tmp_path).stored.folder / "trajectories.parquet")
    page = (ROOT / "docs" / "ensembles.md").read_text().split("## The table of trajectories")[1].split("\n## ")[0]
    documented = DOCUMENTED.findall(page)
    named = {
        "top.PARAMETER": ["top.c0"] if varied else [],
        "initial_COMPONENT": [f"initial_{name}" for name in found.top.components],
    }
    integrals = [name for name in documented if name.endswith(".INVARIANT")]
    plain = [name for name in documented if name not in integrals]
    wanted = [one for name in plain for one in named.get(name, [name])]
    wanted += [name.replace("INVARIANT", one.name) for one in found.top.invariants() for name in integrals]
    assert list(table) == wanted


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


def test_csv_holds_the_recorded_columns(tmp_path: Path) -> None:
    stored = run(tmp_path, output={"every": 100, "format": "csv", "columns": ["t", "k_sq"]}).stored
    series = columns(stored.series)
    assert list(series) == ["trajectory", "t", "k_sq"]
    assert series["trajectory"].dtype == np.int64
    assert (stored.folder / "trajectories.csv").read_text().startswith("trajectory,initial_omega1,")


@pytest.mark.parametrize(("scheme", "begun"), [("hk", 0), ("dop853", 1)])
def test_members_never_begun_are_not_zeros(scheme: str, begun: int, tmp_path: Path) -> None:
    """Stopped at once: only of those that are computed one by one the first is begun."""
    store = {"ensemble": {"random": RANDOM, "store": "final"}}
    result = run_experiment(experiment(scheme=scheme, N=100, **store), tmp_path, RunOptions(stop=lambda: True))
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


def test_a_grid_over_parameters_and_a_failure() -> None:
    grid = {"top.c0": [0.5, 2.0], "omega1": [0.5, 1e200]}
    found = topcli.simulate("kowalevski_hk", scheme="rk2", ensemble={"grid": grid}, N=50, h=0.01)
    assert [part.top.model_dump()["c0"] for part in found.parts] == [0.5, 2.0]
    assert [ending.outcome.value for ending in found.endings] == ["completed", "blew_up"] * 2
    assert np.isnan(found.states[1, -1]).all()
    assert [len(found[1]), len(found[2]), len(found), len(found.endings)] == [1, 51, 51, 4]
    assert found[2]["energy"][0] == found["energy"][2, 0]
    table = found.trajectories()
    assert list(table["top.c0"]) == [0.5, 0.5, 2.0, 2.0]


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


GRID = {"top.c0": [0.5, 1.0, 2.0], "omega1": {"from": 0.1, "to": 0.9, "count": 90}}
START = {"omega": [0.7, -0.4, 1.3], "gamma": [0.6, 0.48, 0.64]}


def test_numbers_of_trajectories_are_unique_over_parameters(tmp_path: Path) -> None:
    """Each member's number leads to its own parameters, initial state and state at step N, which is no recorded one."""
    found = experiment(N=205, initial=START, ensemble={"grid": GRID, "store": "final"})
    stored = run_experiment(found, tmp_path).stored
    table, last = columns(stored.folder / "trajectories.parquet"), columns(stored.series)
    for rows in (table, last):
        assert rows["trajectory"].tolist() == list(range(270))
        assert set(rows["n"]) == {205}
    assert table["top.c0"].tolist() == [c0 for c0 in (0.5, 1.0, 2.0) for _ in range(90)]
    for i in (0, 89, 90, 269):
        member = found.trajectory(i)
        assert member.top.model_dump()["c0"] == table["top.c0"][i]
        assert list(member.y0) == [table[f"initial_{name}"][i] for name in found.top.components]
        single = topcli.simulate({**member.resolved(), "output": {"every": 205}})
        assert [last[name][i] for name in found.top.components] == single.states[-1].tolist()
    with pytest.raises(IndexError, match="there are 270"):
        found.trajectory(270)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("store", "changes"),
    [("trajectories", {}), ("statistics", {"scheme": "rk2", "h": 1e200})],
    ids=["trajectories", "all blow up"],
)
def test_memory_does_not_grow_with_the_members(
    store: str, changes: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More members take some hundred bytes each: their endings, and the figures whose quantiles are sought."""
    monkeypatch.setattr("topcli.store.table.ROW_GROUP", 1024)

    def peak(name: str, count: int) -> int:
        ensemble = {"random": {**RANDOM, "count": count}, "store": store}
        tracemalloc.start()
        try:
            found = experiment(N=2, output={"every": 1}, ensemble=ensemble, **changes)
            run_experiment(found, tmp_path / name, RunOptions(checkpoint_every=1e6, threads=1))
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    peak("first", 10)  # what is imported and compiled once
    assert peak("many", 12_000) - peak("few", 2_000) < 10_000 * 400


@pytest.mark.parametrize("store", ["trajectories", "statistics"])
def test_modified_integrals_are_in_every_table(store: str, tmp_path: Path) -> None:
    """HK of the Euler top keeps integrals of its own exactly: reported, tallied, and a column where asked for."""
    ensemble = {"random": {"count": 70, "omega": {"near": 0.2}}, "store": store}
    found = experiment(top="euler", initial={"omega": [0.3, 1.0, 0.2]}, ensemble=ensemble)
    own = [invariant.name for invariant in found.modified]
    assert own
    result = run_experiment(found, tmp_path)
    assert [row["name"] for row in result.report["invariants"]][-len(own) :] == own
    table = columns(result.stored.folder / "trajectories.parquet")
    for row in result.report["invariants"][-len(own) :]:
        assert row["within_round_off"] == row["judged"] == 70, row["name"]
        single = topcli.simulate(found.trajectory(41).resolved())
        values = single[row["name"]]
        assert table[f"first.{row['name']}"][41] == values[0]
        assert table[f"max_deviation.{row['name']}"][41] == np.abs(values - values[0]).max()


def test_verdicts_do_not_depend_on_every() -> None:
    for scheme, exact in (("hybrid", {"gamma_sq", "k_sq"}), ("hk", set())):
        for every in (1, 7, 100, 1000):
            config = experiment(scheme=scheme, N=1000, output={"every": every}).resolved()
            table = topcli.simulate(config, ensemble={"random": RANDOM}).invariants()
            assert set(table.index[table["within_round_off"] == 70]) == exact, every
            assert (table["judged"] == 70).all()


def test_quantiles_of_what_is_known() -> None:
    assert quantiles(np.array([np.nan, 3.0, 1.0, np.inf]))["median"] == 3.0
    assert quantiles(np.array([np.nan]))["max"] is None


def test_exit_codes_count_failed_trajectories(cli, in_tmp: Path) -> None:
    some = experiment(**failing(8))
    (in_tmp / "some.yaml").write_text(some.to_yaml())
    said = cli("run", "some.yaml")
    assert said.code == 3
    assert "error: some: some trajectories failed; the rows before are kept" in said.err
    text = some.to_yaml().replace("omega: [0.5,", "omega: [1e200,").replace("name: some", "name: all")
    (in_tmp / "all.yaml").write_text(text)
    assert cli("run", "all.yaml").code == 1
