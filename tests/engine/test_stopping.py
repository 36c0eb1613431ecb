"""A request to stop takes effect within a chunk, however long the steps are, and costs no bit of the result."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from conftest import GEN, ROOT
from topcli.analysis.tally import InvariantTally
from topcli.config.load import load_experiment
from topcli.contracts import Outcome, Stepper
from topcli.engine import ensemble, loop, tile
from topcli.engine.ensemble import EnsembleRun, Execution
from topcli.engine.loop import Run
from topcli.runs.plan import RunOptions
from topcli.runs.run import run_experiment
from topcli.schemes.any_top import dop853
from topcli.tops.kowalevski import Kowalevski


def long_step(s, h, p):
    """About 20 ms of compiled arithmetic."""
    x = s[0]
    for _ in range(5_000_000):
        x = 0.75 * x + 1e-3
    return (x, s[1], s[2], s[3], s[4], s[5])


def stop_after(times: int):
    """A request to stop, from the poll with this number on."""
    polls = iter(range(times))
    return lambda: next(polls, None) is None


@pytest.mark.slow
def test_a_step_that_never_ends_is_given_up_when_asked_to() -> None:
    experiment = load_experiment(ROOT / "configs" / "heavy_dop853.yaml", ["h=1e4", "N=3"])
    run = Run(experiment.top, experiment.method(), experiment.y0, 1e4, 3, stop=stop_after(2))
    for _ in run:
        pass
    assert run.ending is not None
    assert (run.ending.outcome, run.ending.step) == (Outcome.INTERRUPTED, 0)


def test_a_step_of_too_many_evaluations_does_not_converge(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dop853, "MAX_EVALUATIONS", 3000)
    experiment = load_experiment(ROOT / "configs" / "heavy_dop853.yaml", ["h=100", "N=3"])
    run = Run(experiment.top, experiment.method(), experiment.y0, 100.0, 3)
    for _ in run:
        pass
    assert run.ending is not None
    assert (run.ending.outcome, run.ending.step) == (Outcome.NO_CONVERGENCE, 1)
    assert 3000 <= run.ending.counters["evaluations"] < 3020


@pytest.mark.slow
def test_long_compiled_steps_are_interrupted_within_a_chunk() -> None:
    run = Run(Kowalevski(), Stepper(long_step, 6), GEN, 0.1, 100_000, stop=stop_after(2))
    chunks = list(run)
    assert run.ending is not None
    assert run.ending.outcome is Outcome.INTERRUPTED
    assert 0 < run.ending.step < 1000
    assert not chunks[-1].whole
    position = run.position()
    assert position is not None
    assert position.done == position.into == run.ending.step


@pytest.mark.slow
def test_an_ensemble_of_long_steps_is_interrupted_within_a_chunk() -> None:
    y0 = np.tile(GEN, (40, 1))
    run = EnsembleRun(
        Kowalevski(),
        Stepper(long_step, 6),
        y0,
        0.1,
        10_000,
        made=lambda piece: int(piece.kept.max()),
        execution=Execution(stop_after(2)),
    )
    rows = [made for made, _ in run]
    assert {ending.outcome for ending in run.endings} == {Outcome.INTERRUPTED}
    assert run.endings[0].step < 1000
    assert rows[-1] == run.endings[0].step + 1
    assert (run.last_n == run.endings[0].step).all()


def test_calls_of_any_length_give_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment = load_experiment(ROOT / "configs" / "kowalevski_hk.yaml", ["N=5000", "output.every=7"])

    def rows() -> np.ndarray:
        run = Run(experiment.top, experiment.method(), experiment.y0, experiment.h, 5000, 7)
        return run.collect().states

    def many() -> np.ndarray:
        y0 = np.array([experiment.y0, GEN])
        pieces = []
        run = EnsembleRun(
            experiment.top, experiment.method(), y0, experiment.h, 5000, 7, made=lambda p: p.states.copy()
        )
        pieces = [made for made, _ in run]
        return np.concatenate(pieces, axis=1)

    whole, whole_many = rows(), many()
    monkeypatch.setattr(loop, "FIRST_CALL", 64)
    monkeypatch.setattr(ensemble, "FIRST_CALL", 4)
    monkeypatch.setattr(loop, "CALL_SECONDS", 0.0)
    monkeypatch.setattr(tile, "CALL_SECONDS", 0.0)
    assert (rows() == whole).all()
    assert (many() == whole_many).all()


def test_a_run_stopped_within_a_chunk_resumes_to_the_same_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stopped with more rows of a chunk than a batch holds: the sums over rows must be cut as if never stopped."""
    experiment = load_experiment(ROOT / "configs" / "kowalevski_hk.yaml", ["N=20000"])
    sizes: list[int] = []
    add = InvariantTally.add

    def recording(self, n, states, values) -> None:
        sizes.append(len(n))
        add(self, n, states, values)

    monkeypatch.setattr(InvariantTally, "add", recording)
    whole = run_experiment(experiment, tmp_path / "whole")
    expected, sizes = sizes, []
    with monkeypatch.context() as cut:
        cut.setattr(loop, "CALL_SECONDS", 0.0)
        cut.setattr(loop, "FIRST_CALL", 700)
        asked = iter([False, False])
        stopped = run_experiment(experiment, tmp_path / "cut", RunOptions(stop=lambda: next(asked, True)))
    assert stopped.report["step"] == 701
    sizes.clear()
    result = run_experiment(experiment, tmp_path / "cut", RunOptions(resume=True))
    assert result.status == "resumed"
    assert sizes == expected
    series = [(folder.stored.folder / "series.parquet").read_bytes() for folder in (result, whole)]
    assert series[0] == series[1]
    assert result.report["invariants"] == whole.report["invariants"]
