"""Speed against error as a picture: a panel a scene, drawn from the finished results of ``topcli bench``."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from topcli.figures.picture import NothingMeasuredError, Styles

FOLDER = "bench"
"""Where results lie, below the folder of the run folders."""
WORST_ERROR = 1.0
"""Curves are drawn from this error on."""
MOST_OF_OURS = 7
"""So many of our schemes are drawn, those that come nearest to the front: there are no more colours to tell apart."""
_SIZE = 6.8
_LETTER = 0.0163
"""A letter of this size takes so much of the width of the axes."""


@dataclass(frozen=True)
class Curve:
    """One competitor's curve: its ``name``, and whether it is one of ours."""

    name: str
    ours: bool


@dataclass(frozen=True)
class WorkPrecision:
    """CPU time per unit of simulated time over the largest error, both logarithmic, for one ``scene``."""

    scene: str
    title: str
    curves: tuple[Curve, ...]
    colours: tuple[str, ...]
    """The names of ours in the figure, by colour."""
    figsize: tuple[float, float] = (7.0, 6.4)
    rows: int = 1

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns that it draws."""
        return tuple(column_name(self.scene, curve.name, kind) for curve in self.curves for kind in ("error", "time"))

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw into ``axes``: labels at the curves' ends instead of a legend."""
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
    """The names at the ends of the curves, moved up where they would lie on one another.

    ``ends`` are (error, time, name, colour); the axis of errors spans so many decades.
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
    """The column of the figure's data: ``kind`` is ``error``, or ``time`` in seconds per unit of time."""
    return f"{scene}:{competitor}:{kind}"


def _nearest_to_front(report: dict[str, Any]) -> dict[str, float]:
    """For each of our schemes how near it comes to the fastest at some decade of error: a factor of 1 or more."""
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
    """Errors and seconds of what is drawn of one result: every peer, and those of ours that are ``shown``."""
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


def work_precision(results: Path) -> tuple[list[WorkPrecision], dict[str, np.ndarray], str]:
    """The panels, their data and what they were made from, of the finished benches below ``results``.

    Nothing is measured here. Raises NothingMeasuredError where there is no result, RunError for a damaged one.
    """
    from topcli.studies.bench.scenes import SCENES
    from topcli.studies.bench.stored import stored_benches

    folder = results / FOLDER
    benches = stored_benches(folder)
    if not benches:
        raise NothingMeasuredError(f"there is no finished result in {folder}; topcli bench makes it, in some minutes")
    order = list(SCENES)
    benches.sort(key=lambda bench: order.index(bench[1]["name"]) if bench[1]["name"] in order else len(order))
    nearness: dict[str, float] = {}
    for _, report in benches:
        for name, factor in _nearest_to_front(report).items():
            nearness[name] = min(nearness.get(name, math.inf), factor)
    shown = tuple(sorted(nearness, key=lambda name: (nearness[name], name))[:MOST_OF_OURS])
    panels, data = [], {}
    for _, report in benches:
        curves = _curves(report, shown)
        if not curves:
            continue
        panels.append(WorkPrecision(report["name"], report["title"], tuple(curves), shown, rows=-(-len(benches) // 2)))
        for curve, values in curves.items():
            for kind, column in zip(("error", "time"), values, strict=True):
                data[column_name(report["name"], curve.name, kind)] = column
    longest = max(map(len, data.values()))
    data = {name: np.append(values, np.full(longest - len(values), np.nan)) for name, values in data.items()}
    source = json.dumps([[run.manifest[key] for key in ("name", "digest", "code", "ended")] for run, _ in benches])
    return panels, data, source
