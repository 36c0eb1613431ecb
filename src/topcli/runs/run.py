"""Run an experiment into a run folder: the series, the report on its invariants, the manifest."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topcli.config.models import Experiment
from topcli.contracts import Method, Outcome
from topcli.engine.loop import Run
from topcli.errors import RunError, TopcliError, UsageError
from topcli.runs.identity import Identity, Origin, store_run
from topcli.runs.plan import Progress, RunOptions, plan_run
from topcli.runs.prepare import run_of
from topcli.runs.recorder import Recorder
from topcli.runs.report import (
    accuracy_data,
    heading,
    left_motion,
    precision_data,
    report_data,
    report_markdown,
    seconds_of,
)
from topcli.runs.resume import (
    Checkpoints,
    checked_start,
    checkpoint_data,
    find_source,
    position_of,
    report_unfinished,
)
from topcli.store.checkpoint import Checkpoint, read_checkpoint, write_checkpoint
from topcli.store.files import io_failure
from topcli.store.manifest import StoredRun, stored_run
from topcli.store.provenance import Commit
from topcli.store.run_folder import RunWriter

if TYPE_CHECKING:
    from topcli.engine.precise.loop import PreciseRun


@dataclass(frozen=True)
class RunResult:
    """A run folder, its report, and the ``status`` of the call.

    The status is ``"ran"``, ``"resumed"``, ``"up to date"`` or, with the format, ``"rewritten as csv"``.
    ``set_aside`` is the new folder of an earlier run that was moved away, because it is a different one or holds files
    that this one does not.
    """

    stored: StoredRun
    report: dict[str, Any]
    status: str
    set_aside: Path | None = None

    @property
    def set_aside_message(self) -> str:
        """Message about the folder that was moved away; empty if none was."""
        if self.set_aside is None:
            return ""
        earlier = stored_run(self.set_aside)
        new = self.stored.manifest
        if earlier is not None and earlier.same(new):
            return f"kept the earlier folder of this run, with files that are not topcli's, as {self.set_aside}"
        return f"renamed the earlier, different run to {self.set_aside}"

    @property
    def outcome(self) -> Outcome:
        """Outcome of the run."""
        return Outcome(self.report["outcome"])


@dataclass(frozen=True)
class _Job:
    """A run with all that it needs: the scheme made ready, the folder to fill, its checkpoints and its origin."""

    experiment: Experiment
    method: Method
    writer: RunWriter
    checkpoints: Checkpoints
    origin: Origin
    precise: PreciseRun | None = None

    @property
    def series(self) -> Path:
        """File of the series."""
        return self.writer.folder / f"series.{self.experiment.output.format}"


def _record(job: _Job, run: Run, recorder: Recorder, progress: Progress) -> None:
    """Carry out ``run`` and record its rows. Raises OSError."""
    with recorder:
        for chunk in run:
            recorder.add(chunk)
            job.checkpoints.consider(run, recorder)
            progress(chunk.done, run.N)
        assert run.ending is not None
        if run.ending.outcome is Outcome.INTERRUPTED:
            job.checkpoints.save(run, recorder)
        run.ending = recorder.finish(run.ending)


def _summary(job: _Job, run: Run, precision: dict[str, Any]) -> dict[str, Any]:
    experiment, ending = job.experiment, run.ending
    assert ending is not None
    return {
        **heading(experiment, experiment.name, job.origin.identity.digest),
        "outcome": ending.outcome.value,
        "message": ending.message,
        "step": ending.step,
        "t": ending.t,
        "left_motion": left_motion(ending),
        "counters": dict(ending.counters),
        "seconds": seconds_of(run),
        **accuracy_data(job.method, experiment, ending.step),
        **precision,
    }


def _started(
    job: _Job, start: Checkpoint | None, stop: Callable[[], bool]
) -> tuple[Run, Recorder, Callable[[], dict[str, Any]]]:
    """Time loop and recorder, in the precision of the experiment, and what the report says on that precision."""
    experiment, precise = job.experiment, job.precise
    metadata = job.origin.metadata()
    if precise is None:
        recorder = Recorder(experiment, job.series, metadata, start)
        position = position_of(start, recorder) if start else None
        return run_of(experiment, job.method, stop, position), recorder, dict
    from topcli.runs.precise import PreciseRecorder

    exact = PreciseRecorder(experiment, precise, job.series, metadata, start)
    position = position_of(start, exact) if start else None
    every = experiment.output.every
    run = Run(precise.top, precise.loop, precise.y0, precise.h, experiment.N, every, stop, position)
    return run, exact, lambda: precision_data(experiment.precision, precise.arithmetic.library, exact.precise.growth)


def _carry_out(
    job: _Job, start: Checkpoint | None, progress: Progress, stop: Callable[[], bool]
) -> tuple[StoredRun, dict[str, Any]]:
    """Run from ``start``, or from step 0, to the end or until ``stop``, and put the folder in its place.

    Raises OSError.
    """
    writer = job.writer
    try:
        run, recorder, precision = _started(job, start, stop)
    except (KeyError, ValueError) as error:
        if start is None:
            raise
        raise UsageError(
            f"{writer.folder}: its checkpoint was written by another version of topcli ({error})"
        ) from None
    run.run_seconds = float(start.about["run_seconds"]) if start else 0.0
    _record(job, run, recorder, progress)
    writer.sha256[job.series.name] = recorder.series.sha256
    report = report_data(_summary(job, run, precision()), recorder.tally.report())
    manifest = {"step": report["step"], "left_motion": report["left_motion"], "series": job.series.name}
    if resumed := job.checkpoints.about["resumed"]:
        manifest["resumed"] = resumed
    return store_run(writer, job.origin, report, report_markdown(report), manifest), report


def prepared_precision(experiment: Experiment) -> PreciseRun | None:
    """Prepare a run in another precision than double; None for double. Raises UsageError if the scheme has none."""
    if experiment.exact is None:
        return None
    from topcli.runs.precise import precise_run

    return precise_run(experiment)


def run_experiment(experiment: Experiment, out: Path, options: RunOptions = RunOptions()) -> RunResult:
    """Run ``experiment`` into the folder ``out/<name>``, unless it has been run before.

    A finished run of the same experiment and code is not repeated unless ``force``, or if it failed ``retry_failed``;
    one in another format is rewritten from its stored tables.
    A different experiment of that name is refused; with ``force`` it is renamed.

    Raises UsageError before anything is written, and RunError if writing fails; what remains can be read or resumed.
    """
    method, precise, tell = experiment.method(), prepared_precision(experiment), options.on_message
    identity = Identity.of(experiment, [method])
    source = find_source(identity, out) if options.resume else None
    plan = plan_run(identity, out, options, source)
    if plan.up_to_date and plan.existing is not None:
        return existing_result(plan.existing, identity, out, plan.rewrite)
    if not options.resume:
        report_unfinished(identity, out, tell)
    if plan.damaged:
        tell(f"{identity.name}: {plan.action}")
    where, displace = source and source.where, options.force or options.retry_failed
    with Commit() as commit, RunWriter(out, identity.name, identity.digests, where, displace) as writer:
        if writer.complete is not None:
            return _put_in_place(writer, writer.complete, tell)
        start = checked_start(identity, writer, source, tell) if options.resume else None
        about = checkpoint_data(identity, start)
        checkpoints = Checkpoints(writer, about, options.checkpoint_every, last=start)
        origin = Origin(
            identity, experiment.scheme, type(experiment.top), about["started"], about["environment"], commit
        )
        job = _Job(experiment, method, writer, checkpoints, origin, precise)
        try:
            stored, report = _carry_out(job, start, options.on_progress, options.stop)
        except OSError as error:
            raise _saved(job, error) from error
    return RunResult(stored, report, "ran" if start is None else "resumed", writer.set_aside)


def existing_result(existing: StoredRun, identity: Identity, out: Path, rewrite: bool) -> RunResult:
    """Result of a run that was finished before, with ``rewrite`` in the format of ``identity``. Raises RunError."""
    if not rewrite:
        return RunResult(existing, existing.report(), "up to date")
    from topcli.runs.rewrite import rewrite_run

    stored, set_aside = rewrite_run(identity, existing, out)
    return RunResult(stored, stored.report(), f"rewritten as {identity.config['output']['format']}", set_aside)


def _put_in_place(writer: RunWriter, complete: StoredRun, tell: Callable[[str], None]) -> RunResult:
    """Finish a run that was killed after its manifest was written. Raises RunError."""
    try:
        stored = writer.put_in_place(complete.manifest)
    except OSError as error:
        raise writer.failure(error) from error
    tell(f"{writer.name}: the run was complete when it was killed; it has been renamed into place")
    return RunResult(stored, stored.report(), "resumed", writer.set_aside)


def _saved(job: _Job, error: OSError) -> RunError:
    """Error to report after a failed write; first saves the run as interrupted, or its last checkpoint, if possible."""
    writer, checkpoints, last = job.writer, job.checkpoints, None
    for last in [] if writer.finished or not writer.folder.exists() else checkpoints.to_save():
        with contextlib.suppress(OSError, TopcliError):
            stored, _ = _carry_out(job, last, lambda done, total: None, lambda: True)
            kept = "the finished run is in its place"
            if stored.interrupted:
                kept = f"the run up to step {last.done} is kept, marked interrupted; --resume continues it"
            return io_failure(error, writer.target, kept)
    if last is not None and read_checkpoint(writer.folder) is None:
        with contextlib.suppress(OSError):
            write_checkpoint(writer.folder, last)
    return writer.failure(error)
