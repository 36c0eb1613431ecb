"""Splitting of the motion into kicks by gravity and rotations, each of which is solved exactly.

The equations of every top of the Euler-Poisson equations are m' = m x omega + gamma x g, gamma' = gamma x omega, with
m = I omega and g the weight times the centre of gravity. The working state is (m, gamma), or m alone for a free body,
followed by the coefficients of the top, so that the same machine code serves all tops. A step is given as the change
of (m, gamma): all its rotations are increments, whose rounding errors are proportional to the angle, and one addition
per component remains. ``dmv`` works on the same state.

The energy is the sum of m_i²/(2 I_i) for the three axes and of gamma . g. Each term alone gives a motion in closed
form: gravity a kick m += h gamma x g, an axis a rotation of m and gamma about it by the angle h m_i/I_i. If A = B, the
free body as a whole is as simple: gamma turns about m by the angle h |m|/A, then m and gamma turn about the third axis
by h m_3 (1/C - 1/A); the two commute.

All of them are canonical and conserve gamma² and m . gamma, and so does their product, which is the exact motion of a
modified top: the energy oscillates by h² and does not drift.

Sine and cosine are polynomials accurate to the last bit, up to the angle pi/4 (``sinc_cosc``), in the form of
increments, with a correction that keeps the length of a rotated vector without bias (``rotation_coefficients``). A
rational rotation (Cayley) would need a division instead of a polynomial, but it is not the motion about an axis: a
different scheme.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from topcli.arithmetic.fused import fma
from topcli.arithmetic.vectors import (
    Vector,
    orthogonal_rodrigues_increment,
    rotation_coefficients,
    turned,
    turned_increment,
)
from topcli.contracts import EulerPoisson, Floats, NoOptions, StepFunction, Stepper, Top
from topcli.errors import UsageError
from topcli.schemes.registry import scheme
from topcli.schemes.steppers import stepper
from topcli.tops.bodies import checked_equations

KEPT = {
    "euler": ("m_sq",),
    "euler+gamma": ("m_sq", "gamma_sq", "m_gamma"),
    **dict.fromkeys(("heavy", "goryachev-chaplygin", "hess-appelrot"), ("gamma_sq", "m_gamma")),
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


_NEEDED_BY = "scheme 'splitting'"
_Free = Callable[[Vector, Vector, Floats, float], tuple[Vector, Vector, Vector, Floats]]
"""``free(m, gamma, c, h)``: changes of m and gamma in a step of the free body, the new gamma, and what ends a change:
nothing, or its status and counts."""


def turn(chi: float, m1: float, m2: float, g1: float, g2: float) -> Floats:
    """Rotation about an axis: changes of the other two components of m and of gamma, and the new ones of m."""
    s, k, s_low, k_low = rotation_coefficients(chi)
    a1, a2 = turned_increment(s, k, s_low, k_low, m1, m2)
    p1, p2 = turned_increment(s, k, s_low, k_low, g1, g2)
    n1, n2 = turned(s, k, m1, m2)  # the next angle waits for it
    return (a1, a2, p1, p2, n1, n2)


def axes(m: Vector, g: Vector, c: Floats, h: float) -> tuple[Vector, Vector, Vector, Floats]:
    """Rotations about the axes 1, 2, 3, 2, 1; ``c`` are the inverse moments."""
    m1, m2, m3 = m
    g1, g2, g3 = g
    d = 0.5 * h
    d1, d2 = d * c[0], d * c[1]
    a2, a3, p2, p3, m2, m3 = turn(d1 * m1, m2, m3, g2, g3)
    g2, g3 = g2 + p2, g3 + p3
    b3, b1, q3, q1, m3, m1 = turn(d2 * m2, m3, m1, g3, g1)
    g3, g1 = g3 + q3, g1 + q1
    c1, c2, r1, r2, m1, m2 = turn((h * c[2]) * m3, m1, m2, g1, g2)
    g1, g2 = g1 + r1, g2 + r2
    e3, e1, t3, t1, m3, m1 = turn(d2 * m2, m3, m1, g3, g1)
    g3, g1 = g3 + t3, g1 + t1
    f2, f3, w2, w3, _, _ = turn(d1 * m1, m2, m3, g2, g3)
    of_m = (b1 + (c1 + e1), a2 + (c2 + f2), (a3 + b3) + (e3 + f3))
    return of_m, (q1 + (r1 + t1), p2 + (r2 + w2), (p3 + q3) + (t3 + w3)), (g1, g2 + w2, g3 + w3), ()


def closed(m: Vector, g: Vector, c: Floats, h: float) -> tuple[Vector, Vector, Vector, Floats]:
    """Exact free motion for A = B; ``c`` are the inverse moments."""
    m1, m2, m3 = m
    g1, g2, g3 = g
    f = h * c[0]
    p1, p2, p3 = orthogonal_rodrigues_increment(f * m1, f * m2, f * m3, g1, g2, g3)
    g1, g2, g3 = g1 + p1, g2 + p2, g3 + p3
    a1, a2, q1, q2, _, _ = turn((h * (c[2] - c[0])) * m3, m1, m2, g1, g2)
    return (a1, a2, -0.0), (p1 + q1, p2 + q2, p3), (g1 + q1, g2 + q2, g3), ()  # x + -0.0 is x, for x = -0.0 too


def free_change(free: _Free) -> StepFunction:
    """Return the change of m in a step without gamma; the coefficients of the top follow m."""

    def change(s: Floats, h: float, p: Floats) -> Floats:
        by_turns, _, _, ending = free((s[0], s[1], s[2]), (0.0, 0.0, 0.0), s[3:], h)
        return (*by_turns, *ending)

    return change


def kicked_change(free: _Free) -> StepFunction:
    """Return the change of m and gamma, half a kick, the free body, half a kick; weight and coefficients follow."""

    def change(s: Floats, h: float, p: Floats) -> Floats:
        m1, m2, m3, g1, g2, g3, x, y, z = s[:9]
        d = 0.5 * h
        u1, u2, u3 = kick(d, g1, g2, g3, x, y, z)
        (a1, a2, a3), by_turns, (g1, g2, g3), ending = free((m1 + u1, m2 + u2, m3 + u3), (g1, g2, g3), s[9:], h)
        v1, v2, v3 = kick(d, g1, g2, g3, x, y, z)
        return ((u1 + v1) + a1, (u2 + v2) + a2, (u3 + v3) + a3, *by_turns, *ending)

    return change


def kicked(
    top: Top, equations: EulerPoisson, free: _Free, rest: Floats = (), counters: tuple[str, ...] = (), *, needed_by: str
) -> Stepper:
    """Stepper of the working state with the free body ``free``, which is iterative if it has ``counters``.

    The inverse moments, followed by ``rest``, are the coefficients c of ``free``. Raises UsageError if a body without
    gamma in its state has weight.
    """
    d, sign, (A, B, C) = len(top.components), equations.omega_sign, equations.moments
    if d == 3 and any(equations.gravity):
        raise UsageError(f"top {top.kind!r}: {needed_by} needs gamma as part of the state of a top with weight")
    weight = () if d == 3 else equations.gravity
    after, place = (*weight, 1.0 / A, 1.0 / B, 1.0 / C, *rest), d + len(weight)
    a, b, c = sign * A, sign * B, sign * C

    def enter(y: Floats, h: float, p: Floats) -> Floats:
        return (a * y[0], b * y[1], c * y[2], *y[3:d], *after)

    def leave(s: Floats, h: float, p: Floats) -> Floats:
        return (sign * s[0] * s[place], sign * s[1] * s[place + 1], sign * s[2] * s[place + 2], *s[3:d])

    change = (free_change if d == 3 else kicked_change)(free)
    return stepper(change, d, len(after), counters=counters, iterative=bool(counters), enter=enter, leave=leave)


@scheme(
    "splitting",
    top=None,
    requires=partial(checked_equations, needed_by=_NEEDED_BY),
    order=2,
    explicit=True,
    self_adjoint=True,
    conserves=lambda top: KEPT.get(top.form, ()),
)
def build_splitting(top: Top, options: NoOptions) -> Stepper:
    r"""Splitting into kicks and rotations.

    A step combines exact motions: gravity alone for h/2 (a kick), the free body for h, gravity alone for h/2.

    If A = B, the motion of the free body is computed in closed form; otherwise it is split into rotations about the
    axes of the body. The scheme is explicit, self-adjoint and canonical (a Poisson map). `splitting` conserves gamma²
    and m·gamma; the deviation of the energy oscillates, is of size h² and does not drift.

    If A = B, the error is proportional to the torque of gravity and independent of the spin, so steps may be long for a
    fast top.

    Source
    ------
    McLachlan 1993; Reich 1994; Touma, Wisdom 1994; Hairer, Lubich, Wanner, Geometric Numerical Integration, section
    VII.5

    Equations
    ---------
    kick h/2 by gamma x g, rotations about the axes 1, 2 (h/2), 3 (h), 2, 1 (h/2), kick h/2

    Formula
    -------
    \Phi_h = K_{h/2}\circ F_h\circ K_{h/2}, \qquad
    K_\tau:\ m \mapsto m + \tau\,\gamma\times r, \qquad
    F_h:\ \text{the free body, if } A = B

    F_h = R^1_{h/2}\circ R^2_{h/2}\circ R^3_h\circ R^2_{h/2}\circ R^1_{h/2} \ \text{otherwise}, \qquad
    R^i_\tau:\ \dot v = v\times\frac{m_i}{I_i}\,e_i \ \text{ for } v = m, \gamma

    Limits
    ------
    singular-step (kowalevski, lagrange, heavy)
        If the body turns by several radians in a step, the kicks and rotations no longer approximate the exact
        motion: the energy deviates by several times its first value.
    """
    equations = checked_equations(top, _NEEDED_BY)
    free = closed if equations.moments[0] == equations.moments[1] else axes
    return kicked(top, equations, free, needed_by=_NEEDED_BY)
