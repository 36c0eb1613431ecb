"""``topcli sweep`` as a user calls it: what it prints, its exit codes, and rows shown and run by themselves."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from cases import table_of
from conftest import Said
from topcli.cli.sweep import exit_code
from topcli.sweeps.run import SweepResult

Cli = Callable[..., Said]
FILE = """\
name: study
base:
  top: kowalevski
  initial: {omega: [0.7, -0.4, 1.3], gamma: [0.6, 0.48, 0.64]}
  scheme: rk4
  h: 0.01
  N: 50
grid:
  scheme: [hk, rk4]
  h: [0.01, 0.02]
measure: [max_deviation.energy]
"""


@pytest.fixture
def study(in_tmp: Path) -> Path:
    path = in_tmp / "study.yaml"
    path.write_text(FILE)
    return path


def rows() -> list[dict[str, object]]:
    return pq.read_table("results/study/rows.parquet").to_pylist()


def test_a_dry_run_lists_the_rows_to_run_and_writes_nothing(cli: Cli, study: Path) -> None:
    said = cli("sweep", "study.yaml", "--dry-run")
    assert said.code == 0
    assert said.out.splitlines() == [
        "study: 4 of 4 rows to run, in results/study",
        "row 0: scheme = hk, h = 0.01",
        "row 1: scheme = hk, h = 0.02",
        "row 2: scheme = rk4, h = 0.01",
        "row 3: scheme = rk4, h = 0.02",
    ]
    assert not Path("results").exists()
    cli("sweep", "study.yaml")
    data = cli("sweep", "study.yaml", "--dry-run", "--json", "--set", "grid.h=[0.02, 0.04]").json()
    assert (data["rows"], data["new"]) == (4, 2)
    rows = [{"row": row, "keys": {"scheme": scheme, "h": 0.04}} for row, scheme in ((1, "hk"), (3, "rk4"))]
    assert data["to_run"] == rows


@pytest.mark.slow
def test_a_row_that_is_shown_runs_to_the_same_numbers(cli: Cli, study: Path) -> None:
    cli("sweep", "study.yaml")
    shown = cli("show", "results/study", "--row", "3")
    assert shown.code == 0
    Path("one.yaml").write_text(shown.out)
    report = cli("run", "one.yaml", "--json").json()["runs"][0]
    (energy,) = [row for row in report["invariants"] if row["name"] == "energy"]
    assert report["name"] == "study_3"
    assert (report["scheme"], report["h"], report["N"]) == ("rk4", 0.02, 50)
    assert energy["max_deviation"] == rows()[3]["max_deviation.energy"]
    assert cli("show", "results/study", "--row", "4").code == 2


def test_the_file_of_a_sweep_can_be_shown(cli: Cli, study: Path) -> None:
    cli("sweep", "study.yaml", "--set", "base.N=7")
    shown = cli("show", "results/study")
    assert shown.code == 0
    assert "  N: 7\n" in shown.out
    study.write_text(shown.out)
    assert "(0 ran)" in cli("sweep", "study.yaml").err


def test_a_sweep_is_no_run(cli: Cli, study: Path) -> None:
    cli("sweep", "study.yaml")
    assert [row["kind"] for row in json.loads(cli("list", "runs", "--json").out)["runs"]] == ["sweep"]
    said = cli("run", "kowalevski_hk", "--set", "N=10", "--set", "name=study")
    assert said.code == 2
    assert said.err == "error: results/study: holds a sweep; choose another name with --set name=NAME\n"
    assert len(rows()) == 4


def test_verify_checks_the_files_of_a_sweep(cli: Cli, study: Path) -> None:
    cli("sweep", "study.yaml")
    said = cli("verify", "study")
    assert (said.code, said.out) == (0, "results/study: finished, 4 files intact\n")
    path = Path("results/study/rows.parquet")
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    said = cli("verify", "study")
    assert said.code == 1
    assert "rows.parquet: damaged: its SHA-256 differs" in said.err
    cli("sweep", "study.yaml")
    assert cli("verify", "study").code == 0


@pytest.mark.slow
def test_a_warning_about_a_top_is_printed_once(cli: Cli, study: Path) -> None:
    study.write_text(FILE.replace("kowalevski", "{kind: heavy, A: 5.0}"))
    said = cli("sweep", "study.yaml")
    assert said.code == 0
    assert (
        said.err.count("warning: study: the moments (5, 1.5, 1) violate the triangle inequality: A = 5 > 1 + 1.5") == 1
    )
    assert "warning" not in cli("sweep", "study.yaml", "--quiet").err


def test_failures_after_the_twentieth_are_only_counted(cli: Cli, study: Path) -> None:
    text = "grid.h={from: 9, to: 20, count: 30}"
    said = cli("sweep", "study.yaml", "--set", text, "--set", "grid.scheme=[rk4]", "--set", "base.N=500")
    assert said.code == 1
    assert said.err.count("error: row ") == 20
    assert said.err.count("further failures are only counted") == 1
    assert len({row["message"] for row in rows()}) > 1


def test_each_number_of_a_result_is_in_its_place(cli: Cli, study: Path) -> None:
    """Of six rows one fails, two are done before, and one is left over: no two numbers are equal."""
    sweep = ["sweep", "study.yaml", "--set", "base.N=500", "--set", "grid.scheme=[rk4]", "--set"]
    cli(*sweep, "grid.h=[0.01, 0.02, 0.07]")
    sweep.append("grid.h=[0.01, 0.02, 0.03, 0.04, 0.05, 9.0]")
    said = cli(*sweep)
    assert said.code == 3
    assert "error: row 5: blew up at step" in said.err
    place = Path("results/study/rows.parquet")
    assert f"study: 6 of 6 rows finished; 1 failed -> {place} (4 ran)" in said.err.splitlines()
    assert said.out.split() == ["outcome", "rows", "blew_up", "1", "completed", "5"]
    again = cli(*sweep, "--json").json()
    outcomes = {"blew_up": 1, "completed": 5}
    assert again.items() >= {"rows": 6, "finished": 6, "ran": 0, "failed": 1, "outcomes": outcomes}.items()
    manifest = json.loads(Path("results/study/manifest.json").read_text())
    assert (manifest["rows"], manifest["outcomes"]) == (6, outcomes)


@pytest.mark.parametrize(
    ("finished", "failed", "interrupted", "code"),
    table_of("""
4  0  False  0
4  1  False  3
4  4  False  1
1  1  True   130
0  0  False  0
"""),
)
def test_exit_codes_count_the_rows_that_finished(finished: int, failed: int, interrupted: bool, code: int) -> None:
    outcomes = {"completed": finished - failed, "blew_up": failed}
    assert exit_code(SweepResult(Path(), 4, 4, outcomes, interrupted, 1.0)) == code
