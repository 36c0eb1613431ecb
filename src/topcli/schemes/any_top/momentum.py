"""Working state of the schemes that move the angular momentum m = I omega and gamma by rotations and kicks.

The equations of every top of the Euler-Poisson equations are m' = m x omega + gamma x g, gamma' = gamma x omega, with
g the weight times the centre of gravity. The working state is (m, gamma), or m alone for a free body, followed by the
coefficients of the top, so that the same machine code serves all tops.

A step is given as the change of (m, gamma): all its rotations are increments, whose rounding errors are proportional to
the angle, and one addition per component remains.
"""

from __future__ import annotations

from collections.abc import Callable

from topcli.arithmetic.fused import fma
from topcli.arithmetic.increments import compensated_sum, compensated_sums
from topcli.arithmetic.rotations import Vector
from topcli.contracts import EulerPoisson, Floats, StepFunction, Stepper, Top
from topcli.errors import UsageError

Change = Callable[[Floats, Floats, float], Floats]
"""``change(y, c, h)``: change of y = (m, gamma) or m in a step, for a top with the coefficients c."""
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


def plain3(change: Change) -> StepFunction:
    """Step m + change of a free body; three inverse moments follow m."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        m1, m2, m3, i1, i2, i3 = s
        x1, x2, x3 = change((m1, m2, m3), (i1, i2, i3), h)
        return (m1 + x1, m2 + x2, m3 + x3, i1, i2, i3)

    return step


def compensated3(change: Change) -> StepFunction:
    """``plain3`` with compensated sums, whose rounding errors are at the end."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        m1, m2, m3, i1, i2, i3, e1, e2, e3 = s
        x1, x2, x3 = change((m1, m2, m3), (i1, i2, i3), h)
        m1, e1 = compensated_sum(m1, e1, x1)
        m2, e2 = compensated_sum(m2, e2, x2)
        m3, e3 = compensated_sum(m3, e3, x3)
        return (m1, m2, m3, i1, i2, i3, e1, e2, e3)

    return step


def plain6(change: Change) -> StepFunction:
    """Step (m, gamma) + change; inverse moments and weight follow."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        m1, m2, m3, g1, g2, g3, i1, i2, i3, x, y, z = s
        x1, x2, x3, x4, x5, x6 = change((m1, m2, m3, g1, g2, g3), (i1, i2, i3, x, y, z), h)
        return (m1 + x1, m2 + x2, m3 + x3, g1 + x4, g2 + x5, g3 + x6, i1, i2, i3, x, y, z)

    return step


def compensated6(change: Change) -> StepFunction:
    """``plain6`` with compensated sums, whose rounding errors are at the end."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        m1, m2, m3, g1, g2, g3, i1, i2, i3, x, y, z, e1, e2, e3, e4, e5, e6 = s
        old = (m1, m2, m3, g1, g2, g3)
        new, lost = compensated_sums(old, (e1, e2, e3, e4, e5, e6), change(old, (i1, i2, i3, x, y, z), h))
        return (*new, i1, i2, i3, x, y, z, *lost)

    return step


def momentum_stepper(equations: EulerPoisson, d: int, change: Change, compensated: bool) -> Stepper:
    """Stepper of a method without iterations, from its change."""
    weight = () if d == 3 else equations.gravity
    leave = leaving(equations, d)
    if compensated:
        make = compensated3 if d == 3 else compensated6
        enter = entering(equations, d, (*weight, *(0.0,) * d))
        return Stepper(make(change), 3 * d, enter, leave, checked=d)
    make = plain3 if d == 3 else plain6
    return Stepper(make(change), 2 * d, entering(equations, d, weight), leave, checked=d)
