"""Steps of omega alone, or of omega and the vertical gamma, and Newton's method in three unknowns for implicit ones."""

from __future__ import annotations

import math
from collections.abc import Callable

from topcli.arithmetic.rotations import Vector, cayley_increment
from topcli.arithmetic.tolerances import follow_precision
from topcli.contracts import Floats, Stepper, Top
from topcli.schemes.layout import Change, CompensatedOption, increment_stepper

FORMS = ("euler", "euler+gamma")
CITATION = "Sogo, Discrete Spinning Tops, section 1.2"
OmegaChange = Callable[[float, float, float, float, Floats], Vector]
"""``change(w1, w2, w3, d, p)`` returns omega' - omega, for d = h/2."""
Axis = Callable[[Vector, Vector], Vector]
"""``axis(omega, change)`` returns the angular velocity of the Cayley rotation of gamma."""
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


def old_omega(w: Vector, x: Vector) -> Vector:
    """Omega before the step."""
    return w


def new_omega(w: Vector, x: Vector) -> Vector:
    """Omega after the step."""
    return (w[0] + x[0], w[1] + x[1], w[2] + x[2])


def mean_omega(w: Vector, x: Vector) -> Vector:
    """The mean of omega before and after the step."""
    return (w[0] + 0.5 * x[0], w[1] + 0.5 * x[1], w[2] + 0.5 * x[2])


def omega_change(change: OmegaChange) -> Change:
    """Return the change in a step of omega alone."""

    def changed(s: Floats, h: float, p: Floats) -> Floats:
        w1, w2, w3 = s
        return change(w1, w2, w3, 0.5 * h, p)

    return changed


def rotating_change(change: OmegaChange, axis: Axis) -> Change:
    """Return the change in a step of omega and gamma, with a Cayley rotation of gamma about ``axis``."""

    def changed(s: Floats, h: float, p: Floats) -> Floats:
        w1, w2, w3, g1, g2, g3 = s
        d = 0.5 * h
        x1, x2, x3 = change(w1, w2, w3, d, p)
        a1, a2, a3 = axis((w1, w2, w3), (x1, x2, x3))
        y1, y2, y3 = cayley_increment(d * a1, d * a2, d * a3, g1, g2, g3)
        return (x1, x2, x3, y1, y2, y3)

    return changed


def with_status(change: Change) -> Change:
    """The change followed by a status: nan if Newton's method returned nan, without convergence."""

    def changed(s: Floats, h: float, p: Floats) -> Floats:
        x = change(s, h, p)
        status = math.nan if math.isnan(x[0]) else 0.0
        return (*x, status)

    return changed


def omega_gamma_stepper(
    top: Top, change: OmegaChange, axis: Axis, options: CompensatedOption, iterative: bool = False
) -> Stepper:
    """Stepper of omega alone or of omega and gamma, depending on the state of ``top``."""
    d = len(top.components)
    changed = omega_change(change) if d == 3 else rotating_change(change, axis)
    return increment_stepper(with_status(changed) if iterative else changed, d, options, iterative)


def rotation_invariants(top: Top) -> tuple[str, ...]:
    """Names of the invariants that every common rotation of m and gamma conserves."""
    return ("m_sq",) if len(top.components) == 3 else ("m_sq", "gamma_sq", "m_gamma")


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
