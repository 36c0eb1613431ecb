"""Sweeps that are killed, cut short or damaged: no finished row is lost, and no two definitions are mixed."""

from __future__ import annotations

import itertools
import os
import signal
import sqlite3
from pathlib import Path
from typing import Any

import pytest

from faults import Disk
from injected import in_fork
from sweeping import BASE, DATA, MANY, sweep, table, with_grid
from topcli.errors import RunError, UsageError
from topcli.store.result_folder import locked, release
from topcli.studies.verify import check_all
from topcli.sweeps.store import DATABASE, RowStore


def stored(out: Path) -> dict[bytes, Any]:
    """Finished rows by digest."""
    if not (out / "study" / DATABASE).exists():
        return {}
    with RowStore(out / "study") as store:
        return store.read()


@pytest.fixture(autouse=True)
def small_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("topcli.sweeps.run_sweep.BATCH_ROWS", 4)


def killed_at_statement(number: int) -> None:
    """Let this process be killed before statement ``number`` of SQLite."""
    count, connect = itertools.count(1), sqlite3.connect

    def traced(path: Any) -> sqlite3.Connection:
        connection = connect(path)
        connection.set_trace_callback(lambda text: next(count) == number and os.kill(os.getpid(), signal.SIGKILL))
        return connection

    sqlite3.connect = traced


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["statement", "torn", "power"])
def test_a_kill_at_any_moment_loses_no_row_and_runs_none_twice(fault: str, tmp_path: Path) -> None:
    data = {**MANY, "random": {**MANY["random"], "count": 3}}
    sweep(tmp_path / "whole", data, threads=1)
    wanted, kills = repr(table(tmp_path / "whole")), 0
    for at in itertools.count(1, 4):
        out = tmp_path / f"life{at}"

        def life(out: Path = out, at: int = at) -> None:
            killed_at_statement(at) if fault == "statement" else Disk(out, at, fault).install()
            sweep(out, data, threads=1)

        code = in_fork(life)
        before = stored(out)
        result = sweep(out, data, threads=1)
        assert (result.ran, result.finished) == (12 - len(before), 12)
        assert stored(out).items() >= before.items()
        assert repr(table(out)) == wanted
        assert sorted(os.listdir(out / "study")) == sorted(os.listdir(tmp_path / "whole" / "study"))
        assert not check_all("study", out).damage
        kills += code != 0
        if code == 0:
            break
    assert kills > 2


def test_a_full_disk_ends_the_sweep_and_keeps_finished_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    connect = sqlite3.connect

    def small(path: Any) -> sqlite3.Connection:
        connection = connect(path)
        connection.execute("PRAGMA max_page_count = 3")
        return connection

    data = {**DATA, "grid": {"h": [0.0001 * k for k in range(1, 201)]}}
    with monkeypatch.context() as patch:
        patch.setattr("topcli.sweeps.store.sqlite3.connect", small)
        with pytest.raises(RunError, match="database or disk is full; the rows finished before are kept"):
            sweep(tmp_path, data, threads=1)
    kept = len(stored(tmp_path))
    assert 0 < kept < 200
    assert sweep(tmp_path, data).ran == 200 - kept


def test_no_damage_to_the_store_makes_a_wrong_row(tmp_path: Path) -> None:
    """A changed byte is noticed, by SQLite or by the checksum of its row, or rows are missing and run again."""
    sweep(tmp_path)
    path = tmp_path / "study" / DATABASE
    whole, rows, refused = path.read_bytes(), stored(tmp_path), 0
    for place in range(0, len(whole), 13):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1 << place % 8]) + whole[place + 1 :])
        try:
            assert stored(tmp_path).items() <= rows.items(), place
        except RunError:
            refused += 1
    assert refused > 10


def test_a_damaged_store_is_named_and_force_begins_anew(tmp_path: Path) -> None:
    sweep(tmp_path)
    with RowStore(tmp_path / "study") as store:
        assert store._file.execute("PRAGMA synchronous").fetchone() == (2,), "rows are on the disk before they count"
    (tmp_path / "study" / "manifest.json").unlink()  # as if it had been killed
    path = tmp_path / "study" / DATABASE
    path.write_bytes(b"SQLite format 3" + path.read_bytes()[100:])
    with pytest.raises(RunError, match=r"rows.db: damaged .*--force"):
        sweep(tmp_path)
    assert sweep(tmp_path, force=True).ran == 4


def test_a_second_sweep_in_the_folder_is_refused(tmp_path: Path) -> None:
    lock = locked(tmp_path / "study")
    assert lock is not None
    with pytest.raises(UsageError, match="another sweep is running in this folder"):
        sweep(tmp_path)
    release(tmp_path / "study", lock)
    assert sweep(tmp_path).finished == 4


def test_rows_of_other_definitions_are_kept_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows of a changed file that were finished before do not run again."""
    sweep(tmp_path)
    first = repr(table(tmp_path))
    assert sweep(tmp_path / "changed").ran == 4
    assert sweep(tmp_path / "changed", with_grid(h=[0.02, 0.04])).ran == 2
    assert [row["h"] for row in table(tmp_path / "changed")] == [0.02, 0.04] * 2
    assert sweep(tmp_path / "changed", with_grid(**{"top.c0": [1.0, 2.0]})).ran == 4, "those of the base are known"
    others: list[dict[str, Any]] = [
        {**DATA, "base": {**BASE, "N": 50}},
        {**DATA, "base": {**BASE, "output": {"every": 2}}},
        {**DATA, "base": {**BASE, "top": {"kind": "kowalevski", "c0": 2.0}}},
        {**DATA, "measure": ["max_deviation.two_l"]},
        {**DATA, "measure": ["max_deviation.energy", "steps"]},
        with_grid(scheme=["midpoint", {"name": "hk", "compensated": True}]),
    ]
    for count, data in enumerate(others, 2):
        assert sweep(tmp_path, data).ran == 4, data
        assert len(stored(tmp_path)) == 4 * count
        assert repr(table(tmp_path)) != first
    assert sweep(tmp_path).ran == 0
    assert repr(table(tmp_path)) == first, "the rows that were kept belong to the first file again"
    for name in ("code_digest", "definition_texts"):
        with monkeypatch.context() as patch:
            patch.setattr("topcli.sweeps.run_sweep.code_of_process", lambda code=name: code)
            patch.setattr(f"topcli.sweeps.run_sweep.{name}", lambda *parts: ["other"] if len(parts) == 1 else "other")
            assert sweep(tmp_path).ran == 4, name


def test_force_renames_the_earlier_folder_and_other_folders_are_refused(tmp_path: Path) -> None:
    sweep(tmp_path)
    messages: list[str] = []
    assert sweep(tmp_path, force=True, on_message=messages.append).ran == 4
    (earlier,) = (path for path in tmp_path.iterdir() if path.name != "study")
    assert messages == [f"renamed the earlier sweep to {earlier}"]
    assert (earlier / "rows.parquet").read_bytes()
    (tmp_path / "other" / "study").mkdir(parents=True)
    (tmp_path / "other" / "study" / "notes.txt").write_text("mine")
    with pytest.raises(UsageError, match="exists and is not a sweep; nothing was written"):
        sweep(tmp_path / "other")
    assert os.listdir(tmp_path / "other" / "study") == ["notes.txt"]
