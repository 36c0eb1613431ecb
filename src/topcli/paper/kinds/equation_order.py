"""Order of one equation of a scheme: its residual along the motion."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from topcli.analysis.reference import reference_states
from topcli.contracts import Array
from topcli.paper.claim import Bound, Finding, Kind
from topcli.paper.kinds.conservation import LADDER, TIME, TOLERANCE, order_of
from topcli.paper.kinds.integrability import GENERIC
from topcli.paper.scenes import Scene

Equation = Callable[[float, float, Array, Array], Array]
"""``equation(c0, h, old, new)``: residuals (n,) at the states (6, n) before and after a step."""


def trapezoidal(c0: float, h: float, old: Array, new: Array) -> Array:
    """Residual of xi' = e^{-i chi} xi with chi = h/2 (omega_3' + omega_3), section 3.2.2 (2)."""
    xi, following = ((y[0] + 1j * y[1]) ** 2 - c0 * (y[3] + 1j * y[4]) for y in (old, new))
    return np.abs(following - np.exp(-0.5j * h * (new[2] + old[2])) * xi)


def method_a(c0: float, h: float, old: Array, new: Array) -> Array:
    """Residual of Method (A), whose omega is the old one."""
    turn = np.cross((new + old)[3:], old[:3], axis=0)
    return np.abs(new[3:] - old[3:] - 0.5 * h * turn).max(axis=0)


def equation_order(equation: Equation, order: int) -> Finding:
    """Exponent of h in the residual of an equation along the motion to t = 10, less one."""
    experiment = Scene("kowalevski_hk", GENERIC).experiment()
    top: Any = experiment.top
    residuals = []
    for h in LADDER:
        times = h * np.arange(round(TIME / h) + 1)
        states = reference_states(top, experiment.y0, times).T
        residuals.append(float(equation(top.c0, h, states[:, :-1], states[:, 1:]).max()))
    bound = Bound(order - TOLERANCE, order + TOLERANCE, f"a rule of order {order} errs by h^{order + 1} in a step")
    found = order_of(residuals, LADDER) - 1.0
    return Finding(found, bound, note=f"residual {residuals[-1]:.1e} at h = {LADDER[-1]:g}")


EQUATION_ORDER = Kind(
    "order of an equation",
    "exponent of h in the residual along the motion, less one, from h = 0.02, 0.01, 0.005",
    "(A), of order 1, as if of order 2",
    lambda: equation_order(method_a, 2),
)
