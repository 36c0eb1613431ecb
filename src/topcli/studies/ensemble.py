"""Run an ensemble into a run folder: stream the rows block by block, tally the invariants, write the reports."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from topcli.analysis.columns import column_names, columns
from topcli.analysis.many import ManyTally, joined_columns
from topcli.config.ensemble import EnsembleExperiment, Group
from topcli.contracts import Ending, Invariant
from topcli.engine.ensemble import EnsembleRun, Piece
from topcli.store.provenance import Commit, environment, now
from topcli.store.run_folder import RunWriter, io_failure
from topcli.store.series import SeriesWriter
from topcli.studies.ensemble_report import ensemble_markdown, ensemble_report
from topcli.studies.run import Progress, RunResult, method_fingerprint, plan_run

Columns = dict[str, np.ndarray]
Made = TypeVar("Made")


def ensemble_fingerprint(experiment: EnsembleExperiment) -> str:
    """A digest of the code of the scheme made ready for every top of the ensemble."""
    made = [method_fingerprint(experiment.of_group(group).method()) for group in experiment.members.groups]
    return made[0] if len(made) == 1 else hashlib.sha256(",".join(made).encode()).hexdigest()


def initial_digest(experiment: EnsembleExperiment) -> str:
    """sha256 of the initial states as little-endian doubles: random draws are the same as long as this is."""
    digest = hashlib.sha256()
    for group in experiment.members.groups:
        digest.update(np.ascontiguousarray(group.states, dtype="<f8").tobytes())
    return digest.hexdigest()


class GroupRun(Generic[Made]):
    """One group of an ensemble on its way: the run and its tally; ``keep`` makes something of every piece."""

    def __init__(
        self,
        experiment: EnsembleExperiment,
        group: Group,
        offset: int,
        keep: Callable[[GroupRun[Made], Piece], Made],
        stop: Callable[[], bool],
        threads: int | None,
    ) -> None:
        one = experiment.of_group(group)
        self.experiment, self.group, self.offset = experiment, group, offset
        self.modified: tuple[Invariant, ...] = one.modified
        self.tally = ManyTally((*group.top.invariants(), *self.modified), len(group.states), group.top)
        self.names = list(one.output.columns or column_names(group.top))

        def made(piece: Piece) -> Made:
            self.tally.add(piece.first, piece.n, piece.states, piece.kept)
            return keep(self, piece)

        method, every = one.method(), one.output.every
        self.run = EnsembleRun(
            group.top, method, group.states, one.h, one.N, every, made=made, stop=stop, threads=threads
        )

    @property
    def endings(self) -> list[Ending]:
        """How each trajectory ended, those that left their energy surface marked as such."""
        left = [None if step < 0 else step for step in self.tally.left.tolist()]
        return [ending.having_left(step, self.run.h) for ending, step in zip(self.run.endings, left, strict=True)]

    def rows(self, first: int | np.ndarray, n: np.ndarray, states: np.ndarray) -> Columns:
        """Columns of rows (m,): numbers of the trajectories in the group, step numbers (m,), states (m, d)."""
        trajectory = np.broadcast_to(np.asarray(first + self.offset, dtype=np.int64), n.shape)
        made = columns(self.group.top, n, self.experiment.first.h, states, self.names, self.modified)
        return {"trajectory": trajectory, **made}

    def last_rows(self) -> Columns:
        """A row for each trajectory that was begun: its last state."""
        begun = np.flatnonzero(self.tally.begun)
        return self.rows(begun, self.run.last_n[begun], self.run.last[begun])


def _all_rows(group: GroupRun[Any], piece: Piece) -> Columns | None:
    """The rows of a piece that were reached, trajectory by trajectory; None when there are none."""
    if not piece.kept.any():
        return None
    reached = np.arange(len(piece.n)) < piece.kept[:, None]
    which, row = np.nonzero(reached)
    return group.rows(piece.first + which, piece.n[row], piece.states[reached])


def _no_rows(group: GroupRun[Any], piece: Piece) -> Columns | None:
    return None


def trajectory_table(experiment: EnsembleExperiment, runs: Sequence[GroupRun[Any]]) -> Columns:
    """The table of trajectories: parameters that vary, initial state, how it ended, what it kept."""
    top = experiment.top
    endings = [ending for run in runs for ending in run.endings]
    counts = [len(run.group.states) for run in runs]
    made: Columns = {"trajectory": np.arange(experiment.count, dtype=np.int64)}
    for name in type(top).model_fields:
        values = [getattr(run.group.top, name) for run in runs]
        if any(value != values[0] for value in values):
            made[f"top.{name}"] = np.repeat(np.array(values, dtype=np.float64), counts)
    states = np.concatenate([run.group.states for run in runs])
    made |= {f"initial_{name}": states[:, i] for i, name in enumerate(top.components)}
    made["outcome"] = np.array([ending.outcome.value for ending in endings])
    made["n"] = np.array([ending.step for ending in endings], dtype=np.int64)
    made["left_motion"] = np.array([-1 if ending.left is None else ending.left for ending in endings], dtype=np.int64)
    return made | joined_columns([run.tally for run in runs])


def _run_groups(
    experiment: EnsembleExperiment,
    series: SeriesWriter | None,
    progress: Progress,
    stop: Callable[[], bool],
    threads: int | None,
) -> list[GroupRun[Columns | None]]:
    """Run group after group, writing what is to be stored."""
    N, total = experiment.first.N, experiment.first.N * experiment.count
    keep = _all_rows if experiment.store == "trajectories" else _no_rows
    runs: list[GroupRun[Columns | None]] = []
    offset = 0
    for group in experiment.members.groups:
        one = GroupRun(experiment, group, offset, keep, stop, threads)
        block = -1
        for made, done in one.run:
            if made is not None and series is not None:
                begins = int(made["trajectory"][0] - offset) // one.run.tile
                if one.run.side_by_side or begins != block:
                    series.end_group()
                block = begins
                series.write(made)
            progress(offset * N + done, total)
        one.tally.finish(one.run.last)
        if experiment.store == "final" and series is not None:
            series.write(one.last_rows())
        runs.append(one)
        offset += len(group.states)
    return runs


def run_ensemble(
    experiment: EnsembleExperiment,
    out: Path,
    *,
    force: bool = False,
    threads: int | None = None,
    progress: Progress = lambda done, total: None,
    stop: Callable[[], bool] = lambda: False,
) -> RunResult:
    """Run an ensemble into ``out/<name>/``, or find it there already; as ``run_experiment`` does for one trajectory.

    ``series.parquet`` has a column ``trajectory`` and the rows that ``store`` asks for, a row group for each block of
    trajectories (in a long run, for each stretch of a block); ``trajectories.parquet`` has a row for each trajectory
    and is the only table when ``store`` is ``statistics``. ``threads`` changes no bit of them; all CPUs by default.

    Raises UsageError before anything is written, RunError when writing fails; then nothing is left behind.
    """
    code = ensemble_fingerprint(experiment)
    plan = plan_run(experiment, out, code, force=force)
    if plan.up_to_date and plan.standing is not None:
        return RunResult(plan.standing, plan.standing.report(), "up to date")
    started, suffix = now(), experiment.first.output.format
    with Commit() as commit, RunWriter(out, experiment.name) as writer:
        try:
            resolved, provenance = experiment.resolved(), environment()
            about = {
                "topcli.config": json.dumps(resolved),
                "topcli.digest": experiment.digest,
                "topcli.environment": json.dumps(provenance),
            }
            table = writer.folder / f"trajectories.{suffix}"
            path = table if experiment.store == "statistics" else writer.folder / f"series.{suffix}"
            with ExitStack() as stack:
                series = None
                if path is not table:
                    names = list(experiment.first.output.columns or column_names(experiment.top))
                    series = stack.enter_context(SeriesWriter(path, ["trajectory", *names], about))
                runs = _run_groups(experiment, series, progress, stop, threads)
                seconds = {
                    "compile": sum(one.run.compile_seconds for one in runs),
                    "compile_cached": all(one.run.cached for one in runs),
                    "run": sum(one.run.run_seconds for one in runs),
                    "threads": runs[0].run.threads,
                }
                endings = [ending for one in runs for ending in one.endings]
                report = ensemble_report(experiment, endings, [one.tally for one in runs], seconds)
                ended = {"topcli.outcome": report["outcome"], "topcli.message": report["message"]}
                if series is not None:
                    series.finish(ended)
            each = trajectory_table(experiment, runs)
            with SeriesWriter(table, list(each), about) as trajectories:
                trajectories.write(each)
                trajectories.finish(ended)
            writer.write("report.json", json.dumps(report, indent=1, ensure_ascii=False) + "\n")
            writer.write("report.md", ensemble_markdown(report))
            writer.write("config.yaml", experiment.to_yaml())
            stored = writer.commit(
                {
                    "name": experiment.name,
                    "kind": "ensemble",
                    "digest": experiment.digest,
                    "code": code,
                    "outcome": report["outcome"],
                    "message": report["message"],
                    "series": path.name,
                    "trajectories": table.name,
                    "initial_states_sha256": initial_digest(experiment),
                    "config": resolved,
                    "scheme_origin": experiment.first.scheme.origin,
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
