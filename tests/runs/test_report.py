"""The report of a run: its figures are computed once, and shown as stored wherever they are shown."""

from __future__ import annotations

from collections import Counter
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conftest import ROOT
from topcli.analysis.tally import InvariantRow
from topcli.config.ensemble import EnsembleExperiment
from topcli.config.load import load
from topcli.config.models import Experiment
from topcli.contracts import Invariant
from topcli.runs.decision import RunOptions
from topcli.runs.report import INVARIANTS, REPORT_COLUMNS, comparison_lines, report_markdown
from topcli.runs.run import RunResult, run_experiment
from topcli.store.series import read_series
from topcli.tops.kowalevski import Kowalevski


def run(config: str, *overrides: str, out: Path) -> RunResult:
    experiment = load(ROOT / "configs" / f"{config}.yaml", list(overrides))
    if isinstance(experiment, EnsembleExperiment):
        return run_experiment(experiment, out, RunOptions(threads=1))
    return run_experiment(experiment, out, RunOptions(checkpoint_every=0.0))


@pytest.fixture
def evaluated(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Rows at which each invariant of Kowalevski's top has been evaluated."""
    counts: Counter[str] = Counter()
    invariants = Kowalevski.invariants

    def counted(one: Invariant) -> Invariant:
        def value(states: np.ndarray) -> np.ndarray:
            counts[one.name] += len(states)
            return one.value(states)

        return replace(one, value=value)

    monkeypatch.setattr(Kowalevski, "invariants", lambda self: tuple(map(counted, invariants(self))))
    return counts


def test_invariants_are_evaluated_once_for_report_and_series(evaluated: Counter[str], tmp_path: Path) -> None:
    """The first row, the reference of the deviations, included."""
    stored = run("kowalevski_hk", "N=3000", out=tmp_path).stored
    series = read_series(stored.series)
    evaluated.pop("energy", None)  # also judged against its limit
    assert len(evaluated) == 3
    assert set(evaluated) < set(series)
    assert set(evaluated.values()) == {len(series["n"])}


def test_invariants_of_an_ensemble_are_evaluated_once_for_report_and_series(
    evaluated: Counter[str], tmp_path: Path
) -> None:
    """Once for every row, and once for the last state of each trajectory."""
    run_result = run("kowalevski_ensemble", "N=300", "ensemble.store=trajectories", out=tmp_path)
    rows, members = len(read_series(run_result.stored.series)["n"]), run_result.report["trajectories"]
    assert rows > members > 1
    evaluated.pop("energy", None)
    assert set(evaluated.values()) == {rows + members}


@pytest.mark.parametrize("config", ["kowalevski_hk", "kowalevski_ensemble"])
def test_a_run_resolves_its_config_once(config: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kind = EnsembleExperiment if "ensemble" in config else Experiment
    calls = []
    resolved = kind.resolved

    def recording(self) -> dict:
        calls.append(self)
        return resolved(self)

    monkeypatch.setattr(kind, "resolved", recording)
    result = run(config, "N=100", out=tmp_path)
    assert len(calls) == 1
    assert result.report["digest"] == result.stored.manifest["digest"] == calls[0].digest


SHOWN = {
    "invariant": ("symbol", "A"),
    "first": ("first", "1.012345678"),
    "min": ("min", "1.022345678"),
    "max": ("max", "1.032345678"),
    "max deviation": ("max_deviation", "0.104"),
    "relative": ("max_deviation_relative", "0.105"),
    "rms deviation": ("rms_deviation", "0.106"),
    "relative ": ("rms_deviation_relative", "0.107"),
    "drift per unit time": ("drift", "-0.108"),
    "± standard error": ("drift_error", "0.11"),
    "over the run": ("drift_over_run", "0.111"),
    "model": ("model", "random walk"),
    "scatter": ("scatter", "0.112"),
    "round-off bound": ("round_off_bound", "1.1e-13"),
    "verdict": ("verdict", "drifting"),
}
"""Cells of each line of the report, by label, for ``ROW``."""


ROW: dict[str, Any] = {
    "name": "a",
    "symbol": "A",
    "first": 1.0123456781,
    "min": 1.0223456781,
    "max": 1.0323456781,
    "max_deviation": 0.1041,
    "max_deviation_relative": 0.1051,
    "rms_deviation": 0.1061,
    "rms_deviation_relative": 0.1071,
    "drift": -0.1081,
    "drift_error": 0.1091,
    "drift_over_run": 0.1111,
    "model": "random walk",
    "scatter": 0.1121,
    "round_off_bound": 1.13e-13,
    "verdict": "drifting",
    "reason": "of the test",
}


def report(**changes: Any) -> dict[str, Any]:
    return {
        "name": "some",
        "top_title": "a top",
        "scheme": "hk",
        "scheme_title": "a scheme",
        "h": 0.1,
        "N": 10,
        "outcome": "completed",
        "message": "10 steps",
        "counters": {},
        "seconds": {"compile": 0.0, "run": 0.0},
        "invariants": [ROW, {**ROW, "symbol": "B", "drift": None, "model": None, **changes}],
    }


def lines_of(data: dict[str, Any]) -> list[list[str]]:
    cells = INVARIANTS.cells(data)
    return [list(cells.header), *map(list, cells.lines)]


def test_every_cell_is_the_stored_field() -> None:
    lines = lines_of(report())
    assert [line[0] for line in lines] == [label.strip() for label in SHOWN]
    assert [line[1] for line in lines] == [cell for _, cell in SHOWN.values()]
    assert [line[0] for line in lines if line[1] != line[2]] == ["invariant", "drift per unit time", "model"]
    assert {line[2] for line in lines if line[1] != line[2]} == {"B", "–"}


@pytest.mark.parametrize(("label", "key"), [(label.strip(), key) for label, (key, _) in SHOWN.items()])
def test_a_field_changes_its_own_line_only(label: str, key: str) -> None:
    changed = "C" if isinstance(ROW[key], str) else 7.5
    before, after = lines_of(report()), lines_of(report(**{key: changed}))
    differs = [line[0] for line, other in zip(before, after, strict=True) if line != other]
    assert differs == [label]


def test_every_figure_of_the_report_is_shown() -> None:
    """The name and the reason of the verdict are in the text below the table."""
    assert {column.name for column in REPORT_COLUMNS} == {field.name for field in fields(InvariantRow)} - {
        "name",
        "reason",
    }


def test_markdown_has_the_same_cells_as_the_terminal() -> None:
    header, ruler, *lines = (line for line in report_markdown(report()).splitlines() if line.startswith("|"))
    assert set(ruler) <= set("| -")
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in (header, *lines)]
    assert cells == lines_of(report())


def test_comparisons_show_the_stored_fields_of_each_scheme() -> None:
    one, other = {"invariants": [ROW]}, {"invariants": [{**ROW, "drift_error": 0.31, "verdict": "exact"}]}
    assert comparison_lines([one, other]) == [
        ["A max deviation", "0.104", "0.104"],
        ["A drift per unit time", "-0.108", "-0.108"],
        ["  its standard error", "0.11", "0.31"],
        ["  model", "random walk", "random walk"],
        ["  verdict", "drifting", "exact"],
    ]
