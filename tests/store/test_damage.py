"""Damage to runs, and folders that somebody else wrote to: noticed, named, and never read or overwritten."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cases import table_of
from resuming import NAME, after, content, killed, small
from stored_results import store_comparison, store_ensemble, store_sweep
from topcli.engine.run import Run
from topcli.errors import RunError, UsageError
from topcli.runs.decision import RunOptions
from topcli.runs.run import run_experiment
from topcli.store import manifest as manifest_module
from topcli.store import provenance
from topcli.store.checkpoint import CHECKPOINT, read_checkpoint
from topcli.store.footer import UNFINISHED
from topcli.store.manifest import MANIFEST, DamagedRun, read_run
from topcli.store.parts import LOCK, owner, remove_own, remove_remains, take_lock
from topcli.store.provenance import Commit, cpu_name
from topcli.store.series import read_series
from topcli.store.verify import check_run
from topcli.studies.health import check_all

pytestmark = pytest.mark.usefixtures("small_chunks")


def flip(path: Path, place: int, bit: int = 0) -> None:
    """Flip one bit of a file, in place."""
    data = bytearray(path.read_bytes())
    data[place] ^= 1 << bit
    path.write_bytes(bytes(data))


def files_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != "lock"}


@pytest.mark.slow
def test_a_flipped_bit_is_never_read_as_a_number(tmp_path: Path) -> None:
    run = run_experiment(small("output.columns=[n, k_sq]"), tmp_path).stored
    expected, data = read_series(run.series), run.series.read_bytes()
    random, refused = np.random.default_rng(2), 0
    flips = list(zip(random.integers(0, len(data), 100), random.integers(0, 8, 100), strict=True))
    footer = len(data) - 8 - int.from_bytes(data[-8:-4], "little")
    for place, bit in (*flips, *((place, bit) for place in range(footer, len(data)) for bit in (2, 4))):
        flip(run.series, int(place), int(bit))
        if place < footer:
            assert "series.parquet" in run.damage()
        try:
            found = read_series(run.series)
        except RunError as error:
            refused += str(error).startswith(f"{run.series}: cannot be read") and len(str(error).splitlines()) == 1
        else:  # in bytes that nothing reads, or in a name
            values = [column.tobytes() for column in found.values()]
            assert values == [column.tobytes() for column in expected.values()]
        run.series.write_bytes(data)
    assert refused > 1000  # of some 5400; most others are in statistics of the footer, which nothing reads
    assert not run.damage()


@pytest.mark.parametrize("name", ["series.parquet", "series.csv", "report.json", "config.yaml"])
def test_a_damaged_finished_run_is_not_up_to_date(tmp_path: Path, name: str) -> None:
    experiment = small(f"output.format={'csv' if name.endswith('csv') else 'parquet'}")
    path = run_experiment(experiment, tmp_path).stored.folder / name
    flip(path, path.stat().st_size // 2)
    messages: list[str] = []
    again = run_experiment(experiment, tmp_path, RunOptions(on_message=messages.append))
    assert again.status == "ran"
    assert f"{path.name} is damaged: its SHA-256 differs" in messages[0]
    assert not again.stored.damage()


def test_large_files_are_compared_by_size_before_a_run_counts_as_up_to_date(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = run_experiment(small(), tmp_path).stored
    flip(run.series, 1000)
    for limit in (run.series.stat().st_size - 1, run.series.stat().st_size):
        monkeypatch.setattr(manifest_module, "CHECKED_AT_ONCE", limit)
        assert (run.damage(quick=True) == {}) == (limit < run.series.stat().st_size)
    assert run.damage() == {"series.parquet": "its SHA-256 differs from the manifest's"}


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_damaged_rows_are_not_resumed_and_nothing_is_deleted(tmp_path: Path, suffix: str) -> None:
    """One bit before the checkpoint, anywhere; behind it the file is cut off and damage does no harm."""
    experiment = small(f"output.format={suffix}")
    expected = content(run_experiment(experiment, tmp_path / "whole").stored.folder)
    out = tmp_path / "out"
    series = killed(out, experiment, 9) / f"series.{suffix}"
    length = read_checkpoint(series.parent).series.length
    assert length > 1000
    for place in (0, length // 2, length - 1):
        flip(series, place)
        before = files_of(series.parent)
        with pytest.raises(RunError, match=r"its SHA-256 differs.*nothing was deleted.*without --resume") as caught:
            run_experiment(experiment, out, RunOptions(resume=True))
        (left,) = out.glob(f".{NAME}.part-*")  # taken over, under a new name
        assert str(caught.value).startswith(f"{left / series.name}: damaged")
        assert len(str(caught.value).splitlines()) == 1
        assert files_of(left) == before
        series = left / series.name
        flip(series, place)
    with series.open("ab") as file:
        file.write(b"half a row group")
    assert content(run_experiment(experiment, out, RunOptions(resume=True)).stored.folder) == expected


@pytest.mark.parametrize("how", ["cut", "gone"])
def test_missing_rows_are_not_resumed(tmp_path: Path, how: str) -> None:
    left = killed(tmp_path, small(), 9)
    series = left / "series.parquet"
    series.unlink() if how == "gone" else series.write_bytes(series.read_bytes()[:500])
    with pytest.raises(RunError, match="ends at byte 500 of" if how == "cut" else "missing"):
        run_experiment(small(), tmp_path, RunOptions(resume=True))
    assert len(list(tmp_path.glob(f".{NAME}.part-*/{CHECKPOINT}"))) == 1
    assert run_experiment(small(), tmp_path).status == "ran"


@pytest.mark.slow
@pytest.mark.parametrize(("name", "place"), [("series.parquet", -1), ("series.csv", 40), (CHECKPOINT, 40)])
def test_a_damaged_interrupted_run_is_not_resumed(tmp_path: Path, name: str, place: int) -> None:
    """Nor where the damage lies behind the checkpoint: the manifest vouches for the whole file."""
    experiment = small("output.format=csv" if name.endswith("csv") else "output.format=parquet")
    folder = run_experiment(experiment, tmp_path, RunOptions(stop=after(7))).stored.folder
    path = folder / name
    flip(path, place)
    before = files_of(folder)
    with pytest.raises(RunError, match=f"{NAME}/{name}: damaged .*nothing was deleted.*without --resume"):
        run_experiment(experiment, tmp_path, RunOptions(resume=True))
    assert files_of(folder) == before
    assert [path.name for path in tmp_path.iterdir()] == [NAME]
    assert run_experiment(experiment, tmp_path).status == "ran"


def test_the_file_of_a_killed_run_is_no_parquet_file(tmp_path: Path) -> None:
    """Else a reader would take the last row group's footer for that of the whole and read the first group's rows."""
    series = killed(tmp_path, small(), 9) / "series.parquet"
    assert series.read_bytes().endswith(UNFINISHED)
    with pytest.raises(RunError, match="cannot be read"):
        read_series(series)


def test_verify_finished_and_unfinished_runs(cli, in_tmp: Path) -> None:
    results = in_tmp / "results"
    run_experiment(small(), results)
    left = killed(results, small(), 9)
    said = cli("verify", NAME)
    assert (said.code, len(said.out.splitlines())) == (0, 2)
    assert f"results/{NAME}: finished, 5 files intact" in said.out
    assert f"{left.name}: unfinished" in said.out
    flip(results / NAME / "series.parquet", 200)
    flip(left / "series.parquet", 200)
    said = cli("verify", NAME)
    assert said.code == 1
    lines = said.err.splitlines()
    assert lines[0].startswith(f"error: results/{NAME}/series.parquet: damaged: its SHA-256 differs")
    assert lines[1].startswith(f"error: results/{left.name}/series.parquet: damaged: the SHA-256 of its first")
    said = cli("verify", NAME, "--json")
    assert said.code == 1
    runs = said.json()["runs"]
    assert [(run["finished"], run["state"]) for run in runs] == [(True, "damaged"), (False, "damaged")]
    assert [file["name"] for run in runs for file in run["files"] if file["damaged"]] == ["series.parquet"] * 2


def interrupted(out: Path) -> Path:
    return run_experiment(small(), out, RunOptions(stop=after(7))).stored.folder


def compared(out: Path) -> Path:
    return store_comparison(out / "compared.json")


@pytest.mark.slow
@pytest.mark.parametrize("store", [interrupted, store_ensemble, store_sweep, compared])
def test_verify_names_every_damaged_file(cli, in_tmp: Path, store: Callable[[Path], Path]) -> None:
    """One that has a bit flipped, is cut or is missing, of every kind of result."""
    place = store(in_tmp)
    files = [place] if place.is_file() else [path for path in sorted(place.iterdir()) if path.name != LOCK]
    for path in files:
        data = path.read_bytes()
        for damaged in (data[:3] + bytes([data[3] ^ 1]) + data[4:], data[:-1], None):
            path.unlink() if damaged is None else path.write_bytes(damaged)
            if damaged is None and path.name in (MANIFEST, place.name):
                continue  # then nothing says that there is a finished result
            said = cli("verify", str(place))
            assert (said.code, len(said.err.splitlines())) == (1, 1), said.err
            assert said.err.startswith(f"error: {path}: damaged: ")
        path.write_bytes(data)
    assert cli("verify", str(place)).code == 0


@pytest.mark.parametrize("change", [{"manifest_version": 99}, {"files": []}])
def test_a_sweep_whose_manifest_is_not_understood_is_damaged(tmp_path: Path, change: dict[str, object]) -> None:
    folder = store_sweep(tmp_path)
    path = folder / MANIFEST
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    (checked,) = check_all(str(folder), tmp_path)
    assert [file.name for file in checked.files if file.damaged] == [MANIFEST]


def test_verify_of_nothing_is_a_usage_error(cli, in_tmp: Path) -> None:
    (in_tmp / "thesis").mkdir()
    for name in ("thesis", "nowhere", "x" * 5000):
        said = cli("verify", name)
        assert said.code == 2
        assert len(said.err) < 1000


@pytest.mark.parametrize(
    "change",
    [
        lambda about: about["environment"].update(cpu="another"),
        lambda about: about.update(message="completed 7 steps"),
        lambda about: about.pop("manifest_sha256"),
        lambda about: about.update(started=None),
    ],
)
def test_a_changed_entry_of_the_manifest_is_damage(tmp_path: Path, change) -> None:
    """Also of an entry that topcli does not read itself."""
    experiment = small()
    run = run_experiment(experiment, tmp_path).stored
    path = run.folder / MANIFEST
    assert not check_run(run.folder).damaged
    about = json.loads(path.read_text())
    change(about)
    path.write_text(json.dumps(about))
    assert [file.name for file in check_run(run.folder).files if file.damaged] == [MANIFEST]
    assert run_experiment(experiment, tmp_path).status == "ran"
    assert not check_run(run.folder).damaged


def test_the_text_of_a_manifest_is_compared(tmp_path: Path) -> None:
    """1.5e-05 and 1.5E-05 are one number, and one of them was not written."""
    run = run_experiment(small(), tmp_path).stored
    path = run.folder / MANIFEST
    assert not check_run(run.folder).damaged
    path.write_text(path.read_text().replace('"name"', '"n\\u0061me"', 1))
    assert not run.damage()
    assert [file.name for file in check_run(run.folder).files if file.damaged] == [MANIFEST]


DEEP = '{"a":' * 100_000


HOSTILE = {
    "empty": lambda manifest: "",
    "half": lambda manifest: json.dumps(manifest)[:200],
    "null": lambda manifest: "null",
    "deep": lambda manifest: DEEP,
    "deep inside": lambda manifest: json.dumps(manifest)[:-1] + ', "x": ' + "[" * 100_000 + "]" * 100_000 + "}",
    "long number": lambda manifest: json.dumps(manifest)[:-1] + ', "x": ' + "9" * 10_000 + "}",
    "no UTF-8": lambda manifest: json.dumps(manifest).replace("kowalevski", "\udcff"),
}
ENTRIES = table_of(r"""
files             {}
files             []
files             {"../../x": 3, "series.parquet": 3}
files             {"series.parquet": "3"}
files             {"series.parquet": {"size": 3, "sha256": "../x"}}
files             {"\x1b[31mred": 3, "series.parquet": 3}
digest            ../../x
digest            None
code              [1]
series            ../other/series.parquet
series            .ssh
outcome           splendid
config.N          nan
config.N          1e300
config.h          small
config.scheme     hk
step              x
manifest_version  99
""")
"""Entries of a manifest, and values that they never have; without a value the entry is missing."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The manifest of a run."""
    folder = run_experiment(small(), tmp_path_factory.mktemp("whole")).stored.folder
    return json.loads((folder / MANIFEST).read_text())


def assert_no_run(folder: Path, text: str) -> None:
    (folder / MANIFEST).write_bytes(text.encode("utf-8", "surrogateescape"))
    found = read_run(folder)
    assert isinstance(found, DamagedRun)
    assert len(found.reason) < 300
    assert found.reason.isprintable()


@pytest.mark.parametrize("kind", HOSTILE)
def test_a_damaged_manifest_is_no_run(tmp_path: Path, whole: dict[str, Any], kind: str) -> None:
    assert_no_run(tmp_path, HOSTILE[kind](whole))


@pytest.mark.parametrize(("key", "value"), [*ENTRIES, ("ended", "x" * 100_000)])
def test_a_manifest_with_a_hostile_entry_is_no_run(
    tmp_path: Path, whole: dict[str, Any], key: str, value: object
) -> None:
    section, _, last = key.rpartition(".")
    inner = {**(whole[section] if section else whole), last: value}
    assert_no_run(tmp_path, json.dumps({**whole, section: inner} if section else inner))


def test_a_damaged_manifest_is_reported_and_kept(cli, in_tmp: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = run_experiment(small(), in_tmp / "results").stored.folder
    run_experiment(small("name=fine"), in_tmp / "results")
    (folder / MANIFEST).write_text(DEEP)
    listed = cli("list", "runs", "--json").json()["runs"]
    assert [(run["name"], run["outcome"]) for run in listed] == [("fine", "completed"), (NAME, "damaged")]
    monkeypatch.setattr(Run, "__iter__", None)  # refused before anything is computed
    for more in ((), ("--force",), ("--resume",), ("--dry-run",)):
        said = cli("run", NAME, "--set", f"name={NAME}", "--set", "N=300", *more)
        assert said.code == 2
        assert f"results/{NAME}: holds a damaged run ({MANIFEST}: " in said.err
    said = cli("verify", NAME)
    assert said.code == 1
    assert said.err.startswith(f"error: results/{NAME}/{MANIFEST}: damaged: ")
    assert (folder / MANIFEST).read_text() == DEEP


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_named_pipe_in_place_of_a_manifest_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / MANIFEST)
    assert read_run(tmp_path) == DamagedRun(tmp_path, f"{MANIFEST}: not a regular file")


LOCKS = table_of("""
[]
{"pid": "x"}
{"pid": NaN}
{"pid": 1e400}
{"pid": -1}
{"pid": 99999999999999999999999}
""")


@pytest.mark.parametrize("text", [*LOCKS, DEEP, "\udcff\udcfe"])
def test_damaged_lock_is_ignored(tmp_path: Path, text: object) -> None:
    (tmp_path / LOCK).write_bytes(str(text).encode("utf-8", "surrogateescape"))
    assert owner(tmp_path) == {}
    lock = take_lock(tmp_path)
    assert lock is not None
    lock.release()


def test_the_part_of_a_living_process_is_not_locked_before_it_does(tmp_path: Path) -> None:
    living, dead = (tmp_path / f".{NAME}.part-{pid}-00000000" for pid in (os.getpid(), 999_999_999))
    living.mkdir()
    dead.mkdir()
    assert take_lock(living) is None
    lock = take_lock(dead)
    assert lock is not None
    lock.release()


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


def test_dead_parts_are_swept_of_our_own_files_alone(tmp_path: Path) -> None:
    part = tmp_path / f".{NAME}.part-999999999-00000000"
    part.mkdir()
    for name in ("series.parquet", "report.json", ".checkpoint.7.npz"):
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


X86 = "processor\t: 0\nmodel name\t: AMD EPYC 7763\nflags\t\t: fpu\n"


ARM = "processor\t: 0\nCPU implementer\t: 0x41\nCPU variant\t: 0x3\nCPU part\t: 0xd0c\nCPU revision\t: 1\n"


@pytest.mark.parametrize(("text", "name"), [(X86, "AMD EPYC 7763"), (ARM, "aarch64 Arm part 0xd0c variant 0x3 r1")])
def test_the_processor_is_named(monkeypatch: pytest.MonkeyPatch, text: str, name: str) -> None:
    monkeypatch.setattr(Path, "read_text", lambda self, **options: text)
    monkeypatch.setattr("platform.machine", lambda: "aarch64")
    assert cpu_name() == name


def test_the_commit_is_dirty_if_a_tracked_file_differs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a checkout of its own: none before the first commit, clean, changed, staged, and clean again."""
    git = shutil.which("git")
    if git is None:
        pytest.skip("no git here")

    def run(*arguments: str) -> str:
        settings = ("-c", "user.name=Nobody", "-c", "user.email=nobody@example.org", "-c", "commit.gpgsign=false")
        command = [git, "-C", str(tmp_path), *settings, *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    def found() -> dict[str, Any]:
        with Commit() as commit:
            return commit.read()

    source = tmp_path / "src" / "topcli" / "store" / "provenance.py"
    source.parent.mkdir(parents=True)
    source.write_text("one\n")
    monkeypatch.setattr(provenance, "__file__", str(source))
    for name in [name for name in os.environ if name.startswith("GIT_")]:
        monkeypatch.delenv(name)
    assert found() == {"commit": None, "dirty": None}
    run("init", "-q")
    assert found() == {"commit": None, "dirty": None}
    run("add", ".")
    run("commit", "-q", "-m", "first")
    clean = {"commit": run("rev-parse", "HEAD"), "dirty": False}
    assert found() == clean
    (tmp_path / "notes.txt").write_text("a new file changes no result\n")
    assert found() == clean
    source.write_text("two\n")
    assert found() == {**clean, "dirty": True}
    run("add", "src")
    assert found() == {**clean, "dirty": True}
