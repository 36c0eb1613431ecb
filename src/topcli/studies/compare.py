"""One experiment under several schemes, measured against an independent reference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from topcli.analysis.drift import invariant_report
from topcli.analysis.order import probe_rows, reversal
from topcli.analysis.reference import distances, reference_states
from topcli.analysis.swings import minima_times, swing_spacing
from topcli.analysis.trajectory import Trajectory
from topcli.config.load import experiment_from
from topcli.config.models import Experiment
from topcli.contracts import Array, Method, Outcome
from topcli.engine.loop import nanoseconds_per_step
from topcli.errors import UsageError, nearest, quoted
from topcli.schemes.registry import find_scheme
from topcli.studies.report import finite, left_motion
from topcli.studies.simulate import trajectory_of

MAX_ROWS = 2_000_000


@dataclass(frozen=True)
class Comparison:
    """One experiment under several schemes: the measured ``figures`` and the ``series`` behind them.

    ``series`` has ``t`` (m,), and for each scheme ``error:<scheme>`` and ``swing:<scheme>`` (m,), the latter also
    for ``reference``; rows after a blow-up are nan.
    """

    figures: dict[str, Any]
    series: dict[str, Array]


def under_scheme(experiment: Experiment, name: str, options: Mapping[str, Any] | None = None) -> Experiment:
    """``experiment`` with another scheme, and with those of ``options`` that this scheme has.

    If it is the same scheme, composed or not, it keeps the other options of the experiment.
    """
    resolved = experiment.resolved()
    own = name.lower().partition("+")[0] == experiment.scheme.name.partition("+")[0]
    resolved["scheme"] = (resolved["scheme"] if own else {}) | {"name": name}
    known = find_scheme(name, experiment.top.form).options.model_fields
    resolved["scheme"] |= {key: value for key, value in (options or {}).items() if key in known}
    return experiment_from(resolved)


def _padded(values: Array, rows: int) -> Array:
    return np.concatenate([values, np.full(rows - len(values), np.nan)])


def _modified_figures(experiment: Experiment, trajectory: Trajectory) -> list[dict[str, Any]]:
    """Figures on the integrals of the scheme itself, with the largest term that each adds to the top's own integral.

    That term is of the order of the scheme in h; the figures include its coefficient.
    """
    plain = {f"modified_{invariant.name}": invariant for invariant in experiment.top.invariants()}
    modified = experiment.modified
    rows = invariant_report(modified, trajectory.n, trajectory.h, trajectory.states)
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


def _figures(
    experiment: Experiment,
    method: Method,
    trajectory: Trajectory,
    error: Array,
    probes: Array,
    nanoseconds: float,
) -> dict[str, Any]:
    top = experiment.top
    back = reversal(top, method, probes, experiment.h)
    reached_end = trajectory.outcome in (Outcome.COMPLETED, Outcome.LEFT_MOTION)
    return {
        "scheme": experiment.scheme.name,
        "options": experiment.options.model_dump(mode="json"),
        "changed": experiment.options.model_dump(mode="json", exclude_defaults=True),
        "outcome": trajectory.ending.outcome.value,
        "message": trajectory.ending.message,
        "left_motion": left_motion(trajectory.ending),
        "counters": dict(trajectory.ending.counters),
        "declared_order": experiment.scheme.order_for(experiment.options),
        "max_error": float(error.max()),
        "end_error": float(error[-1]) if reached_end else None,
        "invariants": [
            row.as_dict() for row in invariant_report(top.invariants(), trajectory.n, trajectory.h, trajectory.states)
        ],
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
    }


def compare_schemes(
    experiment: Experiment, names: Sequence[str], options: Mapping[str, Any] | None = None
) -> Comparison:
    """Run ``experiment`` under each of the schemes ``names`` and measure them.

    Each of the ``options`` is set for the schemes that have it, of which there must be one.

    Errors are Euclidean norms of the difference of states from the Taylor reference at the recorded times. The
    reversal defect is the largest over states spread along the reference. Raises UsageError for a repeated or
    unknown scheme, or for more rows than fit in memory.
    """
    experiments = [under_scheme(experiment, name, options) for name in names]
    for key in options or ():
        if not any(key in one.scheme.options.model_fields for one in experiments):
            known = {key for one in experiments for key in one.scheme.options.model_fields}
            raise UsageError(f"--set scheme.{key}: none of the schemes has this option; {nearest(key, known)}")
    used = [one.scheme.name for one in experiments]
    repeated = sorted({name for name in used if used.count(name) > 1})
    if repeated:
        raise UsageError(f"scheme {quoted(repeated[0])} is named twice")
    rows = experiment.N // experiment.output.every + 1
    if rows > MAX_ROWS:
        raise UsageError(
            f"output.every: {rows} rows to compare in memory; "
            f"record fewer with --set output.every={experiment.N // MAX_ROWS + 1} or more"
        )
    top = experiment.top
    methods = [one.method() for one in experiments]
    trajectories = [trajectory_of(one) for one in experiments]
    n = np.arange(0, experiment.N + 1, experiment.output.every)
    reference = reference_states(top, experiment.y0, n * experiment.h)
    probes = reference[probe_rows(len(reference))]
    timed = nanoseconds_per_step(
        [(top, method, experiment.y0, experiment.h) for method in methods],
        steps=min(max(experiment.N, 1000), 50_000),
    )
    swing = top.components.index(top.swing)
    series = {"t": n * experiment.h, "swing:reference": reference[:, swing]}
    figures = []
    for one, method, trajectory, nanoseconds in zip(experiments, methods, trajectories, timed, strict=True):
        error = distances(trajectory.states, reference[: len(trajectory)])
        figures.append(_figures(one, method, trajectory, error, probes, nanoseconds))
        series[f"error:{one.scheme.name}"] = _padded(error, len(n))
        series[f"swing:{one.scheme.name}"] = _padded(trajectory.states[:, swing], len(n))
    return Comparison(
        finite(
            {
                "config": experiment.resolved(),
                "reference": {
                    "method": "Taylor series in double-double arithmetic",
                    "swing": top.swing,
                    "swing_spacing": swing_spacing(series["t"], series["swing:reference"]),
                },
                "schemes": figures,
            }
        ),
        series,
    )
