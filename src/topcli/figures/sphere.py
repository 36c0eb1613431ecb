"""Traces of unit vectors on the sphere in orthographic projection, lighter on the far side."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from topcli.contracts import Array
from topcli.figures.picture import Runs

MERIDIANS, PARALLELS = 12, 5
NEAR, FAR = "0.62", "0.88"
"""Greys of the graticule."""
TRACE, TRACE_FAR = "#0072B2", "#A6CDE6"
BAND = "#D55E00"


@dataclass(frozen=True)
class Sphere:
    """Trace of the unit vector with the components ``columns``, seen from ``elevation`` and ``azimuth`` in degrees.

    A dot marks the start, an arrow the third axis with its name ``axis``; with ``band`` the two parallels that enclose
    the trace are drawn too.
    """

    title: str
    columns: tuple[str, str, str]
    elevation: float = 50.0
    azimuth: float = 0.0
    axis: str = "p"
    band: bool = True
    width: float = 1.25

    def of_runs(self, runs: Runs) -> Sphere:
        """Return the panel, with the name of the run as title if its motion is not that of the packaged scene."""
        run = runs[self.columns[0]]
        return self if run.as_packaged else replace(self, title=run.experiment.name)

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: object) -> None:
        """Draw the sphere and the trace into ``axes``; ``styles`` is not used."""
        draw_sphere(axes, self, data)


def projection(elevation: float, azimuth: float) -> Array:
    """Matrix (3, 3) that maps a point (x, y, z) to (right, up, towards the viewer)."""
    e, a = math.radians(elevation), math.radians(azimuth)
    return np.array(
        [
            [-math.sin(a), math.cos(a), 0.0],
            [-math.sin(e) * math.cos(a), -math.sin(e) * math.sin(a), math.cos(e)],
            [math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)],
        ]
    )


def _line(axes: Any, view: Array, points: Array, near: str, far: str, width: float, order: int, **style: Any) -> None:
    """Draw a curve (n, 3), with the part on the far side lighter, thinner and below the part on the near side."""
    right, up, towards = view @ points.T
    hidden = towards < 0.0
    for colour, mask, thickness, level in ((far, ~hidden, 0.7 * width, order), (near, hidden, width, order + 10)):
        axes.plot(
            np.where(mask, np.nan, right),
            np.where(mask, np.nan, up),
            color=colour,
            linewidth=thickness,
            zorder=level,
            solid_capstyle="round",
            solid_joinstyle="round",
            **({"linestyle": "-"} | style),
        )


def _parallel(height: float) -> Array:
    """Points (361, 3) of the circle of latitude at ``height``."""
    angle = np.linspace(0.0, 2.0 * math.pi, 361)
    radius = math.sqrt(max(0.0, 1.0 - height * height))
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full_like(angle, height)])


def draw_sphere(axes: Any, panel: Sphere, data: Mapping[str, np.ndarray]) -> None:
    """Draw ``panel`` on ``axes`` from the columns of ``data``, each (m,)."""
    from matplotlib.patches import Circle

    points = np.column_stack([data[name] for name in panel.columns])
    points = points[np.isfinite(points).all(axis=1)]
    view = projection(panel.elevation, panel.azimuth)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_xlim(-1.06, 1.06)
    axes.set_ylim(-1.06, 1.08)
    axes.set_title(panel.title)
    for k, size in enumerate(np.linspace(1.0, 0.1, 12)):  # a soft light from the upper left
        middle = (-0.32 * (1.0 - size), 0.36 * (1.0 - size))
        shade = 0.925 + 0.075 * k / 11
        axes.add_patch(Circle(middle, size, facecolor=(shade, shade, shade), edgecolor="none", zorder=0))
    polar = np.linspace(0.0, math.pi, 181)
    for azimuth in np.arange(MERIDIANS) * (2.0 * math.pi / MERIDIANS):
        ring = np.column_stack([np.sin(polar) * math.cos(azimuth), np.sin(polar) * math.sin(azimuth), np.cos(polar)])
        _line(axes, view, ring, NEAR, FAR, 0.35, 1)
    for height in np.sin(np.linspace(-math.pi / 2, math.pi / 2, PARALLELS + 2)[1:-1]):
        _line(axes, view, _parallel(float(height)), NEAR, FAR, 0.35, 1)
    axes.add_patch(Circle((0.0, 0.0), 1.0, facecolor="none", edgecolor="0.35", linewidth=0.7, zorder=8))
    for height in (points[:, 2].min(), points[:, 2].max()) if panel.band else ():
        _line(axes, view, _parallel(float(height)), BAND, "#F2C6A5", 0.6, 3, linestyle=(0, (4, 2.5)))
    _line(axes, view, points, TRACE, TRACE_FAR, panel.width, 5)
    # the third axis, from the pole outwards
    foot, tip = view @ np.array([0.0, 0.0, 1.0]), view @ np.array([0.0, 0.0, 1.45])
    axes.annotate(
        "",
        tip[:2],
        foot[:2],
        arrowprops={"arrowstyle": "-|>", "color": "0.2", "lw": 0.8, "shrinkA": 0, "shrinkB": 0},
        zorder=30,
    )
    axes.text(tip[0] + 0.05, tip[1] - 0.01, rf"$\boldsymbol{{{panel.axis}}}$", va="top", zorder=30)
    right, up, towards = view @ points[0]
    filled = TRACE if towards >= 0.0 else TRACE_FAR
    axes.plot([right], [up], "o", color=filled, markersize=3.4, markeredgecolor="white", markeredgewidth=0.6, zorder=20)
