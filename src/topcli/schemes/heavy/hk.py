"""Hirota-Kimura (Kahan) step of the general heavy top.

Performance:
- the 6x6 system reduces to a 3x3 system, because the change of gamma is a Cayley rotation plus a term linear in the
  change of omega;
- the 3x3 system is solved by Cramer's rule; its columns need one reciprocal, of 1 + |h omega/2|², so that there are two
  divisions on the critical path;
- the compiler moves expressions in the moments and h out of the loop.

Linear system of implicit steps of the general Euler-Poisson equations.

With I = (A, B, C), g = mg(x0, y0, z0), d = h/2 and a = d omega, the HK scheme and Newton's method for the midpoint rule
lead to the same linear problem. Poisson's equation gives the change of gamma in terms of that of omega by the inverse
of 1 - (. x a), which exists for every a. Three equations for the change of omega remain, with the matrix K::

    K delta = delta - d I^-1 (I omega x delta + I delta x omega + zeta x g),   zeta - zeta x a = d gamma x delta

The unknowns are *changes* of the state: their rounding errors are proportional to the change, and the one addition
state + change rounds without bias.
"""

from __future__ import annotations

from topcli.arithmetic.rotations import Vector, cayley_increment, resolvent
from topcli.arithmetic.vectors import Matrix, solve3
from topcli.contracts import Floats, Stepper, Top
from topcli.schemes.declarations import HIROTA_KIMURA, LONG_HK, SINGULAR
from topcli.schemes.layout import NEAR_SINGULAR, CompensatedOption, increment_stepper, small_determinant, with_counter
from topcli.schemes.registry import scheme


def implicit_matrix(a: Vector, gamma: Vector, d: float, p: Floats) -> Matrix:
    """Matrix K, in row-major order, for a = d omega and gamma; ``p`` is (A, B, C, mg x0, mg y0, mg z0)."""
    a1, a2, a3 = a
    A, B, C, x, y, z = p
    e1, e2, e3 = d * gamma[0], d * gamma[1], d * gamma[2]
    s11, s21, s31 = resolvent(a1, a2, a3, 0.0, e3, -e2)
    s12, s22, s32 = resolvent(a1, a2, a3, -e3, 0.0, e1)
    s13, s23, s33 = resolvent(a1, a2, a3, e2, -e1, 0.0)
    f1, f2, f3 = 1.0 / A, 1.0 / B, 1.0 / C
    k1, k2, k3 = f1 * (B - C), f2 * (C - A), f3 * (A - B)
    f1, f2, f3 = d * f1, d * f2, d * f3
    return (
        1.0 - f1 * (s21 * z - s31 * y),
        -k1 * a3 - f1 * (s22 * z - s32 * y),
        -k1 * a2 - f1 * (s23 * z - s33 * y),
        -k2 * a3 - f2 * (s31 * x - s11 * z),
        1.0 - f2 * (s32 * x - s12 * z),
        -k2 * a1 - f2 * (s33 * x - s13 * z),
        -k3 * a2 - f3 * (s11 * y - s21 * x),
        -k3 * a1 - f3 * (s12 * y - s22 * x),
        1.0 - f3 * (s13 * y - s23 * x),
    )


def hk_heavy_change(state: Floats, h: float, p: Floats) -> Floats:
    """Change in one HK step (Sogo, dEulerPoisson, last sign corrected); ``p`` is (A, B, C, mg x0, mg y0, mg z0).

    The change of gamma is that of the BS step (omega constant) plus a term linear in the change of omega. The system is
    singular only for step sizes far too large to be useful.
    """
    w1, w2, w3, g1, g2, g3 = state
    A, B, C, x, y, z = p
    d = 0.5 * h
    a1, a2, a3 = d * w1, d * w2, d * w3
    b1, b2, b3 = cayley_increment(a1, a2, a3, g1, g2, g3)
    t1, t2, t3 = g1 + 0.5 * b1, g2 + 0.5 * b2, g3 + 0.5 * b3
    u1, u2, u3 = solve3(
        implicit_matrix((a1, a2, a3), (g1, g2, g3), d, p),
        (h / A) * ((B - C) * w2 * w3 + (t2 * z - t3 * y)),
        (h / B) * ((C - A) * w3 * w1 + (t3 * x - t1 * z)),
        (h / C) * ((A - B) * w1 * w2 + (t1 * y - t2 * x)),
    )
    z1, z2, z3 = resolvent(a1, a2, a3, d * (g2 * u3 - g3 * u2), d * (g3 * u1 - g1 * u3), d * (g1 * u2 - g2 * u1))
    return (u1, u2, u3, b1 + z1, b2 + z2, b3 + z3)


def heavy_determinant(state: Floats, h: float, p: Floats) -> tuple[float, float]:
    """Determinant of the system for omega in ``hk_heavy_change`` and the sum of the magnitudes of its terms."""
    w1, w2, w3, g1, g2, g3 = state[0], state[1], state[2], state[3], state[4], state[5]
    d = 0.5 * h
    m11, m12, m13, m21, m22, m23, m31, m32, m33 = implicit_matrix((d * w1, d * w2, d * w3), (g1, g2, g3), d, p)
    t1 = m11 * (m22 * m33 - m23 * m32)
    t2 = m12 * (m23 * m31 - m21 * m33)
    t3 = m13 * (m21 * m32 - m22 * m31)
    return (t1 + t2 + t3, abs(t1) + (abs(t2) + abs(t3)))


@scheme(
    "hk",
    top="heavy",
    title="Hirota-Kimura scheme",
    order=2,
    explicit=True,
    self_adjoint=True,
    citation="Kahan 1993; Hirota, Kimura 2000; Kimura, Hirota 2000; Sogo, Discrete Spinning Tops, section 2.1",
    formula=HIROTA_KIMURA,
    equations="dEulerPoisson, with the last term of its last line corrected to gamma_2^n omega_1^{n+1}",
    options=CompensatedOption,
    limits={"singular-step": SINGULAR, "resonance": LONG_HK},
)
def build(top: Top, options: CompensatedOption) -> Stepper:
    """Linear in the new state: gamma is eliminated, and the three equations for omega are solved in closed form.

    None of the three integrals is conserved exactly; for small h the deviations are of size h². Special tops have
    faster implementations of the same map under the same name.
    """
    return with_counter(
        increment_stepper(hk_heavy_change, 6, options), NEAR_SINGULAR, small_determinant(heavy_determinant)
    )
