"""Figures of errors against the step size, for ``topcli order`` and for the map ``backlund``.

The latter compares errors and times, measured as by ``topcli bench``, on the motion of the generic scene.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from topcli.analysis.reference import reference_states
from topcli.config.load import load_experiment
from topcli.contracts import Scheme
from topcli.engine.fingerprint import fingerprint
from topcli.figures.curves import LOG, CurvePanel, curve_column, plain
from topcli.figures.figure import Loaded, Request, current_study
from topcli.figures.picture import Grid, caption, halo
from topcli.figures.style import Styles, looks
from topcli.runs.identity import method_fingerprint
from topcli.runs.report import finite
from topcli.schemes.display import display_name
from topcli.store.provenance import environment
from topcli.studies import order, order_ladders
from topcli.studies.bench.contest import Problem
from topcli.studies.bench.measure import Effort, SchemeCompetitor, as_rows, explore, time_all
from topcli.studies.entries import scheme_with
from topcli.studies.study import Result

SCENE = "kowalevski_generic_hk"
DURATION, INTERVALS = 100.0, 20
OTHERS = ("hk", "hybrid", "midpoint4", "splitting")
FAMILY = ("backlund", "backlund+suzuki4", "backlund+kahan-li6", "backlund+kahan-li8")
"""The integrable map and its compositions of orders 4, 6 and 8."""
NODES = "backlund:nodes=exact"
"""The integrable map with steps of several lengths that add up to the motion itself."""
EFFORT = Effort(budget=0.04, repetitions=3)
FILE = Path("error-and-cost") / "error-and-cost.json"
SCHEMA_VERSION = 1
LARGEST = 3.0
"""Largest error that is drawn: the size of the state."""
ORDERS = {"backlund+suzuki4": "order 4", "backlund+kahan-li6": "6", "backlund+kahan-li8": "8"}
LEVEL = 1e-8
"""Compositions have their orders written beside the point of about this error."""
ABSCISSAE = {"h": "step size $h$", "time": "CPU time per unit of time, µs"}


def column_name(scheme: str, kind: str) -> str:
    """Name of a column: ``kind`` is ``h``, ``error``, or ``time`` in microseconds per unit of simulated time."""
    return f"{scheme}:{kind}"


@dataclass(frozen=True)
class ErrorPanel:
    """Errors of the ``schemes`` over the columns of a kind, both logarithmic; with ``keys`` the legend is beside.

    Compositions have their orders written beside them.
    """

    schemes: tuple[str, ...]
    kind: str
    title: str
    keys: bool = False

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the curves into ``axes``."""
        axes.set(xscale="log", yscale="log")
        styles_of = looks(self.schemes, markers=True)
        for scheme in self.schemes:
            x, y = data[column_name(scheme, self.kind)], data[column_name(scheme, "error")]
            shown = np.isfinite(x) & (y > 0.0) & (y <= LARGEST)
            style = {**styles_of[scheme], "markersize": 4.0}
            if scheme == NODES:
                style |= {"linestyle": "none", "markersize": 5.0}
            axes.plot(x[shown], y[shown], label=display_name(scheme), lw=1.0, mew=0.4, **style)
            if scheme in ORDERS and shown.any():
                at = int(np.argmin(np.abs(np.log(y[shown] / LEVEL))))
                left = (self.kind == "h") != (scheme == FAMILY[-1])  # to the outer side of the curves
                look = {"ha": "right" if left else "left", "va": "center", "fontsize": 8.5}
                place = {"xytext": (-5 if left else 5, 0), "textcoords": "offset points"}
                halo(axes.annotate(ORDERS[scheme], (x[shown][at], y[shown][at]), **place, **look))
        axes.set_ylim(top=2.0 * LARGEST)
        caption(axes, ABSCISSAE[self.kind], "largest error", self.title)
        if self.keys:
            axes.legend(loc="upper left", bbox_to_anchor=(1.02, 1.02), fontsize=8.5, borderaxespad=0.0)


def points_of(row: Mapping[str, Any], key: str) -> np.ndarray:
    """Values (m,) of the points of a scheme; those that are missing are nan."""
    return np.array([point[key] for point in row["points"]], dtype=float)


def load_error_and_cost(request: Request) -> Loaded:
    """Load the study of errors and times, measured if it is missing, out of date or forced."""
    source = study_source()
    measured = partial(error_and_cost, problem(), compared_schemes())
    study = current_study(request, FILE, SCHEMA_VERSION, "topcli plot error-and-cost", source, measured)
    return loaded_study(study, source)


def loaded_study(study: Mapping[str, Any], source: str) -> Loaded:
    """The figure of a study."""
    data = {}
    for row in study["schemes"]:
        for kind, key, factor in (("h", "h", 1.0), ("time", "seconds", 1e6), ("error", "error", 1.0)):
            data[column_name(row["scheme"], kind)] = factor * points_of(row, key)
    schemes = tuple(row["scheme"] for row in study["schemes"] if row["points"])
    heading = rf"Kowalevski top, generic motion, $0 \leq t \leq {study['duration']:g}$"
    panels = (
        ErrorPanel(schemes, "h", "(a) against the step size"),
        ErrorPanel(schemes, "time", "(b) against the computing time", keys=True),
    )
    measured = [[row["scheme"], [point["seconds"] for point in row["points"]]] for row in study["schemes"]]
    return Loaded(
        panels, lambda: data, {"study": source, "measured": measured}, Grid(figsize=(7.0, 3.3), heading=heading)
    )


def compared_schemes() -> list[Scheme]:
    """Schemes of the study, in the order of the figure."""
    form = problem().top.form
    return [scheme_with(name, form) for name in (*OTHERS, *FAMILY, NODES)]


def problem() -> Problem:
    """Motion and times of the comparison."""
    experiment = load_experiment(SCENE)
    return Problem(experiment.name, experiment.top.title, experiment, DURATION, INTERVALS)


def error_and_cost(
    what: Problem, schemes: Sequence[Scheme], on_progress: Callable[[int, int], None] = lambda done, total: None
) -> dict[str, Any]:
    """Measure errors and times of the ``schemes`` over their ladders of step sizes; plain data, ready for JSON.

    Errors are the largest Euclidean norms of the difference of states from the Taylor reference in double-double
    arithmetic at the common times, times CPU seconds per unit of simulated time.
    """
    reference = reference_states(what.top, what.experiment.y0, what.times)
    measured = [explore(SchemeCompetitor(one, what), what, reference, EFFORT) for one in schemes]
    time_all(measured, EFFORT, on_progress)
    rows = [
        {
            "scheme": one.competitor.name,
            "ended": one.ended,
            "failed": [{"h": value, "reason": reason} for value, reason in one.failed],
            "points": [{"h": row["value"], **row} for row in as_rows(one, what.duration)],
        }
        for one in measured
    ]
    return finite(
        {
            "schema_version": SCHEMA_VERSION,
            "name": what.name,
            "top": what.title,
            "config": what.experiment.resolved(),
            "duration": what.duration,
            "intervals": what.intervals,
            "schemes": rows,
            "environment": environment(),
        }
    )


def study_source() -> str:
    """Digest of everything that the errors of a study depend on."""
    what = problem()
    codes = [method_fingerprint(one.build(what.top, one.options())) for one in compared_schemes()]
    code = fingerprint(error_and_cost, explore, time_all, reference_states, compiled=False)
    text = json.dumps([what.experiment.digest, what.duration, what.intervals, codes, code])
    return hashlib.sha256(text.encode()).hexdigest()


CEILING = 1e3
"""Errors above this one, of step sizes at which a scheme explodes, are drawn at the upper edge."""


def order_data(study: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Columns of a study: step sizes and errors of each scheme; an error that is not finite is nan."""
    data = {}
    for row in study["schemes"]:
        for kind, key in (("x", "h"), ("y", "error")):
            data[curve_column(row["scheme"], kind)] = points_of(row, key)
    return data


def loaded_order(result: Result) -> Loaded:
    """The figure of a study of orders."""
    study = result.data
    labels = tuple(row["scheme"] for row in study["schemes"] if row["points"])
    span = rf"largest error, $0 \leq t \leq {study['duration']:g}$"
    panel = CurvePanel(
        labels,
        "step size $h$",
        span,
        True,
        LOG,
        ceiling=CEILING,
        title=plain(f"{study['top'].partition(' (')[0]} ({study['name']})"),
        legend="scheme: order",
    )
    source = {"study": result.source(), "code": fingerprint(order_data, compiled=False)}
    return Loaded((panel,), lambda: order_data(study), source, Grid(figsize=(6.4, 3.8)))


def load_order(request: Request) -> Loaded:
    """Load the default study of ``topcli order``, run if it is missing, out of date or forced."""
    what = order_ladders.ladders(())
    source, measured = order_ladders.order_source(what), partial(order_ladders.order_study, what)
    study = current_study(request, order.FILE, order_ladders.SCHEMA_VERSION, "topcli order", source, measured)
    return loaded_order(Result(study, source=lambda: source))
