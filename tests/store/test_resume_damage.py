"""Full disks, locks, damaged and cut files, kills at any moment: nothing is lost, and what is resumed is right."""

from __future__ import annotations

import errno
import itertools
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from resuming import HK, NAME, content, killed, small
from topcli.errors import RunError, UsageError
from topcli.runs.decision import RunOptions
from topcli.runs.run import run_experiment
from topcli.store import parts
from topcli.store.checkpoint import CHECKPOINT, read_checkpoint
from topcli.store.manifest import stored_run, stored_runs
from topcli.store.parts import lock_new, new_part, parts_of, take_lock
from topcli.store.series import GrowingFile, SeriesWriter, read_metadata, read_series

pytestmark = pytest.mark.usefixtures("small_chunks")


def full_after(monkeypatch: pytest.MonkeyPatch, room: int, forever: bool = True) -> None:
    """A disk that accepts a number of further bytes of series, then nothing, or only bytes freed by truncation."""
    append, used = SeriesWriter._append, [0]

    def limited(self: SeriesWriter, *pieces: bytes) -> None:
        size = sum(map(len, pieces))
        if used[0] + size > room:
            used[0] = room if forever else 0
            raise OSError(errno.ENOSPC, "No space left on device", str(self._path))
        used[0] += size
        append(self, *pieces)

    monkeypatch.setattr(SeriesWriter, "_append", limited)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_a_full_disk_leaves_what_was_written_readable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    """No checkpoint yet: what reached the disk is kept as an interrupted run, and can be resumed."""
    experiment = small(f"output.format={suffix}")
    expected = content(run_experiment(experiment, tmp_path / "whole").stored.folder)
    data = read_series(tmp_path / "whole" / NAME / f"series.{suffix}")
    with monkeypatch.context() as patched:
        full_after(patched, 16_000, forever=False)
        with pytest.raises(RunError, match=rf"series.{suffix}: no space left .* kept, marked interrupted") as caught:
            run_experiment(experiment, tmp_path / "out")
    assert caught.value.exit_code == 1
    stored = stored_run(tmp_path / "out" / NAME)
    assert stored is not None
    assert stored.interrupted
    kept = read_series(stored.series)
    assert 0 < len(kept["t"]) == stored.manifest["step"] + 1 < 301
    assert all((kept[name] == data[name][: len(kept[name])]).all() for name in data)
    assert content(run_experiment(experiment, tmp_path / "out", RunOptions(resume=True)).stored.folder) == expected


def test_a_disk_without_room_for_anything_leaves_the_last_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = content(run_experiment(small(), tmp_path / "whole").stored.folder)
    out = tmp_path / "out"
    with monkeypatch.context() as patched:
        full_after(patched, 16_000)
        with pytest.raises(RunError, match=r"no space left .* last checkpoint holds is kept.*\(up to step \d+\)"):
            run_experiment(small(), out, RunOptions(checkpoint_every=0.0))
    assert stored_runs(out) == []
    assert content(run_experiment(small(), out, RunOptions(resume=True)).stored.folder) == expected
    assert [path.name for path in out.iterdir()] == [NAME]


class Disk:
    """A disk on which the series may have ``room`` bytes, and which refuses its flushes and renames after ``calls``.

    ``claimed`` is the furthest step of a checkpoint that was put in its place.
    """

    def __init__(self, patch: pytest.MonkeyPatch, room: int = 10**9, calls: int = 10**9, forever: bool = True) -> None:
        self.claimed, self.refused = 0, 0
        append, replace, done = GrowingFile.append, os.replace, itertools.count()

        def full() -> None:
            self.refused += 1
            raise OSError(errno.ENOSPC, "No space left on device")

        def limited(file: GrowingFile, *pieces: bytes) -> None:
            if file.length + sum(map(len, pieces)) > room:
                full()
            append(file, *pieces)

        def counted(real: Callable[..., Any]) -> Callable[..., Any]:
            def operation(*arguments: Any, **options: Any) -> Any:
                number = next(done)
                if number == calls or (forever and number > calls):
                    full()
                return real(*arguments, **options)

            return operation

        def put(source: Any, target: Any, **options: Any) -> None:
            replace(source, target, **options)
            if Path(target).name == CHECKPOINT:
                found = read_checkpoint(Path(target).parent)
                assert found is not None
                self.claimed = max(self.claimed, found.done)

        patch.setattr(GrowingFile, "append", limited)
        for name, real in (("replace", put), ("rename", os.rename), ("fsync", os.fsync)):
            patch.setattr(os, name, counted(real))


def failure(out: Path) -> str:
    """Message of a run that fails; empty if it does not."""
    try:
        run_experiment(small(), out, RunOptions(checkpoint_every=0.0))
    except RunError as error:
        return str(error)
    return ""


def resumed_from(out: Path, expected: dict[str, object]) -> int:
    """Step from which the run in ``out`` continues, to the result that it is to have; 300 if it was complete."""
    messages: list[str] = []
    for part in out.glob(".*"):  # as after the end of this process
        part.rename(out / f".{NAME}.part-999999999-00000000")
    run = run_experiment(small(), out, RunOptions(resume=True, on_message=messages.append))
    assert content(run.stored.folder) == expected
    assert [path.name for path in out.iterdir()] == [NAME]
    (step,) = [int(found[1]) for line in messages if (found := re.search(r"continues from step (\d+)", line))] or [
        300 if "was complete" in messages[0] else 0
    ]
    return step


@pytest.mark.slow
@pytest.mark.parametrize("every", [0.0, 1e9])
def test_a_disk_that_is_full_at_any_byte_takes_back_no_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, every: float
) -> None:
    """With a checkpoint after each chunk and with none: an older state fits where the last one does not."""
    expected = content(run_experiment(small(), tmp_path / "whole").stored.folder)
    size = (tmp_path / "whole" / NAME / "series.parquet").stat().st_size
    steps, claims = [], []
    for room in range(0, size, size // 40):
        with monkeypatch.context() as patch:
            disk = Disk(patch, room)
            with pytest.raises(RunError, match="no space left"):
                run_experiment(small(), tmp_path / f"{room}", RunOptions(checkpoint_every=every))
        steps.append(resumed_from(tmp_path / f"{room}", expected))
        claims.append(disk.claimed)
        assert steps[-1] >= claims[-1], f"with room for {room} bytes it went back to step {steps[-1]}"
    assert steps == sorted(steps)
    assert steps[-1] > 200
    assert max(claims) > 200


@pytest.mark.slow
@pytest.mark.parametrize("forever", [True, False])
def test_a_disk_that_is_full_at_any_flush_or_rename_takes_back_no_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, forever: bool
) -> None:
    expected = content(run_experiment(small(), tmp_path / "whole").stored.folder)
    seen = set()
    for calls in itertools.count():
        out = tmp_path / f"{calls}"
        with monkeypatch.context() as patch:
            disk = Disk(patch, calls=calls, forever=forever)
            said = failure(out)
        if not disk.refused:
            break
        assert "no space left on the device" in said
        if (found := stored_run(out / NAME)) is not None and not found.interrupted:
            assert content(out / NAME) == expected
            assert said.endswith("the finished run is in its place")
            continue
        assert ("nothing was" in said) == (not any(out.iterdir()))
        step = resumed_from(out, expected)
        assert step >= disk.claimed, f"with {calls} flushes and renames it went back to step {step}"
        seen.add(step)
    assert calls > 40
    assert len(seen) > 10


def test_a_failed_checkpoint_names_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sync, calls = os.fsync, iter(range(10**6))

    def full(handle: int) -> None:
        if next(calls) >= 9:
            raise OSError(errno.ENOSPC, "No space left on device")
        sync(handle)

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        with pytest.raises(RunError, match="no space left"):
            run_experiment(small("output.every=50"), tmp_path, RunOptions(checkpoint_every=0.0))
    messages: list[str] = []
    run_experiment(small("output.every=50"), tmp_path, RunOptions(resume=True, on_message=messages.append))
    assert "continues from step" in messages[0]


@pytest.mark.slow
def test_living_process_excludes_others(tmp_path: Path) -> None:
    """The lock is the system's: held by a living process, free the moment it is killed."""
    code = (
        "import sys; from pathlib import Path; from topcli.config.load import load_experiment\n"
        "from topcli.runs.decision import RunOptions\n"
        "from topcli.runs.run import run_experiment\n"
        f"experiment = load_experiment({str(HK)!r}, ['N=300'])\n"
        "def wait(done, total):\n"
        "    if done > 200000 or done == total:\n"
        "        print('running', flush=True); sys.stdin.read()\n"
        "run_experiment(experiment, Path(sys.argv[1]), RunOptions(checkpoint_every=0.0, on_progress=wait))\n"
    )
    command = [sys.executable, "-c", code, str(tmp_path)]
    other = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert other.stdout is not None
        assert other.stdout.readline() == "running\n"
        (part,) = parts_of(tmp_path, NAME)
        assert (part.alive, part.owner["pid"]) == (True, other.pid)
        with pytest.raises(UsageError, match=f"process {other.pid} is running this experiment"):
            run_experiment(small(), tmp_path, RunOptions(resume=True))
        messages: list[str] = []
        assert run_experiment(small(), tmp_path, RunOptions(on_message=messages.append)).status == "ran"
        assert messages == [f"{NAME}: process {other.pid} is running this experiment too"]
        assert part.folder.is_dir(), "the other one's folder is left alone"
    finally:
        other.kill()
        other.communicate()
    (part,) = parts_of(tmp_path, NAME)
    assert not part.alive, "a stale lock does not block"
    assert run_experiment(small(), tmp_path, RunOptions(force=True, resume=True)).status in ("resumed", "ran")
    assert parts_of(tmp_path, NAME) == []


@pytest.mark.parametrize("locks", [True, False])
def test_lock_belongs_to_a_living_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, locks: bool) -> None:
    """Without locks, the process number shows if the owner is alive."""
    if not locks:
        monkeypatch.setattr(parts, "fcntl", None)
    folder = new_part(tmp_path, "x")
    folder.mkdir()
    assert take_lock(folder) is None, "just made by a living process"
    mine = lock_new(folder, {"digest": "d"})
    assert parts.owner(folder) == {"pid": os.getpid(), "digest": "d"}
    assert take_lock(folder) is None
    mine.release()
    mine.release()
    if not locks:
        (folder / "lock").write_text('{"pid": 999999999}')
    again = take_lock(folder, {"digest": "e"})
    assert again is not None
    assert parts.owner(folder)["digest"] == "e"
    again.release()


def test_damaged_checkpoint_is_not_resumed(tmp_path: Path) -> None:
    left = killed(tmp_path, small(), 5)
    path = left / CHECKPOINT
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))
    assert read_checkpoint(left) is None
    with pytest.raises(RunError, match=rf"{CHECKPOINT}: damaged .*; nothing was deleted; run without --resume"):
        run_experiment(small(), tmp_path, RunOptions(resume=True))
    assert path.read_bytes() == data


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
@pytest.mark.parametrize("rows", [0, 1, 39, 40, 41, 400])
def test_series_cut_anywhere_resumes_to_the_same_file(tmp_path: Path, suffix: str, rows: int) -> None:
    data = {"n": np.arange(500), "x": np.random.default_rng(1).normal(size=500)}
    whole, cut = tmp_path / f"whole.{suffix}", tmp_path / f"cut.{suffix}"
    cuts = [*range(0, rows, 17), rows]

    def write(writer: SeriesWriter, begin: int, end: int) -> None:
        writer.write({name: values[begin:end] for name, values in data.items()})

    with SeriesWriter(whole, ["n", "x"], {"who": "test"}) as writer:
        for begin, end in zip(cuts, [*cuts[1:], 500], strict=True):
            write(writer, begin, end)
        writer.finish({"end": "yes"})
    with SeriesWriter(cut, ["n", "x"], {"who": "test"}) as writer:
        for begin, end in itertools.pairwise(cuts):
            write(writer, begin, end)
        mark = writer.mark()
        write(writer, rows, min(rows + 90, 500))
    with SeriesWriter(cut, ["n", "x"], {"who": "test"}, mark) as writer:
        write(writer, rows, 500)
        writer.finish({"end": "yes"})
    assert cut.read_bytes() == whole.read_bytes()
    assert all((read_series(cut)[name] == values).all() for name, values in data.items())
    if suffix == "parquet":
        assert pq.read_metadata(cut).metadata[b"end"] == b"yes"
        assert read_metadata(cut)["who"] == "test"


@pytest.mark.slow
def test_many_row_groups_keep_their_places(tmp_path: Path) -> None:
    """Offsets beyond one byte of a varint, and one row group read without the others."""
    path = tmp_path / "series.parquet"
    names = ["n", *(f"x{i}" for i in range(20))]
    data = {name: np.random.default_rng(i).normal(size=40) for i, name in enumerate(names)}
    data["n"] = np.arange(40)
    with SeriesWriter(path, names, {}) as writer:
        for _ in range(300):
            writer.write(data)
        writer.finish({})
    file = pq.ParquetFile(path)
    assert file.num_row_groups == 300
    for index in (0, 1, 150, 299):
        group = file.read_row_group(index)
        assert all((group.column(name).to_numpy() == data[name]).all() for name in names)
    assert pq.read_table(path).num_rows == 12_000


def test_few_rows_in_many_pieces_take_the_memory_of_their_numbers(tmp_path: Path) -> None:
    import tracemalloc

    with SeriesWriter(tmp_path / "series.parquet", ["n", "x"], {}) as writer:
        tracemalloc.start()
        for i in range(39):
            writer.write({"n": np.array([i]), "x": np.array([0.5])})
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 10_000
