"""``topcli sweep`` as a user calls it: what it prints, its exit codes, and rows shown and run by themselves."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from conftest import Said
from injected import Operations, command_in_fork, signal_to_self

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
measure: [deviation.energy]
"""


@pytest.fixture
def study(in_tmp: Path) -> Path:
    path = in_tmp / "study.yaml"
    path.write_text(FILE)
    return path


def rows() -> list[dict[str, object]]:
    return pq.read_table("results/study/rows.parquet").to_pylist()


def test_a_sweep_prints_its_outcomes_and_where_they_are(cli: Cli, study: Path) -> None:
    said = cli("sweep", "study.yaml")
    assert said.code == 0
    assert said.out.split() == ["outcome", "rows", "completed", "4"]
    assert said.err == "study: 4 of 4 rows finished -> results/study/rows.parquet (4 ran)\n"
    assert "(0 ran)" in cli("sweep", "study.yaml").err


def test_json_has_the_numbers_of_the_table(cli: Cli, study: Path) -> None:
    found = cli("sweep", "study.yaml", "--json", "--set", "grid.h=[0.01, 9.0]", "--set", "base.N=500").json()
    table = rows()
    outcomes = [row["outcome"] for row in table]
    assert found["rows"] == found["finished"] == found["ran"] == len(table) == 4
    assert found["outcomes"] == {outcome: outcomes.count(outcome) for outcome in sorted(set(outcomes))}
    assert found["failed"] == sum(outcome != "completed" for outcome in outcomes) > 0


@pytest.mark.parametrize(
    ("steps", "code", "failed"),
    [("[0.01]", 0, 0), ("[0.01, 9.0]", 3, 1), ("[9.0]", 1, 1)],
)
def test_exit_codes_say_how_many_rows_failed(cli: Cli, study: Path, steps: str, code: int, failed: int) -> None:
    said = cli("sweep", "study.yaml", "--set", f"grid.h={steps}", "--set", "grid.scheme=[rk4]", "--set", "base.N=500")
    assert said.code == code
    assert said.err.count("error: row ") == failed
    assert ("(scheme = rk4, h = 9.0): blew up at step" in said.err) == bool(failed)


def test_a_dry_run_says_what_would_run_and_why_and_writes_nothing(cli: Cli, study: Path) -> None:
    said = cli("sweep", "study.yaml", "--dry-run")
    assert said.code == 0
    assert said.out.splitlines() == [
        "study: 4 new, 0 done, 0 failed, in results/study",
        "varied: scheme (2 values), h (2 values)",
        "to run: 4 rows, new",
        "row 0: new: scheme = hk, h = 0.01",
        "row 1: new: scheme = hk, h = 0.02",
        "row 2: new: scheme = rk4, h = 0.01",
        "row 3: new: scheme = rk4, h = 0.02",
    ]
    assert not Path("results").exists()
    cli("sweep", "study.yaml")
    changed = cli("sweep", "study.yaml", "--dry-run", "--set", "grid.h=[0.02, 0.04]").out.splitlines()
    assert changed == [
        "study: 2 new, 2 done, 0 failed, in results/study",
        "varied: scheme (2 values), h (2 values)",
        "changed: grid.h: [0.01, 0.02] -> [0.02, 0.04]",
        "to run: 2 rows, new",
        "row 1: new: scheme = hk, h = 0.04",
        "row 3: new: scheme = rk4, h = 0.04",
        "kept: 2 finished rows no longer belong to the sweep and are not current",
    ]
    data = cli("sweep", "study.yaml", "--dry-run", "--json", "--set", "grid.h=[0.02, 0.04]").json()
    assert (data["new"], data["done"], data["failed"], data["not_current"]) == (2, 2, 0, 2)
    assert data["to_run"][0] == {"row": 1, "reason": "new", "keys": {"scheme": "hk", "h": 0.04}}


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
    assert energy["max_deviation"] == rows()[3]["deviation.energy"]
    as_json = cli("show", "results/study", "--row", "3", "--json").json()
    assert as_json["row_digest"] == rows()[3]["digest"]


def test_the_file_of_a_sweep_can_be_shown(cli: Cli, study: Path) -> None:
    cli("sweep", "study.yaml", "--set", "base.N=7")
    shown = cli("show", "results/study")
    assert shown.code == 0
    assert "  N: 7\n" in shown.out
    study.write_text(shown.out)
    assert "(0 ran)" in cli("sweep", "study.yaml").err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--set", "measure=[deviation.l]"], "--set measure=[deviation.l]: measure: measure 'deviation.l'"),
        (["--dask", "local:2", "--threads", "3"], "--threads does not go with --dask: each worker has its own number"),
        (["--dask", "nowhere"], "--dask 'nowhere': neither a number of workers nor the address of a scheduler\n"),
        (["--time-limit", "-1"], "--time-limit -1: must be a number of seconds, at least 0\n"),
        (
            ["--set", "grid.h={from: 0.001, to: 0.01, count: 60000}"],
            "study.yaml:8: 120000 rows; a sweep of more than 100000 needs --yes",
        ),
    ],
)
def test_a_mistake_is_refused_before_anything_is_written(
    cli: Cli, study: Path, arguments: list[str], message: str
) -> None:
    said = cli("sweep", "study.yaml", *arguments)
    assert said.code == 2
    assert said.err.startswith(f"error: {message}")
    assert not Path("results").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["results"], "results: holds no sweep"),
        (["results/study", "--row", "4"], "has no row 4; its rows are 0 to 3"),
        (["results/study", "--row", "-1"], "has no row -1; its rows are 0 to 3"),
        (["results", "--row", "0"], "results: holds no sweep"),
    ],
)
def test_a_row_that_is_not_there_is_refused(cli: Cli, study: Path, arguments: list[str], message: str) -> None:
    cli("sweep", "study.yaml")
    said = cli("show", *arguments)
    assert said.code == 2
    assert message in said.err


def test_a_sweep_is_no_run(cli: Cli, study: Path) -> None:
    cli("sweep", "study.yaml")
    assert json.loads(cli("list", "runs", "--json").out)["runs"] == []
    said = cli("run", "kowalevski_hk", "--set", "N=10", "--set", "name=study")
    assert said.code == 2
    assert "exists and is not a finished run; nothing was written" in said.err
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


def test_progress_in_a_log_has_rows_rate_time_left_and_failures(capsys: pytest.CaptureFixture[str]) -> None:
    from topcli.cli.output import ProgressDisplay

    times = iter([0.0, 100.0, 100.0, 110.0, 120.0])
    display = ProgressDisplay(1, False, lambda: next(times), unit="rows")
    display.begin("study")
    for done in (0, 50, 100):
        display(done, 200, f"{done // 25} failed" if done else "")
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["study: 50.0%, 100 of 200 rows, 5 rows/s, 20 s left, 4 failed"]


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_terminated_sweep_ends_as_interrupted_and_continues(cli: Cli, study: Path, number: signal.Signals) -> None:
    """A signal when the second of four batches is stored: at most the third one is finished."""
    steps = ["--set", "grid.scheme=[hk]", "--set", "grid.h={from: 1e-9, to: 1e-8, count: 40}"]
    second = Operations(study.parent, 2, signal_to_self(number), names=["pwrite"], only="journal")
    said = command_in_fork(["sweep", "study.yaml", *steps, "--threads", "1"], study.parent, second)
    assert said.code == 130, said.err
    assert "interrupted; run it again to continue" in said.err
    assert 0 < len(rows()) <= 30
    assert not Path("results/study/manifest.json").exists()
    plan = cli("sweep", "study.yaml", *steps, "--dry-run", "--json").json()
    assert (plan["done"], plan["new"]) == (len(rows()), 40 - len(rows()))


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_after_the_last_row_changes_nothing(study: Path, number: signal.Signals) -> None:
    late = Operations(study.parent, 1, signal_to_self(number), names=["replace"], only=".rows")
    said = command_in_fork(["sweep", "study.yaml"], study.parent, late)
    assert said.code == 0, said.err
    assert "interrupted" not in said.err
    assert Path("results/study/manifest.json").exists()


@pytest.mark.slow
def test_each_number_of_a_result_is_in_its_place(cli: Cli, study: Path) -> None:
    """Of six rows one fails, two are done before, and one is left over: no two numbers are equal."""
    failing = ["--set", "base.N=500", "--set", "grid.scheme=[rk4]"]
    cli("sweep", "study.yaml", *failing, "--set", "grid.h=[0.01, 0.02, 0.07]")
    steps = ["--set", "grid.h=[0.01, 0.02, 0.03, 0.04, 0.05, 9.0]"]
    plan = cli("sweep", "study.yaml", *failing, *steps, "--dry-run", "--json").json()
    numbers = ("rows", "new", "done", "failed", "repeated", "not_current")
    assert [plan[key] for key in numbers] == [6, 4, 2, 0, 0, 1]
    said = cli("sweep", "study.yaml", *failing, *steps)
    place = Path("results/study/rows.parquet")
    assert f"study: 6 of 6 rows finished; 1 failed -> {place} (4 ran)" in said.err.splitlines()
    assert "study: 1 earlier rows no longer belong to the sweep; they are not current" in said.err.splitlines()
    assert said.out.split() == ["outcome", "rows", "blew_up", "1", "completed", "5"]
    again = cli("sweep", "study.yaml", *failing, *steps, "--retry-failed", "--json").json()
    counted = {key: again[key] for key in ("rows", "finished", "ran", "failed", "not_current", "outcomes")}
    outcomes = {"blew_up": 1, "completed": 5}
    assert counted == {"rows": 6, "finished": 6, "ran": 1, "failed": 1, "not_current": 1, "outcomes": outcomes}
    manifest = json.loads(Path("results/study/manifest.json").read_text())
    assert (manifest["rows"], manifest["outcomes"]) == (6, outcomes)
    for retry, expected in (([], [6, 0, 6, 1, 0, 1]), (["--retry-failed"], [6, 1, 5, 0, 0, 1])):
        plan = cli("sweep", "study.yaml", *failing, *steps, "--dry-run", "--json", *retry).json()
        assert [plan[key] for key in numbers] == expected
        text = cli("sweep", "study.yaml", *failing, *steps, "--dry-run", *retry).out.splitlines()[0]
        assert text == f"study: {expected[1]} new, {expected[2]} done, {expected[3]} failed, in results/study"


@pytest.mark.parametrize(
    ("finished", "failed", "interrupted", "code"),
    [(4, 0, False, 0), (4, 1, False, 3), (4, 4, False, 1), (1, 1, False, 1), (1, 1, True, 130), (0, 0, False, 0)],
)
def test_exit_codes_count_the_rows_that_finished(finished: int, failed: int, interrupted: bool, code: int) -> None:
    """Of four rows; with --fail-fast the only one that finished may have failed."""
    from types import SimpleNamespace

    from topcli.cli.sweep import exit_code

    plan = SimpleNamespace(survey=SimpleNamespace(count=4))
    result: Any = SimpleNamespace(finished=finished, failed=failed, interrupted=interrupted, plan=plan)
    assert exit_code(result) == code
