"""Runs in another precision than double, with invariants and deviations in that precision."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.algebraic_growth import DigitGrowth, digit_growth
from topcli.analysis.columns import columns
from topcli.analysis.tally import InvariantRow, InvariantTally
from topcli.analysis.trajectory import Trajectory
from topcli.config.models import Experiment
from topcli.contracts import Array, Invariant
from topcli.engine.precise import PreciseRun, longest, prepared
from topcli.engine.precise_numbers import RATIONAL, NotRationalError
from topcli.engine.run import Run
from topcli.runs.recorder import Recorder


def precise_run(experiment: Experiment) -> PreciseRun | None:
    """Prepare the run of an experiment in its precision; None if that is double.

    Raises UsageError, naming the scheme and the reason, if the scheme has no such precision.
    """
    written = experiment.written
    if written is None:
        return None
    numbers = (written.h, written.parameters, written.y0)
    return prepared(
        experiment.scheme, experiment.top, experiment.options, experiment.precision, numbers, experiment.max_digits
    )


class PreciseTally:
    """Report on the invariants of a run in another precision."""

    def __init__(self, experiment: Experiment, run: PreciseRun) -> None:
        self._run, self._rational = run, experiment.precision == RATIONAL
        scheme, options = experiment.scheme, experiment.options
        with run.arithmetic.active():
            modified = scheme.modified(run.top, run.h, options) if scheme.modified else ()
            self._invariants: tuple[Invariant, ...] = (*run.top.invariants(), *modified)
        first = self.values(run.y0[None, :])
        self._firsts = {name: values[0] for name, values in first.items()}
        origins = {name: _double(value) for name, value in self._firsts.items()}
        in_doubles = (*experiment.top.invariants(), *experiment.modified)
        self.tally = InvariantTally(in_doubles, experiment.h, experiment.top)
        self._origins = origins
        self._unequal = dict.fromkeys(origins, 0)
        self._count = 0
        self._growth: list[tuple[int, int]] = []

    def values(self, states: NDArray[Any]) -> dict[str, list[Any]]:
        """Values of the invariants at ``states`` (m, d) in this precision; None where one does not exist."""
        with self._run.arithmetic.active():
            values = {invariant.name: self.rows_of(invariant.value, states) for invariant in self._invariants}
        return self.exact(values)

    def rows_of(self, function: Callable[..., Any], *columns: NDArray[Any]) -> list[Any]:
        """Values of a function at the rows of its arguments; None where it has no finite value."""
        try:
            return [x if self._run.arithmetic.finite(x) else None for x in function(*columns)]
        except ZeroDivisionError:
            rows = range(len(columns[0]))
            if len(rows) == 1:
                return [None]
            return [x for i in rows for x in self.rows_of(function, *(each[i : i + 1] for each in columns))]

    def exact(self, values: dict[str, list[Any]]) -> dict[str, list[Any]]:
        """The same values. Raises NotRationalError for those that rational numbers do not have."""
        for name, at_rows in values.items() if self._rational else ():
            if any(isinstance(x, float) for x in at_rows):
                raise NotRationalError(f"precision: {name!r} has no rational values; leave it out or choose another")
        return values

    def add(self, n: NDArray[np.int64], states: NDArray[Any]) -> dict[str, list[Any]]:
        """Add rows: step numbers (m,) and states (m, d); return the values of the invariants."""
        values = self.values(states)
        deviations: dict[str, Array] = {}
        for name, at_rows in values.items():
            first = self._firsts[name]
            with self._run.arithmetic.active():
                off = [None if x is None or first is None else x - first for x in at_rows]
            deviations[name] = np.array([_double(x) for x in off])
            self._unequal[name] += sum(x is None or x != 0 for x in off)
        self._count += len(n)
        if self._rational:
            self._growth += [(int(step), longest(state)) for step, state in zip(n, states, strict=True)]
        self.tally.add(n, states.astype(np.float64), deviations)
        return values

    def report(self) -> list[InvariantRow]:
        """Report with one row for each invariant; equality in rational numbers is stated as such."""
        rows = self.tally.report(eps=self._run.arithmetic.eps, origins=self._origins)
        if not self._rational:
            return rows
        equal = f"equal at all {self._count} rows"
        return [replace(row, reason=equal) if not self._unequal[row.name] else row for row in rows]

    @property
    def growth(self) -> DigitGrowth | None:
        """Growth of the numbers; None unless they are rational."""
        steps = np.array(self._growth, dtype=np.int64).reshape(-1, 2)
        return digit_growth(steps[:, 0], steps[:, 1])

    @property
    def left_step(self) -> int | None:
        """First recorded step at which the energy was beyond its limit; None for never."""
        return self.tally.left_step


def _double(value: Any) -> float:
    return math.nan if value is None else float(value)


class PreciseRecorder(Recorder):
    """Recorder of a run in another precision: its rows are rounded once, after the invariants have been evaluated."""

    def __init__(self, experiment: Experiment, run: PreciseRun, path: Path, metadata: Mapping[str, str]) -> None:
        self._run = run
        self.precise = PreciseTally(experiment, run)
        super().__init__(experiment, path, metadata)

    def new_tally(self) -> Any:
        """Tally of the report."""
        return self.precise

    @property
    def growth(self) -> DigitGrowth | None:
        """Growth of the numbers; None unless they are rational."""
        return self.precise.growth

    def evaluated(self, n: NDArray[np.int64], states: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Add rows to the tally; return their columns."""
        values = self.precise.add(n, states)
        with self._run.arithmetic.active():
            observed = {
                q.name: self.precise.rows_of(lambda n, y, q=q: q.values(self._run.top, n, self._run.h, y), n, states)
                for q in self._quantities
            }
        values = {**values, **self.precise.exact(observed)}
        doubles = {name: np.array([_double(x) for x in at_rows]) for name, at_rows in values.items()}
        top, h = self._experiment.top, self._experiment.h
        self.quantities.add({name: doubles[name] for name in observed})
        return columns(top, n, h, states.astype(np.float64), self._names, self._modified, doubles)


def precise_trajectory(experiment: Experiment, run: PreciseRun) -> Trajectory:
    """Run an experiment in memory; the states are rounded to doubles, the report is computed in its precision."""
    loop = Run(run.top, run.loop, run.y0, run.h, experiment.N, experiment.output.every)
    n, states, ending = loop.collect()
    tally = PreciseTally(experiment, run)
    tally.add(n, states)
    ending = ending.with_left(tally.left_step, loop.h)
    doubles, rows = states.astype(np.float64), tuple(tally.report())
    return Trajectory(
        experiment.top,
        experiment.scheme.name,
        loop.h,
        n,
        doubles,
        ending,
        loop.compile_seconds,
        loop.run_seconds,
        experiment.modified,
        rows,
        quantities=experiment.quantities,
    )
