"""Runs that are stopped or killed, and resumed: equal, bit for bit, to the uninterrupted run."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from conftest import GEN
from declared import TRIALS, by_name
from resuming import FILES, HK, NAME, after, content, killed, small
from topcli.analysis.tally import InvariantTally
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Outcome, Scheme
from topcli.engine.run import Position, Run
from topcli.errors import UsageError
from topcli.runs.decision import RunOptions
from topcli.runs.recorder import COST, Checkpoints
from topcli.runs.run import run_experiment
from topcli.runs.run_list import listed_runs
from topcli.store import parts
from topcli.store.checkpoint import CHECKPOINT, read_checkpoint, write_checkpoint
from topcli.store.manifest import stored_runs
from topcli.store.parts import lock_new, new_part, parts_of, take_lock
from topcli.store.series import SeriesMark, read_series

pytestmark = pytest.mark.usefixtures("small_chunks")


@pytest.mark.slow
@by_name
def test_every_scheme_resumes_bit_for_bit(scheme: Scheme) -> None:
    """Working states of every scheme, carried quantities and counters included, and the sums of the report."""
    top = TRIALS[scheme.top][-1]
    method, N, every = scheme.build(top, scheme.options()), 120, 7
    invariants = top.invariants()

    def pieces(run: Run, tally: InvariantTally) -> list[bytes]:
        made = []
        for chunk in run:
            tally.add(chunk.n, chunk.states)
            made.append(chunk.n.tobytes() + chunk.states.tobytes())
        return made

    y0 = GEN[: len(top.components)]
    whole, whole_tally = Run(top, method, y0, 0.01, N, every), InvariantTally(invariants, 0.01)
    expected = pieces(whole, whole_tally)
    first, tally = Run(top, method, y0, 0.01, N, every, after(3)), InvariantTally(invariants, 0.01)
    before = pieces(first, tally)
    start = first.position()
    assert start is not None
    assert 0 < start.done < N
    resumed = InvariantTally(invariants, 0.01)
    resumed.restore(tally.state())
    second = Run(top, method, y0, 0.01, N, every, start=start)
    assert b"".join(before + pieces(second, resumed)) == b"".join(expected)
    assert second.ending == whole.ending
    assert second.position().work.tobytes() == whole.position().work.tobytes()
    assert resumed.report() == whole_tally.report()


RESUMED = """
increments: kowalevski_hk parquet N=100
carried phase: kowalevski_hk csv scheme=hybrid N=100
iterative with counters: kowalevski_hk parquet scheme=hybrid-sym N=100
interpreted: kowalevski_hk csv scheme=dop853 N=70
closed form: euler_gamma_hk parquet scheme=exact N=100
chart: kowalevski_bohlin_a parquet N=100
attitude: kowalevski_hk csv N=300 output.attitude=quaternion output.every=3
attitude of a series: kowalevski_hk parquet scheme=taylor N=100 output.attitude=quaternion output.every=3
"""


@pytest.mark.slow
@pytest.mark.parametrize("kind", RESUMED.strip().split("\n"))
def test_an_interrupted_run_is_resumed_to_the_same_folder(tmp_path: Path, kind: str) -> None:
    """Stopped after one chunk, twice or three times on and stopped again."""
    scene, suffix, *overrides = kind.partition(": ")[2].split()
    experiment = load_experiment(scene, [f"output.format={suffix}", *overrides], any_precision=True)
    expected = content(run_experiment(experiment, tmp_path / "whole").stored.folder)
    out, messages, steps = tmp_path / "out", list[str](), list[int]()
    stopped = RunOptions(resume=True, stop=after(1), checkpoint_every=0.0, on_message=messages.append)
    result = run_experiment(experiment, out, replace(stopped, resume=False))
    while result.outcome is Outcome.INTERRUPTED:
        assert (result.stored.folder / CHECKPOINT).exists()
        rows = len(next(iter(read_series(result.stored.series).values())))
        assert rows == result.report["step"] // experiment.output.every + 1
        steps.append(result.report["step"])
        stop = after(1) if len(steps) < 4 else lambda: False
        result = run_experiment(experiment, out, replace(stopped, stop=stop))
        assert result.status == "resumed"
    assert content(result.stored.folder) == expected
    assert messages == [f"{experiment.name}: continues from step {step} of {experiment.N}" for step in steps]
    assert 0 < steps[0] <= steps[-1] < experiment.N
    assert [path.name for path in out.iterdir()] == [experiment.name]
    assert result.report["seconds"]["run"] > 0.0
    assert [one["step"] for one in result.stored.manifest["resumed"]] == steps


@pytest.mark.slow
def test_a_run_removes_the_dead_parts_that_it_supersedes_and_no_others(tmp_path: Path) -> None:
    """Parts of the same name belong to another experiment, to other code, or to this run; some got further."""
    out = tmp_path / "out"
    out.mkdir()

    def left(place: str, experiment: Experiment, chunks: int, **about: Any) -> str:
        folder = killed(tmp_path / place, experiment, chunks)
        checkpoint = read_checkpoint(folder)
        assert checkpoint is not None
        write_checkpoint(folder, replace(checkpoint, about={**checkpoint.about, **about}))
        folder.rename(out / folder.name)
        return folder.name

    other_code = left("code", small(), 4, code="0" * 64)
    other = left("experiment", small("h=0.002"), 4)
    less, more = left("less", small(), 2), left("more", small(), 8)
    run_experiment(small(), out, RunOptions(stop=after(5)))
    assert {path.name for path in out.iterdir()} == {NAME, other, other_code, more}
    assert not (out / less).exists()
    assert run_experiment(small(), out, RunOptions(force=True)).outcome is Outcome.COMPLETED
    assert {path.name for path in out.iterdir()} == {NAME, other, other_code}
    expected = content(run_experiment(small("h=0.002"), tmp_path / "whole").stored.folder)
    resumed = run_experiment(small("h=0.002"), out, RunOptions(resume=True))
    assert resumed.status == "resumed"
    assert content(resumed.stored.folder) == expected


def test_a_run_that_fails_has_no_checkpoint(tmp_path: Path) -> None:
    overrides = ["scheme=rk4", "h=40", "initial.omega=[1e6, 1e6, 1e6]"]
    result = run_experiment(small(*overrides), tmp_path, RunOptions(checkpoint_every=0.0))
    assert result.outcome is Outcome.BLEW_UP
    assert not (result.stored.folder / CHECKPOINT).exists()
    assert run_experiment(small(*overrides), tmp_path, RunOptions(resume=True)).status == "up to date"


def test_two_resumes_accumulate_history_seconds_and_start(tmp_path: Path) -> None:
    left = killed(tmp_path, small(), 3)
    first = read_checkpoint(left)
    assert first is not None
    began = "2001-02-03T04:05:06+00:00"
    write_checkpoint(left, replace(first, about={**first.about, "run_seconds": 1000.0, "started": began}))
    second = run_experiment(small(), tmp_path, RunOptions(resume=True, stop=after(2)))
    assert second.outcome is Outcome.INTERRUPTED
    third = run_experiment(small(), tmp_path, RunOptions(resume=True))
    assert third.outcome is Outcome.COMPLETED
    steps = [first.done, second.report["step"]]
    assert 0 < steps[0] < steps[1] < 300
    for result, count in ((second, 1), (third, 2)):
        manifest = result.stored.manifest
        assert manifest["started"] == began
        assert [one["step"] for one in manifest["resumed"]] == steps[:count]
        assert manifest["seconds"] == result.report["seconds"]
    assert 1000.0 < second.report["seconds"]["run"] < third.report["seconds"]["run"] < 1100.0


@pytest.mark.parametrize(("cost", "pause"), [(0.05, 10.0), (2.0, None)])
def test_slow_checkpoints_are_written_less_often(cost: float, pause: float | None, tmp_path: Path) -> None:
    """The next one is due ten seconds after the end of the last, or COST times as long as that one took."""
    clock, written = [0.0], []

    def state(flush: bool) -> Any:
        clock[0] += cost
        written.append(flush)
        return {}, mark, (np.empty(0), np.empty(0))

    mark = SeriesMark(1, {}, "")
    run: Any = SimpleNamespace(position=lambda: Position(7, np.zeros(1), 1, 1), run_seconds=0.0)
    recorder: Any = SimpleNamespace(series=mark, state=state, stored=lambda numbers: numbers)
    kept = Checkpoints(tmp_path, {}, 10.0, lambda: clock[0])
    clock[0] = 5.0
    kept.consider(run, recorder)
    assert written == [True]
    ended, pause = clock[0], pause or COST * cost
    assert pause > 10.0 or cost < 1.0
    for time, count in ((ended + 0.999 * pause, 1), (ended + 1.001 * pause, 2)):
        clock[0] = time
        kept.consider(run, recorder)
        assert len(written) == count


def test_the_last_two_states_may_still_be_written_to_a_full_disk(tmp_path: Path) -> None:
    """The furthest first, and none that lies before the checkpoint on the disk."""
    done = [0]
    run: Any = SimpleNamespace(position=lambda: Position(done[0], np.zeros(1), 1, 1), run_seconds=0.5)
    series = SimpleNamespace(length=0)
    recorder: Any = SimpleNamespace(
        series=series, stored=lambda numbers: numbers,
        state=lambda flush: ({}, SeriesMark(done[0], {}, ""), (np.empty(0, dtype=np.int64), np.empty((0, 1)))),
    )  # fmt: skip
    about = {"digest": "", "code": "", "started": "", "resumed": [], "config": {}, "environment": {}}
    kept = Checkpoints(tmp_path, about, 10.0, lambda: 0.0)

    def steps_after(step: int, save: bool = False) -> list[int]:
        done[0] = series.length = step
        kept.save(run, recorder) if save else kept.consider(run, recorder)
        return [state.done for state in kept.to_save()]

    assert [steps_after(3), steps_after(5), steps_after(7)] == [[3], [5, 3], [7, 5]]
    assert [steps_after(9, save=True), steps_after(11)] == [[9], [11, 9]]


@pytest.mark.slow
def test_living_process_excludes_others(tmp_path: Path) -> None:
    """The lock is the system's: held by a living process, free the moment it is killed."""
    code = (
        "import sys; from pathlib import Path; from topcli.config.load import load_experiment\n"
        "from topcli.runs.decision import RunOptions\n"
        "from topcli.runs.run import run_experiment\n"
        f"experiment = load_experiment({str(HK)!r}, ['N=300'])\n"
        "def wait(done, total):\n"
        "    if done > 200000 or done == total:\n"
        "        print('running', flush=True); sys.stdin.read()\n"
        "run_experiment(experiment, Path(sys.argv[1]), RunOptions(checkpoint_every=0.0, on_progress=wait))\n"
    )
    command = [sys.executable, "-c", code, str(tmp_path)]
    other = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert other.stdout is not None
        assert other.stdout.readline() == "running\n"
        (part,) = parts_of(tmp_path, NAME)
        assert (part.alive, part.owner["pid"]) == (True, other.pid)
        with pytest.raises(UsageError, match=f"process {other.pid} is running this experiment"):
            run_experiment(small(), tmp_path, RunOptions(resume=True))
        messages: list[str] = []
        assert run_experiment(small(), tmp_path, RunOptions(on_message=messages.append)).status == "ran"
        assert messages == [f"{NAME}: process {other.pid} is running this experiment too"]
        assert part.folder.is_dir(), "the other one's folder is left alone"
    finally:
        other.kill()
        other.communicate()
    (part,) = parts_of(tmp_path, NAME)
    assert not part.alive, "a stale lock does not block"
    assert run_experiment(small(), tmp_path, RunOptions(force=True, resume=True)).status in ("resumed", "ran")
    assert parts_of(tmp_path, NAME) == []


@pytest.mark.parametrize("locks", [True, False])
def test_lock_belongs_to_a_living_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, locks: bool) -> None:
    """Without locks, the process number shows if the owner is alive."""
    if not locks:
        monkeypatch.setattr(parts, "fcntl", None)
    folder = new_part(tmp_path, "x")
    folder.mkdir()
    assert take_lock(folder) is None, "just made by a living process"
    mine = lock_new(folder, {"digest": "d"})
    assert parts.owner(folder) == {"pid": os.getpid(), "digest": "d"}
    assert take_lock(folder) is None
    mine.release()
    mine.release()
    if not locks:
        (folder / "lock").write_text('{"pid": 999999999}')
    again = take_lock(folder, {"digest": "e"})
    assert again is not None
    assert parts.owner(folder)["digest"] == "e"
    again.release()


KEYS = ("name", "outcome", "step", "resumable")


def rows(out: Path) -> list[tuple[Any, ...]]:
    return [tuple(item[key] for key in KEYS) for item in listed_runs(out)]


@pytest.mark.slow
def test_unfinished_runs_are_listed_beside_finished_ones(cli: Callable[..., Any], in_tmp: Path) -> None:
    out = in_tmp / "results"
    run_experiment(small("name=done"), out)
    run_experiment(small("name=stopped"), out, RunOptions(stop=after(4)))
    killed(out, small("name=dead"), 5)
    (out / ".empty.part-999999999-0123abcd").mkdir()
    seen: list[list[tuple[Any, ...]]] = []
    run_experiment(small("name=busy"), out, RunOptions(on_progress=lambda done, total: seen.append(rows(out))))
    assert ("busy", "running", None, False) in seen[1]
    before = sorted(path.relative_to(out) for path in out.rglob("*"))
    found = rows(out)
    assert sorted(path.relative_to(out) for path in out.rglob("*")) == before, "listing changes nothing"
    steps = {name: step for name, _, step, _ in found}
    assert 0 < steps["stopped"] < 300
    assert 0 < steps["dead"] < 300
    assert [(name, outcome, resumable) for name, outcome, _, resumable in found] == [
        ("busy", "completed", False),
        ("dead", "killed", True),
        ("done", "completed", False),
        ("empty", "killed", False),
        ("stopped", "interrupted", True),
    ]
    dead = cli("list", "runs", "--json").json()["runs"][1]
    assert (dead["scheme"], dead["h"], dead["N"], dead["ended"]) == ("hk", 0.001, 300, None)


@pytest.mark.parametrize(("how", "given"), [("killed", "mine"), ("interrupted", "results/mine/")])
def test_a_run_continues_by_its_name(cli: Callable[..., Any], in_tmp: Path, how: str, given: str) -> None:
    out = in_tmp / "results"
    if how == "killed":
        left = killed(out, small("name=mine"), 5)
        assert stored_runs(out) == []
        (left / ".checkpoint.7.npz").write_bytes(b"half a checkpoint")
        with (left / "series.parquet").open("ab") as file:
            file.write(b"half a row group")
    else:
        run_experiment(small("name=mine"), out, RunOptions(stop=after(4)))
    said = cli("run", given, "--resume")
    assert said.code == 0
    assert "mine: continues from step" in said.err
    whole = run_experiment(small("name=mine"), in_tmp / "whole").stored.folder
    assert content(out / "mine") == content(whole)
    assert [path.name for path in out.iterdir()] == ["mine"]
    assert {path.name for path in (out / "mine").iterdir()} == {*FILES, "series.parquet"}
    assert "(up to date)" in cli("run", given, "--resume").err


def test_a_run_that_is_computed_now_is_not_resumed_by_name(cli: Callable[..., Any], in_tmp: Path) -> None:
    said: list[Any] = []

    def once(done: int, total: int) -> None:
        if not said:
            said.append(cli("run", "mine", "--resume"))

    run_experiment(small("name=mine"), in_tmp / "results", RunOptions(on_progress=once))
    assert said[0].code == 2
    assert "is computing this run now; there is nothing to resume" in said[0].err
