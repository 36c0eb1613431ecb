"""Steps of omega alone, or of omega and the vertical gamma."""

from __future__ import annotations

from collections.abc import Callable

from topcli.arithmetic.rotations import Vector, cayley_increment
from topcli.contracts import Floats, Stepper, Top
from topcli.schemes.layout import Change, CompensatedOption, increment_stepper

FORMS = ("euler", "euler+gamma")
CITATION = "Sogo, Discrete Spinning Tops, section 1.2"
OmegaChange = Callable[[float, float, float, float, Floats], Vector]
"""``change(w1, w2, w3, d, p)`` returns omega' - omega, for d = h/2."""
Axis = Callable[[Vector, Vector], Vector]
"""``axis(omega, change)`` returns the angular velocity of the Cayley rotation of gamma."""


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


def omega_gamma_stepper(top: Top, change: OmegaChange, axis: Axis, options: CompensatedOption) -> Stepper:
    """Stepper of omega alone or of omega and gamma, depending on the state of ``top``."""
    if len(top.components) == 3:
        return increment_stepper(omega_change(change), 3, options)
    return increment_stepper(rotating_change(change, axis), 6, options)


def rotation_invariants(top: Top) -> tuple[str, ...]:
    """Names of the invariants that every common rotation of m and gamma conserves."""
    return ("m_sq",) if len(top.components) == 3 else ("m_sq", "gamma_sq", "m_gamma")
