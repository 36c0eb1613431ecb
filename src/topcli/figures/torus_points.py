"""Figure of the points of two maps with a long step, beside the torus of the motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from topcli.analysis.columns import step_of_leaving
from topcli.config.load import load_experiment
from topcli.contracts import Array
from topcli.engine.fingerprint import fingerprint
from topcli.engine.loop import Run
from topcli.figures.figure import Loaded, Request
from topcli.figures.picture import Grid, Styles, caption, halo
from topcli.figures.scene3d import TRACE, projection
from topcli.runs.identity import method_fingerprint
from topcli.studies.entries import under_scheme

if TYPE_CHECKING:
    from topcli.config.models import Experiment

SCENE = "kowalevski_generic_backlund"
POINTS = 1_000_000
SCHEMES = ("backlund", "hk")
FLOW = "taylor"
FLOW_STEP, FLOW_STEPS = 0.02, 500_000
SEEN = (0, 1, 5)
"""Components of the state that are seen: omega1, omega2, gamma3, in which the torus does not meet itself."""
CUT, SECTION = 0, (1, 4)
"""The section is at omega1 = 0; omega2 and gamma2 are shown."""
THICKNESS = 0.01
"""Largest ``abs(omega1)`` of a point of a map on the section."""

SPANS = {"x": (-1.2, 1.45), "y": (-1.6, 1.6), "z": (-1.1, 1.15)}
"""Parts of the axes omega1, omega2, gamma3 that are seen; each is shown with the same length."""
LABELS = {"x": r"$\omega_1$", "y": r"$\omega_2$", "z": r"$\gamma_3$"}
ELEVATION, AZIMUTH = 52.0, 18.0
FRAME = 1.35
"""Half the width of the picture; an axis has the length 2."""
CORNER, ARROW = np.array([-1.05, -0.98]), 0.28
COLOURS = "viridis"


@dataclass(frozen=True)
class TorusView:
    """Points of a map, of which nearer ones hide farther ones and are lighter.

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
        right, up, depth = seen[np.argsort(seen[:, 2], kind="stable")].T
        size = 0.35 if len(right) > 100_000 else 0.8
        axes.scatter(right, up, c=depth, s=size, lw=0.0, cmap=COLOURS, vmin=-1.2, vmax=1.2, rasterized=True)
        for label, tip in zip(LABELS.values(), ARROW * camera[:2].T, strict=True):
            style = {"arrowstyle": "->", "lw": 0.8, "shrinkA": 0, "shrinkB": 0}
            axes.annotate("", CORNER + tip, CORNER, arrowprops=style)
            halo(axes.text(*(CORNER + 1.45 * tip), label, ha="center", va="center", fontsize=9))
        axes.set(xlim=(-FRAME, FRAME), ylim=(-FRAME, FRAME), xticks=[], yticks=[], aspect="equal")
        end = "" if len(points) >= self.whole else ", then lost"
        axes.set_title(f"{self.title}, {len(points):,} points{end}", loc="left")


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
        axes.plot(x, y, ".", color=TRACE, ms=size, mew=0.0, rasterized=True, label=self.scheme)
        axes.set(xlim=(-2.1, 2.1), ylim=(-1.7, 1.7))
        caption(axes, r"$\omega_2$", r"$\gamma_2$", self.title)


def load_torus_points(request: Request) -> Loaded:
    """Load the points of the two maps."""
    ours, other = SCHEMES
    near = rf"$|\omega_1| < {THICKNESS:g}$"
    panels = (
        TorusView(ours, f"(a) {ours}, $h = 1$", POINTS),
        TorusView(other, f"(b) {other}, $h = 1$", POINTS),
        TorusSection(ours, f"(c) {ours}, {near}; grey: the motion"),
        TorusSection(other, f"(d) {other}, {near}"),
    )
    return Loaded(panels, torus_columns, {"study": torus_code()}, Grid(2, (7.0, 6.4)))


def _experiment(scheme: str) -> Experiment:
    return under_scheme(load_experiment(SCENE), scheme, None)


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
        states = orbit(experiment, POINTS - 1, experiment.h)
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
    made = [_experiment(name) for name in (*SCHEMES, FLOW)]
    digests = [method_fingerprint(one.method()) + one.digest for one in made]
    settings = [POINTS, FLOW_STEP, FLOW_STEPS, SEEN, CUT, SECTION, THICKNESS]
    return fingerprint(orbit, crossings, compiled=False) + "".join(digests) + repr(settings)
