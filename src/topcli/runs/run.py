"""Run of an experiment or an ensemble into a folder: decide, compute, record, commit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topcli.config.models import Experiment
from topcli.contracts import Outcome
from topcli.errors import UsageError
from topcli.runs.decision import Decision, RunOptions, decide, difference
from topcli.runs.identity import Identity, prepared
from topcli.runs.recording import Origin, Recording, SingleRecording
from topcli.store.checkpoint import Checkpoint
from topcli.store.folder import Folder, Resumable, RunWriter
from topcli.store.manifest import StoredRun, stored_run
from topcli.store.provenance import Commit, environment, now

if TYPE_CHECKING:
    from topcli.config.ensemble import EnsembleExperiment


@dataclass(frozen=True)
class RunResult:
    """A run folder, its report, and the ``status`` of the call.

    The status is ``"ran"``, ``"resumed"`` or ``"up to date"``.
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
        if earlier is not None and earlier.same(self.stored.manifest):
            return f"renamed the earlier folder of this run to {self.set_aside}; it has files that topcli did not write"
        return f"renamed the earlier, different run to {self.set_aside}"

    @property
    def outcome(self) -> Outcome:
        """Outcome of the run."""
        return Outcome(self.report["outcome"])


def decision_on(
    experiment: Experiment | EnsembleExperiment, out: Path, options: RunOptions
) -> tuple[Identity, Decision]:
    """Identity of an experiment, and the decision on it. Raises UsageError for a run that would be refused."""
    identity = prepared(experiment, options.resume).identity
    return identity, decide(identity, Folder.look(out, identity.name), options)


def run_experiment(
    experiment: Experiment | EnsembleExperiment, out: Path, options: RunOptions = RunOptions()
) -> RunResult:
    """Run an experiment or ensemble into the folder ``out/<name>``, unless it has been run before.

    A finished run of the same experiment and code is not repeated unless ``force``, if it failed ``retry_failed``, or
    if the format of its tables is another.
    A different experiment of that name is refused; with ``force`` it is renamed.

    Raises UsageError before anything is written, and RunError if writing fails; what remains can be read or resumed.
    """
    ready, tell = prepared(experiment, options.resume), options.on_message
    identity, name = ready.identity, ready.identity.name
    folder = Folder.look(out, name)
    decision = decide(identity, folder, options)
    for note in decision.notes:
        tell(f"{name}: {note}")
    if decision.verb != "run":
        assert folder.run is not None
        return RunResult(folder.run, folder.run.report(), "up to date")
    source, displace = decision.source, options.force or options.retry_failed
    with Commit() as commit, RunWriter(out, name, identity.digests, source and source.where, displace) as writer:
        if writer.complete is not None:
            return _put_in_place(writer, writer.complete, tell)
        start = _checked_start(identity, writer, source, tell) if source else None
        begun = start.about if start else {"started": now(), "environment": environment(), "resumed": []}
        origin = Origin(identity, begun["started"], begun["environment"], commit)
        if isinstance(experiment, Experiment):
            resumed = [*begun["resumed"], *([{"step": start.done, "at": now()}] if start else [])]
            recording: Recording = SingleRecording(
                experiment, writer, origin, ready, resumed, start, options.checkpoint_every
            )
        else:
            from topcli.runs.ensemble import EnsembleRecording

            recording = EnsembleRecording(experiment, writer, origin)
        try:
            stored, report = recording.carry_out(start, options)
        except OSError as error:
            raise recording.failure(error) from error
    return RunResult(stored, report, "resumed" if start else "ran", writer.set_aside)


def _checked_start(identity: Identity, writer: RunWriter, source: Resumable, tell: Callable[[str], None]) -> Checkpoint:
    """Checkpoint of a run to be resumed, now that this process holds its lock.

    Raises UsageError if the folder has changed since ``source`` was seen.
    """
    start, name = writer.checkpoint, identity.name
    if start is None or not identity.same(start.about):
        raise UsageError(f"{source.where.folder}: changed while it was being resumed; try again")
    tell(f"{name}: continues from step {start.done} of {identity.config['N']}")
    if changed := difference(start.about["environment"], environment()):
        tell(f"{name}: started in another environment ({changed}); the last bits may differ from an uninterrupted run")
    return start


def _put_in_place(writer: RunWriter, complete: StoredRun, tell: Callable[[str], None]) -> RunResult:
    """Finish a run that was killed after its manifest was written. Raises RunError."""
    try:
        stored = writer.put_in_place(complete.manifest)
    except OSError as error:
        raise writer.failure(error) from error
    tell(f"{writer.name}: the run was complete when it was killed; it has been renamed into place")
    return RunResult(stored, stored.report(), "resumed", writer.set_aside)
