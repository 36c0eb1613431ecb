"""Picture of one exact motion.

A motion of the Kowalevski top is a place in the bifurcation diagram, and that of an Euler top a polhode on the energy
ellipsoid. Of any other top with a vertical, its trace on the sphere is drawn, and of the rest the components over time.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from topcli.analysis.motion import Motion
from topcli.analysis.reference import reference_states
from topcli.contracts import Array, Top
from topcli.figures.diagram import DASHED, critical_curves, draw_diagram, place_of_motion
from topcli.figures.figure import Drawing
from topcli.figures.labels import component_symbol, labelled, legend_under
from topcli.figures.space import SPATIAL, draw_polhodes, draw_trace
from topcli.tops.euler import Euler
from topcli.tops.kowalevski import Kowalevski

SAMPLES, PERIODS = 240, 8
"""Points of a period, and the number of nutations that are drawn."""
TURNS = 4.0
"""Revolutions at the initial rate for which a motion without a period is drawn."""
LARGEST_INTEGRAL = 1e12
"""Largest integral in units of gravity; the diagram has no structure near larger ones."""


def motion_drawing(top: Top, motion: Motion, name: str) -> tuple[Drawing, str | None]:
    """Function that draws the ``motion`` of ``top``, the one with a closed form, and the projection of its axes.

    ``name`` is that of the experiment. Raises UsageError and RunError if the state is too large to be followed.
    """
    moving, turned = any(motion.state[:3]), any(motion.state[3:])
    if isinstance(top, Kowalevski) and top.constants()[0] and turned:
        place = place_of_motion(motion.state, top.constants()[0])
        if max(map(abs, place)) <= LARGEST_INTEGRAL:
            return lambda axes: _draw_place(axes, place, name), None
    times = _times(motion)
    states = reference_states(top, motion.state, times)
    if isinstance(top, Euler) and len({top.A, top.B, top.C}) == 3 and moving:
        moments = np.array([top.A, top.B, top.C])
        return lambda axes: draw_polhodes(axes, moments, states[:, :3], "the motion"), SPATIAL
    vector = next((vector for vector in ("a", "gamma") if vector in top.vectors), "")
    if vector and turned:
        points = states[:, slice(*top.vectors[vector])]
        return lambda axes: _draw_trace(axes, points, in_body=vector == "gamma"), SPATIAL
    return lambda axes: _draw_components(axes, top, times, states), None


def _times(motion: Motion) -> Array:
    """Times of some periods; if there is none or an infinite one, of some revolutions at the initial rate."""
    for name, count in (("period", 1), ("period.nutation", PERIODS)):
        if name in motion and math.isfinite(motion[name]):
            return np.linspace(0.0, count * motion[name], count * SAMPLES + 1)
    rate = math.hypot(*motion.state[:3]) or 1.0
    return np.linspace(0.0, TURNS * 2.0 * math.pi / rate, PERIODS * SAMPLES + 1)


def _draw_place(axes: Any, place: tuple[float, float, float], name: str) -> None:
    """Draw the diagram around the place of the motion, and a legend where there is no motion."""
    E, k_sq, two_l = place
    middle, high = 0.5 * two_l**2, max(2.0 * k_sq, 2.0)
    width = math.sqrt(high)
    window = (middle - 2.1 * width, max(middle + 1.12 * width, E + 0.5 * width)), (0.0, high)
    draw_diagram(axes, window, critical_curves(two_l, window), place, name)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small", handlelength=DASHED)
    axes.set_title(rf"$2\ell = {two_l:.6g}$, units with $C = c_0 = |\boldsymbol{{\gamma}}| = 1$", loc="left")


def _draw_trace(axes: Any, points: Array, in_body: bool) -> None:
    """Draw the trace of a vector of any length on the unit sphere, from above or from below."""
    points = points / np.linalg.norm(points, axis=1)[:, None]
    draw_trace(axes, points, 60.0 if points[:, 2].mean() > -0.2 else -60.0, in_body)
    legend_under(axes, 3)


def _draw_components(axes: Any, top: Top, times: Array, states: Array) -> None:
    """Draw the components of the first vector over time."""
    name, (begin, end) = next(iter(top.vectors.items()))
    for i in range(begin, end):
        axes.plot(times, states[:, i], label=component_symbol(top.components[i]))
    labelled(axes, "time $t$", name, xlim=times[[0, -1]])
    axes.legend()
