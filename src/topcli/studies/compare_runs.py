"""Runs of one experiment or ensemble under several schemes, compared with an independent reference."""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from topcli.analysis.order import probe_rows, reversal
from topcli.analysis.reference import MAX_TAYLOR_STEPS, distances
from topcli.analysis.swings import first_swing_spacing, minima_times
from topcli.analysis.tally import quantiles
from topcli.analysis.trajectory import Trajectory
from topcli.config.ensemble import EnsembleExperiment, Group
from topcli.config.models import Experiment
from topcli.contracts import Array, Method, Outcome, Sampler, Top
from topcli.engine.precise_numbers import MAX_DIGITS
from topcli.engine.run import nanoseconds_per_step
from topcli.runs.references import METHODS, TAYLOR, SharedReferences, reference_of
from topcli.runs.report import EndingTally, finite, left_motion
from topcli.runs.simulate import trajectory_of
from topcli.studies.entries import Entry, Failed, few_rows, read_entries, users_code
from topcli.studies.study import Result
from topcli.sweeps.batch import evaluate
from topcli.sweeps.batch_run import MAX_RUNS, BatchRun
from topcli.sweeps.measures import Measure, names_of, resolve_measures

if TYPE_CHECKING:
    from topcli.engine.precise import PreciseRun


def _padded(values: Array, rows: int) -> Array:
    return np.concatenate([values, np.full(rows - len(values), np.nan)])


def _modified_figures(experiment: Experiment, trajectory: Trajectory) -> list[dict[str, Any]]:
    """Figures on the integrals of the scheme itself, with the largest term that each adds to the top's own integral.

    That term is of the order of the scheme in h; the figures include its coefficient.
    """
    plain = {f"modified_{invariant.name}": invariant for invariant in experiment.top.invariants()}
    modified = experiment.modified
    rows = trajectory.invariant_rows()[len(plain) :]
    power = experiment.scheme.order_for(experiment.options) or 0
    figures = []
    for invariant, row in zip(modified, rows, strict=True):
        own = plain.get(invariant.name)
        figures.append(row.as_dict())
        if own is not None:
            term = float(np.abs(invariant.value(trajectory.states) - own.value(trajectory.states)).max())
            figures[-1]["correction"] = {
                "of": own.symbol,
                "size": term,
                "power": power,
                "coefficient": term / abs(trajectory.h) ** power,
            }
    return figures


def _unlimited(experiment: Experiment) -> PreciseRun | None:
    """Run of an experiment in its precision; None for double. Its limit of digits leaves room for single steps."""
    if experiment.written is None:
        return None
    from topcli.runs.precise import precise_run

    return precise_run(experiment.model_copy(update={"max_digits": max(experiment.max_digits, MAX_DIGITS)}))


def _figures(
    entry: Entry,
    method: Method,
    trajectory: Trajectory,
    error: Array,
    probes: Array,
    nanoseconds: float,
) -> dict[str, Any]:
    experiment, top = entry.experiment, entry.experiment.top
    back = reversal(top, method, probes, experiment.h, _unlimited(experiment))
    reached_end = trajectory.outcome in (Outcome.COMPLETED, Outcome.LEFT_MOTION)
    return {
        **entry.settings(),
        "outcome": trajectory.ending.outcome.value,
        "message": trajectory.ending.message,
        "left_motion": left_motion(trajectory.ending),
        "counters": dict(trajectory.ending.counters),
        "declared_order": experiment.scheme.order_for(experiment.options),
        "max_error": float(error.max()),
        "final_error": float(error[-1]) if reached_end else None,
        "invariants": [row.as_dict() for row in trajectory.invariant_rows()[: len(top.invariants())]],
        "modified": _modified_figures(experiment, trajectory),
        "reversal_defect": back.defect,
        "reversal_order": back.order,
        "reversal": {"h": back.h, "sizes": list(back.sizes), "defects": list(back.defects)},
        "first_swing_spacing": first_swing_spacing(trajectory.t, trajectory[top.swing]),
        "swing_times": minima_times(trajectory.t, trajectory[top.swing]).tolist(),
        "nanoseconds_per_step": nanoseconds if reached_end else None,  # of a few steps it says little
        "compile_seconds": trajectory.compile_seconds,
        "closed_form": isinstance(method, Sampler),
    }


def compare_schemes(
    experiment: Experiment,
    entries: Sequence[str],
    options: Mapping[str, Any] | None = None,
    reference: str = TAYLOR,
) -> Result:
    """Run ``experiment`` under each of the ``entries``, names of schemes with their own settings, and measure them.

    Each of the ``options`` is set for the schemes that have it, of which there must be one.

    Errors are Euclidean norms of the difference of states from the ``reference`` at the compared times: Taylor series
    or the closed form (``references.METHODS``). The reversal defect is the largest over states spread along the
    reference. Entries whose code fails are listed under ``failed``; the others go on. Raises UsageError as
    ``read_entries``, for a reference that the top does not have, and if the code of all entries fails.
    """
    asked = read_entries(experiment, entries, options)
    top = experiment.top
    exact_motion = reference_of(top, reference)
    shared = SharedReferences(sys.maxsize, MAX_TAYLOR_STEPS)

    def reference_rows(compared: Experiment, every: int) -> Array:
        n = np.arange(0, compared.N + 1, every)
        return shared.states(exact_motion, np.array(experiment.y0), compared.h, n)

    finest = max((entry.experiment for entry in asked), key=lambda each: each.N // each.output.every)
    finest_rows = reference_rows(finest, finest.output.every)  # first, because it may be refused
    runs: list[_EntryRun] = []
    failed: list[Failed] = []
    for entry in asked:
        with users_code(failed, entry.label):
            runs.append(_EntryRun(entry, entry.experiment.method(), trajectory_of(entry.experiment)))
    if not runs:
        raise failed[0].error
    probes = finest_rows[probe_rows(len(finest_rows))]
    swing, first = top.components.index(top.swing), runs[0].entry
    t = np.arange(0, first.experiment.N + 1, first.stride) * first.experiment.h
    series = {"t": t, "swing:reference": reference_rows(first.experiment, first.stride)[:, swing]}
    rows = []
    for (entry, method, trajectory), nanoseconds in zip(runs, _step_times(experiment, runs), strict=True):
        states = trajectory.states[:: entry.rows_apart]
        error = distances(states, reference_rows(entry.experiment, entry.stride)[: len(states)])
        rows.append(_figures(entry, method, trajectory, error, probes, nanoseconds))
        series[f"error:{entry.label}"] = _padded(error, len(t))
        series[f"swing:{entry.label}"] = _padded(states[:, swing], len(t))
    times = np.arange(len(finest_rows)) * finest.output.every * finest.h
    return Result(
        finite(
            {
                "config": experiment.resolved(),
                "reference": {
                    "kind": reference,
                    "method": METHODS[reference],
                    "swing": top.swing,
                    "first_swing_spacing": first_swing_spacing(times, finest_rows[:, swing]),
                },
                "rows": len(t),
                "few_rows": few_rows([run.entry for run in runs], experiment),
                "schemes": rows,
                "failed": [failure.as_dict() for failure in failed],
            }
        ),
        series,
    )


class _EntryRun(NamedTuple):
    """One entry, its method and its run."""

    entry: Entry
    method: Method
    trajectory: Trajectory


def _step_times(experiment: Experiment, runs: Sequence[_EntryRun]) -> list[float]:
    """Nanoseconds a step of each run; in another precision than double from the run itself."""
    if experiment.written is not None:
        return [1e9 * run.trajectory.run_seconds / max(run.trajectory.ending.step, 1) for run in runs]
    return nanoseconds_per_step(
        [(experiment.top, run.method, experiment.y0, run.entry.experiment.h) for run in runs],
        steps=min(max(experiment.N, 1000), 50_000),
    )


ERRORS = ("max_error", "final_error")
"""Measures that need a reference."""
COMPARED_QUANTILES = {"10 %": 0.1, "median": 0.5, "90 %": 0.9}
MEASURED = (*ERRORS, "reversal_defect", "first_swing_spacing")
"""Measures of every entry that they fit, beside deviation and drift of its invariants."""


def compare_ensemble(
    experiment: EnsembleExperiment,
    entries: Sequence[str],
    options: Mapping[str, Any] | None = None,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
    reference: str = TAYLOR,
    most: int = MAX_RUNS,
) -> dict[str, Any]:
    """Run an ensemble under each of the ``entries`` and measure the trajectories; plain data, ready for JSON.

    Parameters
    ----------
    experiment : EnsembleExperiment
        Ensemble, whose initial states all entries share.
    entries : sequence of str
        Names of schemes with their own settings, as ``read_entries`` takes them.
    options : mapping, optional
        Options of all schemes that have them.
    on_progress : callable, optional
        ``on_progress(done, total)`` is called with the number of steps taken.
    reference : str, optional
        Reference of the errors, as ``compare_schemes`` takes it. A top that it cannot follow has no errors.
    most : int, optional
        Largest number of trajectories at a time, which does not change the figures.

    Returns
    -------
    dict
        ``schemes`` holds for each entry the counted outcomes, the first failures, and the quantiles of each measure
        over the trajectories that took all their steps and have a value, with the ``count`` of these. ``failed`` lists
        the entries whose code fails.

    Raises
    ------
    UsageError
        As ``read_entries``, for a reference that the top does not have, for more rows than fit in memory, and if the
        code of all entries fails.
    """
    compared = read_entries(experiment.first, entries, options)
    known = not reference_of(experiment.top, reference).obstacle
    columns: list[_Column] = []
    failed: list[Failed] = []
    for entry in compared:
        with users_code(failed, entry.label):
            columns.append(_Column(entry, experiment.top, reference if known else None))
    done, total = 0, experiment.count * sum(column.experiment.N for column in columns)
    for group in experiment.members.groups:
        sizes = []
        for column in _working(columns, failed):
            with users_code(failed, column.entry.label):
                sizes.append(column.prepare(group))
        for initial in group.source.blocks(min(most, *sizes) if sizes else group.count):
            for column in _working(columns, failed):  # one block under all entries, so that they share its references
                with users_code(failed, column.entry.label):
                    column.add(initial)
                done += len(initial) * column.experiment.N
                on_progress(done, total)
    columns = _working(columns, failed)
    if not columns:
        raise failed[0].error
    first = compared[0]
    return finite(
        {
            "kind": "ensemble",
            "config": experiment.resolved(),
            "trajectories": experiment.count,
            "quantiles": COMPARED_QUANTILES,
            "reference": {"kind": reference, "method": METHODS[reference]} if known else None,
            "swing": experiment.top.swing,
            "rows": first.experiment.N // first.stride + 1,
            "few_rows": few_rows(compared, experiment.first),
            "schemes": [column.figures() for column in columns],
            "failed": [failure.as_dict() for failure in failed],
        }
    )


def _working(columns: Sequence[_Column], failed: Sequence[Failed]) -> list[_Column]:
    """The ``columns`` whose code has not failed."""
    labels = {failure.label for failure in failed}
    return [column for column in columns if column.entry.label not in labels]


class _Column:
    """One entry, fed with blocks of initial states; without a ``reference`` it measures no errors."""

    def __init__(self, entry: Entry, top: Top, reference: str | None) -> None:
        experiment = entry.experiment
        output = experiment.output.model_copy(update={"every": entry.stride})
        self.entry, self.experiment = entry, experiment.model_copy(update={"top": top, "output": output})
        self._reference = reference
        self.measures = _measures(self.experiment, ERRORS if reference is None else ())
        self._values: dict[str, list[Array]] = {measure.name: [] for measure in self.measures}
        self._faults: dict[str, list[tuple[int, str]]] = defaultdict(list)
        self._endings = EndingTally(self.experiment.N)
        self._reached, self._steps, self._seconds = 0, 0, 0.0
        self._run: BatchRun | None = None

    def prepare(self, group: Group) -> int:
        """Get ready to run trajectories of a group; return the largest number of them at a time."""
        experiment = self.experiment.model_copy(update={"top": group.top})
        self._run = BatchRun(experiment, self.measures, count=group.count, reference=self._reference)
        return self._run.size

    def add(self, initial: Array) -> None:
        """Run the trajectories from ``initial`` (m, d) and measure them."""
        assert self._run is not None
        offset = self._endings.total
        batch = self._run.finished(initial)
        values_by_name = evaluate(
            self.measures, batch, lambda i, name, reason: self._faults[name].append((offset + i, reason))
        )
        for name, values in values_by_name.items():
            self._values[name].append(values)  # nan for those that failed
        self._reached += int(np.count_nonzero(batch.whole))
        self._endings.add(batch.endings)
        self._steps += int(batch.endings.step.sum())
        self._seconds += float(batch.seconds.sum())

    def figures(self) -> dict[str, Any]:
        """Outcomes and quantiles as plain data."""
        measured = {}
        for name, parts in self._values.items():
            values = np.concatenate(parts)
            measured[name] = {
                "count": int(np.count_nonzero(~np.isnan(values))),
                **quantiles(values, COMPARED_QUANTILES),
            }
        return {
            **self.entry.settings(),
            "outcomes": self._endings.outcomes,
            "message": self._endings.message,
            "reached_end": self._reached,
            "failures": [
                {"trajectory": i, "outcome": ending.outcome.value, "message": ending.message}
                for i, ending in self._endings.failures
            ],
            "faults": {
                name: {"count": len(missing), "trajectory": missing[0][0], "reason": missing[0][1]}
                for name, missing in self._faults.items()
            },
            "invariants": [
                {"name": invariant.name, "symbol": invariant.symbol}
                for invariant in (*self.experiment.top.invariants(), *self.experiment.modified)
            ],
            "measures": measured,
            "nanoseconds_per_step": 1e9 * self._seconds / max(self._steps, 1),
        }


def _measures(experiment: Experiment, without: Sequence[str]) -> tuple[Measure, ...]:
    """Measures of an entry: those of ``MEASURED`` that fit, and deviation and drift of each invariant.

    Those named in ``without`` are left out.
    """
    top, scheme, options = experiment.top, experiment.scheme, experiment.options
    fitting = names_of(top, scheme, options)
    names = [name for name in MEASURED if name in fitting and name not in without]
    names += [name for name in fitting if name.partition(".")[0] in ("max_deviation", "drift")]
    return resolve_measures(names, top, scheme, options)
