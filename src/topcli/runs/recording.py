"""The consumers and tables of an experiment that is run into a folder, and the report on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.crossings import SectionRows
from topcli.analysis.tally import Tally, summary, trajectory_columns
from topcli.config.models import Experiment
from topcli.contracts import Outcome
from topcli.engine.consumers import Consumer, State
from topcli.engine.endings import ARRAYS, Endings
from topcli.engine.integration import Integration
from topcli.engine.rows import Plan, Rows
from topcli.runs.plans import search_of
from topcli.runs.report import quantity_rows, report_of_ensemble, report_of_run
from topcli.store.growing_table import GrowingTable

_Columns = dict[str, NDArray[Any]]


class _TableRows(Consumer):
    """The columns ``names`` of some rows go into a ``table``."""

    def __init__(self, table: GrowingTable, names: Sequence[str]) -> None:
        self.table, self.names = table, names

    def _columns(self, rows: Rows) -> _Columns:
        """Columns of the rows that were reached."""
        return {name: np.array(values) for name, values in rows.columns(self.names).items()}

    def state(self) -> State:
        """Parts of the table, after writing all rows."""
        return dict(self.table.commit())

    def restore(self, state: State) -> None:
        """Continue from a ``state()``, with the rows that it has; after the first plan, they are there already."""
        self.table.restore(state)


class Series(_TableRows):
    """The columns ``names`` of all rows go into a ``table``."""

    def add(self, rows: Rows) -> _Columns:
        """Columns of the rows that were reached."""
        return self._columns(rows)

    def take(self, result: _Columns) -> None:
        """Append the columns to the table."""
        self.table.add(result)


class LastRows(_TableRows):
    """The columns ``names`` of the last row of each trajectory go into a ``table``."""

    def end(self, run: Integration) -> None:
        """Write the last rows of the trajectories that were begun."""
        begun = np.repeat(run.done >= 0, run.size)[: len(run.last)]
        which = run.plan.first + np.flatnonzero(begun)
        rows = Rows(run.plan, run.last_n[begun], run.last[None, begun], columns={"trajectory": which[None]})
        self.table.add(self._columns(rows))


class Members(Consumer):
    """One row for each trajectory of an ensemble goes into a ``table``; the endings of all of them are in memory.

    Of the ``judged`` trajectories, ``within`` (invariants,) conserve each invariant to round-off. ``columns`` are the
    figures of all trajectories by name.
    """

    def __init__(self, table: GrowingTable, tally: Tally, section: SectionRows | None, varied: Sequence[str]) -> None:
        self._table, self._tally, self._section, self._varied = table, tally, section, varied
        self._endings: list[Endings] = []
        self._figures: list[_Columns] = []
        self.within, self.judged = np.zeros(1, dtype=np.int64), 0

    @property
    def endings(self) -> Endings:
        """Endings of the trajectories of all plans so far."""
        return Endings.joined(self._endings)

    @property
    def figures(self) -> _Columns:
        """Figures of invariants and quantities by name, of the trajectories of all plans so far."""
        return {name: np.concatenate([part[name] for part in self._figures]) for name in self._figures[0]}

    def end(self, run: Integration) -> None:
        """Write the rows of a plan: parameters, initial states, outcomes, figures of invariants and quantities."""
        tally = self._tally
        columns = trajectory_columns(tally, run.endings, self._varied)
        if self._section:
            columns |= self._section.quantities.quantities()
        self._table.add(columns)
        self._endings.append(run.endings)
        self._figures.append({name: values for name, values in columns.items() if "." in name})
        self.within = self.within + tally.within_round_off.sum(axis=1)
        self.judged += int((tally.steps > 0).sum())

    def state(self) -> State:
        """Endings and figures of the trajectories of earlier plans, and the parts of the table."""
        state: State = {"within": self.within, "judged": np.array(self.judged), **self._table.commit()}
        if self._endings:
            state |= {f"ending.{name}": getattr(self.endings, name) for name in ARRAYS}
            state |= {f"figure.{name}": values for name, values in self.figures.items()}
        return state

    def restore(self, state: State) -> None:
        """Continue from a ``state()``."""
        self.within, self.judged = np.array(state["within"]), int(state["judged"])
        self._table.restore(state)
        figures = {key.removeprefix("figure."): state[key] for key in state if key.startswith("figure.")}
        if figures:
            plan = self._tally.plan
            counters = plan.machine.counters if plan.machine else ()
            endings = Endings.of_none(0, plan.h, counters)
            self._endings = [replace(endings, **{name: np.array(state[f"ending.{name}"]) for name in ARRAYS})]
            self._figures = [figures]


class Recording:
    """The ``consumers`` that record an experiment into tables in a folder, and the report on what they recorded."""

    def __init__(self, experiment: Experiment, folder: Path, metadata: dict[str, str]) -> None:
        self.experiment, ensemble = experiment, experiment.ensemble
        self.seconds: dict[str, Any] = {"compile": 0.0, "compile_cached": True, "run": 0.0}
        self.tables: list[GrowingTable] = []
        self._folder, self._metadata = folder, metadata
        store = ensemble.store if ensemble else "trajectories"
        names = None
        if experiment.crossings:
            names = [invariant.name for invariant in (*experiment.top.invariants(), *experiment.modified)]
        self._tally, self._section, self._members = Tally(names, judged=not ensemble), None, None
        self.consumers: list[Consumer] = [self._tally]
        self._columns = [*(["trajectory"] if ensemble else []), *experiment.recorded]
        if store != "statistics":
            rows = (LastRows if store == "final" else Series)(self._table("series"), self._columns)
            if experiment.crossings and store == "trajectories":
                rows = self._section = SectionRows(lambda plan: search_of(experiment, plan), rows)
            self.consumers.append(rows)
        if ensemble:
            tops = ensemble.tops
            varied = [name for name in type(tops[0]).model_fields if len({getattr(top, name) for top in tops}) > 1]
            self._members = Members(self._table("trajectories"), self._tally, self._section, varied)
            self.consumers.append(self._members)

    def _table(self, name: str) -> GrowingTable:
        self.tables.append(GrowingTable(self._folder, name, self._metadata, self.experiment.output.format))
        return self.tables[-1]

    def add_seconds(self, run: Integration) -> None:
        """Add the times of a plan; those of an ensemble share their code."""
        times, seconds = run.times, self.seconds
        seconds["compile"] = max(seconds["compile"], times["compile"])
        seconds["compile_cached"] &= times["compile_cached"]
        seconds["run"] += times["run"]

    def report(self, plan: Plan, endings: Endings, digest: str) -> dict[str, Any]:
        """Content of ``report.json``; ``plan`` is the last one, and the ``endings`` are those of its trajectories."""
        counts = None if self._section is None else self._section.counts
        if self._members is None:
            tally = self._section.quantities if self._section else self._tally
            quantities = quantity_rows(self.experiment.quantities, tally.quantities(), counts)
            further = {"precision": self.experiment.precision}
            further = further | {"library": plan.precise.arithmetic.library} if plan.precise else {}
            rows = self._tally.report()
            return report_of_run(self.experiment, digest, endings[0], rows, self.seconds, quantities, counts, further)
        members = self._members
        rows = summary(plan, members.figures, members.within, members.judged)
        quantities = quantity_rows(self.experiment.quantities, members.figures, counts)
        return report_of_ensemble(self.experiment, digest, members.endings, rows, self.seconds, quantities, counts)

    def finish(self, outcome: Outcome, message: str, more: dict[str, str]) -> list[Path]:
        """Complete the tables, and return their files."""
        ended = {"topcli.outcome": outcome.value, "topcli.message": message, **more}
        return [table.finish(self._columns if table.name == "series" else (), ended) for table in self.tables]
