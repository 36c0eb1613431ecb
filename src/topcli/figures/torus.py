"""Figure ``torus-points``: points of two maps with a long step on a section, beside the torus of the motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from topcli.config.load import load_experiment
from topcli.contracts import Array
from topcli.engine.collect import orbit
from topcli.figures.figure import Loaded, Request
from topcli.figures.picture import Grid, caption
from topcli.figures.style import Styles, looks
from topcli.schemes.display import display_name
from topcli.studies.entries import under_scheme

if TYPE_CHECKING:
    from topcli.config.models import Experiment

SCENE = "kowalevski_generic_backlund"
MAP_POINTS = 1_000_000
SCHEMES = ("backlund", "hk")
FLOW = "taylor"
FLOW_STEP, FLOW_STEPS = 0.02, 500_000
CUT, SECTION = 0, (1, 4)
"""The section is at omega1 = 0; omega2 and gamma2 are shown."""
THICKNESS = 0.01
"""Largest ``abs(omega1)`` of a point of a map on the section."""


@dataclass(frozen=True)
class TorusSection:
    """Points of a map near omega1 = 0 over the section of the torus of the motion.

    A map with fewer than ``MAP_POINTS`` points has left the energy surface after them.
    """

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
        count = int(data[f"{self.scheme}:points"][0])
        end = "" if count >= MAP_POINTS else ", then lost"
        caption(axes, r"$\omega_2$", r"$\gamma_2$", f"{self.title} {name}: {count:,} points{end}")


def load_torus_points(request: Request) -> Loaded:
    """Load the points of the two maps."""
    panels = tuple(TorusSection(scheme, letter) for scheme, letter in zip(SCHEMES, ("(a)", "(b)"), strict=True))
    layout = Grid(figsize=(7.0, 3.6), heading=rf"Kowalevski top, $h = 1$: points with $|\omega_1| < {THICKNESS:g}$")
    return Loaded(panels, torus_columns, {"scenes": [_experiment(name).digest for name in (*SCHEMES, FLOW)]}, layout)


def _experiment(scheme: str) -> Experiment:
    return under_scheme(load_experiment(SCENE), scheme)


def motion(experiment: Experiment, steps: int, h: float) -> Array:
    """States (m, d) after up to ``steps`` steps of ``h``, without those after the energy surface is left."""
    top = experiment.top
    recorded = orbit(top, experiment.method(), experiment.y0, h, steps, invariants=top.invariants())
    return recorded.states[: recorded.ending.left]


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

    ``<scheme>:u`` and ``:v`` are the points of a map near the section, ``:points`` is the number of all its points,
    and ``flow:u`` and ``flow:v`` are the motion on the section.
    """
    columns: dict[str, Array] = {}
    for name in SCHEMES:
        experiment = _experiment(name)
        states = motion(experiment, MAP_POINTS - 1, experiment.h)
        near = states[np.abs(states[:, CUT]) < THICKNESS]
        columns[f"{name}:points"] = np.array([float(len(states))])
        columns |= {f"{name}:{axis}": near[:, i].astype(np.float32) for axis, i in zip("uv", SECTION, strict=True)}
    experiment = _experiment(FLOW)
    states = motion(experiment, FLOW_STEPS, FLOW_STEP)
    p = experiment.top.constants()
    rates = np.array(type(experiment.top).field(tuple(states.T), p)).T  # the field is arithmetic: it takes arrays
    on_cut = crossings(states, rates, FLOW_STEP)
    columns |= {f"flow:{axis}": on_cut[:, i].astype(np.float32) for axis, i in zip("uv", SECTION, strict=True)}
    return columns
