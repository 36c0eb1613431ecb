"""Run folders: whole or not at all, and no result ever lost."""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from conftest import examples
from resuming import FILES, NAME, after, small
from topcli.config.load import load_experiment
from topcli.contracts import Outcome
from topcli.errors import RunError, UsageError
from topcli.runs.decision import RunOptions
from topcli.runs.run import decision_on, run_experiment
from topcli.store import folder as store_folder
from topcli.store.checkpoint import CHECKPOINT
from topcli.store.folder import Folder, RunWriter
from topcli.store.manifest import stored_run, stored_runs
from topcli.store.series import read_metadata, read_series

CSV = "output.format=csv"


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
    if suffix == "parquet":
        about = read_metadata(result.stored.series)
        assert json.loads(about["topcli.config"]) == experiment.resolved()
        assert about["topcli.digest"] == experiment.digest


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


def test_a_living_writer_is_not_swept_away(tmp_path: Path) -> None:
    with RunWriter(tmp_path, "kowalevski_hk") as writer:
        run_experiment(small(), tmp_path)
        assert writer.folder.is_dir()


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
    (tmp_path / names[0] / "series.parquet").write_bytes(b"junk")
    run_experiment(small("h=0.002"), tmp_path, RunOptions(force=True))
    assert not stored_run(tmp_path / f"{names[0]}.2").damage(), "a damaged copy is none"


def test_result_written_meanwhile_is_set_aside(tmp_path: Path) -> None:
    with RunWriter(tmp_path, "kowalevski_hk") as writer:
        other = run_experiment(small(), tmp_path)
        writer.commit({"digest": "f" * 64, "code": "c", "series": "series.csv"}, {"series.csv": "x"})
    assert writer.set_aside is not None
    assert stored_run(writer.set_aside).manifest["digest"] == other.stored.manifest["digest"]


def bits(values: np.ndarray) -> Any:
    return values.tolist() if values.dtype.kind == "O" else values.view(np.int64).tolist()


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@pytest.mark.slow
@pytest.mark.parametrize("at", ["series", "manifest", "rename"])
def test_a_failure_keeps_the_earlier_format(tmp_path: Path, at: str, monkeypatch: pytest.MonkeyPatch) -> None:
    first = run_experiment(small(), tmp_path).stored.folder
    before = contents(first)
    full = OSError(28, "No space left on device")

    def fail(*arguments: Any, **options: Any) -> None:
        raise full

    with monkeypatch.context() as patch:
        if at == "series":
            patch.setattr("topcli.store.series.GrowingFile.append", fail)
        elif at == "manifest":
            patch.setattr(store_folder, "write_text", fail)
        else:
            patch.setattr(os, "rename", fail)
        with pytest.raises(RunError, match="no space left on the device"):
            run_experiment(small(CSV), tmp_path)
    assert contents(first) == before
    assert run_experiment(small(CSV), tmp_path).status == "ran"
    assert [path.name for path in tmp_path.glob("[!.]*")] == ["kowalevski_hk"]


@pytest.mark.slow
def test_the_step_at_which_a_run_left_its_motion_stays_in_its_tables(tmp_path: Path) -> None:
    """HK with so long a step that gamma² grows to 2e59."""
    big = ["h=2", "N=1000"]
    first = run_experiment(load_experiment("kowalevski_hk", big), tmp_path)
    about = pq.read_metadata(first.stored.series).metadata
    left = first.stored.manifest["left_motion"]
    assert json.loads(about[b"topcli.left_motion"]) == left
    assert 0 < left["step"] < 1000


SIZES = st.sampled_from([0.001, 0.002])
FORMATS = st.sampled_from(["parquet", "csv"])
YES_OR_NO = st.booleans()


class Killed(BaseException):
    pass


def numbers(folder: Path) -> dict[str, Any]:
    """Report and series of a run, apart from its times and its format."""
    report = {key: value for key, value in json.loads((folder / "report.json").read_text()).items() if key != "seconds"}
    (series,) = folder.glob("series.*")
    return {"report": report, "series": {name: bits(values) for name, values in read_series(series).items()}}


def tree(folder: Path) -> dict[Path, bytes | None]:
    return {path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


class ResultsMachine(RuleBasedStateMachine):
    """One folder where runs of one name end, stop, are killed and damaged: nothing of value is lost.

    ``done`` holds the step sizes with a complete result, ``reached`` the step up to which the others got, ``notes`` the
    files of the user.
    """

    whole: ClassVar[dict[float, dict[str, Any]]] = {}

    def __init__(self) -> None:
        super().__init__()
        self.temporary = tempfile.TemporaryDirectory()
        self.out = Path(self.temporary.name) / "out"
        self.out.mkdir()
        self.done: set[float] = set()
        self.reached: dict[float, int] = {}
        self.notes: set[str] = set()

    def teardown(self) -> None:
        self.temporary.cleanup()

    def expected(self, h: float) -> dict[str, Any]:
        if h not in self.whole:
            elsewhere = Path(self.temporary.name) / f"{h}"
            self.whole[h] = numbers(run_experiment(small(f"h={h}"), elsewhere).stored.folder)
        return self.whole[h]

    @rule(h=SIZES, suffix=FORMATS, force=YES_OR_NO, resume=YES_OR_NO, chunks=st.integers(1, 20), kill=YES_OR_NO)
    def run(self, h: float, suffix: str, force: bool, resume: bool, chunks: int, kill: bool) -> None:
        """Run until ``chunks`` chunks are done, of which a whole run has 19, after a look that must foretell it."""
        experiment, before, steps = small(f"h={h}", f"output.format={suffix}"), tree(self.out), [0]

        def progress(done: int, total: int) -> None:
            steps[0] = done
            if kill and done >= 16 * chunks:
                raise Killed

        options = RunOptions(force, resume, checkpoint_every=0.0, on_progress=progress)
        options = options if kill else replace(options, stop=after(chunks))
        try:
            decision = decision_on(experiment, self.out, options)[1]
        except UsageError as refusal:
            with pytest.raises(UsageError, match=re.escape(str(refusal))):
                run_experiment(experiment, self.out, options)
            assert tree(self.out) == before
            return
        assert tree(self.out) == before
        try:
            result = run_experiment(experiment, self.out, options)
        except Killed:
            self.reached |= {} if h in self.done else {h: max(steps[0], self.reached.get(h, 0))}
            return
        begun = "resumed" if decision.source else "ran"
        status = {"run": begun, "leave": "up to date"}[decision.verb]
        assert result.status == status
        kept = decision.verb != "leave" and any(path.match(f"{NAME}/notes*") for path in before)
        assert result.set_aside is not None or not kept
        assert (tree(self.out) == before) == (decision.verb == "leave")
        if result.outcome is Outcome.COMPLETED:
            assert numbers(result.stored.folder) == self.expected(h)
            self.done.add(h)
            self.reached.pop(h, None)
        elif h not in self.done:
            self.reached[h] = max(result.report["step"], self.reached.get(h, 0))

    @precondition(lambda self: stored_run(self.out / NAME) is not None)
    @rule(name=st.sampled_from(["series", "report.json"]))
    def damage(self, name: str) -> None:
        """A complete result that is damaged is worth nothing; one that was set aside may be all there is."""
        (path,) = (self.out / NAME).glob(f"{name}*")
        run = stored_run(self.out / NAME)
        assert run is not None
        if not run.interrupted:
            path.write_bytes(path.read_bytes()[:-1] + b"?")
            self.done.discard(run.manifest["config"]["h"])

    @precondition(lambda self: (self.out / NAME).is_dir())
    @rule()
    def take_notes(self) -> None:
        self.notes.add(name := f"notes{len(self.notes)}")
        (self.out / NAME / name).write_text(name)

    @invariant()
    def nothing_of_value_is_lost(self) -> None:
        found = [run for run in stored_runs(self.out) if not run.interrupted and not run.damage()]
        for h in self.done:
            assert any(numbers(run.folder) == self.expected(h) for run in found if run.manifest["config"]["h"] == h)
        assert {path.name for path in self.out.rglob("notes*")} == self.notes
        sources = Folder.look(self.out, NAME).sources
        for h, step in self.reached.items():
            # more if a stopped run, which a complete one once outdid, was set aside with the user's notes
            assert max(source.done for source in sources if source.about["config"]["h"] == h) >= step
        assert all((part / CHECKPOINT).exists() for part in self.out.glob(".*"))


ResultsMachine.TestCase.settings = settings(examples(10), stateful_step_count=15)
TestResults = pytest.mark.slow(pytest.mark.usefixtures("small_chunks")(ResultsMachine.TestCase))
