"""A torus of the Kowalevski top in a projection to three dimensions, with the lines of the flows of E and k².

The surface is drawn as small facets from back to front. A line is cut where the surface hides it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from topcli.engine.fingerprint import fingerprint
from topcli.errors import UsageError
from topcli.figures.figure import Loaded, Request
from topcli.figures.picture import Grid, Styles
from topcli.figures.scene3d import arrow, lit, projection, split
from topcli.figures.scenes import scene_config

AXES = ("x", "y", "z")
PROJECTION = np.array([[2.0, 0, 0, 0, 0, 0], [0, 1.0, 0.5, 0, 0, 0], [0, 0, 0, 0, -1.0, 1.0]])
"""Coordinates of the picture. In those of a state some parts of every torus coincide, because of its symmetries."""
LABELS = (r"$2\omega_1$", r"$\omega_2+\frac{1}{2}\omega_3$", r"$\gamma_3-\gamma_2$")
ROWS, COLUMNS = 64, 128
"""Points of the surface along the first and the second angle."""
FINER, FINEST = 4, 12
"""Facets, and points of the map of depths, for each point of the surface in both directions."""
LINES: dict[str, tuple[str, str, Any]] = {
    "energy": ("flow of $E$", "#B2182B", "-"),
    "k_sq": ("flow of $k^2$", "#1F4E9C", (0, (5, 1.5))),
}
"""Kinds of lines: labels, colours and dashes."""
COUNT, POINTS = 12, 361
MIDDLE = 0.25
"""Middle of the lines of the energy, in periods of the second angle from the initial state; their ends are behind."""
RETURNS = 1.6
"""Periods of the second angle for which the motion itself is drawn."""
CELLS = 400
"""Cells of the map of depths across the picture."""
SURFACE = np.array([0.93, 0.90, 0.82])


@dataclass(frozen=True)
class TorusPanel:
    """Torus seen from ``elevation`` and ``azimuth`` in degrees.

    The columns are ``surface:``, ``energy:``, ``k_sq:`` and ``motion:`` with the coordinates; the lines of a flow are
    separated by nan. The motion begins at the initial state.
    """

    elevation: float
    azimuth: float

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the torus into ``axes``."""
        view = projection(self.elevation, self.azimuth)
        surface = np.stack([data[f"surface:{name}"][: ROWS * COLUMNS].reshape(ROWS, COLUMNS) for name in AXES], -1)
        depths = _Depths(_refined(surface, FINEST) @ view.T)
        _facets(axes, _refined(surface, FINER), view)
        for part, (label, colour, dashes) in LINES.items():
            line = _points(data, part) @ view.T
            axes.plot(*split(line, depths.visible(line))[0].T, color=colour, ls=dashes, lw=0.8, label=label, zorder=4)
        _motion(axes, _points(data, "motion") @ view.T, depths)
        _triad(axes, view, depths)
        axes.set_aspect("equal")
        axes.set_axis_off()
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.02), ncols=4, fontsize=9)


def _points(data: Mapping[str, np.ndarray], part: str) -> np.ndarray:
    """Points (m, 3) of some lines."""
    points = np.column_stack([data[f"{part}:{name}"] for name in AXES])
    return points[: np.flatnonzero(np.isfinite(points[:, 0]))[-1] + 1]


def _refined(surface: np.ndarray, times: int) -> np.ndarray:
    """The periodic surface (rows, columns, 3), closed, with more points both ways by trigonometric interpolation."""
    for axis in (0, 1):
        count = surface.shape[axis]
        series = np.fft.rfft(surface, axis=axis)
        surface = np.fft.irfft(series, n=times * count, axis=axis) * times
    return np.pad(surface, ((0, 1), (0, 1), (0, 0)), mode="wrap")


class _Depths:
    """Largest depth towards the viewer of a projected surface (..., 3), in square cells of the picture."""

    def __init__(self, points: np.ndarray) -> None:
        flat = points.reshape(-1, 3)
        self.low, self.high = flat.min(axis=0), flat.max(axis=0)
        self.cell = float((self.high[:2] - self.low[:2]).max()) / CELLS
        self.map = np.full((CELLS + 3, CELLS + 3), -np.inf)
        np.maximum.at(self.map, self._cells(flat), flat[:, 2])
        self.tolerance = 0.012 * float((self.high - self.low).max())

    def _cells(self, flat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        at = np.nan_to_num((flat[:, :2] - self.low[:2]) / self.cell)
        return tuple(np.clip(at.astype(int) + 1, 0, CELLS + 2).T)

    def visible(self, line: np.ndarray) -> np.ndarray:
        """True for the points (m, 3) that no part of the surface hides; short gaps are closed."""
        seen = line[:, 2] >= self.map[self._cells(line)] - self.tolerance
        return _without_short_runs(_without_short_runs(seen, False), True)


def _without_short_runs(flags: np.ndarray, value: bool) -> np.ndarray:
    """Flags whose runs of ``value`` of less than five points are inverted."""
    edges = np.flatnonzero(np.diff(flags.astype(int))) + 1
    for begin, end in zip([0, *edges], [*edges, len(flags)], strict=True):
        if end - begin < 5 and flags[begin] == value:
            flags = flags.copy()
            flags[begin:end] = not value
    return flags


def _facets(axes: Any, fine: np.ndarray, view: np.ndarray) -> None:
    """Draw the surface as facets from back to front, lit from the upper left on both sides."""
    from matplotlib.collections import PolyCollection

    corners = np.stack([fine[:-1, :-1], fine[1:, :-1], fine[1:, 1:], fine[:-1, 1:]], axis=2).reshape(-1, 4, 3)
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    towards = normal @ view[2]
    normal *= np.where(towards < 0.0, -1.0, 1.0)[:, None]
    light = np.array([-0.45, 0.55, 0.75]) @ view
    colours = lit(SURFACE, normal, light, view[2], (0.62, 0.40), (0.08, 30))
    flat = corners @ view.T
    order = np.argsort(flat[:, :, 2].mean(axis=1))
    look: dict[str, Any] = {"facecolors": colours[order], "edgecolors": colours[order], "linewidths": 0.3}
    facets = PolyCollection(list(flat[order, :, :2]), rasterized=True, zorder=2, **look)
    axes.add_collection(facets)
    axes.autoscale_view()


def _motion(axes: Any, line: np.ndarray, depths: _Depths) -> None:
    """Draw the motion as a broader line with its start and arrows."""
    seen, colour = depths.visible(line), LINES["energy"][1]
    axes.plot(*split(line, seen)[0].T, color=colour, ls="-", lw=2.6, zorder=5, label="the motion")
    if seen[0]:
        look = {"color": colour, "markersize": 5.0, "markeredgecolor": "white"}
        axes.plot(*line[0, :2], "o", zorder=7, label="initial state", **look)
    edges = [0, *(np.flatnonzero(np.diff(seen.astype(int))) + 1), len(seen)]
    for begin, end in pairwise(edges):
        if seen[begin] and end - begin > 40:
            foot, tip = line[(begin + end) // 2 + np.array([0, 6]), :2]
            arrow(axes, foot, tip, colour, 1.5, zorder=6, head=0.25)


def _triad(axes: Any, view: np.ndarray, depths: _Depths) -> None:
    """Draw the directions of the coordinates to the lower left of the surface, and set the limits of the axes."""
    low, high = depths.low[:2], depths.high[:2]
    size = 0.17 * float((high - low).max())
    tips = size * view[:2].T
    right, lowest = max(0.0, tips[:, 0].max()), min(0.0, tips[:, 1].min())
    corner = low + np.array([-0.2 * size - right, 0.3 * size - lowest])
    for tip, label in zip(tips, LABELS, strict=True):
        arrow(axes, corner, corner + tip, "0.2", 0.8, zorder=8, head=0.15)
        across = abs(tip[0]) > abs(tip[1])
        place = {
            "ha": ("left" if tip[0] > 0.0 else "right") if across else "center",
            "va": "center" if across else "bottom",
        }
        shift = [0.08 * size * np.sign(tip[0]), 0.0] if across else [0.0, 0.08 * size if tip[1] > 0.0 else -0.3 * size]
        axes.text(*(corner + tip + shift), label, zorder=8, **place)
    left = corner[0] + min(0.0, tips[:, 0].min()) - size
    axes.set_xlim(left, high[0] + 0.05 * size)
    axes.set_ylim(low[1] - 0.05 * size, high[1] + 0.05 * size)


def load_torus(name: str, scene: str, panel: TorusPanel, request: Request) -> Loaded:
    """Load the torus of a scene. Raises UsageError for a scene of another top or without a torus."""
    from topcli.analysis.motion.torus import Torus
    from topcli.config.load import load_experiment

    experiment = load_experiment(scene_config(scene, request.configs))
    if experiment.top.kind != "kowalevski":
        raise UsageError(f"{name}: {experiment.name} is of the top {experiment.top.kind}, not kowalevski")
    y, c = tuple(experiment.y0), float(experiment.top.constants()[0])
    source = {
        "state": [*y, c],
        "size": [ROWS, COLUMNS, COUNT, POINTS, MIDDLE, RETURNS],
        "projection": PROJECTION.tolist(),
        "code": fingerprint(Torus.states, Torus.surface, Torus.motion_line, Torus._lines, compiled=False),
    }
    return Loaded((panel,), lambda: _data(name, y, c), source, Grid(figsize=(5.4, 4.8)))


def _data(name: str, y: tuple[float, ...], c: float) -> dict[str, np.ndarray]:
    from topcli.analysis.motion.torus import Torus

    try:
        torus = Torus.of(y, c)
    except ValueError as error:
        raise UsageError(f"{name}: {error}") from None
    parts = {
        "surface": torus.surface(ROWS, COLUMNS).reshape(-1, 6) @ PROJECTION.T,
        "energy": _separated(torus.energy_lines(COUNT, POINTS, MIDDLE) @ PROJECTION.T),
        "k_sq": _separated(torus.k_sq_lines(COUNT, POINTS) @ PROJECTION.T),
        "motion": torus.motion_line(RETURNS, 2 * POINTS) @ PROJECTION.T,
    }
    return {f"{part}:{name}": values[:, i] for part, values in parts.items() for i, name in enumerate(AXES)}


def _separated(lines: np.ndarray) -> np.ndarray:
    """Lines (count, points, 3) one after the other, with nan between."""
    return np.pad(lines, ((0, 0), (0, 1), (0, 0)), constant_values=np.nan).reshape(-1, 3)
