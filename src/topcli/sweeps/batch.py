"""Batches of finished runs that differ only in their initial states: recorded data and measures.

Runs record only the data that the measures need. The results of a run do not depend on the other runs in its batch, so
that a run in a batch has the bits of a single run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.lyapunov import Growth, growth_of
from topcli.analysis.order import PROBES as PROBE_STATES
from topcli.analysis.order import probe_rows
from topcli.analysis.tally import BLOCKS, Tally
from topcli.config.models import Experiment
from topcli.contracts import Array, Outcome, StopAsked, check_stop
from topcli.engine.collect import Memory
from topcli.engine.consumer import Consumer
from topcli.engine.drive import drive
from topcli.engine.endings import Endings
from topcli.engine.loops import state_after
from topcli.engine.machine import SIDE_BY_SIDE, machine_of
from topcli.engine.plan import Plan
from topcli.errors import TopcliError, UsageError
from topcli.runs.references import Errors, reference_of
from topcli.schemes.plugins import users_error
from topcli.sweeps.measures import DEVIATION, DRIFT, ERROR, FINAL_ERROR, PROBES, RECORDED, STATES, Measure, integrals_of

OnFault = Callable[[int, str, str], None]
"""Called with the number of a run in its batch, the name of a measure and the reason why it has no value."""
WHOLE = (Outcome.COMPLETED, Outcome.LEFT_MOTION)
"""Outcomes of runs that took all their steps."""
BATCH_BYTES, MAX_RUN_BYTES, MAX_RUNS = 1 << 26, 1 << 31, 4096
"""Memory of the records of a batch and of one run, and most runs of a batch."""


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
    probes : ndarray, shape (runs, k, d)
        For each run, k recorded states (at most 16) that are evenly spread along the run.
    deviations, drifts : mapping of str to ndarray, shape (runs,)
        ``deviations`` contains the largest deviation of each invariant from its first value. ``drifts`` contains the
        slope of a line fitted to each invariant, per unit time. The keys are the names of the invariants.
    max_error, final_error : ndarray, shape (runs,)
        Euclidean distances from the reference solution. ``max_error`` is the largest distance over the recorded states,
        and ``final_error`` is the distance at step N.
    faults : mapping of int to str
        Reasons why the errors of a run could not be computed, by its number.
    one_step : callable
        ``one_step(states, h)`` takes k states, shape (k, d), and returns the states after one step of ``h`` in an array
        of the same shape. A state is nan if its step fails.
    """

    experiment: Experiment
    n: NDArray[np.int64]
    initial: Array
    last: Array
    endings: Endings
    seconds: Array
    columns: Mapping[str, Array]
    states: Array
    probes: Array
    deviations: Mapping[str, Array]
    drifts: Mapping[str, Array]
    max_error: Array
    final_error: Array
    faults: Mapping[int, str]
    one_step: Callable[[Array, float], Array]

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

    @property
    def whole(self) -> NDArray[np.bool_]:
        """True for each run that took all its steps."""
        return self.endings.is_(*WHOLE)

    def of(self, which: NDArray[np.int64]) -> Batch:
        """Batch of the runs numbered ``which`` (k,) alone."""

        def cut(arrays: Mapping[str, Array]) -> dict[str, Array]:
            return {name: array[which] for name, array in arrays.items()}

        each = ("initial", "last", "seconds", "states", "probes", "max_error", "final_error")
        return replace(
            self,
            endings=self.endings.of(which),
            columns=cut(self.columns),
            deviations=cut(self.deviations),
            drifts=cut(self.drifts),
            faults={new: self.faults[i] for new, i in enumerate(which.tolist()) if i in self.faults},
            **{name: getattr(self, name)[which] for name in each},
        )


class Measuring:
    """Runs of ``experiment``, whose initial state is ignored, with the records that ``measures`` need.

    ``threads`` is their number, by default one for each CPU. Errors are distances from the reference that
    ``reference_of`` chooses. Raises UsageError for a run whose records do not fit in memory.
    """

    def __init__(self, experiment: Experiment, measures: Sequence[Measure], threads: int | None = None) -> None:
        self.experiment, self.measures, self._threads = experiment, tuple(measures), threads
        self._needs = needs = {need for measure in measures for need in measure.needs}
        self._deviations, self._drifts = (
            sorted(need.removeprefix(f"{what}.") for need in needs if need.startswith(f"{what}."))
            for what in (DEVIATION, DRIFT)
        )
        named = [need for need in needs if need.partition(".")[0] in (DEVIATION, DRIFT)]
        self._columns = sorted(needs - set(RECORDED) - set(named))
        top, scheme, h = experiment.top, experiment.scheme, experiment.h
        self._plan = Plan(
            top,
            machine_of(top, scheme, experiment.options),
            np.empty((0, len(top.components))),
            h,
            experiment.N,
            experiment.output.every,
            invariants=integrals_of(top, scheme, h, experiment.options),
            quantities=experiment.quantities,
        )
        self._reference = reference_of(top, judged=scheme)
        bytes_per_run = self._bytes()
        self.size = max(1, min(MAX_RUNS, BATCH_BYTES // bytes_per_run))
        """Number of runs whose records fit into memory."""

    def _bytes(self) -> int:
        """Memory that the records of a run take, references included. Raises UsageError for too many."""
        needs, d, every = self._needs, len(self.experiment.top.components), self.experiment.output.every
        rows = self.experiment.N // every + 1
        numbers = 1 + len(self._columns) + d * bool({STATES, PROBES} & needs) + (d + 1) * (ERROR in needs)
        size = 8 * (rows * numbers + d * PROBE_STATES + 4 * BLOCKS * len(self._drifts))
        if size > MAX_RUN_BYTES:
            names = ", ".join(measure.name for measure in self.measures)
            raise UsageError(
                f"output.every: {rows} recorded rows do not fit in memory for {names}; "
                f"record fewer with output.every: {every * math.ceil(size / MAX_RUN_BYTES)} or more"
            )
        return size

    def finished(self, initial: Array, stop: Callable[[], bool] = lambda: False) -> Batch:
        """Batch of the runs from ``initial`` (runs, d); those that ``stop()`` cuts short are interrupted."""
        plan, needs = replace(self._plan, states=np.ascontiguousarray(initial, dtype=np.float64)), self._needs
        tally = Tally(sorted({*self._deviations, *self._drifts}), drifts=bool(self._drifts))
        columns, states, errors = Memory(self._columns), Memory(), Errors(self._reference, ERROR in needs)
        consumers: list[Consumer] = [columns]
        consumers += [tally] if self._deviations or self._drifts else []
        consumers += [states] if {STATES, PROBES} & needs else []
        consumers += [errors] if {ERROR, FINAL_ERROR} & needs else []
        run = drive(plan, consumers, stop=stop, threads=self._threads)

        none, rows = np.full(len(plan.states), np.nan), states.states if states in consumers else None
        empty = np.empty((len(plan.states), 0, plan.states.shape[1]))
        tallied, compared = tally in consumers, errors in consumers
        index = {name: i for i, name in enumerate(tally.names)} if tallied else {}
        slopes = tally.slopes() if self._drifts else none
        return Batch(
            experiment=self.experiment,
            n=columns.n,
            initial=plan.states,
            last=run.last,
            endings=run.endings,
            seconds=np.full(len(none), float(run.seconds.sum()) / len(none)),
            columns=columns.columns,
            states=rows if rows is not None and STATES in needs else empty,
            probes=rows[:, probe_rows(len(columns.n))] if rows is not None and PROBES in needs else empty,
            deviations={name: tally.max_deviation[index[name]] for name in self._deviations},
            drifts={name: slopes[index[name]] for name in self._drifts},
            max_error=np.where(run.endings.is_(*WHOLE), errors.largest, np.nan) if compared else none,
            final_error=errors.final if compared else none,
            faults=errors.faults if compared else {},
            one_step=lambda states, h: self._one_step(states, h, len(initial)),
        )

    def _one_step(self, states: Array, h: float, count: int) -> Array:
        """States (k, d) after one step of ``h`` from ``states`` (k, d) of ``count`` runs; nan where the step fails."""
        after, usable = np.full_like(states, np.nan), np.flatnonzero(np.isfinite(states).all(axis=1))
        machine = self._plan.machine
        assert machine is not None
        if count < SIDE_BY_SIDE:  # no machine code for lanes is needed otherwise
            for i in usable:
                end = state_after(machine.loop, states[i], machine.p, h)
                after[i] = np.nan if end is None else end
        elif len(usable):
            step = drive(Plan(self._plan.top, machine, states[usable], h, 1), threads=self._threads)
            stepped = step.last_n == 1
            after[usable[stepped]] = step.last[stepped]
        check_stop()
        return after


def _ignore(run: int, name: str, reason: str) -> None:
    """Leave a missing value unexplained."""


def evaluate(measures: Sequence[Measure], batch: Batch, on_fault: OnFault = _ignore) -> dict[str, Array]:
    """Return the values (runs,) of ``measures`` for a batch of finished runs, by name.

    Parameters
    ----------
    measures : sequence of Measure
        Measures, as ``resolve_measures`` returns them, for which the batch has been recorded.
    batch : Batch
        Finished runs, which may have failed.
    on_fault : callable, optional
        ``on_fault(run, name, reason)`` is called for every value that could not be computed although the run took all
        its steps.

    Returns
    -------
    dict of str to ndarray of float, shape (runs,)
        nan for a run that failed, unless the measure is declared ``of_failed``, and where ``on_fault`` was called.
    """
    everything = np.arange(len(batch))
    whole = np.flatnonzero(batch.whole)
    complete = batch if len(whole) == len(batch) else batch.of(whole)
    columns = {}
    for measure in measures:
        name = measure.name
        which, rows = (everything, batch) if measure.of_failed else (whole, complete)
        columns[name] = np.full(len(batch), np.nan)
        if len(which):
            columns[name][which] = _values(
                measure, rows, lambda i, reason, name=name, which=which: on_fault(int(which[i]), name, reason)
            )
        for i in set(whole.tolist()) & set(batch.faults) if {ERROR, FINAL_ERROR} & set(measure.needs) else ():
            columns[name][i] = np.nan
            on_fault(i, name, batch.faults[i])
    return columns


def _values(measure: Measure, batch: Batch, on_fault: Callable[[int, str], None]) -> Array:
    """Values of a measure; if it fails, run by run, so that only the runs that make it fail have none."""
    check_stop()
    try:
        return _checked(measure, measure.evaluate(batch), len(batch))
    except StopAsked:
        raise
    except Exception as error:
        if len(batch) > 1:
            return np.concatenate(
                [
                    _values(measure, batch.of(np.array([i])), lambda _, reason, i=i: on_fault(i, reason))
                    for i in range(len(batch))
                ]
            )
        known = error if isinstance(error, TopcliError) else users_error(error)
        if known is None:
            raise
        on_fault(0, str(known))
        return np.full(1, np.nan)


def _checked(measure: Measure, values: Any, count: int) -> Array:
    """``values`` of a measure as an array (count,). Raises UsageError for anything else."""
    try:
        made = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        made = np.empty(0)
    if made.shape != (count,):
        raise UsageError(f"measure {measure.name!r}: its function must return an array of one number for each run")
    return made
