"""Batches of finished runs that differ only in their initial states: recorded data and measures.

Runs record only the data that the measures need. The results of a run do not depend on the other runs in its batch, and
sums over rows do not depend on how the rows are divided into pieces. So a run in a batch has the bits of a single run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.leaving import energy_of
from topcli.analysis.lyapunov import Growth, growth_of
from topcli.analysis.order import PROBES as PROBE_STATES
from topcli.analysis.order import probe_rows
from topcli.analysis.reference import distances
from topcli.analysis.tally import BLOCKS, InvariantTally
from topcli.config.models import Experiment
from topcli.contracts import Array, Outcome, StopAsked, check_stop
from topcli.engine.run import CODES, Endings
from topcli.engine.tile import Piece
from topcli.errors import RunError, TopcliError, UsageError
from topcli.runs.references import REFERENCES, reference_of
from topcli.schemes.plugins import users_error
from topcli.sweeps.measures import DEVIATION, DRIFT, ERROR, FINAL_ERROR, PROBES, RECORDED, STATES, Measure, integrals_of

OnFault = Callable[[int, str, str], None]
"""Called with the number of a run in its batch, the name of a measure and the reason why it has no value."""
WHOLE = (CODES[Outcome.COMPLETED], CODES[Outcome.LEFT_MOTION])
"""Codes of the outcomes of runs that took all their steps."""
MAX_RUN_BYTES = 1 << 31
"""Memory that the records of one run may take."""


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
    faults : mapping of str to sequence of str
        The key ``"error"`` belongs to ``max_error``, and ``"final_error"`` to ``final_error``. The value has a text for
        each run: the reason why this error could not be computed, or an empty text if it was computed.
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
    faults: Mapping[str, Sequence[str]]
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
        completed, left = WHOLE
        return (self.endings.outcome == completed) | (self.endings.outcome == left)

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
            faults={name: [reasons[i] for i in which.tolist()] for name, reasons in self.faults.items()},
            **{name: getattr(self, name)[which] for name in each},
        )


def bytes_per_run(experiment: Experiment, measures: Sequence[Measure]) -> int:
    """Memory that recording one run for ``measures`` takes, references included."""
    needs = {need for measure in measures for need in measure.needs}
    d, rows = len(experiment.top.components), experiment.N // experiment.output.every + 1
    numbers = 1 + len(_columns(needs)) + d * (STATES in needs) + (d + 1) * (ERROR in needs)
    return 8 * (rows * numbers + d * PROBE_STATES + 2 * BLOCKS * len(_named(needs, DRIFT)))


def rows_fault(experiment: Experiment, measures: Sequence[Measure]) -> str:
    """Reason why a run has more rows than its measures can hold in memory; empty if it has not."""
    size = bytes_per_run(experiment, measures)
    if size <= MAX_RUN_BYTES:
        return ""
    rows, every = experiment.N // experiment.output.every + 1, experiment.output.every
    names = ", ".join(measure.name for measure in measures)
    return (
        f"output.every: {rows} recorded rows do not fit in memory for {names}; "
        f"record fewer with output.every: {every * math.ceil(size / MAX_RUN_BYTES)} or more"
    )


class BatchRecorder:
    """Records for ``measures`` of the runs of ``experiment`` from ``initial`` (runs, d), fed with pieces of their rows.

    Pieces of different runs may be added from different threads, those of a run in the order of time. Errors are
    distances from the reference that ``reference_of`` chooses.
    """

    def __init__(
        self,
        experiment: Experiment,
        measures: Sequence[Measure],
        initial: Array,
    ) -> None:
        if fault := rows_fault(experiment, measures):
            raise UsageError(fault)
        self.experiment, self.initial = experiment, initial
        self._reference = reference_of(experiment.top, judged=experiment.scheme)
        top, every = experiment.top, experiment.output.every
        needs = {need for measure in measures for need in measure.needs}
        self._n = np.arange(0, experiment.N + 1, every, dtype=np.int64)
        count, m, d = len(initial), len(self._n), len(top.components)
        self._integrals = {
            integral.name: integral
            for integral in integrals_of(top, experiment.scheme, experiment.h, experiment.options)
        }
        self._summed = {what: _named(needs, what) for what in (DEVIATION, DRIFT)}
        tallied = {name for names in self._summed.values() for name in names}
        energy = energy_of(top)
        watched = tallied | ({energy.name} if energy else set())
        summed = [integral for integral in self._integrals.values() if integral.name in watched]
        last, drifts = int(self._n[-1]), bool(self._summed[DRIFT])
        self._tally = InvariantTally(summed, experiment.h, top, count, last, drifts)
        self._columns = {name: np.full((count, m), np.nan) for name in _columns(needs)}
        self._quantities = {quantity.name: quantity for quantity in experiment.quantities}
        self._states = np.full((count, m if STATES in needs else 0, d), np.nan)
        self._probe_rows = np.arange(m)[probe_rows(m)] if PROBES in needs else np.empty(0, dtype=np.int64)
        self._probes = np.full((count, len(self._probe_rows), d), np.nan)
        self._needs = needs & {ERROR, FINAL_ERROR}
        self.max_error, self.final_error = np.full(count, np.nan), np.full(count, np.nan)
        self._faults = {need: [""] * count for need in self._needs}
        self._references: list[Array | None] = [self._reference_states(ERROR, i, self._n) for i in range(count)]
        if ERROR in needs:
            self.max_error[:] = 0.0

    def _reference_states(self, need: str, i: int, n: NDArray[np.int64]) -> Array | None:
        """Reference of run ``i`` at the steps ``n``; None if it is not needed or, with the fault noted, not known."""
        if need not in self._needs:
            return None
        experiment = self.experiment
        try:
            return REFERENCES.states(self._reference, self.initial[i], experiment.h, n)
        except RunError as error:
            self._faults[need][i] = str(error)
            return None

    def add(self, piece: Piece) -> None:
        """Add a piece of recorded rows."""
        first, n, states, kept = piece.first, piece.n, piece.states, piece.kept
        count, m, d = states.shape
        if not m:
            return
        flat = states.reshape(count * m, d)
        row = int(n[0]) // self.experiment.output.every
        runs, rows = slice(first, first + count), slice(row, row + m)
        with np.errstate(all="ignore"):
            values = {integral.name: integral.value(flat) for integral in self._tally.invariants}
        self._tally.add(n, states, values, first, kept)
        reached = None if (kept == m).all() else np.arange(m) < kept[:, None]
        for name, column in self._columns.items():
            recorded = self._column(name, n, states, flat, values)
            column[runs, rows] = recorded if reached is None else np.where(reached, recorded, np.nan)
        if self._states.size:
            self._states[runs, rows] = states if reached is None else np.where(reached[..., None], states, np.nan)
        if len(self._probe_rows):
            here = (self._probe_rows >= row) & (self._probe_rows < row + m)
            self._probes[runs, here] = states[:, self._probe_rows[here] - row]
        for i, reference in enumerate(self._references[runs]):
            if reference is not None and kept[i]:
                error = distances(states[i, : kept[i]], reference[row : row + kept[i]])
                self.max_error[first + i] = np.maximum(self.max_error[first + i], error.max())

    def _column(
        self, name: str, n: NDArray[np.int64], states: Array, flat: Array, values: Mapping[str, Array]
    ) -> Array:
        """Column (runs, m) of a piece."""
        components = self.experiment.top.components
        if name in components:
            return states[..., components.index(name)]
        if name in values:
            return values[name].reshape(states.shape[:2])
        if name in self._quantities:
            steps, h = np.tile(n, len(states)), self.experiment.h
            return self._quantities[name].values(self.experiment.top, steps, h, flat).reshape(states.shape[:2])
        with np.errstate(all="ignore"):
            return self._integrals[name].value(flat).reshape(states.shape[:2])

    def finish(self, endings: Endings, last: Array, seconds: Array, one_step: Callable[[Array, float], Array]) -> Batch:
        """Return the batch; ``endings`` of runs that left their energy surface get the outcome ``left_motion``."""
        endings.mark_left(self._tally.left)
        experiment = self.experiment
        for i in range(len(self.initial)):
            whole = endings.outcome[i] in WHOLE
            end = self._reference_states(FINAL_ERROR, i, np.array([experiment.N])) if whole else None
            if end is not None:
                self.final_error[i] = distances(last[i], end[0])
            if whole and ERROR in self._needs and self._references[i] is None:
                self.max_error[i] = np.nan
        index = {invariant.name: i for i, invariant in enumerate(self._tally.invariants)}
        slopes = self._tally.slopes(len(self._n), int(self._n[-1]))
        return Batch(
            experiment=experiment,
            n=self._n,
            initial=self.initial,
            last=last,
            endings=endings,
            seconds=seconds,
            columns=self._columns,
            states=self._states,
            probes=self._probes,
            deviations={name: self._tally.max_deviation[index[name]] for name in self._summed[DEVIATION]},
            drifts={name: slopes[index[name]] for name in self._summed[DRIFT]},
            max_error=self.max_error,
            final_error=self.final_error,
            faults=self._faults,
            one_step=one_step,
        )


def _columns(needs: set[str]) -> list[str]:
    """Names of the columns among ``needs``."""
    return sorted(need for need in needs if need not in RECORDED and need.partition(".")[0] not in (DEVIATION, DRIFT))


def _named(needs: set[str], what: str) -> list[str]:
    """Names of the integrals that ``needs`` holds as ``what.NAME``."""
    return sorted(need.removeprefix(f"{what}.") for need in needs if need.startswith(f"{what}."))


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
        for need in (need for need in (ERROR, FINAL_ERROR) if need in measure.needs):
            for i in whole.tolist():
                if batch.faults[need][i]:
                    columns[name][i] = np.nan
                    on_fault(i, name, batch.faults[need][i])
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
