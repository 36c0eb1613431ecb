"""Decision on a run, from its identity, one look at its folder, and the options: a table of cases without a disk."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest

import resuming
from topcli.errors import RunError, UsageError
from topcli.runs.decision import Decision, RunOptions, decide
from topcli.runs.identity import Identity
from topcli.runs.run import run_experiment
from topcli.store.folder import Folder, Resumable
from topcli.store.manifest import REPORT, StoredRun
from topcli.store.parts import Part

OUT, NAME = Path("out"), "wobble"


CONFIG: dict[str, Any] = {
    "name": NAME,
    "scheme": {"name": "hk"},
    "h": 0.1,
    "N": 100,
    "output": {"every": 1, "format": "parquet"},
}


MINE = Identity(CONFIG, "a" * 64, "code")


FORCE, RESUME, RETRY = RunOptions(force=True), RunOptions(resume=True), RunOptions(retry_failed=True)


PLAIN = RunOptions()


FLIPPED = {"report.md": "its SHA-256 differs"}


def config(**changes: Any) -> dict[str, Any]:
    return {**CONFIG, **changes}


def manifest(outcome: str = "completed", suffix: str = "parquet", **changes: Any) -> dict[str, Any]:
    return {
        "name": NAME,
        "digest": MINE.digest,
        "code": MINE.code,
        "outcome": outcome,
        "config": CONFIG,
        "series": f"series.{suffix}",
        "files": {REPORT: {}},
        **changes,
    }


def run(outcome: str = "completed", suffix: str = "parquet", **changes: Any) -> StoredRun:
    return StoredRun(OUT / NAME, manifest(outcome, suffix, **changes))


def part(alive: bool = False, digest: str = MINE.digest) -> Part:
    return Part(OUT / f".{NAME}.part-7-00000000", {"pid": 7, "digest": digest}, alive)


def left(done: int, *, where: Any = None, complete: bool = False, **changes: Any) -> Resumable:
    """What a killed process has left at step ``done``, or an interrupted run."""
    checkpoint: Any = None if complete else object()
    return Resumable(where or part(), done, checkpoint, manifest(**changes))


OTHER_RUN = run(digest="b" * 64, config=config(h=0.2, name="earlier"))


OTHER_CODE = run(digest="b" * 64, top_origin="mine.py")


@dataclass(frozen=True)
class Case:
    """A look at the folder and options; the decision, or a part of its error."""

    look: dict[str, Any]
    options: RunOptions
    expected: str = "run"
    action: str = ""
    notes: tuple[str, ...] = ()
    step: int | None = None
    identity: Identity = field(default=MINE)


CSV = replace(MINE, config=config(output={"every": 1, "format": "csv"}))


HINT = "starting from step 0; --resume would continue an unfinished run at step 40 of 100"


NOTHING = "nothing to resume; starting from step 0"


BUSY = "process 7 is running this experiment too"


DAMAGED = "will run again; report.md is damaged: its SHA-256 differs"


LINK = "out/wobble: is a symbolic link, which no run can replace; nothing was written"


CASES = {
    "an empty place": Case({}, PLAIN, action="will run"),
    "nothing to resume": Case({}, RESUME, action="will run", notes=(NOTHING,)),
    "a place that cannot be used": Case({"fault": ("out: is not a folder",)}, FORCE, "out: is not a folder"),
    "a link to nothing": Case({"linked": True}, PLAIN, LINK),
    "a link to a different run": Case({"linked": True, "run": OTHER_RUN}, FORCE, LINK),
    "a link to a run in another format": Case({"linked": True, "run": run(suffix="csv")}, PLAIN, LINK),
    "a link to this run": Case({"linked": True, "run": run()}, PLAIN, "leave", "up to date"),
    "a link to this run, by force": Case({"linked": True, "run": run()}, FORCE, LINK),
    "up to date": Case({"run": run()}, PLAIN, "leave", "up to date"),
    "up to date, to be resumed": Case({"run": run()}, RESUME, "leave", "up to date"),
    "up to date, beside a killed run": Case({"run": run(), "sources": (left(40),)}, RESUME, "leave", "up to date"),
    "up to date, beside a killed run of other code": Case(
        {"run": run(), "sources": (left(40, code="other"),)}, RESUME, "leave", "up to date"
    ),
    "up to date, by force": Case({"run": run()}, FORCE, action="will run again"),
    "not failed, to be retried": Case({"run": run()}, RETRY, "leave", "up to date"),
    "failed": Case(
        {"run": run("blew_up")},
        PLAIN,
        "leave",
        "up to date; the existing run ended as blew_up; --retry-failed runs it again",
    ),
    "failed, to be retried": Case({"run": run("blew_up")}, RETRY, action="will run again"),
    "in another format": Case({"run": run(suffix="csv")}, PLAIN, "rewrite", "will be rewritten as parquet"),
    "failed, in another format": Case(
        {"run": run("blew_up")}, PLAIN, "rewrite", "will be rewritten as csv", identity=CSV
    ),
    "damaged": Case({"run": run(), "damage": FLIPPED}, PLAIN, action=DAMAGED, notes=(DAMAGED,)),
    "damaged, in another format": Case(
        {"run": run(suffix="csv"), "damage": FLIPPED}, PLAIN, action=DAMAGED, notes=(DAMAGED,)
    ),
    "damaged, to be resumed": Case({"run": run(), "damage": FLIPPED}, RESUME, action=DAMAGED, notes=(DAMAGED, NOTHING)),
    "without its report": Case({"run": run(files={})}, PLAIN, action="will run again"),
    "of other code": Case({"run": run(code="other")}, PLAIN, action="will run again"),
    "interrupted": Case(
        {"run": run("interrupted"), "sources": (left(40, where=run("interrupted")),)},
        PLAIN,
        action="will run again",
        notes=(HINT,),
    ),
    "interrupted, to be resumed": Case(
        {"run": run("interrupted"), "sources": (left(40, where=run("interrupted")),)},
        RESUME,
        action="will continue from step 40",
        step=40,
    ),
    "a different run": Case(
        {"run": OTHER_RUN}, PLAIN, "holds a different experiment (h: 0.2 there, 0.1 here); nothing"
    ),
    "the same run by a user's top": Case(
        {"run": OTHER_CODE}, PLAIN, "as computed by other code of mine.py (digest bbbbbbbb, this one aaaaaaaa)"
    ),
    "a very different run": Case(
        {"run": run(digest="b" * 64, config=config(scheme={"name": "rk4"}, h=0.2, N=7, output={"every": 2}))},
        PLAIN,
        "(scheme.name: rk4 there, hk here; h: 0.2 there, 0.1 here; N: 7 there, 100 here; ...); nothing",
    ),
    "this run of another version": Case(
        {"run": run(digest="b" * 64)}, PLAIN, "holds this experiment as identified by another version of topcli"
    ),
    "a different run, by force": Case(
        {"run": OTHER_RUN}, FORCE, action="will run; the existing different run is renamed, not overwritten"
    ),
    "a different run, beside a killed one": Case(
        {"run": OTHER_RUN, "parts": (part(),), "sources": (left(40),)},
        RESUME,
        action="will continue from step 40; the existing different run is renamed, not overwritten",
        step=40,
    ),
    "killed": Case({"parts": (part(),), "sources": (left(30), left(40))}, PLAIN, action="will run", notes=(HINT,)),
    "killed, to be resumed": Case(
        {"parts": (part(),), "sources": (left(40), left(60), left(50))},
        RESUME,
        action="will continue from step 60",
        step=60,
    ),
    "complete before it was killed": Case(
        {"parts": (part(),), "sources": (left(60), left(0, complete=True))},
        RESUME,
        action="will continue from step 0",
        step=0,
    ),
    "set aside": Case(
        {"sources": (left(40, where=StoredRun(OUT / f"{NAME}.aaaaaaaa", {})),)}, PLAIN, action="will run"
    ),
    "killed in another format": Case(
        {"sources": (left(40, config=config(output={"format": "csv"})),)},
        RESUME,
        "the unfinished run, at step 40, is written as csv, not parquet",
    ),
    "killed, of a different experiment": Case(
        {"sources": (left(40, digest="b" * 64, config=config(N=7)),)},
        RESUME,
        "at step 40, is of a different experiment (N: 7 there, 100 here); nothing was written and it is kept",
    ),
    "killed, of other code": Case(
        {"sources": (left(40, code="other"), left(80, digest="b" * 64))},
        RESUME,
        "at step 40, was made by other code of the scheme hk",
    ),
    "killed, of another version": Case(
        {"sources": (left(40, digest="b" * 64),)}, RESUME, "at step 40, was begun by another version of topcli"
    ),
    "a damaged checkpoint": Case(
        {"damaged_checkpoint": OUT / ".wobble.part-7-00000000" / "checkpoint.npz"},
        RESUME,
        "checkpoint.npz: damaged (or written by another version of topcli); nothing was deleted",
    ),
    "a damaged checkpoint, not to be resumed": Case(
        {"damaged_checkpoint": OUT / "checkpoint.npz"}, PLAIN, action="will run"
    ),
    "running": Case({"parts": (part(True),)}, PLAIN, action="will run", notes=(BUSY,)),
    "running, to be resumed": Case(
        {"parts": (part(True),), "sources": (left(40),)},
        RESUME,
        "out/wobble: process 7 is running this experiment now; there is nothing to resume",
    ),
    "another one running": Case({"parts": (part(True, "b" * 64),)}, RESUME, action="will run", notes=(NOTHING,)),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_decision(case: Case) -> None:
    folder = Folder(OUT, NAME, **case.look)
    if case.action:
        decision = decide(case.identity, folder, case.options)
        source = next((left for left in folder.sources if left.done == case.step), None)
        assert decision == Decision(case.expected, case.action, source, case.notes)  # type: ignore[arg-type]
        return
    with pytest.raises((UsageError, RunError)) as caught:
        decide(case.identity, folder, case.options)
    assert case.expected in str(caught.value)
    assert isinstance(caught.value, RunError) == ("damaged (" in case.expected)


def test_a_look_changes_nothing(tmp_path: Path) -> None:
    """Not even in the remains of a killed process, which the next run removes."""
    remains = tmp_path / f".{NAME}.part-999999999-00000000"
    remains.mkdir()
    (remains / "series.parquet").write_bytes(b"half a row group")
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    assert Folder.look(tmp_path, NAME).parts == ()
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before


def test_a_look_finds_the_unfinished_runs_of_its_name_alone(tmp_path: Path, small_chunks: None) -> None:
    """``wobble.2`` is the name of another run as well as of one that was set aside."""
    longer = f"{resuming.NAME}.2"
    stop = RunOptions(stop=resuming.after(5))
    run_experiment(resuming.small(f"name={longer}"), tmp_path, stop)
    assert Folder.look(tmp_path, resuming.NAME).sources == ()
    (source,) = Folder.look(tmp_path, longer).sources
    assert source.where.folder == tmp_path / longer
    assert source.done > 0
