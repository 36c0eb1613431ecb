"""BS schemes of the Euler top (Sogo, section 1.2): Cayley rotation of m with the old or the new omega.

``bs`` has a closed form with one division. ``bs-implicit`` is solved by Newton's method in three unknowns, started from
HK's step, with corrections in closed form. Notation as in ``hk``; every function returns the change of omega.
"""

from __future__ import annotations

from topcli.arithmetic.rotations import Vector
from topcli.contracts import Floats, Stepper, Top
from topcli.schemes.declarations import NEWTON_SINGULAR
from topcli.schemes.euler.hk import hk_increment
from topcli.schemes.euler.steps import (
    CITATION,
    FORMS,
    new_omega,
    newton,
    old_omega,
    omega_gamma_stepper,
    rotation_invariants,
)
from topcli.schemes.layout import CompensatedOption
from topcli.schemes.registry import scheme


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
    title="BS scheme with the old omega",
    order=1,
    explicit=True,
    self_adjoint=False,
    conserves=rotation_invariants,
    citation=CITATION + ", after Bobenko, Suris 1999",
    formula=r"m' - m = h\,\bar m\times\omega, \qquad \gamma' - \gamma = h\,\bar\gamma\times\omega",
    equations="EulerBS; gamma by (A)",
    options=CompensatedOption,
)
def build_bs(top: Top, options: CompensatedOption) -> Stepper:
    """Cayley rotation of m and gamma with the old omega: m², gamma² and m·gamma are conserved.

    m·omega is not conserved: it grows until the top rotates about the axis of its smallest moment.
    """
    return omega_gamma_stepper(top, bs_change, old_omega, options)


@scheme(
    "bs-implicit",
    top=FORMS,
    title="BS scheme with the new omega",
    order=1,
    explicit=False,
    self_adjoint=False,
    conserves=rotation_invariants,
    citation=CITATION + ", after Bobenko, Suris 1999",
    formula=r"m' - m = h\,\bar m\times\omega', \qquad \gamma' - \gamma = h\,\bar\gamma\times\omega'",
    equations="EulerBS with omega^{n+1}; gamma by (A) with omega^{n+1}",
    options=CompensatedOption,
    limits={"singular-step": NEWTON_SINGULAR},
)
def build_bs_implicit(top: Top, options: CompensatedOption) -> Stepper:
    """Inverse of ``bs`` with -h: Cayley rotation of m and gamma with the new omega.

    omega is determined to round-off by Newton's method, with step halving as a safeguard. m², gamma² and m·gamma are
    conserved; m·omega decreases until the top rotates about the axis of its largest moment. If a step does not
    converge, the run ends as `no_convergence`.
    """
    return omega_gamma_stepper(top, implicit_change, new_omega, options, iterative=True)
