"""BS schemes and midpoint rule of the Euler top: steps of omega alone, or of omega and gamma.

Sogo, section 1.2. m is rotated with the old, the new or the mean omega, by a Cayley rotation. ``bs``, with the old one,
has a closed form with one division. ``bs-implicit`` and ``midpoint`` are solved by Newton's method in three unknowns,
started from HK's step, with corrections in closed form: each correction of the midpoint rule is the closed-form
solution of HK's linear system at the mean omega. Notation as in ``hk``; every function returns the change of omega.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from topcli.arithmetic.fused import follow_precision
from topcli.arithmetic.vectors import Vector, cayley_increment
from topcli.contracts import Floats, Stepper, Top
from topcli.schemes.euler.hk import CITATION, FORMS, OmegaChange, hk_increment, omega_change
from topcli.schemes.layout import (
    NEWTON_SINGULAR,
    NO_SOLUTION,
    Change,
    CompensatedOption,
    all_invariants,
    increment_stepper,
)
from topcli.schemes.registry import scheme

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


def bs_increment(
    w1: float, w2: float, w3: float, A: float, B: float, C: float, d: float, c1: float, c2: float, c3: float
) -> Vector:
    """Change omega' - omega for m' - m = d (m' + m) x omega: Cayley rotation of m, divided by the moments.

    m x omega is computed from the differences of the moments, so that it vanishes exactly for a spherical top.
    """
    b1 = A * (c1 * (w2 * w3))
    b2 = B * (c2 * (w3 * w1))
    b3 = C * (c3 * (w1 * w2))
    a1 = d * w1
    a2 = d * w2
    a3 = d * w3
    r = 2.0 / ((1.0 + a1 * a1) + (a2 * a2 + a3 * a3))
    return (
        r * (b1 + (b2 * a3 - b3 * a2)) / A,
        r * (b2 + (b3 * a1 - b1 * a3)) / B,
        r * (b3 + (b1 * a2 - b2 * a1)) / C,
    )


def implicit_residual(w: Vector, q: Floats, x: Vector) -> Vector:
    """Residual of m' - m = d (m' + m) x omega', divided by the moments, for the change x of omega.

    The equations are x_i = c_i ((omega_j + x_j)(omega_k + x_k) + omega_j omega_k) + e_i (m_j x_k - m_k x_j) with
    e_i = d/I_i and m of the old state; q = (c_1, c_2, c_3, e_1, e_2, e_3, m_1, m_2, m_3).
    """
    c1, c2, c3, e1, e2, e3, m1, m2, m3 = q
    w1, w2, w3 = w
    x1, x2, x3 = x
    return (
        (c1 * ((w2 + x2) * (w3 + x3) + w2 * w3) - x1) + e1 * (m2 * x3 - m3 * x2),
        (c2 * ((w3 + x3) * (w1 + x1) + w3 * w1) - x2) + e2 * (m3 * x1 - m1 * x3),
        (c3 * ((w1 + x1) * (w2 + x2) + w1 * w2) - x3) + e3 * (m1 * x2 - m2 * x1),
    )


def implicit_correction(w: Vector, q: Floats, x: Vector, r: Vector) -> Vector:
    """Newton correction of x for the residual r, by Cramer's rule."""
    c1, c2, c3, e1, e2, e3, m1, m2, m3 = q
    y1 = w[0] + x[0]
    y2 = w[1] + x[1]
    y3 = w[2] + x[2]
    r1, r2, r3 = r
    n12 = e1 * m3 - c1 * y3
    n13 = -e1 * m2 - c1 * y2
    n23 = e2 * m1 - c2 * y1
    n21 = -e2 * m3 - c2 * y3
    n31 = e3 * m2 - c3 * y2
    n32 = -e3 * m1 - c3 * y1
    k1 = 1.0 - n23 * n32
    k2 = n23 * n31 - n21
    k3 = n21 * n32 - n31
    f = 1.0 / (k1 + n12 * k2 + n13 * k3)
    return (
        f * (k1 * r1 + (n13 * n32 - n12) * r2 + (n12 * n23 - n13) * r3),
        f * (k2 * r1 + (1.0 - n13 * n31) * r2 + (n13 * n21 - n23) * r3),
        f * (k3 * r1 + (n12 * n31 - n32) * r2 + (1.0 - n12 * n21) * r3),
    )


implicit_increment = newton(implicit_residual, implicit_correction)
"""``implicit_increment(omega, q, start)``: change omega' - omega in the BS scheme with the new omega."""


def bs_change(w1: float, w2: float, w3: float, d: float, p: Floats) -> Vector:
    """Change of omega by m' - m = d (m' + m) x omega."""
    return bs_increment(w1, w2, w3, p[0], p[1], p[2], d, d * p[3], d * p[4], d * p[5])


def implicit_change(w1: float, w2: float, w3: float, d: float, p: Floats) -> Vector:
    """Change of omega by m' - m = d (m' + m) x omega', solved iteratively from HK's change."""
    c1 = d * p[3]
    c2 = d * p[4]
    c3 = d * p[5]
    q = (c1, c2, c3, d / p[0], d / p[1], d / p[2], p[0] * w1, p[1] * w2, p[2] * w3)
    return implicit_increment((w1, w2, w3), q, hk_increment(w1, w2, w3, c1, c2, c3))


@scheme(
    "bs",
    top=FORMS,
    title="Bobenko-Suris (BS) scheme with the old omega",
    order=1,
    explicit=True,
    self_adjoint=False,
    conserves=rotation_invariants,
    citation=CITATION + ", after Bobenko, Suris 1999",
    formula=r"m' - m = h\,\bar m\times\omega, \qquad \gamma' - \gamma = h\,\bar\gamma\times\omega",
    equations="(EulerBS) and, for gamma, (A) of the paper",
    options=CompensatedOption,
)
def build_bs(top: Top, options: CompensatedOption) -> Stepper:
    """The scheme rotates m and gamma by a Cayley transform of the old omega, and so conserves m², gamma² and m·gamma.

    The old omega is omega before the step. The scheme does not conserve m·omega, which grows until the top rotates
    about the axis of its smallest moment of inertia.
    """
    return omega_gamma_stepper(top, bs_change, old_omega, options)


@scheme(
    "bs-implicit",
    top=FORMS,
    title="Bobenko-Suris (BS) scheme with the new omega",
    order=1,
    explicit=False,
    self_adjoint=False,
    conserves=rotation_invariants,
    citation=CITATION + ", after Bobenko, Suris 1999",
    formula=r"m' - m = h\,\bar m\times\omega', \qquad \gamma' - \gamma = h\,\bar\gamma\times\omega'",
    equations="(EulerBS) and, for gamma, (A) of the paper, both with omega^{n+1} in place of omega^n",
    options=CompensatedOption,
    limits={"singular-step": NEWTON_SINGULAR},
)
def build_bs_implicit(top: Top, options: CompensatedOption) -> Stepper:
    """The scheme rotates m and gamma by a Cayley transform of the new omega.

    The new omega is omega after the step. A step of length h undoes a step of ``bs`` of length -h. Newton's method
    determines the new omega to round-off; a correction that does not decrease the residual is halved. The scheme
    conserves m², gamma² and m·gamma; m·omega decreases until the top rotates about the axis of its largest moment of
    inertia. If a step does not converge, the run ends as `no_convergence`.
    """
    return omega_gamma_stepper(top, implicit_change, new_omega, options, iterative=True)


def midpoint_residual(w: Vector, q: Floats, z: Vector) -> Vector:
    """Residual of z_i = c_i (omega_j + z_j)(omega_k + z_k) for half the change, z; q = (c_1, c_2, c_3)."""
    y1 = w[0] + z[0]
    y2 = w[1] + z[1]
    y3 = w[2] + z[2]
    return (q[0] * (y2 * y3) - z[0], q[1] * (y3 * y1) - z[1], q[2] * (y1 * y2) - z[2])


def midpoint_correction(w: Vector, q: Floats, z: Vector, r: Vector) -> Vector:
    """Newton correction of z for the residual r: the solution of M x = r at omega + z."""
    y1 = w[0] + z[0]
    y2 = w[1] + z[1]
    y3 = w[2] + z[2]
    c1, c2, c3 = q
    r1, r2, r3 = r
    v1 = y1 + c1 * (y2 * y3)
    v2 = y2 + c2 * (y3 * y1)
    v3 = y3 + c3 * (y1 * y2)
    k1 = c2 * c3
    b1 = k1 * (y1 * y1)
    b2 = (c3 * c1) * (y2 * y2)
    b3 = (c1 * c2) * (y3 * y3)
    f = 1.0 / ((1.0 - b1) - ((b2 + b3) + (2.0 * k1) * (y1 * (c1 * (y2 * y3)))))
    return (
        f * ((1.0 - b1) * r1 + c1 * (v3 * r2 + v2 * r3)),
        f * ((1.0 - b2) * r2 + c2 * (v1 * r3 + v3 * r1)),
        f * ((1.0 - b3) * r3 + c3 * (v2 * r1 + v1 * r2)),
    )


midpoint_half = newton(midpoint_residual, midpoint_correction)
"""``midpoint_half(omega, (c_1, c_2, c_3), start)``: half the change of omega in the midpoint rule."""


def midpoint_change(w1: float, w2: float, w3: float, d: float, p: Floats) -> Vector:
    """Change of omega by omega' - omega = h f((omega' + omega)/2), solved iteratively from HK's change.

    After the iteration the change is evaluated again from the equation: the error of the iteration always has the same
    sign and would cause a drift of 4e-20 per step.
    """
    c1 = d * p[3]
    c2 = d * p[4]
    c3 = d * p[5]
    s1, s2, s3 = hk_increment(w1, w2, w3, c1, c2, c3)
    z1, z2, z3 = midpoint_half((w1, w2, w3), (c1, c2, c3), (0.5 * s1, 0.5 * s2, 0.5 * s3))
    y1, y2, y3 = w1 + z1, w2 + z2, w3 + z3
    return (2.0 * (c1 * (y2 * y3)), 2.0 * (c2 * (y3 * y1)), 2.0 * (c3 * (y1 * y2)))


@scheme(
    "midpoint",
    top=FORMS,
    title="Implicit midpoint rule",
    order=2,
    explicit=False,
    self_adjoint=True,
    conserves=all_invariants,
    citation=CITATION,
    formula=r"m' - m = h\,\bar m\times\bar\omega, \qquad \gamma' - \gamma = h\,\bar\gamma\times\bar\omega",
    equations="the last difference equations of section 1.2 of the paper and, for gamma, the modified BS scheme of its "
    "section 3.2.3",
    options=CompensatedOption,
    limits={"resonance": NO_SOLUTION, "singular-step": NEWTON_SINGULAR},
)
def build_midpoint(top: Top, options: CompensatedOption) -> Stepper:
    """The scheme rotates m and gamma by a Cayley transform of the mean omega, and so conserves all integrals.

    Newton's method in three unknowns starts from a step of HK (`hk`), which has an error of O(h³), and reaches
    round-off after two or three iterations. If a step does not converge, the run ends as `no_convergence`.
    """
    return omega_gamma_stepper(top, midpoint_change, mean_omega, options, iterative=True)
