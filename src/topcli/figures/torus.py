"""Tori of the Kowalevski top: one with flow lines of E and k², and one with points of two maps.

The surface is drawn as small facets from back to front. A line is cut where the surface hides it. The maps have a long
step; their points are drawn beside the torus of the motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from topcli.analysis.leaving import step_of_leaving
from topcli.analysis.motion.torus import Torus
from topcli.config.load import load_experiment
from topcli.contracts import Array
from topcli.engine.fingerprint import fingerprint
from topcli.engine.run import Run
from topcli.errors import UsageError
from topcli.figures.figure import Loaded, Request, code_of
from topcli.figures.picture import Grid, caption, halo
from topcli.figures.scene3d import arrow, lit, projection, quads, split
from topcli.figures.scenes import scene_config
from topcli.figures.style import Styles, looks
from topcli.schemes.display import display_name
from topcli.studies.entries import under_scheme

if TYPE_CHECKING:
    from topcli.config.models import Experiment

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
COUNTS, POINTS = range(10, 17), 361
"""Numbers of lines of one kind, of which the best is chosen (``_closing_count``), and points of a line."""
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

    corners = quads(fine)
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


def load_torus(request: Request) -> Loaded:
    """Load the torus of the scene. Raises UsageError for a scene of another top or without a torus."""
    experiment = load_experiment(scene_config("kowalevski_torus", request.configs))
    if experiment.top.kind != "kowalevski":
        raise UsageError(f"torus: {experiment.name} is of the top {experiment.top.kind}, not kowalevski")
    y, c = tuple(experiment.y0), float(experiment.top.constants()[0])
    source = {
        "state": [*y, c],
        "size": [ROWS, COLUMNS, list(COUNTS), POINTS, RETURNS],
        "projection": PROJECTION.tolist(),
        "code": fingerprint(
            Torus.states, Torus.surface, Torus.motion_line, Torus._lines, Torus.turn, _closing_count, compiled=False
        ),
    }
    return Loaded((TorusPanel(elevation=32.0, azimuth=165.0),), lambda: _data(y, c), source, Grid(figsize=(5.4, 4.8)))


def _data(y: tuple[float, ...], c: float) -> dict[str, np.ndarray]:
    try:
        torus = Torus.of(y, c)
    except ValueError as error:
        raise UsageError(f"torus: {error}") from None
    parts = {
        "surface": torus.surface(ROWS, COLUMNS).reshape(-1, 6) @ PROJECTION.T,
        "energy": _separated(torus.energy_lines(_closing_count(torus, 1), POINTS, 0.5 * RETURNS) @ PROJECTION.T),
        "k_sq": _separated(torus.k_sq_lines(_closing_count(torus, 0), POINTS) @ PROJECTION.T),
        "motion": torus.motion_line(RETURNS, 2 * POINTS) @ PROJECTION.T,
    }
    return {f"{part}:{name}": values[:, i] for part, values in parts.items() for i, name in enumerate(AXES)}


def _closing_count(torus: Torus, axis: int) -> int:
    """Number of lines over one period of the angle ``axis`` of which each ends nearly where another begins."""
    turn = torus.turn(torus.energy_rates if axis else torus.k_sq_rates, axis)
    return min(COUNTS, key=lambda count: abs(count * turn - round(count * turn)))


def _separated(lines: np.ndarray) -> np.ndarray:
    """Lines (count, points, 3) one after the other, with nan between."""
    return np.pad(lines, ((0, 0), (0, 1), (0, 0)), constant_values=np.nan).reshape(-1, 3)


SCENE = "kowalevski_generic_backlund"
MAP_POINTS = 1_000_000
SCHEMES = ("backlund", "hk")
FLOW = "taylor"
FLOW_STEP, FLOW_STEPS = 0.02, 500_000
SEEN = (0, 1, 5)
"""Components of the state that are seen: omega1, omega2, gamma3, in which the torus does not meet itself."""
CUT, SECTION = 0, (1, 4)
"""The section is at omega1 = 0; omega2 and gamma2 are shown."""
THICKNESS = 0.01
"""Largest ``abs(omega1)`` of a point of a map on the section."""

SPANS = {"x": (-1.7, 1.7), "y": (-1.9, 1.9), "z": (-1.8, 1.8)}
"""Parts of the axes omega1, omega2, gamma3 that are seen; each is shown with the same length."""
SEEN_LABELS = {"x": r"$\omega_1$", "y": r"$\omega_2$", "z": r"$\gamma_3$"}
ELEVATION, AZIMUTH = 52.0, 18.0
FRAME = 1.35
"""Half the width of the picture; an axis has the length 2."""
PICTURE_CELLS = 1000
"""Cells across a picture, somewhat smaller than its pixels in print and than a third of a point."""
CORNER, ARROW = np.array([-1.05, -0.98]), 0.28


@dataclass(frozen=True)
class TorusView:
    """Points of a map in shades of the scheme's colour: nearer ones hide farther ones and are darker.

    A map with fewer than ``whole`` points has left the energy surface after them.
    """

    scheme: str
    title: str
    whole: int

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the points, and arrows along the axes, into ``axes``."""
        points = np.column_stack([data[f"{self.scheme}:{axis}"] for axis in SPANS]).astype(float)
        points = points[np.isfinite(points).all(axis=1)]
        low, high = np.array(list(SPANS.values())).T
        camera = projection(ELEVATION, AZIMUTH)
        seen = (2.0 * points - (low + high)) / (high - low) @ camera.T
        seen = seen[np.abs(seen[:, :2]).max(axis=1) <= FRAME]
        right, up, depth = _not_hidden(seen[np.argsort(seen[:, 2], kind="stable")]).T
        size = 0.35 if len(right) > 100_000 else 0.8
        shades = _shades(looks([self.scheme])[self.scheme]["color"])
        axes.scatter(right, up, c=depth, s=size, lw=0.0, cmap=shades, vmin=-0.65, vmax=0.65, rasterized=True)
        for label, tip in zip(SEEN_LABELS.values(), ARROW * camera[:2].T, strict=True):
            style = {"arrowstyle": "->", "lw": 0.8, "shrinkA": 0, "shrinkB": 0}
            axes.annotate("", CORNER + tip, CORNER, arrowprops=style)
            halo(axes.text(*(CORNER + 1.45 * tip), label, ha="center", va="center", fontsize=9))
        axes.set(xlim=(-FRAME, FRAME), ylim=(-FRAME, FRAME), xticks=[], yticks=[], aspect="equal")
        end = "" if len(points) >= self.whole else ", then lost"
        axes.set_title(f"{self.title}, {len(points):,} points{end}", loc="left")


def _shades(colour: str) -> Any:
    """Map of depths to shades of a colour, from a pale one, of the farthest points, to a dark one."""
    from matplotlib.colors import LinearSegmentedColormap, to_rgb

    own = np.array(to_rgb(colour))
    return LinearSegmentedColormap.from_list("shades", [0.8 + 0.2 * own, 0.55 * own])


def _not_hidden(points: np.ndarray) -> np.ndarray:
    """The projected ``points`` (m, 3), the farthest first, without those in the same cell as a nearer one."""
    cells = np.floor(points[::-1, :2] * (PICTURE_CELLS / (2.0 * FRAME))).astype(np.int64)
    _, nearest = np.unique(cells @ [1, 2 * PICTURE_CELLS], return_index=True)
    return points[len(points) - 1 - np.sort(nearest)[::-1]]


@dataclass(frozen=True)
class TorusSection:
    """Points of a map near omega1 = 0 over the section of the torus of the motion."""

    scheme: str
    title: str

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the section of the torus in grey and the points into ``axes``."""
        u, v, x, y = (data[f"{name}:{axis}"] for name in ("flow", self.scheme) for axis in "uv")
        axes.plot(u, v, "s", color="0.75", ms=3.4, mew=0.0, rasterized=True, label="motion")
        size = 1.8 if np.isfinite(x).sum() > 1000 else 3.0
        colour, name = looks([self.scheme])[self.scheme]["color"], display_name(self.scheme)
        axes.plot(x, y, ".", color=colour, ms=size, mew=0.0, rasterized=True, label=name)
        axes.legend(loc="lower right", markerscale=3.0, fontsize="small")
        axes.set(xlim=(-2.1, 2.1), ylim=(-1.7, 1.7))
        caption(axes, r"$\omega_2$", r"$\gamma_2$", self.title)


def load_torus_points(request: Request) -> Loaded:
    """Load the points of the two maps."""
    ours, other = SCHEMES
    near = rf"$|\omega_1| < {THICKNESS:g}$"
    panels = (
        TorusView(ours, f"(a) {display_name(ours)}", MAP_POINTS),
        TorusView(other, f"(b) {display_name(other)}", MAP_POINTS),
        TorusSection(ours, f"(c) {near}"),
        TorusSection(other, f"(d) {near}"),
    )
    layout = Grid(2, (7.0, 6.7), heading="Kowalevski top, $h = 1$; in (a) and (b) nearer points are darker")
    return Loaded(panels, torus_columns, {"study": torus_code()}, layout)


def _experiment(scheme: str) -> Experiment:
    return under_scheme(load_experiment(SCENE), scheme)


def orbit(experiment: Experiment, steps: int, h: float) -> Array:
    """States (m, d) after up to ``steps`` steps of ``h``, without those after the energy surface is left."""
    recorded = Run(experiment.top, experiment.method(), experiment.y0, h, steps).collect()
    left = step_of_leaving(experiment.top, recorded.n, recorded.states)
    return recorded.states[:left]


def crossings(states: Array, rates: Array, h: float) -> Array:
    """States (m, d) of a motion where omega1 = 0, from samples ``h`` apart and their rates of change, both (n, d).

    Between two samples the motion is Hermite's cubic; its zero is found by bisection.
    """
    before = np.flatnonzero(np.signbit(states[:-1, CUT]) != np.signbit(states[1:, CUT]))
    a, b = states[before], states[before + 1]
    p, q = h * rates[before], h * rates[before + 1]

    def at(s: Array) -> Array:
        s = s[:, None]
        return a + s * (p + s * ((3.0 * (b - a) - 2.0 * p - q) + s * (2.0 * (a - b) + p + q)))

    low, high = np.zeros(len(before)), np.ones(len(before))
    for _ in range(50):
        middle = 0.5 * (low + high)
        same = np.signbit(at(middle)[:, CUT]) == np.signbit(a[:, CUT])
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return at(0.5 * (low + high))


def torus_columns() -> Mapping[str, Array]:
    """Columns of the figure.

    ``<scheme>:x``, ``:y`` and ``:z`` are the points as they are seen, ``<scheme>:u`` and ``:v`` those on the section,
    and ``flow:u`` and ``flow:v`` the motion on the section.
    """
    columns: dict[str, Array] = {}
    for name in SCHEMES:
        experiment = _experiment(name)
        states = orbit(experiment, MAP_POINTS - 1, experiment.h)
        near = states[np.abs(states[:, CUT]) < THICKNESS]
        columns |= {f"{name}:{axis}": states[:, i].astype(np.float32) for axis, i in zip("xyz", SEEN, strict=True)}
        columns |= {f"{name}:{axis}": near[:, i].astype(np.float32) for axis, i in zip("uv", SECTION, strict=True)}
    experiment = _experiment(FLOW)
    states = orbit(experiment, FLOW_STEPS, FLOW_STEP)
    p = experiment.top.constants()
    rates = np.array(type(experiment.top).field(tuple(states.T), p)).T  # the field is arithmetic: it takes arrays
    on_cut = crossings(states, rates, FLOW_STEP)
    columns |= {f"flow:{axis}": on_cut[:, i].astype(np.float32) for axis, i in zip("uv", SECTION, strict=True)}
    return columns


def torus_code() -> str:
    """Digest of everything that the columns depend on; equal digests mean equal columns."""
    settings = MAP_POINTS, FLOW_STEP, FLOW_STEPS, SEEN, CUT, SECTION, THICKNESS
    return code_of(map(_experiment, (*SCHEMES, FLOW)), [orbit, crossings], *settings)
