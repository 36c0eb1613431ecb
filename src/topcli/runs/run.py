"""Run of an experiment or an ensemble into its folder: claim, compute with checkpoints, report, finish."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from topcli.config.models import Experiment
from topcli.contracts import Outcome
from topcli.engine.consumers import State
from topcli.engine.drive import Chunk, drive
from topcli.engine.integration import Integration
from topcli.errors import RunError
from topcli.plugins import own_sources
from topcli.runs.plans import plans
from topcli.runs.recording import Recording
from topcli.store.files import json_text
from topcli.store.identity import Identity, identity_of
from topcli.store.provenance import git_commit, now
from topcli.store.result_folder import ResultFolder, being_computed
from topcli.store.results import SWEEP, StoredResult, intact_result, stored_results
from topcli.tops import top_origin

CHECKPOINT_SECONDS = 10.0
"""Seconds between two checkpoints; the first one comes after half of it."""
COST = 100.0
"""A checkpoint waits at least this many times the seconds that the last one took: at most 1 % of a run."""
_Progress = Callable[[int, int], None]
"""Called with (steps done, all steps) between chunks; of an ensemble, with those of all trajectories."""


@dataclass(frozen=True)
class RunOptions:
    """Options of a run, for the command and for the function; none of them changes what is computed.

    Attributes
    ----------
    force : bool
        Run again; what the name holds is renamed, not overwritten.
    checkpoint_every : float
        Seconds between checkpoints, all that a kill can lose; 0 for one after every chunk.
    threads : int, optional
        Threads of an ensemble, by default one for each CPU.
    on_progress, on_message : callable
        Called with (steps done, all steps), and with a line for the user.
    """

    force: bool = False
    checkpoint_every: float = CHECKPOINT_SECONDS
    threads: int | None = None
    on_progress: _Progress = lambda done, total: None
    on_message: Callable[[str], None] = lambda line: None


@dataclass(frozen=True)
class RunResult:
    """A result in its folder and its report.

    The ``status`` of the call is ``"ran"``, ``"continued"`` or ``"up to date"``. ``set_aside`` is the new folder of an
    earlier result that had to make way.
    """

    stored: StoredResult
    report: dict[str, Any]
    status: str
    set_aside: Path | None = None

    @property
    def outcome(self) -> Outcome:
        """Outcome of the run."""
        return Outcome(self.report["outcome"])


def outlook(experiment: Experiment, out: Path, force: bool) -> tuple[Identity, str]:
    """Identity of an experiment, and what ``run_experiment`` would do. Raises UsageError for what it would refuse."""
    identity = identity_of(experiment)
    next(plans(experiment))
    return identity, ResultFolder.outlook(out / experiment.name, identity, force)


def run_experiment(experiment: Experiment, out: Path, options: RunOptions = RunOptions()) -> RunResult:
    """Run an experiment or ensemble into ``out/NAME``, continue it if it was stopped, or find that it is up to date.

    With ``force`` it begins anew; what the name holds is renamed. A different experiment of that name is refused
    without. Once the work is asked to stop, the run ends as ``interrupted`` and its rows are stored. Raises UsageError
    before anything is written, and RunError if a stored result is damaged or writing fails; then the last checkpoint
    remains.
    """
    identity = identity_of(experiment)
    next(plans(experiment))  # an experiment that cannot be computed is refused before anything is written
    with ResultFolder.claim(out / experiment.name, identity, force=options.force) as folder:
        if folder.complete:
            stored = intact_result(folder.stored.folder)
            return RunResult(stored, stored.report(), "up to date", folder.set_aside)
        return _computed(experiment, folder, identity, options)


def _computed(experiment: Experiment, folder: ResultFolder, identity: Identity, options: RunOptions) -> RunResult:
    """Compute a result into its folder, from the last checkpoint on. Raises OSError."""
    metadata = {"topcli.config": json.dumps(identity.config), "topcli.digest": identity.digest}
    metadata |= {"topcli.environment": json.dumps(folder.stored.manifest["environment"])}
    recording, state = Recording(experiment, folder.working, metadata), folder.checkpoint()
    if continued := bool(state):
        options.on_message(f"{experiment.name}: continues from the last checkpoint")
    with ExitStack() as open_tables:
        for table in recording.tables:
            open_tables.enter_context(table)
        run = _integrated(recording, state, Checkpoints(folder, options), options)
        report = recording.report(run.plan, run.endings, identity.digest)
        left = {"topcli.left_motion": json.dumps(report["left_motion"])} if report.get("left_motion") else {}
        tables = recording.finish(Outcome(report["outcome"]), report["message"], left)
    # the manifest comes last, for it declares the result complete
    entries = _manifest_entries(recording, report, tables) | ({"continued": now()} if continued else {})
    folder.finish(entries, _texts(recording, identity, report), tables)
    return RunResult(folder.stored, report, "continued" if continued else "ran", folder.set_aside)


def _integrated(recording: Recording, state: State, save: Checkpoints, options: RunOptions) -> Integration:
    """Last plan, or the interrupted one, after integrating those that the checkpoint ``state`` leaves to do."""
    experiment, begun = recording.experiment, int(state.pop("plan", np.array(0)))
    count, run = experiment.ensemble.count if experiment.ensemble else 1, None
    for number, plan in enumerate(plans(experiment)):
        if number < begun:  # it is in the tables already
            continue

        def on_chunk(chunk: Chunk, number: int = number) -> None:
            save(number, chunk)
            options.on_progress(chunk.run.plan.first * experiment.N + chunk.run.taken, count * experiment.N)

        run = drive(plan, recording.consumers, start=state, on_chunk=on_chunk, threads=options.threads)
        recording.add_seconds(run)
        state = {}
        if Outcome.INTERRUPTED in run.endings.outcomes:
            break
    assert run is not None
    return run


def _manifest_entries(recording: Recording, report: dict[str, Any], tables: Sequence[Path]) -> dict[str, Any]:
    """Entries of the manifest of a result with this report and these tables."""
    experiment = recording.experiment
    return {
        "kind": "ensemble" if experiment.ensemble else "run",
        "outcome": report["outcome"],
        "message": report["message"],
        **({"step": report["step"]} if "step" in report else {"trajectories": tables[-1].name}),
        "series": tables[0].name,
        "scheme_origin": experiment.scheme.origin,
        "top_origin": top_origin(type(experiment.top)),
        "seconds": recording.seconds,
        **git_commit(),
    }


def _texts(recording: Recording, identity: Identity, report: dict[str, Any]) -> dict[str, str]:
    """Texts of a result by file name: the report, the config, and a user's own sources."""
    from topcli.config.text import to_yaml

    sources = own_sources(type(recording.experiment.top), recording.experiment.scheme)
    return {"report.json": json_text(report), "config.yaml": to_yaml(identity.config), **sources}


class Checkpoints:
    """Saves the state of a run between chunks: the first time after half of the seconds, and when it is stopped."""

    def __init__(self, folder: ResultFolder, options: RunOptions) -> None:
        self._folder, self._options = folder, options
        self._due = time.monotonic() + 0.5 * options.checkpoint_every

    def __call__(self, plan: int, chunk: Chunk) -> None:
        """Save the state after a chunk of plan number ``plan``, if that is due. Raises OSError."""
        seconds, began = self._options.checkpoint_every, time.monotonic()
        if chunk.run.plan.precise is None and (began >= self._due or chunk.stopping):
            self._folder.save({"plan": np.array(plan), **chunk.state()})
            ended = time.monotonic()
            self._due = ended + (max(seconds, COST * (ended - began)) if seconds else 0.0)


def listed_runs(out: Path) -> list[dict[str, Any]]:
    """Runs and sweeps in ``out`` by name, as plain data for ``topcli list runs``; what is not known is None.

    The outcome is ``running`` while a process computes the run, ``killed`` if it no longer does, or ``damaged``. The
    ``step`` and ``N`` of a sweep are the numbers of its finished rows and of all.
    """
    return [_listed(name, stored) for name, stored in stored_results(out).items()]


def _listed(name: str, stored: StoredResult | RunError) -> dict[str, Any]:
    manifest = stored.manifest if isinstance(stored, StoredResult) else {}
    config, outcome = manifest.get("config", {}), manifest.get("outcome") or "damaged"
    if isinstance(stored, StoredResult) and stored.outcome is None:
        outcome = "running" if being_computed(stored.folder) else "killed"
    return {
        "name": name,
        "kind": SWEEP if manifest.get("kind") == SWEEP else "ensemble" if "ensemble" in config else "run",
        "outcome": outcome,
        "step": manifest.get("step"),
        "scheme": config.get("scheme", {}).get("name"),
        "h": config.get("h"),
        "N": manifest.get("rows", config.get("N")),
        "digest": manifest["digest"][:8] if manifest else None,
        "ended": manifest.get("ended"),
        **({} if manifest else {"reason": str(stored)}),
    }
