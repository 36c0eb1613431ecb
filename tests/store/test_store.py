"""Run folders and series: bit-exact, whole or not at all, an earlier result never lost."""

from __future__ import annotations

import errno
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from conftest import ROOT
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Outcome
from topcli.engine.loop import Run
from topcli.errors import RunError, UsageError
from topcli.runs.decision import RunOptions
from topcli.runs.run import run_experiment
from topcli.store import folder as store_folder
from topcli.store import series
from topcli.store.folder import RunWriter
from topcli.store.manifest import stored_run, stored_runs
from topcli.store.series import SeriesWriter, read_metadata, read_series

HK = ROOT / "configs" / "kowalevski_hk.yaml"
FILES = ["config.yaml", "manifest.json", "report.json", "report.md"]


def small(*overrides: str) -> Experiment:
    return load_experiment(HK, ["N=300", *overrides])


@settings(max_examples=40, deadline=None)
@given(
    values=st.lists(st.floats(allow_nan=False), min_size=1, max_size=50),
    suffix=st.sampled_from(["parquet", "csv"]),
)
@example(values=[1.0, 2.0], suffix="csv")
def test_series_are_bit_exact(tmp_path_factory: pytest.TempPathFactory, values: list[float], suffix: str) -> None:
    path = tmp_path_factory.mktemp("series") / f"series.{suffix}"
    data = {"n": np.arange(len(values)), "x": np.array(values)}
    with SeriesWriter(path, ["n", "x"], {"who": "test"}) as writer:
        writer.write(data)
        writer.finish({"end": "yes"})
    back = read_series(path)
    assert list(back) == ["n", "x"]
    assert back["x"].dtype == np.float64
    assert (back["n"] == data["n"]).all()
    assert back["x"].tobytes() == data["x"].tobytes()


def test_pieces_make_one_series_and_metadata_comes_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(series, "ROW_GROUP", 10)
    path = tmp_path / "series.parquet"
    with SeriesWriter(path, ["x"], {"who": "test"}) as writer:
        for i in range(7):
            writer.write({"x": np.arange(4.0) + 4 * i})
        writer.finish({"end": "yes"})
    assert (read_series(path)["x"] == np.arange(28.0)).all()
    assert pq.ParquetFile(path).num_row_groups == 3
    assert read_metadata(path)["who"] == "test"
    assert pq.read_metadata(path).metadata[b"end"] == b"yes"
    assert read_metadata(tmp_path / "none.parquet") == {}


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_a_run_folder_is_complete(tmp_path: Path, suffix: str) -> None:
    experiment = small(f"output.format={suffix}")
    result = run_experiment(experiment, tmp_path)
    assert sorted(p.name for p in result.stored.folder.iterdir()) == sorted([*FILES, f"series.{suffix}"])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["kowalevski_hk"]
    assert load_experiment(result.stored.folder / "config.yaml").digest == experiment.digest
    manifest = json.loads((result.stored.folder / "manifest.json").read_text())
    assert manifest["digest"] == experiment.digest
    assert {"topcli", "python", "numpy", "numba", "platform", "cpu"} <= set(manifest["environment"])
    assert manifest["outcome"] == "completed"
    assert manifest["started"] <= manifest["ended"]
    data = read_series(result.stored.series)
    assert len(data["t"]) == 301
    assert (data["t"] == data["n"] * 1e-3).all()
    assert (data["k_sq"][0], data["gamma3"][0]) == (result.report["invariants"][3]["first"], 1e-3)


def test_parquet_carries_its_provenance(tmp_path: Path) -> None:
    result = run_experiment(small(), tmp_path)
    about = read_metadata(result.stored.series)
    assert json.loads(about["topcli.config"]) == small().resolved()
    assert about["topcli.digest"] == small().digest


def test_subset_of_columns_is_recorded(tmp_path: Path) -> None:
    experiment = small("output.columns=[t, k_sq]", "output.every=7")
    data = read_series(run_experiment(experiment, tmp_path).stored.series)
    assert list(data) == ["t", "k_sq"]
    assert (data["t"] == 1e-3 * np.arange(0, 301, 7)).all()


def test_a_finished_run_is_not_repeated_unless_forced(tmp_path: Path) -> None:
    first = run_experiment(small(), tmp_path)
    stamp = (first.stored.folder / "manifest.json").stat().st_mtime_ns
    again = run_experiment(small(), tmp_path)
    assert (again.status, again.report) == ("up to date", first.report)
    assert (first.stored.folder / "manifest.json").stat().st_mtime_ns == stamp
    assert run_experiment(small(), tmp_path, RunOptions(force=True)).status == "ran"
    assert [p.name for p in tmp_path.iterdir()] == ["kowalevski_hk"]


def test_a_different_experiment_is_refused_and_forced_aside(tmp_path: Path) -> None:
    first = run_experiment(small(), tmp_path)
    before = (first.stored.folder / "series.parquet").read_bytes()
    with pytest.raises(UsageError, match=r"holds a different experiment.*\n.*--force"):
        run_experiment(small("h=0.002"), tmp_path)
    assert (first.stored.folder / "series.parquet").read_bytes() == before
    result = run_experiment(small("h=0.002"), tmp_path, RunOptions(force=True))
    assert result.set_aside is not None
    assert (result.set_aside / "series.parquet").read_bytes() == before
    assert result.set_aside.name == f"kowalevski_hk.{first.stored.manifest['digest'][:8]}"
    assert len(stored_runs(tmp_path)) == 2


def test_changed_code_runs_again_and_keeps_the_earlier_result(tmp_path: Path) -> None:
    first = run_experiment(small(), tmp_path)
    manifest = first.stored.folder / "manifest.json"
    manifest.write_text(manifest.read_text().replace(first.stored.manifest["code"], "0" * 64))
    again = run_experiment(small(), tmp_path)
    assert again.status == "ran"
    assert again.set_aside is not None
    assert again.set_aside.is_dir()


def test_a_folder_that_is_no_run_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "kowalevski_hk").mkdir()
    (tmp_path / "kowalevski_hk" / "thesis.tex").write_text("years of work")
    with pytest.raises(UsageError, match="is not a finished run"):
        run_experiment(small(), tmp_path, RunOptions(force=True))
    assert (tmp_path / "kowalevski_hk" / "thesis.tex").read_text() == "years of work"
    assert stored_run(tmp_path / "kowalevski_hk") is None


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_a_full_disk_leaves_nothing_and_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    earlier = run_experiment(small(), tmp_path)
    before = (earlier.stored.folder / "series.parquet").read_bytes()

    def full(self: SeriesWriter, *pieces: bytes) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(SeriesWriter, "_append", full)
    with pytest.raises(RunError, match="no space left") as caught:
        run_experiment(small("h=0.002", f"output.format={suffix}"), tmp_path, RunOptions(force=True))
    assert caught.value.exit_code == 1
    assert [p.name for p in tmp_path.iterdir()] == ["kowalevski_hk"]
    assert (earlier.stored.folder / "series.parquet").read_bytes() == before


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="limits the file size the way Linux does")
@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_a_real_write_failure_through_the_entry_point(tmp_path: Path, suffix: str) -> None:
    """The kernel itself refuses the write: a file may not grow beyond 50 kB."""
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000));"
        "from topcli.__main__ import main;"
        f"sys.argv = ['topcli', 'run', {str(HK)!r}, '--out', {str(tmp_path)!r}, '--format', {suffix!r}, '--quiet'];"
        "main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    assert "size limit" in done.stderr
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_an_unwritable_output_folder_is_a_usage_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match=r"cannot be written to.*--out"):
        run_experiment(small(), tmp_path / "file" / "results")


def test_interrupted_runs_are_kept_marked_and_repeated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("topcli.engine.loop.CHUNK_STEPS", 100)
    asked = iter([False, True])
    result = run_experiment(small(), tmp_path, RunOptions(stop=lambda: next(asked)))
    assert result.outcome is Outcome.INTERRUPTED
    assert len(read_series(result.stored.series)["t"]) == 101
    assert pq.read_metadata(result.stored.series).metadata[b"topcli.outcome"] == b"interrupted"
    again = run_experiment(small(), tmp_path)
    assert (again.status, again.outcome) == ("ran", Outcome.COMPLETED)


@pytest.mark.slow
def test_killed_before_the_manifest_leaves_nothing_that_looks_whole(tmp_path: Path) -> None:
    """Leftovers of a killed process are no result, hinder nothing, and are removed by the next run."""
    code = (
        "import os, sys; from pathlib import Path; from topcli.store.folder import RunWriter\n"
        "with RunWriter(Path(sys.argv[1]), 'kowalevski_hk') as writer:\n"
        "    (writer.folder / 'report.json').write_text('{}')\n"
        "    os._exit(9)\n"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False)
    assert len(list(tmp_path.iterdir())) == 1
    assert stored_runs(tmp_path) == []
    run_experiment(small(), tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["kowalevski_hk"]


def test_a_living_writer_is_not_swept_away(tmp_path: Path) -> None:
    with RunWriter(tmp_path, "kowalevski_hk") as writer:
        run_experiment(small(), tmp_path)
        assert writer.folder.is_dir()


def test_damaged_manifests_are_no_results(tmp_path: Path) -> None:
    result = run_experiment(small(), tmp_path)
    (result.stored.folder / "manifest.json").write_text("{ half")
    assert stored_run(result.stored.folder) is None
    (result.stored.folder / "manifest.json").write_text("[]")
    assert stored_run(result.stored.folder) is None


def test_a_missing_file_makes_a_run_out_of_date(tmp_path: Path) -> None:
    result = run_experiment(small(), tmp_path)
    (result.stored.folder / "report.md").unlink()
    assert run_experiment(small(), tmp_path).status == "ran"


def test_renaming_is_the_last_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A failure while flushing loses neither the earlier run nor leaves a new one."""
    first = run_experiment(small(), tmp_path)

    def fail(path: Path) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(store_folder, "sync", fail)
    with pytest.raises(RunError, match="Input/output error"):
        run_experiment(small(), tmp_path, RunOptions(force=True))
    assert stored_run(first.stored.folder) is not None
    assert [p.name for p in tmp_path.iterdir()] == ["kowalevski_hk"]


def test_nothing_is_integrated_for_a_refusal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_experiment(small(), tmp_path)

    def never(*args: object, **kwargs: object) -> None:
        raise AssertionError("integrated")

    monkeypatch.setattr(Run, "__iter__", never)
    with pytest.raises(UsageError):
        run_experiment(small("N=301"), tmp_path)
    assert run_experiment(small(), tmp_path).status == "up to date"


@pytest.mark.slow
def test_concurrent_different_experiments_are_both_kept(tmp_path: Path) -> None:
    """Both start on an empty folder; the one that ends second gives way, and says so even under -q."""
    command = [sys.executable, "-m", "topcli", "run", str(HK), "--out", str(tmp_path), "--quiet", "--name", "one"]
    running = [
        subprocess.Popen([*command, "--set", f"N={N}"], stderr=subprocess.PIPE, text=True) for N in (400_000, 400_001)
    ]
    said = [process.communicate(timeout=120)[1] for process in running]
    codes = [process.returncode for process in running]
    assert codes.count(0) == 1
    (other,) = (i for i in (0, 1) if codes[i])
    kept = {run.manifest["config"]["N"] for run in stored_runs(tmp_path)}
    if codes[other] == 2:  # began after the other had ended
        assert "holds a different experiment" in said[other]
        assert kept == {400_001 - other}
    else:
        assert codes[other] == 1
        assert "another process has meanwhile put a different experiment there; this run is kept as" in said[other]
        assert kept == {400_000, 400_001}


def test_a_different_run_that_came_meanwhile_stays_and_copies_are_dropped(tmp_path: Path) -> None:
    """Without --force nobody is displaced, who comes second is kept aside, and of identical runs there is one."""

    def late(done: int, total: int) -> None:
        run_experiment(small(), tmp_path, RunOptions(force=True))

    for _ in range(2):
        shutil.rmtree(tmp_path / "kowalevski_hk", ignore_errors=True)
        with pytest.raises(RunError, match="meanwhile put a different experiment there; this run is kept as") as caught:
            run_experiment(small("h=0.002"), tmp_path, RunOptions(on_progress=late))
        aside = f"kowalevski_hk.{small('h=0.002').digest[:8]}"
        assert str(caught.value).endswith(aside)
        assert stored_run(tmp_path / "kowalevski_hk").manifest["config"]["h"] == 0.001
        assert sorted(path.name for path in tmp_path.iterdir()) == ["kowalevski_hk", aside]


def test_forced_runs_in_turn_leave_one_copy_of_each(tmp_path: Path) -> None:
    for h in (1e-3, 2e-3, 1e-3, 2e-3, 1e-3):
        run_experiment(small(f"h={h}"), tmp_path, RunOptions(force=True))
    names = [f"kowalevski_hk.{small(f'h={h}').digest[:8]}" for h in (1e-3, 2e-3)]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(["kowalevski_hk", *names])
    assert all(not stored_run(tmp_path / name).damage() for name in names)


def test_result_written_meanwhile_is_set_aside(tmp_path: Path) -> None:
    with RunWriter(tmp_path, "kowalevski_hk") as writer:
        other = run_experiment(small(), tmp_path)
        writer.commit({"digest": "f" * 64, "code": "c", "series": "series.csv"}, {"series.csv": "x"})
    assert writer.set_aside is not None
    assert stored_run(writer.set_aside).manifest["digest"] == other.stored.manifest["digest"]


def test_files_of_the_users_in_a_run_folder_are_not_lost(tmp_path: Path) -> None:
    first = run_experiment(small(), tmp_path)
    (first.stored.folder / "notes.txt").write_text("remember")
    again = run_experiment(small(), tmp_path, RunOptions(force=True))
    assert again.set_aside is not None
    assert (again.set_aside / "notes.txt").read_text() == "remember"


def test_a_damaged_series_is_not_up_to_date_and_not_read(tmp_path: Path) -> None:
    result = run_experiment(small(), tmp_path)
    result.stored.series.write_text("junk")
    with pytest.raises(RunError, match="cannot be read"):
        read_series(result.stored.series)
    assert run_experiment(small(), tmp_path).status == "ran"
