"""A row that takes long or for ever costs no other row; time is that of an injected clock."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conftest import GEN
from sweeping import BASE, DATA, sweep, table
from topcli.analysis.reference import reference_states
from topcli.config.rows import Row, RowReader
from topcli.config.sweep import load_sweep
from topcli.contracts import StopAsked, check_stop, stopping_when
from topcli.errors import RunError
from topcli.runs import references
from topcli.runs.references import SharedReferences, reference_of
from topcli.sweeps import row_results
from topcli.sweeps.row_results import Results, Work, results_of_rows, unfinished
from topcli.tops.kowalevski import Kowalevski

ERRORS = {**DATA, "grid": {"initial.omega1": [0.25, 0.5, 0.75]}, "measure": ["max_error", "steps"]}


def rows_of(data: dict[str, Any]) -> list[Row]:
    return list(RowReader(load_sweep(data)).rows())


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The clock of the sweep, in seconds, which nothing but the test advances."""
    now = [100.0]
    monkeypatch.setattr(row_results.time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(references, "REFERENCES", SharedReferences())
    return now


@pytest.fixture
def slow_reference(clock: list[float], monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """References that take a second for each question whether to stop: ten, or a hundred from omega1 = 0.5."""

    def slow(top: Any, y0: Any, t: Any, most: int) -> Any:
        for _ in range(100 if y0[0] == 0.5 else 10):
            clock[0] += 1.0
            check_stop()
        return reference_states(top, y0, t, most)

    monkeypatch.setattr(references, "reference_states", slow)
    return clock


def test_a_stop_during_a_reference_leaves_the_row_unfinished(slow_reference: list[float]) -> None:
    found = results_of_rows(rows_of(ERRORS), ERRORS["measure"], lambda: slow_reference[0] > 130.0)
    assert found.done == [True, False, False]
    assert slow_reference[0] == 131.0


def test_finished_rows_do_not_wait_for_those_of_a_slow_batch(
    tmp_path: Path, clock: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each row takes 0.9 s: a call hands over three, and the rest of its batch is called again."""
    finished = row_results.Measuring.finished

    def slow(self: Any, initial: Any, stop: Any) -> Any:
        clock[0] += 0.9 * len(initial)
        return finished(self, initial, stop)

    monkeypatch.setattr(row_results.Measuring, "finished", slow)
    data = {**ERRORS, "grid": {"initial.omega1": [0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5]}, "measure": ["steps"]}
    rows = rows_of(data)
    found = Work(("steps",))(rows)
    assert found.done == [True] * 3 + [False] * 4
    assert unfinished(rows, found) == rows[3:]
    monkeypatch.setattr("topcli.sweeps.run.batches", lambda made, *arguments: [list(made)])
    assert sweep(tmp_path, data, threads=1).outcomes == {"completed": 7}
    lines = (tmp_path / "study" / "journal.jsonl").read_text().splitlines()
    assert [len(json.loads(line.partition(" ")[2])["digest"]) for line in lines] == [3, 3, 1]


def test_a_call_that_was_stopped_is_not_repeated() -> None:
    rows = rows_of(DATA)
    assert unfinished(rows, Results(done=[False] * len(rows))) == []
    assert unfinished(rows, Results(done=[True] * len(rows))) == []


def test_a_refused_reference_is_refused_to_all_rows_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []

    def refuse(top: Any, y0: Any, t: Any, most: int) -> Any:
        calls.append(most)
        raise RunError(f"no {len(calls)}")

    monkeypatch.setattr(references, "reference_states", refuse)
    shared = SharedReferences()
    for n, said in ((3, "no 1"), (3, "no 1"), (4, "no 2")):
        with pytest.raises(RunError, match=said):
            shared.states(reference_of(Kowalevski()), np.array(GEN), 0.1, np.arange(n))
    assert calls == [1_000_000] * 2


def test_a_long_closed_form_stops_when_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    from topcli.tops.euler import Euler

    monkeypatch.setattr(references, "CLOSED_STATES", 10)
    euler, y0, n = reference_of(Euler()), np.array([0.3, 0.2, 1.0]), np.arange(95)
    whole = SharedReferences().states(euler, y0, 0.1, n)
    monkeypatch.setattr(references, "CLOSED_STATES", 1 << 16)
    assert np.array_equal(SharedReferences().states(euler, y0, 0.1, n), whole)
    monkeypatch.setattr(references, "CLOSED_STATES", 10)
    asked = iter([False] * 4 + [True])
    with stopping_when(lambda: next(asked)), pytest.raises(StopAsked):
        SharedReferences().states(euler, y0, 0.1, n)


@pytest.mark.slow
def test_hopeless_scales_are_outcomes_and_missing_values(tmp_path: Path) -> None:
    """A small edition of 13 schemes at h, c0 and omega1 from 5e-324 to 1e306."""
    data = {
        "name": "study",
        "base": {**BASE, "initial": {"omega": [0, 0, 0], "gamma": ["auto", 0, 0.1]}, "N": 2},
        "grid": {
            "scheme": ["hk", "exact", "taylor", "dop853", "backlund"],
            "h": [5e-324, -0.01, 1e150],
            "top.c0": [5e-324, 1e306],
            "initial.omega1": [5e-324, 2, 1e306],
        },
        "measure": ["max_error"],
    }
    failures: list[str] = []
    result = sweep(tmp_path, data, on_failure=lambda row, outcome, message: failures.append(message))
    found = table(tmp_path)
    assert result.finished == len(found) == 5 * 3 * 2 * 3
    assert [row["message"] for row in found if "internal" in row["message"]] == []
    for row in found:
        reason = row["message"].partition("max_error: ")[2]
        if row["outcome"] == "completed" and row["scheme"] != "backlund":
            assert np.isnan(row["max_error"]) == bool(reason)
        assert not reason or reason.startswith("the reference would need at least ")
    assert {row["scheme"] for row in found if "max_error" in row["message"]} == {"hk"}
    refused = [row["message"] for row in found if (row["scheme"], row["outcome"]) == ("exact", "failed")]
    assert len(refused) == 13
    assert all(text.startswith("kowalevski, scheme exact: ") for text in refused)
    assert {row["outcome"] for row in found if row["scheme"] == "taylor"} == {"completed", "no_convergence"}
