"""The figure of speed against error: one panel per scene, drawn from finished results of ``topcli bench``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from topcli.figures.contract import Figure, Loaded, NothingMeasuredError, Request
from topcli.figures.picture import Grid, Styles

FOLDER = "bench"
"""Folder of the results in the folder of the run folders."""
WORST_ERROR = 1.0
"""Largest error that is drawn."""
MOST_OF_OURS = 7
"""Number of our schemes that are drawn, the nearest to the front; there are no more distinct colours."""
_SIZE = 6.8
"""Font size of the labels."""
_LETTER = 0.0163
"""Width of a letter of this size, relative to the axes."""


@dataclass(frozen=True)
class Curve:
    """Curve of one competitor, a scheme of topcli if ``ours``."""

    name: str
    ours: bool


@dataclass(frozen=True)
class WorkPrecision:
    """CPU time per unit of simulated time over the largest error, both logarithmic, for one ``scene``."""

    scene: str
    title: str
    curves: tuple[Curve, ...]
    colours: tuple[str, ...]
    """Names of our schemes in the figure, by colour."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns that the panel draws."""
        return tuple(column_name(self.scene, curve.name, kind) for curve in self.curves for kind in ("error", "time"))

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the curves into ``axes``, with labels at their ends instead of a legend."""
        import matplotlib as mpl

        cycle = [style["color"] for style in mpl.rcParams["axes.prop_cycle"]]
        ends: list[tuple[float, float, str, str]] = []
        axes.set(xscale="log", yscale="log")
        for curve in sorted(self.curves, key=lambda curve: curve.ours):
            error, time = (data[column_name(self.scene, curve.name, kind)] for kind in ("error", "time"))
            error, time = error[np.isfinite(error)], 1e6 * time[np.isfinite(error)]
            colour = cycle[self.colours.index(curve.name) % len(cycle)] if curve.ours else "0.65"
            width = 1.3 if curve.ours else 0.9
            axes.plot(error, time, "-", marker=".", color=colour, lw=width, ms=3.0, mew=0.0, zorder=2 + curve.ours)
            ends.append((float(error[-1]), float(time[-1]), curve.name, colour if curve.ours else "0.45"))
        span = max(-math.log10(error) / (1.0 - _LETTER * len(name)) for error, _, name, _ in ends)
        axes.set_xlim(WORST_ERROR, 10.0**-span)
        _label(axes, ends, span)
        axes.set_xlabel("largest error over the run")
        axes.set_ylabel("CPU time per unit of time, µs")
        axes.set_title(self.title, loc="left")


def _label(axes: Any, ends: Sequence[tuple[float, float, str, str]], span: float) -> None:
    """Label the ends of the curves, moved up if labels would overlap.

    ``ends`` are (error, time, name, colour); ``span`` is the number of decades on the axis of errors.
    """
    from matplotlib.patheffects import withStroke

    low, high = (math.log10(limit) for limit in axes.get_ylim())
    gap = 0.036 * (high - low)
    placed: list[tuple[float, float, float]] = []
    for error, time, name, colour in sorted(ends, key=lambda end: end[1]):
        x, y = -math.log10(error), math.log10(time)
        width = _LETTER * len(name) * span
        for left, right, height in sorted(placed, key=lambda one: one[2]):
            if x < right and left < x + width and abs(y - height) < gap:
                y = height + gap
        placed.append((x, x + width, y))
        text = axes.annotate(
            name,
            (error, 10.0**y),
            xytext=(3.5, 0.0),
            textcoords="offset points",
            color=colour,
            fontsize=_SIZE,
            va="center",
            zorder=5,
        )
        text.set_path_effects([withStroke(linewidth=1.6, foreground="white")])
    axes.set_ylim(10.0**low, 10.0 ** max(high, *(height + gap for *_, height in placed)))


def column_name(scene: str, competitor: str, kind: str) -> str:
    """Name of a column of the data; ``kind`` is ``error``, or ``time`` in seconds per unit of time."""
    return f"{scene}:{competitor}:{kind}"


def _nearest_to_front(report: dict[str, Any]) -> dict[str, float]:
    """Smallest ratio of the time of each of our schemes to the fastest, over the decades of error: 1 or more."""
    from topcli.studies.bench.front import DECADES, ranking

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
    from topcli.analysis.pareto import pareto_front
    from topcli.studies.bench.front import points_of

    found = {}
    for competitor in report["competitors"]:
        ours = competitor["kind"] == "topcli"
        points = [point for point in points_of(competitor) if point.error <= WORST_ERROR]
        best = [points[i] for i in pareto_front(points) if points[i].error > 0.0]
        if len(best) > 1 and (not ours or competitor["name"] in shown):
            errors, seconds = (np.array([getattr(point, key) for point in best]) for key in ("error", "seconds"))
            found[Curve(competitor["name"], ours)] = errors, seconds
    return found


def _shown(reports: Sequence[dict[str, Any]]) -> tuple[str, ...]:
    """Names of our schemes that are drawn, the nearest to the front first."""
    nearness: dict[str, float] = {}
    for report in reports:
        for name, factor in _nearest_to_front(report).items():
            nearness[name] = min(nearness.get(name, math.inf), factor)
    return tuple(sorted(nearness, key=lambda name: (nearness[name], name))[:MOST_OF_OURS])


class WorkPrecisionFigure(Figure):
    """Finished results of ``topcli bench``; nothing is measured for the figure."""

    def load(self, request: Request) -> Loaded:
        """Return panels and data of the results. Raises NothingMeasuredError if there are none, and RunError."""
        from topcli.studies.bench.scenes import SCENES
        from topcli.studies.bench.stored import stored_benches

        folder = request.results / FOLDER
        benches = stored_benches(folder)
        if not benches:
            raise NothingMeasuredError(f"no finished result in {folder}; topcli bench makes one in a few minutes")
        order = list(SCENES)
        benches.sort(key=lambda bench: order.index(bench[1]["name"]) if bench[1]["name"] in order else len(order))
        reports = [report for _, report in benches]
        shown = _shown(reports)
        panels: list[WorkPrecision] = []
        data: dict[str, np.ndarray] = {}
        for report in reports:
            curves = _curves(report, shown)
            if not curves:
                continue
            panels.append(WorkPrecision(report["name"], report["title"], tuple(curves), shown))
            for curve, values in curves.items():
                for kind, column in zip(("error", "time"), values, strict=True):
                    data[column_name(report["name"], curve.name, kind)] = column
        made_from = [[run.manifest[key] for key in ("name", "digest", "code", "ended")] for run, _ in benches]
        return Loaded(panels, lambda: data, {"benches": made_from}, Grid(-(-len(benches) // 2), (7.0, 6.4)))
