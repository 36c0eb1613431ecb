"""The implicit midpoint rule for the Euler top: Newton's method on three unknowns from HK's step.

Notation as in ``hk``: each correction is the closed-form solution of HK's linear system at the mean omega.
"""

from __future__ import annotations

from topcli.arithmetic.rotations import Vector
from topcli.contracts import Floats, Stepper, Top
from topcli.schemes.compensated import CompensatedOption
from topcli.schemes.euler.hk import hk_increment
from topcli.schemes.euler.newton import newton, with_status
from topcli.schemes.euler.omega_gamma import CITATION, FORMS, mean, stepper_of
from topcli.schemes.limits import NEWTON_SINGULAR, NO_SOLUTION
from topcli.schemes.registry import scheme


def midpoint_residual(w: Vector, q: Floats, z: Vector) -> Vector:
    """By how much half a change z misses z_i = c_i (omega_j + z_j)(omega_k + z_k); q = (c_1, c_2, c_3)."""
    y1 = w[0] + z[0]
    y2 = w[1] + z[1]
    y3 = w[2] + z[2]
    return (q[0] * (y2 * y3) - z[0], q[1] * (y3 * y1) - z[1], q[2] * (y1 * y2) - z[2])


def midpoint_correction(w: Vector, q: Floats, z: Vector, r: Vector) -> Vector:
    """Newton's correction of z for the residual r: M x = r at omega + z."""
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
"""(omega' - omega)/2 of the midpoint rule, ``midpoint_half(omega, (c_1, c_2, c_3), start)``."""


def midpoint_change(w1: float, w2: float, w3: float, d: float, p: Floats) -> Vector:
    """omega' - omega = h f((omega' + omega)/2), solved from HK's change.

    At the end the change is computed afresh from the equation: what the iteration leaves is always of the same sign,
    and would drift by 4e-20 a step.
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
    equations="the last difference equations of section 1.2; gamma by the modified BS scheme of section 3.2.3",
    options=CompensatedOption,
    limits={"resonance": NO_SOLUTION, "singular-step": NEWTON_SINGULAR},
)
def build_midpoint(top: Top, options: CompensatedOption) -> Stepper:
    """m and gamma turn by Cayley's rotation with the mean omega: all integrals are conserved.

    Newton's method on three unknowns starts from HK's step, which misses by O(h³); two or three corrections reach
    round-off. A step that does not settle ends the run as `no_convergence`.
    """
    return with_status(stepper_of(top, midpoint_change, mean, options), len(top.components))
