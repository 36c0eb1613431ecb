"""``topcli compare``: schemes, options and step sizes on one experiment, against an independent reference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from topcli.analysis.order import probe_rows, reversal
from topcli.analysis.reference import distances
from topcli.analysis.swings import first_swing_spacing, swing_times
from topcli.analysis.trajectory import Trajectory
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array, Method, Outcome, Top
from topcli.engine.numbers import MAX_DIGITS
from topcli.engine.timing import nanoseconds_per_step
from topcli.errors import ExitCode, SchemeCodeError, UsageError
from topcli.runs.plans import precise_of, trajectory_of
from topcli.runs.references import METHODS, reference_of
from topcli.runs.report import deviation_text, drift_text, open_lines
from topcli.studies import SILENT, Watch
from topcli.studies.entries import SCHEME, code_failures, common_strides, entries_of, refuse_keys
from topcli.studies.report import Report, Table
from topcli.table import Row

_FIGURES = ("max_deviation", "max_deviation_relative", "drift", "drift_error", "drift_bound", "model", "verdict")
"""Figures of each invariant in the detailed table, as in the report of a run."""


def compare(
    *entries: str,
    config: str | Path | Mapping[str, Any] = "kowalevski_hk",
    overrides: Sequence[str] = (),
    reference: Literal["taylor", "exact"] = "taylor",
    watch: Watch = SILENT,
) -> Report:
    """Compare errors, drifts, reversibility and speed of schemes.

    A scheme may have its own step size and options, as in hk:h=0.01 or hybrid:branch=sign. Runs with different steps
    cover the same time span and are compared at common times. A sweep (topcli sweep) compares schemes on many
    trajectories.

    Parameters
    ----------
    *entries : str
        Names of schemes, each with its own h and options if needed. Examples are ``"hk"``, ``"hk:h=0.02"`` and
        ``"hybrid:branch=sign"``.
    config : path, str or mapping, optional
        Read the experiment from a config or scene. In Python, ``config`` may also be the content of a config.
    overrides : sequence of str, optional
        Override a key of the config, e.g. h=0.01 or top.c0=-1.
    reference : {"taylor", "exact"}, optional
        Measure errors against a Taylor series or the exact solution. The Taylor series is computed in double-double
        arithmetic (32 digits), the exact solution from a closed form.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    Report
        Errors, reversal, swings and speed of each entry; deviations and drifts of the invariants. An error is the
        Euclidean norm of the difference between a state and the reference state. ``columns`` has the compared times
        ``t`` and, for each entry, the columns ``error:<entry>`` and ``swing:<entry>``, the component that shows the
        swings of the top, such as gamma1.

    Raises
    ------
    ConfigError
        If the config is invalid or describes an ensemble.
    UsageError
        If a scheme or an option is unknown, or if ``reference="exact"`` is given for a top without a closed form.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.compare("hk", "hk:h=0.02", config="kowalevski_generic_hk", overrides=["h=0.01", "T=5"])
    >>> fine, coarse = report.table["max_error"]
    >>> bool(3.9 < coarse / fine < 4.1)
    True
    >>> report.plot().get_yscale()
    'log'
    """
    refuse_keys(overrides, SCHEME)
    base = load_experiment(config, overrides, any_precision=True)
    asked = entries_of(base, entries)
    top, exact = base.top, reference_of(base.top, reference)
    strides = dict(zip(asked, common_strides(base, list(asked.values())), strict=True))
    first = next(iter(asked.values()))
    watch.begin(base.name, base, unit="schemes")
    expected: dict[float, Array] = {}
    runs: dict[str, tuple[Experiment, Method, Trajectory]] = {}
    broken: list[str] = []
    for i, (label, experiment) in enumerate(asked.items()):
        if experiment.h not in expected:
            n = np.arange(0, experiment.N + 1, strides[label])
            expected[experiment.h] = exact.states(np.array(base.y0), experiment.h, n)
        with code_failures(broken, label):
            runs[label] = experiment, experiment.method(), _recorded(experiment, strides[label])
        watch(i + 1, len(asked))
    if not runs:
        raise SchemeCodeError(broken[0].partition(": ")[2])

    # the speed of all is timed in turns, after the runs
    probes = expected[first.h][probe_rows(len(expected[first.h]))]
    t, swing = np.arange(0, first.N + 1, strides[next(iter(asked))]) * first.h, top.components.index(top.swing)
    rows, invariants, columns = [], {}, {"t": t, "swing:reference": expected[first.h][:, swing]}
    coarse: dict[str, None] = {}
    for (label, (experiment, method, run)), nanoseconds in zip(
        runs.items(), _step_times(list(runs.values())), strict=True
    ):
        error = distances(run.states, expected[experiment.h][: len(run.states)])
        spacing = first_swing_spacing(_swings(top, run.t, run.states, coarse))
        rows.append(_row(label, experiment, method, run, error, probes, spacing, nanoseconds))
        invariants[label] = [row.as_dict() for row in run.invariant_rows()]
        for name, values in (("error", error), ("swing", run[top.swing])):
            columns[f"{name}:{label}"] = np.append(values, np.full(len(t) - len(values), np.nan))
    ended = [
        f"{label}: {run.ending.message}" for label, (*_, run) in runs.items() if run.outcome is not Outcome.COMPLETED
    ]

    same_step = all(experiment.h == first.h for experiment in asked.values())
    steps = f"h = {first.h:g}, N = {first.N}" if same_step else f"t from 0 to {base.duration:g}"
    title = f"{base.name}: {top.title}, {steps}" + (f", precision {base.precision}" if base.written else "")
    hidden = ["ns_per_step", *(("h", "N") if same_step else ()), *(() if ended else ("outcome",))]
    formats = {"h": "g", "its_order": ".2f", "first_swing_spacing": ".4f", "ns_per_step": ".1f"}
    of_top = {label: each[: len(top.invariants())] for label, each in invariants.items()}
    tables = [Table("Errors, reversal and speed", rows, formats, hidden), *_invariant_tables(of_top, invariants)]
    speeds = ", ".join(f"{row['scheme']} {row['ns_per_step']:.1f}" for row in rows if row["ns_per_step"] is not None)
    spacing = first_swing_spacing(_swings(top, t, expected[first.h], coarse))
    swings = "" if spacing is None else f" The first swing spacing of {top.swing} in the reference is {spacing:.4f}."
    notes = [*open_lines([(label, row) for label, each in of_top.items() for row in each]), *coarse]
    notes += [f"ns per step: {speeds}"] if speeds else []
    notes.append(f"Errors are norms of the difference of states from the reference, a {METHODS[reference]}.{swings}")
    code = ExitCode.PARTLY_FAILED if broken else ExitCode.FAILED if ended else ExitCode.SUCCESS
    draw = partial(_draw, list(runs), columns, base.name)
    return Report("compare", title, "", tables, notes, [*ended, *broken], code, base.resolved(), columns, draw)


def _row(
    label: str,
    experiment: Experiment,
    method: Method,
    run: Trajectory,
    error: Array,
    probes: Array,
    spacing: float | None,
    nanoseconds: float,
) -> Row:
    """Row of an entry; its reversal is tried at the states ``probes`` of the reference."""
    precise = precise_of(experiment.model_copy(update={"max_digits": max(experiment.max_digits, MAX_DIGITS)}))
    defect, its_order = reversal(experiment.top, method, probes, experiment.h, precise)
    complete = run.outcome in (Outcome.COMPLETED, Outcome.LEFT_MOTION)
    return {
        "scheme": label, "h": experiment.h, "N": experiment.N, "outcome": run.outcome.value,
        "max_error": float(error.max()), "final_error": float(error[-1]) if complete else None,
        "reversal_defect": defect, "its_order": its_order,
        "first_swing_spacing": spacing,
        "ns_per_step": nanoseconds if complete else None,
    }  # fmt: skip


def _invariant_tables(of_top: Mapping[str, Sequence[Row]], every: Mapping[str, Sequence[Row]]) -> list[Table]:
    """Tables of the invariants of the top by entry: deviations, drifts, and all figures, also of modified integrals."""
    deviations, drifts = (
        [{"scheme": label, **{row["symbol"]: text(row) for row in rows}} for label, rows in of_top.items()]
        for text in (deviation_text, _drift)
    )
    figures = [
        {"scheme": label, "invariant": row["symbol"]} | {key: row[key] for key in _FIGURES}
        for label, rows in every.items()
        for row in rows
    ]
    return [
        Table("Largest deviation, relative to the first value", deviations),
        Table("Drift per unit time, with 95 % bounds, or the verdict", drifts),
        Table("Invariants and modified integrals", figures, detail=True),
    ]


def _draw(labels: Sequence[str], columns: Mapping[str, Array], title: str, axes: Any, looks: Any) -> None:
    """Draw the errors over time, from above their growth at the beginning."""
    for label, style in looks(labels).items():
        error = columns[f"error:{label}"]
        axes.plot(columns["t"], np.where(error > 0.0, error, np.nan), label=label, **style)
    axes.set(xlabel="time $t$", ylabel="error of the state", yscale="log", title=title.replace("$", r"\$"))
    later = np.concatenate([columns[f"error:{label}"][1 + len(columns["t"]) // 100 :] for label in labels])
    if (later > 0.0).any():
        axes.set_ylim(bottom=0.5 * np.nanmin(later[later > 0.0]))


def _swings(top: Top, t: Array, states: Array, coarse: dict[str, None]) -> Array:
    """Times of the swings in the rows; none if these are too few to show them, which is added to ``coarse``."""
    try:
        return swing_times(top, t, states)
    except UsageError as failure:
        coarse[f"no swing spacing: {failure.lines[0]}"] = None
        return np.empty(0)


def _recorded(experiment: Experiment, stride: int) -> Trajectory:
    """Run of an experiment that records every ``stride``-th step."""
    return trajectory_of(
        experiment.model_copy(update={"output": experiment.output.model_copy(update={"every": stride})})
    )


def _drift(row: Mapping[str, Any]) -> str | None:
    """Drift of an invariant, significant or bounded; otherwise the verdict."""
    return drift_text(row, short=True) if row["verdict"] in ("drifting", "no drift seen") else row["verdict"]


def _step_times(runs: Sequence[tuple[Experiment, Method, Trajectory]]) -> list[float]:
    """Nanoseconds a step of each run; in another precision than double from the run itself."""
    if runs[0][0].written is not None:
        return [1e9 * run.seconds["run"] / max(run.ending.step, 1) for _, _, run in runs]
    timed = [(experiment.top, method, experiment.y0, experiment.h) for experiment, method, _ in runs]
    return nanoseconds_per_step(timed)
