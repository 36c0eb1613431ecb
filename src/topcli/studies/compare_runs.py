"""Runs of one experiment under several schemes, compared with an independent reference."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from topcli.analysis.order import probe_rows, reversal
from topcli.analysis.reference import MAX_TAYLOR_STEPS, distances
from topcli.analysis.swings import first_swing_spacing, minima_times
from topcli.analysis.trajectory import Trajectory
from topcli.config.models import Experiment
from topcli.contracts import Array, Method, Outcome, Sampler
from topcli.engine.machine import nanoseconds_per_step
from topcli.engine.numbers import MAX_DIGITS
from topcli.runs.plans import precise_of, trajectory_of
from topcli.runs.references import METHODS, TAYLOR, SharedReferences, reference_of
from topcli.runs.report import finite, left_motion
from topcli.studies.entries import Entry, Failed, few_rows, read_entries, users_code
from topcli.studies.study import Result

if TYPE_CHECKING:
    from topcli.engine.numbers import PreciseRun


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
    return precise_of(experiment.model_copy(update={"max_digits": max(experiment.max_digits, MAX_DIGITS)}))


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
        "compile_seconds": trajectory.seconds["compile"],
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
        return [1e9 * run.trajectory.seconds["run"] / max(run.trajectory.ending.step, 1) for run in runs]
    return nanoseconds_per_step(
        [(experiment.top, run.method, experiment.y0, run.entry.experiment.h) for run in runs],
        steps=min(max(experiment.N, 1000), 50_000),
    )
