"""Bifurcation diagram of the Kowalevski top, and the picture of one motion.

The diagram has regions with their numbers of tori, critical curves, and scenes. A motion of the Kowalevski top is a
place in it, that of an Euler top a polhode on the energy ellipsoid, that of a Lagrange top the trace of its axis; any
other is drawn as components over time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from topcli.analysis.motion import Motion
from topcli.analysis.motion.diagram import REGIONS, branches, regions
from topcli.analysis.reference import reference_states
from topcli.config.load import load_experiment
from topcli.contracts import Array, Top
from topcli.figures.curves import plain
from topcli.figures.figure import Loaded, Request
from topcli.figures.picture import DASHED, Drawable, Grid, Line, Panel, caption, component_symbol, halo
from topcli.figures.space import Polhodes, Sphere
from topcli.figures.style import Styles
from topcli.schemes.kowalevski.curve import Integrals
from topcli.tops.euler import Euler
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange, LagrangeInertial

TINTS = ("#FFFFFF", "#DCE9F5", "#E3F0DC", "#F6EBD3", "#F5DDD9", "#E4DCEF")
"""Colours of no motion and of the regions I to V."""
KINDS: dict[str, tuple[str, dict[str, Any]]] = {
    "separatrix": ("separatrix", {"color": "0.1", "linestyle": "-", "linewidth": 1.4}),
    "pinch": ("pinch", {"color": "#B2182B", "linestyle": (0, (4, 1.5)), "linewidth": 1.6}),
    "periodic": (
        r"periodic: $E-2\ell^2=-k$",
        {"color": "#0072B2", "linestyle": (0, (7, 1.5, 1.5, 1.5)), "linewidth": 1.8},
    ),
    "delone": (r"Delone: $k=0$", {"color": "#009E73", "linestyle": "-", "linewidth": 2.6}),
    "bobylev-steklov": ("Bobylev, Steklov", {"color": "#0072B2", "linestyle": (0, (1, 1.2)), "linewidth": 1.4}),
    "change": (r"$E-2\ell^2=k$: no bifurcation", {"color": "0.5", "linestyle": "-", "linewidth": 0.6}),
}
"""Kinds of critical curves and the boundary of II and III: labels and looks, in the order of the legend."""
LEVELS = {"change": 2.5, "bobylev-steklov": 3.0}
"""Kinds that others cover where they coincide."""
PIXELS = (700, 500)
SMALL, MEDIUM, LARGE = 0.035, 0.045, 0.1
"""Radius of the largest circle in a part of a region, relative to the panel, from which its name is written, and from
which its tori are; these are also written, smaller, into the largest part of each region above the medium radius."""


@dataclass(frozen=True)
class Diagram:
    """Diagram in the plane of E and k² for one ``two_l``, with the motion of ``scene`` as a point.

    The columns are ``number:kind:E`` and ``number:kind:k_sq`` for the ``kinds`` of critical curves, with nan between
    their parts, and ``number:scene:E`` and ``number:scene:k_sq``. By default the ``title`` is a letter and ``two_l``.
    """

    number: int
    two_l: float
    energies: tuple[float, float]
    k_sq: tuple[float, float]
    scene: str
    kinds: tuple[str, ...]
    title: str = ""

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw regions, curves and the point of the scene into ``axes``."""
        point = None
        if self.scene:
            E, k_sq = (float(data[f"{self.number}:scene:{axis}"][0]) for axis in AXES)
            point = E, k_sq
            self._mark(axes, E, k_sq)
        self._tint(axes, point)
        for kind in self.kinds:
            label, look = KINDS[kind]
            x, y = (data[f"{self.number}:{kind}:{axis}"] for axis in AXES)
            axes.plot(x, y, label=label, zorder=LEVELS.get(kind, 4.0), **look)
        axes.set(xlim=self.energies, ylim=self.k_sq)
        axes.grid(False)
        caption(axes, "energy $E$", "$k^2$", self.title or rf"({'abcdef'[self.number]}) $2\ell = {self.two_l:.6g}$")

    def _mark(self, axes: Any, E: float, k_sq: float) -> None:
        """Draw the point of the scene and its name."""
        axes.plot([E], [k_sq], "o", color="0.05", markersize=5.0, markeredgecolor="white", zorder=6, label="_scene")
        look = {"textcoords": "offset points", "fontsize": 8, "zorder": 7, "va": "center"}
        text = axes.annotate(self.scene, (E, k_sq), xytext=(6, 0), **look)
        halo(text)

    def _tint(self, axes: Any, point: tuple[float, float] | None) -> None:
        """Tint the regions, and write names and numbers of tori into their parts that are large enough."""
        from matplotlib.colors import ListedColormap

        E = _centres(*self.energies, PIXELS[0])[None, :]
        k_sq = _centres(*self.k_sq, PIXELS[1])[:, None]
        codes = regions(E, k_sq, 0.5 * self.two_l, 1.0)
        extent = (*self.energies, *self.k_sq)
        axes.imshow(
            codes, extent=extent, origin="lower", aspect="auto", cmap=ListedColormap(TINTS), vmin=-0.5, vmax=5.5
        )
        free = np.ones(codes.shape, dtype=bool)
        if point is not None:  # room for the name of the scene
            beside = point[0] - 0.05 * np.ptp(self.energies) < E
            free &= ~(beside & (np.abs(k_sq - point[1]) < 0.12 * np.ptp(self.k_sq)))
        for code, (name, region) in enumerate(REGIONS.items(), 1):
            parts = [part for part in _middles(codes == code, free) if part[2] > SMALL * PIXELS[1]]
            for row, column, radius in sorted(parts, key=lambda part: -part[2]):
                large, number = radius > LARGE * PIXELS[1], f"{region.tori} {'tori' if region.tori > 1 else 'torus'}"
                widest = radius == max(part[2] for part in parts) and radius > MEDIUM * PIXELS[1]
                text = f"{name}\n{number}" if large or widest else name
                at = (float(E[0, column]), float(k_sq[row, 0]))
                size = 9.0 if large or text == name else 7.0
                axes.text(*at, text, ha="center", va="center", color="0.25", fontsize=size, zorder=5)


AXES = ("E", "k_sq")
SECOND = list(REGIONS).index("II") + 1
"""Code of the region II; that of III follows."""


def _centres(low: float, high: float, count: int) -> np.ndarray:
    return low + (high - low) * (np.arange(count) + 0.5) / count


def _middles(mask: np.ndarray, free: np.ndarray) -> list[tuple[int, int, float]]:
    """Row and column of the ``free`` point of each connected part of the mask that is furthest from the edges.

    The third number is its distance from them.
    """
    from scipy.ndimage import distance_transform_edt, find_objects, label

    parts: Any = label(mask)[0]  # type: ignore[index]
    middles = []
    for part, box in enumerate(find_objects(parts), 1):
        inside = (parts[box] == part) & free[box]
        distance: Any = distance_transform_edt(np.pad(inside, 1))
        row, column = np.unravel_index(int(np.argmax(distance)), distance.shape)
        place = box[0].start + int(row) - 1, box[1].start + int(column) - 1
        middles.append((*place, float(distance[row, column])))
    return middles


@dataclass(frozen=True)
class Window:
    """Part of the plane that is drawn for the 2l of ``scene``, or for ``two_l`` if there is none."""

    energies: tuple[float, float]
    k_sq: tuple[float, float]
    scene: str = ""
    two_l: float = 0.0


WINDOWS = (
    Window((-0.9, 4.9), (0.0, 3.0), "kowalevski_generic_hk"),
    Window((-0.9, 2.9), (0.0, 2.0), "kowalevski_torus"),
    Window((1.66, 2.06), (0.0, 0.1), two_l=1.85),
    Window((3.0, 12.5), (0.0, 20.0), "kowalevski_hk"),
)


def load_bifurcation(request: Request) -> Loaded:
    """Load the panels of the windows."""
    panels, data = [], {}
    for number, window in enumerate(WINDOWS):
        two_l = window.two_l
        if window.scene:
            experiment = load_experiment(window.scene)
            of = Integrals.of(experiment.y0, experiment.top.constants()[0])
            two_l = 2.0 * float(of.L)
            data |= curve_columns(number, {"scene": np.array([[3.0 * float(of.l1)], [float(of.k_sq)]])})
        curves = critical_curves(two_l, window.energies, window.k_sq)
        data |= curve_columns(number, curves)
        panels.append(Diagram(number, two_l, window.energies, window.k_sq, window.scene, tuple(curves)))
    source = {"panels": [repr(panel) for panel in panels]}
    return Loaded(tuple(panels), lambda: data, source, Grid(2, (7.0, 6.2), ncols=3, fontsize=9.0, handlelength=DASHED))


def curve_columns(number: int, curves: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns of curves (2, m) of the panel ``number``."""
    return {f"{number}:{kind}:{axis}": curve[i] for kind, curve in curves.items() for i, axis in enumerate(AXES)}


def critical_curves(two_l: float, energies: tuple[float, float], k_sq: tuple[float, float]) -> dict[str, np.ndarray]:
    """Critical curves of each kind in a window, in the order of the legend: E and k² (2, m), nan between parts."""
    parts: dict[str, list[np.ndarray]] = {kind: [] for kind in KINDS}
    for branch in branches(0.5 * two_l, 1.0, energies, k_sq):
        if branch.kind in parts:
            parts[branch.kind] += [np.array([branch.E, branch.k_sq]), np.full((2, 1), np.nan)]
    k = np.sqrt(np.linspace(*k_sq, SAMPLES + 1))
    E = 0.5 * two_l**2 + k
    sides = [regions(E + side * 1e-6 * np.ptp(energies), k**2, 0.5 * two_l, 1.0) for side in (-1.0, 1.0)]
    between = (np.min(sides, axis=0) == SECOND) & (np.max(sides, axis=0) == SECOND + 1) & (energies[1] > E)
    if between.any():
        parts["change"].append(np.where(between, [E, k**2], np.nan))
    return {kind: np.hstack(some) for kind, some in parts.items() if some}


Drawn = tuple[Drawable, dict[str, np.ndarray]]
"""Panel and its data."""
SAMPLES, MOST_SAMPLES = 240, 6000
"""Points of one oscillation or revolution, and of a curve."""
MOST_NUTATIONS = 12
LEFT, RIGHT, BESIDE = 2.1, 1.12, 0.5
"""In units of the largest k: ends of the diagram from its middle, the left one with room for the legend, and room on
the right of the motion."""
TURNS = 4.0
"""Revolutions at the initial rate for which a motion without a period is drawn."""
LARGEST = 1e12
"""Largest integral in units of gravity; the diagram has no structure near larger ones."""
WEIGHTLESS = 1e-30
"""Length of the axis for a top without gravity in the inertial frame, where it does not react on the momentum."""
AXIS = ("a1", "a2", "a3")


def motion_drawn(top: Top, motion: Motion, name: str) -> Drawn:
    """Panel and data for the ``motion`` of ``top``, the one with a closed form (``closed_form_top``).

    ``name`` is that of the experiment. Raises UsageError and RunError if the state is too large to be followed.
    """
    if isinstance(top, Kowalevski) and top.constants()[0] and any(motion.state[3:]):
        return _diagram(top, motion, name)
    if isinstance(top, Euler) and len({top.A, top.B, top.C}) == 3 and any(motion.state[:3]):
        return _polhode(top, motion)
    if isinstance(top, Lagrange | LagrangeInertial) and any(motion.state[3:]):
        return _trace(top, motion)
    return _components(top, motion)


@dataclass(frozen=True)
class PlaceDiagram(Diagram):
    """Bifurcation diagram with its own legend, in the corner of the plane where there is no motion."""

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the diagram and the legend into ``axes``."""
        super().paint(axes, data, styles)
        axes.legend(loc="lower left", fontsize="small", frameon=False, handlelength=DASHED, borderaxespad=0.3)

    def _mark(self, axes: Any, E: float, k_sq: float) -> None:
        """Draw the point of the motion, whose name is in the legend."""
        look = {"color": "0.05", "linestyle": "none", "markersize": 5.0, "markeredgecolor": "white"}
        axes.plot([E], [k_sq], marker="o", zorder=6, label=self.scene, **look)


def _diagram(top: Kowalevski, motion: Motion, name: str) -> Drawn:
    """Place in the plane of E and k², in units in which c |gamma| = 1."""
    of = Integrals.of(motion.state, top.constants()[0])
    unit = math.sqrt(float(of.G))
    E, k_sq, two_l = 3.0 * float(of.l1) / unit, float(of.k_sq) / unit**2, 2.0 * float(of.L) / unit**1.5
    if max(abs(E), k_sq, abs(two_l)) > LARGEST:
        return _components(top, motion)
    middle, high = 0.5 * two_l**2, max(2.0 * k_sq, 2.0)
    width = math.sqrt(high)
    energies = middle - LEFT * width, max(middle + RIGHT * width, E + BESIDE * width)
    curves = critical_curves(two_l, energies, (0.0, high))
    data = curve_columns(0, {**curves, "scene": np.array([[E], [k_sq]])})
    units = "" if unit == top.C == top.c0 == 1.0 else r" in units in which $C = c_0 = |\boldsymbol{\gamma}| = 1$"
    title = rf"$2\ell = {two_l:.6g}${units}"
    panel = PlaceDiagram(0, two_l, energies, (0.0, high), plain(name), tuple(curves), title)
    return panel, data


def _polhode(top: Euler, motion: Motion) -> Drawn:
    """The polhode on the energy ellipsoid."""
    states = reference_states(top, motion.state, _times(motion, ("period",)))
    panel = Polhodes((top.A, top.B, top.C), label="the motion")
    return panel, {name: states[:, i] for i, name in enumerate(panel.omega)}


def _trace(top: Lagrange | LagrangeInertial, motion: Motion) -> Drawn:
    """Trace of the axis on the sphere, with the vertical upright."""
    state = np.array(motion.state)
    sign = 1.0
    if isinstance(top, Lagrange):
        sign = math.copysign(1.0, top.mu)
        state = _in_space(top, state)
    axis = reference_states(LagrangeInertial(), state.tolist(), _nutations(motion))[:, 3:]
    axis *= sign / np.linalg.norm(axis, axis=1)[:, None]
    panel = Sphere("", AXIS, elevation=_elevation(axis), alone=True)
    return panel, {name: axis[:, i] for i, name in enumerate(AXIS)}


def _in_space(top: Lagrange, state: Array) -> Array:
    """State (6,) of the inertial form, in units with A = 1, whose motion is that of ``state`` in the body frame."""
    size = float(np.linalg.norm(state[3:]))
    up = state[3:] / size
    side = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    side /= np.linalg.norm(side)
    to_space = np.array([side, np.cross(up, side), up])
    momentum = to_space @ (state[:3] * [1.0, 1.0, top.C / top.A])
    weight = top.mu / top.A * size or WEIGHTLESS
    return np.concatenate([momentum, weight * to_space[:, 2]])


def _elevation(axis: Array) -> float:
    """Elevation of a viewer who sees the trace from above or from below, in degrees."""
    return 60.0 if axis[:, 2].mean() > -0.2 else -60.0


def _nutations(motion: Motion) -> Array:
    """Times over the nutations in which the axis precesses about once, at most ``MOST_NUTATIONS`` of them."""
    if "precession.per_nutation" not in motion:
        rate = abs(motion["frequency.precession"]) if "frequency.precession" in motion else 0.0
        return np.linspace(0.0, 1.0 / rate, SAMPLES + 1) if rate else _times(motion, ())
    each = abs(motion["precession.per_nutation"])
    count = min(max(math.ceil(0.999 / each) if each else 2, 2), MOST_NUTATIONS)
    samples = min(math.ceil(SAMPLES * count * max(1.0, each)), MOST_SAMPLES)
    return np.linspace(0.0, count * motion["period.nutation"], samples + 1)


def _times(motion: Motion, periods: tuple[str, ...]) -> Array:
    """Times of one of the ``periods``; if none is finite, of some revolutions at the initial rate."""
    for name in periods:
        if name in motion and math.isfinite(motion[name]):
            return np.linspace(0.0, motion[name], SAMPLES + 1)
    rate = math.hypot(*motion.state[:3]) or 1.0
    return np.linspace(0.0, TURNS * 2.0 * math.pi / rate, MOST_SAMPLES // 4 + 1)


def _components(top: Top, motion: Motion) -> Drawn:
    """Components of the first vector over time."""
    times = _times(motion, ("period",))
    states = reference_states(top, motion.state, times)
    name, (begin, end) = next(iter(top.vectors.items()))
    names = top.components[begin:end]
    data = {one: states[:, begin + i] for i, one in enumerate(names)}
    label = rf"$\boldsymbol{{\{name}}}$" if len(name) > 1 else rf"$\boldsymbol{{{name}}}$"
    return Panel(tuple(Line(one, component_symbol(one)) for one in names), label), {"t": times, **data}
