"""Three-dimensional pictures by mplot3d: traces on the unit sphere, and polhodes on the energy ellipsoid.

Mplot3d draws one curve or surface after the other. A curve on a convex body is therefore drawn in two parts, a pale one
behind the body and a strong one in front of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from topcli.contracts import Array
from topcli.figures.figure import Columns, figure
from topcli.figures.style import halo, legend_below
from topcli.runs.simulate import simulate

SPATIAL = "3d"
"""Projection of the axes that the functions of this module draw into."""
ZOOM = 1.7
"""Zoom at which half the width of mplot3d's axes is one unit, if their limits are -1 and 1."""
TRACE, START = "#0072B2", "#D55E00"


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


def curve(
    axes: Any,
    camera: Array,
    points: Array,
    color: Any,
    width: float,
    zorder: float,
    normals: Array | None = None,
    **common: Any,
) -> None:
    """Draw a curve (m, 3) on a convex body: what is turned to the viewer in full colour, the rest thinner and pale.

    ``normals`` (m, 3) are those of the body; by default it is a sphere.
    """
    near = ((points if normals is None else normals) @ camera[2] >= 0.0)[:, None]
    style = {"linestyle": "-", "solid_capstyle": "round", "solid_joinstyle": "round", "color": color, **common}
    axes.plot(*np.where(near, points, np.nan).T, lw=width, zorder=zorder, **style)
    hidden = "on the far side" if "label" in common and not near.all() else None
    axes.plot(
        *np.where(near, np.nan, points).T, **{**style, "lw": 0.6 * width, "alpha": 0.45, "zorder": 2, "label": hidden}
    )


def arrow(axes: Any, foot: Array, tip: Array, colour: str, width: float, zorder: float, **props: Any) -> None:
    """Draw an arrow between two points (3,)."""
    from mpl_toolkits.mplot3d.proj3d import proj_transform

    shape = {"arrowstyle": "-|>", "color": colour, "lw": width, "shrinkA": 0, "shrinkB": 0, **props}
    ends = (proj_transform(x, y, z, axes.get_proj())[:2] for x, y, z in (tip, foot))
    axes.annotate("", *ends, arrowprops=shape, zorder=zorder)


def axis(axes: Any, foot: Array, camera: Array, length: float, name: str) -> None:
    """Draw an arrow of this ``length`` from ``foot`` (3,) outwards in the plane of the picture, its name beyond it."""
    along = camera[:2] @ foot / np.hypot(*camera[:2] @ foot) @ camera[:2]
    arrow(axes, foot, foot + length * along, "0.25", 0.9, zorder=30, shrinkA=2)
    style = {"ha": "center", "va": "center", "fontsize": "large", "zorder": 31}
    halo(axes.text(*(foot + (length + 0.11) * along), rf"${name}$", **style), 3.0)


def parallel(height: float) -> Array:
    """Points (361, 3) of the circle of latitude of the unit sphere at ``height``."""
    angle = np.linspace(0.0, 2.0 * math.pi, 361)
    radius = math.sqrt(max(0.0, 1.0 - height * height))
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full_like(angle, height)])


def sphere(rows: int, columns: int) -> Array:
    """Points (rows + 1, columns + 1, 3) of the unit sphere, from pole to pole."""
    polar = np.linspace(0.0, math.pi, rows + 1)[:, None]
    around = np.linspace(0.0, 2.0 * math.pi, columns + 1)
    points = np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)
    return np.stack(np.broadcast_arrays(*points), axis=2)


def surface(axes: Any, points: Array, colours: Array, camera: Array, zorder: float = 0.0, soft: float = 0.0) -> None:
    """Draw the faces of a convex surface (rows, columns, 3) that are turned to the viewer, in a light from the left.

    ``colours`` has the same shape; ``soft`` is the part of them that the light does not change.
    """
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    corners = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    faces = np.stack(corners, axis=2).reshape(-1, 4, 3)
    normals = np.cross(faces[:, 1] - faces[:, 3], faces[:, 2] - faces[:, 0])
    near = normals @ camera[2] > 0.0
    normals = normals[near] / np.linalg.norm(normals[near], axis=1, keepdims=True)
    bright = 0.62 + 0.42 * np.maximum(normals @ (np.array([-0.45, 0.45, 0.77]) @ camera), 0.0)
    lit = np.clip(colours[:-1, :-1].reshape(-1, 3)[near] * (soft + (1.0 - soft) * bright)[:, None], 0.0, 1.0)
    look = {"facecolors": lit, "edgecolors": lit, "linewidths": 0.35, "zorder": zorder, "rasterized": True}
    axes.add_collection3d(Poly3DCollection(faces[near], **look), autolim=False)


def draw_globe(axes: Any, camera: Array) -> None:
    """Draw the unit sphere: a pale disc with three parallels."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    outline = parallel(0.0)[:, :2] @ camera[:2]
    axes.add_collection3d(Poly3DCollection([outline], facecolor="0.975", edgecolor="0.75", lw=0.6, zorder=0))
    for height in (0.0, math.sqrt(0.5), -math.sqrt(0.5)):
        curve(axes, camera, parallel(height), "0.75", 0.5, zorder=11)


def draw_trace(axes: Any, points: Array, elevation: float = 72.0, in_body: bool = False, width: float = 1.25) -> None:
    """Draw the trace (m, 3) of a unit vector on the sphere; a diamond marks the start.

    In space the vertical is drawn too; in the body, its axes.
    """
    azimuth, reach, middle = (35.0, 1.36, 0.14) if in_body else (0.0, 1.12, 0.0)
    camera = set_view(axes, elevation, azimuth, reach, middle)

    draw_globe(axes, camera)
    for i in (1, 2, 3) if in_body else (3,):
        flat = camera[:2] @ np.eye(3)[i - 1]
        foot = np.eye(3)[i - 1] if camera[2, i - 1] > 0.0 else flat / np.hypot(*flat) @ camera[:2]
        length, name = (1.2 - math.hypot(*camera[:2] @ foot), rf"e_{i}") if in_body else (0.2, "p")
        axis(axes, foot, camera, length, rf"\boldsymbol{{{name}}}")

    curve(axes, camera, points, TRACE, width, zorder=15, label="trace", gid="motion")
    look = {"markersize": 4.2, "markeredgecolor": "white", "markeredgewidth": 0.6, "zorder": 20, "label": "start"}
    axes.plot(*points[:1].T, "D", color=START, **look)


TRACES = {
    "lagrange_cusps": "(a) Lagrange: cusps",
    "lagrange_loops": "(b) Lagrange: loops",
    "lagrange_waves": "(c) Lagrange: waves",
    "kowalevski_hybrid": "(d) Kowalevski: near homoclinic",
    "kowalevski_generic_hk": "(e) Kowalevski: generic",
}


def draw_traces(canvas: Any, columns: Columns) -> None:
    """Draw the traces of the axis of Lagrange's top in space, and of the vertical in the body of Kowalevski's."""
    for i, (scene, title) in enumerate(TRACES.items(), 1):
        axes, points = canvas.add_subplot(2, 3, i, projection=SPATIAL), vectors(columns, scene)
        if scene.startswith("lagrange"):
            draw_trace(axes, points)
        else:
            draw_trace(axes, points, -20.0, in_body=True, width=0.5 if "generic" in scene else 1.25)
        axes.set_title(title)
    heading = r"(a)-(c) axis $\boldsymbol{a}$ in space; (d), (e) vertical $\boldsymbol{\gamma}$ in the body"
    canvas.suptitle(heading, fontsize="medium")
    legend_below(canvas, 4)


def vectors(columns: Columns, name: str) -> Array:
    """Vectors (m, 3) of the columns ``name:1`` to ``name:3``."""
    return np.column_stack([columns[f"{name}:{i}"] for i in (1, 2, 3)])


@figure("traces", "Traces on the sphere: axis of Lagrange's top, vertical of Kowalevski's", draw_traces, (7.0, 5.3))
def traces() -> Columns:
    """Components of the axes and the verticals."""
    columns: dict[str, Array] = {}
    for scene in TRACES:
        run, vector = simulate(scene), "a" if scene.startswith("lagrange") else "gamma"
        columns |= {f"{scene}:{i}": run[f"{vector}{i}"] for i in (1, 2, 3)}
    return columns


RUN = "#B2182B"
PALE, BLUE, OCHRE = (np.array(tint) for tint in ((0.985, 0.975, 0.955), (0.44, 0.63, 0.80), (0.93, 0.72, 0.42)))
"""Tints of the ellipsoid at the separatrix and around the axes of the largest and the smallest moment."""
_LEVELS = (0.0, 0.1, 0.25, 0.42, 0.6, 0.77, 0.91)
"""Positions of the drawn polhodes between the separatrix (0) and the axes (1), on either side."""


def polhodes(moments: Array, levels: Sequence[float] = _LEVELS) -> list[Array]:
    """Polhodes (m, 3) on x.Ix = 1, each once around in the sense of the motion; four for each level.

    About the axis i the curve of m² = q is I_j (I_j - I_i) x_j² + I_k (I_k - I_i) x_k² = q - I_i.
    """
    small, middle, large = (int(i) for i in np.argsort(moments))
    angle = np.linspace(0.0, 2.0 * np.pi, 721)
    curves = []
    for level in levels:
        for i in (small, large):
            j, k = (i + 1) % 3, (i + 2) % 3
            rest = (moments[middle] - moments[i]) * (1.0 - level) ** 2  # squared, so that the curves are even
            for side in (1.0, -1.0):
                x = np.empty((len(angle), 3))
                x[:, j] = np.cos(angle) * np.sqrt(rest / (moments[j] * (moments[j] - moments[i])))
                x[:, k] = np.sin(angle) * np.sqrt(rest / (moments[k] * (moments[k] - moments[i])))
                others = moments[j] * x[:, j] ** 2 + moments[k] * x[:, k] ** 2
                x[:, i] = side * np.sqrt(np.maximum(1.0 - others, 0.0) / moments[i])
                forwards = -side * (moments[k] - moments[i]) > 0.0  # x_j' = (I_k - I_i)/I_j x_k x_i
                curves.append(x if forwards else x[::-1])
    return curves


def draw_polhodes(axes: Any, moments: Array, omega: Array) -> None:
    """Draw the ellipsoid x.Ix = 1 with its polhodes, and the curve (m, 3) of a motion, scaled to it."""
    shortest = math.sqrt(moments.min())
    camera = set_view(axes, 24.0, 52.0, 1.13 / shortest, 0.12 / shortest)
    _ellipsoid(axes, moments, camera)
    path = omega / np.sqrt(omega[0] ** 2 @ moments)
    curve(axes, camera, path, RUN, 1.8, zorder=3.2, normals=path * moments, label="run", gid="motion")
    for number, points in enumerate(polhodes(moments)):
        width, kind = (1.2, "separatrix") if number < 4 else (0.6, "other polhodes")
        normals = points * moments
        curve(axes, camera, points, "0.15", width, zorder=3, normals=normals, label=kind)
        facing = normals @ camera[2] / np.linalg.norm(normals, axis=1)
        at = int(np.argmax(facing[:-8]))  # an arrowhead where it can be read best
        if facing[at] >= 0.1:
            head = "-|>,head_width=0.17,head_length=0.34"
            arrow(axes, points[at], points[at + 6], "0.15", 0.6, zorder=4, arrowstyle=head)

    # axes and steady rotations
    middle = int(np.argsort(moments)[1])
    for i, tip in enumerate(np.diag(1.0 / np.sqrt(moments))):
        fill, kind = ("white", "unstable rotation") if i == middle else ("0.1", "stable rotation")
        axes.plot(*tip[:, None], "o", ms=5.0, mew=1.0, mec="0.1", mfc=fill, zorder=5, label=kind)
        axis(axes, tip, camera, 0.2 / shortest, rf"\omega_{i + 1}")


def _ellipsoid(axes: Any, moments: Array, camera: Array) -> None:
    """Draw the ellipsoid and its outline, tinted by m²: blue towards the largest moment, ochre towards the smallest."""
    points = sphere(90, 180) / np.sqrt(moments)
    m_sq = (points * moments) ** 2 @ np.ones(3)
    level = np.clip(np.interp(m_sq, np.sort(moments), [-1.0, 0.0, 1.0]), -1.0, 1.0)[..., None]
    colours = PALE + np.where(level > 0.0, level * (BLUE - PALE), -level * (OCHRE - PALE))
    surface(axes, points, colours, camera, soft=0.25)
    # where the line of sight touches the surface: a great circle in the coordinates sqrt(I) x
    across = np.linalg.svd((np.sqrt(moments) * camera[2])[None, :])[2][1:]
    axes.plot(*(parallel(0.0)[:, :2] @ across / np.sqrt(moments)).T, "-", color="0.35", lw=0.6, zorder=3.5)
    small, _, large = np.argsort(moments) + 1
    for tint, number in ((BLUE, large), (OCHRE, small)):
        axes.plot([], [], "s", color=tint, ms=8.0, label=rf"around $\omega_{number}$")


MOMENTS = np.array([3.0, 2.0, 1.0])


def draw_tennis_racket(canvas: Any, columns: Columns) -> None:
    """Draw the polhodes and the tennis-racket flip among them."""
    draw_polhodes(canvas.add_subplot(projection=SPATIAL), MOMENTS, vectors(columns, "omega"))
    legend_below(canvas, 3)


@figure("polhodes", "Euler top: polhodes, and one from near the middle axis", draw_tennis_racket, (5.0, 5.9))
def euler_polhodes() -> Columns:
    """Components of omega of the tennis-racket flip."""
    run = simulate("euler_tennis_racket")
    return {f"omega:{i}": run[f"omega{i}"] for i in (1, 2, 3)}
