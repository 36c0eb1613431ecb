"""Run an ensemble into a run folder, block by block: the rows, the table of trajectories, the report."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from typing import Any, Generic, TypeVar

import numpy as np

from topcli.analysis.columns import column_names, columns, invariant_values
from topcli.analysis.tally import EnsembleSummary, InvariantTally, measure_columns
from topcli.config.ensemble import EnsembleExperiment, Group
from topcli.contracts import Array, Invariant
from topcli.engine.endings import OUTCOMES
from topcli.engine.ensemble import BLOCK, EnsembleRun, Execution, Piece, tile_of
from topcli.runs.decision import RunOptions
from topcli.runs.report import EndingTally, ensemble_markdown, ensemble_report, setup_message
from topcli.runs.run import Recording
from topcli.store.checkpoint import Checkpoint
from topcli.store.series import SeriesWriter

Columns = dict[str, np.ndarray]
Values = Mapping[str, Array]
Made = TypeVar("Made")


class GroupRun(Generic[Made]):
    """One group of an ensemble, run block by block.

    ``keep(group, piece, values)`` is called for every piece of rows with the values of the invariants (rows,), by name,
    which are evaluated once for it and for ``tally``. ``run`` and ``tally`` are those of the latest block.
    """

    def __init__(
        self,
        experiment: EnsembleExperiment,
        group: Group,
        offset: int,
        keep: Callable[[GroupRun[Made], Piece, Values], Made],
        stop: Callable[[], bool],
        threads: int | None,
    ) -> None:
        one = experiment.of_group(group)
        self.experiment, self.group, self.offset = experiment, group, offset
        """``offset`` is the number of the block's first trajectory in the ensemble."""
        self._next = offset
        self.modified: tuple[Invariant, ...] = one.modified
        self.invariants = (*group.top.invariants(), *self.modified)
        self._last = one.N // one.output.every * one.output.every
        self.tally = self._tally(0)
        self.names = list(one.output.columns or column_names(group.top))

        def made(piece: Piece) -> Made:
            values = invariant_values(self.invariants, piece.states.reshape(-1, piece.states.shape[-1]))
            self.tally.add(piece.n, piece.states, values, piece.first, piece.kept)
            return keep(self, piece, values)

        self.run = EnsembleRun(
            group.top,
            one.method(),
            np.empty((0, len(group.top.components))),
            one.h,
            one.N,
            one.output.every,
            made=made,
            # where all rows are stored, row groups are tiles
            execution=Execution(stop, threads, tile_of(group.count), wide=experiment.store != "trajectories"),
        )

    def _tally(self, count: int) -> InvariantTally:
        return InvariantTally(self.invariants, self.experiment.first.h, self.group.top, count, self._last)

    def block(self, y0: Array) -> Iterator[tuple[Made, int]]:
        """Run the next trajectories of the group, from ``y0`` (m, d): results of ``keep`` and trajectory-steps done."""
        self.offset, self._next = self._next, self._next + len(y0)
        self.tally = self._tally(len(y0))
        self.run.begin(y0)
        yield from self.run
        self.tally.finish(self.run.last)
        self.run.endings.mark_left(self.tally.left)

    def rows(self, which: np.ndarray, n: np.ndarray, states: np.ndarray, values: Values | None = None) -> Columns:
        """Columns of rows (m,): trajectories by their number in the block, step numbers (m,), states (m, d).

        ``values`` (m,) are those of the invariants by name, if they have been evaluated before.
        """
        made = columns(self.group.top, n, self.experiment.first.h, states, self.names, self.modified, values)
        return {"trajectory": (which + self.offset).astype(np.int64, copy=False), **made}

    def last_rows(self) -> Columns:
        """Row of the last state of each trajectory in the block that has been started."""
        begun = np.flatnonzero(self.tally.rows)
        return self.rows(begun, self.run.last_n[begun], self.run.last[begun])

    def trajectories(self, varied: Sequence[str]) -> Columns:
        """Table of the block's trajectories: ``varied`` parameters, initial states, outcomes, deviations."""
        run, top = self.run, self.group.top
        count = len(run.endings)
        made: Columns = {"trajectory": np.arange(self.offset, self.offset + count, dtype=np.int64)}
        made |= {f"top.{name}": np.full(count, getattr(top, name), dtype=np.float64) for name in varied}
        made |= {f"initial_{name}": run.y0[:, i] for i, name in enumerate(top.components)}
        made["outcome"] = _OUTCOME_NAMES[run.endings.outcome]
        made["n"] = run.endings.step
        made["left_motion"] = run.endings.left
        one = self.experiment.first
        return made | measure_columns(self.tally, one.N, one.output.every)


_OUTCOME_NAMES = np.array([outcome.value for outcome in OUTCOMES], dtype=object)


def varied_parameters(experiment: EnsembleExperiment) -> list[str]:
    """Parameters of the top that differ between groups."""
    tops = [group.top for group in experiment.members.groups]
    names = type(experiment.top).model_fields
    return [name for name in names if any(getattr(top, name) != getattr(tops[0], name) for top in tops)]


def _all_rows(group: GroupRun[Any], piece: Piece, values: Values) -> Columns | None:
    """Rows of a piece that were reached, trajectory by trajectory; None if there are none."""
    if not piece.kept.any():
        return None
    reached = np.arange(len(piece.n)) < piece.kept[:, None]
    which, row = np.nonzero(reached)
    of_rows = {name: value[reached.ravel()] for name, value in values.items()}
    return group.rows(piece.first + which, piece.n[row], piece.states[reached], of_rows)


def _no_rows(group: GroupRun[Any], piece: Piece, values: Values) -> Columns | None:
    return None


class _Record:
    """Tables and sums of an ensemble that runs, in memory that does not grow with the number of trajectories.

    ``series`` is the table of rows, if rows are stored. ``table_of(names)`` opens the table of trajectories.
    """

    def __init__(
        self,
        experiment: EnsembleExperiment,
        series: SeriesWriter | None,
        table_of: Callable[[list[str]], SeriesWriter],
        spool: Any,
    ) -> None:
        self.experiment, self.series, self._table_of = experiment, series, table_of
        self.trajectories: SeriesWriter | None = None
        self.varied = varied_parameters(experiment)
        self.initial = hashlib.sha256()
        self.endings = EndingTally(experiment.first.N)
        self.summary = EnsembleSummary(spool)
        self.seconds: dict[str, Any] = {"compile": 0.0, "compile_cached": True, "run": 0.0}

    def run(self, options: RunOptions) -> None:
        """Run each group, block by block."""
        N, total = self.experiment.first.N, self.experiment.first.N * self.experiment.count
        keep = _all_rows if self.experiment.store == "trajectories" else _no_rows
        offset = 0
        for group in self.experiment.members.groups:
            one = GroupRun(self.experiment, group, offset, keep, options.stop, options.threads)
            for y0 in group.source.blocks(BLOCK):
                self._write_block(one, y0, lambda done, one=one: options.on_progress(one.offset * N + done, total))
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
        if run.setup is not None:
            self.seconds["setup"] = self.seconds.get("setup", 0.0) + run.setup.seconds
            self.seconds["setup_cached"] = self.seconds.get("setup_cached", True) and run.setup.cached
        self.seconds["run"] += run.run_seconds
        self.seconds["threads"] = run.threads

    def finish(self, digest: str) -> dict[str, Any]:
        """Complete the tables and return the report. Raises OSError."""
        ended = {"topcli.outcome": self.endings.outcome.value, "topcli.message": self.endings.message}
        for table in (self.series, self.trajectories):
            if table is not None:
                table.finish(ended)
        return ensemble_report(self.experiment, digest, self.endings, self.summary.rows(), self.seconds)


class EnsembleRecording(Recording):
    """An ensemble on its way into its tables.

    ``series.parquet`` has a column ``trajectory`` and the rows selected by ``store``, one row group per block of
    trajectories, or per stretch of a block in a long run. ``trajectories.parquet`` has one row per trajectory; with
    ``store: statistics`` it is the only table. The results do not depend on the threads.
    """

    experiment: EnsembleExperiment

    def record(self, start: Checkpoint | None, options: RunOptions) -> tuple[dict[str, Any], str, dict[str, Any]]:
        """Run into the tables; the report, its Markdown, and entries of the manifest. Raises OSError."""
        experiment, writer, metadata = self.experiment, self.writer, self.origin.metadata()
        if message := setup_message(experiment, options.threads):
            options.on_message(f"{experiment.name}: {message}")
        suffix = experiment.first.output.format
        table = writer.folder / f"trajectories.{suffix}"
        path = table if experiment.store == "statistics" else writer.folder / f"series.{suffix}"
        with ExitStack() as stack:
            series = None
            if path != table:
                names = list(experiment.first.output.columns or column_names(experiment.top))
                series = stack.enter_context(SeriesWriter(path, ["trajectory", *names], metadata))

            def table_of(names: list[str]) -> SeriesWriter:
                return stack.enter_context(SeriesWriter(table, names, metadata))

            spool = stack.enter_context(tempfile.TemporaryFile(dir=writer.folder))
            record = _Record(experiment, series, table_of, spool)
            record.run(options)
            report = record.finish(self.origin.identity.digest)
            for name, written in ((path.name, series), (table.name, record.trajectories)):
                if written is not None:
                    writer.sha256[name] = written.sha256
        manifest = {
            "kind": "ensemble",
            "series": path.name,
            "trajectories": table.name,
            "initial_states_sha256": record.initial.hexdigest(),
        }
        return report, ensemble_markdown(report), manifest
