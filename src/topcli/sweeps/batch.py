"""Batches of finished runs that differ only in their initial states: recorded data and measures.

Runs record only the data that the measures need. The results of a run do not depend on the other runs in its batch, so
that a run in a batch has the bits of a single run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.lyapunov import Growth, growth_of
from topcli.analysis.swings import swing_times
from topcli.analysis.tally import BLOCKS, Tally
from topcli.config.models import Experiment
from topcli.contracts import Array, Outcome, StopAsked, check_stop
from topcli.engine.consumers import Consumer, Memory
from topcli.engine.drive import drive
from topcli.engine.endings import Endings
from topcli.engine.machine import Machine, machine_of
from topcli.engine.rows import Plan
from topcli.errors import TopcliError, UsageError, quoted
from topcli.plugins import users_error
from topcli.runs.plans import plan_of
from topcli.runs.references import Errors, reference_of
from topcli.sweeps.measures import ERROR, FINAL_ERROR, RECORDED, STATES, Measure, is_figure

WHOLE = (Outcome.COMPLETED, Outcome.LEFT_MOTION)
"""Outcomes of runs that took all their steps."""
BATCH_BYTES, MAX_RUNS = 1 << 26, 4096
"""Memory of the records of a batch, and most runs of it."""


@dataclass(frozen=True)
class Batch:
    """Finished runs of one experiment from several initial states, passed to the function of a measure.

    ``len(batch)`` is the number of runs. Attributes that no measure of the sweep needs are empty.

    Attributes
    ----------
    experiment : Experiment
        Top, scheme, options, step size and output, which are the same for all runs.
    n : ndarray of int64, shape (m,)
        Step numbers of the recorded states.
    initial, last : ndarray, shape (runs, d)
        States at step 0 and at step N.
    endings : Endings
        Outcome, last step and counters of each run.
    seconds : ndarray, shape (runs,)
        Wall time of the steps, divided equally among the runs of the batch.
    columns : mapping of str to ndarray, shape (runs, m)
        Recorded columns by name. Values after the end of a failed run are nan.
    states : ndarray, shape (runs, m, d)
        Recorded states. Values after the end of a failed run are nan.
    figures : mapping of str to ndarray, shape (runs,)
        Figures of invariants, such as ``max_deviation.energy`` and ``drift.energy``.
    max_error, final_error : ndarray, shape (runs,)
        Euclidean distances from the reference solution. ``max_error`` is the largest distance over the recorded states,
        and ``final_error`` is the distance at step N.
    faults : mapping of int to str
        Reasons why the errors of a run could not be computed, by its number.
    plan : Plan
        Top and machine code of the runs.
    """

    experiment: Experiment
    n: NDArray[np.int64]
    initial: Array
    last: Array
    endings: Endings
    seconds: Array
    columns: Mapping[str, Array]
    states: Array
    figures: Mapping[str, Array]
    max_error: Array
    final_error: Array
    faults: Mapping[int, str]
    plan: Plan

    def __len__(self) -> int:
        return len(self.initial)

    @cached_property
    def t(self) -> Array:
        """Times ``n * h`` of the recorded rows, shape (m,)."""
        return self.n * self.experiment.h

    @cached_property
    def growth(self) -> Growth:
        """Growth of a tangent vector along each run; the runs are computed once more for it."""
        experiment = self.experiment
        return growth_of(
            experiment.top, experiment.scheme, experiment.method(), experiment.h, experiment.N, self.initial
        )

    @cached_property
    def swings(self) -> list[Array]:
        """Times of the swings of each run. Raises UsageError if the rows are too few to show them."""
        return [swing_times(self.experiment.top, self.t, states) for states in self.states]

    def one_step(self, states: Array, h: float) -> Array:
        """Return the states after one step of ``h`` from each of ``states``, shape (k, d); nan where the step fails."""
        after, usable = np.full_like(states, np.nan), np.flatnonzero(np.isfinite(states).all(axis=1))
        if len(usable):
            step = drive(Plan(self.plan.top, self.plan.machine, states[usable], h, 1), threads=1)
            stepped = step.last_n == 1
            after[usable[stepped]] = step.last[stepped]
        check_stop()
        return after

    @property
    def whole(self) -> NDArray[np.bool_]:
        """True for each run that took all its steps."""
        return self.endings.is_(*WHOLE)

    def of(self, which: NDArray[np.int64]) -> Batch:
        """Batch of the runs numbered ``which`` (k,) alone."""
        parts: dict[str, Any] = {"endings": self.endings.of(which)}
        for name in ("initial", "last", "seconds", "states", "max_error", "final_error"):
            parts[name] = getattr(self, name)[which]
        for name in ("columns", "figures"):
            parts[name] = {key: array[which] for key, array in getattr(self, name).items()}
        parts["faults"] = {new: self.faults[i] for new, i in enumerate(which.tolist()) if i in self.faults}
        return replace(self, **parts)


class Measuring:
    """Runs of ``experiment``, whose initial state is ignored, with the records that ``measures`` need.

    Errors are distances from the reference that ``reference_of`` chooses. ``machine`` is the code for the same top,
    scheme and options, if it is there already.
    """

    def __init__(self, experiment: Experiment, measures: Sequence[Measure], machine: Machine | None = None) -> None:
        self.experiment, self.measures = experiment, tuple(measures)
        d, rows = len(experiment.top.components), experiment.N // experiment.output.every + 1
        self.machine = machine or machine_of(experiment.top, experiment.scheme, experiment.options)
        self._plan = plan_of(experiment, np.empty((0, d)), self.machine)
        self._reference = reference_of(experiment.top, judged=experiment.scheme)
        self._needs = needs = {need for measure in measures for need in measure.needs}
        figures = {need.partition(".") for need in needs if is_figure(need)}
        self._invariants = sorted({name for _, _, name in figures})
        self._drifts = any(figure == "drift" for figure, _, _ in figures)
        self._columns = sorted(need for need in needs if not is_figure(need) and need not in RECORDED)
        numbers = 1 + len(self._columns) + d * (STATES in needs) + (d + 1) * (ERROR in needs)
        per_run = 8 * (rows * numbers + 4 * BLOCKS * len(self._invariants))
        self.size = max(1, min(MAX_RUNS, BATCH_BYTES // per_run))
        """Number of runs whose records, references included, fit into memory."""

    def finished(self, initial: Array) -> Batch:
        """Batch of the runs from ``initial`` (runs, d); those that a request to stop cuts short are interrupted."""
        plan, needs = replace(self._plan, states=np.ascontiguousarray(initial, dtype=np.float64)), self._needs
        # only what the measures need is recorded
        columns, tally = Memory(self._columns), Tally(self._invariants, drifts=self._drifts)
        memory, errors = Memory(), Errors(self._reference, ERROR in needs)
        optional = {
            tally: bool(self._invariants),
            memory: STATES in needs,
            errors: bool({ERROR, FINAL_ERROR} & needs),
        }
        consumers: list[Consumer] = [columns, *(consumer for consumer, needed in optional.items() if needed)]
        run = drive(plan, consumers, threads=1)

        count, d = plan.states.shape
        none, states = np.full(count, np.nan), memory.states if optional[memory] else np.empty((count, 0, d))
        largest = np.where(run.endings.is_(*WHOLE), errors.largest, np.nan) if optional[errors] else none
        return Batch(
            experiment=self.experiment,
            n=columns.n,
            initial=plan.states,
            last=run.last,
            endings=run.endings,
            seconds=np.full(count, float(run.seconds.sum()) / count),
            columns=columns.columns,
            states=states,
            figures=tally.columns() if optional[tally] else {},
            max_error=largest,
            final_error=errors.final if optional[errors] else none,
            faults=errors.faults if optional[errors] else {},
            plan=plan,
        )


Faults = dict[int, str]
"""Reasons why runs have no value, by their numbers."""


def evaluate(measures: Sequence[Measure], batch: Batch) -> tuple[dict[str, Array], list[tuple[int, str, str]]]:
    """Return the values (runs,) of ``measures`` for a batch of finished runs, by name.

    Parameters
    ----------
    measures : sequence of Measure
        Measures, as ``resolve_measures`` returns them, for which the batch has been recorded.
    batch : Batch
        Finished runs, which may have failed.

    Returns
    -------
    values : dict of str to ndarray of float, shape (runs,)
        nan for a run that failed, unless the measure is declared ``of_failed``, and for faults.
    faults : list of tuple
        Run, measure and reason of each value that could not be computed although the run took all its steps.
    """
    everything, whole = np.arange(len(batch)), np.flatnonzero(batch.whole)
    complete, columns, faults = batch if len(whole) == len(batch) else batch.of(whole), {}, []
    for measure in measures:
        which, runs = (everything, batch) if measure.of_failed else (whole, complete)
        columns[measure.name] = column = np.full(len(batch), np.nan)
        column[which], reasons = _values(measure, runs)
        if {ERROR, FINAL_ERROR} & set(measure.needs):
            reasons = {**reasons, **runs.faults}
        for i, reason in reasons.items():
            column[which[i]] = np.nan
            faults.append((int(which[i]), measure.name, reason))
    return columns, faults


def _values(measure: Measure, batch: Batch) -> tuple[Array, Faults]:
    """Values of a measure; if it fails, run by run, so that only the runs that make it fail have none."""
    check_stop()
    if not len(batch):
        return np.empty(0), {}
    try:
        values = measure.evaluate(batch)
        if np.shape(values) != (len(batch),) or np.asarray(values).dtype.kind not in "biuf":
            name = quoted(measure.name)
            raise UsageError(f"measure {name}: its function must return an array of one number for each run")
        return np.asarray(values, dtype=np.float64), {}
    except StopAsked:
        raise
    except Exception as error:
        if len(batch) > 1:
            parts = [_values(measure, batch.of(np.array([i]))) for i in range(len(batch))]
            reasons = {i: reason for i, (_, faults) in enumerate(parts) for reason in faults.values()}
            return np.concatenate([values for values, _ in parts]), reasons
        reported = error if isinstance(error, TopcliError) else users_error(error)
        if reported is None:
            raise
        return np.full(1, np.nan), {0: str(reported)}
