"""Run an ensemble into a run folder: stream the rows block by block, tally the invariants, write the reports."""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

import numpy as np

from topcli.analysis.columns import column_names, columns
from topcli.analysis.many import EnsembleSummary, EnsembleTally, Spool, measure_columns
from topcli.config.ensemble import EnsembleExperiment, Group
from topcli.contracts import Array, Invariant
from topcli.engine.endings import OUTCOMES
from topcli.engine.ensemble import BLOCK, EnsembleRun, Piece, tile_of
from topcli.store.provenance import Commit, environment, now
from topcli.store.run_folder import RunWriter
from topcli.store.series import SeriesWriter
from topcli.studies.ensemble_report import EndingTally, ensemble_markdown, ensemble_report
from topcli.studies.run import Progress, RunResult, method_fingerprint, plan_run

Columns = dict[str, np.ndarray]
Made = TypeVar("Made")


def ensemble_fingerprint(experiment: EnsembleExperiment) -> str:
    """A digest of the code of the scheme made ready for every top of the ensemble."""
    made = [method_fingerprint(experiment.of_group(group).method()) for group in experiment.members.groups]
    return made[0] if len(made) == 1 else hashlib.sha256(",".join(made).encode()).hexdigest()


class GroupRun(Generic[Made]):
    """One group of an ensemble on its way, block by block; ``keep`` makes something of every piece.

    ``run`` and ``tally`` are those of the block that was begun last.
    """

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
        """``offset`` is the number that the first trajectory of the block has in the ensemble."""
        self._next = offset
        self.modified: tuple[Invariant, ...] = one.modified
        self.invariants = (*group.top.invariants(), *self.modified)
        self.tally = EnsembleTally(self.invariants, 0, group.top)
        self.names = list(one.output.columns or column_names(group.top))

        def made(piece: Piece) -> Made:
            self.tally.add(piece.first, piece.n, piece.states, piece.kept)
            return keep(self, piece)

        self.run = EnsembleRun(
            group.top,
            one.method(),
            np.empty((0, len(group.top.components))),
            one.h,
            one.N,
            one.output.every,
            made=made,
            stop=stop,
            threads=threads,
            tile=tile_of(group.count),
            wide=experiment.store != "trajectories",  # whose row groups are tiles
        )

    def block(self, y0: Array) -> Iterator[tuple[Made, int]]:
        """Run the next trajectories of the group, from ``y0`` (m, d): what ``keep`` made, and trajectory-steps done."""
        self.offset, self._next = self._next, self._next + len(y0)
        self.tally = EnsembleTally(self.invariants, len(y0), self.group.top)
        self.run.begin(y0)
        yield from self.run
        self.tally.finish(self.run.last)
        self.run.endings.mark_left(self.tally.left)

    def rows(self, first: int | np.ndarray, n: np.ndarray, states: np.ndarray) -> Columns:
        """Columns of rows (m,): numbers of the trajectories in the block, step numbers (m,), states (m, d)."""
        trajectory = np.broadcast_to(np.asarray(first + self.offset, dtype=np.int64), n.shape)
        made = columns(self.group.top, n, self.experiment.first.h, states, self.names, self.modified)
        return {"trajectory": trajectory, **made}

    def last_rows(self) -> Columns:
        """A row for each trajectory of the block that was begun: its last state."""
        begun = np.flatnonzero(self.tally.begun)
        return self.rows(begun, self.run.last_n[begun], self.run.last[begun])

    def trajectories(self, varied: Sequence[str]) -> Columns:
        """The table of the block's trajectories: ``varied`` parameters, initial state, how it ended, what it kept."""
        run, top = self.run, self.group.top
        count = len(run.endings)
        made: Columns = {"trajectory": np.arange(self.offset, self.offset + count, dtype=np.int64)}
        made |= {f"top.{name}": np.full(count, getattr(top, name), dtype=np.float64) for name in varied}
        made |= {f"initial_{name}": run.y0[:, i] for i, name in enumerate(top.components)}
        made["outcome"] = _OUTCOME_NAMES[run.endings.outcome]
        made["n"] = run.endings.step
        made["left_motion"] = run.endings.left
        return made | measure_columns(self.tally)


_OUTCOME_NAMES = np.array([outcome.value for outcome in OUTCOMES], dtype=object)


def varied_parameters(experiment: EnsembleExperiment) -> list[str]:
    """The parameters of the top that are not the same in all groups."""
    tops = [group.top for group in experiment.members.groups]
    names = type(experiment.top).model_fields
    return [name for name in names if any(getattr(top, name) != getattr(tops[0], name) for top in tops)]


def _all_rows(group: GroupRun[Any], piece: Piece) -> Columns | None:
    """The rows of a piece that were reached, trajectory by trajectory; None when there are none."""
    if not piece.kept.any():
        return None
    reached = np.arange(len(piece.n)) < piece.kept[:, None]
    which, row = np.nonzero(reached)
    return group.rows(piece.first + which, piece.n[row], piece.states[reached])


def _no_rows(group: GroupRun[Any], piece: Piece) -> Columns | None:
    return None


class _Record:
    """What is kept of an ensemble while it runs, in memory that does not grow with the number of trajectories.

    ``series`` is the table of rows, if there is one besides that of trajectories, which ``table_of`` its columns opens.
    """

    def __init__(
        self,
        experiment: EnsembleExperiment,
        series: SeriesWriter | None,
        table_of: Callable[[list[str]], SeriesWriter],
        spool: Spool,
    ) -> None:
        self.experiment, self.series, self._table_of = experiment, series, table_of
        self.trajectories: SeriesWriter | None = None
        self.varied = varied_parameters(experiment)
        self.initial = hashlib.sha256()
        self.endings = EndingTally(experiment.first.N)
        self.summary = EnsembleSummary(spool)
        self.seconds: dict[str, Any] = {"compile": 0.0, "compile_cached": True, "run": 0.0}

    def run(self, progress: Progress, stop: Callable[[], bool], threads: int | None) -> None:
        """Run group after group, and in each block after block."""
        N, total = self.experiment.first.N, self.experiment.first.N * self.experiment.count
        keep = _all_rows if self.experiment.store == "trajectories" else _no_rows
        offset = 0
        for group in self.experiment.members.groups:
            one = GroupRun(self.experiment, group, offset, keep, stop, threads)
            for y0 in group.source.blocks(BLOCK):
                self._write_block(one, y0, lambda done, one=one: progress(one.offset * N + done, total))
            self._add_seconds(one.run)
            offset += group.count

    def _write_block(self, one: GroupRun[Columns | None], y0: Array, advanced: Callable[[int], None]) -> None:
        tile = -1
        for made, done in one.block(y0):
            if made is not None and self.series is not None:
                begins = int(made["trajectory"][0] - one.offset) // one.run.tile
                if one.run.side_by_side or begins != tile:
                    self.series.end_group()
                tile = begins
                self.series.write(made)
            advanced(done)
        if self.experiment.store == "final" and self.series is not None:
            self.series.write(one.last_rows())
        self.initial.update(np.ascontiguousarray(y0, dtype="<f8").data)
        self.endings.add(one.run.endings)
        self.summary.add(one.tally)
        made = one.trajectories(self.varied)
        if self.trajectories is None:
            self.trajectories = self._table_of(list(made))
        self.trajectories.write(made)

    def _add_seconds(self, run: EnsembleRun[Any]) -> None:
        self.seconds["compile"] += run.compile_seconds
        self.seconds["compile_cached"] &= run.cached
        self.seconds["run"] += run.run_seconds
        self.seconds["threads"] = run.threads

    def finish(self) -> dict[str, Any]:
        """End the tables; the report. Raises OSError."""
        ended = {"topcli.outcome": self.endings.outcome.value, "topcli.message": self.endings.message}
        for table in (self.series, self.trajectories):
            if table is not None:
                table.finish(ended)
        return ensemble_report(self.experiment, self.endings, self.summary.rows(), self.seconds)


def _tables(experiment: EnsembleExperiment, folder: Path) -> tuple[Path, Path]:
    """The paths of the table of rows and of that of trajectories, which are one where no rows are stored."""
    suffix = experiment.first.output.format
    table = folder / f"trajectories.{suffix}"
    return (table if experiment.store == "statistics" else folder / f"series.{suffix}"), table


def _carry_out(
    experiment: EnsembleExperiment,
    writer: RunWriter,
    about: dict[str, str],
    progress: Progress,
    stop: Callable[[], bool],
    threads: int | None,
) -> tuple[dict[str, Any], str]:
    """Run into the tables of the run folder; the report, and the sha256 of the initial states. Raises OSError."""
    path, table = _tables(experiment, writer.folder)
    with ExitStack() as stack:
        series = None
        if path != table:
            names = list(experiment.first.output.columns or column_names(experiment.top))
            series = stack.enter_context(SeriesWriter(path, ["trajectory", *names], about))

        def table_of(names: list[str]) -> SeriesWriter:
            return stack.enter_context(SeriesWriter(table, names, about))

        spool = stack.enter_context(tempfile.TemporaryFile(dir=writer.folder))
        record = _Record(experiment, series, table_of, cast(Spool, spool))
        record.run(progress, stop, threads)
        report = record.finish()
        for name, written in ((path.name, series), (table.name, record.trajectories)):
            if written is not None:
                writer.sha256[name] = written.sha256
        return report, record.initial.hexdigest()


def run_ensemble(
    experiment: EnsembleExperiment,
    out: Path,
    *,
    force: bool = False,
    retry_failed: bool = False,
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
    plan = plan_run(experiment, out, code, force=force, retry_failed=retry_failed)
    if plan.up_to_date and plan.standing is not None:
        return RunResult(plan.standing, plan.standing.report(), "up to date")
    started = now()
    with Commit() as commit, RunWriter(out, experiment.name, displace=force or retry_failed) as writer:
        try:
            resolved, provenance = experiment.resolved(), environment()
            about = {
                "topcli.config": json.dumps(resolved),
                "topcli.digest": experiment.digest,
                "topcli.environment": json.dumps(provenance),
            }
            report, initial = _carry_out(experiment, writer, about, progress, stop, threads)
            writer.write("report.json", json.dumps(report, indent=1, ensure_ascii=False) + "\n")
            writer.write("report.md", ensemble_markdown(report))
            writer.write("config.yaml", experiment.to_yaml())
            path, table = _tables(experiment, writer.folder)
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
                    "initial_states_sha256": initial,
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
            raise writer.failure(error) from error
    return RunResult(stored, report, "ran", writer.set_aside)
