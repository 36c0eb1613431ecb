"""The report of a run: its figures are computed once, and shown as stored wherever they are shown."""

from __future__ import annotations

from collections import Counter
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from conftest import ROOT
from topcli.analysis.tally import InvariantRow
from topcli.config.ensemble import EnsembleExperiment
from topcli.config.load import load
from topcli.config.models import Experiment
from topcli.contracts import Invariant
from topcli.runs.decision import RunOptions
from topcli.runs.report import INVARIANTS, REPORT_COLUMNS, ReportColumn
from topcli.runs.run import RunResult, run_experiment
from topcli.runs.simulate import simulate
from topcli.store.series import read_series
from topcli.table import DASH
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


@pytest.mark.parametrize("column", REPORT_COLUMNS[1:], ids=lambda column: column.name)
def test_a_report_without_a_column_shows_a_dash(column: ReportColumn) -> None:
    """As one that was stored before the column existed."""
    rows = [row.as_dict() for row in simulate("euler_hk", h=0.1, N=20).invariant_rows()]
    lines = INVARIANTS.cells({"invariants": rows}).lines
    for row in rows:
        del row[column.name]
    without = INVARIANTS.cells({"invariants": rows}).lines
    changed = [after for before, after in zip(lines, without, strict=True) if before != after]
    assert all(set(line[1:]) == {DASH} for line in changed)
    assert len(changed) <= 1
    assert INVARIANTS.frame({"invariants": rows})[column.name].isna().all()


def test_every_figure_of_the_report_is_shown() -> None:
    """The name, the statement of the verdict and its reason are in the text below the table."""
    assert {column.name for column in REPORT_COLUMNS} == {field.name for field in fields(InvariantRow)} - {
        "name",
        "reason",
        "statement",
    }
