"""Spatial scenes in parallel projection: lit surfaces, lines in front and behind, arrows; traces on the unit sphere.

Matplotlib's three-dimensional axes sort whole surfaces and not their parts. Here everything is projected by a camera,
the matrix (3, 3) that maps a point to (right, up, towards the viewer), and drawn behind or in front by its depth.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array
from topcli.figures.picture import REFERENCE, Runs, Styles, exact_column

TRACE, TRACE_FAR = "#0072B2", "#74ABD1"
BAND, BAND_FAR = "#D55E00", "#DD9560"
MERIDIANS, PARALLELS = 12, 5
NEAR, FAR = "0.62", "0.86"
"""Greys of the graticule."""
REACH = 1.2
"""Distance of the arrowheads of the axes from the centre of the picture: outside of the sphere."""
STEEP = 0.5
"""An axis that appears shorter than this part of its length is seen from above and ends inside of the sphere."""


def projection(elevation: float, azimuth: float) -> Array:
    """Camera of a viewer at ``elevation`` and ``azimuth`` in degrees, with the third axis upright."""
    e, a = math.radians(elevation), math.radians(azimuth)
    return np.array(
        [
            [-math.sin(a), math.cos(a), 0.0],
            [-math.sin(e) * math.cos(a), -math.sin(e) * math.sin(a), math.cos(e)],
            [math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)],
        ]
    )


def unit(vectors: Array) -> Array:
    """Vectors (..., 3) of length one."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def lit(
    colours: Array, normals: Array, light: Array, eye: Array, shade: tuple[float, float], gloss: tuple[float, int]
) -> Array:
    """Colours (..., 3) of surfaces with unit ``normals`` (..., 3) in the direction ``light``, seen from ``eye``.

    ``shade`` are the parts of ambient and diffuse light, ``gloss`` the strength and the exponent of the reflection.
    """
    light = unit(light)
    diffuse = np.maximum(normals @ light, 0.0)[..., None]
    shine = np.maximum(normals @ unit(light + eye), 0.0)[..., None] ** gloss[1]
    return np.clip(colours * (shade[0] + shade[1] * diffuse) + gloss[0] * shine, 0.0, 1.0)


def split(points: Array, near: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Places (m, 2) of the near and of the far part of a projected curve (m, 2 or 3), with nan for the other part."""
    flat, mask = points[:, :2], near[:, None]
    return np.where(mask, flat, np.nan), np.where(mask, np.nan, flat)


def pair_of_lines(
    axes: Any,
    points: Array,
    near: NDArray[np.bool_],
    looks: tuple[Mapping[str, Any], Mapping[str, Any]],
    **common: Any,
) -> None:
    """Draw the far part of a projected curve, then the near part, in the ``looks`` of the near and the far one."""
    style = {"linestyle": "-", "solid_capstyle": "round", "solid_joinstyle": "round", **common}
    for part, look in zip(reversed(split(points, near)), reversed(looks), strict=True):
        axes.plot(*part.T, **{**style, **look})


def arrow(
    axes: Any, foot: Any, tip: Any, colour: str, width: float, zorder: float, head: float = 0.0, **props: Any
) -> None:
    """Draw an arrow between two places; ``head`` is half the width of its head, by default matplotlib's."""
    style = f"-|>,head_width={head},head_length={2 * head}" if head else "-|>"
    shape = {"arrowstyle": style, "color": colour, "lw": width, "shrinkA": 0, "shrinkB": 0, **props}
    axes.annotate("", tip, foot, arrowprops=shape, zorder=zorder)


def parallel(height: float) -> Array:
    """Points (361, 3) of the circle of latitude of the unit sphere at ``height``."""
    angle = np.linspace(0.0, 2.0 * math.pi, 361)
    radius = math.sqrt(max(0.0, 1.0 - height * height))
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full_like(angle, height)])


def _line(axes: Any, points: Array, near: str, far: str, width: float, order: int, **style: Any) -> None:
    """Draw a projected curve (m, 3), with the far part lighter, thinner and below the near part."""
    pair = {"color": near, "lw": width, "zorder": order + 10}, {"color": far, "lw": 0.7 * width, "zorder": order}
    pair_of_lines(axes, points, points[:, 2] >= 0.0, pair, **style)


@dataclass(frozen=True)
class Sphere:
    """Trace of the unit vector with the components ``vector``, seen from ``elevation`` and ``azimuth`` in degrees.

    A dot marks the start; arrows are the axes whose names ``axes`` are not empty; with ``band`` the two parallels that
    enclose the trace are drawn too. Small dots are at every unit of the column ``time``, if there is one. With
    the columns ``exact`` the exact motion is drawn in grey behind the trace.
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

    def of_runs(self, runs: Runs) -> Sphere:
        """Return the panel with the exact motion, and the name of the run as title if it is not the packaged one."""
        run, exact = runs.of(self.vector[0]), runs.overlaid(self.vector)
        title = self.title if run.as_packaged else run.experiment.name
        return replace(self, title=title, exact=exact if exact == self.vector else ())

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the sphere and the trace into ``axes``."""
        points = np.column_stack([data[name] for name in self.vector])
        rows = np.isfinite(points).all(axis=1)
        camera = projection(self.elevation, self.azimuth)
        seen = points[rows] @ camera.T
        axes.set_aspect("equal")
        axes.set_axis_off()
        room = REACH + 0.24 if any(self.axes[:2]) else 1.04
        axes.set(xlim=(-room, room), ylim=(-1.04, room))
        axes.set_title(self.title)
        _globe(axes, camera)
        heights = points[rows, 2]
        for height in (heights.min(), heights.max()) if self.band else ():
            _line(axes, parallel(float(height)) @ camera.T, BAND, BAND_FAR, 0.7, 3, linestyle=(0, (4, 2.5)))
        if self.time:
            _time_dots(axes, seen, data[self.time][rows])
        if self.exact:
            exact = np.column_stack([data[exact_column(name)] for name in self.vector])[rows]
            grey = styles[REFERENCE]["color"]
            _line(axes, exact @ camera.T, grey, grey, 2.6 * self.width, 4)
        _line(axes, seen, TRACE, TRACE_FAR, self.width, 5)
        for i, name in enumerate(self.axes):
            if name:
                _axis(axes, camera[:, i], name)
        look = {"markersize": 3.4, "markeredgecolor": "white", "markeredgewidth": 0.6, "zorder": 20}
        axes.plot(*seen[:1, :2].T, "o", color=TRACE if seen[0, 2] >= 0.0 else TRACE_FAR, **look)


def _globe(axes: Any, camera: Array) -> None:
    """Draw the unit sphere with its graticule in a soft light from the upper left."""
    from matplotlib.patches import Circle

    for k, size in enumerate(np.linspace(1.0, 0.1, 12)):
        middle = (-0.32 * (1.0 - size), 0.36 * (1.0 - size))
        axes.add_patch(Circle(middle, size, facecolor=(0.925 + 0.075 * k / 11,) * 3, edgecolor="none", zorder=0))
    polar = np.linspace(0.0, math.pi, 181)
    rings = [
        np.column_stack([np.sin(polar) * math.cos(azimuth), np.sin(polar) * math.sin(azimuth), np.cos(polar)])
        for azimuth in np.arange(MERIDIANS) * (2.0 * math.pi / MERIDIANS)
    ]
    rings += [parallel(math.sin(latitude)) for latitude in np.linspace(-math.pi / 2, math.pi / 2, PARALLELS + 2)[1:-1]]
    for ring in rings:
        _line(axes, ring @ camera.T, NEAR, FAR, 0.35, 1)
    axes.add_patch(Circle((0.0, 0.0), 1.0, facecolor="none", edgecolor="0.35", linewidth=0.7, zorder=8))


def _axis(axes: Any, foot: Array, name: str) -> None:
    """Draw an axis from its ``foot`` on the sphere outwards, and its name beyond the arrowhead."""
    length = math.hypot(foot[0], foot[1])
    tip = foot[:2] * (REACH / length if length > STEEP else 1.45)
    start = foot[:2] if foot[2] >= 0.0 else foot[:2] / length  # hidden by the sphere up to its outline
    arrow(axes, start, tip, "0.2", 0.8, zorder=30)
    axes.text(*(tip + 0.13 * foot[:2] / length), rf"$\boldsymbol{{{name}}}$", ha="center", va="center", zorder=30)


def _time_dots(axes: Any, seen: Array, times: Array) -> None:
    """Draw small dots at every unit of time, of which those on the far side are lighter."""
    elapsed = np.abs(times - times[0])
    units = np.arange(math.floor(elapsed[-1] + 1e-9) + 1)
    at = seen[np.searchsorted(elapsed, units - 1e-9)]
    for colour, mask, level in ((TRACE_FAR, at[:, 2] < 0.0, 6), (TRACE, at[:, 2] >= 0.0, 16)):
        axes.plot(*at[mask, :2].T, linestyle="none", marker=".", markersize=4.5, color=colour, zorder=level)
