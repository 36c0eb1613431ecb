"""Checks of stored results by ``topcli verify``, and what a manifest says of machine and commit."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from conftest import Said
from resuming import NAME, life, small
from stored_results import store_comparison, store_ensemble, store_run, store_sweep
from topcli.runs.run import run_experiment
from topcli.store import provenance
from topcli.store.provenance import git_commit
from topcli.store.results import MANIFEST

pytestmark = pytest.mark.usefixtures("small_chunks")


def interrupted(out: Path) -> Path:
    return life(small(), out, 7).stored.folder


def comparison(out: Path) -> Path:
    return store_comparison(out / "compared.json")


@pytest.mark.slow
@pytest.mark.parametrize(
    "store", [lambda out: store_run(out, "one"), interrupted, store_ensemble, store_sweep, comparison]
)
def test_verify_names_every_damaged_file(cli: Callable[..., Said], in_tmp: Path, store: Callable[[Path], Path]) -> None:
    """One that has a bit flipped or is missing, of every kind of result."""
    place = store(in_tmp)
    files = [place] if place.is_file() else [path for path in place.rglob("*") if path.suffix != ".arrow"]
    for path in filter(Path.is_file, files):
        content = path.read_bytes()
        changed = content.replace(b'"', b"'", 1) if path.name == MANIFEST else content[:3] + b"?" + content[4:]
        for damaged in (changed, None):
            path.unlink() if damaged is None else path.write_bytes(damaged)
            if damaged is None and path.name in (MANIFEST, place.name, "checkpoint.npz"):
                continue  # then nothing says that it was there
            said = cli("verify", str(place))
            assert (said.code, len(said.err.splitlines())) == (1, 1), said.err
            assert said.err.startswith(f"error: {path}: damaged: ")
        path.write_bytes(content)
    said = cli("verify", str(place))
    assert said.code == 0
    assert ("unfinished" if store is interrupted else "intact") in said.out


def test_verify_of_nothing_is_a_usage_error(cli: Callable[..., Said], in_tmp: Path) -> None:
    (in_tmp / "thesis").mkdir()
    for name in ("thesis", "nowhere", "x" * 5000):
        said = cli("verify", name)
        assert said.code == 2
        assert len(said.err) < 1000


@pytest.mark.slow
@pytest.mark.parametrize("text", ["", "[]", "{}", '{"manifest_version": 2}', "[" * 100_000], ids=range(5))
def test_a_damaged_manifest_is_reported_and_stays(cli: Callable[..., Said], in_tmp: Path, text: str) -> None:
    folder = run_experiment(small(), in_tmp / "results").stored.folder
    run_experiment(small("name=fine"), in_tmp / "results")
    (folder / MANIFEST).write_text(text)
    listed = cli("list", "runs", "--json").json()["runs"]
    assert [(run["name"], run["outcome"]) for run in listed] == [("fine", "completed"), (NAME, "damaged")]
    for more in ((), ("--force",), ("--dry-run",)):
        said = cli("run", NAME, "--set", f"name={NAME}", "--set", "N=300", *more)
        assert said.code == 1
        assert said.err.startswith(f"error: results/{NAME}/{MANIFEST}: damaged (")
    assert cli("verify", NAME).err.startswith(f"error: results/{NAME}/{MANIFEST}: damaged")
    assert (folder / MANIFEST).read_text() == text


def test_the_commit_is_dirty_if_a_tracked_file_differs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a checkout of its own: none before the first commit, then clean, and changed."""

    def run(*arguments: str) -> str:
        settings = ("-c", "user.name=Nobody", "-c", "user.email=nobody@example.org", "-c", "commit.gpgsign=false")
        command = ["git", "-C", str(tmp_path), *settings, *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    source = tmp_path / "src" / "topcli" / "store" / "provenance.py"
    source.parent.mkdir(parents=True)
    source.write_text("one\n")
    monkeypatch.setattr(provenance, "__file__", str(source))
    for name in [name for name in os.environ if name.startswith("GIT_")]:
        monkeypatch.delenv(name)
    assert git_commit() == {"commit": None, "dirty": None}
    run("init", "-q")
    run("add", ".")
    run("commit", "-q", "-m", "first")
    commit = run("rev-parse", "HEAD")
    (tmp_path / "notes.txt").write_text("a new file changes no result\n")
    assert git_commit() == {"commit": commit, "dirty": False}
    source.write_text("two\n")
    assert git_commit() == {"commit": commit, "dirty": True}
