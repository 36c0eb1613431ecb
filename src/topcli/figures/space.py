"""Three-dimensional pictures by mplot3d: traces on the unit sphere, polhodes on the energy ellipsoid.

Mplot3d draws one curve or surface after the other. A curve on a convex body is therefore drawn in two parts, behind the
body and in front of it, and of the body itself only the faces that are turned to the viewer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array
from topcli.figures.picture import halo
from topcli.figures.style import Styles

SPATIAL = "3d"
"""Projection of the axes that the panels of this module draw into."""
ZOOM = 1.7
"""Zoom at which half the width of mplot3d's axes is one unit, if their limits are -1 and 1."""
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


def set_view(axes: Any, elevation: float, azimuth: float, reach: float, middle: float = 0.0) -> Array:
    """Set the view from ``elevation`` and ``azimuth`` in degrees, and return the camera.

    ``reach`` is half the width of the picture, and ``middle`` the height of its middle above the origin. The camera is
    the matrix (3, 3) that maps a point to (right, up, towards the viewer).
    """
    e, a = math.radians(elevation), math.radians(azimuth)
    right, ahead = np.array([-math.sin(a), math.cos(a), 0.0]), np.array([math.cos(a), math.sin(a), 0.0])
    up = np.array([0.0, 0.0, math.cos(e)]) - math.sin(e) * ahead
    axes.view_init(elevation, azimuth)
    axes.set_proj_type("ortho")
    axes.set_box_aspect((1.0, 1.0, 1.0), zoom=ZOOM / reach)
    limits = [(centre - 1.0, centre + 1.0) for centre in middle * up]
    axes.set(xlim=limits[0], ylim=limits[1], zlim=limits[2])
    axes.set_axis_off()
    axes.computed_zorder = False
    return np.array([right, up, math.cos(e) * ahead + np.array([0.0, 0.0, math.sin(e)])])


def lit(colours: Array, normals: Array, camera: Array, shade: float) -> Array:
    """Colours (k, 3) of faces with unit ``normals`` (k, 3) in a light from the upper left; ``shade`` is its part."""
    light = np.array([-0.45, 0.45, 0.77]) @ camera
    return np.clip(colours * (1.04 - shade + shade * np.maximum(normals @ light, 0.0)[:, None]), 0.0, 1.0)


def split(points: Array, near: NDArray[np.bool_]) -> tuple[Array, Array]:
    """The near and the far part of a curve (m, 3), with nan for the other part."""
    return np.where(near[:, None], points, np.nan), np.where(near[:, None], np.nan, points)


def curve(
    axes: Any,
    points: Array,
    near: NDArray[np.bool_],
    looks: tuple[Mapping[str, Any], Mapping[str, Any]],
    **common: Any,
) -> None:
    """Draw a curve (m, 3) in the ``looks`` of its near and its far part."""
    style = {"linestyle": "-", "solid_capstyle": "round", "solid_joinstyle": "round", **common}
    for part, look in zip(split(points, near), looks, strict=True):
        axes.plot(*part.T, **{**style, **look})


def arrow(
    axes: Any, foot: Array, tip: Array, colour: str, width: float, zorder: float, head: float = 0.0, **props: Any
) -> None:
    """Draw an arrow between two points (3,); ``head`` is half the width of its head, by default matplotlib's."""
    from mpl_toolkits.mplot3d.proj3d import proj_transform

    style = f"-|>,head_width={head},head_length={2 * head}" if head else "-|>"
    shape = {"arrowstyle": style, "color": colour, "lw": width, "shrinkA": 0, "shrinkB": 0, **props}
    ends = (proj_transform(x, y, z, axes.get_proj())[:2] for x, y, z in (tip, foot))
    axes.annotate("", *ends, arrowprops=shape, zorder=zorder)


def parallel(height: float) -> Array:
    """Points (361, 3) of the circle of latitude of the unit sphere at ``height``."""
    angle = np.linspace(0.0, 2.0 * math.pi, 361)
    radius = math.sqrt(max(0.0, 1.0 - height * height))
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full_like(angle, height)])


def quads(points: Array) -> Array:
    """Faces (k, 4, 3) between neighbouring points (rows, columns, 3) of a surface."""
    corners = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    return np.stack(corners, axis=2).reshape(-1, 4, 3)


def sphere(rows: int, columns: int) -> Array:
    """Points (rows + 1, columns + 1, 3) of the unit sphere."""
    polar = np.linspace(0.0, math.pi, rows + 1)[:, None]
    around = np.linspace(0.0, 2.0 * math.pi, columns + 1)
    points = np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)
    return np.stack(np.broadcast_arrays(*points), axis=2)


def surface(axes: Any, faces: Array, normals: Array, colours: Array, camera: Array, shade: float) -> None:
    """Draw the lit faces (k, 4, 3) of a convex body that are turned to the viewer, behind everything else."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    near = normals @ camera[2] > 0.0
    shown = lit(colours[near], normals[near], camera, shade)
    look = {"facecolors": shown, "edgecolors": shown, "linewidths": 0.35}
    axes.add_collection3d(Poly3DCollection(faces[near], zorder=0, rasterized=True, **look))


@dataclass(frozen=True)
class Sphere:
    """Trace of the unit vector with the components ``vector``, seen from ``elevation`` and ``azimuth`` in degrees.

    A diamond marks the start; arrows are the axes whose names ``axes`` are not empty; with ``band`` the two parallels
    that enclose the trace are drawn too. Small dots are at every unit of the column ``time``, if there is one. The
    legend is below the panel if it is ``alone``, and else up to the layout.
    """

    title: str
    vector: tuple[str, str, str]
    elevation: float = 72.0
    azimuth: float = 0.0
    axes: tuple[str, str, str] = ("", "", "p")
    band: bool = True
    width: float = 1.25
    time: str = ""
    alone: bool = False
    projection: ClassVar[str] = SPATIAL

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the sphere and the trace into ``axes``."""
        points = np.column_stack([data[name] for name in self.vector])
        rows = np.isfinite(points).all(axis=1)
        points = points[rows]
        outwards = any(self.axes[:2])
        camera = set_view(axes, self.elevation, self.azimuth, 1.34 if outwards else 1.12, 0.14 * outwards)
        axes.set_title(self.title)
        _globe(axes, camera)
        near = points @ camera[2] >= 0.0
        hidden = "_" if near.all() else "on the far side"
        front = {"color": TRACE, "lw": self.width, "zorder": 15, "label": "trace"}
        curve(axes, points, near, (front, {"color": TRACE_FAR, "lw": 0.7 * self.width, "zorder": 5, "label": hidden}))
        if self.time:
            _time_dots(axes, points, near, data[self.time][rows])
        heights = points[:, 2]
        for height, label in ((heights.min(), "its bounds"), (heights.max(), "_")) if self.band else ():
            ring = parallel(float(height))
            look = {"color": BAND, "lw": 0.7, "zorder": 13, "label": label}, {"color": BAND_FAR, "lw": 0.5, "zorder": 3}
            curve(axes, ring, ring @ camera[2] >= 0.0, look, linestyle=(0, (4, 2.5)))
        for direction, name in zip(np.eye(3), self.axes, strict=True):
            if name:
                _axis(axes, direction, camera, name)
        look = {"markersize": 4.2, "markeredgecolor": "white", "markeredgewidth": 0.6, "zorder": 20}
        axes.plot(*points[:1].T, "D", color=START if near[0] else START_FAR, label="start", **look)
        if self.alone:
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.02), ncols=4, fontsize="small")


def _globe(axes: Any, camera: Array) -> None:
    """Draw the unit sphere with its graticule in a soft light."""
    points = sphere(45, 90)
    faces = quads(points)
    surface(axes, faces, faces.mean(axis=1), np.ones((len(faces), 3)), camera, shade=0.12)
    meridians = np.moveaxis(sphere(180, MERIDIANS), 1, 0)[1:]
    latitudes = np.linspace(-math.pi / 2, math.pi / 2, PARALLELS + 2)[1:-1]
    for ring in (*meridians, *(parallel(math.sin(latitude)) for latitude in latitudes)):
        looks = {"color": NEAR, "lw": 0.35, "zorder": 11}, {"color": FAR, "lw": 0.25, "zorder": 1}
        curve(axes, ring, ring @ camera[2] >= 0.0, looks)
    axes.plot(*(parallel(0.0)[:, :2] @ camera[:2]).T, "-", color="0.35", lw=0.7, zorder=8)


def _axis(axes: Any, direction: Array, camera: Array, name: str) -> None:
    """Draw an axis from the sphere outwards, and its name beyond the arrowhead."""
    right, up, ahead = camera @ direction
    length = math.hypot(right, up)
    outwards = (right * camera[0] + up * camera[1]) / length
    foot = direction if ahead >= 0.0 else outwards  # hidden by the sphere up to its outline
    tip = outwards * (REACH if length > STEEP else 1.45 * length)
    arrow(axes, foot, tip, "0.2", 0.8, zorder=30)
    axes.text(*(tip + 0.13 * outwards), rf"$\boldsymbol{{{name}}}$", ha="center", va="center", zorder=30)


def _time_dots(axes: Any, points: Array, near: NDArray[np.bool_], times: Array) -> None:
    """Draw small dots at every unit of time, of which those on the far side are lighter."""
    elapsed = np.abs(times - times[0])
    units = np.arange(math.floor(elapsed[-1] + 1e-9) + 1)
    at = np.searchsorted(elapsed, units - 1e-9)
    for colour, rows, level in ((TRACE, at[near[at]], 16), (TRACE_FAR, at[~near[at]], 6)):
        look = {"linestyle": "none", "marker": ".", "markersize": 4.5, "zorder": level}
        axes.plot(*points[rows].T, color=colour, label="$t = 0, 1, 2, ...$" if level == 16 else "_", **look)


RUN = "#B2182B"
PALE, BLUE, OCHRE = (0.985, 0.975, 0.955), (0.44, 0.63, 0.80), (0.93, 0.72, 0.42)
"""Tints of the ellipsoid at the separatrix and around the axes of the largest and the smallest moment."""
FACING = 0.1
"""Smallest cosine of the angle between the line of sight and the surface's normal at which an arrow can be read."""
LEVELS = (0.1, 0.25, 0.42, 0.6, 0.77, 0.91)
"""Positions of the thin polhodes between the separatrix (0) and the axes (1), on either side."""


@dataclass(frozen=True)
class Polhodes:
    """Ellipsoid for moments (A, B, C), all different, at the energy of the run; the run's own curve is highlighted.

    ``label`` names the run's curve in the legend.
    """

    moments: tuple[float, float, float]
    omega: tuple[str, str, str] = ("omega1", "omega2", "omega3")
    label: str = "run"
    projection: ClassVar[str] = SPATIAL

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw into ``axes``."""
        moments = np.array(self.moments)
        path = np.column_stack([data[name] for name in self.omega])
        path = path / np.sqrt(path[0] ** 2 @ moments)
        camera = set_view(axes, 24.0, 52.0, 1.13 / math.sqrt(moments.min()), 0.12 / math.sqrt(moments.min()))
        _ellipsoid(axes, moments, camera)
        for points, steady in polhodes(moments, LEVELS):
            width, far = (1.2, 0.45) if steady else (0.6, 0.3)
            _trace(axes, points, _facing(points, moments, camera), "0.15", width, far)
            _arrowhead(axes, points, _facing(points, moments, camera))
        _trace(axes, path, _facing(path, moments, camera), RUN, width=1.8, far=0.45)
        _landmarks(axes, moments, camera)
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


def _ellipsoid(axes: Any, moments: Array, camera: Array) -> None:
    """Draw the ellipsoid x.Ix = 1, tinted by m²/2E: blue towards the largest moment, ochre towards the smallest."""
    faces = quads(sphere(90, 180) / np.sqrt(moments))
    normals = faces.mean(axis=1) * moments
    m_sq = (normals**2).sum(axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    small, middle, large = np.sort(moments)
    level = np.where(m_sq > middle, (m_sq - middle) / (large - middle), (m_sq - middle) / (middle - small))
    level = np.clip(level, -1.0, 1.0)[:, None]
    pale, blue, ochre = map(np.array, (PALE, BLUE, OCHRE))
    colours = pale + np.where(level > 0.0, level * (blue - pale), -level * (ochre - pale))
    surface(axes, faces, normals, colours, camera, shade=0.31)
    # where the line of sight touches the surface: a great circle in the coordinates sqrt(I) x
    across = np.linalg.svd((np.sqrt(moments) * camera[2])[None, :])[2][1:]
    axes.plot(*(parallel(0.0)[:, :2] @ across / np.sqrt(moments)).T, "-", color="0.35", lw=0.6, zorder=3.5)


def polhodes(moments: Array, levels: tuple[float, ...]) -> list[tuple[Array, bool]]:
    """Polhodes on x.Ix = 1, each once around in the sense of the motion; True for the separatrix.

    About the axis i the curve of m² = q is I_j (I_j - I_i) x_j² + I_k (I_k - I_i) x_k² = q - I_i.
    """
    small, middle, large = (int(i) for i in np.argsort(moments))
    angle = np.linspace(0.0, 2.0 * np.pi, 721)
    found: list[tuple[Array, bool]] = []
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


def _facing(points: Array, moments: Array, camera: Array) -> Array:
    """Cosines (m,) of the angles between the line of sight and the normals of the ellipsoid at points of a curve."""
    return (points * moments) @ camera[2] / np.linalg.norm(points * moments, axis=1)


def _trace(axes: Any, points: Array, facing: Array, color: str, width: float, far: float) -> None:
    """Draw a curve: solid in front, thin and of the opacity ``far`` behind."""
    looks = {"lw": width, "zorder": 3}, {"lw": 0.6 * width, "alpha": far, "zorder": 2}
    curve(axes, points, facing >= 0.0, looks, color=color)


def _arrowhead(axes: Any, points: Array, facing: Array) -> None:
    """Draw an arrowhead at the point of the curve that faces the viewer most, if it is visible."""
    at = int(np.argmax(facing[:-8]))
    if facing[at] >= FACING:
        arrow(axes, points[at], points[at + 6], "0.15", 0.6, zorder=4, head=0.17)


def _landmarks(axes: Any, moments: Array, camera: Array) -> None:
    """Draw the axes and the steady rotations, filled if stable, open if unstable."""
    middle = int(np.argsort(moments)[1])
    for i, direction in enumerate(np.eye(3)):
        tip = direction / math.sqrt(moments[i])
        shown = 1.0 if camera[2][i] > 0.0 else -1.0
        look = {"ms": 5.0, "mew": 1.0, "mec": "0.1", "mfc": "white" if i == middle else "0.1", "zorder": 5}
        axes.plot(*(shown * tip)[:, None], "o", **look)
        if shown > 0.0:
            flat = camera[:2] @ tip
            along = flat / np.hypot(*flat) @ camera[:2] / math.sqrt(moments.min())
            arrow(axes, tip, tip + 0.2 * along, "0.25", 0.9, zorder=4, head=0.2, shrinkA=3)
            style = {"ha": "center", "va": "center", "fontsize": "large", "zorder": 6}
            halo(axes.text(*(tip + 0.27 * along), rf"$\omega_{i + 1}$", **style), 3.0)
