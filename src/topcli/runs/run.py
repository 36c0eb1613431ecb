"""Run an experiment or an ensemble into a folder: look at it, decide, run, record, commit."""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topcli.config.models import Experiment
from topcli.contracts import Outcome
from topcli.errors import RunError, TopcliError, UsageError
from topcli.runs.decision import Decision, RunOptions, decide, difference
from topcli.runs.identity import Identity, Prepared, prepared
from topcli.runs.recorder import Checkpoints, recorder_of, run_of
from topcli.runs.report import (
    accuracy_data,
    heading,
    left_motion,
    precision_data,
    report_data,
    report_markdown,
    seconds_of,
)
from topcli.schemes.registry import top_origin
from topcli.store.checkpoint import Checkpoint, read_checkpoint, write_checkpoint
from topcli.store.files import io_failure, json_text
from topcli.store.folder import Folder, RunWriter, Source
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
            return f"kept the earlier folder of this run, with files that are not topcli's, as {self.set_aside}"
        return f"renamed the earlier, different run to {self.set_aside}"

    @property
    def outcome(self) -> Outcome:
        """Outcome of the run."""
        return Outcome(self.report["outcome"])


@dataclass(frozen=True)
class Origin:
    """Origin of the files of a run folder: the experiment, when and where it was begun, and the commit of the code."""

    identity: Identity
    started: str
    environment: dict[str, Any]
    commit: Commit

    def metadata(self) -> dict[str, str]:
        """Metadata of the tables."""
        return table_metadata(self.identity, self.environment)


def table_metadata(identity: Identity, made_in: dict[str, Any]) -> dict[str, str]:
    """Metadata of the tables of a run that was made in this environment."""
    return {
        "topcli.config": json.dumps(identity.config),
        "topcli.digest": identity.digest,
        "topcli.environment": json.dumps(made_in),
    }


def config_text(identity: Identity) -> str:
    """Config of a run as YAML."""
    from topcli.config.yaml_text import to_yaml  # slow to import; runs that are up to date do not need it

    return to_yaml(identity.config)


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


def _checked_start(identity: Identity, writer: RunWriter, source: Source, tell: Callable[[str], None]) -> Checkpoint:
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


class Recording:
    """A run on its way into its folder; a subclass runs it into tables."""

    def __init__(self, experiment: Experiment | EnsembleExperiment, writer: RunWriter, origin: Origin) -> None:
        self.experiment, self.writer, self.origin = experiment, writer, origin

    def record(self, start: Checkpoint | None, options: RunOptions) -> tuple[dict[str, Any], str, dict[str, Any]]:
        """Run into tables; the report, its Markdown, and entries of the manifest. Raises OSError."""
        raise NotImplementedError

    def carry_out(self, start: Checkpoint | None, options: RunOptions) -> tuple[StoredRun, dict[str, Any]]:
        """Run from ``start``, or from step 0, to the end or until stopped, and put the folder in its place.

        Raises OSError, and RunError if another process has put a different run there.
        """
        report, markdown, entries = self.record(start, options)
        writer, origin, identity = self.writer, self.origin, self.origin.identity
        texts = {"report.json": json_text(report), "report.md": markdown, "config.yaml": config_text(identity)}
        first = self.experiment if isinstance(self.experiment, Experiment) else self.experiment.first
        manifest = {
            "name": identity.name,
            **identity.digests,
            "outcome": report["outcome"],
            "message": report["message"],
            **entries,
            "config": identity.config,
            "scheme_origin": first.scheme.origin,
            "top_origin": top_origin(type(first.top)),
            "started": origin.started,
            "ended": now(),
            "seconds": report["seconds"],
            "environment": origin.environment,
            **origin.commit.read(),
        }
        return writer.commit(manifest, texts), report

    def failure(self, error: OSError) -> RunError:
        """Error to report after a failed write."""
        return self.writer.failure(error)


class SingleRecording(Recording):
    """A run of one trajectory, with a checkpoint every some ``seconds``."""

    experiment: Experiment

    def __init__(
        self,
        experiment: Experiment,
        writer: RunWriter,
        origin: Origin,
        ready: Prepared,
        resumed: list[dict[str, Any]],
        start: Checkpoint | None,
        seconds: float,
    ) -> None:
        super().__init__(experiment, writer, origin)
        self.ready, self.resumed = ready, resumed
        identity = origin.identity
        about = {
            **identity.digests,
            "name": identity.name,
            "config": identity.config,
            "environment": origin.environment,
            "started": origin.started,
            "resumed": resumed,
        }
        self.checkpoints = Checkpoints(writer.folder, about, seconds, last=start)

    def record(self, start: Checkpoint | None, options: RunOptions) -> tuple[dict[str, Any], str, dict[str, Any]]:
        """Run into the series; the report, its Markdown, and entries of the manifest. Raises OSError."""
        experiment, writer, precise = self.experiment, self.writer, self.ready.precise
        path = writer.folder / f"series.{experiment.output.format}"
        try:
            recorder = recorder_of(experiment, precise, path, self.origin.metadata(), start)
            position = start and recorder.position(start)
            run = run_of(experiment, self.ready.method, precise, options.stop, position)
        except (KeyError, ValueError) as error:
            if start is None:
                raise
            raise UsageError(
                f"{writer.folder}: its checkpoint was written by another version of topcli ({error})"
            ) from None
        run.run_seconds = float(start.about["run_seconds"]) if start else 0.0
        with recorder:
            for chunk in run:
                recorder.add(chunk)
                self.checkpoints.consider(run, recorder)
                options.on_progress(chunk.done, run.N)
            assert run.ending is not None
            if run.ending.outcome is Outcome.INTERRUPTED:
                self.checkpoints.save(run, recorder)
            ending = recorder.finish(run.ending)
        writer.sha256[path.name] = recorder.series.sha256
        summary = {
            **heading(experiment, experiment.name, self.origin.identity.digest),
            "outcome": ending.outcome.value,
            "message": ending.message,
            "step": ending.step,
            "t": ending.t,
            "left_motion": left_motion(ending),
            "counters": dict(ending.counters),
            "seconds": seconds_of(run),
            **accuracy_data(self.ready.method, experiment, ending.step),
            **((precise and precision_data(experiment.precision, precise.arithmetic.library, recorder.growth)) or {}),
        }
        report = report_data(summary, recorder.tally.report())
        manifest = {"step": ending.step, "left_motion": report["left_motion"], "series": path.name}
        return report, report_markdown(report), manifest | ({"resumed": self.resumed} if self.resumed else {})

    def failure(self, error: OSError) -> RunError:
        """Error to report after a failed write; saves the run as interrupted, or its last checkpoint, if possible."""
        writer, last = self.writer, None
        for last in [] if writer.finished or not writer.folder.exists() else self.checkpoints.to_save():
            with contextlib.suppress(OSError, TopcliError):
                stored, _ = self.carry_out(last, RunOptions(stop=lambda: True))
                kept = "the finished run is in its place"
                if stored.interrupted:
                    kept = f"the run up to step {last.done} is kept, marked interrupted; --resume continues it"
                return io_failure(error, writer.target, kept)
        if last is not None and read_checkpoint(writer.folder) is None:
            with contextlib.suppress(OSError):
                write_checkpoint(writer.folder, last)
        return writer.failure(error)


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
