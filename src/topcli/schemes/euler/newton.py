"""Newton's method in three unknowns, for the implicit schemes of the Euler top."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from topcli.arithmetic.increments import first3, first6
from topcli.arithmetic.rotations import Vector
from topcli.contracts import Floats, Stepper

Residual = Callable[[Vector, Floats, Vector], Vector]
Correction = Callable[[Vector, Floats, Vector, Vector], Vector]
Solve = Callable[[Vector, Floats, Vector], Vector]
NEWTON_LIMIT = 40
HALVINGS = 12
LAST_STEP = 1e-16
"""Newton's method is done when the square of its correction is below this, relative to the square of the change: it
doubles the digits, so that what is left is below the last bit."""
NEGLIGIBLE = 1e-60
"""Or below this, relative to the square of omega: on the way into a steady rotation the change itself dies out."""


def square(x: Vector) -> float:
    """x.x"""
    return x[0] * x[0] + (x[1] * x[1] + x[2] * x[2])


def newton(residual: Residual, correction: Correction) -> Solve:
    """A solver of ``residual(w, q, x) = 0`` for x from a start, by Newton's method with halved steps as a safeguard.

    A correction is halved until the residual shrinks. Without convergence the result is NaN: the run then ends
    there and says so.
    """

    def solve(w: Vector, q: Floats, start: Vector) -> Vector:
        x = start
        r = residual(w, q, x)
        size = square(r)
        floor = NEGLIGIBLE * square(w)
        for _ in range(NEWTON_LIMIT):
            d1, d2, d3 = correction(w, q, x, r)
            tried = (x[0] + d1, x[1] + d2, x[2] + d3)
            if square((d1, d2, d3)) <= LAST_STEP * square(tried) + floor:
                return tried
            left = residual(w, q, tried)
            t = 1.0
            for _ in range(HALVINGS):
                if square(left) < size:
                    break
                t = 0.5 * t
                tried = (x[0] + t * d1, x[1] + t * d2, x[2] + t * d3)
                left = residual(w, q, tried)
            x = tried
            r = left
            size = square(r)
        return (math.nan, math.nan, math.nan)

    return solve


def with_status(stepper: Stepper, d: int) -> Stepper:
    """``stepper`` with a status behind its state: nan where Newton's method, which then gives nan, did not converge."""
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
        leave=first3 if d == 3 else first6,
        iterative=True,
    )
