"""Working state of the schemes that move the angular momentum m = I omega and gamma by rotations and kicks.

The equations of every top of the Euler-Poisson equations are m' = m x omega + gamma x g, gamma' = gamma x omega, with
g the weight times the centre of gravity. The working state is (m, gamma), or m alone for a free body, followed by the
coefficients of the top, so that the same machine code serves all tops.

A step is given as the change of (m, gamma): all its rotations are increments, whose rounding errors are proportional to
the angle, and one addition per component remains.
"""

from __future__ import annotations

from topcli.arithmetic.fused import fma
from topcli.arithmetic.rotations import Vector
from topcli.contracts import EulerPoisson, Floats, StepFunction, Stepper, Top
from topcli.errors import UsageError
from topcli.schemes.layout import Change, stepper

KEPT = {
    "euler": ("m_sq",),
    "euler+gamma": ("m_sq", "gamma_sq", "m_gamma"),
    "heavy": ("gamma_sq", "m_gamma"),
    "kowalevski": ("gamma_sq", "two_l"),
    "lagrange": ("gamma_sq", "m_gamma", "m_axis"),
    "lagrange/inertial": ("a_sq", "m_p", "m_a"),
}
"""Invariants that common rotations of m and gamma and kicks along gamma x g conserve, and for Lagrange's top those of
its symmetry."""


def difference_of_products(a: float, b: float, c: float, d: float) -> float:
    """Return a b - c d with an error of at most 1.5 ulp (Kahan)."""
    p = c * d
    return fma(a, b, -p) - fma(c, d, -p)


def kick(d: float, g1: float, g2: float, g3: float, x: float, y: float, z: float) -> Vector:
    """Change d gamma x g of m by gravity."""
    return (
        d * difference_of_products(g2, z, g3, y),
        d * difference_of_products(g3, x, g1, z),
        d * difference_of_products(g1, y, g2, x),
    )


def inverse_moments(equations: EulerPoisson) -> tuple[float, float, float]:
    """Inverse of each moment of inertia."""
    A, B, C = equations.moments
    return (1.0 / A, 1.0 / B, 1.0 / C)


def state_length(top: Top, needed_by: str) -> int:
    """Number of components of the state of ``top``: 3 or 6. Raises UsageError if a body without gamma has weight."""
    d = len(top.components)
    if d == 3 and any(top.euler_poisson().gravity):
        raise UsageError(f"top {top.kind!r}: {needed_by} needs gamma as part of the state of a top with weight")
    return d


def entering(equations: EulerPoisson, d: int, rest: Floats) -> StepFunction:
    """``enter`` of a working state (m, gamma) followed by the inverse moments and ``rest``."""
    A, B, C = (equations.omega_sign * moment for moment in equations.moments)
    after = (*inverse_moments(equations), *rest)

    def enter(y: Floats, h: float, p: Floats) -> Floats:
        return (A * y[0], B * y[1], C * y[2], *y[3:d], *after)

    return enter


def leave3(s: Floats, h: float, p: Floats) -> Floats:
    """Omega, from m and the inverse moments."""
    return (s[0] * s[3], s[1] * s[4], s[2] * s[5])


def leave6(s: Floats, h: float, p: Floats) -> Floats:
    """Omega and gamma, from m, gamma and the inverse moments."""
    return (s[0] * s[6], s[1] * s[7], s[2] * s[8], s[3], s[4], s[5])


def leave6_reversed(s: Floats, h: float, p: Floats) -> Floats:
    """Minus omega, and gamma."""
    return (-s[0] * s[6], -s[1] * s[7], -s[2] * s[8], s[3], s[4], s[5])


def leave3_reversed(s: Floats, h: float, p: Floats) -> Floats:
    """Minus omega."""
    return (-s[0] * s[3], -s[1] * s[4], -s[2] * s[5])


def leaving(equations: EulerPoisson, d: int) -> StepFunction:
    """``leave`` of the working state: the physical state."""
    if equations.omega_sign < 0.0:
        return leave3_reversed if d == 3 else leave6_reversed
    return leave3 if d == 3 else leave6


def momentum_stepper(equations: EulerPoisson, d: int, change: Change, compensated: bool) -> Stepper:
    """Stepper of a method without iterations, from its change."""
    enter = entering(equations, d, () if d == 3 else equations.gravity)
    return stepper(change, d, d, lost=range(d * compensated), checked=d, enter=enter, leave=leaving(equations, d))
