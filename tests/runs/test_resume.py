"""Runs that are stopped, killed or out of disk, and resumed: equal, bit for bit, to the uninterrupted run."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from conftest import GEN, ROOT
from declared import TRIALS, by_name
from resuming import FILES, KINDS, NAME, after, content, killed, small
from topcli.analysis.tally import InvariantTally
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Outcome, Scheme, Stepper
from topcli.engine.loop import Position, Run
from topcli.errors import UsageError
from topcli.runs.decision import RunOptions
from topcli.runs.recorder import COST, Checkpoints
from topcli.runs.run import run_experiment
from topcli.schemes.registry import all_schemes
from topcli.store.checkpoint import CHECKPOINT, read_checkpoint, write_checkpoint
from topcli.store.manifest import stored_run, stored_runs
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


def test_physical_states_alone_do_not_resume_bit_for_bit() -> None:
    """Positive control: started again from the recorded state, a scheme with carried quantities ends elsewhere."""
    (scheme,) = (s for s in all_schemes() if (s.name, s.top) == ("hybrid-xi", "kowalevski"))
    top = TRIALS["kowalevski"][1]
    method = scheme.build(top, scheme.options())
    assert isinstance(method, Stepper)
    assert method.width > 6
    whole = Run(top, method, GEN, 0.01, 400).collect().states
    half = Run(top, method, whole[200], 0.01, 200).collect().states
    assert not (half == whole[200:]).all()
    assert np.abs(half - whole[200:]).max() < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("scene", KINDS.values(), ids=KINDS)
@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_an_interrupted_run_is_resumed_to_the_same_folder(tmp_path: Path, scene: str, suffix: str) -> None:
    N = 70 if "dop853" in scene else 300
    experiment = load_experiment(ROOT / "configs" / f"{scene}.yaml", [f"N={N}", f"output.format={suffix}"])
    expected = content(run_experiment(experiment, tmp_path / "whole").stored.folder)
    out, messages = tmp_path / "out", []
    chunks = 2
    result = run_experiment(experiment, out, RunOptions(stop=after(chunks)))
    for _ in range(3):  # three times on, and stopped again
        assert result.outcome is Outcome.INTERRUPTED
        assert (result.stored.folder / CHECKPOINT).exists()
        rows = len(next(iter(read_series(result.stored.series).values())))
        assert rows == result.report["step"] + 1
        result = run_experiment(experiment, out, RunOptions(resume=True, stop=after(1), on_message=messages.append))
        assert result.status == "resumed"
        if result.outcome is Outcome.COMPLETED:
            break
    result = run_experiment(experiment, out, RunOptions(resume=True, on_message=messages.append))
    assert content(result.stored.folder) == expected
    assert f"continues from step {chunks * 16 if N > 70 else 32} of {N}" in messages[0]
    assert [path.name for path in out.iterdir()] == [experiment.name]
    assert result.report["seconds"]["run"] > 0.0
    assert result.stored.manifest["resumed"][0]["step"] > 0
    assert run_experiment(experiment, out, RunOptions(resume=True)).status == "up to date"


def test_a_killed_run_is_resumed_and_nothing_of_it_is_left(tmp_path: Path) -> None:
    experiment = small("output.every=2")
    expected = content(run_experiment(experiment, tmp_path / "whole").stored.folder)
    out = tmp_path / "out"
    left = killed(out, experiment, 9)
    assert stored_runs(out) == []
    checkpoint = read_checkpoint(left)
    assert checkpoint is not None
    assert checkpoint.done >= 9 * 23
    (left / ".checkpoint.npz").write_bytes(b"half a checkpoint")
    with (left / "series.parquet").open("ab") as file:
        file.write(b"half a row group")
    result = run_experiment(experiment, out, RunOptions(resume=True))
    assert content(result.stored.folder) == expected
    assert [path.name for path in out.iterdir()] == [NAME]


def test_killed_between_manifest_and_place_it_is_only_put_in_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Killed(BaseException):
        pass

    def rename(*args: object) -> None:
        raise Killed

    with monkeypatch.context() as patched:
        patched.setattr(os, "rename", rename)
        with pytest.raises(Killed):
            run_experiment(small(), tmp_path)
        assert stored_runs(tmp_path) == []
    (left,) = tmp_path.iterdir()
    assert sorted(path.name for path in left.iterdir()) == sorted([*FILES, "series.parquet"])
    left.rename(tmp_path / f".{NAME}.part-999999999-00000000")  # a process that has ended
    monkeypatch.setattr(Run, "__iter__", None)  # nothing is integrated
    assert run_experiment(small(), tmp_path, RunOptions(resume=True)).outcome is Outcome.COMPLETED
    assert [path.name for path in tmp_path.iterdir()] == [NAME]


def test_without_resume_it_runs_again_and_says_what_could_be(tmp_path: Path) -> None:
    messages: list[str] = []
    killed(tmp_path, small(), 5)
    result = run_experiment(small(), tmp_path, RunOptions(on_message=messages.append))
    assert (result.status, result.outcome) == ("ran", Outcome.COMPLETED)
    assert "--resume would continue" in messages[0]
    assert [path.name for path in tmp_path.iterdir()] == [NAME], "superseded, and swept away"


def test_resume_without_a_checkpoint_starts_from_step_0(tmp_path: Path) -> None:
    messages: list[str] = []
    assert run_experiment(small(), tmp_path, RunOptions(resume=True, on_message=messages.append)).status == "ran"
    assert messages == [f"{NAME}: nothing to resume; starting from step 0"]


@pytest.mark.slow
@pytest.mark.parametrize("how", ["killed", "interrupted"])
def test_another_experiment_or_code_is_refused_and_nothing_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    if how == "killed":
        left = killed(tmp_path, small(), 5)
    else:
        left = run_experiment(small(), tmp_path, RunOptions(stop=after(5))).stored.folder
    before = {path.name: path.read_bytes() for path in left.iterdir() if path.name != "lock"}
    with pytest.raises(UsageError, match=r"different experiment \(h: 0.001 there, 0.002 here\).*\n.*without --resume"):
        run_experiment(small("h=0.002"), tmp_path, RunOptions(resume=True))
    monkeypatch.setattr("topcli.runs.identity.method_fingerprint", lambda method: "0" * 64)
    with pytest.raises(UsageError, match="other code of the scheme hk"):
        run_experiment(small(), tmp_path, RunOptions(resume=True))
    assert {path.name: path.read_bytes() for path in left.iterdir() if path.name != "lock"} == before
    monkeypatch.undo()


def test_an_interrupted_run_never_takes_the_place_of_more(tmp_path: Path) -> None:
    complete = content(run_experiment(small(), tmp_path).stored.folder)
    result = run_experiment(small(), tmp_path, RunOptions(force=True, stop=after(3)))
    assert result.set_aside is not None
    assert content(result.set_aside) == complete
    further = run_experiment(small(), tmp_path / "b", RunOptions(stop=after(8)))
    less = run_experiment(small(), tmp_path / "b", RunOptions(stop=after(2)))
    assert less.set_aside is not None
    assert stored_run(less.set_aside).manifest["step"] == further.report["step"]
    messages: list[str] = []
    run_experiment(small(), tmp_path / "b", RunOptions(resume=True, on_message=messages.append))
    assert f"step {further.report['step']} of" in messages[0], "the one that got further goes on"


def test_a_forced_run_beside_a_different_one_is_resumed(tmp_path: Path) -> None:
    first = content(run_experiment(small("h=0.002"), tmp_path).stored.folder)
    killed(tmp_path, small(), 5)
    result = run_experiment(small(), tmp_path, RunOptions(resume=True))
    assert (result.status, result.outcome) == ("resumed", Outcome.COMPLETED)
    assert result.set_aside is not None
    assert content(result.set_aside) == first


def test_a_run_removes_the_dead_parts_that_it_supersedes_and_no_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Parts of the same name belong to another experiment, to other code, or to this run; some got further."""
    out = tmp_path / "out"
    out.mkdir()

    def left(place: str, experiment: Experiment, chunks: int) -> str:
        folder = killed(tmp_path / place, experiment, chunks)
        folder.rename(out / folder.name)
        return folder.name

    with monkeypatch.context() as patch:
        patch.setattr("topcli.runs.identity.method_fingerprint", lambda method: "0" * 64)
        other_code = left("code", small(), 4)
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


def test_space_is_reserved_from_the_first_checkpoint_on(tmp_path: Path) -> None:
    """A quarter of a megabyte from the first checkpoint until the run is complete."""
    seen = []

    def progress(done: int, total: int) -> None:
        sizes = [path.stat().st_size for path in tmp_path.glob(".*/reserve")]
        seen.append((bool(list(tmp_path.glob(".*/checkpoint.npz"))), sizes))

    folder = run_experiment(small(), tmp_path, RunOptions(checkpoint_every=0.0, on_progress=progress)).stored.folder
    assert any(checkpoint for checkpoint, _ in seen)
    assert all(sizes == [262144] for checkpoint, sizes in seen if checkpoint)
    assert not (folder / "reserve").exists()


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
