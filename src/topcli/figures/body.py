"""Drawing of a spinning body from its moments of inertia, with its axis and the vertical, along a stored run.

The body is convex: the faces turned to the viewer hide all others. Its attitude is recorded in the run, or
reconstructed from the rows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array, Outcome, Top
from topcli.engine.columns import quaternions_of
from topcli.errors import ConfigError, UsageError
from topcli.figures.picture import halo
from topcli.figures.space import arrow, curve, lit, parallel, quads, set_view, sphere, split
from topcli.store.results import StoredResult, intact_result
from topcli.store.series import read_series
from topcli.tops.bodies import checked_equations

LONGITUDES, LATITUDES = 56, 28
PALE, BLUE, MARK = (0.93, 0.90, 0.83), (0.20, 0.47, 0.69), (0.87, 0.42, 0.10)
"""Colours of the sectors; one of them is marked, so that the spin is seen."""
LARGEST = 0.66
"""Largest distance of a point of the body from the fixed point; the traces lie on the sphere of radius one."""
UNKNOWN_MOMENTS = (3.0, 2.5, 1.5)
THINNEST = 0.12
"""Smallest semi-axis relative to the largest one."""
TRACE, TRACE_FAR, OLD, OLD_FAR = "#0072B2", "#A6CDE6", "#7FB8D8", "#D3E5F0"
VERTICAL, DOT = "0.15", "#D55E00"
ELEVATION = 22.0
"""Elevation of the viewer in degrees."""
SHOWN_POINTS = 6000
"""Largest number of points of a drawn trace."""
_SILHOUETTE = ((0.0, 0.0), (0.10, 0.10), (0.62, 0.58), (0.64, 0.66), (0.50, 0.80), (0.10, 1.0), (0.0, 1.0))
"""Distance from the axis and height of a Lagrange top, convex."""


@dataclass(frozen=True)
class Body:
    """Convex body of a top: faces (k, 4, 3) in the body's frame, outward normals (k, 3), colours (k, 3).

    ``axis`` (3,) is the body's direction that is traced and ``label`` its name; ``vertical`` names the fixed direction.
    """

    faces: Array
    normals: Array
    colours: Array
    axis: Array
    label: str
    vertical: str


def body_of(top: Top, state: Sequence[float] | None) -> Body:
    """Body of a top, whose motion starts in ``state`` (None if that is not known).

    The axis passes through the centre of gravity, or without gravity it is the principal axis that is nearest to the
    angular momentum at the start. A top with a symmetry axis through its centre of gravity looks like a spinning top;
    any other is the homogeneous ellipsoid of its moments. A top that declares no moments is shown with
    ``UNKNOWN_MOMENTS`` and its third axis.
    """
    try:
        top.euler_poisson()
    except NotImplementedError:
        axis, three = np.array([0.0, 0.0, 1.0]), len(top.components) == 3
        vertical = r"\boldsymbol{e}_z" if type(top).vertical is None else rf"\boldsymbol{{{'m' if three else 'p'}}}"
        shape = _coloured(_ellipsoid(_semi_axes(np.array(UNKNOWN_MOMENTS)), axis), axis)
        return Body(*shape, axis, _axis_name(axis), f"${vertical}$")
    equations = checked_equations(top, "the body")
    moments, gravity = np.array(equations.moments), np.array(equations.gravity)
    free = not gravity.any()
    vertical = r"$\boldsymbol{m}$" if free and len(top.components) == 3 else r"$\boldsymbol{p}$"
    if top.in_space or (moments[0] == moments[1] and gravity[:2].tolist() == [0.0, 0.0] and not free):
        faces = _revolved(0.5 if top.in_space else float(moments[2] / (moments[0] + moments[2])))
        axis, label = np.array([0.0, 0.0, 1.0]), r"$\boldsymbol{a}$" if top.in_space else r"$\boldsymbol{e}_3$"
        return Body(*_coloured(faces, axis), axis, label, vertical)
    if free:
        m = np.abs(moments * np.array((state or (0.0, 0.0, 1.0))[:3]))
        axis = np.eye(3)[int(np.argmax(m))]
    else:
        axis = gravity / np.linalg.norm(gravity)
    return Body(*_coloured(_ellipsoid(_semi_axes(moments), axis), axis), axis, _axis_name(axis), vertical)


def _axis_name(axis: Array) -> str:
    """Mathtext of a principal axis, or of the direction of the centre of gravity."""
    along = np.flatnonzero(axis)
    if len(along) == 1:
        return rf"${'-' if axis[along[0]] < 0.0 else ''}\boldsymbol{{e}}_{along[0] + 1}$"
    return r"$\boldsymbol{s}$"


def _semi_axes(moments: Array) -> Array:
    """Semi-axes (3,) of the homogeneous ellipsoid with the ``moments``; the longest is LARGEST, none is too thin."""
    squares = moments.sum() - 2.0 * moments  # A = (b² + c²)/5 of the mass, and so on
    sizes = np.sqrt(np.maximum(squares, 0.0))
    return LARGEST * np.maximum(sizes / sizes.max(), THINNEST)


def _ellipsoid(semi: Array, axis: Array) -> Array:
    """Faces of the ellipsoid with semi-axes ``semi``, with poles on ``axis``."""
    first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    first = first / np.linalg.norm(first)
    frame = np.stack([first, np.cross(axis, first), axis])
    return quads((sphere(LATITUDES, LONGITUDES) @ frame) * semi)


def _revolved(weight: float) -> Array:
    """Faces of a spinning top about the third axis with its tip in the fixed point, wider for a larger ``weight``."""
    radius, height = np.array(_SILHOUETTE).T
    radius = radius * min(1.25, max(0.5, 2.0 * weight))
    at = np.linspace(0.0, 1.0, LATITUDES + 1) * (len(radius) - 1)
    radius, height = (LARGEST * 1.3 * np.interp(at, np.arange(len(height)), one) for one in (radius, height))
    around = np.linspace(0.0, 2.0 * math.pi, LONGITUDES + 1)
    heights = np.broadcast_to(height[:, None], (len(height), len(around)))
    points = np.stack([radius[:, None] * np.cos(around), radius[:, None] * np.sin(around), heights], axis=2)
    return quads(points[::-1])  # from the top downwards, as on an ellipsoid


def _coloured(faces: Array, axis: Array) -> tuple[Array, Array, Array]:
    """Faces, outward normals, and colours in eight sectors around the axis."""
    normals = np.cross(faces[:, 2] - faces[:, 0], faces[:, 3] - faces[:, 1])
    middle = faces.mean(axis=1)
    inside = faces.reshape(-1, 3).mean(axis=0)
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    kept = size[:, 0] > 1e-12
    faces, normals, middle = faces[kept], normals[kept] / size[kept], middle[kept]
    normals = normals * np.where(((middle - inside) * normals).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]
    sector = (np.arange(len(kept)) % LONGITUDES)[kept] * 8 // LONGITUDES
    colours = np.where((sector % 2 == 0)[:, None], PALE, BLUE)
    return faces, normals, np.where((sector == 0)[:, None], MARK, colours)


def view_azimuth(axis: Array) -> float:
    """Azimuth of the viewer, in degrees, that sees the direction ``axis`` (3,) on the left; 35 if it is upright."""
    return 35.0 if np.hypot(axis[0], axis[1]) < 0.1 else math.degrees(math.atan2(axis[1], axis[0])) + 70.0


def surface_distance(body: Body) -> float:
    """Distance from the fixed point at which the axis leaves the body."""
    corners = body.faces.reshape(-1, 3)
    size = np.linalg.norm(corners, axis=1)
    cosine = np.where(size > 0.0, corners @ body.axis / np.where(size > 0.0, size, 1.0), -1.0)
    return float(size[int(np.argmax(cosine))])


class BodyArtist:
    """Artists of a body, its axis and the trace of that, on 3D ``axes``; ``show`` moves them to a row of the motion.

    ``path`` (m, 3) are the directions of the axis in space. The viewer's azimuth follows from its start.
    """

    def __init__(self, axes: Any, body: Body, path: Array) -> None:
        from mpl_toolkits.mplot3d.art3d import Poly3DCollection

        self.body, self.reach = body, surface_distance(body)
        self.camera = set_view(axes, ELEVATION, view_azimuth(path[0]), 1.22, 0.15)
        self.stride = -(-len(path) // SHOWN_POINTS)
        self.path = path[:: self.stride]
        self._globe(axes)
        self.old, self.new = self._pair(axes, OLD, OLD_FAR, 0.9), self._pair(axes, TRACE, TRACE_FAR, 1.9)
        self.faces = Poly3DCollection(body.faces, linewidths=0.35, zorder=10)
        axes.add_collection3d(self.faces)
        self.rod = axes.plot([], [], [], color="0.1", lw=1.6, ls="-", solid_capstyle="round")[0]
        self.dot = axes.plot([], [], [], "o", color=DOT, ms=5.5, mec="white", mew=0.8)[0]
        self.name = axes.text(0.0, 0.0, 0.0, body.label, ha="center", va="center", zorder=30)
        halo(self.name, 2.2)
        top = np.array([0.0, 0.0, 1.38])
        arrow(axes, np.array([0.0, 0.0, 1.0]), top, VERTICAL, 1.1, zorder=31)
        axes.text(*(top + 0.06 * self.camera[0]), body.vertical, va="top", zorder=31)

    def _globe(self, axes: Any) -> None:
        """Disc, outline and three parallels of the unit sphere."""
        from mpl_toolkits.mplot3d.art3d import Poly3DCollection

        disc = parallel(0.0)[:, :2] @ self.camera[:2]
        axes.add_collection3d(Poly3DCollection([disc], facecolor="0.975", edgecolor="0.75", lw=0.6, zorder=0))
        for height in (0.0, math.sqrt(0.5), -math.sqrt(0.5)):
            ring = parallel(height)
            looks = {"color": "0.80", "lw": 0.5, "zorder": 20}, {"color": "0.89", "lw": 0.4, "zorder": 2}
            curve(axes, ring, ring @ self.camera[2] >= 0.0, looks)

    @staticmethod
    def _pair(axes: Any, near: str, far: str, width: float) -> tuple[Any, Any]:
        """Lines for the part of a curve in front of the body and for that behind it."""
        style = {"ls": "-", "solid_capstyle": "round", "solid_joinstyle": "round"}
        return (
            axes.plot([], [], [], color=near, lw=width, zorder=20, **style)[0],
            axes.plot([], [], [], color=far, lw=0.8 * width, zorder=2, **style)[0],
        )

    @property
    def moving(self) -> list[Any]:
        """Artists that ``show`` changes, the furthest first."""
        artists = (*self.old, *self.new, self.faces, self.rod, self.dot, self.name)
        return sorted(artists, key=lambda one: one.get_zorder())

    def _place(self, pair: tuple[Any, Any], points: Array) -> None:
        """Move a pair of lines to the curve (m, 3): its near part, and its far part."""
        for line, part in zip(pair, split(points, points @ self.camera[2] >= 0.0), strict=True):
            line.set_data_3d(*part.T)

    def show(self, row: int, since: int, rotation: Array) -> None:
        """Show the attitude ``rotation`` (3, 3) after the trace up to ``row``, whose part from ``since`` is strong."""
        normals = self.body.normals @ rotation.T
        near = normals @ self.camera[2] > 0.0
        colours = lit(self.body.colours[near], normals[near], self.camera, shade=0.48)
        self.faces.set_verts(list(self.body.faces[near] @ rotation.T))
        self.faces.set(facecolor=colours, edgecolor=colours)
        tip = rotation @ self.body.axis
        first, last = since // self.stride, row // self.stride
        self._place(self.old, self.path[: first + 1])
        self._place(self.new, np.vstack([self.path[first : last + 1], tip]))
        right, up, ahead = self.camera @ tip
        reach = self.reach if ahead >= 0.0 else 0.0
        self.rod.set_data_3d(*np.column_stack([reach * tip, tip]))
        self.rod.set_zorder(21 if ahead >= 0.0 else 3)
        self.dot.set_data_3d(*tip[:, None])
        self.dot.set_zorder(22 if ahead >= 0.0 else 4)
        out = np.array([right, up]) / max(math.hypot(right, up), 0.15)
        if abs(right) < 0.2 and abs(up) > 0.7:  # beside the arrow of the vertical, within the picture
            out = np.array([-1.0, 0.35])
        self.name.set_position_3d(tip + 0.14 * out @ self.camera[:2])


LARGEST_TURN = 0.5
"""Largest turn between two rows, in radians, from which an attitude is reconstructed."""
ASK = "--set output.attitude=quaternion"


@dataclass(frozen=True)
class BodyMotion:
    """Rows of a run: times (m,), attitudes as unit quaternions (m, 4), states (m, d) and invariants (m,) by name.

    ``states`` and ``invariants`` are empty if the run does not record the components. ``notes`` are messages about
    what is missing or reconstructed.
    """

    experiment: Experiment
    t: Array
    attitude: Array
    states: Array | None
    invariants: Mapping[str, Array]
    notes: tuple[str, ...]


def stored_body_motion(folder: Path) -> BodyMotion:
    """Motion of the finished or interrupted run in ``folder``.

    Raises UsageError if there is no run, or if its rows do not determine the attitude, and RunError if it is damaged.
    """
    run = intact_result(folder)
    experiment = _experiment(run)
    series = read_series(run.series)
    name, notes = experiment.name, []
    if run.outcome is not Outcome.COMPLETED:
        notes.append(f"{name}: {run.manifest['message']}")
    states = _states(experiment, series)
    attitude = quaternions_of(series)
    if attitude is None:
        attitude = _reconstructed(experiment, states, folder)
        notes.append(f"{name}: no attitude is recorded; reconstructed from the rows ({ASK} records the scheme's own)")
    good: NDArray[np.bool_] = np.isfinite(attitude).all(axis=1).reshape(-1)
    if not good[0] or good.sum() < 2:
        raise UsageError(f"{folder}: no motion to show: the attitude is not finite or has only one row")
    last = len(good) if good.all() else int(np.argmin(good))
    if last < len(good):
        notes.append(f"{name}: the attitude is not finite after row {last}")
    return BodyMotion(
        experiment,
        _times(experiment, series, len(good))[:last],
        attitude[:last],
        None if states is None else states[:last],
        _invariants(experiment, series, states, last),
        tuple(notes),
    )


def _experiment(run: StoredResult) -> Experiment:
    """Experiment of a run. Raises UsageError for an ensemble and for a scheme or top that is not known here."""
    config = run.manifest["config"]
    if "ensemble" in config:
        raise UsageError(f"{run.folder}: is an ensemble; run a single one of its trajectories")
    try:
        return load_experiment(config, any_precision=True)
    except (UsageError, ConfigError) as error:
        raise UsageError(f"{run.folder}: its config cannot be read here: {error.lines[0]}", *error.lines[1:]) from None


def _states(experiment: Experiment, series: Mapping[str, NDArray[Any]]) -> Array | None:
    """States (m, d) of the rows; None if a component is not recorded."""
    names = experiment.top.components
    return np.column_stack([series[name] for name in names]) if all(name in series for name in names) else None


def _times(experiment: Experiment, series: Mapping[str, NDArray[Any]], rows: int) -> Array:
    """Times (m,) of the rows, whose steps are the multiples of ``every``."""
    return series["t"] if "t" in series else np.arange(rows) * experiment.output.every * experiment.h


def _reconstructed(experiment: Experiment, states: Array | None, folder: Path) -> Array:
    """Attitudes (m, 4) from the states of the rows. Raises UsageError if there are too few columns or rows."""
    top, every = experiment.top, experiment.output.every
    if states is None:
        raise UsageError(
            f"{folder}: records neither the attitude nor all of {', '.join(top.components)}", f"run it with {ASK}"
        )
    from topcli.engine.attitude import attitude_of_rows, velocities

    turn = float(np.nanmax(np.linalg.norm(velocities(top, states), axis=1))) * abs(experiment.h) * every
    if not turn <= LARGEST_TURN:
        raise UsageError(
            f"{folder}: the body turns by up to {turn:.2g} radians from row to row, and no attitude is recorded",
            f"run it with {ASK}, or with rows at least {turn / LARGEST_TURN:.1f} times as dense (output.every)",
        )
    return attitude_of_rows(top, states, experiment.h * every)


def _invariants(
    experiment: Experiment, series: Mapping[str, NDArray[Any]], states: Array | None, rows: int
) -> dict[str, Array]:
    """Invariants of the top along the rows, recorded or evaluated."""
    known = experiment.top.invariants()
    values = {each.name: np.asarray(series[each.name], dtype=float) for each in known if each.name in series}
    if states is not None:
        with np.errstate(all="ignore"):
            values |= {each.name: each.value(states) for each in known if each.name not in values}
    return {each.name: values[each.name][:rows] for each in known if each.name in values}
