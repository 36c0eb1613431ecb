"""Implicit midpoint rule for the Euler top, solved by Newton's method in three unknowns from HK's step.

Notation as in ``hk``. Each correction is the closed-form solution of HK's linear system at the mean omega.
"""

from __future__ import annotations

from topcli.arithmetic.rotations import Vector
from topcli.contracts import Floats, Stepper, Top
from topcli.schemes.declarations import NEWTON_SINGULAR, NO_SOLUTION
from topcli.schemes.euler.hk import hk_increment
from topcli.schemes.euler.steps import CITATION, FORMS, mean_omega, newton, omega_gamma_stepper
from topcli.schemes.layout import CompensatedOption
from topcli.schemes.registry import scheme


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
    conserves=lambda top: tuple(invariant.name for invariant in top.invariants()),
    citation=CITATION,
    formula=r"m' - m = h\,\bar m\times\bar\omega, \qquad \gamma' - \gamma = h\,\bar\gamma\times\bar\omega",
    equations="the last difference equations of section 1.2; gamma by the modified BS scheme of section 3.2.3",
    options=CompensatedOption,
    limits={"resonance": NO_SOLUTION, "singular-step": NEWTON_SINGULAR},
)
def build_midpoint(top: Top, options: CompensatedOption) -> Stepper:
    """Cayley rotation of m and gamma with the mean omega: all integrals are conserved.

    Newton's method in three unknowns starts from HK's step, whose error is O(h³); two or three corrections reach
    round-off. If a step does not converge, the run ends as `no_convergence`.
    """
    return omega_gamma_stepper(top, midpoint_change, mean_omega, options, iterative=True)
