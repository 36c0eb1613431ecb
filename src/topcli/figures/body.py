"""The spinning body of an animation, made from its moments of inertia, with its axis and the fixed direction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from topcli.contracts import Array, Top
from topcli.figures.labels import halo
from topcli.figures.space import TRACE, axis, curve, draw_globe, set_view, sphere, surface
from topcli.tops.bodies import checked_equations

LONGITUDES, LATITUDES = 56, 28
PALE, BLUE, MARK = (0.93, 0.90, 0.83), (0.20, 0.47, 0.69), (0.87, 0.42, 0.10)
"""Colours of the sectors; one of them is marked, so that the spin is seen."""
_REACH = 0.66
"""Largest distance of a point of the body from the fixed point; the traces lie on the sphere of radius one."""
UNKNOWN = (3.0, 2.5, 1.5), (0.0, 0.0, 1.0)
"""Moments and centre of gravity of a top that does not declare them."""
DOT = "#D55E00"
SILHOUETTE = ((0.0, 0.86), (0.06, 0.86), (0.28, 0.69), (0.37, 0.57), (0.35, 0.5), (0.06, 0.09), (0.0, 0.0))
"""Distance from the axis and height of a spinning top, convex, from its upper end to its tip."""


@dataclass(frozen=True)
class Body:
    """Convex body of a top: its surface (rows, columns, 3) in the body's frame, around the ``axis`` (3,).

    ``axis`` is traced and ``label`` its name; ``vertical`` names the direction fixed in space.
    """

    surface: Array
    axis: Array
    label: str
    vertical: str


def body_of(top: Top, state: Sequence[float]) -> Body:
    """Body of a top, whose motion starts in ``state``.

    The axis passes through the centre of gravity, or without gravity it is the principal axis that is nearest to the
    angular momentum at the start. A top with a symmetry axis through its centre of gravity looks like a spinning top;
    any other is the homogeneous ellipsoid of its moments, or of ``UNKNOWN`` ones.
    """
    letter = r"\boldsymbol{m}" if len(top.components) == 3 else r"\boldsymbol{p}"
    vertical = letter if type(top).vertical else r"\boldsymbol{e}_z"
    try:
        top.euler_poisson()
        equations = checked_equations(top, "the body")
        moments, gravity = np.array(equations.moments), np.array(equations.gravity)
    except NotImplementedError:
        moments, gravity = map(np.array, UNKNOWN)
    if top.in_space or (moments[0] == moments[1] and gravity[2] and not gravity[:2].any()):
        label = r"$\boldsymbol{a}$" if top.in_space else r"$\boldsymbol{e}_3$"
        return Body(_spinning_top(), np.array([0.0, 0.0, 1.0]), label, vertical)
    momentum = moments * np.array(state[:3], dtype=float)
    axis = gravity / np.linalg.norm(gravity) if gravity.any() else np.eye(3)[int(np.argmax(np.abs(momentum)))]
    along, sign = np.flatnonzero(axis), "-" if axis.min() < 0.0 else ""
    label = rf"${sign}\boldsymbol{{e}}_{along[0] + 1}$" if len(along) == 1 else r"$\boldsymbol{s}$"
    return Body(_ellipsoid(moments, axis), axis, label, vertical)


def _ellipsoid(moments: Array, axis: Array) -> Array:
    """Surface of the homogeneous ellipsoid with the ``moments``, with poles on ``axis``; no semi-axis is too short."""
    sizes = np.sqrt(np.maximum(moments.sum() - 2.0 * moments, 0.0))  # A = (b² + c²)/5 of the mass, and so on
    first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    first = first / np.linalg.norm(first)
    frame = np.stack([first, np.cross(axis, first), axis])
    return (sphere(LATITUDES, LONGITUDES) @ frame) * _REACH * np.maximum(sizes / sizes.max(), 0.12)


def _spinning_top() -> Array:
    """Surface of a spinning top with its tip in the fixed point."""
    radius, height = np.array(SILHOUETTE).T
    at = np.linspace(0.0, len(radius) - 1.0, LATITUDES + 1)
    points = sphere(LATITUDES, LONGITUDES)
    points[..., :2] = points[LATITUDES // 2, :, :2] * np.interp(at, np.arange(len(radius)), radius)[:, None, None]
    points[..., 2] = np.interp(at, np.arange(len(height)), height)[:, None]
    return points


def draw_space(axes: Any, body: Body, start: Array) -> Array:
    """Draw the unit sphere and the fixed direction; return the camera (3, 3).

    The viewer has the axis of the body on his left at the ``start`` (3,).
    """
    upright = np.hypot(start[0], start[1]) < 0.1
    azimuth = 35.0 if upright else math.degrees(math.atan2(start[1], start[0])) + 70.0
    camera = set_view(axes, 22.0, azimuth, 1.22, 0.15)
    draw_globe(axes, camera)
    axis(axes, np.array([0.0, 0.0, 1.0]), camera, 0.2, body.vertical)
    return camera


def draw_body(axes: Any, camera: Array, body: Body, rotation: Array, path: Array, width: float) -> None:
    """Draw the body in the attitude ``rotation`` (3, 3) and the ``path`` (m, 3) of its axis up to it."""
    curve(axes, camera, path, TRACE, width, zorder=20, label="trace of the axis")
    sector = np.arange(LONGITUDES + 1) * 8 // LONGITUDES
    colours = np.where((sector % 2 == 0)[:, None], PALE, BLUE)
    colours = np.where((sector == 0)[:, None], MARK, colours)
    surface(axes, body.surface @ rotation.T, np.broadcast_to(colours, body.surface.shape), camera, zorder=10)

    # the axis from the surface to the sphere, its end and its name
    tip = rotation @ body.axis
    right, up, ahead = camera @ tip
    reach, level = (np.max(body.surface @ body.axis), 21) if ahead >= 0.0 else (0.0, 3)
    axes.plot(*np.column_stack([reach * tip, tip]), "-", color="0.1", lw=1.6, solid_capstyle="round", zorder=level)
    dot = {"color": DOT, "ms": 5.5, "mec": "white", "mew": 0.8, "zorder": level + 1, "label": "end of the axis"}
    axes.plot(*tip[:, None], "o", **dot)
    beside = 0.14 * np.array([right, up]) / max(math.hypot(right, up), 0.15)
    halo(axes.text(*(tip + beside @ camera[:2]), body.label, ha="center", va="center", zorder=30), 2.2)
