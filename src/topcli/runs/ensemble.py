"""Run of an ensemble into a run folder, block by block: rows, table of trajectories, report."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from typing import Any, Generic, TypeVar

import numpy as np

from topcli.analysis.columns import columns, invariant_values
from topcli.analysis.crossings import Crossings, CrossingSearch
from topcli.analysis.quantities import QuantityTally, quantity_rows
from topcli.analysis.tally import EnsembleSummary, InvariantTally, measure_columns
from topcli.config.ensemble import EnsembleExperiment, Group
from topcli.contracts import Array, Invariant
from topcli.engine.ensemble import BLOCK, EnsembleRun, Execution, Piece, tile_of
from topcli.engine.run import OUTCOMES
from topcli.runs.decision import RunOptions
from topcli.runs.recorder import crossing_columns, tallied_rows
from topcli.runs.recording import Recording
from topcli.runs.report import EndingTally, ensemble_markdown, ensemble_report
from topcli.store.checkpoint import Checkpoint
from topcli.store.series import SeriesWriter

Columns = dict[str, np.ndarray]
Values = Mapping[str, Array]
Kept = TypeVar("Kept")


class GroupRun(Generic[Kept]):
    """One group of an ensemble, run block by block.

    ``keep(group, piece, values)`` is called for every piece of rows with the values of the invariants and quantities
    (rows,), by name, which are evaluated once for it and for the tallies. ``run``, ``tally`` and ``quantities`` are
    those of the latest block.
    """

    def __init__(
        self,
        experiment: EnsembleExperiment,
        group: Group,
        offset: int,
        keep: Callable[[GroupRun[Kept], Piece, Values], Kept],
        stop: Callable[[], bool],
        threads: int | None,
    ) -> None:
        first = experiment.of_group(group)
        self.experiment, self.group, self.offset = experiment, group, offset
        """``offset`` is the number of the block's first trajectory in the ensemble."""
        self._next = offset
        self.modified: tuple[Invariant, ...] = first.modified
        self.invariants = (*group.top.invariants(), *self.modified)
        self._last = first.N // first.tallied * first.tallied
        self.tally = self._tally(0)
        self.quantities = QuantityTally(first.quantities, 0)
        self.names = first.recorded

        self.search: CrossingSearch | None = None
        """Search for the crossings of a section by the trajectories of the block; None without a section."""

        def on_piece(piece: Piece) -> Kept:
            seen = piece if self.search is None else _thinned(piece)
            flat = seen.states.reshape(-1, seen.states.shape[-1])
            values = invariant_values(self.invariants, flat)
            self.tally.add(seen.n, seen.states, values, seen.first, seen.kept)
            if first.quantities and len(seen.n) and self.search is None:
                n = np.tile(seen.n, len(seen.kept))
                values |= {one.name: one.values(group.top, n, first.h, flat) for one in first.quantities}
                self.quantities.add(values, seen.first, seen.kept)
            return keep(self, piece, values)

        self.run = EnsembleRun(
            group.top,
            first.method(),
            np.empty((0, len(group.top.components))),
            first.h,
            first.N,
            first.output.every,
            on_piece=on_piece,
            # where all rows are stored, row groups are tiles
            execution=Execution(stop, threads, tile_of(group.count), wide=experiment.store != "trajectories"),
        )

    def _search_from(self, y0: Array) -> CrossingSearch | None:
        if self.search is not None:
            return self.search.restarted(y0)
        return self.experiment.of_group(self.group).search(y0, self.run.method)

    def _tally(self, count: int) -> InvariantTally:
        return InvariantTally(self.invariants, self.experiment.first.h, self.group.top, count, self._last)

    def block(self, y0: Array) -> Iterator[tuple[Kept, int]]:
        """Run the next trajectories of the group, from ``y0`` (m, d): results of ``keep`` and trajectory-steps done."""
        self.offset, self._next = self._next, self._next + len(y0)
        self.tally = self._tally(len(y0))
        self.quantities = QuantityTally(self.quantities.quantities, len(y0))
        self.search = self._search_from(y0)
        self.run.begin(y0)
        yield from self.run
        self.tally.finish(self.run.last)
        self.run.endings.mark_left(self.tally.left)

    def rows(self, which: np.ndarray, n: np.ndarray, states: np.ndarray, values: Values | None = None) -> Columns:
        """Columns of rows (m,): trajectories by their number in the block, step numbers (m,), states (m, d).

        ``values`` (m,) are those of invariants and quantities by name, if they have been evaluated before.
        """
        table = columns(
            self.group.top,
            n,
            self.experiment.first.h,
            states,
            self.names,
            self.modified,
            values,
            self.experiment.first.quantities,
        )
        return {"trajectory": (which + self.offset).astype(np.int64, copy=False), **table}

    def crossing_rows(self, found: Crossings) -> Columns:
        """Columns of crossings, whose quantities are added to those of the trajectories."""
        one = self.experiment.first.model_copy(update={"top": self.group.top})
        table = crossing_columns(one, found, self.names)
        first, counts = int(found.which[0]), np.bincount(found.which - found.which[0])  # ordered by trajectories
        crossed = np.arange(counts.max()) < counts[:, None]
        values = {quantity.name: np.zeros(crossed.shape) for quantity in self.quantities.quantities}
        for name, of_rows in values.items():
            of_rows[crossed] = table[name]
        self.quantities.add(values, first, counts)
        return {"trajectory": found.which + self.offset, **table}

    def last_rows(self) -> Columns:
        """Row of the last state of each trajectory in the block that has been started."""
        begun = np.flatnonzero(self.tally.rows)
        return self.rows(begun, self.run.last_n[begun], self.run.last[begun])

    def trajectories(self, varied: Sequence[str]) -> Columns:
        """Table of the block's trajectories: ``varied`` parameters, initial states, outcomes, deviations."""
        run, top = self.run, self.group.top
        count = len(run.endings)
        table: Columns = {"trajectory": np.arange(self.offset, self.offset + count, dtype=np.int64)}
        table |= {f"top.{name}": np.full(count, getattr(top, name), dtype=np.float64) for name in varied}
        table |= {f"initial_{name}": run.y0[:, i] for i, name in enumerate(top.components)}
        table["outcome"] = _OUTCOME_NAMES[run.endings.outcome]
        table["n"] = run.endings.step
        table["left_motion"] = run.endings.left
        first = self.experiment.first
        return table | measure_columns(self.tally, first.N, first.tallied) | self.quantities.columns()


def _thinned(piece: Piece) -> Piece:
    """The rows of a piece that the invariant report of a section's run is about."""
    at = tallied_rows(piece.n) if len(piece.n) else slice(None)
    kept = np.searchsorted(np.arange(len(piece.n))[at], piece.kept)
    return Piece(piece.first, piece.n[at], np.ascontiguousarray(piece.states[:, at]), kept)


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
    if group.search is not None:
        found = group.search.add(piece.n, piece.states, piece.first, piece.kept)
        return group.crossing_rows(found) if len(found.n) else None
    reached = np.arange(len(piece.n)) < piece.kept[:, None]
    which, row = np.nonzero(reached)
    of_rows = {name: value[reached.ravel()] for name, value in values.items()}
    return group.rows(piece.first + which, piece.n[row], piece.states[reached], of_rows)


def _no_rows(group: GroupRun[Any], piece: Piece, values: Values) -> Columns | None:
    return None


class EnsembleRecording(Recording):
    """An ensemble on its way into its tables, in memory that does not grow with the number of trajectories.

    ``series.parquet`` has a column ``trajectory`` and the rows selected by ``store``, one row group per block of
    trajectories, or per stretch of a block in a long run. ``trajectories.parquet`` has one row per trajectory; with
    ``store: statistics`` it is the only table. The results do not depend on the threads.
    """

    experiment: EnsembleExperiment

    def record(self, start: Checkpoint | None, options: RunOptions) -> tuple[dict[str, Any], str, dict[str, Any]]:
        """Run into the tables; the report, its Markdown, and entries of the manifest. Raises OSError."""
        experiment, N = self.experiment, self.experiment.first.N
        self._varied = varied_parameters(experiment)
        self._tables: dict[str, SeriesWriter] = {}
        self._observed: list[tuple[Array, int]] = []
        self._endings, self._initial, offset = EndingTally(N), hashlib.sha256(), 0
        self._crossings = None if experiment.first.section is None else np.zeros(experiment.count, dtype=np.int64)
        seconds: dict[str, Any] = {"compile": 0.0, "compile_cached": True, "run": 0.0}
        keep = _all_rows if experiment.store == "trajectories" else _no_rows
        with ExitStack() as self._open:
            if experiment.store != "statistics":
                self._table("series", ["trajectory", *experiment.first.recorded])
            self._summary = EnsembleSummary(self._open.enter_context(tempfile.TemporaryFile(dir=self.writer.folder)))
            for group in experiment.members.groups:
                run = GroupRun(experiment, group, offset, keep, options.stop, options.threads)
                for y0 in group.source.blocks(BLOCK):
                    for done in self._block(run, y0):
                        options.on_progress(run.offset * N + done, N * experiment.count)
                _add_seconds(seconds, run.run)
                offset += group.count
            ended = {"topcli.outcome": self._endings.outcome.value, "topcli.message": self._endings.message}
            files = {name: f"{name}.{experiment.first.output.format}" for name in self._tables}
            for name, table in self._tables.items():
                table.finish(ended)
                self.writer.sha256[files[name]] = table.sha256
            summary = self._summary.rows()
            observed = quantity_rows(experiment.first.quantities, self._observed)
            report = ensemble_report(
                experiment, self.origin.identity.digest, self._endings, summary, seconds, observed, self._crossings
            )
        manifest = {
            "kind": "ensemble",
            "series": files.get("series", files["trajectories"]),
            "trajectories": files["trajectories"],
            "initial_states_sha256": self._initial.hexdigest(),
        }
        return report, ensemble_markdown(report), manifest

    def _table(self, name: str, columns: list[str]) -> SeriesWriter:
        """The table ``name``, which is opened with these columns when it is first needed."""
        if name not in self._tables:
            path = self.writer.folder / f"{name}.{self.experiment.first.output.format}"
            table = SeriesWriter(path, columns, self.origin.metadata())
            self._tables[name] = self._open.enter_context(table)
        return self._tables[name]

    def _block(self, group: GroupRun[Columns | None], y0: Array) -> Iterator[int]:
        """Run a block of trajectories into the tables; yield the trajectory-steps done."""
        series, tile = self._tables.get("series"), -1
        for rows, done in group.block(y0):
            if rows is not None and series is not None:
                begins = int(rows["trajectory"][0] - group.offset) // group.run.tile
                if group.run.side_by_side or begins != tile:
                    series.end_group()
                tile = begins
                if self._crossings is not None:
                    np.add.at(self._crossings, rows["trajectory"], 1)
                series.write(rows)
            yield done
        if self.experiment.store == "final" and series is not None:
            series.write(group.last_rows())
        self._initial.update(np.ascontiguousarray(y0, dtype="<f8").data)
        self._endings.add(group.run.endings)
        self._summary.add(group.tally)
        self._observed.append(group.quantities.together())
        rows = group.trajectories(self._varied)
        self._table("trajectories", list(rows)).write(rows)


def _add_seconds(seconds: dict[str, Any], run: EnsembleRun[Any]) -> None:
    """Add the times of the latest group."""
    seconds["compile"] += run.compile_seconds
    seconds["compile_cached"] &= run.cached
    seconds["run"] += run.run_seconds
    seconds["threads"] = run.threads
