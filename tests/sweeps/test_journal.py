"""Sweeps that are stopped, killed or damaged: nothing finished is lost or run twice."""

from __future__ import annotations

import errno
import itertools
import json
import os
import signal
import sys
import tracemalloc
import zlib
from pathlib import Path
from typing import Any

import pytest

from faults import Disk
from injected import fork, in_fork
from sweeping import DATA, MANY, sweep, table, without_origin
from topcli.config.sweep import load_sweep
from topcli.errors import RunError, UsageError
from topcli.studies.health import check_all
from topcli.sweeps.journal import FinishedRows, Journal, damaged_lines
from topcli.sweeps.plan import survey


def test_an_interrupted_sweep_continues(tmp_path: Path) -> None:
    data = {**DATA, "grid": {"h": [0.001 * k for k in range(1, 21)]}}
    asked: list[int] = []
    after_one = {"on_progress": lambda done, total, note: asked.append(done), "stop": lambda: bool(asked)}
    result = sweep(tmp_path, data, threads=1, **after_one)
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
    assert damaged_lines(tmp_path / "study" / "journal.jsonl") == 0, "what was written of the line is cut off"
    kept = len(finished_digests(tmp_path / "study"))
    assert kept > 0
    assert sweep(tmp_path, data).ran == 20 - kept


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
    content[content.index(b'"max_deviation.energy":[') + 26] ^= 1  # a digit
    path.write_bytes(content)
    messages: list[str] = []
    result = sweep(tmp_path, on_message=messages.append)
    assert (result.ran, result.finished) == (lost, 4)
    assert messages == [f"warning: {path}: 1 damaged lines; their rows run again"]


def test_the_later_of_two_entries_of_a_row_counts(tmp_path: Path) -> None:
    def block(digest: str, outcome: str) -> FinishedRows:
        return FinishedRows([digest], [outcome], ["m"], ["c"], {"h": [0.1]}, {"x": [1.0]}, "cpu")

    with Journal(tmp_path, write=True) as journal:
        journal.append(block("aa" * 32, "blew_up"))
        journal.append(block("bb" * 32, "completed"))
        journal.append(block("aa" * 32, "completed"))
        for index in (journal.index(),):
            assert index.rows["completed"].tolist() == [True, True]
            assert index.rows["block"].tolist() == [2, 1]
    with Journal(tmp_path) as journal:
        assert journal.index().rows["block"].tolist() == [2, 1]
        assert journal.block(0).outcome == ["blew_up"]


def test_the_journal_is_flushed_every_two_seconds_and_at_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows come every 0.75 s of a clock that the test sets."""
    times = {"now": 50.0}
    flushes = Disk(tmp_path, only="fsync journal.jsonl").install(monkeypatch.setattr)
    seen: list[int] = []
    with Journal(tmp_path, write=True, clock=lambda: times["now"]) as journal:
        for i in range(8):
            times["now"] += 0.75
            journal.append(FinishedRows([f"{i:064x}"], ["completed"], [""], ["c"], {"h": [0.1]}, {"x": [1.0]}, "cpu"))
            seen.append(flushes.count)
    assert seen == [0, 0, 1, 1, 1, 2, 2, 2], "after 2.25 s each time: the first moment that is 2 s or more later"
    assert flushes.count == 3


@pytest.mark.slow
def test_a_second_sweep_in_the_folder_is_refused_while_the_first_lives(tmp_path: Path) -> None:
    """The first one says when it writes its file, which is after it has locked the folder, and waits there."""
    begun, says = os.pipe()

    def first() -> int:
        def wait() -> None:
            os.write(says, b"!")
            signal.pause()

        Disk(tmp_path, 1, meanwhile=wait, only="replace").install()
        return sweep(tmp_path).failed

    pid = fork(first)
    os.close(says)
    try:
        assert os.read(begun, 1) == b"!", "the first sweep ended before it wrote its file"
        with pytest.raises(UsageError, match="another sweep is running in this folder"):
            sweep(tmp_path)
    finally:
        os.close(begun)
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
    assert sweep(tmp_path).finished == 4, "the lock dies with its process"


@pytest.mark.slow
def test_a_kill_at_any_write_loses_nothing_and_runs_nothing_twice(tmp_path: Path) -> None:
    """Killed before each operation on the disk in turn, twice in each life; a row of the journal is torn."""
    data = {**MANY, "random": {**MANY["random"], "count": 12}}
    sweep(tmp_path / "whole", data, threads=2)
    wanted = repr(without_origin(table(tmp_path / "whole")))
    kills = resumed = 0
    for at in itertools.count(1, 2):
        out, known, codes = tmp_path / f"life{at}", 0, []
        for how, moment in (("torn", at), ("before", 4 + at % 7), ("before", 0)):

            def life(out: Path = out, how: str = how, moment: int = moment) -> None:
                Disk(out, moment, how).install()
                sweep(out, data, threads=2)

            codes.append(in_fork(life))
            digests = finished_digests(out / "study")
            assert len(digests) == len(set(digests)), "a row ran twice"
            assert len(digests) >= known, "a finished row was lost"
            kills, resumed, known = kills + (codes[-1] != 0), resumed + (known > 0), len(digests)
        assert codes[1:] == [-signal.SIGKILL, 0]
        assert codes[0] in (0, -signal.SIGKILL)
        assert known == 48
        assert repr(without_origin(table(out))) == wanted
        checked = check_all(str(out / "study"), out)
        assert (checked.finished, checked.damage) == (True, {})
        assert sorted(os.listdir(out / "study")) == sorted(os.listdir(tmp_path / "whole" / "study"))
        if codes[0] == 0:
            break
    assert at > 20, "fewer operations than a sweep has"
    assert kills >= 20
    assert resumed >= 10


def finished_digests(folder: Path) -> list[str]:
    """Digests in the complete lines of the journal."""
    path = folder / "journal.jsonl"
    lines = path.read_bytes().splitlines(keepends=True) if path.exists() else []
    return [digest for line in lines if line.endswith(b"\n") for digest in json.loads(line[9:])["digest"]]


@pytest.mark.parametrize(
    ("number", "expected"), [(errno.ENOSPC, RunError), (errno.EIO, RunError), (errno.EROFS, UsageError)]
)
def test_a_full_or_failing_disk_is_no_wrong_usage(
    number: int, expected: type[Exception], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(path: Path) -> None:
        raise OSError(number, os.strerror(number))

    with monkeypatch.context() as patch:
        patch.setattr("topcli.sweeps.run.sync", fails)
        with pytest.raises(expected):
            sweep(tmp_path)
    assert sweep(tmp_path).finished == 4


@pytest.mark.parametrize(
    "change",
    [
        {"digest": ["x" * 64] * 2},
        {"outcome": ["completed"]},
        {"message": [1, 2]},
        {"keys": {"h": [0.1]}},
        {"values": {"x": [1.0, "2"]}},
        {"cpu": None},
        {"more": 1},
    ],
)
def test_a_line_that_no_sweep_has_written_is_damaged(tmp_path: Path, change: dict[str, Any]) -> None:
    block = FinishedRows(
        ["aa" * 32, "bb" * 32], ["completed"] * 2, [""] * 2, ["c"] * 2, {"h": [1, 2]}, {"x": [1.0, 2.0]}, ""
    )
    for extra, damaged in (({}, 0), (change, 1)):
        text = json.dumps({**block.__dict__, **extra}).encode()
        (tmp_path / "journal.jsonl").write_bytes(b"%08x %s\n" % (zlib.crc32(text), text))
        with Journal(tmp_path) as journal:
            assert journal.damaged == damaged
            assert len(journal.index().rows) == (0 if damaged else 2)


def test_every_flipped_bit_and_every_cut_of_a_journal_is_found(tmp_path: Path) -> None:
    sweep(tmp_path, {**DATA, "grid": {"h": [0.01]}})
    (tmp_path / "study" / "manifest.json").unlink()
    path = tmp_path / "study" / "journal.jsonl"
    whole = path.read_bytes()
    assert not check_all(str(tmp_path / "study"), tmp_path).damage
    for place in range(len(whole)):
        for bit in (0, place % 7 + 1):
            path.write_bytes(whole[:place] + bytes([whole[place] ^ 1 << bit]) + whole[place + 1 :])
            assert damaged_lines(path) > 0, (place, bit)
    for length in range(1, len(whole)):
        path.write_bytes(whole[:length])
        assert damaged_lines(path) == 1
    assert check_all(str(tmp_path / "study"), tmp_path).damage


def test_verify_covers_the_journal_of_a_finished_sweep(tmp_path: Path) -> None:
    sweep(tmp_path)
    path = tmp_path / "study" / "journal.jsonl"
    assert not check_all("study", tmp_path).damage
    path.write_bytes(path.read_bytes().replace(b"\n", b"", 1))
    assert list(check_all("study", tmp_path).damage) == [path.name]


@pytest.mark.slow
def test_a_large_sweep_is_planned_in_bounded_memory_and_operations() -> None:
    """Measured: 18 bytes are kept for each row, at most 36 are taken, and a row costs 98 calls of functions."""

    def data(rows: int) -> dict[str, Any]:
        return {**DATA, "grid": {"scheme": ["hk", "rk4"], "h": {"from": 1e-3, "to": 1e-2, "count": rows // 2}}}

    def calls(rows: int) -> int:
        found, count = load_sweep(data(rows)), [0]

        def seen(frame: object, event: str, argument: object) -> None:
            count[0] += event in ("call", "c_call")

        sys.setprofile(seen)
        try:
            survey(found)
        finally:
            sys.setprofile(None)
        return count[0]

    calls(1000)
    few, many = calls(1000), calls(2000)
    assert (many - few) / 1000 < 110
    found = load_sweep(data(100_000))
    tracemalloc.start()
    try:
        surveyed = survey(found)
        assert surveyed.count == 100_000
        kept, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert kept < 26 * 100_000
    assert peak < 60 * 100_000
