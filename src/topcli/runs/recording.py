"""Recording of a run or an ensemble into its folder, from the first step to the manifest."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from topcli.config.models import Experiment
from topcli.contracts import Outcome
from topcli.engine.fingerprint import own_parts
from topcli.errors import RunError, TopcliError, UsageError
from topcli.runs.decision import RunOptions
from topcli.runs.identity import Identity, Prepared
from topcli.runs.recorder import Checkpoints, Recorder, run_of
from topcli.runs.report import (
    heading,
    left_motion,
    precision_data,
    report_data,
    report_markdown,
    seconds_of,
    section_data,
    section_note,
)
from topcli.schemes.own_tops import top_origin
from topcli.schemes.plugins import sources_of
from topcli.store.checkpoint import Checkpoint, read_checkpoint, write_checkpoint
from topcli.store.files import io_failure, json_text
from topcli.store.folder import RunWriter
from topcli.store.manifest import StoredRun
from topcli.store.provenance import Commit, now

if TYPE_CHECKING:
    from topcli.config.ensemble import EnsembleExperiment
    from topcli.engine.precise import PreciseRun


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
    from topcli.config.text import to_yaml  # slow to import; runs that are up to date do not need it

    return to_yaml(identity.config)


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
        texts |= sources_of(own_parts(type(first.top), first.scheme))
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
    """A run of one trajectory, with a checkpoint every some ``seconds`` if it is computed in doubles."""

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
            recorder = _recorder(experiment, precise, path, self.origin.metadata(), start)
            position = start and recorder.position(start)
            run = run_of(experiment, self.ready.method, options.stop, position, precise)
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
                if precise is None:
                    self.checkpoints.consider(run, recorder)
                options.on_progress(chunk.done, run.N)
            assert run.ending is not None
            if run.ending.outcome is Outcome.INTERRUPTED and precise is None:
                self.checkpoints.save(run, recorder)
            ending = recorder.finish(run.ending)
        writer.sha256[path.name] = recorder.series.sha256
        crossings = None if recorder.crossings is None else np.array([recorder.crossings])
        summary = {
            **heading(experiment, experiment.name, self.origin.identity.digest),
            "outcome": ending.outcome.value,
            "message": ending.message + section_note(experiment, crossings),
            **section_data(crossings),
            "step": ending.step,
            "t": ending.t,
            "left_motion": left_motion(ending),
            "counters": dict(ending.counters),
            "seconds": seconds_of(run),
            **((precise and precision_data(experiment.precision, precise.arithmetic.library, recorder.growth)) or {}),
        }
        report = report_data(summary, recorder.tally.report(), recorder.quantities.rows())
        manifest = {"step": ending.step, "left_motion": report["left_motion"], "series": path.name}
        return report, report_markdown(report), manifest | ({"resumed": self.resumed} if self.resumed else {})

    def failure(self, error: OSError) -> RunError:
        """Return the error to report after a failed write, and save the run as interrupted or its last checkpoint."""
        writer, last = self.writer, None
        if writer.finished or not writer.folder.exists():
            return writer.failure(error)
        for last in self.checkpoints.to_save():
            with contextlib.suppress(OSError, TopcliError):
                return io_failure(error, writer.target, self._saved(last))
        if last is not None and read_checkpoint(writer.folder) is None:
            with contextlib.suppress(OSError):
                write_checkpoint(writer.folder, last)
        return writer.failure(error)

    def _saved(self, last: Checkpoint) -> str:
        """Put the run up to a checkpoint in its place, and return what is kept. Raises OSError and TopcliError.

        The run continues from the checkpoint and is stopped before its next step, so that it ends as interrupted runs
        do; one that is already at its end is finished.
        """
        stored, _ = self.carry_out(last, RunOptions(stop=lambda: True))
        if stored.interrupted:
            return f"the run up to step {last.done} is kept, marked interrupted; --resume continues it"
        return "the finished run is stored in its folder"


def _recorder(
    experiment: Experiment,
    precise: PreciseRun | None,
    path: Path,
    metadata: Mapping[str, str],
    start: Checkpoint | None,
) -> Recorder:
    """Recorder of an experiment in its precision, for a series at ``path``; it continues from ``start``."""
    if precise is None:
        return Recorder(experiment, path, metadata, start)
    from topcli.runs.precise import PreciseRecorder

    return PreciseRecorder(experiment, precise, path, metadata)
