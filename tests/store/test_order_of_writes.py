"""The order of writes: what is flushed to the disk before what is renamed, and what a failure in the middle leaves."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import topcli
from resuming import small
from stored_results import store_comparison, store_ensemble, store_sweep
from sweeping import sweep, with_grid
from topcli.errors import RunError
from topcli.runs.decision import RunOptions
from topcli.runs.run import run_experiment
from topcli.store.checkpoint import read_checkpoint
from topcli.store.manifest import stored_run

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


def test_a_checkpoint_is_flushed_before_it_replaces_the_earlier_one(
    tmp_path: Path, calls: Calls, small_chunks: None
) -> None:
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


def test_a_sweep_is_flushed_in_the_order_in_which_its_files_vouch_for_each_other(tmp_path: Path, calls: Calls) -> None:
    """The folder of the sweep, the file, the rows, the manifest; the journal at the end at the latest."""
    sweep(tmp_path)
    assert calls[0] == ("flush", str(tmp_path), "")
    renamed = [Path(to).name for kind, _, to in calls if kind == "rename"]
    assert renamed == ["sweep.yaml", "rows.parquet", "manifest.json"]
    assert ("flush", str(tmp_path / "study" / "journal.jsonl"), "") in calls


def being_written(handle: int) -> tuple[str, str]:
    """Name of an open file, and the one that it gets when it is complete."""
    name = Path(os.readlink(f"/proc/self/fd/{handle}")).name
    return name, re.sub(r"^\.(\w+)\.\d+", r"\1", name)


@contextmanager
def flush_failing(name: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """Every flush of the file ``name`` fails for a full disk; yields the names of the failures."""
    fsync, failed = os.fsync, []

    def full(handle: int) -> None:
        if name in being_written(handle):
            failed.append(name)
            raise OSError(28, "No space left on device")
        fsync(handle)

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        yield failed


@pytest.mark.parametrize("name", ["sweep.yaml", "rows.parquet", "manifest.json"])
def test_a_failed_flush_keeps_the_earlier_table_of_a_sweep(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    sweep(tmp_path)
    before = (tmp_path / "study" / "rows.parquet").read_bytes()
    said = pytest.raises(RunError, match=f"{name}.*: no space left on the device; ")
    with flush_failing(name, monkeypatch) as failed, said:
        sweep(tmp_path, with_grid(h=[0.01, 0.03]))
    assert failed
    rows = (tmp_path / "study" / "rows.parquet").read_bytes()
    assert (rows == before) == (name != "manifest.json")
    assert not list((tmp_path / "study").glob(".*"))
    assert sweep(tmp_path, with_grid(h=[0.01, 0.03])).ran == (2 if name == "sweep.yaml" else 0)


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
    run_experiment(small(), tmp_path, RunOptions(checkpoint_every=0.0))
    assert len(set(claimed)) > 3


@pytest.mark.parametrize("name", ["report.json", "series.parquet", "manifest.json"])
def test_a_failed_flush_keeps_the_earlier_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    earlier = run_experiment(small(), tmp_path).stored
    content = {path.name: path.read_bytes() for path in earlier.folder.iterdir()}
    with flush_failing(name, monkeypatch) as failed, pytest.raises(RunError, match="no space left"):
        run_experiment(small("h=0.002"), tmp_path, RunOptions(force=True))
    assert failed
    assert {path.name: path.read_bytes() for path in earlier.folder.iterdir()} == content
    found = stored_run(earlier.folder)
    assert found is not None
    assert not found.damage()


def test_three_different_runs_keep_three(tmp_path: Path) -> None:
    folders = [run_experiment(small(f"h={h}"), tmp_path, RunOptions(force=True)).stored for h in (0.001, 0.002, 0.003)]
    digests = {run.manifest["digest"] for run in folders}
    kept = [stored_run(path) for path in tmp_path.iterdir() if path.is_dir()]
    assert {run.manifest["digest"] for run in kept if run} == digests
    assert len(kept) == 3
