"""Run of an experiment or an ensemble into a folder: decide, compute, record, commit."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topcli.config.models import Experiment
from topcli.contracts import Outcome
from topcli.errors import UsageError
from topcli.runs.decision import Decision, RunOptions, decide, difference
from topcli.runs.identity import Identity, prepared
from topcli.runs.recording import Origin, Recording, SingleRecording, config_text, table_metadata
from topcli.store.checkpoint import Checkpoint
from topcli.store.folder import Folder, Resumable, RunWriter
from topcli.store.manifest import StoredRun, stored_run
from topcli.store.parts import is_result, remove_own
from topcli.store.provenance import Commit, environment, now
from topcli.store.series import copy_series

if TYPE_CHECKING:
    from topcli.config.ensemble import EnsembleExperiment

_TABLES = ("series", "trajectories")
"""Entries of a manifest that name tables; they are the same file if an ensemble keeps no rows."""


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
    return identity, decide(identity, Folder.look(out, identity.name, identity.format), options)


def run_experiment(
    experiment: Experiment | EnsembleExperiment, out: Path, options: RunOptions = RunOptions()
) -> RunResult:
    """Run an experiment or ensemble into the folder ``out/<name>``, unless it has been run before.

    A finished run of the same experiment and code is not repeated unless ``force``, or if it failed ``retry_failed``;
    one in another format is rewritten from its stored tables.
    A different experiment of that name is refused; with ``force`` it is renamed.

    Raises UsageError before anything is written, and RunError if writing fails; what remains can be read or resumed.
    """
    ready, tell = prepared(experiment, options.resume), options.on_message
    identity, name = ready.identity, ready.identity.name
    folder = Folder.look(out, name, identity.format)
    decision = decide(identity, folder, options)
    for note in decision.notes:
        tell(f"{name}: {note}")
    if decision.verb != "run":
        assert folder.run is not None
        return _finished_result(identity, folder.run, out, decision.verb == "rewrite")
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


def _finished_result(identity: Identity, run: StoredRun, out: Path, rewrite: bool) -> RunResult:
    """Result of a finished run, as it is or with its tables written again in the format of ``identity``.

    The earlier folder is then removed after the new one is complete; if it holds files of the user it is renamed.
    Raises RunError if reading or writing fails; the earlier run is unchanged.
    """
    if not rewrite:
        return RunResult(run, run.report(), "up to date")
    manifest, suffix = run.manifest, identity.format
    tables = {manifest[key]: f"{Path(manifest[key]).stem}.{suffix}" for key in _TABLES if key in manifest}
    metadata = table_metadata(identity, manifest.get("environment", {}))
    with RunWriter(out, identity.name, identity.digests, displace=False) as writer:
        try:
            for name in manifest["files"]:
                if name in tables:
                    target = writer.folder / tables[name]
                    writer.sha256[target.name] = copy_series(run.folder / name, target, metadata, _ended(manifest))
                elif is_result(name):
                    shutil.copyfile(run.folder / name, writer.folder / name)
            kept = {key: value for key, value in manifest.items() if key != "files"}
            kept |= {key: tables[manifest[key]] for key in _TABLES if key in manifest}
            rewritten = {"from": sorted(tables), "at": now()}
            kept |= {"name": identity.name, "config": identity.config, "rewritten": rewritten}
            stored = writer.commit(kept, {"config.yaml": config_text(identity)})
        except OSError as error:
            if stored_run(run.folder) is not None:  # not moved yet: the unplaced copy is of no use
                remove_own(writer.folder)
            raise writer.failure(error, f"the run is kept as {run.series.suffix[1:]}") from error
    return RunResult(stored, stored.report(), f"rewritten as {suffix}", writer.set_aside)


def _ended(manifest: dict[str, Any]) -> dict[str, str]:
    """Metadata of tables that are known at the end of a run."""
    ended = {"topcli.outcome": manifest["outcome"], "topcli.message": manifest.get("message", "")}
    left = manifest.get("left_motion")
    return ended if left is None else {**ended, "topcli.left_motion": json.dumps(left)}
