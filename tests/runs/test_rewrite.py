"""A finished run asked for in another format is rewritten from its tables, and never computed again."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from topcli.config.load import load, load_experiment
from topcli.engine.ensemble import EnsembleRun
from topcli.engine.loop import Run
from topcli.errors import RunError, UsageError
from topcli.runs.decision import RunOptions
from topcli.runs.run import run_experiment
from topcli.store import folder as store_folder
from topcli.store.files import sealed
from topcli.store.manifest import MANIFEST_SEAL, stored_run
from topcli.store.series import copy_series, read_series, write_parquet

BASE = ["h=0.01", "N=300"]


CSV = "output.format=csv"


MANY = ["ensemble={random: {count: 5, seed: 3, gamma: sphere}}", "h=0.01", "N=40"]


def experiment(*overrides: str) -> Any:
    return load_experiment("kowalevski_hk", [*BASE, *overrides])


def bits(values: np.ndarray) -> Any:
    return values.tolist() if values.dtype.kind == "O" else values.view(np.int64).tolist()


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def without_time(text: bytes) -> dict[str, Any]:
    """A report without the seconds, which differ between runs."""
    return {key: value for key, value in json.loads(text).items() if key != "seconds"}


@pytest.fixture
def never_computes(monkeypatch: pytest.MonkeyPatch) -> None:
    """From here on, starting the time loop fails."""

    def refuse(*arguments: Any, **options: Any) -> None:
        raise AssertionError("computed again")

    for loop in (Run, EnsembleRun):
        monkeypatch.setattr(loop, "__iter__", refuse)


VALUES = [0.0, -0.0, 0.1, -1e-308, 5e-324, 1.7976931348623157e308, np.inf, -np.inf, np.nan, 1 / 3, 2.0**53 + 2, -7.0]


@pytest.mark.parametrize("rows", [0, 1, 12, 5000])
def test_a_series_keeps_its_bits_in_every_format(tmp_path: Path, rows: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("topcli.store.series.ROW_GROUP", 700)
    data = {
        "n": np.arange(rows, dtype=np.int64) * 10**11,
        "x": np.resize(np.array(VALUES), rows) * np.float64(1.0),
        "y": np.random.default_rng(4).standard_normal(rows),
        "outcome": np.resize(np.array(["completed", "blew_up"], dtype=object), rows),
    }
    write_parquet(tmp_path / "0.parquet", data, {})
    for step in ("0.parquet 1.csv", "1.csv 2.parquet", "2.parquet 3.parquet", "2.parquet 4.csv"):
        old, new = step.split()
        copy_series(tmp_path / old, tmp_path / new, {"about": "it"}, {"end": "now"})
    for name in ("1.csv", "2.parquet", "3.parquet", "4.csv"):
        found = read_series(tmp_path / name)
        assert list(found) == list(data)
        assert {key: bits(found[key]) for key in data} == {key: bits(data[key]) for key in data}
    assert (tmp_path / "1.csv").read_bytes() == (tmp_path / "4.csv").read_bytes()
    found = pq.read_metadata(tmp_path / "2.parquet").metadata
    assert (found[b"about"], found[b"end"]) == (b"it", b"now")


def test_a_run_is_rewritten_as_a_direct_run_would_be(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    direct = {kind: run_experiment(experiment(f"output.format={kind}"), tmp_path / kind) for kind in ("csv", "parquet")}
    run_experiment(experiment(), tmp_path)
    first = contents(tmp_path / "kowalevski_hk")
    request.getfixturevalue("never_computes")
    made = run_experiment(experiment(CSV), tmp_path)
    assert (made.status, made.stored.series.name, made.set_aside) == ("rewritten as csv", "series.csv", None)
    found, wanted = contents(made.stored.folder), contents(direct["csv"].stored.folder)
    assert found.keys() == wanted.keys()
    assert found["series.csv"] == wanted["series.csv"]
    assert found["config.yaml"] == wanted["config.yaml"]
    assert (found["report.json"], found["report.md"]) == (first["report.json"], first["report.md"])
    assert without_time(found["report.json"]) == without_time(wanted["report.json"])
    old, new = json.loads(first["manifest.json"]), json.loads(found["manifest.json"])
    assert new["config"] == {**old["config"], "output": {**old["config"]["output"], "format": "csv"}}
    assert new["rewritten"]["from"] == ["series.parquet"]
    same = ("digest", "code", "outcome", "started", "ended", "seconds", "environment", "step")
    assert [new[key] for key in same] == [old[key] for key in same]
    assert made.stored.damage() == {}
    assert run_experiment(experiment(CSV), tmp_path).status == "up to date"

    back = run_experiment(experiment(), tmp_path)
    assert back.status == "rewritten as parquet"
    about, direct_about = (
        {key: value for key, value in pq.read_metadata(path).metadata.items() if key.startswith(b"topcli.")}
        for path in (back.stored.series, direct["parquet"].stored.series)
    )
    assert about == direct_about
    assert about.keys() >= {b"topcli.config", b"topcli.digest", b"topcli.environment", b"topcli.outcome"}
    columns, wanted = read_series(back.stored.series), read_series(direct["parquet"].stored.series)
    assert {name: bits(values) for name, values in columns.items()} == {k: bits(v) for k, v in wanted.items()}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["csv", "kowalevski_hk", "parquet"]


@pytest.mark.slow
@pytest.mark.parametrize("store", ["trajectories", "final", "statistics"])
def test_an_ensemble_is_rewritten_with_all_its_tables(
    tmp_path: Path, store: str, request: pytest.FixtureRequest
) -> None:
    def many(kind: str) -> Any:
        return load("kowalevski_hk", [*MANY, f"ensemble.store={store}", f"output.format={kind}"])

    run_experiment(many("parquet"), tmp_path)
    direct = contents(run_experiment(many("csv"), tmp_path / "direct").stored.folder)
    request.getfixturevalue("never_computes")
    made = run_experiment(many("csv"), tmp_path)
    assert made.status == "rewritten as csv"
    found = contents(made.stored.folder)
    tables = {name for name in direct if name.endswith(".csv")}
    assert tables == ({"trajectories.csv"} if store == "statistics" else {"series.csv", "trajectories.csv"})
    assert {name: found[name] for name in tables} == {name: direct[name] for name in tables}
    assert found.keys() == direct.keys()
    assert made.stored.manifest["trajectories"] == "trajectories.csv"
    back = run_experiment(many("parquet"), tmp_path)
    assert back.status == "rewritten as parquet"
    assert back.stored.damage() == {}


@pytest.mark.slow
@pytest.mark.parametrize("at", ["series", "manifest", "rename"])
def test_a_failure_keeps_the_earlier_format(tmp_path: Path, at: str, monkeypatch: pytest.MonkeyPatch) -> None:
    first = run_experiment(experiment(), tmp_path).stored.folder
    before = contents(first)
    full = OSError(28, "No space left on device")

    def fail(*arguments: Any, **options: Any) -> None:
        raise full

    with monkeypatch.context() as patch:
        if at == "series":
            patch.setattr("topcli.store.series.GrowingFile.append", fail)
        elif at == "manifest":
            patch.setattr(store_folder, "write_whole", fail)
        else:
            patch.setattr(os, "rename", fail)
        with pytest.raises(RunError, match="no space left on the device"):
            run_experiment(experiment(CSV), tmp_path)
    assert contents(first) == before
    assert run_experiment(experiment(CSV), tmp_path).status == "rewritten as csv"
    assert [path.name for path in tmp_path.iterdir()] == ["kowalevski_hk"]


def test_the_earlier_file_is_there_until_the_new_one_is_complete(tmp_path: Path, monkeypatch) -> None:
    folder = run_experiment(experiment(), tmp_path).stored.folder
    seen = []
    original = os.rename

    def watched(old: Path, new: Path) -> None:
        seen.append((stored_run(folder), [run for path in tmp_path.iterdir() if (run := stored_run(path))]))
        original(old, new)

    monkeypatch.setattr(os, "rename", watched)
    run_experiment(experiment(CSV), tmp_path)
    assert seen[0][0].series.name == "series.parquet"
    names = [[run.series.name for run in complete] for _, complete in seen]
    assert all("series.csv" in complete and "series.parquet" in complete for complete in names)


def test_damaged_tables_are_computed_again_whatever_their_size(tmp_path: Path, monkeypatch) -> None:
    """Rewriting would give a damaged large file a valid checksum; a run in the same format compares its size only."""
    monkeypatch.setattr("topcli.store.manifest.CHECKED_AT_ONCE", 0)
    series = run_experiment(experiment(CSV), tmp_path).stored.series
    text = series.read_bytes()
    series.write_bytes(text[:-3] + bytes([text[-3] ^ 1]) + text[-2:])
    said: list[str] = []
    made = run_experiment(experiment(), tmp_path, RunOptions(on_message=said.append))
    assert made.status == "ran"
    assert "series.csv is damaged" in said[0]
    assert made.stored.damage() == {}


def test_a_failed_run_is_rewritten_and_repeated_only_on_request(tmp_path: Path) -> None:
    fails = ["scheme=rk4", "h=40", "initial.omega=[1e6, 1e6, 1e6]"]
    blown = load_experiment("kowalevski_hk", [*BASE[1:], *fails])
    assert run_experiment(blown, tmp_path).outcome.value == "blew_up"
    csv = load_experiment("kowalevski_hk", [*BASE[1:], *fails, CSV])
    made = run_experiment(csv, tmp_path)
    assert (made.status, made.outcome.value) == ("rewritten as csv", "blew_up")
    assert run_experiment(blown, tmp_path, RunOptions(retry_failed=True)).status == "ran"


def test_a_users_files_are_kept(tmp_path: Path) -> None:
    folder = run_experiment(experiment(), tmp_path).stored.folder
    (folder / "notes.txt").write_text("mine")
    made = run_experiment(experiment(CSV), tmp_path)
    assert made.status == "rewritten as csv"
    assert made.set_aside is not None
    assert (made.set_aside / "notes.txt").read_text() == "mine"
    assert (made.set_aside / "series.parquet").exists()
    kept = f"kept the earlier folder of this run, with files that are not topcli's, as {made.set_aside}"
    assert made.set_aside_message == kept
    other = run_experiment(experiment("scheme=rk4"), tmp_path, RunOptions(force=True))
    assert other.set_aside_message == f"renamed the earlier, different run to {other.set_aside}"
    assert run_experiment(experiment("name=new"), tmp_path).set_aside_message == ""


def test_an_unfinished_run_is_continued_in_its_own_format(tmp_path: Path, small_chunks: None) -> None:
    asked = iter([False, False, True, True, True])
    stopped = run_experiment(experiment(), tmp_path, RunOptions(stop=lambda: next(asked, True)))
    assert stopped.outcome.value == "interrupted"
    with pytest.raises(UsageError, match="is written as parquet, not csv") as refused:
        run_experiment(experiment(CSV), tmp_path, RunOptions(resume=True))
    assert "--format parquet" in str(refused.value)
    assert run_experiment(experiment(), tmp_path, RunOptions(resume=True)).status == "resumed"
    assert run_experiment(experiment(CSV), tmp_path, RunOptions(resume=True)).status == "rewritten as csv"


def test_a_run_with_a_digest_of_an_earlier_version_is_refused_by_name(tmp_path: Path) -> None:
    stored = run_experiment(experiment(), tmp_path).stored
    old = sealed({**stored.manifest, "digest": "0" * 64}, MANIFEST_SEAL)
    (stored.folder / "manifest.json").write_text(json.dumps(old))
    with pytest.raises(UsageError, match="this experiment as identified by another version of topcli"):
        run_experiment(experiment(), tmp_path)
    with pytest.raises(UsageError, match="a different experiment"):
        run_experiment(load_experiment("kowalevski_hk", ["N=300", "h=0.02"]), tmp_path)
    made = run_experiment(experiment(), tmp_path, RunOptions(force=True))
    assert made.set_aside == tmp_path / "kowalevski_hk.00000000"


def test_the_plan_says_that_a_run_will_be_rewritten(cli: Any) -> None:
    command = ("run", "kowalevski_hk", "--set", "N=50", "--name", "x")
    cli(*command)
    assert "x: will be rewritten as csv: 51 rows" in cli(*command, "--format", "csv", "--dry-run").out
    assert "(rewritten as csv)" in cli(*command, "--format", "csv").err
    assert cli(*command, "--json").json()["runs"][0]["status"] == "rewritten as parquet"


@pytest.mark.slow
def test_the_step_at_which_a_run_left_its_motion_stays_in_its_tables(tmp_path: Path) -> None:
    """HK with so long a step that gamma² grows to 2e59, as parquet, csv and parquet again."""
    big = ["h=2", "N=1000"]
    first = run_experiment(load_experiment("kowalevski_hk", big), tmp_path)
    about = pq.read_metadata(first.stored.series).metadata
    left = first.stored.manifest["left_motion"]
    assert json.loads(about[b"topcli.left_motion"]) == left
    assert 0 < left["step"] < 1000
    assert run_experiment(load_experiment("kowalevski_hk", [*big, CSV]), tmp_path).status == "rewritten as csv"
    again = run_experiment(load_experiment("kowalevski_hk", big), tmp_path)
    assert again.status == "rewritten as parquet"
    assert again.stored.manifest["left_motion"] == left
    assert pq.read_metadata(again.stored.series).metadata[b"topcli.left_motion"] == about[b"topcli.left_motion"]
