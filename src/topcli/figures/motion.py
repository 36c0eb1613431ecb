"""Picture of one motion: bifurcation diagram, energy ellipsoid, trace of the axis, or components over time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from topcli.analysis.motion import Motion
from topcli.contracts import Array, Top
from topcli.figures.bifurcation import Diagram, critical_curves, curve_columns, numbers_of_tori
from topcli.figures.curves import plain
from topcli.figures.picture import Drawable, Line, Panel, Styles, component_symbol
from topcli.figures.polhodes import Polhodes
from topcli.figures.scene3d import Sphere
from topcli.tops.euler import Euler
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange, LagrangeInertial

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
        axes.legend(loc="lower left", fontsize="small", frameon=False, handlelength=1.6, borderaxespad=0.3)

    def _mark(self, axes: Any, E: float, k_sq: float) -> None:
        """Draw the point of the motion, whose name is in the legend."""
        look = {"color": "0.05", "linestyle": "none", "markersize": 5.0, "markeredgecolor": "white"}
        axes.plot([E], [k_sq], marker="o", zorder=6, label=self.scene, **look)


def _diagram(top: Kowalevski, motion: Motion, name: str) -> Drawn:
    """Place in the plane of E and k², in units in which c |gamma| = 1."""
    from topcli.schemes.kowalevski.closed_form.curve import integrals

    of = integrals(motion.state, top.constants()[0])
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
    panel = PlaceDiagram(0, two_l, energies, (0.0, high), plain(name), tuple(curves), numbers_of_tori(), title)
    return panel, data


def _polhode(top: Euler, motion: Motion) -> Drawn:
    """The polhode on the energy ellipsoid."""
    states = _states(top, motion.state, _times(motion, ("period",)))
    panel = Polhodes((top.A, top.B, top.C), label="the motion")
    return panel, {name: states[:, i] for i, name in enumerate(panel.omega)}


def _trace(top: Lagrange | LagrangeInertial, motion: Motion) -> Drawn:
    """Trace of the axis on the sphere, with the vertical upright."""
    state = np.array(motion.state)
    sign = 1.0
    if isinstance(top, Lagrange):
        sign = math.copysign(1.0, top.mu)
        state = _in_space(top, state)
    axis = _states(LagrangeInertial(), state, _nutations(motion))[:, 3:]
    axis *= sign / np.linalg.norm(axis, axis=1)[:, None]
    panel = Sphere("", AXIS, elevation=_elevation(axis))
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
    states = _states(top, motion.state, times)
    name, (begin, end) = next(iter(top.vectors.items()))
    names = top.components[begin:end]
    data = {one: states[:, begin + i] for i, one in enumerate(names)}
    label = rf"$\boldsymbol{{\{name}}}$" if len(name) > 1 else rf"$\boldsymbol{{{name}}}$"
    return Panel(tuple(Line(one, component_symbol(one)) for one in names), label), {"t": times, **data}


def _states(top: Top, state: Any, times: Array) -> Array:
    """Motion (m, d) at the given times, by the independent reference."""
    from topcli.analysis.reference import reference_states

    return reference_states(top, state, times)
