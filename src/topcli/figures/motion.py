"""Picture of one exact motion.

A motion of the Kowalevski top is a place in the bifurcation diagram, that of an Euler top a polhode on the energy
ellipsoid, that of a Lagrange top the trace of its axis; any other is drawn as components over time.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from topcli.analysis.motion import Motion
from topcli.analysis.reference import reference_states
from topcli.arithmetic.quaternions import matrices
from topcli.contracts import Array, Top
from topcli.engine.attitude import start_attitude
from topcli.figures.diagram import DASHED, critical_curves, draw_diagram, place_of_motion
from topcli.figures.figure import Drawing
from topcli.figures.labels import component_symbol, entries_of, labelled, plain
from topcli.figures.space import SPATIAL, draw_polhodes, draw_trace
from topcli.tops.euler import Euler
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange, LagrangeInertial

SAMPLES, MOST_SAMPLES = 240, 6000
"""Points of one oscillation or revolution, and of a curve."""
MOST_NUTATIONS = 12
TURNS = 4.0
"""Revolutions at the initial rate for which a motion without a period is drawn."""
LARGEST = 1e12
"""Largest integral in units of gravity; the diagram has no structure near larger ones."""


def motion_drawing(top: Top, motion: Motion, name: str) -> tuple[Drawing, str | None]:
    """Function that draws the ``motion`` of ``top``, the one with a closed form, and the projection of its axes.

    ``name`` is that of the experiment. Raises UsageError and RunError if the state is too large to be followed.
    """
    moving, turned = any(motion.state[:3]), any(motion.state[3:])
    if isinstance(top, Kowalevski) and top.constants()[0] and turned:
        place = place_of_motion(motion.state, top.constants()[0])
        if max(map(abs, place)) <= LARGEST:
            return lambda axes: _place(axes, place, name), None
    if isinstance(top, Euler) and len({top.A, top.B, top.C}) == 3 and moving:
        states = reference_states(top, motion.state, _times(motion, "period"))
        moments = np.array([top.A, top.B, top.C])
        return lambda axes: draw_polhodes(axes, moments, states[:, :3], "the motion"), SPATIAL
    if isinstance(top, Lagrange | LagrangeInertial) and turned:
        axis = _axis(top, motion)
        elevation = 60.0 if axis[:, 2].mean() > -0.2 else -60.0  # from above or from below

        def draw(axes: Any) -> None:
            draw_trace(axes, axis, elevation)
            entries, place = entries_of(axes), {"loc": "upper center", "bbox_to_anchor": (0.5, 0.02)}
            axes.legend(entries.values(), entries, ncols=4, fontsize="small", **place)

        return draw, SPATIAL
    times = _times(motion, "period")
    states = reference_states(top, motion.state, times)
    return lambda axes: _components(axes, top, times, states), None


def _place(axes: Any, place: tuple[float, float, float], name: str) -> None:
    """Draw the diagram around the place of the motion, and a legend where there is no motion."""
    E, k_sq, two_l = place
    middle, high = 0.5 * two_l**2, max(2.0 * k_sq, 2.0)
    width = math.sqrt(high)
    window = (middle - 2.1 * width, max(middle + 1.12 * width, E + 0.5 * width)), (0.0, high)
    draw_diagram(axes, two_l, window, critical_curves(two_l, window), (E, k_sq))
    axes.plot([], [], "o", color="0.05", markersize=5.0, markeredgecolor="white", label=plain(name))
    axes.legend(loc="lower left", fontsize="small", frameon=False, handlelength=DASHED, borderaxespad=0.3)
    labelled(axes, "energy $E$", "$k^2$", rf"$2\ell = {two_l:.6g}$, units with $C = c_0 = |\boldsymbol{{\gamma}}| = 1$")


def _axis(top: Lagrange | LagrangeInertial, motion: Motion) -> Array:
    """Directions (m, 3) of the axis in space, with the vertical upright."""
    state, sign = np.array(motion.state), 1.0
    if isinstance(top, Lagrange):  # the state of the inertial form, in units with A = 1
        to_space = matrices(np.array([start_attitude(top, tuple(motion.state))]))[0]
        weight = top.mu / top.A * np.linalg.norm(state[3:])
        axis = to_space[:, 2] * (weight or 1e-30)  # without gravity an axis that does not react on the momentum
        state = np.concatenate([to_space @ (state[:3] * [1.0, 1.0, top.C / top.A]), axis])
        sign = math.copysign(1.0, top.mu)
    axis = reference_states(LagrangeInertial(), state.tolist(), _nutations(motion))[:, 3:]
    return sign * axis / np.linalg.norm(axis, axis=1)[:, None]


def _nutations(motion: Motion) -> Array:
    """Times over the nutations in which the axis precesses about once, at most ``MOST_NUTATIONS`` of them."""
    if "precession.per_nutation" not in motion:
        rate = abs(motion["frequency.precession"]) if "frequency.precession" in motion else 0.0
        return np.linspace(0.0, 1.0 / rate, SAMPLES + 1) if rate else _times(motion)
    each = abs(motion["precession.per_nutation"])
    count = min(max(math.ceil(0.999 / each) if each else 2, 2), MOST_NUTATIONS)
    samples = min(math.ceil(SAMPLES * count * max(1.0, each)), MOST_SAMPLES)
    return np.linspace(0.0, count * motion["period.nutation"], samples + 1)


def _times(motion: Motion, period: str = "") -> Array:
    """Times of one ``period``; if there is none or an infinite one, of some revolutions at the initial rate."""
    if period in motion and math.isfinite(motion[period]):
        return np.linspace(0.0, motion[period], SAMPLES + 1)
    rate = math.hypot(*motion.state[:3]) or 1.0
    return np.linspace(0.0, TURNS * 2.0 * math.pi / rate, MOST_SAMPLES // 4 + 1)


def _components(axes: Any, top: Top, times: Array, states: Array) -> None:
    """Draw the components of the first vector over time."""
    name, (begin, end) = next(iter(top.vectors.items()))
    for i in range(begin, end):
        axes.plot(times, states[:, i], label=component_symbol(top.components[i]))
    label = rf"$\boldsymbol{{\{name}}}$" if len(name) > 1 else rf"$\boldsymbol{{{name}}}$"
    labelled(axes, "time $t$", label, xlim=times[[0, -1]])
    axes.legend()
