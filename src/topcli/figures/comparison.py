"""Figures that compare schemes, for ``topcli compare``, ``topcli analyse`` and ``topcli bench``.

The first two show errors and swings over time, of schemes and of a series. The figure ``work-precision`` has a panel
for each scene with a finished result of ``topcli bench``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from topcli.analysis.swings import minima_times
from topcli.config.load import load_experiment
from topcli.errors import UsageError
from topcli.figures.curves import plain
from topcli.figures.figure import Loaded, NothingMeasuredError, Request
from topcli.figures.picture import Grid, Line, Panel, below_panels, caption, component_symbol, number_text
from topcli.figures.style import MARKERS, REFERENCE, Styles, looks
from topcli.schemes.display import display_name
from topcli.studies.bench.contest import SCENES
from topcli.studies.bench.result import DECADES, SETUP, pareto_front, points_of, ranking, stored_benches
from topcli.studies.study import Result

SAME = 0.01
"""Schemes whose errors differ by less than this part of them at all times are drawn as one curve."""
START = 100
"""Number of parts of the rows, the first of which may be left out of the scale of the errors ..."""
EMPTY = 30.0
"""... if the scale becomes shorter by this factor without it."""
LAST = 3
"""Number of swings that are shown of a run with more than twice as many."""


def groups(labels: Sequence[str], data: Mapping[str, np.ndarray]) -> list[list[str]]:
    """Labels whose errors coincide, in the order of the first of each group."""
    alike: list[list[str]] = []
    for label in labels:
        mine = data[f"error:{label}"]
        for group in alike:
            other = data[f"error:{group[0]}"]
            if (np.isnan(mine) == np.isnan(other)).all() and np.nanmax(np.abs(mine / other - 1.0), initial=0.0) < SAME:
                group.append(label)
                break
        else:
            alike.append([label])
    return alike


def last_swings(t: np.ndarray, values: np.ndarray) -> tuple[float, str]:
    """Time from which the swings of a component are shown, and a note if that is not the start."""
    times = minima_times(t, values)
    if len(times) <= 2 * LAST:
        return float(t[0]), ""
    return float(times[-LAST - 1] + times[-LAST]) / 2.0, f", last {LAST} of {len(times)} swings"


def _least(errors: np.ndarray) -> float:
    """Half of the smallest of the errors after the first of the rows, in which errors begin at nothing."""
    later = errors[len(errors) // START :]
    return 0.5 * float(np.nanmin(later)) if np.isfinite(later).any() else np.nan


@dataclass(frozen=True)
class ErrorsOverTime:
    """Errors of the schemes ``labels`` over time; one curve for schemes that coincide, named as such.

    Much smaller errors at the very start are below the scale.
    """

    labels: tuple[str, ...]

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the curves into ``axes``, and a legend below all panels."""
        alike = groups(self.labels, data)
        own = looks(group[0] for group in alike)
        for group in alike:
            axes.plot(data["t"], data[f"error:{group[0]}"], label=" ≈ ".join(map(display_name, group)), **own[group[0]])
        axes.set(xlabel="time $t$", ylabel="error of the state", yscale="log", xlim=(data["t"][0], data["t"][-1]))
        low = min((_least(data[f"error:{group[0]}"]) for group in alike), default=np.nan)
        if np.isfinite(low) and low > EMPTY * axes.get_ylim()[0]:
            axes.set_ylim(bottom=low)
        axes.set_title("(a)", loc="left")
        handles, texts = axes.get_legend_handles_labels()
        below_panels(axes.figure, handles, texts, min(5, len(alike)))


@dataclass(frozen=True)
class SwingPanel:
    """A row for each scheme, in which ``symbol``, the swinging component, is drawn over the reference in grey.

    Schemes that coincide share a row. Of many swings the last are shown. The scale on the right is that of the lowest
    row.
    """

    labels: tuple[str, ...]
    symbol: str

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the rows into ``axes``, the first scheme at the top."""
        t, reference = data["t"], data[f"swing:{REFERENCE}"]
        alike = groups(self.labels, data)
        own = looks(group[0] for group in alike)
        start, note = last_swings(t, reference)
        low, high = float(np.nanmin(reference)), float(np.nanmax(reference))
        size = 1.35 * (high - low or 1.0)
        names = []
        for i, group in enumerate(alike):
            up = (len(alike) - 1 - i) * size
            near = np.clip(data[f"swing:{group[0]}"], low - 0.1 * size, high + 0.1 * size)
            axes.plot(t, reference + up, **styles[REFERENCE])
            axes.plot(t, near + up, **{**own[group[0]], "linestyle": "-"})
            names.append((up + 0.5 * (low + high), "\n≈ ".join(map(display_name, group))))
        axes.set_yticks(*zip(*names, strict=True), fontsize="small")
        axes.set(xlabel="time $t$", xlim=(start, t[-1]), ylim=(low - 0.2 * size, high + (len(alike) - 0.8) * size))
        axes.tick_params(axis="y", length=0)
        axes.grid(visible=False, axis="y")
        axes.set_title(f"(b) {self.symbol}, reference in grey{note}", loc="left")
        scale = axes.secondary_yaxis("right")
        scale.set_yticks([low, high], [f"${end:.3g}$" for end in (low, high)], fontsize="small")


def _panels(labels: Sequence[str], component: str) -> tuple[ErrorsOverTime, SwingPanel]:
    """Errors (left) and the swinging component (right)."""
    return ErrorsOverTime(tuple(labels)), SwingPanel(tuple(labels), component_symbol(component))


def _layout(labels: Sequence[str], what: str, h: float) -> Grid:
    """Two panels with room for a row for each scheme, under the name of ``what`` is computed and the step size."""
    height = min(9.0, 1.8 + 0.32 * max(5, len(labels)))
    return Grid(figsize=(7.0, height), heading=f"{what}, $h = {number_text(h)}$")


def _data(comparison: Result) -> dict[str, np.ndarray]:
    """Series of a comparison; errors of zero become nan because a logarithmic axis has no zero."""
    return {
        name: np.where(values > 0.0, values, np.nan) if name.startswith("error:") else values
        for name, values in comparison.arrays.items()
    }


def loaded_comparison(comparison: Result) -> Loaded:
    """The figure of ``topcli compare``; without panels for a stored result without its series."""
    data = comparison.data
    labels = [scheme["label"] for scheme in data["schemes"]]
    source = {"config": data["config"], "schemes": labels}
    if not comparison.arrays:  # of a file that --json wrote
        return Loaded((), dict, source)
    panels = _panels(labels, data["reference"]["swing"])
    return Loaded(
        panels, lambda: _data(comparison), source, _layout(labels, plain(data["config"]["name"]), data["config"]["h"])
    )


def comparison_curves(comparison: Result, what: str = "error") -> tuple[Panel, Mapping[str, np.ndarray]]:
    """Panel of the errors over time, or with ``what="swing"`` of the swinging component, and its data.

    Raises UsageError for any other word.
    """
    labels = [scheme["label"] for scheme in comparison.data["schemes"]]
    if what == "error":
        lines = tuple(Line(f"error:{label}", display_name(label)) for label in labels)
        return Panel(lines, "error of the state", log=True), _data(comparison)
    if what == "swing":
        lines = tuple(Line(f"swing:{label}", display_name(label)) for label in (REFERENCE, *labels))
        return Panel(lines, component_symbol(comparison.data["reference"]["swing"])), comparison.arrays
    raise UsageError(f"plot: what={what!r} must be 'error' or 'swing'")


SERIES = "series"
"""Label of the analysed series."""


def _analysis_data(analysis: Result) -> dict[str, np.ndarray]:
    """Columns of the figure; zeros of logarithmic panels become nan."""
    linear = ("t", "swing", "swing:reference")
    return {
        name: values if name in linear else np.where(values > 0.0, values, np.nan)
        for name, values in analysis.arrays.items()
    }


def loaded_analysis(analysis: Result) -> Loaded:
    """The figure of ``topcli analyse``, without lines that are zero throughout or need a missing reference.

    Raises UsageError for a stored result without its series.
    """
    if not analysis.arrays:
        raise UsageError("the series is not in this file")
    data, report = _analysis_data(analysis), analysis.data
    top = load_experiment(report["config"], any_precision=True).top
    swings = [Line("swing", SERIES)]
    panels = []
    if "error" in data:
        swings.insert(0, Line("swing:reference", REFERENCE))
        if np.isfinite(data["error"]).any():
            panels.append(Panel((Line("error", SERIES),), "error of the state", log=True))
    panels.append(Panel(tuple(swings), component_symbol(top.swing)))
    moving = [each for each in top.invariants() if np.isfinite(data[f"deviation:{each.name}"]).any()]
    if moving:
        lines = tuple(Line(f"deviation:{each.name}", f"${each.tex}$") for each in moving)
        panels.append(Panel(lines, "deviation of the invariants", log=True))
    return Loaded(tuple(panels), lambda: data, {key: report[key] for key in ("config", "file", "sha256")})


FOLDER = "bench"
"""Folder of the results in the folder of the run folders."""
WORST_ERROR = 1.0
"""Largest error that is drawn."""
MOST_OF_OURS = 7
"""Number of our schemes that are drawn, the nearest to the front; there are no more distinct colours."""


@dataclass(frozen=True)
class CompetitorCurve:
    """Curve of one competitor, a scheme of topcli if ``ours``; ``setup`` if it has a set-up, which is not counted."""

    name: str
    ours: bool
    setup: bool = False

    @property
    def label(self) -> str:
        """Label in the legend."""
        name = display_name(self.name) if self.ours else self.name
        return f"{name} (after its set-up)" if self.setup else name


@dataclass(frozen=True)
class WorkPrecision:
    """CPU time per unit of simulated time over the largest error, both logarithmic, for one ``scene``."""

    scene: str
    title: str
    curves: tuple[CompetitorCurve, ...]
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
    found: dict[str, float] = {}
    ours = {competitor["name"] for competitor in report["competitors"] if competitor["kind"] == "topcli"}
    for error in DECADES:
        ranked = ranking(report["competitors"], error)
        for entry in ranked:
            if entry["name"] in ours:
                factor = entry["seconds"] / ranked[0]["seconds"]
                found[entry["name"]] = min(found.get(entry["name"], math.inf), factor)
    return found


def _curves(report: dict[str, Any], shown: Sequence[str]) -> dict[CompetitorCurve, tuple[np.ndarray, np.ndarray]]:
    """Errors and seconds of the curves of one result: every peer, and our schemes that are ``shown``."""
    found = {}
    for competitor in report["competitors"]:
        ours = competitor["kind"] == "topcli"
        points = [point for point in points_of(competitor) if point.error <= WORST_ERROR]
        best = [points[i] for i in pareto_front(points) if points[i].error > 0.0]
        if best and (not ours or competitor["name"] in shown):
            errors, seconds = (np.array([getattr(point, key) for point in best]) for key in ("error", "seconds"))
            curve = CompetitorCurve(competitor["name"], ours, competitor["setup_seconds"] > SETUP)
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
    return Loaded(panels, lambda: data, {"benches": made_from}, layout)
