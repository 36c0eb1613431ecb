"""The figure of speed against error: one panel per scene, drawn from finished results of ``topcli bench``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from topcli.engine.fingerprint import fingerprint
from topcli.figures.figure import Loaded, NothingMeasuredError, Request
from topcli.figures.picture import MARKERS, Grid, Styles, caption, looks

FOLDER = "bench"
"""Folder of the results in the folder of the run folders."""
WORST_ERROR = 1.0
"""Largest error that is drawn."""
MOST_OF_OURS = 7
"""Number of our schemes that are drawn, the nearest to the front; there are no more distinct colours."""


@dataclass(frozen=True)
class Curve:
    """Curve of one competitor, a scheme of topcli if ``ours``; ``setup`` if it has a set-up, which is not counted."""

    name: str
    ours: bool
    setup: bool = False

    @property
    def label(self) -> str:
        """Label in the legend."""
        return f"{self.name} (after its set-up)" if self.setup else self.name


@dataclass(frozen=True)
class WorkPrecision:
    """CPU time per unit of simulated time over the largest error, both logarithmic, for one ``scene``."""

    scene: str
    title: str
    curves: tuple[Curve, ...]
    colours: tuple[str, ...]
    """Names of our schemes in the figure, by colour."""
    peers: tuple[str, ...] = ()
    """Names of the other integrators in the figure, by marker."""

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the curves into ``axes``: our schemes in colours, others in grey, all with different markers."""
        own = looks(self.colours, markers=True)
        axes.set(xscale="log", yscale="log")
        least = WORST_ERROR
        for curve in sorted(self.curves, key=lambda curve: curve.ours):
            error, time = (data[column_name(self.scene, curve.name, kind)] for kind in ("error", "time"))
            error, time = error[np.isfinite(error)], 1e6 * time[np.isfinite(error)]
            least = min(least, float(error.min()))
            if curve.ours:
                look: dict[str, Any] = {**own[curve.name], "lw": 1.2}
            else:
                marker = MARKERS[self.peers.index(curve.name) % len(MARKERS)]
                look = {"color": "0.55", "linestyle": "-", "lw": 0.8, "mfc": "white", "marker": marker}
            axes.plot(error, time, ms=3.2, mew=0.7, zorder=2 + curve.ours, label=curve.label, **look)
        axes.set_xlim(2.0 * WORST_ERROR, least / 3.0)
        caption(axes, "largest error over the run; more accurate →", "CPU time per unit of time, µs", self.title)


def column_name(scene: str, competitor: str, kind: str) -> str:
    """Name of a column of the data; ``kind`` is ``error``, or ``time`` in seconds per unit of time."""
    return f"{scene}:{competitor}:{kind}"


def _nearest_to_front(report: dict[str, Any]) -> dict[str, float]:
    """Smallest ratio of the time of each of our schemes to the fastest, over the decades of error: 1 or more."""
    from topcli.studies.bench.result import DECADES, ranking

    found: dict[str, float] = {}
    ours = {competitor["name"] for competitor in report["competitors"] if competitor["kind"] == "topcli"}
    for error in DECADES:
        ranked = ranking(report["competitors"], error)
        for entry in ranked:
            if entry["name"] in ours:
                factor = entry["seconds"] / ranked[0]["seconds"]
                found[entry["name"]] = min(found.get(entry["name"], math.inf), factor)
    return found


def _curves(report: dict[str, Any], shown: Sequence[str]) -> dict[Curve, tuple[np.ndarray, np.ndarray]]:
    """Errors and seconds of the curves of one result: every peer, and our schemes that are ``shown``."""
    from topcli.studies.bench.result import SETUP, pareto_front, points_of

    found = {}
    for competitor in report["competitors"]:
        ours = competitor["kind"] == "topcli"
        points = [point for point in points_of(competitor) if point.error <= WORST_ERROR]
        best = [points[i] for i in pareto_front(points) if points[i].error > 0.0]
        if best and (not ours or competitor["name"] in shown):
            errors, seconds = (np.array([getattr(point, key) for point in best]) for key in ("error", "seconds"))
            curve = Curve(competitor["name"], ours, competitor["setup_seconds"] > SETUP)
            found[curve] = errors, seconds
    return found


def _shown(reports: Sequence[dict[str, Any]]) -> tuple[str, ...]:
    """Names of our schemes that are drawn, the nearest to the front first."""
    nearness: dict[str, float] = {}
    for report in reports:
        for name, factor in _nearest_to_front(report).items():
            nearness[name] = min(nearness.get(name, math.inf), factor)
    return tuple(sorted(nearness, key=lambda name: (nearness[name], name))[:MOST_OF_OURS])


def load_work_precision(request: Request) -> Loaded:
    """Load finished results of ``topcli bench``; nothing is measured for the figure.

    Raises NothingMeasuredError if there are none, and RunError.
    """
    from topcli.studies.bench.contest import SCENES
    from topcli.studies.bench.result import stored_benches

    folder = request.results / FOLDER
    benches = stored_benches(folder)
    if not benches:
        raise NothingMeasuredError(f"no finished result in {folder}; topcli bench makes one in a few minutes")
    order = list(SCENES)
    benches.sort(key=lambda bench: order.index(bench[1]["name"]) if bench[1]["name"] in order else len(order))
    reports = [report for _, report in benches]
    shown = _shown(reports)
    drawn = [(report, curves) for report in reports if (curves := _curves(report, shown))]
    peers = tuple(dict.fromkeys(curve.name for _, curves in drawn for curve in curves if not curve.ours))
    panels: list[WorkPrecision] = []
    data: dict[str, np.ndarray] = {}
    for report, curves in drawn:
        panels.append(WorkPrecision(report["name"], report["title"], tuple(curves), shown, peers))
        for curve, values in curves.items():
            for kind, column in zip(("error", "time"), values, strict=True):
                data[column_name(report["name"], curve.name, kind)] = column
    made_from = [[run.manifest[key] for key in ("name", "digest", "code", "ended")] for run, _ in benches]
    rows = -(-len(panels) // 2)
    labels = {curve.name: curve.label for _, curves in drawn for curve in curves}
    first = tuple(labels.get(name, name) for name in (*shown, *peers))
    layout = Grid(rows, (7.0, 1.0 + 2.8 * rows), ncols=3, first=first)
    code = fingerprint(_shown, _curves, compiled=False)
    return Loaded(panels, lambda: data, {"benches": made_from, "code": code}, layout)
