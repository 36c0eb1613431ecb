"""Traces of unit vectors on the sphere in orthographic projection, lighter on the far side."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from topcli.contracts import Array
from topcli.figures.picture import REFERENCE, Runs, Styles, exact_column

MERIDIANS, PARALLELS = 12, 5
NEAR, FAR = "0.62", "0.86"
"""Greys of the graticule."""
TRACE, TRACE_FAR = "#0072B2", "#74ABD1"
BAND, BAND_FAR = "#D55E00", "#DD9560"
REACH = 1.2
"""Distance of the arrowheads of the axes from the centre of the picture: outside of the sphere."""
STEEP = 0.5
"""An axis that appears shorter than this part of its length is seen from above and ends inside of the sphere."""


@dataclass(frozen=True)
class Sphere:
    """Trace of the unit vector with the components ``vector``, seen from ``elevation`` and ``azimuth`` in degrees.

    A dot marks the start; arrows are the axes whose names ``axes`` are not empty; with ``band`` the two parallels that
    enclose the trace are drawn too. Small dots are at every unit of the column ``time``, if there is one. Columns in
    ``exact`` have another, ``exact:<column>``, of the exact motion, which is drawn in grey behind the trace.
    """

    title: str
    vector: tuple[str, str, str]
    elevation: float = 72.0
    azimuth: float = 0.0
    axes: tuple[str, str, str] = ("", "", "p")
    band: bool = True
    width: float = 1.25
    time: str = ""
    exact: tuple[str, ...] = ()

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns that the panel draws."""
        return (*self.vector, *((self.time,) if self.time else ()), *map(exact_column, self.exact))

    def of_runs(self, runs: Runs) -> Sphere:
        """Return the panel, with the name of the run as title if its motion is not that of the packaged scene."""
        run = runs[self.vector[0]]
        return self if run.as_packaged else replace(self, title=run.experiment.name)

    def overlaid(self, known: frozenset[str]) -> Sphere:
        """Return the panel with the trace of the exact motion if all components are ``known``."""
        return replace(self, exact=self.vector) if known.issuperset(self.vector) else self

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the sphere and the trace into ``axes``."""
        draw_sphere(axes, self, data, styles)


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


def _axis(axes: Any, view: Array, i: int, name: str) -> None:
    """Draw the axis ``i`` from the sphere outwards, and its name beyond the arrowhead."""
    foot = view[:, i]
    length = math.hypot(foot[0], foot[1])
    tip = foot[:2] * (REACH / length if length > STEEP else 1.45)
    start = foot[:2] if foot[2] >= 0.0 else foot[:2] / length  # hidden by the sphere up to its outline
    arrow = {"arrowstyle": "-|>", "color": "0.2", "lw": 0.8, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", tip, start, arrowprops=arrow, zorder=30)
    place = tip + 0.13 * foot[:2] / length
    axes.text(*place, rf"$\boldsymbol{{{name}}}$", ha="center", va="center", zorder=30)


def _time_dots(axes: Any, view: Array, points: Array, times: Array) -> None:
    """Draw small dots at every unit of time, of which those on the far side are lighter."""
    elapsed = np.abs(times - times[0])
    units = np.arange(math.floor(elapsed[-1] + 1e-9) + 1)
    right, up, towards = view @ points[np.searchsorted(elapsed, units - 1e-9)].T
    for colour, mask, level in ((TRACE_FAR, towards < 0.0, 6), (TRACE, towards >= 0.0, 16)):
        axes.plot(right[mask], up[mask], linestyle="none", marker=".", markersize=4.5, color=colour, zorder=level)


def draw_sphere(axes: Any, panel: Sphere, data: Mapping[str, np.ndarray], styles: Styles) -> None:
    """Draw ``panel`` on ``axes`` from the columns of ``data``, each (m,)."""
    from matplotlib.patches import Circle

    points = np.column_stack([data[name] for name in panel.vector])
    there = np.isfinite(points).all(axis=1)
    points = points[there]
    view = projection(panel.elevation, panel.azimuth)
    axes.set_aspect("equal")
    axes.set_axis_off()
    room = REACH + 0.24 if any(panel.axes[:2]) else 1.04
    axes.set(xlim=(-room, room), ylim=(-1.04, room))
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
        _line(axes, view, _parallel(float(height)), BAND, BAND_FAR, 0.7, 3, linestyle=(0, (4, 2.5)))
    if panel.exact:
        exact = np.column_stack([data[exact_column(name)] for name in panel.vector])
        grey = styles[REFERENCE]["color"]
        _line(axes, view, exact[there], grey, grey, 2.6 * panel.width, 4)
    _line(axes, view, points, TRACE, TRACE_FAR, panel.width, 5)
    if panel.time:
        _time_dots(axes, view, points, data[panel.time][there])
    for i, name in enumerate(panel.axes):
        if name:
            _axis(axes, view, i, name)
    right, up, towards = view @ points[0]
    filled = TRACE if towards >= 0.0 else TRACE_FAR
    axes.plot([right], [up], "o", color=filled, markersize=3.4, markeredgecolor="white", markeredgewidth=0.6, zorder=20)
