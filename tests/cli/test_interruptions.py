"""Commands that are stopped, killed and run again, and closed pipes; and progress meanwhile."""

from __future__ import annotations

import itertools
import json
import os
import signal
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from conftest import ROOT
from faults import Disk
from injected import command_in_fork, signal_to_self, topcli_process
from topcli.cli.output import Progress
from topcli.engine import integration
from topcli.runs.run import RunOptions
from topcli.sweeps.store import RowStore

HK = str(ROOT / "configs" / "kowalevski_hk.yaml")
SWEEP = """\
base: {top: kowalevski, initial: {omega: [0.7, -0.4, 1.3], gamma: [0.6, 0.48, 0.64]}, scheme: hk, N: 50}
grid:
  h: {from: 1e-9, to: 1e-8, count: 40}
measure: [max_deviation.energy]
"""
STOPS = [signal.SIGINT, signal.SIGTERM]


@pytest.mark.slow
@pytest.mark.parametrize("number", [*STOPS, signal.SIGKILL])
def test_a_stopped_run_is_continued(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals) -> None:
    """Remains of a signal at the third checkpoint are continued to the end of a run that was never stopped."""
    steps = ["--set", "N=12000000", "--set", "output.every=50000"]
    arguments = ["run", HK, "--set", "name=long", *steps]
    monkeypatch.setattr(integration, "CALL_SECONDS", 0.0)
    monkeypatch.setattr("topcli.runs.run.RunOptions", partial(RunOptions, checkpoint_every=0.0))
    at_a_checkpoint = Disk(tmp_path, 3, meanwhile=signal_to_self(number), only="replace checkpoint")
    said = command_in_fork(arguments, tmp_path, at_a_checkpoint)
    if number != signal.SIGKILL:
        assert said.code == 130, said.err
        assert "run it again to continue" in said.err
        assert "Traceback" not in said.err
        manifest = json.loads((tmp_path / "results" / "long" / "manifest.json").read_text())
        assert manifest["outcome"] == "interrupted"
        assert 0 < manifest["step"] < 12_000_000
    else:
        assert said.code == -signal.SIGKILL
        planned = topcli_process(*arguments, "--dry-run", cwd=tmp_path)
        assert "will continue from its last checkpoint" in planned.stdout
    again = topcli_process(*arguments, "--json", cwd=tmp_path)
    assert "long: continues from the last checkpoint" in again.stderr
    whole = topcli_process(*arguments, "--out", "whole", "--json", cwd=tmp_path)
    reports = [json.loads(done.stdout)["runs"][0] for done in (whole, again)]
    assert [report["status"] for report in reports] == ["ran", "continued"]
    for report in reports:
        del report["seconds"], report["status"], report["folder"]
    assert reports[0] == reports[1]
    series = [tmp_path / out / "long" / "series.parquet" for out in ("whole", "results")]
    assert series[0].read_bytes() == series[1].read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("number", STOPS)
@pytest.mark.parametrize("kind", ["run", "ensemble", "sweep"])
def test_a_signal_after_the_last_step_changes_nothing(tmp_path: Path, number: signal.Signals, kind: str) -> None:
    """The result is complete, and says so: nothing is left that could be continued."""
    (tmp_path / "one.yaml").write_text(SWEEP)
    many = ["--set", "ensemble={random: {count: 3, gamma: sphere}}"] if kind == "ensemble" else []
    run = ["run", HK, "--set", "name=one", "--set", "N=500", *many]
    command, last = (["sweep", "one.yaml"], "rows") if kind == "sweep" else (run, "manifest")
    late = Disk(tmp_path, 1 + (kind != "sweep"), meanwhile=signal_to_self(number), only=f"replace {last}")
    said = command_in_fork(command, tmp_path, late)
    assert said.code == 0, said.err
    assert "interrupted" not in said.err
    assert (tmp_path / "results" / "one" / "manifest.json").exists()
    again = topcli_process(*command, cwd=tmp_path)
    assert ("(0 ran)" if kind == "sweep" else "up to date") in again.stderr


@pytest.mark.slow
@pytest.mark.parametrize("number", STOPS)
def test_a_terminated_sweep_ends_as_interrupted_and_continues(
    cli, in_tmp: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    """A signal when the second of four batches is stored: at most the third one is finished."""
    (in_tmp / "study.yaml").write_text(SWEEP)
    add, batches = RowStore.add, itertools.count(1)

    def interrupted(store: RowStore, *rows: Any) -> None:
        add(store, *rows)
        if next(batches) == 2:
            os.kill(os.getpid(), number)

    with monkeypatch.context() as patch:
        patch.setattr(RowStore, "add", interrupted)
        said = command_in_fork(["sweep", "study.yaml", "--threads", "1"], in_tmp, Disk(in_tmp, 10**9))
    assert said.code == 130, said.err
    assert "interrupted; run it again to continue" in said.err
    done = pq.read_table("results/study/rows.parquet").num_rows
    assert 0 < done <= 30
    plan = cli("sweep", "study.yaml", "--dry-run", "--json").json()
    assert (plan["rows"], plan["new"]) == (40, 40 - done)


@pytest.mark.slow
@pytest.mark.parametrize("fails", [False, True])
def test_a_closed_pipe_changes_neither_the_runs_nor_their_code(tmp_path: Path, fails: bool) -> None:
    """The reader is gone before anything is printed: the worst case of ``| head -1``. Both runs are finished."""
    failing = ["--set", "scheme=rk4", "--set", "h=40", "--set", "initial.omega=[1e6, 1e6, 1e6]"]
    arguments = ["run", "kowalevski_hk", "kowalevski_hk", "--set", "N=50", *(failing if fails else ())]
    read, write = os.pipe()
    os.close(read)
    done = topcli_process(*arguments, cwd=tmp_path, stdout=write, env={"PYTHONUNBUFFERED": ""})
    os.close(write)
    assert done.returncode == int(fails), done.stderr
    (folder,) = (tmp_path / "results").iterdir()
    assert done.stderr.count(f"{folder.name}: ") == (4 if fails else 2)
    assert "cannot write output" not in done.stderr
    assert "Traceback" not in done.stderr
    assert (folder / "manifest.json").is_file()


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_unusable_stdout_is_not_reported_as_a_bug(tmp_path: Path) -> None:
    with open("/dev/full", "w") as full:
        done = topcli_process("show", HK, cwd=tmp_path, stdout=full)
    assert done.returncode == 1
    assert "cannot write output" in done.stderr
    assert "Traceback" not in done.stderr
    done = topcli_process("run", HK, "--set", "N=50", cwd=tmp_path, env={"PYTHONIOENCODING": "ascii"})
    assert done.returncode == 0, done.stderr


# progress


class Clock:
    """A clock that the test sets."""

    now = 1000.0

    def __call__(self) -> float:
        return self.now


def test_progress_in_a_log_is_rare_and_survives_a_terminal_that_is_gone() -> None:
    clock, lines = Clock(), []
    progress = Progress(True, lines.append, clock)
    progress.begin("long", unit="rows")
    for seconds, done in ((0.1, 1), (1.0, 10), (14.0, 140), (15.0, 160), (4.0, 200), (100.0, 999)):
        clock.now += seconds
        progress(done, 1000)
    assert lines[0] == "long: 14.0%, 140 of 1000 rows, 9.29 rows/s, 0:01:33 left"
    assert [line.split(",")[0] for line in lines] == ["long: 14.0%", "long: 20.0%", "long: 99.9%"]

    def gone(line: str) -> None:
        raise OSError(5, "Input/output error")

    with closing(Progress(True, gone, clock)) as silent:
        silent.begin("long")
        clock.now += 100.0
        silent(1, 10)
        silent(2, 10)
