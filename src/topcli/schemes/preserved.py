"""Polynomial invariants of low degree, which whole classes of methods conserve.

Every Runge-Kutta method conserves linear invariants; the implicit midpoint rule also conserves quadratic ones (Cooper
1987).
"""

from __future__ import annotations

from math import comb

import numpy as np

from topcli.contracts import Top

LINES = 3


def polynomial_invariants(top: Top, degree: int) -> tuple[str, ...]:
    """Return the names of the invariants of ``top`` that are polynomials of the state of at most ``degree``.

    This is determined numerically: along a line, the finite difference of order ``degree + 1`` of such a polynomial
    vanishes. Three lines in general position are used, with a tolerance for round-off.
    """
    d = len(top.components)
    orders = np.arange(degree + 2.0)
    weights = np.array([(-1.0) ** k * comb(degree + 1, k) for k in range(degree + 2)])
    found = []
    for invariant in top.invariants():
        excess = 0.0
        for line in range(LINES):
            start, along = np.cos(np.arange(2.0 * d) + 2.0 * d * line + 1.0).reshape(2, d)
            states = start + orders[:, None] * along
            scale = float(invariant.scale(states).max()) or 1.0
            excess = max(excess, abs(float(weights @ invariant.value(states))) / scale)
        if excess < 1e-13 * 2.0 ** (degree + 1):
            found.append(invariant.name)
    return tuple(found)
