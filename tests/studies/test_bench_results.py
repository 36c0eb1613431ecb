"""The results of a bench on disk, and the command."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from cases import table_of
from topcli.errors import RunError
from topcli.studies.bench.contest import Problem, bench_problems, choose
from topcli.studies.bench.measure import Effort, bench
from topcli.studies.bench.result import DECADES, POINTS, points_table, store_bench, stored_benches


@pytest.fixture(scope="module")
def short() -> Problem:
    """The generic Kowalevski top for a short while."""
    (problem,) = bench_problems((), ("kowalevski_generic_hk",), ("h=0.01", "N=1000"), 20)
    return problem


@pytest.fixture
def result(short: Problem) -> dict[str, Any]:
    """A small result."""
    return bench(short, choose(short, ("hk", "rk4")), [], Effort(0.001, 1))


def test_a_result_is_stored_whole(result: dict[str, Any], tmp_path: Path) -> None:
    stored, aside = store_bench(result, "code", "start", tmp_path / "bench")
    assert aside is None
    assert stored.folder == tmp_path / "bench" / "kowalevski_generic_hk"
    names = sorted(path.name for path in stored.folder.iterdir())
    assert names == ["manifest.json", "points.parquet", "report.json"]
    table = pq.read_table(stored.folder / POINTS)
    assert table.num_rows == sum(len(row["points"]) for row in result["competitors"])
    assert table.column("name").to_pylist() == points_table(result)["name"]
    assert {"error", "final_error", "drift", "seconds", "drift_k_sq", "lower_quartile"} <= set(table.column_names)
    (found,) = stored_benches(tmp_path / "bench")
    assert {key: found[1][key] for key in result} == json.loads(json.dumps(result))


def test_a_result_is_never_lost(result: dict[str, Any], tmp_path: Path) -> None:
    out = tmp_path / "bench"
    first, _ = store_bench(result, "code", "start", out)
    for code in ("code", "other code"):  # the same measured again, and another
        _, aside = store_bench(result, code, "start", out)
        assert aside is not None
        assert (aside / POINTS).is_file()
    assert [run.folder for run, _ in stored_benches(out)] == [first.folder]  # what is set aside is not drawn
    fewer = {**result, "competitors": result["competitors"][:1]}
    assert store_bench(fewer, "other code", "start", out)[1] is not None
    assert len([path for path in out.iterdir() if path.is_dir()]) == 4


def test_half_written_result_is_not_read(result: dict[str, Any], tmp_path: Path) -> None:
    def fails(*arguments: object) -> None:
        raise OSError(28, "No space left on device")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("topcli.studies.bench.result.write_table", fails)
        with pytest.raises(RunError, match="nothing of this run was stored"):
            store_bench(result, "code", "start", tmp_path)
    assert list(tmp_path.iterdir()) == []
    assert stored_benches(tmp_path) == []


@pytest.mark.slow
def test_bench_measures_and_draws_end_to_end(cli: Any) -> None:
    scenes = ("--scene", "lagrange", "--scene", "kowalevski-paper")
    arguments = (*scenes, "--against", "none", "--budget", "0.001", "--repetitions", "1")
    document = cli("bench", "hk", "rk4", "hybrid", *arguments, "--json").json()
    assert document["command"] == "bench"
    assert document["schema_version"] == 1
    scene, other = document["scenes"]
    assert [row["name"] for row in other["competitors"]] == ["hk", "rk4", "hybrid"]
    assert [row["name"] for row in scene["competitors"]] == ["hk", "rk4"]
    assert scene["left_out"] == [{"name": "hybrid", "reason": "does not fit the top lagrange"}]
    assert scene["skipped_peers"] == scene["failed_peers"] == []
    for row in scene["competitors"]:
        assert row["parameter"] == "h"
        assert row["compile_seconds"] >= 0.0
        for point in row["points"]:
            assert set(point) == {
                "value", "error", "final_error", "drift", "invariants",
                "seconds", "fastest", "quartiles", "repetitions", "processes",
            }  # fmt: skip
    assert [row["error"] for row in scene["decades"]] == list(DECADES)
    assert Path(scene["folder"], POINTS).is_file()
    again = cli("bench", "rk4", *arguments, "--points")
    assert "for an error of 1e-3 take rk4 with h=" in again.out
    assert "renamed the earlier result to results/bench/lagrange-" in again.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    table_of("""
hkk --scene euler          did you mean 'hk'
hybrid --scene euler       does not fit top 'euler'
--scene euler --set h=1    none is given
"""),
)
def test_mistakes_are_reported_with_a_correction(cli: Any, arguments: str, message: str) -> None:
    failed = cli("bench", *arguments.split())
    assert failed.code == 2
    assert message in failed.err
    assert not Path("results").exists()
