"""Run an experiment into a run folder: stream the series, tally the invariants, write the reports."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from topcli.analysis.columns import column_names, columns
from topcli.analysis.drift import InvariantTally
from topcli.config.models import Experiment
from topcli.contracts import Block, Invariant, Method, Outcome, Sampler
from topcli.engine.loop import Run
from topcli.engine.source import fingerprint
from topcli.errors import UsageError
from topcli.store.provenance import Commit, environment, now
from topcli.store.run_folder import RunWriter, StoredRun, io_failure, stored_run
from topcli.store.series import SeriesWriter
from topcli.studies.report import report_data, report_markdown

Progress = Callable[[int, int], None]
"""Told (steps done, N) between chunks."""


@dataclass(frozen=True)
class RunResult:
    """A run folder, its report, and what became of the call.

    ``status`` is ``"ran"`` or ``"up to date"``; ``set_aside`` is where a different earlier run was moved.
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
    """A digest of the code of a scheme made ready for a top."""
    if isinstance(method, Sampler):
        return fingerprint(method.states)
    if isinstance(method, Block):
        return hashlib.sha256((method.text() + fingerprint(method.enter)).encode()).hexdigest()
    return fingerprint(method.step, method.enter, method.leave)


def plan_run(experiment: Experiment, out: Path, code: str, *, force: bool = False) -> Plan:
    """What running ``experiment`` into ``out`` will do. Raises UsageError for what would be refused."""
    target, digest = out / experiment.name, experiment.digest
    if out.exists() and not out.is_dir():
        raise UsageError(f"output folder {out}: is not a folder; choose another with --out")
    standing = stored_run(target)
    if standing is None:
        if target.exists() and (not target.is_dir() or any(target.iterdir())):
            raise UsageError(
                f"{target}: exists and is no finished run; nothing was written\n"
                "move it away, or choose another folder with --out or another name with --set name=..."
            )
        return Plan(None, False, "will run")
    if not standing.same_experiment(digest):
        if not force:
            raise UsageError(
                f"{target}: holds a different experiment (digest {str(standing.manifest['digest'])[:8]}, this one "
                f"{digest[:8]}); nothing was written\nchoose --set name=... or --out, or --force to keep the earlier "
                "run aside and put this one in its place"
            )
        return Plan(standing, False, "will run, and keep the different run that is there aside")
    if not force and standing.up_to_date(digest, code):
        return Plan(standing, True, "up to date")
    return Plan(standing, False, "will run again")


def _write_series(
    path: Path,
    experiment: Experiment,
    run: Run,
    tally: InvariantTally,
    modified: tuple[Invariant, ...],
    about: dict[str, str],
    progress: Progress,
) -> None:
    top, h = experiment.top, experiment.h
    names = list(experiment.output.columns or column_names(top))
    with SeriesWriter(path, names, about) as writer:
        for chunk in run:
            tally.add(chunk.n, chunk.states)
            writer.write(columns(top, chunk.n, h, chunk.states, names, modified))
            progress(chunk.done, experiment.N)
        assert run.ending is not None
        writer.finish({"topcli.outcome": run.ending.outcome.value, "topcli.message": run.ending.message})


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
        "counters": dict(ending.counters),
        "seconds": {"compile": run.compile_seconds, "compile_cached": run.cached, "run": run.run_seconds},
    }


def run_experiment(
    experiment: Experiment,
    out: Path,
    *,
    force: bool = False,
    progress: Progress = lambda done, total: None,
    stop: Callable[[], bool] = lambda: False,
) -> RunResult:
    """Run ``experiment`` into ``out/<name>/``, or find it there already.

    A run of the same experiment by the same code that ended by itself is not repeated unless ``force``. A
    different experiment standing there is refused, unless ``force``: then it is set aside under another name.
    ``stop`` is asked between chunks; what was written until then is kept, marked ``interrupted``.

    Raises UsageError before anything is written, RunError when writing fails; then nothing is left behind.
    """
    method, digest = experiment.method(), experiment.digest
    code = method_fingerprint(method)
    plan = plan_run(experiment, out, code, force=force)
    if plan.up_to_date and plan.standing is not None:
        return RunResult(plan.standing, plan.standing.report(), "up to date")
    started = now()
    modified = experiment.modified
    tally = InvariantTally((*experiment.top.invariants(), *modified), experiment.h)
    with Commit() as commit, RunWriter(out, experiment.name) as writer:
        series = writer.folder / f"series.{experiment.output.format}"
        try:
            resolved, provenance = experiment.resolved(), environment()
            about = {
                "topcli.config": json.dumps(resolved),
                "topcli.digest": digest,
                "topcli.environment": json.dumps(provenance),
            }
            run = Run(
                experiment.top,
                method,
                experiment.y0,
                experiment.h,
                experiment.N,
                experiment.output.every,
                stop,
            )
            _write_series(series, experiment, run, tally, modified, about, progress)
            report = report_data(_summary(experiment, run, digest), tally.rows())
            writer.write("report.json", json.dumps(report, indent=1, ensure_ascii=False) + "\n")
            writer.write("report.md", report_markdown(report))
            writer.write("config.yaml", experiment.to_yaml())
            stored = writer.commit(
                {
                    "name": experiment.name,
                    "digest": digest,
                    "code": code,
                    "outcome": report["outcome"],
                    "message": report["message"],
                    "series": series.name,
                    "config": resolved,
                    "scheme_origin": experiment.scheme.origin,
                    "started": started,
                    "ended": now(),
                    "seconds": report["seconds"],
                    "environment": provenance,
                    **commit.read(),
                }
            )
        except OSError as error:
            raise io_failure(error, out / experiment.name) from error
    return RunResult(stored, report, "ran", writer.set_aside)
