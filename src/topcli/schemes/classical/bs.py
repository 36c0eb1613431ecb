"""Bobenko-Suris steps of the Euler top and of the Lagrange top in the inertial frame (Sogo, sections 1.2 and 2.3).

For the Euler top, m is rotated by a Cayley rotation about the old omega (``bs``, in closed form) or about the new one
(``bs-implicit``, by Newton's method in three unknowns, started from the step about the old omega). p = (A, B, C,
alpha_1, alpha_2, alpha_3) with alpha_1 = (B - C)/A and cyclically, d = h/2, c_i = d alpha_i. Every function returns the
change of omega, whose rounding errors are proportional to it.

Source
------
Sogo, Discrete Spinning Tops, section 1.2, after Bobenko, Suris 1999
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

from topcli.arithmetic.fused import fma, follow_precision
from topcli.arithmetic.vectors import Vector, cayley_increment, cayley_rotated, solve3
from topcli.contracts import Floats, Invariant, NoOptions, StepFunction, Stepper, Top, invariant_of
from topcli.schemes.registry import scheme
from topcli.schemes.steppers import stepper

_NEWTON_LIMIT = 40
_SETTLED = 2.0**-53
"""Square of the last correction relative to the square of the change; by quadratic convergence the remaining error is
below the last bit."""
STEADY = 2.0**-200
"""Square of the last correction relative to the square of omega, sufficient as well: near a steady rotation the change
itself tends to zero."""
follow_precision(__name__, caps=("_NEWTON_LIMIT",), _SETTLED=1, STEADY=4)


def old_change(w: Vector, d: float, p: Floats) -> Vector:
    """Change of omega for m' - m = d (m' + m) x omega, divided by the moments.

    m x omega is computed from the differences of the moments, so that it vanishes exactly for a spherical top.
    """
    w1, w2, w3 = w
    A, B, C = p[0], p[1], p[2]
    b1 = A * ((d * p[3]) * (w2 * w3))
    b2 = B * ((d * p[4]) * (w3 * w1))
    b3 = C * ((d * p[5]) * (w1 * w2))
    a1, a2, a3 = d * w1, d * w2, d * w3
    r = 2.0 / ((1.0 + a1 * a1) + (a2 * a2 + a3 * a3))
    return (
        r * (b1 + (b2 * a3 - b3 * a2)) / A,
        r * (b2 + (b3 * a1 - b1 * a3)) / B,
        r * (b3 + (b1 * a2 - b2 * a1)) / C,
    )


def norm_sq(x: Vector) -> float:
    """Squared Euclidean norm of ``x``."""
    return x[0] * x[0] + (x[1] * x[1] + x[2] * x[2])


def new_change(w: Vector, d: float, p: Floats) -> Floats:
    """Change x of omega for m' - m = d (m' + m) x omega', by Newton's method; the status is nan without convergence.

    The equations are x_i = c_i ((omega_j + x_j)(omega_k + x_k) + omega_j omega_k) + e_i (m_j x_k - m_k x_j) with
    e_i = d/I_i and m of the old state.
    """
    w1, w2, w3 = w
    A, B, C = p[0], p[1], p[2]
    c1, c2, c3 = d * p[3], d * p[4], d * p[5]
    e1, e2, e3 = d / A, d / B, d / C
    m1, m2, m3 = A * w1, B * w2, C * w3
    # Newton's method from the change of the last step, until a correction is below the rounding of the change
    x1, x2, x3 = old_change(w, d, p)
    status = math.nan
    for _ in range(_NEWTON_LIMIT):
        y1, y2, y3 = w1 + x1, w2 + x2, w3 + x3
        r1 = (c1 * (y2 * y3 + w2 * w3) - x1) + e1 * (m2 * x3 - m3 * x2)
        r2 = (c2 * (y3 * y1 + w3 * w1) - x2) + e2 * (m3 * x1 - m1 * x3)
        r3 = (c3 * (y1 * y2 + w1 * w2) - x3) + e3 * (m1 * x2 - m2 * x1)
        row1 = (1.0, e1 * m3 - c1 * y3, -e1 * m2 - c1 * y2)
        row2 = (-e2 * m3 - c2 * y3, 1.0, e2 * m1 - c2 * y1)
        row3 = (e3 * m2 - c3 * y2, -e3 * m1 - c3 * y1, 1.0)
        d1, d2, d3 = solve3((*row1, *row2, *row3), r1, r2, r3)
        x1, x2, x3 = x1 + d1, x2 + d2, x3 + d3
        if norm_sq((d1, d2, d3)) <= _SETTLED * norm_sq((x1, x2, x3)) + STEADY * norm_sq(w):
            status = 0.0
            break
    return (x1, x2, x3, status)


def explicit_change(d: int) -> StepFunction:
    """Return the change of omega (d = 3), or also of gamma, which turns about the old omega like m."""

    def omega_change(s: Floats, h: float, p: Floats) -> Floats:
        return old_change((s[0], s[1], s[2]), 0.5 * h, p)

    def body_change(s: Floats, h: float, p: Floats) -> Floats:
        w1, w2, w3, g1, g2, g3 = s
        k = 0.5 * h
        return (*old_change((w1, w2, w3), k, p), *cayley_increment(k * w1, k * w2, k * w3, g1, g2, g3))

    return omega_change if d == 3 else body_change


def implicit_change(d: int) -> StepFunction:
    """Return the change of omega (d = 3), or also of gamma, which turns about the new omega like m; the status."""

    def omega_change(s: Floats, h: float, p: Floats) -> Floats:
        return new_change((s[0], s[1], s[2]), 0.5 * h, p)

    def body_change(s: Floats, h: float, p: Floats) -> Floats:
        w1, w2, w3, g1, g2, g3 = s
        k = 0.5 * h
        x1, x2, x3, status = new_change((w1, w2, w3), k, p)
        y1, y2, y3 = cayley_increment(k * (w1 + x1), k * (w2 + x2), k * (w3 + x3), g1, g2, g3)
        return (x1, x2, x3, y1, y2, y3, status)

    return omega_change if d == 3 else body_change


def rotation_invariants(top: Top) -> tuple[str, ...]:
    """Names of the invariants that every common rotation of m and gamma conserves."""
    return ("m_sq",) if len(top.components) == 3 else ("m_sq", "gamma_sq", "m_gamma")


bobenko_suris = partial(
    scheme,
    top=("euler", "euler+gamma"),
    order=1,
    self_adjoint=False,
    conserves=rotation_invariants,
)


@bobenko_suris("bs", explicit=True)
def build_bs(top: Top, options: NoOptions) -> Stepper:
    r"""Bobenko-Suris (BS) scheme with the old omega.

    The scheme rotates m and gamma by a Cayley transform of the old omega, and so conserves m², gamma² and m·gamma.

    The old omega is omega before the step. The scheme does not conserve m·omega, which grows until the top rotates
    about the axis of its smallest moment of inertia.

    Equations
    ---------
    (EulerBS) and, for gamma, (A) of the paper

    Formula
    -------
    m' - m = h\,\bar m\times\omega, \qquad \gamma' - \gamma = h\,\bar\gamma\times\omega
    """
    d = len(top.components)
    return stepper(explicit_change(d), d)


@bobenko_suris("bs-implicit", explicit=False)
def build_bs_implicit(top: Top, options: NoOptions) -> Stepper:
    r"""Bobenko-Suris (BS) scheme with the new omega.

    The scheme rotates m and gamma by a Cayley transform of the new omega.

    The new omega is omega after the step. A step of length h undoes a step of ``bs`` of length -h. Newton's method
    determines the new omega to round-off. The scheme conserves m², gamma² and m·gamma; m·omega decreases until the top
    rotates about the axis of its largest moment of inertia. If a step does not converge, the run ends as
    `no_convergence`.

    Equations
    ---------
    (EulerBS) and, for gamma, (A) of the paper, both with omega^{n+1} in place of omega^n

    Formula
    -------
    m' - m = h\,\bar m\times\omega', \qquad \gamma' - \gamma = h\,\bar\gamma\times\omega'

    Limits
    ------
    singular-step
        If h is the time of one revolution of the body or longer, Newton's method may find no solution. The run then
        ends as `no_convergence`.
    """
    d = len(top.components)
    return stepper(implicit_change(d), d, iterative=True)


def lagrange_step(state: Floats, h: float, p: Floats) -> Floats:
    """Step m' - m = h p x a, then a' - a = h/2 m' x (a' + a): Sogo's (L1), (L2)."""
    m1, m2, m3, a1, a2, a3 = state
    d = -0.5 * h
    n1 = fma(-h, a2, m1)
    n2 = fma(h, a1, m2)
    # fma(-h d, a2, d m1) in place of d n1 would shorten the critical path, but h d is rounded, and m.a would drift
    b1, b2, b3 = cayley_rotated(d * n1, d * n2, d * m3, a1, a2, a3)
    return (n1, n2, m3, b1, b2, b3)


def bs_integrals(top: Top, h: float, options: NoOptions) -> tuple[Invariant, ...]:
    """Modified energy m²/2 + a·p + h/2 (a x m)·p, conserved by the BS map (Sogo, section 2.3, law 4)."""

    def modified_energy(y: Floats, p: Floats) -> Any:
        """energy plus h/2 (a×m)·p, which the BS map conserves."""
        m1, m2, m3, a1, a2, a3 = y
        return 0.5 * (m1**2 + m2**2 + m3**2) + a3 + 0.5 * h * (a1 * m2 - a2 * m1)

    return (invariant_of("modified_energy", modified_energy, (), ("E mod", r"\widetilde{E}")),)


@scheme(
    "bs",
    top="lagrange/inertial",
    order=1,
    explicit=True,
    self_adjoint=False,
    conserves=("a_sq", "m_p", "m_a"),
    modified=bs_integrals,
)
def build_lagrange_bs(top: Top, options: NoOptions) -> Stepper:
    r"""Bobenko-Suris scheme.

    The new m is m + h p x a. A Cayley transform then rotates the axis a of the top about the new m.

    The scheme conserves a², m·p, m·a and a modified energy exactly; the modified energy differs from E by a term of
    size h. The map is integrable. Although the scheme has order 1 and is not self-adjoint, no integral drifts.

    Source
    ------
    Bobenko, Suris 1999; Sogo, Discrete Spinning Tops, section 2.3

    Equations
    ---------
    (L1) and (L2) of the paper

    Formula
    -------
    m' - m = h\,p\times a, \qquad a' - a = h\,m'\times\bar a
    """
    return Stepper(lagrange_step, 6)
