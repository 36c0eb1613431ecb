"""Run an experiment into a run folder: stream the series, tally the invariants, write the reports."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from topcli.analysis.columns import column_names, columns
from topcli.analysis.drift import InvariantTally
from topcli.config.models import Experiment
from topcli.contracts import Block, Invariant, Method, Outcome, Sampler
from topcli.engine.fingerprint import fingerprint
from topcli.engine.loop import Run
from topcli.errors import RunError, TopcliError, UsageError
from topcli.store.checkpoint import Checkpoint, write_checkpoint
from topcli.store.manifest import CHECKED_AT_ONCE, StoredRun
from topcli.store.provenance import Commit, environment, now
from topcli.store.run_folder import RunWriter, io_failure, require_place, require_real
from topcli.store.series import SeriesWriter
from topcli.studies.report import left_motion, report_data, report_markdown
from topcli.studies.resume import (
    CHECKPOINT_SECONDS,
    Batch,
    Checkpoints,
    Source,
    begun,
    checked_start,
    find_source,
    position_of,
    say_what_could_be_resumed,
)

if TYPE_CHECKING:
    from topcli.config.ensemble import EnsembleExperiment

Progress = Callable[[int, int], None]
"""Told (steps done, N) between chunks."""


@dataclass(frozen=True)
class RunResult:
    """A run folder, its report, and what became of the call.

    ``status`` is ``"ran"``, ``"resumed"`` or ``"up to date"``; ``set_aside`` is where a different earlier run was
    moved.
    """

    stored: StoredRun
    report: dict[str, Any]
    status: str
    set_aside: Path | None = None

    @property
    def outcome(self) -> Outcome:
        """How the run ended."""
        return Outcome(self.report["outcome"])


@dataclass(frozen=True)
class Plan:
    """What a call of ``run_experiment`` will do: ``standing`` is the run that is there, ``action`` says it in words."""

    standing: StoredRun | None
    up_to_date: bool
    action: str


def method_fingerprint(method: Method) -> str:
    """A digest of the code of a scheme made ready for a top. Raises SchemeCodeError for code that cannot be hashed."""
    if isinstance(method, Sampler):
        return fingerprint(method.states, compiled=False)
    if isinstance(method, Block):
        code = method.text() + fingerprint(method.enter, compiled=False)
        layout = (method.width, method.counters, method.iterative)
    else:
        code = fingerprint(method.step, method.enter, method.leave, compiled=not method.plain)
        stages = method.stages and (fingerprint(method.stages[0]), method.stages[1])
        layout = (method.width, method.counters, method.iterative, method.checked, method.plain, stages)
    return hashlib.sha256((code + repr(layout)).encode()).hexdigest()


def plan_run(
    experiment: Experiment | EnsembleExperiment,
    out: Path,
    code: str,
    *,
    force: bool = False,
    retry_failed: bool = False,
    source: Source | None = None,
) -> Plan:
    """What running ``experiment`` into ``out``, or continuing from ``source``, will do.

    Raises UsageError for what would be refused.
    """
    target, digest = out / experiment.name, experiment.digest
    standing = require_place(out, experiment.name)
    begin = f"will continue from step {source.done}" if source else "will run"
    if standing is None:
        return Plan(None, False, begin)
    if not standing.same_experiment(digest):
        if not force and source is None:
            raise UsageError(
                f"{target}: holds a different experiment (digest {standing.manifest['digest'][:8]}, this one "
                f"{digest[:8]}); nothing was written",
                "choose --set name=... or --out, or --force to keep the earlier run aside and put this one in "
                "its place",
            )
        require_real(target)
        return Plan(standing, False, f"{begin}, and keep the different run that is there aside")
    failed = standing.outcome is not Outcome.COMPLETED
    if not force and not (failed and retry_failed) and standing.up_to_date(digest, code):
        return Plan(standing, True, f"up to date; {retry_hint(standing)}" if failed else "up to date")
    require_real(target)
    damaged = "".join(f"; {name} is damaged: {why}" for name, why in standing.damage(CHECKED_AT_ONCE).items())
    return Plan(standing, False, (begin if source else "will run again") + damaged)


def retry_hint(standing: StoredRun) -> str:
    """How a finished run failed, and how to run it again."""
    return f"the run that is there ended as {standing.outcome.value}; --retry-failed runs it again"


def _write_series(
    path: Path,
    experiment: Experiment,
    run: Run,
    tally: InvariantTally,
    modified: tuple[Invariant, ...],
    about: dict[str, str],
    progress: Progress,
    checkpoints: Checkpoints,
    start: Checkpoint | None,
) -> str:
    """Run and write the rows to ``path``; the SHA-256 of the file."""
    top, h = experiment.top, experiment.h
    names = list(experiment.output.columns or column_names(top))
    batch = Batch(start)
    with SeriesWriter(path, names, about, start.series if start else None) as writer:

        def take_in(n: NDArray[Any], states: NDArray[Any]) -> None:
            tally.add(n, states)
            writer.write(columns(top, n, h, states, names, modified))

        for chunk in run:
            if len(chunk.n):
                batch.add(chunk.n, chunk.states)
            if chunk.whole and batch.enough:
                take_in(*batch.take())
            checkpoints.consider(run, tally, writer, batch)
            progress(chunk.done, experiment.N)
        assert run.ending is not None
        if run.ending.outcome is Outcome.INTERRUPTED:
            checkpoints.save(run, tally, writer, batch)
        if len(batch.rows()[0]):
            take_in(*batch.take())
        run.ending = ending = run.ending.having_left(tally.left, experiment.h)
        writer.finish(
            {
                "topcli.outcome": ending.outcome.value,
                "topcli.message": ending.message,
                **({} if ending.left is None else {"topcli.left_motion": json.dumps(left_motion(ending))}),
            }
        )
    return writer.sha256


def _summary(experiment: Experiment, run: Run, digest: str) -> dict[str, Any]:
    ending = run.ending
    assert ending is not None
    return {
        "name": experiment.name,
        "digest": digest,
        "top": experiment.top.kind,
        "top_title": experiment.top.title,
        "scheme": experiment.scheme.name,
        "scheme_title": experiment.scheme.title,
        "h": experiment.h,
        "N": experiment.N,
        "outcome": ending.outcome.value,
        "message": ending.message,
        "step": ending.step,
        "t": ending.t,
        "left_motion": left_motion(ending),
        "counters": dict(ending.counters),
        "seconds": {"compile": run.compile_seconds, "compile_cached": run.cached, "run": run.run_seconds},
    }


def _carry_out(
    experiment: Experiment,
    method: Method,
    writer: RunWriter,
    commit: Commit,
    checkpoints: Checkpoints,
    start: Checkpoint | None,
    progress: Progress,
    stop: Callable[[], bool],
) -> tuple[StoredRun, dict[str, Any]]:
    """Run, from ``start`` if there is one, to the end or until ``stop``, and put the folder in its place.

    Raises OSError.
    """
    top, h, modified = experiment.top, experiment.h, experiment.modified
    resolved, provenance = experiment.resolved(), environment()
    about = {
        "topcli.config": json.dumps(resolved),
        "topcli.digest": checkpoints.about["digest"],
        "topcli.environment": json.dumps(provenance),
    }
    tally = InvariantTally((*top.invariants(), *modified), h, top)
    try:
        if start is not None:
            tally.restore(start.tally)
        position = position_of(start) if start else None
        run = Run(top, method, experiment.y0, h, experiment.N, experiment.output.every, stop, position)
    except (KeyError, ValueError) as error:
        if start is None:
            raise
        raise UsageError(f"{writer.folder}: its checkpoint is none of this version of topcli ({error})") from None
    run.run_seconds = float(start.about["run_seconds"]) if start else 0.0
    series = writer.folder / f"series.{experiment.output.format}"
    digest = _write_series(series, experiment, run, tally, modified, about, progress, checkpoints, start)
    writer.sha256[series.name] = digest
    report = report_data(_summary(experiment, run, checkpoints.about["digest"]), tally.rows())
    writer.write("report.json", json.dumps(report, indent=1, ensure_ascii=False) + "\n")
    writer.write("report.md", report_markdown(report))
    writer.write("config.yaml", experiment.to_yaml())
    stored = writer.commit(
        {
            "name": experiment.name,
            "digest": checkpoints.about["digest"],
            "code": checkpoints.about["code"],
            "outcome": report["outcome"],
            "message": report["message"],
            "step": report["step"],
            "left_motion": report["left_motion"],
            "series": series.name,
            "config": resolved,
            "scheme_origin": experiment.scheme.origin,
            "started": checkpoints.about["started"],
            "ended": now(),
            **({"resumed": resumed} if (resumed := checkpoints.about["resumed"]) else {}),
            "seconds": report["seconds"],
            "environment": provenance,
            **commit.read(),
        }
    )
    return stored, report


def run_experiment(
    experiment: Experiment,
    out: Path,
    *,
    force: bool = False,
    resume: bool = False,
    retry_failed: bool = False,
    checkpoint_every: float = CHECKPOINT_SECONDS,
    progress: Progress = lambda done, total: None,
    stop: Callable[[], bool] = lambda: False,
    tell: Callable[[str], None] = lambda line: None,
) -> RunResult:
    """Run ``experiment`` into ``out/<name>/``, or find it there already.

    A run of the same experiment by the same code that ended by itself is not repeated unless ``force``, or
    ``retry_failed`` and it failed. A different experiment is refused, unless ``force``: then it is set aside under
    another name.
    ``stop`` is asked between chunks; what was written until then is kept, marked ``interrupted``.
    With ``resume`` an interrupted or killed run goes on from its last checkpoint and ends, bit for bit, as if it had
    never been stopped; checkpoints are written every ``checkpoint_every`` seconds. ``tell`` receives lines of talk.

    Raises UsageError before anything is written, RunError when writing fails; then nothing is left behind but what
    can be read or resumed.
    """
    method, digest = experiment.method(), experiment.digest
    code = method_fingerprint(method)
    source = find_source(experiment, out, code) if resume else None
    plan = plan_run(experiment, out, code, force=force, retry_failed=retry_failed, source=source)
    if plan.up_to_date and plan.standing is not None:
        return RunResult(plan.standing, plan.standing.report(), "up to date")
    if not resume:
        say_what_could_be_resumed(experiment, out, code, tell)
    if "damaged" in plan.action:
        tell(f"{experiment.name}: {plan.action}")
    identity, displace = {"digest": digest, "code": code}, force or retry_failed
    with Commit() as commit, RunWriter(out, experiment.name, identity, source and source.where, displace) as writer:
        if writer.complete is not None:
            try:
                stored = writer.put_in_place(writer.complete.manifest)
            except OSError as error:
                raise writer.failure(error) from error
            tell(f"{experiment.name}: the run had ended before it was killed; it is in its place now")
            return RunResult(stored, stored.report(), "resumed", writer.set_aside)
        start = checked_start(experiment, writer, source, identity, tell) if resume else None
        checkpoints = Checkpoints(writer, begun(experiment, identity, start), checkpoint_every, last=start)
        carry_out = partial(_carry_out, experiment, method, writer, commit, checkpoints)
        try:
            stored, report = carry_out(start, progress, stop)
        except OSError as error:
            raise _saved(carry_out, checkpoints, error) from error
    return RunResult(stored, report, "ran" if start is None else "resumed", writer.set_aside)


def _saved(
    carry_out: Callable[..., tuple[StoredRun, dict[str, Any]]], checkpoints: Checkpoints, error: OSError
) -> RunError:
    """The error to report of a write that failed, after saving what can be saved: as an interrupted run if possible."""
    writer, last = checkpoints.writer, None
    for last in [] if writer.finished else checkpoints.to_save():
        with contextlib.suppress(OSError, TopcliError):
            carry_out(last, lambda done, total: None, lambda: True)
            kept = f"the run up to step {last.done} is kept, marked interrupted; --resume continues it"
            return io_failure(error, writer.target, kept)
    if last is not None and checkpoints.kept is None:
        with contextlib.suppress(OSError):
            write_checkpoint(writer.folder, last)
    return writer.failure(error)
