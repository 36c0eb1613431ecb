"""Folders that somebody else wrote to: bad manifests and locks, links, foreign files, folders that vanish."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from resuming import NAME, after, content, killed, small
from topcli.contracts import Outcome
from topcli.engine.loop import Run
from topcli.errors import RunError, UsageError
from topcli.runs.decision import RunOptions
from topcli.runs.run import run_experiment
from topcli.store import manifest as manifest_module
from topcli.store.checkpoint import CHECKPOINT, read_checkpoint
from topcli.store.manifest import MANIFEST, DamagedRun, read_run, stored_run, stored_runs
from topcli.store.parts import LOCK, new_part, owner, remove_own, remove_remains

pytestmark = pytest.mark.usefixtures("small_chunks")

DEEP = '{"a":' * 100_000
BLOW_UP = ("scheme=rk4", "h=40", "initial.omega=[1e6, 1e6, 1e6]")


def with_entry(key: str, value: Any) -> Callable[[dict[str, Any]], str]:
    """The text of a manifest with one entry changed; ``key`` is a path with dots, ``None`` removes the entry."""

    def text(manifest: dict[str, Any]) -> str:
        *path, last = key.split(".")
        inner = manifest
        for name in path:
            inner = inner[name]
        if value is None:
            del inner[last]
        else:
            inner[last] = value
        return json.dumps(manifest)

    return text


HOSTILE: dict[str, Callable[[dict[str, Any]], str]] = {
    "empty": lambda manifest: "",
    "half": lambda manifest: json.dumps(manifest)[:200],
    "a list": lambda manifest: "[]",
    "null": lambda manifest: "null",
    "deep": lambda manifest: DEEP,
    "deep inside": lambda manifest: json.dumps(manifest)[:-1] + ', "x": ' + "[" * 100_000 + "]" * 100_000 + "}",
    "long number": lambda manifest: json.dumps(manifest)[:-1] + ', "x": ' + "9" * 10_000 + "}",
    "no UTF-8": lambda manifest: json.dumps(manifest).replace("kowalevski", "\udcff"),
    "no files": with_entry("files", {}),
    "files a list": with_entry("files", []),
    "file elsewhere": with_entry("files", {"../../x": 3, "series.parquet": 3}),
    "file size text": with_entry("files", {"series.parquet": "3"}),
    "file size nan": with_entry("files", {"series.parquet": float("nan")}),
    "file hash short": with_entry("files", {"series.parquet": {"size": 3, "sha256": "../x"}}),
    "digest number": with_entry("digest", 1),
    "digest path": with_entry("digest", "../../x"),
    "digest gone": with_entry("digest", None),
    "code a list": with_entry("code", [1]),
    "series elsewhere": with_entry("series", "../other/series.parquet"),
    "series hidden": with_entry("series", ".ssh"),
    "outcome unknown": with_entry("outcome", "splendid"),
    "N nan": with_entry("config.N", float("nan")),
    "N huge": with_entry("config.N", 10**300),
    "h nan": with_entry("config.h", float("nan")),
    "h text": with_entry("config.h", "small"),
    "config text": with_entry("config", "x"),
    "scheme text": with_entry("config.scheme", "hk"),
    "step text": with_entry("step", "x"),
    "file name of escapes": with_entry("files", {"\x1b[31mred": 3, "series.parquet": 3}),
    "version": with_entry("manifest_version", 99),
    "long words": with_entry("ended", "x" * 100_000),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", HOSTILE)
def test_damaged_manifest_is_reported_as_damage(cli, in_tmp: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    results = in_tmp / "results"
    folder = run_experiment(small(), results).stored.folder
    run_experiment(small("name=fine"), results)
    text = HOSTILE[kind](json.loads((folder / MANIFEST).read_text()))
    (folder / MANIFEST).write_bytes(text.encode("utf-8", "surrogateescape"))
    found = read_run(folder)
    assert isinstance(found, DamagedRun)
    assert len(found.reason) < 300
    assert found.reason.isprintable()
    listed = cli("list", "runs", "--json").json()["runs"]
    assert [(run["name"], run["outcome"]) for run in listed] == [("fine", "completed"), (NAME, "damaged")]
    assert cli("list", "runs").code == 0
    monkeypatch.setattr(Run, "__iter__", None)  # refused before anything is computed
    for more in ((), ("--force",), ("--resume",), ("--dry-run",)):
        said = cli("run", "kowalevski_hk", "--name", "kowalevski_hk", "--set", "N=300", *more)
        assert said.code == 2
        assert f"results/{NAME}: holds a damaged run ({MANIFEST}: " in said.err
        assert len(said.err) < 1000
    said = cli("verify", NAME)
    assert said.code == 1
    assert said.err.startswith(f"error: results/{NAME}/{MANIFEST}: damaged: ")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_named_pipe_in_place_of_a_manifest_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / MANIFEST)
    assert read_run(tmp_path) == DamagedRun(tmp_path, f"{MANIFEST}: no regular file")


@pytest.mark.slow
def test_thousands_of_runs_are_listed_at_once(tmp_path: Path) -> None:
    text = (run_experiment(small(), tmp_path).stored.folder / MANIFEST).read_text()
    for i in range(2000):
        (tmp_path / f"run{i}").mkdir()
        (tmp_path / f"run{i}" / MANIFEST).write_text(text)
    began = time.process_time()
    assert len(stored_runs(tmp_path)) == 2001
    assert time.process_time() - began < 0.6  # typically 0.1; 20,000 runs are to be listed within 2 s


LOCKS = {
    "deep": DEEP,
    "list": "[]",
    "pid text": '{"pid": "x"}',
    "pid nan": '{"pid": NaN}',
    "pid huge": '{"pid": 1e400}',
    "pid negative": '{"pid": -1}',
    "pid large": '{"pid": 99999999999999999999999}',
    "binary": "\udcff\udcfe",
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", LOCKS)
def test_damaged_lock_is_ignored(tmp_path: Path, kind: str) -> None:
    expected = content(run_experiment(small(), tmp_path / "whole").stored.folder)
    left = killed(tmp_path, small(), 9)
    (left / LOCK).write_bytes(LOCKS[kind].encode("utf-8", "surrogateescape"))
    assert owner(left) == {}
    assert content(run_experiment(small(), tmp_path, RunOptions(resume=True)).stored.folder) == expected


def test_damaged_checkpoint_is_not_read(tmp_path: Path) -> None:
    left = killed(tmp_path, small(), 9)
    path = left / CHECKPOINT
    data, random = path.read_bytes(), np.random.default_rng(3)
    for place, bit in zip(random.integers(0, len(data), 100), random.integers(0, 8, 100), strict=True):
        path.write_bytes(data[:place] + bytes([data[place] ^ 1 << bit]) + data[place + 1 :])
        assert read_checkpoint(left) is None
    for cut in (0, 10, 40, len(data) - 1):
        path.write_bytes(data[:cut])
        assert read_checkpoint(left) is None
    path.write_bytes(data)
    assert read_checkpoint(left) is not None


def test_foreign_files_in_a_part_are_kept_and_do_no_harm(tmp_path: Path) -> None:
    expected = content(run_experiment(small(), tmp_path / "whole").stored.folder)
    out = tmp_path / "out"
    left = killed(out, small(), 9)
    (left / ".ipynb_checkpoints").mkdir()
    (left / ".ipynb_checkpoints" / "notes").write_text("remember")
    (left / ".secret").write_text("mine")
    folder = run_experiment(small(), out, RunOptions(resume=True)).stored.folder
    assert content(folder) == expected
    assert (folder / ".ipynb_checkpoints" / "notes").read_text() == "remember"
    assert (folder / ".secret").read_text() == "mine"


def test_a_resume_that_fails_at_the_start_keeps_the_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    left = killed(tmp_path, small(), 9)
    before = (left / CHECKPOINT).read_bytes()

    def fails(*paths: Path) -> None:
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as patched:
        patched.setattr(os, "rename", fails)
        with pytest.raises(RunError, match="last checkpoint holds is kept"):
            run_experiment(small(), tmp_path, RunOptions(resume=True))
    (kept,) = tmp_path.glob(f".{NAME}.part-*/{CHECKPOINT}")
    assert kept.read_bytes() == before
    assert run_experiment(small(), tmp_path, RunOptions(resume=True)).status == "resumed"


def test_dead_parts_are_swept_of_our_own_files_alone(tmp_path: Path) -> None:
    part = tmp_path / f".{NAME}.part-999999999-00000000"
    part.mkdir()
    for name in ("series.parquet", "report.json", "reserve", ".checkpoint.npz"):
        (part / name).write_text("x")
    (part / "thesis.tex").write_text("years of work")
    remove_remains(tmp_path, NAME)
    assert [path.name for path in part.iterdir()] == ["thesis.tex"]
    (part / "thesis.tex").unlink()
    remove_own(part)
    assert not part.exists()


def test_linked_parts_are_ignored(tmp_path: Path) -> None:
    elsewhere = killed(tmp_path / "elsewhere", small(), 9)
    (elsewhere / ".secret").write_text("mine")
    before = sorted(path.name for path in elsewhere.iterdir())
    out = tmp_path / "out"
    out.mkdir()
    link = out / f".{NAME}.part-999999999-00000000"
    link.symlink_to(elsewhere)
    messages: list[str] = []
    assert run_experiment(small(), out, RunOptions(resume=True, on_message=messages.append)).status == "ran"
    assert "nothing to resume" in messages[0]
    assert link.is_symlink()
    assert sorted(path.name for path in elsewhere.iterdir()) == before


@pytest.mark.parametrize("name", [LOCK, "series.parquet", "report.md"])
def test_a_linked_file_in_a_part_is_not_written_through(tmp_path: Path, name: str) -> None:
    left = killed(tmp_path, small(), 9)
    precious = tmp_path / "precious"
    precious.write_text("years of work")
    (left / name).unlink(missing_ok=True)
    (left / name).symlink_to(precious)
    with contextlib.nullcontext() if name == LOCK else pytest.raises(UsageError, match="is not a regular file"):
        run_experiment(
            small(), tmp_path, RunOptions(resume=True)
        )  # nobody knows who holds a lock that is a link: left alone
    assert precious.read_text() == "years of work"


@pytest.mark.parametrize("kind", ["same", "different", "nothing"])
def test_a_link_in_the_place_of_the_run_is_refused_before_computing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    target = tmp_path / "elsewhere" / NAME
    if kind != "nothing":
        run_experiment(small(*([] if kind == "same" else ["h=0.002"])), tmp_path / "elsewhere")
    (out / NAME).symlink_to(target)
    if kind == "same":
        assert run_experiment(small(), out).status == "up to date"
    monkeypatch.setattr(Run, "__iter__", None)
    with pytest.raises(UsageError, match=f"{NAME}: is a symbolic link.*nothing was written"):
        run_experiment(small(), out, RunOptions(force=True))
    assert [path.name for path in out.iterdir()] == [NAME]


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
    assert "nothing was kept of this run" in str(caught.value)
    assert "checkpoint" not in str(caught.value)


def test_a_run_looks_at_its_own_name_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of thousands of other folders it sees the names and no more."""
    for i in range(20):
        (tmp_path / f"other{i}").mkdir()
        (tmp_path / f"other{i}" / MANIFEST).write_text("{}")
    touched: list[str] = []
    open_, stat = manifest_module.read_json, os.stat

    def read_json(path: str | Path) -> dict[str, Any]:
        touched.append(str(path))
        return open_(path)

    def look_at(path: Any, *rest: Any, **options: Any) -> os.stat_result:
        touched.append(str(path))
        return stat(path, *rest, **options)

    monkeypatch.setattr(manifest_module, "read_json", read_json)
    monkeypatch.setattr(os, "stat", look_at)
    monkeypatch.setattr(Path, "iterdir", None)
    monkeypatch.setattr(Path, "glob", None)
    run_experiment(small(), tmp_path, RunOptions(stop=after(5)))
    run_experiment(small(), tmp_path, RunOptions(resume=True))
    monkeypatch.undo()
    assert any(NAME in path for path in touched)
    assert not [path for path in touched if "other" in path]
    assert stored_run(tmp_path / NAME).outcome is Outcome.COMPLETED


@pytest.mark.slow
def test_failed_runs_are_run_again_on_request(cli, in_tmp: Path) -> None:
    arguments = ["run", "kowalevski_hk", "--name", "kowalevski_hk"] + [
        word for key in ("N=300", *BLOW_UP) for word in ("--set", key)
    ]
    assert cli(*arguments).code == 1
    said = cli(*arguments)
    assert said.code == 1
    assert "(not run again: it ended as blew_up before; --retry-failed runs it again)" in said.err
    assert "--retry-failed runs it again" in cli(*arguments, "--dry-run").out
    assert "will run again" in cli(*arguments, "--dry-run", "--retry-failed").out
    stamp = (in_tmp / "results" / NAME / MANIFEST).stat().st_mtime_ns
    document = cli(*arguments, "--retry-failed", "--json").json()
    assert document["runs"][0]["status"] == "ran"
    assert (in_tmp / "results" / NAME / MANIFEST).stat().st_mtime_ns > stamp
    fine = ("run", "kowalevski_hk", "--set", "N=300", "--set", "name=fine", "--retry-failed")
    assert cli(*fine).code == 0
    assert cli(*fine, "--json").json()["runs"][0]["status"] == "up to date"
