"""Unfinished runs by name: listed with what is left of them, and continued without their config."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from resuming import after, content, killed, small
from topcli.runs.decision import RunOptions
from topcli.runs.run import run_experiment
from topcli.runs.run_list import listed_runs

KEYS = ("name", "outcome", "step", "resumable")


def rows(out: Path) -> list[tuple[Any, ...]]:
    return [tuple(item[key] for key in KEYS) for item in listed_runs(out)]


@pytest.mark.usefixtures("small_chunks")
def test_unfinished_runs_are_listed_beside_finished_ones(cli: Callable[..., Any], in_tmp: Path) -> None:
    out = in_tmp / "results"
    run_experiment(small("name=done"), out)
    run_experiment(small("name=stopped"), out, RunOptions(stop=after(4)))
    killed(out, small("name=dead"), 5)
    (out / ".empty.part-999999999-0123abcd").mkdir()
    seen: list[list[tuple[Any, ...]]] = []
    run_experiment(small("name=busy"), out, RunOptions(on_progress=lambda done, total: seen.append(rows(out))))
    assert ("busy", "running", None, False) in seen[1]
    before = sorted(path.relative_to(out) for path in out.rglob("*"))
    found = rows(out)
    assert sorted(path.relative_to(out) for path in out.rglob("*")) == before, "listing changes nothing"
    steps = {name: step for name, _, step, _ in found}
    assert 0 < steps["stopped"] < 300
    assert 0 < steps["dead"] < 300
    assert [(name, outcome, resumable) for name, outcome, _, resumable in found] == [
        ("busy", "completed", False),
        ("dead", "killed", True),
        ("done", "completed", False),
        ("empty", "killed", False),
        ("stopped", "interrupted", True),
    ]
    dead = cli("list", "runs", "--json").json()["runs"][1]
    assert (dead["scheme"], dead["h"], dead["N"], dead["ended"]) == ("hk", 0.001, 300, None)
    header, *lines = cli("list", "runs").out.splitlines()
    assert header.split() == ["name", "outcome", "step", "resumable", "scheme", "h", "N", "digest", "ended"]
    assert lines[1].split()[:7] == ["dead", "killed", str(steps["dead"]), "yes", "hk", "0.001", "300"]


def test_a_list_of_finished_runs_has_no_columns_for_others(cli: Callable[..., Any], in_tmp: Path) -> None:
    run_experiment(small("name=done"), in_tmp / "results")
    assert cli("list", "runs").out.split()[:4] == ["name", "outcome", "scheme", "h"]


@pytest.mark.usefixtures("small_chunks")
@pytest.mark.parametrize("how", ["killed", "interrupted"])
@pytest.mark.parametrize("given", ["mine", "results/mine", "results/mine/"])
def test_a_run_continues_by_its_name(cli: Callable[..., Any], in_tmp: Path, how: str, given: str) -> None:
    out = in_tmp / "results"
    if how == "killed":
        killed(out, small("name=mine"), 5)
    else:
        run_experiment(small("name=mine"), out, RunOptions(stop=after(4)))
    said = cli("run", given, "--resume")
    assert said.code == 0
    assert "mine: continues from step" in said.err
    whole = run_experiment(small("name=mine"), in_tmp / "whole").stored.folder
    assert content(out / "mine") == content(whole)
    assert "(up to date)" in cli("run", given, "--resume").err


@pytest.mark.usefixtures("small_chunks")
def test_a_run_that_is_computed_now_is_not_resumed_by_name(cli: Callable[..., Any], in_tmp: Path) -> None:
    said: list[Any] = []

    def once(done: int, total: int) -> None:
        if not said:
            said.append(cli("run", "mine", "--resume"))

    run_experiment(small("name=mine"), in_tmp / "results", RunOptions(on_progress=once))
    assert said[0].code == 2
    assert "is computing this run now; there is nothing to resume" in said[0].err


def test_a_name_without_a_run_or_config_is_unknown(cli: Callable[..., Any]) -> None:
    for more in ((), ("--resume",)):
        said = cli("run", "nosuch", *more)
        assert said.code == 2
        assert "no packaged scene is called 'nosuch'" in said.err
