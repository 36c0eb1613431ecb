"""The order of writes, and what a disk that is full or fails in the middle of them leaves."""

from __future__ import annotations

import itertools
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import topcli
from faults import Disk
from injected import in_fork
from resuming import HK, NAME, content, killed, small
from stored_results import store_comparison, store_ensemble, store_sweep
from sweeping import sweep, with_grid
from topcli.contracts import Outcome
from topcli.engine.run import Run
from topcli.errors import RunError
from topcli.runs.decision import RunOptions
from topcli.runs.run import run_experiment
from topcli.store.checkpoint import CHECKPOINT
from topcli.store.manifest import stored_run, stored_runs
from topcli.store.parts import new_part
from topcli.store.series import read_series

Calls = list[tuple[str, str, str]]


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Calls:
    """Flushes and renames in their order: ("flush", path, "") and ("rename", from, to)."""
    seen: Calls = []
    fsync, rename, replace = os.fsync, os.rename, os.replace

    def flushed(handle: int) -> None:
        seen.append(("flush", os.readlink(f"/proc/self/fd/{handle}"), ""))
        fsync(handle)

    def renamed(source: os.PathLike[str], target: os.PathLike[str], **options: int) -> None:
        rename(source, target, **options)
        seen.append(("rename", os.fspath(source), os.fspath(target)))

    def replaced(source: os.PathLike[str], target: os.PathLike[str], **options: int) -> None:
        replace(source, target, **options)
        seen.append(("rename", os.fspath(source), os.fspath(target)))

    monkeypatch.setattr(os, "fsync", flushed)
    monkeypatch.setattr(os, "rename", renamed)
    monkeypatch.setattr(os, "replace", replaced)
    return seen


pytestmark = [
    pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="names of open files are read from /proc"),
    pytest.mark.usefixtures("small_chunks"),
]


def placed(calls: Calls, target: Path) -> int:
    """Index of the rename that put the run into its place, the only one."""
    (at,) = (i for i, (kind, _, to) in enumerate(calls) if kind == "rename" and to == str(target))
    return at


def test_a_run_is_flushed_whole_before_it_is_renamed_into_its_place(tmp_path: Path, calls: Calls) -> None:
    """Each file, then the manifest, then the folder; then the rename; then the folder of the folders."""
    result = run_experiment(small(), tmp_path)
    target = result.stored.folder
    at = placed(calls, target)
    part = calls[at][1]
    later = {source: to for kind, source, to in calls[:at] if kind == "rename"}
    paths = [Path(later.get(path, path)) for kind, path, _ in calls[:at] if kind == "flush"]
    flushed = [path.name for path in paths if path.parent == Path(part)]
    files = {path.name for path in target.iterdir()}
    assert {"series.parquet", "report.json", "report.md", "config.yaml", "manifest.json"} <= files
    assert files <= set(flushed)
    assert flushed[-1] == "manifest.json"
    (manifest,) = (i for i, (_, _, to) in enumerate(calls) if to == f"{part}/manifest.json")
    folder = max(i for i, (kind, path, _) in enumerate(calls) if kind == "flush" and path == part)
    out = min(i for i, (kind, path, _) in enumerate(calls) if kind == "flush" and path == str(tmp_path) and i > at)
    assert manifest < folder < at < out


def files_put_in_place(calls: Calls, folder: Path) -> list[str]:
    """Names of the files that were renamed below ``folder``: each was flushed just before, its folder just after."""
    found = []
    for i, (kind, source, to) in enumerate(calls):
        if kind == "rename" and Path(to).is_relative_to(folder) and Path(source).suffix and Path(to).name != "lock":
            assert calls[i - 1] == ("flush", source, ""), f"{to} was not flushed before its rename"
            assert calls[i + 1] == ("flush", str(Path(to).parent), ""), f"the folder of {to} was not flushed"
            found.append(Path(to).name)
    return found


def test_a_checkpoint_is_flushed_before_it_replaces_the_earlier_one(tmp_path: Path, calls: Calls) -> None:
    result = run_experiment(small(), tmp_path / "out", RunOptions(checkpoint_every=0.0))
    part = placed(calls, result.stored.folder)
    del calls[part]
    names = files_put_in_place(calls, tmp_path)
    assert names[-1] == "manifest.json"
    assert len(names) > 3
    assert set(names[:-1]) == {"checkpoint.npz"}


def save_page(out: Path) -> None:
    topcli.run("kowalevski_hk", out, N=50, progress=False).save(out / "page.html")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("store", "names"),
    [
        (store_sweep, {"sweep.yaml", "rows.parquet", "manifest.json"}),
        (store_ensemble, {"manifest.json"}),
        (lambda out: store_comparison(out / "compared.json"), {"compared.json"}),
        (save_page, {"manifest.json", "page.html"}),
    ],
)
def test_every_file_is_flushed_before_its_rename_and_its_folder_after(
    tmp_path: Path, calls: Calls, store: Callable[[Path], object], names: set[str]
) -> None:
    store(tmp_path)
    runs = [i for i, (kind, source, _) in enumerate(calls) if kind == "rename" and ".part-" in Path(source).name]
    for i in reversed(runs):
        del calls[i]
    assert set(files_put_in_place(calls, tmp_path)) == names


def failing(patch: pytest.MonkeyPatch, out: Path, only: str, at: int = 1, how: str = "full") -> None:
    """A disk that is full from the operation ``at`` of this kind on, or for this one."""
    Disk(out, at, how, only=only).install(patch.setattr)


@pytest.mark.parametrize("name", ["sweep.yaml", "rows.parquet", "manifest.json"])
def test_a_failed_flush_keeps_the_earlier_table_of_a_sweep(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    sweep(tmp_path)
    before = (tmp_path / "study" / "rows.parquet").read_bytes()
    said = pytest.raises(RunError, match=f"{name}.*: no space left on the device; ")
    with monkeypatch.context() as patch, said:
        failing(patch, tmp_path, rf"fsync \.?{name.partition('.')[0]}")
        sweep(tmp_path, with_grid(h=[0.01, 0.03]))
    rows = (tmp_path / "study" / "rows.parquet").read_bytes()
    assert (rows == before) == (name != "manifest.json")
    assert not list((tmp_path / "study").glob(".*"))
    assert sweep(tmp_path, with_grid(h=[0.01, 0.03])).ran == (2 if name == "sweep.yaml" else 0)


@pytest.mark.parametrize("name", ["report.json", "series.parquet", "manifest.json"])
def test_a_failed_flush_keeps_the_earlier_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    earlier = run_experiment(small(), tmp_path).stored
    content = {path.name: path.read_bytes() for path in earlier.folder.iterdir()}
    with monkeypatch.context() as patch:
        failing(patch, tmp_path, rf"fsync \.?{name.partition('.')[0]}")
        with pytest.raises(RunError, match="no space left"):
            run_experiment(small("h=0.002"), tmp_path, RunOptions(force=True))
    assert {path.name: path.read_bytes() for path in earlier.folder.iterdir()} == content
    found = stored_run(earlier.folder)
    assert found is not None
    assert not found.damage()


def test_a_full_disk_leaves_what_was_written_readable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No checkpoint yet: what reached the disk is kept as an interrupted run, and can be resumed."""
    suffix = "csv"
    experiment = small(f"output.format={suffix}")
    expected = content(run_experiment(experiment, tmp_path / "whole").stored.folder)
    data = read_series(tmp_path / "whole" / NAME / f"series.{suffix}")
    with monkeypatch.context() as patched:
        failing(patched, tmp_path / "out", "write series", 4, "full once")
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
        failing(patched, out, "write series", 6)
        with pytest.raises(RunError, match=r"no space left .* last checkpoint is kept.*\(up to step \d+\)"):
            run_experiment(small(), out, RunOptions(checkpoint_every=0.0))
    assert stored_runs(out) == []
    assert content(run_experiment(small(), out, RunOptions(resume=True)).stored.folder) == expected
    assert [path.name for path in out.iterdir()] == [NAME]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("how", "every"), [("full", 0.0), ("full once", 0.0), ("full once", 1e9), ("power", 0.0), ("power", 1e9)]
)
def test_a_fault_at_any_operation_takes_back_no_checkpoint(tmp_path: Path, how: str, every: float) -> None:
    """With a checkpoint after each chunk of 16 steps, and with none; what a checkpoint claims had been flushed."""
    expected = content(run_experiment(small(), tmp_path / "whole").stored.folder)
    steps = set()
    for at in itertools.count(1, 13 if every == 0.0 else 5):
        out = tmp_path / f"{at}"
        out.mkdir()
        disk, messages = Disk(out, at, how), list[str]()

        def life(disk: Disk = disk, out: Path = out) -> None:
            disk.install()
            run_experiment(small(), out, RunOptions(checkpoint_every=every))

        code, done = in_fork(life), disk.operations()
        assert code == (0 if len(done) < at else -9 if how == "power" else 99)
        if len(done) < at:
            break
        finished = stored_run(out / NAME)
        if finished is None or finished.interrupted:
            claimed = min(16 * (done[: at - 1].count("replace checkpoint.npz") - 1), 300)  # the first one is of step 0
            resumed = run_experiment(small(), out, RunOptions(resume=True, on_message=messages.append))
            found = [int(match[1]) for line in messages if (match := re.search(r"continues from step (\d+)", line))]
            steps.add(step := found[0] if found else 300 if "was complete" in str(messages) else 0)
            assert step >= claimed, f"{how} at {done[-1]}: went back from step {claimed} to {step}"
            assert resumed.stored.folder == out / NAME
        assert content(out / NAME) == expected
        assert [path.name for path in out.iterdir()] == [NAME]
    assert at > 25
    assert len(steps) > (5 if every == 0.0 else 1)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="limits the file size the way Linux does")
def test_a_real_write_failure_through_the_entry_point(tmp_path: Path) -> None:
    """The kernel itself refuses the write: a file may not grow beyond 50 kB."""
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000));"
        "from topcli.__main__ import main;"
        f"sys.argv = ['topcli', 'run', {str(HK)!r}, '--out', {str(tmp_path)!r}, '--quiet'];"
        "main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    assert "size limit" in done.stderr
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_resume_that_fails_at_the_start_keeps_the_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    left = killed(tmp_path, small(), 9)
    before = (left / CHECKPOINT).read_bytes()

    def fails(*paths: Path) -> None:
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as patched:
        patched.setattr(os, "rename", fails)
        with pytest.raises(RunError, match="last checkpoint is kept"):
            run_experiment(small(), tmp_path, RunOptions(resume=True))
    (kept,) = tmp_path.glob(f".{NAME}.part-*/{CHECKPOINT}")
    assert kept.read_bytes() == before
    assert run_experiment(small(), tmp_path, RunOptions(resume=True)).status == "resumed"


def test_a_finished_run_that_cannot_be_put_in_its_place_says_where_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def denied(source: object, target: object) -> None:
        raise PermissionError(13, "Permission denied")

    with monkeypatch.context() as patched:
        patched.setattr(os, "rename", denied)
        with pytest.raises(
            RunError, match=rf"the finished run is kept in .*\.{NAME}\.part-.*--resume puts it"
        ) as caught:
            run_experiment(small(), tmp_path)
    (left,) = tmp_path.iterdir()
    assert str(left) in str(caught.value)
    left.rename(new_part(tmp_path, NAME).with_name(f".{NAME}.part-999999999-00000000"))
    monkeypatch.setattr(Run, "__iter__", None)
    assert run_experiment(small(), tmp_path, RunOptions(resume=True)).outcome is Outcome.COMPLETED


def test_an_output_folder_deleted_meanwhile_is_not_said_to_hold_a_checkpoint(tmp_path: Path) -> None:
    out = tmp_path / "out"

    def progress(done: int, total: int) -> None:
        if done > 150 and out.exists():
            shutil.rmtree(out)

    with pytest.raises(RunError) as caught:
        run_experiment(small(), out, RunOptions(checkpoint_every=0.0, on_progress=progress))
    assert "nothing of this run was stored" in str(caught.value)
    assert "checkpoint is kept" not in str(caught.value)
