"""The order of writes: what is flushed to the disk before what is renamed, and what a failure in the middle leaves."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from resuming import small
from topcli.errors import RunError
from topcli.store.checkpoint import read_checkpoint
from topcli.store.manifest import stored_run
from topcli.studies.run import run_experiment

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


pytestmark = pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="names of open files are read from /proc")


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
    flushed = [Path(path).name for kind, path, _ in calls[:at] if kind == "flush" and Path(path).parent == Path(part)]
    files = {path.name for path in target.iterdir()}
    assert {"series.parquet", "report.json", "report.md", "config.yaml", "manifest.json"} <= files
    assert files <= set(flushed)
    assert flushed[-1] == "manifest.json"
    manifest = max(i for i, (_, path, _) in enumerate(calls) if path == f"{part}/manifest.json")
    folder = max(i for i, (kind, path, _) in enumerate(calls) if kind == "flush" and path == part)
    out = min(i for i, (kind, path, _) in enumerate(calls) if kind == "flush" and path == str(tmp_path) and i > at)
    assert manifest < folder < at < out


def test_a_checkpoint_is_flushed_before_it_replaces_the_earlier_one(
    tmp_path: Path, calls: Calls, small_chunks: None
) -> None:
    run_experiment(small(), tmp_path, checkpoint_every=0.0)
    renames = [i for i, (kind, _, to) in enumerate(calls) if kind == "rename" and to.endswith("checkpoint.npz")]
    assert len(renames) > 2
    for i in renames:
        source, to = calls[i][1:]
        assert calls[i - 1] == ("flush", source, "")
        assert calls[i + 1] == ("flush", str(Path(to).parent), "")


def test_a_checkpoint_vouches_for_rows_that_are_on_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, small_chunks: None
) -> None:
    """When a checkpoint is put in its place the series has been flushed at least as far as it says."""
    fsync, replace = os.fsync, os.replace
    flushed, claimed = [0], []

    def flush(handle: int) -> None:
        fsync(handle)
        if Path(os.readlink(f"/proc/self/fd/{handle}")).stem == "series":
            flushed.append(os.fstat(handle).st_size)

    def put(source: os.PathLike[str], target: os.PathLike[str]) -> None:
        replace(source, target)
        if Path(target).name == "checkpoint.npz":
            found = read_checkpoint(Path(target).parent)
            assert found is not None
            claimed.append(found.series.length)
            assert claimed[-1] <= flushed[-1]

    monkeypatch.setattr(os, "fsync", flush)
    monkeypatch.setattr(os, "replace", put)
    run_experiment(small(), tmp_path, checkpoint_every=0.0)
    assert len(set(claimed)) > 3


@pytest.mark.parametrize("name", ["report.json", "series.parquet", "manifest.json"])
def test_a_failed_flush_keeps_the_earlier_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    earlier = run_experiment(small(), tmp_path).stored
    content = {path.name: path.read_bytes() for path in earlier.folder.iterdir()}
    fsync, failed = os.fsync, []

    def full(handle: int) -> None:
        if Path(os.readlink(f"/proc/self/fd/{handle}")).name == name:
            failed.append(name)
            raise OSError(28, "No space left on device")
        fsync(handle)

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(RunError, match="no space left"):
            run_experiment(small("h=0.002"), tmp_path, force=True)
    assert failed
    assert {path.name: path.read_bytes() for path in earlier.folder.iterdir()} == content
    found = stored_run(earlier.folder)
    assert found is not None
    assert not found.damage()


def test_three_different_runs_keep_three(tmp_path: Path) -> None:
    folders = [run_experiment(small(f"h={h}"), tmp_path, force=True).stored for h in (0.001, 0.002, 0.003)]
    digests = {run.manifest["digest"] for run in folders}
    kept = [stored_run(path) for path in tmp_path.iterdir() if path.is_dir()]
    assert {run.manifest["digest"] for run in kept if run} == digests
    assert len(kept) == 3
