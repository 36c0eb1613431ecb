"""Newton's method in three unknowns, for the implicit schemes of the Euler top."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from topcli.arithmetic.rotations import Vector
from topcli.arithmetic.tolerances import follow_precision
from topcli.contracts import Floats, Stepper
from topcli.schemes.layout import first

Residual = Callable[[Vector, Floats, Vector], Vector]
Correction = Callable[[Vector, Floats, Vector, Vector], Vector]
Solve = Callable[[Vector, Floats, Vector], Vector]
NEWTON_LIMIT = 40
HALVINGS = 12
CORRECTION_TOLERANCE_SQ = 1e-16
"""Bound on the squared correction relative to the squared change, at which the iteration ends; by quadratic convergence
the remaining error is below the last bit."""
OMEGA_TOLERANCE_SQ = 1e-60
"""Bound on the squared correction relative to the squared omega, sufficient as well: near a steady rotation the change
itself tends to zero."""
follow_precision(__name__, caps=("NEWTON_LIMIT",), CORRECTION_TOLERANCE_SQ=1, OMEGA_TOLERANCE_SQ=4)


def norm_sq(x: Vector) -> float:
    """Squared Euclidean norm of ``x``."""
    return x[0] * x[0] + (x[1] * x[1] + x[2] * x[2])


def newton(residual: Residual, correction: Correction) -> Solve:
    """Return a solver ``solve(w, q, start)`` of ``residual(w, q, x) = 0`` by Newton's method with step halving.

    A correction is halved until the norm of the residual decreases. Without convergence the result is nan.
    """

    def solve(w: Vector, q: Floats, start: Vector) -> Vector:
        x = start
        r = residual(w, q, x)
        size = norm_sq(r)
        floor = OMEGA_TOLERANCE_SQ * norm_sq(w)
        for _ in range(NEWTON_LIMIT):
            d1, d2, d3 = correction(w, q, x, r)
            tried = (x[0] + d1, x[1] + d2, x[2] + d3)
            if norm_sq((d1, d2, d3)) <= CORRECTION_TOLERANCE_SQ * norm_sq(tried) + floor:
                return tried
            left = residual(w, q, tried)
            t = 1.0
            for _ in range(HALVINGS):
                if norm_sq(left) < size:
                    break
                t = 0.5 * t
                tried = (x[0] + t * d1, x[1] + t * d2, x[2] + t * d3)
                left = residual(w, q, tried)
            x = tried
            r = left
            size = norm_sq(r)
        return (math.nan, math.nan, math.nan)

    return solve


def with_status(stepper: Stepper, d: int) -> Stepper:
    """Append a status to the state of ``stepper``: nan if Newton's method returned nan, without convergence."""
    step, inner_enter = stepper.step, stepper.enter

    def stepped(s: Floats, h: float, p: Floats) -> Floats:
        new = step(s[:-1], h, p)
        status = math.nan if math.isnan(new[0]) else 0.0
        return (*new, status)

    def enter(y: Floats, h: float, p: Floats) -> Floats:
        return (*(inner_enter(y, h, p) if inner_enter else y), 0.0)

    return replace(
        stepper,
        step=stepped,
        width=stepper.width + 1,
        enter=enter,
        leave=first(d),
        iterative=True,
    )
