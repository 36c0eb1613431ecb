"""One experiment under several schemes, options or steps, measured against an independent reference."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from topcli.analysis.order import probe_rows, reversal
from topcli.analysis.reference import MAX_STEPS, distances
from topcli.analysis.swings import minima_times, swing_spacing
from topcli.analysis.trajectory import Trajectory
from topcli.config.models import Experiment
from topcli.contracts import Array, Method, Outcome, Sampler
from topcli.engine.loop import nanoseconds_per_step
from topcli.engine.precise.numbers import MAX_DIGITS
from topcli.runs.report import finite, left_motion
from topcli.runs.simulate import trajectory_of
from topcli.store.envelope import thinned
from topcli.store.provenance import environment
from topcli.store.study import write_study
from topcli.studies.entries import Entry, few_rows, read_entries, users_code
from topcli.sweeps.measures.references import METHODS, TAYLOR, SharedReferences, reference_form

if TYPE_CHECKING:
    from topcli.engine.precise.loop import PreciseRun


@dataclass(frozen=True)
class Comparison:
    """One experiment under several schemes: the measured ``figures`` and the ``series`` behind them.

    ``series`` has the compared times ``t`` (m,), and for each entry ``error:<label>`` and ``swing:<label>`` (m,), the
    latter also for ``reference``; rows after a blow-up are nan.
    """

    figures: dict[str, Any]
    series: dict[str, Array]


def comparison_document(comparison: Comparison) -> dict[str, Any]:
    """The comparison as plain data: what ``--json`` prints, and the rows of its series that a picture needs."""
    series = {name: values.tolist() for name, values in thinned(comparison.series).items()}
    return finite({"schema_version": 1, "command": "compare", **comparison.figures, "series": series})


def write_comparison(path: Path, figures: Mapping[str, Any]) -> Path:
    """Write a comparison as JSON atomically, with the time, the commit and the versions; the path.

    ``figures`` is a ``comparison_document``, or the figures of an ensemble. Raises UsageError and RunError.
    """
    named = {"schema_version": 1, "command": "compare", **figures, "environment": environment()}
    return write_study(path, named, None)


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
    if experiment.exact is None:
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
        **settings(entry),
        "outcome": trajectory.ending.outcome.value,
        "message": trajectory.ending.message,
        "left_motion": left_motion(trajectory.ending),
        "counters": dict(trajectory.ending.counters),
        "declared_order": experiment.scheme.order_for(experiment.options),
        "max_error": float(error.max()),
        "end_error": float(error[-1]) if reached_end else None,
        "invariants": [row.as_dict() for row in trajectory.invariant_rows()[: len(top.invariants())]],
        "modified": _modified_figures(experiment, trajectory),
        "reversal": {
            "h": back.h,
            "defect": back.defect,
            "order": back.order,
            "sizes": list(back.sizes),
            "defects": list(back.defects),
        },
        "swing_spacing": swing_spacing(trajectory.t, trajectory[top.swing]),
        "swing_times": minima_times(trajectory.t, trajectory[top.swing]).tolist(),
        "nanoseconds_per_step": nanoseconds,
        "compile_seconds": trajectory.compile_seconds,
        "closed_form": isinstance(method, Sampler),
        "setup_seconds": trajectory.setup_seconds if isinstance(method, Sampler) and method.setup else None,
    }


def settings(entry: Entry) -> dict[str, Any]:
    """First figures of an entry: its label, scheme, options and steps; ``compared_every`` steps are compared."""
    experiment = entry.experiment
    return {
        "label": entry.label,
        "scheme": experiment.scheme.name,
        "options": experiment.options.model_dump(mode="json"),
        "changed": experiment.options.model_dump(mode="json", exclude_defaults=True),
        "own": list(entry.own),
        "h": experiment.h,
        "N": experiment.N,
        "every": experiment.output.every,
        "compared_every": entry.stride,
    }


def compare_schemes(
    experiment: Experiment,
    entries: Sequence[str],
    options: Mapping[str, Any] | None = None,
    reference: str = TAYLOR,
) -> Comparison:
    """Run ``experiment`` under each of the ``entries``, names of schemes with their own settings, and measure them.

    Each of the ``options`` is set for the schemes that have it, of which there must be one.

    Errors are Euclidean norms of the difference of states from the ``reference`` at the compared times: Taylor series
    or the closed form (``references.METHODS``). The reversal defect is the largest over states spread along the
    reference. Entries whose code fails are listed under ``failed``; the others go on. Raises UsageError as
    ``read_entries``, for a reference that the top does not have, and if the code of all entries fails.
    """
    asked = read_entries(experiment, entries, options)
    top = experiment.top
    reference_form(top, reference)
    shared = SharedReferences(sys.maxsize, MAX_STEPS)

    def reference_of(one: Experiment, every: int) -> Array:
        n = np.arange(0, one.N + 1, every)
        return shared.states(top, reference, np.array(experiment.y0), one.h, n)

    finest = max((one.experiment for one in asked), key=lambda one: one.N // one.output.every)
    finest_rows = reference_of(finest, finest.output.every)  # first, because it may be refused
    compared, methods, trajectories, failed = [], [], [], []
    for one in asked:
        with users_code(failed, one.label):
            method, trajectory = one.experiment.method(), trajectory_of(one.experiment)
            compared.append(one)
            methods.append(method)
            trajectories.append(trajectory)
    if not compared:
        raise failed[0].error
    probes = finest_rows[probe_rows(len(finest_rows))]
    timed = nanoseconds_per_step(
        [(top, method, experiment.y0, one.experiment.h) for one, method in zip(compared, methods, strict=True)],
        steps=min(max(experiment.N, 1000), 50_000),
    )
    if experiment.exact is not None:
        timed = [1e9 * one.run_seconds / max(one.ending.step, 1) for one in trajectories]
    swing, first = top.components.index(top.swing), compared[0]
    t = np.arange(0, first.experiment.N + 1, first.stride) * first.experiment.h
    series = {"t": t, "swing:reference": reference_of(first.experiment, first.stride)[:, swing]}
    figures = []
    for one, method, trajectory, nanoseconds in zip(compared, methods, trajectories, timed, strict=True):
        states = trajectory.states[:: one.rows_apart]
        error = distances(states, reference_of(one.experiment, one.stride)[: len(states)])
        figures.append(_figures(one, method, trajectory, error, probes, nanoseconds))
        series[f"error:{one.label}"] = _padded(error, len(t))
        series[f"swing:{one.label}"] = _padded(states[:, swing], len(t))
    times = np.arange(len(finest_rows)) * finest.output.every * finest.h
    return Comparison(
        finite(
            {
                "config": experiment.resolved(),
                "reference": {
                    "kind": reference,
                    "method": METHODS[reference],
                    "swing": top.swing,
                    "swing_spacing": swing_spacing(times, finest_rows[:, swing]),
                },
                "rows": len(t),
                "few_rows": few_rows(compared, experiment),
                "schemes": figures,
                "failed": [one.as_dict() for one in failed],
            }
        ),
        series,
    )
