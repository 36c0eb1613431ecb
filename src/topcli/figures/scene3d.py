"""Three-dimensional pictures in parallel projection: traces on the unit sphere, polhodes on the energy ellipsoid.

Matplotlib's three-dimensional axes sort whole surfaces and not their parts. Here everything is projected by a camera,
the matrix (3, 3) that maps a point to (right, up, towards the viewer), and drawn behind or in front by its depth. The
ellipsoid is shaded pixel by pixel, and every curve is cut at its outline.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array
from topcli.figures.picture import halo
from topcli.figures.style import Styles

TRACE, TRACE_FAR = "#0072B2", "#74ABD1"
START, START_FAR = "#D55E00", "#DD9560"
BAND, BAND_FAR = "#D55E00", "#DD9560"
MERIDIANS, PARALLELS = 12, 5
NEAR, FAR = "0.62", "0.86"
"""Greys of the graticule."""
REACH = 1.2
"""Distance of the arrowheads of the axes from the centre of the picture: outside of the sphere."""
STEEP = 0.55
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


def quads(points: Array) -> Array:
    """Faces (k, 4, 3) between neighbouring points (rows, columns, 3) of a surface."""
    corners = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    return np.stack(corners, axis=2).reshape(-1, 4, 3)


def _line(
    axes: Any,
    points: Array,
    near: str,
    far: str,
    width: float,
    order: int,
    labels: tuple[str, str] = ("", ""),
    **style: Any,
) -> None:
    """Draw a projected curve (m, 3), with the far part lighter, thinner and below the near part.

    ``labels`` are those of both parts in the legend; empty ones are left out.
    """
    named = [{"label": label} if label else {} for label in labels]
    front = {"color": near, "lw": width, "zorder": order + 10, **named[0]}
    back = {"color": far, "lw": 0.7 * width, "zorder": order, **named[1]}
    pair_of_lines(axes, points, points[:, 2] >= 0.0, (front, back), **style)


@dataclass(frozen=True)
class Sphere:
    """Trace of the unit vector with the components ``vector``, seen from ``elevation`` and ``azimuth`` in degrees.

    A diamond marks the start; arrows are the axes whose names ``axes`` are not empty; with ``band`` the two parallels
    that enclose the trace are drawn too. Small dots are at every unit of the column ``time``, if there is one. ``name``
    is that of the vector in the legend, which is below the panel if it is ``alone``, and else up to the layout.
    """

    title: str
    vector: tuple[str, str, str]
    elevation: float = 72.0
    azimuth: float = 0.0
    axes: tuple[str, str, str] = ("", "", "p")
    band: bool = True
    width: float = 1.25
    time: str = ""
    name: str = r"axis $\boldsymbol{a}$"
    alone: bool = False

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the sphere and the trace into ``axes``."""
        points = np.column_stack([data[name] for name in self.vector])
        rows = np.isfinite(points).all(axis=1)
        camera = projection(self.elevation, self.azimuth)
        seen = points[rows] @ camera.T
        axes.set_aspect("equal")
        axes.set_axis_off()
        outside = np.hypot(*camera[:2]) > STEEP
        room = REACH + 0.24 if any(name and out for name, out in zip(self.axes, outside, strict=True)) else 1.04
        axes.set(xlim=(-room, room), ylim=(-1.04, room))
        axes.set_title(self.title)
        _globe(axes, camera)
        heights = points[rows, 2]
        for height, label in ((heights.min(), "its bounds"), (heights.max(), "")) if self.band else ():
            dashed = {"labels": (label, ""), "linestyle": (0, (4, 2.5))}
            _line(axes, parallel(float(height)) @ camera.T, BAND, BAND_FAR, 0.7, 3, **dashed)
        if self.time:
            _time_dots(axes, seen, data[self.time][rows])
        hidden = "on the far side" if (seen[:, 2] < 0.0).any() else ""
        _line(axes, seen, TRACE, TRACE_FAR, self.width, 5, (self.name, hidden))
        for i, name in enumerate(self.axes):
            if name:
                _axis(axes, camera[:, i], name)
        look = {"markersize": 4.2, "markeredgecolor": "white", "markeredgewidth": 0.6, "zorder": 20}
        axes.plot(*seen[:1, :2].T, "D", color=START if seen[0, 2] >= 0.0 else START_FAR, label="start", **look)
        if self.alone:
            entries = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
            entries = {self.name: entries[self.name], **entries}
            place = {"loc": "upper center", "bbox_to_anchor": (0.5, 0.02)}
            axes.legend(entries.values(), entries, ncols=4, fontsize="small", **place)


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
        look = {"linestyle": "none", "marker": ".", "markersize": 4.5, "zorder": level}
        axes.plot(*at[mask, :2].T, color=colour, label="$t = 0, 1, 2, ...$" if level == 16 else None, **look)


Curve = np.ndarray
"""Points (m, 3)."""
RUN = "#B2182B"
BLUE, OCHRE = (0.44, 0.63, 0.80), (0.93, 0.72, 0.42)
"""Tints of the ellipsoid around the axes of the largest and the smallest moment."""
FACING = 0.1
"""Smallest cosine of the angle between the line of sight and the surface's normal at which an arrow can be read."""


@dataclass(frozen=True)
class Polhodes:
    """Ellipsoid for moments (A, B, C), all different, at the energy of the run; the run's own curve is highlighted.

    ``levels`` are the positions of the thin polhodes between the separatrix (0) and the axes (1), on either side.
    ``view`` is the azimuth and the elevation of the viewer, in degrees, with omega3 upright. ``label`` names the run's
    curve in the legend.
    """

    moments: tuple[float, float, float]
    omega: tuple[str, str, str] = ("omega1", "omega2", "omega3")
    levels: tuple[float, ...] = (0.1, 0.25, 0.42, 0.6, 0.77, 0.91)
    view: tuple[float, float] = (52.0, 24.0)
    pixels: int = 900
    label: str = "run"

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw into ``axes``."""
        moments = np.array(self.moments)
        path = np.column_stack([data[name] for name in self.omega])
        size = np.sqrt(path[0] ** 2 @ moments)
        azimuth, elevation = self.view
        camera = projection(elevation, azimuth)
        _shade(axes, moments, camera, self.pixels)
        for curve, steady in _curves(moments, self.levels):
            width, far = (1.2, 0.45) if steady else (0.6, 0.3)
            _trace(axes, curve @ camera.T, _facing(curve, moments, camera), "0.15", width, far)
            _arrow(axes, curve, moments, camera)
        _trace(axes, path @ camera.T / size, _facing(path, moments, camera), RUN, width=1.8, far=0.45)
        labels = _landmarks(axes, moments, camera)
        reach = 1.04 * np.sqrt(camera[:2] ** 2 @ (1.0 / moments))
        low, high = np.minimum(-reach, labels.min(axis=0) - 0.06), np.maximum(reach, labels.max(axis=0) + 0.06)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        axes.set_axis_off()
        self._legend(axes)

    def _legend(self, axes: Any) -> None:
        """Explain lines and dots below the ellipsoid."""
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch

        dot: dict[str, Any] = {"color": "none", "marker": "o", "markeredgecolor": "0.1"}
        small, _, large = np.argsort(self.moments) + 1
        entries = {
            self.label: Line2D([], [], color=RUN, linestyle="-", linewidth=1.8),
            "separatrix": Line2D([], [], color="0.15", linestyle="-", linewidth=1.2),
            "other polhodes": Line2D([], [], color="0.15", linestyle="-", linewidth=0.6),
            "stable rotation": Line2D([], [], markerfacecolor="0.1", **dot),
            "unstable rotation": Line2D([], [], markerfacecolor="white", **dot),
            "on the far side": Line2D([], [], color="0.15", alpha=0.45, linestyle="-", linewidth=0.5),
            rf"around $\omega_{large}$": Patch(facecolor=BLUE),
            rf"around $\omega_{small}$": Patch(facecolor=OCHRE),
        }
        axes.legend(entries.values(), entries, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=3, fontsize=9)


def _shade(axes: Any, moments: np.ndarray, camera: np.ndarray, pixels: int) -> None:
    """Draw the ellipsoid x.Ix = 1, tinted by m²/2E: blue towards the largest moment, ochre towards the smallest."""
    reach = 1.02 * np.sqrt(camera[:2] ** 2 @ (1.0 / moments)).max()
    x, y = np.meshgrid(*(np.linspace(-reach, reach, pixels),) * 2)
    base = x[..., None] * camera[0] + y[..., None] * camera[1]
    a, b, c = camera[2] ** 2 @ moments, (base * moments) @ camera[2], (base**2) @ moments - 1.0
    inside = b * b - a * c
    depth = (-b + np.sqrt(np.maximum(inside, 0.0))) / a
    point = base + depth[..., None] * camera[2]
    normal = point * moments
    size = np.linalg.norm(normal, axis=-1)
    normal /= size[..., None]
    small, middle, large = np.sort(moments)
    level = np.where(size**2 > middle, (size**2 - middle) / (large - middle), (size**2 - middle) / (middle - small))
    level = np.clip(level, -1.0, 1.0)[..., None]
    white, blue, ochre = (np.array(rgb) for rgb in ((0.985, 0.975, 0.955), BLUE, OCHRE))
    colour = white + np.where(level > 0.0, level * (blue - white), -level * (ochre - white))
    image = lit(colour, normal, np.array([-0.45, 0.55, 0.75]) @ camera, camera[2], (0.70, 0.31), (0.07, 24))
    slope = np.maximum((normal @ camera[2]), 0.0)
    edge = np.clip(slope * pixels / 60.0, 0.0, 1.0)  # the outline fades within some pixels
    image = np.dstack([image, np.where(inside > 0.0, edge, 0.0)])
    outline = np.linalg.cholesky((camera[:2] / moments) @ camera[:2].T)
    turn = np.linspace(0.0, 2.0 * np.pi, 361)
    axes.plot(*(outline @ [np.cos(turn), np.sin(turn)]), color="0.35", linestyle="-", linewidth=0.6, zorder=3.5)
    axes.imshow(image, extent=(-reach, reach, -reach, reach), origin="lower", interpolation="bicubic", zorder=1)


def _curves(moments: np.ndarray, levels: tuple[float, ...]) -> list[tuple[Curve, bool]]:
    """Polhodes on x.Ix = 1, each once around in the sense of the motion; True for the separatrix.

    About the axis i the curve of m² = q is I_j (I_j - I_i) x_j² + I_k (I_k - I_i) x_k² = q - I_i.
    """
    small, middle, large = (int(i) for i in np.argsort(moments))
    angle = np.linspace(0.0, 2.0 * np.pi, 721)
    found: list[tuple[Curve, bool]] = []
    for i in (small, large):
        j, k = (i + 1) % 3, (i + 2) % 3
        for level in (0.0, *levels):
            # squared, so that the curves are evenly spaced
            rest = (moments[middle] - moments[i]) * (1.0 - level) ** 2
            for side in (1.0, -1.0):
                x = np.empty((len(angle), 3))
                x[:, j] = np.cos(angle) * np.sqrt(rest / (moments[j] * (moments[j] - moments[i])))
                x[:, k] = np.sin(angle) * np.sqrt(rest / (moments[k] * (moments[k] - moments[i])))
                others = moments[j] * x[:, j] ** 2 + moments[k] * x[:, k] ** 2
                x[:, i] = side * np.sqrt(np.maximum(1.0 - others, 0.0) / moments[i])
                # the motion: x_j' = (I_k - I_i)/I_j x_k x_i
                forwards = -side * (moments[k] - moments[i]) > 0.0
                found.append((x if forwards else x[::-1], level == 0.0))
    return found


def _facing(curve: Curve, moments: np.ndarray, camera: np.ndarray) -> np.ndarray:
    """Cosines (m,) of the angles between the line of sight and the normals of the ellipsoid at points of a curve."""
    return (curve * moments) @ camera[2] / np.linalg.norm(curve * moments, axis=1)


def _trace(axes: Any, seen_curve: Curve, facing: np.ndarray, color: str, width: float, far: float) -> None:
    """Draw a curve as the camera sees it: solid in front, thin and of the opacity ``far`` behind."""
    pair = {"lw": width, "zorder": 3}, {"lw": 0.6 * width, "alpha": far, "zorder": 2}
    pair_of_lines(axes, seen_curve, facing >= 0.0, pair, color=color)


def _arrow(axes: Any, curve: Curve, moments: np.ndarray, camera: np.ndarray) -> None:
    """Draw an arrowhead at the point of the curve that faces the viewer most, if it is visible."""
    facing = _facing(curve, moments, camera)
    at = int(np.argmax(facing[:-8]))
    if facing[at] < FACING:
        return
    start, end = (curve[[at, at + 6]]) @ camera[:2].T
    arrow(axes, start, end, "0.15", 0.6, zorder=4, head=0.17)


def _landmarks(axes: Any, moments: np.ndarray, camera: np.ndarray) -> np.ndarray:
    """Draw the axes and the steady rotations, filled if stable, open if unstable; the places (m, 2) of the names."""
    middle = int(np.argsort(moments)[1])
    labels = []
    for i in range(3):
        tip = np.zeros(3)
        tip[i] = 1.0 / np.sqrt(moments[i])
        for sign in (1.0, -1.0):
            if sign * camera[2][i] > 0.0:
                stable = i != middle
                look = {"ms": 5.0, "mew": 1.0, "mec": "0.1", "mfc": "0.1" if stable else "white", "zorder": 5}
                axes.plot(*(sign * tip @ camera[:2].T), "o", **look)
        if camera[2][i] > 0.0:
            start = tip @ camera[:2].T
            along = start / np.hypot(*start) * np.sqrt(1.0 / moments.min())
            arrow(axes, start, start + 0.2 * along, "0.25", 0.9, zorder=4, head=0.2, shrinkA=3)
            labels.append(start + 0.27 * along)
            style = {"ha": "center", "va": "center", "fontsize": "large", "zorder": 6}
            halo(axes.text(*labels[-1], rf"$\omega_{i + 1}$", **style), 3.0)
    return np.array(labels)
