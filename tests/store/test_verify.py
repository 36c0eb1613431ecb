"""Damage to finished and unfinished runs is noticed, by ``topcli verify`` and before anything is resumed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from resuming import NAME, after, content, killed, small
from topcli.errors import RunError
from topcli.runs.decision import RunOptions
from topcli.runs.run import run_experiment
from topcli.store import manifest as manifest_module
from topcli.store.checkpoint import CHECKPOINT, read_checkpoint
from topcli.store.footer import UNFINISHED
from topcli.store.manifest import MANIFEST
from topcli.store.series import read_series
from topcli.store.verify import check_run

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
    for place, bit in zip(random.integers(0, len(data), 300), random.integers(0, 8, 300), strict=True):
        flip(run.series, int(place), int(bit))
        assert "series.parquet" in run.damage()
        try:
            found = read_series(run.series)
        except RunError as error:
            refused += str(error).startswith(f"{run.series}: cannot be read") and len(str(error).splitlines()) == 1
        else:  # in bytes that nothing reads, or in a name
            values = [column.tobytes() for column in found.values()]
            assert values == [column.tobytes() for column in expected.values()]
        run.series.write_bytes(data)
    assert refused > 100  # 140 of 300: with row groups of 40 rows most of the file is footers that nothing reads
    assert not run.damage()


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["parquet", "csv"])
@pytest.mark.parametrize("name", ["series", "report.json", "config.yaml"])
def test_a_damaged_finished_run_is_not_up_to_date(tmp_path: Path, suffix: str, name: str) -> None:
    experiment = small(f"output.format={suffix}")
    run = run_experiment(experiment, tmp_path).stored
    path = run.series if name == "series" else run.folder / name
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
@pytest.mark.parametrize("name", ["series.parquet", "series.csv", CHECKPOINT])
def test_a_damaged_interrupted_run_is_not_resumed(tmp_path: Path, name: str) -> None:
    experiment = small("output.format=csv" if name.endswith("csv") else "output.format=parquet")
    folder = run_experiment(experiment, tmp_path, RunOptions(stop=after(7))).stored.folder
    path = folder / name
    flip(path, 40 if name == CHECKPOINT else path.stat().st_size // 2)
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
    document = cli("verify", f"results/{NAME}", str(left), "--json").json()
    assert [(run["finished"], run["state"]) for run in document["runs"]] == [(True, "whole"), (False, "whole")]
    flip(results / NAME / "series.parquet", 200)
    flip(left / "series.parquet", 200)
    said = cli("verify", NAME)
    assert said.code == 1
    lines = said.err.splitlines()
    assert lines[0].startswith(f"error: results/{NAME}/series.parquet: damaged: its SHA-256 differs")
    assert lines[1].startswith(f"error: results/{left.name}/series.parquet: damaged: the SHA-256 of its first")
    said = cli("verify", NAME, "--json")
    assert said.code == 1
    damaged = [file for run in said.json()["runs"] for file in run["files"] if file["damaged"]]
    assert [file["name"] for file in damaged] == ["series.parquet", "series.parquet"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["manifest", "missing", "longer", "checkpoint"])
def test_verify_names_every_damaged_file(cli, in_tmp: Path, kind: str) -> None:
    folder = run_experiment(small(), in_tmp, RunOptions(stop=after(7))).stored.folder
    name = {"manifest": MANIFEST, "missing": "report.md", "longer": "config.yaml", "checkpoint": CHECKPOINT}[kind]
    if kind == "missing":
        (folder / name).unlink()
    elif kind == "longer":
        (folder / name).write_text((folder / name).read_text() + "#")
    else:
        flip(folder / name, 3)
    said = cli("verify", str(folder))
    assert said.code == 1
    assert said.err.startswith(f"error: {folder / name}: damaged: ")
    assert len(said.err.splitlines()) == 1


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
