"""Large ensembles block by block: bounded memory, the same numbers in any blocks, and the bookkeeping of members."""

from __future__ import annotations

import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import topcli
from test_ensemble_run import RANDOM, columns, experiment, failing
from topcli.analysis.tally import DEVIATIONS, InvariantTally
from topcli.contracts import Ending, Invariant, Outcome
from topcli.engine import ensemble as engine
from topcli.engine.run import CODES, Endings
from topcli.runs import ensemble as study
from topcli.runs.decision import RunOptions
from topcli.runs.identity import prepared
from topcli.runs.report import EndingTally
from topcli.runs.run import run_experiment
from topcli.tops.kowalevski import Kowalevski

START = {"omega": [0.7, -0.4, 1.3], "gamma": [0.6, 0.48, 0.64]}


GRID = {"top.c0": [0.5, 1.0, 2.0], "omega1": {"from": 0.1, "to": 0.9, "count": 90}}


def peak(folder: Path, count: int, **changes: Any) -> int:
    """Bytes that Python and numpy hold at most while an ensemble of ``count`` members is loaded, run and reported."""
    ensemble = {"random": {**RANDOM, "count": count}, "store": changes.pop("store")}
    tracemalloc.start()
    try:
        run_experiment(
            experiment(N=2, output={"every": 1}, ensemble=ensemble, **changes), folder, RunOptions(threads=1)
        )
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("store", "changes"),
    [("trajectories", {}), ("statistics", {"scheme": "rk2", "h": 1e200})],
    ids=["trajectories", "all blow up"],
)
def test_memory_does_not_grow_with_the_members(
    store: str, changes: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More members take nine bytes for each of them: a measure of an invariant, while its quantiles are sought.

    When every member had an Ending, a row and its deviations in memory it was some 1,500 bytes.
    """
    monkeypatch.setattr(study, "BLOCK", 1024)
    monkeypatch.setattr("topcli.store.series.ROW_GROUP", 1024)
    peak(tmp_path / "first", 10, store=store, **changes)  # what is imported and compiled once
    few = peak(tmp_path / "few", 2_000, store=store, **changes)
    many = peak(tmp_path / "many", 12_000, store=store, **changes)
    assert many - few < 10_000 * 40


def test_the_drifts_of_any_number_of_steps_are_fitted_in_little_memory() -> None:
    """A run may have 1e12 steps; its recorded step numbers alone would take terabytes."""
    tally = InvariantTally(Kowalevski().invariants(), 0.01, count=2, last=10**12)
    tracemalloc.start()
    try:
        tally.slopes(10**12 + 1, 10**12)
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()
    group = experiment(N=10**12, ensemble={"random": {**RANDOM, "count": 2}, "store": "statistics"})
    tracemalloc.start()
    try:
        study.GroupRun(group, next(iter(group.members.groups)), 0, lambda *_: None, lambda: False, 1)
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()


def test_a_block_of_the_engine_begins_with_a_tile() -> None:
    """Else the row groups of a large ensemble would depend on the blocks."""
    assert engine.BLOCK % (engine.GROUP * engine.TILE) == 0


@pytest.mark.slow
@pytest.mark.parametrize("store", ["trajectories", "final", "statistics"])
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"top": "lagrange", "scheme": "hk", "initial": {"omega": [0.1, 0.2, 1.0]}},
        {"ensemble": {"grid": GRID}, "initial": START},
        failing(),
        {"scheme": "dop853", "N": 20, "ensemble": {"random": {**RANDOM, "count": 20}}},
    ],
    ids=["random", "modified", "grid", "failing", "one by one"],
)
def test_blocks_change_no_number(
    changes: dict[str, Any], store: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ensemble = {**(changes.get("ensemble") or {"random": {**RANDOM, "count": 200}}), "store": store}
    found = experiment(**{**changes, "ensemble": ensemble})
    monkeypatch.setattr(engine, "GROUP", 1)
    whole = run_experiment(found, tmp_path / "whole")
    monkeypatch.setattr(study, "BLOCK", 64)
    cut = run_experiment(found, tmp_path / "cut")
    for table in {whole.stored.manifest["series"], whole.stored.manifest["trajectories"]}:
        one, other = columns(whole.stored.folder / table), columns(cut.stored.folder / table)
        assert list(one) == list(other)
        for name in one:
            assert np.array_equal(one[name], other[name], equal_nan=one[name].dtype == np.float64), name
    for key in ("initial_states_sha256", "outcome", "message"):
        assert whole.stored.manifest[key] == cut.stored.manifest[key]
    reports = [{**done.report, "seconds": None} for done in (whole, cut)]
    assert reports[0] == reports[1]


def test_indices_are_unique_over_groups(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each member's number leads to its own parameters, initial state and state at step N, which is no recorded one."""
    monkeypatch.setattr(study, "BLOCK", 64)
    found = experiment(N=205, initial=START, ensemble={"grid": GRID, "store": "final"})
    stored = run_experiment(found, tmp_path).stored
    table, last = columns(stored.folder / "trajectories.parquet"), columns(stored.series)
    for rows in (table, last):
        assert rows["trajectory"].tolist() == list(range(270))
        assert set(rows["n"]) == {205}
    assert table["top.c0"].tolist() == [c0 for c0 in (0.5, 1.0, 2.0) for _ in range(90)]
    for i in (0, 89, 90, 269):
        member = found.member(i)
        assert member.top.model_dump()["c0"] == table["top.c0"][i]
        assert list(member.y0) == [table[f"initial_{name}"][i] for name in found.top.components]
        single = topcli.simulate({**member.resolved(), "output": {"every": 205}})
        assert [last[name][i] for name in found.top.components] == single.states[-1].tolist()
    with pytest.raises(IndexError, match="there are 270"):
        found.member(270)


def test_every_outcome_is_counted() -> None:
    """Also one that is neither of those that the engine gives, as soon as the enum has it."""
    outcomes = list(Outcome)
    endings = Endings(len(outcomes) + 1, 0.5, ("events",))
    for i, outcome in enumerate(outcomes):
        endings.put(i, outcome, i, [10])
    endings.put(len(outcomes), Outcome.BLEW_UP, 7, [1])
    tally = EndingTally(9)
    tally.add(endings)
    tally.add(endings)
    assert tally.outcomes == {o.value: 4 if o is Outcome.BLEW_UP else 2 for o in outcomes}
    assert sum(tally.outcomes.values()) == tally.total == 2 * len(endings)
    assert tally.counters == {"events": 2 * (10 * len(outcomes) + 1)}
    failing = [o for o in outcomes if o not in (Outcome.COMPLETED, Outcome.INTERRUPTED)]
    assert {ending.outcome for _, ending in tally.failures} == set(failing)
    first = CODES[failing[0]]
    assert tally.failures[0] == (first, Ending(failing[0], first, first * 0.5, {"events": 10}))
    for count in tally.outcomes.values():
        assert f"{count} " in tally.message
    assert tally.outcome is Outcome.INTERRUPTED


SUM = Invariant("sum", "s", "s", "sum", lambda y: y.sum(axis=1), lambda y: np.abs(y).sum(axis=1))


EPS = 2.0**-52


@pytest.mark.parametrize("every", [1, 10, 100])
@pytest.mark.parametrize(("ulps", "exact"), [(399, True), (401, False)])
def test_the_round_off_bound_counts_steps_not_rows(every: int, ulps: int, exact: bool) -> None:
    """An ulp within and beyond 20 eps sqrt(400) times the terms, which are 1, at any density of the record."""
    n = np.arange(0, 401, every)
    states = np.zeros((1, len(n), 2))
    states[0, :, 0] = 1.0
    states[0, 1, 1] = ulps * EPS
    tally = InvariantTally([SUM], 0.1)
    tally.add(n, states)
    tally.finish(states[:, -1])
    assert tally.steps.tolist() == [400]
    assert tally.within_round_off.tolist() == [[exact]]


def test_verdicts_do_not_depend_on_every() -> None:
    for scheme, exact in (("hybrid", {"gamma_sq", "k_sq"}), ("hk", set())):
        for every in (1, 7, 100, 1000):
            table = topcli.simulate_ensemble(
                experiment(scheme=scheme, N=1000, output={"every": every}).resolved(), ensemble={"random": RANDOM}
            ).invariants()
            assert set(table.index[table["within_round_off"] == 70]) == exact, every
            assert (table["judged"] == 70).all()


@pytest.mark.parametrize(("scheme", "begun"), [("hk", 70), ("dop853", 0)])
def test_members_never_begun_are_not_zeros(scheme: str, begun: int, tmp_path: Path) -> None:
    """Stopped at once: side by side they are at their initial states, one by one most have not even that."""
    store = {"ensemble": {"random": RANDOM, "store": "final"}}
    result = run_experiment(experiment(scheme=scheme, N=100, **store), tmp_path, RunOptions(stop=lambda: True))
    report, table = result.report, columns(result.stored.folder / "trajectories.parquet")
    begun = begun or 1  # the first one was begun before it was asked
    assert report["outcomes"] == {"interrupted": 70}
    assert not table["n"].any()
    for invariant in ("gamma_sq", "two_l", "energy", "k_sq"):
        for name in ("first", *DEVIATIONS):
            values = table[f"{name}.{invariant}"]
            assert np.isfinite(values[:begun]).all(), name
            assert np.isnan(values[begun:]).all(), name
    assert len(columns(result.stored.series)["n"]) == begun
    for row in report["invariants"]:
        assert (row["judged"], row["within_round_off"]) == (0, 0)
    assert np.isfinite(table["initial_omega1"]).all()


@pytest.mark.parametrize("store", ["trajectories", "statistics"])
def test_modified_integrals_are_in_every_table(store: str, tmp_path: Path) -> None:
    """HK of the Euler top keeps integrals of its own exactly: reported, tallied, and a column where asked for."""
    found = experiment(
        top="euler", initial={"omega": [0.3, 1.0, 0.2]}, ensemble={"random": {"count": 70, "omega": {"near": 0.2}},
        "store": store}
    )  # fmt: skip
    own = [invariant.name for invariant in found.first.modified]
    assert own
    result = run_experiment(found, tmp_path)
    assert [row["name"] for row in result.report["invariants"]][-len(own) :] == own
    table = columns(result.stored.folder / "trajectories.parquet")
    for row in result.report["invariants"][-len(own) :]:
        assert row["within_round_off"] == row["judged"] == 70, row["name"]
        single = topcli.simulate(found.member(41).resolved())
        values = single[row["name"]]
        assert table[f"first.{row['name']}"][41] == values[0]
        assert table[f"max_deviation.{row['name']}"][41] == np.abs(values - values[0]).max()


def test_the_code_of_every_group_is_part_of_the_identity() -> None:
    """splitting steps a symmetric top in closed form and any other by its axes: two pieces of code."""

    def code(*moments: float) -> str:
        top = {"kind": "heavy", "A": 2.0, "B": 1.0, "C": 1.0, "x0": 1.0}
        grid = {"ensemble": {"grid": {"top.B": list(moments)}}}
        return prepared(experiment(top=top, scheme="splitting", initial=START, **grid)).identity.code

    assert len({code(1.0, 1.5), code(1.0, 2.0), code(2.0, 1.0), code(2.0)}) == 4
