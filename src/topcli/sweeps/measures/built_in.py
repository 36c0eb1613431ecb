"""The measures of topcli itself."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from topcli.analysis.swings import minima_times
from topcli.analysis.swings import swing_spacing as spacing_of_first
from topcli.contracts import Array
from topcli.sweeps.measures.batch import Batch
from topcli.sweeps.measures.references import obstacle
from topcli.sweeps.measures.registry import (
    COUNTER,
    DEVIATION,
    DRIFT,
    END_ERROR,
    ERROR,
    PROBES,
    SWING,
    counter_names,
    integral_names,
    measure,
)

INTEGRAL = "invariant"
TIME, NUMBER = "time", "number"


def _of_swings(batch: Batch, figure: Callable[[Array], float]) -> Array:
    """``figure`` of the times of the swings of each run (runs,)."""
    values = batch.columns[batch.experiment.top.swing]
    return np.array([figure(minima_times(batch.t, of_one)) for of_one in values])


@measure("swings", summary="number of swings: deep minima of the top's swinging component", unit=NUMBER, needs=[SWING])
def swings(batch: Batch) -> Array:
    """Number of deep minima within the recorded rows."""
    return _of_swings(batch, len)


@measure("swing_spacing", summary="median time from one swing to the next", unit=TIME, needs=[SWING])
def swing_spacing(batch: Batch) -> Array:
    """Median distance of neighbouring deep minima; nan for fewer than two."""
    return _of_swings(batch, lambda times: float(np.median(np.abs(np.diff(times)))) if len(times) > 1 else np.nan)


@measure("swing_spacing.first", summary="time from the first swing to the second", unit=TIME, needs=[SWING])
def first_spacing(batch: Batch) -> Array:
    """Distance of the first two deep minima; nan for fewer than two."""
    values = batch.columns[batch.experiment.top.swing]
    spacings = [spacing_of_first(batch.t, of_one) for of_one in values]
    return np.array([np.nan if spacing is None else spacing for spacing in spacings])


@measure(
    "drift.NAME",
    summary="fitted slope of NAME per unit time",
    unit="unit of NAME per time",
    needs=[DRIFT],
    names=integral_names,
    noun=INTEGRAL,
)
def drift(batch: Batch, name: str) -> Array:
    """Slope of the line that ``analysis.tally`` fits; nan for fewer than eight recorded rows."""
    return batch.drifts[name]


@measure(
    "deviation.NAME",
    summary="largest deviation of NAME from its first value",
    unit="unit of NAME",
    needs=[DEVIATION],
    names=integral_names,
    noun=INTEGRAL,
)
def deviation(batch: Batch, name: str) -> Array:
    """Largest magnitude of the deviation over the recorded rows."""
    return batch.deviations[name]


ERROR_UNIT = "norm of the state"


@measure(
    "error.max",
    summary="largest distance of a recorded state from the reference solution",
    unit=ERROR_UNIT,
    needs=[ERROR],
    obstacle=obstacle,
)
def max_error(batch: Batch) -> Array:
    """Largest Euclidean norm of the error over the recorded rows."""
    return batch.max_error


@measure(
    "error.end",
    summary="distance of the last state from the reference solution",
    unit=ERROR_UNIT,
    needs=[END_ERROR],
    obstacle=obstacle,
)
def end_error(batch: Batch) -> Array:
    """Euclidean norm of the error at step N."""
    return batch.end_error


@measure(
    "reversal",
    summary="defect of one step of |h| and one back, largest over 16 states of the run",
    unit="unit of the state",
    needs=[PROBES],
)
def reversal(batch: Batch) -> Array:
    """Largest component of the defect; infinite if one of the steps fails."""
    count, probes, d = batch.probes.shape
    h = abs(batch.experiment.h)
    there = batch.one_step(batch.probes.reshape(count * probes, d), h)
    back = batch.one_step(there, -h)
    with np.errstate(all="ignore"):
        defect = np.abs(back.reshape(count, probes, d) - batch.probes).max(axis=(1, 2))
    return np.where(np.isnan(defect), np.inf, defect)


@measure(
    "counter.NAME",
    summary="number of events NAME that the scheme counts",
    unit=NUMBER,
    names=counter_names,
    noun=COUNTER,
)
def counter(batch: Batch, name: str) -> Array:
    """Count at the end of the run; nan for a scheme that does not count it."""
    if name not in batch.endings.counters:
        return np.full(len(batch), np.nan)
    return batch.endings.counts[:, batch.endings.counters.index(name)].astype(np.float64)


@measure("steps", summary="steps taken; of a failed run, the step that failed", unit=NUMBER, of_failed=True)
def steps(batch: Batch) -> Array:
    """Step number at which the run ended."""
    return batch.endings.step.astype(np.float64)


@measure(
    "seconds",
    summary="wall time of the steps, the run's share of its batch; differs from run to run",
    unit="seconds",
    reproducible=False,
)
def seconds(batch: Batch) -> Array:
    """Wall time without compiling and without measuring."""
    return batch.seconds
