"""Sweeps: what runs, what is kept, and that a row has the numbers of a run by itself."""

from __future__ import annotations

import errno
import json
import os
import pickle
import random
import time
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from attack.command import fork, start
from topcli.config.load import experiment_from
from topcli.config.sweep import sweep_from
from topcli.config.sweep_rows import RowReader
from topcli.errors import RunError, UsageError
from topcli.studies.simulate import trajectory_of
from topcli.studies.sweep import evaluate as seam
from topcli.studies.sweep.batches import batches
from topcli.studies.sweep.evaluate import Results, Work, evaluate_batch
from topcli.studies.sweep.journal import Block, Journal
from topcli.studies.sweep.run import SweepOptions, SweepResult, Watcher, find_row, in_threads, planned, run_sweep

BASE: dict[str, Any] = {
    "top": "kowalevski",
    "initial": {"omega": [0.7, -0.4, 1.3], "gamma": [0.6, 0.48, 0.64]},
    "scheme": "hk",
    "h": 0.01,
    "N": 60,
}
DATA: dict[str, Any] = {
    "name": "study",
    "base": BASE,
    "grid": {"scheme": ["hk", "rk4"], "h": [0.01, 0.02]},
    "measure": ["deviation.energy"],
}


def sweep(out: Path, data: dict[str, Any] = DATA, watcher: Watcher | None = None, **options: Any) -> SweepResult:
    return run_sweep(sweep_from(data), out, SweepOptions(**options), watcher or Watcher())


def table(out: Path, name: str = "study") -> list[dict[str, Any]]:
    return pq.read_table(out / name / "rows.parquet").to_pylist()


def with_grid(**grid: Any) -> dict[str, Any]:
    return {**DATA, "grid": {**DATA["grid"], **grid}}


def deviation(row: dict[str, Any], out: Path) -> float:
    """Largest deviation of the energy of a row that is run by itself, by its formula."""
    one = trajectory_of(experiment_from(find_row(out / "study", row["row"])[1].config("one")))
    w, g = one.states[:, :3], one.states[:, 3:]
    energy = w[:, 0] ** 2 + w[:, 1] ** 2 + 0.5 * w[:, 2] ** 2 + g[:, 0]  # A = 2, c0 = 1
    return float(np.abs(energy - energy[0]).max())


def test_a_sweep_writes_a_tidy_table(tmp_path: Path) -> None:
    result = sweep(tmp_path)
    assert (result.finished, result.ran, result.failed, result.outcomes) == (4, 4, 0, {"completed": 4})
    found = pq.read_table(tmp_path / "study" / "rows.parquet")
    names = ["row", "scheme", "h", "outcome", "message", "deviation.energy", "digest", "cpu", "current"]
    assert found.column_names == names
    assert [str(kind) for kind in found.schema.types] == [
        "int64",
        "string",
        "double",
        "string",
        "string",
        "double",
        "string",
        "string",
        "bool",
    ]
    described = json.loads(found.schema.metadata[b"topcli.sweep"])
    assert described["name"] == "study"
    assert described["keys"] == ["scheme", "h"]
    assert described["measures"] == ["deviation.energy"]
    assert described["log"] == []
    rows = found.to_pylist()
    assert [(row["row"], row["scheme"], row["h"]) for row in rows] == [
        (0, "hk", 0.01),
        (1, "hk", 0.02),
        (2, "rk4", 0.01),
        (3, "rk4", 0.02),
    ]
    assert all(row["current"] and row["message"].startswith("completed 60 steps") for row in rows)
    assert json.loads((tmp_path / "study" / "manifest.json").read_text())["rows"] == 4


def test_finished_rows_never_run_again(tmp_path: Path) -> None:
    sweep(tmp_path)
    before = (tmp_path / "study" / "journal.jsonl").read_bytes()
    result = sweep(tmp_path)
    assert (result.ran, result.finished) == (0, 4)
    assert (tmp_path / "study" / "journal.jsonl").read_bytes() == before


def test_a_changed_file_runs_only_new_rows_and_keeps_the_others(tmp_path: Path) -> None:
    sweep(tmp_path)
    changed = with_grid(h=[0.02, 0.04])
    plan, changes = planned(sweep_from(changed), tmp_path, SweepOptions())
    assert (plan.to_run, plan.done, plan.left) == (2, 2, 2)
    assert plan.reasons() == {"new": 2}
    assert changes == ["grid.h: [0.01, 0.02] -> [0.02, 0.04]"]
    assert sweep(tmp_path, changed).ran == 2
    rows = table(tmp_path)
    assert [(row["row"], row["h"], row["current"]) for row in rows] == [
        (0, 0.02, True),
        (1, 0.04, True),
        (2, 0.02, True),
        (3, 0.04, True),
        (-1, 0.01, False),
        (-1, 0.01, False),
    ]
    assert sweep(tmp_path).ran == 0, "the rows that were kept belong to the first file again"


def test_a_new_key_at_the_value_of_the_base_keeps_the_rows(tmp_path: Path) -> None:
    sweep(tmp_path)
    assert sweep(tmp_path, with_grid(**{"top.c0": [1.0, 2.0]})).ran == 4


def test_a_new_measure_runs_the_rows_again(tmp_path: Path) -> None:
    sweep(tmp_path)
    more = {**DATA, "measure": ["deviation.energy", "steps"]}
    assert planned(sweep_from(more), tmp_path, SweepOptions())[0].reasons() == {"a measure is new": 4}
    assert sweep(tmp_path, more).ran == 4
    assert [row["steps"] for row in table(tmp_path)] == [60.0] * 4
    assert sweep(tmp_path).ran == 0


def test_changed_code_of_a_scheme_runs_its_rows_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from topcli.studies.sweep import plan as planning

    sweep(tmp_path)
    real = planning.method_fingerprint
    codes: list[str] = []

    def changed(method: Any) -> str:
        codes.append(real(method))
        return codes[-1] if len(codes) == 1 else "0" * 64

    monkeypatch.setattr(planning, "method_fingerprint", changed)
    plan, _ = planned(sweep_from(DATA), tmp_path, SweepOptions())
    assert plan.reasons() == {"the code of the scheme changed": 2}
    assert plan.status.tolist() == [0, 0, 2, 2]


FAILING = {**DATA, "grid": {"h": [0.01, 3.0, 0.02]}, "base": {**BASE, "scheme": "rk4"}}


def test_a_failed_row_stays_a_row(tmp_path: Path) -> None:
    messages: list[tuple[int, str]] = []
    result = sweep(tmp_path, FAILING, Watcher(failure=lambda row, outcome, message: messages.append((row.number, outcome))))
    assert messages == [(1, "blew_up")]
    assert (result.failed, result.finished) == (1, 3)
    row = table(tmp_path)[1]
    assert row["outcome"] == "blew_up"
    assert row["message"].startswith("blew up at step ")
    assert np.isnan(row["deviation.energy"])
    again = sweep(tmp_path, FAILING)
    assert (again.ran, again.failed) == (0, 1)
    assert sweep(tmp_path, FAILING, retry_failed=True).ran == 1


def test_fail_fast_stops_and_keeps_what_is_finished(tmp_path: Path) -> None:
    data = {**FAILING, "grid": {"h": [3.0, *[0.001 * k for k in range(1, 41)]]}}
    result = sweep(tmp_path, data, fail_fast=True, threads=1)
    assert 1 <= result.finished < 41
    assert result.failed == 1
    assert not (tmp_path / "study" / "manifest.json").exists()
    rest = sweep(tmp_path, data)
    assert rest.ran == 41 - result.finished
    assert rest.outcomes == {"blew_up": 1, "completed": 40}


def test_a_row_that_cannot_become_a_run_is_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = seam.BatchRun

    class Broken(real):  # type: ignore[misc, valid-type]
        def finished(self, initial: Any) -> Any:
            if (initial[:, 0] == 0.25).any():
                raise RunError("no luck")
            return super().finished(initial)

    monkeypatch.setattr(seam, "BatchRun", Broken)
    data = {**DATA, "grid": {"initial.omega1": [0.125, 0.25, 0.5]}}
    result = sweep(tmp_path, data)
    assert result.outcomes == {"completed": 2, "failed": 1}
    assert [(row["outcome"], row["message"] == "no luck") for row in table(tmp_path)] == [
        ("completed", False),
        ("failed", True),
        ("completed", False),
    ]


@pytest.mark.slow
def test_a_row_beyond_its_time_limit_is_stopped(tmp_path: Path) -> None:
    data = {**DATA, "base": {**BASE, "N": 10**9, "output": {"every": 10**8}}, "grid": {"h": [1e-9]}}
    began = time.perf_counter()
    result = sweep(tmp_path, data, time_limit=0.3)
    assert time.perf_counter() - began < 10.0
    assert result.outcomes == {"interrupted": 1}
    assert not result.interrupted
    assert table(tmp_path)[0]["message"].endswith("the time limit is 0.3 s")
    assert sweep(tmp_path, data).ran == 0
    assert sweep(tmp_path, data, retry_failed=True, time_limit=0.3).ran == 1


def test_an_interrupted_sweep_continues(tmp_path: Path) -> None:
    data = {**DATA, "grid": {"h": [0.001 * k for k in range(1, 21)]}}
    asked: list[int] = []
    watcher = Watcher(progress=lambda done, total, failed: asked.append(done), stop=lambda: bool(asked))
    result = sweep(tmp_path, data, watcher, threads=1)
    assert result.interrupted
    assert 0 < result.finished < 20
    rest = sweep(tmp_path, data)
    assert (rest.ran, rest.finished, rest.interrupted) == (20 - result.finished, 20, False)
    assert [row["row"] for row in table(tmp_path)] == list(range(20))


def test_a_full_disk_ends_the_sweep_and_keeps_finished_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = {**DATA, "grid": {"h": [0.001 * k for k in range(1, 21)]}}
    real, calls = os.pwrite, [0]

    def full(handle: int, content: bytes, offset: int) -> int:
        calls[0] += 1
        if calls[0] == 3:
            real(handle, content[:10], offset)
            raise OSError(errno.ENOSPC, "no space left on device")
        return real(handle, content, offset)

    with monkeypatch.context() as patch:
        # the lock's entry is written in this way, too
        patch.setattr(os, "pwrite", full)
        with pytest.raises(RunError, match="no space left on the device; the rows finished before are kept"):
            sweep(tmp_path, data, threads=1)
    kept = len(finished_digests(tmp_path / "study"))
    assert kept > 0
    assert sweep(tmp_path, data).ran == 20 - kept


def test_an_unfinished_sweep_has_no_manifest(tmp_path: Path) -> None:
    sweep(tmp_path)
    manifest = tmp_path / "study" / "manifest.json"
    assert manifest.exists()
    assert not sweep(tmp_path, with_grid(h=[0.03]), Watcher(stop=lambda: True)).finished
    assert not manifest.exists()


def test_no_batch_begins_after_a_stop() -> None:
    rows = list(RowReader(sweep_from(MANY)).rows())
    begun: list[int] = []

    class Counted(Work):
        def __call__(self, rows: Any, stop: Any = None) -> Results:
            begun.append(len(rows))
            return Results()

    made = ([row] for row in rows)
    assert len(list(in_threads(1)(made, Counted(()), lambda: len(begun) >= 3))) < 8
    assert next(made)[0].number < 8


def test_equal_rows_are_computed_once(tmp_path: Path) -> None:
    data = {**DATA, "include": [{"scheme": "hk", "h": 0.01}]}
    result = sweep(tmp_path, data)
    assert (result.ran, result.finished) == (4, 5)
    rows = table(tmp_path)
    assert rows[4]["row"] == 4
    assert rows[4]["digest"] == rows[0]["digest"]
    assert rows[4]["deviation.energy"] == rows[0]["deviation.energy"]


MANY = {
    **DATA,
    "random": {"count": 40, "omega": {"sphere": 1}, "gamma": "sphere"},
    "measure": ["deviation.energy", "drift.energy", "swings"],
}


def without_origin(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{key: value for key, value in row.items() if key not in ("row", "cpu", "scheme", "h")} for row in rows]


def test_a_row_has_the_bits_of_a_run_by_itself(tmp_path: Path) -> None:
    sweep(tmp_path, MANY)
    rows = table(tmp_path)
    assert len(rows) == 160
    for row in rows[::31]:
        assert row["deviation.energy"] == deviation(row, tmp_path)


@pytest.mark.slow
def test_a_row_does_not_depend_on_the_rest_of_the_sweep(tmp_path: Path) -> None:
    sweep(tmp_path / "all", MANY, threads=2)
    rows = table(tmp_path / "all")
    alone = []
    for number in (0, 57, 130, 159):
        data = find_row(tmp_path / "all" / "study", number)[1].config("x")
        one = {
            "name": "study",
            "base": {key: data[key] for key in ("top", "initial", "scheme")},
            "include": [{"h": data["h"], "N": data["N"]}],
            "measure": MANY["measure"],
        }
        sweep(tmp_path / str(number), one)
        alone += [
            {key: row[key] for key in without_origin(rows)[0] if key != "sample"}
            for row in table(tmp_path / str(number))
        ]
    wanted = [{key: rows[number][key] for key in alone[0]} for number in (0, 57, 130, 159)]
    assert repr(alone) == repr(wanted)


@pytest.mark.slow
@pytest.mark.parametrize("lanes", [1, 10**9])
def test_lanes_do_not_change_a_bit(lanes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = list(RowReader(sweep_from(MANY)).rows())
    usual = evaluate_batch(rows, MANY["measure"])
    monkeypatch.setattr(seam, "LANE_ROWS", lanes)
    monkeypatch.setattr(seam, "LANE_STEPS", lanes)
    other = evaluate_batch(list(reversed(rows)), MANY["measure"])
    for name, values in usual.values.items():
        assert np.array_equal(values, other.values[name][::-1], equal_nan=True)
    assert usual.message == other.message[::-1]


def test_batches_hold_every_row_once_and_are_bounded() -> None:
    rows = list(RowReader(sweep_from(MANY)).rows())
    made = list(batches(iter(rows), 2))
    assert sorted(row.number for batch in made for row in batch) == list(range(160))
    assert len(made) >= 8
    assert max(sum(row.N for row in batch) for batch in made) <= 160 * 60 // 8 + 1


def test_work_can_be_done_in_another_process_in_any_order(tmp_path: Path) -> None:
    def backend(made: Any, work: Work, stop: Any) -> Any:
        for batch in reversed(list(made)):
            sent = pickle.loads(pickle.dumps((work, batch)))
            yield batch, pickle.loads(pickle.dumps(sent[0](sent[1])))

    sweep(tmp_path / "here", MANY)
    run_sweep(sweep_from(MANY), tmp_path / "there", backend=backend)
    assert repr(table(tmp_path / "there")) == repr(table(tmp_path / "here"))


def test_a_torn_line_of_the_journal_is_cut_off_and_its_rows_run_again(tmp_path: Path) -> None:
    sweep(tmp_path)
    path = tmp_path / "study" / "journal.jsonl"
    whole = path.read_bytes()
    lines = whole.splitlines(keepends=True)
    lost = len(json.loads(lines[-1][9:])["digest"])
    path.write_bytes(whole[:-7])
    result = sweep(tmp_path)
    assert (result.ran, result.finished) == (lost, 4)
    assert all(line.endswith(b"}\n") for line in path.read_bytes().splitlines(keepends=True))
    assert path.read_bytes().startswith(b"".join(lines[:-1]))


def test_a_torn_line_longer_than_what_follows_leaves_nothing(tmp_path: Path) -> None:
    sweep(tmp_path)
    path = tmp_path / "study" / "journal.jsonl"
    whole = path.read_bytes()
    path.write_bytes(whole + b"0" * 100_000)
    assert sweep(tmp_path).ran == 0
    assert path.read_bytes() == whole


def test_a_damaged_line_is_reported_and_its_rows_run_again(tmp_path: Path) -> None:
    sweep(tmp_path)
    path = tmp_path / "study" / "journal.jsonl"
    content = bytearray(path.read_bytes())
    lost = len(json.loads(content.splitlines()[0][9:])["digest"])
    content[content.index(b'"deviation.energy":[') + 22] ^= 1  # a digit
    path.write_bytes(content)
    messages: list[str] = []
    result = sweep(tmp_path, watcher=Watcher(message=messages.append))
    assert (result.ran, result.finished) == (lost, 4)
    assert messages == [f"warning: {path}: 1 damaged lines; their rows run again"]


def test_the_later_of_two_entries_of_a_row_counts(tmp_path: Path) -> None:
    def block(digest: str, outcome: str) -> Block:
        return Block([digest], [outcome], ["m"], ["c"], {"h": [0.1]}, {"x": [1.0]}, "cpu")

    with Journal(tmp_path, write=True) as journal:
        journal.append(block("aa" * 32, "blew_up"))
        journal.append(block("bb" * 32, "completed"))
        journal.append(block("aa" * 32, "completed"))
        for index in (journal.index(),):
            assert index.completed.tolist() == [True, True]
            assert index.block.tolist() == [2, 1]
    with Journal(tmp_path) as journal:
        assert journal.index().block.tolist() == [2, 1]
        assert journal.block(0).outcome == ["blew_up"]


@pytest.mark.slow
def test_a_second_sweep_in_the_folder_is_refused_while_the_first_lives(tmp_path: Path) -> None:
    data = {**DATA, "base": {**BASE, "N": 10**9, "output": {"every": 10**8}}, "grid": {"h": [1e-9]}}
    pid = fork(lambda: sweep(tmp_path, data).failed)
    try:
        lock = tmp_path / "study" / "lock"
        deadline = time.monotonic() + 20.0
        while not (lock.exists() and lock.stat().st_size) and time.monotonic() < deadline:
            time.sleep(0.01)
        with pytest.raises(UsageError, match=rf"another sweep \(process {pid}\) is running in this folder"):
            sweep(tmp_path)
    finally:
        os.kill(pid, 9)
        os.waitpid(pid, 0)
    assert sweep(tmp_path).finished == 4, "the lock dies with its process"


def test_a_folder_that_is_no_sweep_is_refused(tmp_path: Path) -> None:
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "notes.txt").write_text("mine")
    with pytest.raises(UsageError, match="exists and is not a sweep; nothing was written"):
        sweep(tmp_path)
    assert os.listdir(tmp_path / "study") == ["notes.txt"]


def test_what_a_process_killed_at_its_start_has_left_is_no_obstacle(tmp_path: Path) -> None:
    (tmp_path / "study").mkdir()
    for name in ("lock", ".sweep.123.yaml", ".rows.123.parquet"):
        (tmp_path / "study" / name).write_text("{")
    assert sweep(tmp_path).finished == 4
    found = sorted(os.listdir(tmp_path / "study"))
    assert found == ["journal.jsonl", "lock", "manifest.json", "rows.parquet", "sweep.yaml"]


def test_very_many_rows_need_a_confirmation(tmp_path: Path) -> None:
    data = {**DATA, "grid": {"h": {"from": 0.1, "to": 1.0, "count": 100_001}}}
    with pytest.raises(UsageError, match="100001 rows; a sweep of more than 100000 needs --yes"):
        sweep(tmp_path, data)
    assert not (tmp_path / "study").exists()
    planned(sweep_from({**data, "grid": {"h": [0.1]}}), tmp_path, SweepOptions())
    assert not (tmp_path / "study").exists()


@pytest.mark.slow
def test_series_are_stored_where_asked_for(tmp_path: Path) -> None:
    sweep(tmp_path, {**DATA, "store": "series"})
    rows = table(tmp_path)
    for row in rows:
        series = pq.read_table(tmp_path / "study" / "series" / row["digest"][:16] / "series.parquet")
        energy = np.array(series["energy"])
        assert np.abs(energy - energy[0]).max() == row["deviation.energy"]
    assert len(os.listdir(tmp_path / "study" / "series")) == 4


@pytest.mark.slow
def test_thirty_kills_lose_nothing_and_run_nothing_twice(tmp_path: Path) -> None:
    data = {
        **MANY,
        "random": {**MANY["random"], "count": 60},
        "base": {**BASE, "N": 50_000, "output": {"every": 50}},
        "measure": ["deviation.energy", "drift.energy"],
    }
    file = tmp_path / "study.yaml"
    file.write_text(sweep_from(data).to_yaml())
    began = time.perf_counter()
    sweep(tmp_path / "whole", data)
    began = time.perf_counter()
    sweep(tmp_path / "timed", data)
    span = time.perf_counter() - began
    wanted = without_origin(table(tmp_path / "whole"))
    draw, kills, resumed = random.Random(12), 0, 0
    for life in range(100):
        out, patience, known = tmp_path / f"life{life}", 1.0, 0
        while True:
            running = start(
                ["sweep", str(file), "--out", str(out)], tmp_path, [out, Path(os.environ["NUMBA_CACHE_DIR"])]
            )
            if kills < 30:
                time.sleep(draw.uniform(0.0, 1.2 * patience * span))
                running.kill()
            said = running.finish()
            digests = finished_digests(out / "study")
            assert len(digests) == len(set(digests)), "a row ran twice"
            assert len(digests) >= known, "a finished row was lost"
            resumed += known > 0
            patience = 1.0 if len(digests) > known else 1.3 * patience
            known = len(digests)
            if said.code == 0:
                break
            assert said.code == -9, said.err
            kills += 1
        assert repr(without_origin(table(out))) == repr(wanted)
        if kills >= 30:
            break
    assert kills >= 30
    assert resumed >= 5


def finished_digests(folder: Path) -> list[str]:
    """Digests in the complete lines of the journal."""
    path = folder / "journal.jsonl"
    lines = path.read_bytes().splitlines(keepends=True) if path.exists() else []
    return [digest for line in lines if line.endswith(b"\n") for digest in json.loads(line[9:])["digest"]]
