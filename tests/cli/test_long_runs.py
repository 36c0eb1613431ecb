"""Long runs through the command: stopped, killed, resumed, out of disk space; and their messages meanwhile."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from conftest import ROOT
from injected import Operations, command_in_fork, signal_to_self
from test_cli import process
from topcli.cli.output import ProgressDisplay, spell_seconds
from topcli.store.manifest import stored_runs
from topcli.store.series import read_series

HK = str(ROOT / "configs" / "kowalevski_hk.yaml")


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_stopped_run_is_resumed(tmp_path: Path, number: signal.Signals) -> None:
    """Through the command: what SIGTERM or SIGKILL leaves is continued to the end of a run that was never stopped."""
    arguments = [
        "run",
        HK,
        "--name",
        "kowalevski_hk",
        "--set",
        "N=12000000",
        "--set",
        "output.every=50000",
        "--checkpoint-every",
        "0",
    ]
    at_a_checkpoint = Operations(tmp_path, 3, signal_to_self(number), names=["replace"], only="checkpoint")
    said = command_in_fork(arguments, tmp_path, at_a_checkpoint)
    if number == signal.SIGTERM:
        assert said.code == 130, said.err
        assert "--resume continues it" in said.err
        refused = process(*arguments, "--resume", "--set", "h=0.002", cwd=tmp_path)
        assert refused.returncode == 2
        assert "h: 0.001 there, 0.002 here" in refused.stderr
    else:
        assert said.code == -signal.SIGKILL
        planned = process(*arguments, "--resume", "--dry-run", cwd=tmp_path)
        assert "will continue from step" in planned.stdout
    again = process(*arguments, "--resume", "--json", cwd=tmp_path)
    assert "continues from step" in again.stderr
    whole = process(*arguments, "--out", "whole", "--json", cwd=tmp_path)
    reports = [json.loads(done.stdout)["runs"][0] for done in (whole, again)]
    assert [report["status"] for report in reports] == ["ran", "resumed"]
    for report in reports:
        del report["seconds"], report["status"], report["folder"]
    assert reports[0] == reports[1]
    series = [tmp_path / out / "kowalevski_hk" / "series.parquet" for out in ("whole", "results")]
    assert series[0].read_bytes() == series[1].read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("kind", [[], ["--set", "ensemble={random: {count: 3, gamma: sphere}}"]])
def test_a_signal_after_the_last_step_changes_nothing(tmp_path: Path, number: signal.Signals, kind: list[str]) -> None:
    """The run is complete, and says so: nothing is left that --resume could continue."""
    late = Operations(tmp_path, 1, signal_to_self(number), names=["replace"], only=".manifest")
    said = command_in_fork(["run", HK, "--name", "one", "--set", "N=500", *kind], tmp_path, late)
    assert said.code == 0, said.err
    assert "interrupted" not in said.err
    (run,) = stored_runs(tmp_path / "results")
    assert run.outcome.value == "completed"
    again = process("run", HK, "--name", "one", "--set", "N=500", *kind, cwd=tmp_path)
    assert "up to date" in again.stderr


def test_options_that_contradict_each_other(cli) -> None:
    said = cli("run", HK, "--resume", "--force")
    assert said.code == 2
    assert "--resume continues a run and --force repeats it" in said.err
    said = cli("run", HK, "--checkpoint-every", "nan")
    assert said.code == 2
    assert "must be a number of seconds" in said.err


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="limits the file size the way Linux does")
@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_a_file_that_may_not_grow_is_closed_and_readable(tmp_path: Path, suffix: str) -> None:
    """The kernel itself refuses the write, in the second row group; the first is kept."""
    room = 12_000_000 if suffix == "parquet" else 40_000_000
    code = (
        f"import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, ({room}, {room}));"
        "from topcli.__main__ import main;"
        f"sys.argv = ['topcli', 'run', {HK!r}, '--out', {str(tmp_path)!r}, '--format', {suffix!r}, '--quiet',"
        "'--name', 'x', '--set', 'N=300000']; main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    assert f"x/series.{suffix}: the file would exceed the size limit; the run up to step" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    (stored,) = stored_runs(tmp_path)
    assert stored.manifest["outcome"] == "interrupted"
    rows = read_series(stored.series)["n"]
    assert (rows == np.arange(stored.manifest["step"] + 1)).all()
    assert len(rows) > 100_000


class Clock:
    """A clock that the test sets."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


def test_progress_in_a_log_is_sparse_and_tells_rate_and_time_left(capsys: pytest.CaptureFixture[str]) -> None:
    clock, hours = Clock(), 20
    teller = ProgressDisplay(1, False, clock)
    teller.begin("long")
    total, rate = 50_000 * 3600 * hours, 50_000
    for second in range(3600 * hours):
        clock.now = 1000.0 + second
        teller(1_000_000 + rate * second, total + 1_000_000)  # resumed: a million steps had been done before
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "long: 0.0%, 1800000 of 3601000000 steps, 5e+04 steps/s, 19:59:44 h left"
    assert len(lines) < 6 * hours + 40
    assert lines[-1].endswith("min left")
    assert "100.0%" not in lines[-1]


def test_the_rate_follows_the_machine(capsys: pytest.CaptureFixture[str]) -> None:
    """A machine that slows down: the time left follows from the last half minute."""
    clock = Clock()
    teller = ProgressDisplay(2, False, clock)
    teller.begin("first")
    done = 0
    for second in range(200):
        clock.now = 1000.0 + second
        done += 1000 if second < 100 else 100
        teller(done, 1_000_000)
    assert "[1/2] first: " in (last := capsys.readouterr().err.splitlines()[-1])
    assert "100 steps/s" in last


def test_progress_survives_a_terminal_that_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(line: str) -> None:
        raise OSError(5, "Input/output error")

    clock = Clock()
    monkeypatch.setattr("topcli.cli.output.print_message", gone)
    teller = ProgressDisplay(1, False, clock)
    teller.begin("long")
    clock.now += 100.0
    teller(1, 10)
    teller(2, 10)
    teller.close()


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.2, "0 s"), (99, "99 s"), (185, "3:05 min"), (3600, "1:00:00 h"), (90_000, "25:00:00 h"), (300_000, "3 d 11 h")],
)
def test_durations_are_spelled_out(seconds: float, words: str) -> None:
    assert spell_seconds(seconds) == words
