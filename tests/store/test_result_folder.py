"""The rules of the store: nothing is lost, whoever computes, whatever fails, and whenever it is killed."""

from __future__ import annotations

import contextlib
import errno
import itertools
import os
import shutil
import signal
from pathlib import Path

import pytest

from counting import CHUNK, NAME, compute, counted, tree
from faults import Disk
from injected import fork, in_fork
from topcli.errors import RunError, UsageError
from topcli.store import result_folder
from topcli.store.result_folder import ResultFolder, being_computed
from topcli.store.results import intact_result, read_result, stored_results

FILES = {"manifest.json", "report.json", "series.parquet"}
OTHER = counted(h=0.2)
KILLS = [("torn", 1, False), ("power", 5, True)]
STATUS = ("ran", "continued", "up to date")


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("topcli.store.growing_table.ROW_GROUP", 40)
    monkeypatch.setattr(result_folder, "LOOK_SECONDS", 0.001)
    monkeypatch.setattr(os, "fsync", lambda handle: None)


def data(folder: Path) -> dict[str, bytes]:
    """Files of a result that do not hold times."""
    return {name: content for name, content in tree(folder).items() if name != "manifest.json"}


def whole(folder: Path) -> bool:
    result = read_result(folder)
    return result is not None and result.complete and not result.damage()


def killed_after(chunks: int) -> object:
    """``on_chunk`` that ends the process in the middle of the chunk after the first ``chunks``."""
    asked = itertools.count(1)
    return lambda n: os.kill(os.getpid(), signal.SIGKILL) if next(asked) > chunks else None


def stopped_after(chunks: int) -> object:
    asked = itertools.count(1)
    return lambda n: next(asked) >= chunks


@pytest.mark.slow
@pytest.mark.parametrize(("how", "every", "earlier"), KILLS)
def test_a_kill_at_any_operation_loses_nothing(
    tmp_path: Path, how: str, every: int, earlier: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also while an earlier, different result makes way; a second kill hits the life that continues.

    A torn operation is one half of which is done; where power fails, what was not flushed is gone.
    """
    monkeypatch.setattr("counting.N", 3 * CHUNK)
    compute(tmp_path / "whole", every=every)
    expected = data(tmp_path / "whole" / NAME)
    first = tmp_path / "first"
    first.mkdir()
    if earlier:
        compute(first, OTHER)
    before = data(first / NAME)
    for at in itertools.count(1):
        out = shutil.copytree(first, tmp_path / str(at))
        disk, again = Disk(out, at, how), Disk(out, 2 * at % 17 + 1, how)
        code = in_fork(lambda disk=disk, out=out: (disk.install(), compute(out, every=every, force=earlier), 0)[2])
        done = disk.operations()
        assert code == (0 if len(done) < at else -9)
        assert not earlier or any(data(path) == before for path in out.iterdir() if path.is_dir())
        if len(done) < at:
            break
        read_result(out / NAME)  # whole or missing
        retry = earlier and NAME in os.listdir(out) and data(out / NAME) == before
        in_fork(lambda disk=again, out=out, retry=retry: (disk.install(), compute(out, every=every, force=retry))[0])
        retry = earlier and NAME in os.listdir(out) and data(out / NAME) == before
        compute(out, every=every, force=retry)
        assert whole(out / NAME)
        assert data(out / NAME) == expected
        assert set(os.listdir(out / NAME)) == FILES
        aside = set(os.listdir(out)) - {NAME, f".{NAME}.lock"}
        assert aside == ({f"{NAME}-{OTHER.key}"} if earlier else set())
        assert not earlier or whole(out / f"{NAME}-{OTHER.key}")
    assert at > 40


@pytest.mark.slow
@pytest.mark.parametrize(("how", "form"), [("full", "parquet"), ("full once", "csv")])
def test_a_full_disk_is_reported_and_loses_nothing(tmp_path: Path, how: str, form: str) -> None:
    identity = counted(form=form)
    compute(tmp_path / "whole", identity)
    expected = data(tmp_path / "whole" / NAME)
    for at in itertools.count(1):
        out = tmp_path / str(at)
        out.mkdir()
        with pytest.MonkeyPatch.context() as patch:
            disk = Disk(out, at, how).install(patch.setattr)
            with contextlib.suppress(RunError):
                compute(out, identity)
        if len(disk.operations()) < at:
            break
        compute(out, identity)
        assert data(out / NAME) == expected
        assert set(os.listdir(out)) <= {NAME, f".{NAME}.lock"}
    assert at > 40


@pytest.mark.slow
@pytest.mark.parametrize("chunks", [0, 3, None])
def test_what_a_result_does_when_it_is_in_the_way(tmp_path: Path, chunks: int | None) -> None:
    """Begun without a checkpoint, killed after three chunks, complete."""
    begin = (lambda: compute(tmp_path, OTHER)) if chunks is None else None
    in_fork(begin or (lambda: compute(tmp_path, OTHER, on_chunk=killed_after(chunks))))
    before = tree(tmp_path / NAME)
    if chunks == 0:
        assert compute(tmp_path) == "ran"
        assert os.listdir(tmp_path) == [NAME]
        return
    with pytest.raises(UsageError, match=r"holds a different experiment \(h: 0\.2 stored, 0\.1 requested\)") as caught:
        compute(tmp_path)
    assert "--force" in str(caught.value)
    assert tree(tmp_path / NAME) == before
    for code, form in (("c", "parquet"), ("d", "parquet"), ("d", "csv")):
        identity = counted(h=0.2, code=code * 64, form=form)  # other code and another format need no --force
        assert compute(tmp_path, identity, force=code == "c") == "ran"
        assert compute(tmp_path, identity) == "up to date"
    assert compute(tmp_path, force=True) == "ran"
    other = counted(h=0.2, code="d" * 64).key
    aside = [f"{NAME}-{OTHER.key}", f"{NAME}-{OTHER.key}-2", f"{NAME}-{other}", f"{NAME}-{other}-2"]
    assert sorted(os.listdir(tmp_path)) == sorted([NAME, *aside])
    assert tree(tmp_path / aside[0]) == before
    assert all(whole(tmp_path / name) for name in aside[1:])


@pytest.mark.parametrize("force", [False, True])
def test_foreign_files_stay(tmp_path: Path, force: bool) -> None:
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "mine.txt").write_text("mine")
    place = tmp_path / "out" / NAME
    place.parent.mkdir()
    for make in (
        lambda: place.write_text("mine"),
        lambda: place.symlink_to("nowhere"),
        lambda: place.symlink_to(tmp_path / "notes"),
        lambda: shutil.copytree(tmp_path / "notes", place),
    ):
        make()
        with pytest.raises(UsageError, match="exists and is no result of topcli"):
            compute(tmp_path / "out", force=force)
        assert os.listdir(tmp_path / "out") == [NAME]
        assert "mine" in (place.read_text() if place.is_file() else os.listdir(tmp_path / "notes")[0])
        shutil.rmtree(place) if place.is_dir() and not place.is_symlink() else place.unlink()
    place.mkdir()
    assert compute(tmp_path / "out", force=force) == "ran"


def test_files_of_a_user_stay(tmp_path: Path) -> None:
    """In a result that makes way, in one that has just begun, and in one that is computed through a link."""
    compute(tmp_path)
    (tmp_path / NAME / "notes.txt").write_text("mine")
    compute(tmp_path, force=True)
    aside = tmp_path / f"{NAME}-{counted().key}"
    assert (aside / "notes.txt").read_text() == "mine"
    with ResultFolder.claim(tmp_path / NAME, OTHER, force=True) as folder:
        (folder.stored.folder / "notes.txt").write_text("mine")
    assert (tmp_path / NAME / "notes.txt").read_text() == "mine"
    (tmp_path / "linked").mkdir()
    (tmp_path / "linked" / NAME).symlink_to(aside)
    assert compute(tmp_path / "linked") == "up to date"
    assert compute(tmp_path / "linked", OTHER, force=True) == "ran"
    assert whole(aside)


def test_a_second_process_is_refused_until_the_first_has_ended(tmp_path: Path) -> None:
    (computing, begun), asked = os.pipe(), itertools.count()

    def holder() -> str:
        return compute(
            tmp_path, on_chunk=lambda n: os.write(begun, b"x") and signal.pause() if next(asked) == 3 else None
        )

    first = fork(lambda: STATUS.index(holder()))
    os.close(begun)
    assert os.read(computing, 1) == b"x"
    os.close(computing)
    assert being_computed(tmp_path / NAME)
    for force in (False, True):
        with pytest.raises(RunError, match="another process is computing this result"):
            compute(tmp_path, force=force)
    os.kill(first, signal.SIGKILL)
    os.waitpid(first, 0)
    assert not being_computed(tmp_path / NAME)
    assert compute(tmp_path) == "continued"
    assert os.listdir(tmp_path) == [NAME]


def flip(path: Path, place: int) -> None:
    content = bytearray(path.read_bytes())
    content[place] ^= 1
    path.write_bytes(content)


def test_a_damaged_checkpoint_is_never_continued(tmp_path: Path) -> None:
    compute(tmp_path / "whole")
    in_fork(lambda: compute(tmp_path / "out", on_chunk=killed_after(3)))
    path = tmp_path / "out" / NAME / "unfinished" / "checkpoint.npz"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    before = tree(tmp_path / "out" / NAME)
    with pytest.raises(RunError, match=r"checkpoint\.npz: damaged .*--force"):
        compute(tmp_path / "out")
    assert tree(tmp_path / "out" / NAME) == before
    assert compute(tmp_path / "out", force=True) == "ran"
    assert data(tmp_path / "out" / NAME) == data(tmp_path / "whole" / NAME)


def test_results_are_listed_whatever_their_state(tmp_path: Path) -> None:
    compute(tmp_path, OTHER)
    compute(tmp_path, on_chunk=stopped_after(1), force=True)
    (tmp_path / "plain").mkdir()
    outcomes = {name: result.outcome for name, result in stored_results(tmp_path).items()}
    assert outcomes == {NAME: "interrupted", f"{NAME}-{OTHER.key}": "completed"}
    assert stored_results(tmp_path / "none") == {}
    shutil.rmtree(tmp_path / NAME)
    in_fork(lambda: compute(tmp_path, on_chunk=killed_after(2)))
    assert stored_results(tmp_path)[NAME].outcome is None
    with pytest.raises(UsageError, match="the run is unfinished; run it again to continue it"):
        intact_result(tmp_path / NAME)
    with pytest.raises(UsageError, match=r"no run is stored here .*did you mean"):
        intact_result(tmp_path / NAME[:-1])


def test_places_that_cannot_be_written_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compute(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match=r"output folder .*file: cannot be written to"):
        compute(tmp_path / "file")

    def denied(*arguments: object, **options: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    with monkeypatch.context() as patch:
        patch.setattr("tempfile.TemporaryFile", denied)
        assert compute(tmp_path) == "up to date"
        with pytest.raises(UsageError, match=r"cannot be written to .*choose another with --out"):
            compute(tmp_path, force=True)

    def without_locks(handle: int, mode: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", without_locks)
    with pytest.raises(RunError, match=r"the file system has no locks \(No locks available\)"):
        compute(tmp_path, force=True)
    assert whole(tmp_path / NAME)
