"""``topcli order``: errors over several step sizes, observed orders of convergence, and the plateau of round-off."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from topcli.analysis.order import OrderVerdict, convergence, is_consistent, judge_order
from topcli.analysis.reference import reference_states
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array
from topcli.errors import ExitCode, UsageError
from topcli.schemes.registry import names_for
from topcli.studies import SILENT, Watch
from topcli.studies.entries import SCENE, SCHEME, code_failures, entries_of, refuse_keys
from topcli.studies.ladder import ErrorCurve, ladder, measured, scheme_calls
from topcli.studies.report import Report, Table
from topcli.table import Row, two_digits

DEFAULT = ("bohlin-a", "hk", "hybrid", "rk4", "hk+kahan-li6", "hk+kahan-li8")
"""Schemes of the default study, on the generic motion of Kowalevski's top."""
FALSE = (OrderVerdict.TOO_LOW, OrderVerdict.INCONSISTENT)
"""Verdicts on a scheme whose declared order is false."""
INTERVALS = 20
"""Intervals between the evenly spaced times at which errors are measured."""
SECONDS = 5.0
"""CPU seconds that one run may take."""
CEILING = 1e3
"""Larger errors, of step sizes at which a scheme explodes, are not drawn."""


def order(
    *schemes: str,
    config: str | Path | Mapping[str, Any] | None = None,
    overrides: Sequence[str] = (),
    sizes: Sequence[float] = (),
    max_steps: int = 4_000_000,
    watch: Watch = SILENT,
) -> Report:
    """Measure errors at several h, and orders of convergence.

    The error of a run is its largest distance from a reference solution in double-double arithmetic. The order is
    fitted at the smallest step sizes whose errors exceed round-off. The command exits with code 4 if the
    measured order is below the order that the scheme declares.

    Parameters
    ----------
    *schemes : str
        Names of schemes, with options if needed; by default, six common ones, or all that fit the config.
    config : path, str or mapping, optional
        Config or scene that gives the top, the initial state and the duration. By default, a generic motion of the
        Kowalevski top over T = 10.
    overrides : sequence of str, optional
        Override a key of the config, e.g. top.c0=-1 or T=20.
    sizes : sequence of float, optional
        Run each scheme with this step size. By default, each scheme is run with its own decreasing step sizes, until
        round-off dominates or a run would need more than ``max_steps`` steps.
    max_steps : int, optional
        Take at most this many steps in each run.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    Report
        The first table has a row for each scheme with its observed order, the second a row for each step size with the
        errors of all schemes. The error of a run is the largest Euclidean distance between its states and the reference
        solution, a Taylor series, at evenly spaced times.

    Raises
    ------
    UsageError
        If a scheme is unknown or does not fit the top, or if a step size is too small or too large.
    RunError
        If the reference solution of the motion cannot be computed.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.order("hk", "rk4", config="euler_hk", overrides=["T=2"], sizes=[0.1, 0.05, 0.025])
    >>> report.table["order"].round(1).to_dict()
    {'hk': 2.0, 'rk4': 4.0}
    >>> report.tables[1].frame().shape
    (3, 2)
    """
    refuse_keys(overrides, {**SCHEME, "h": "the step sizes of this study are given by --h, or chosen for each scheme"})
    scene, length = (SCENE, ["T=10"]) if config is None else (config, [])
    base = load_experiment(scene, [*length, *overrides])
    interval = base.duration / INTERVALS
    if interval <= 0.0:
        raise UsageError(f"the duration {base.duration:g} must be positive; give another with --set T=...")
    chosen_sizes = sorted({_dividing(size, interval) for size in sizes}, reverse=True)
    names = schemes or (DEFAULT if config is None else ())
    chosen = entries_of(base, names, names_for(base.top.form), _without_order)
    watch.begin("order", base, unit="schemes")
    times = np.arange(INTERVALS + 1) * interval
    reference = reference_states(base.top, base.y0, times)
    extent = float(np.linalg.norm(reference - reference[0], axis=1).max())
    rows: list[Row] = []
    points: dict[str, dict[float, float]] = {}
    notes, broken, false = [], [], []
    for i, (name, experiment) in enumerate(chosen.items()):
        steps = [h for h in ladder(experiment, interval) if base.duration <= max_steps * h * (1.0 + 1e-9)]
        calls = measured(scheme_calls(experiment, times, []), times)
        curve = ErrorCurve(name, "scheme", "h", chosen_sizes or steps, SECONDS, calls)
        failed = len(broken)
        with code_failures(broken, name):
            curve.climb(reference)
        watch(i + 1, len(chosen))
        if len(broken) > failed:
            rows.append({"scheme": name, "verdict": "failed"})
            continue
        if curve.failure:
            notes.append(f"{name}: no result with {curve.failure}")
        points[name] = {point.setting: point.error for point in curve.points}
        row, why = _row(name, experiment, points[name], extent)
        rows.append(row)
        if row["verdict"] in map(str, FALSE):
            false.append(f"{name}: {why}")
        elif why and points[name]:
            notes.append(f"{name}: order undecided: {why}")
    code = ExitCode.VIOLATED if false else ExitCode.SUCCESS
    if broken:
        code = ExitCode.PARTLY_FAILED if len(broken) < len(rows) else ExitCode.WRONG_USAGE
    elif not all(points.values()):
        code = ExitCode.FAILED

    small = dict.fromkeys(("round-off", "from h", "smallest_error"), two_digits)
    formats = {"order": ".2f", **small, "at_h": lambda h: f"{h:.3g}" if float(f"{h:.3g}") == h else two_digits(h)}
    every_size = sorted({size for of_scheme in points.values() for size in of_scheme}, reverse=True)
    errors_at = [{"h": size, **{name: of[size] for name, of in points.items() if size in of}} for size in every_size]
    tables = [
        Table("Observed orders", rows, formats, detail=("h of the fit", "round-off", "from h")),
        Table("Largest error at each h", errors_at, {"h": ".4g", **dict.fromkeys(chosen, two_digits)}, detail=True),
    ]
    title = f"{base.name}: {base.top.title}, t from 0 to {base.duration:g}"
    columns: dict[str, Array] = {}
    for name, of_scheme in points.items():
        columns |= {f"{name}:h": np.array([*of_scheme]), f"{name}:error": np.array([*of_scheme.values()])}
    draw = partial(_draw, rows, columns, base.name)
    return Report("order", title, _answer(rows), tables, notes, [*broken, *false], code, base.resolved(), columns, draw)


def _row(name: str, experiment: Experiment, points: Mapping[float, float], extent: float) -> tuple[Row, str]:
    """Row of a scheme with these errors by step size, in a motion of this extent, and the reason of its verdict."""
    observed = convergence([*points], [*points.values()])
    declared = experiment.scheme.order_for(experiment.options) or 0
    verdict, why = judge_order(declared, observed, extent, partial(_consistent, experiment))
    finite = {h: error if math.isfinite(error) else math.inf for h, error in points.items()}
    best = min(finite, key=lambda h: finite[h], default=None)
    fitted = f"{two_digits(observed.fitted[0])} to {two_digits(observed.fitted[-1])}" if observed.fitted else None
    return {
        "scheme": name, "declared_order": declared, "order": observed.order, "verdict": str(verdict),
        "h of the fit": fitted, "round-off": observed.plateau, "from h": observed.onset,
        "smallest_error": None if best is None else points[best], "at_h": best,
    }, why  # fmt: skip


def _draw(rows: Sequence[Row], columns: Mapping[str, Array], title: str, axes: Any, looks: Callable[..., Any]) -> None:
    """Draw the errors of each scheme against h, with its observed order."""
    styles = looks([row["scheme"] for row in rows], markers=True)
    for row in rows:
        name = row["scheme"]
        if f"{name}:h" in columns:
            h, error = columns[f"{name}:h"], columns[f"{name}:error"]
            label = name if row["order"] is None else f"{name}: {row['order']:.2f}"
            error = np.where((error > 0.0) & (error < CEILING), error, np.nan)
            axes.loglog(h, error, label=label, markersize=4, **styles[name])
    axes.set(xlabel="step size $h$", ylabel="largest error", title=title.replace("$", r"\$"))


def _dividing(size: float, interval: float) -> float:
    """Step ``size``, rounded to a part of the ``interval`` between comparisons. Raises UsageError if it is none."""
    count = max(1, round(interval / size)) if size > 0.0 else 1
    if abs(interval / count - size) > 1e-9 * size:
        near = f"give for example {interval / count:g}"
        raise UsageError(f"--h {size:g}: must divide {interval:g}, the time between comparisons; {near}")
    return interval / count


def _consistent(experiment: Experiment) -> bool:
    """True if single steps of an experiment are consistent with the equations of motion."""
    return is_consistent(experiment.top, experiment.method(), np.array(experiment.y0))


def _without_order(experiment: Experiment) -> str:
    """Reason why the order of a scheme cannot be observed; empty if it can."""
    if experiment.scheme.adaptive:
        return "has no order in h: it chooses its steps by a tolerance"
    return "" if experiment.scheme.order_for(experiment.options) else "has no error that depends on h"


def _answer(rows: Sequence[Mapping[str, Any]]) -> str:
    """Schemes by verdict, with their observed orders."""
    named: dict[str, list[str]] = {}
    for row in sorted(rows, key=lambda row: row["verdict"] != "as declared"):
        observed = "" if row.get("order") is None else f" {row['order']:.2f}"
        named.setdefault(row["verdict"], []).append(row["scheme"] + observed)
    words = {"as declared": "order as declared"}
    return "; ".join(f"{words.get(verdict, verdict)}: {', '.join(names)}" for verdict, names in named.items())
