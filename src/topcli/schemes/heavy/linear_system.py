"""Linear system of implicit steps of the general Euler-Poisson equations.

With I = (A, B, C), g = mg(x0, y0, z0), d = h/2 and a = d omega, the HK scheme and Newton's method for the midpoint rule
lead to the same linear problem. Poisson's equation gives the change of gamma in terms of that of omega by the inverse
of 1 - (. x a), which exists for every a. Three equations for the change of omega remain, with the matrix K::

    K delta = delta - d I^-1 (I omega x delta + I delta x omega + zeta x g),   zeta - zeta x a = d gamma x delta

The unknowns are *changes* of the state: their rounding errors are proportional to the change, and the one addition
state + change rounds without bias.
"""

from __future__ import annotations

from topcli.arithmetic.linear import Matrix
from topcli.arithmetic.rotations import Vector, resolvent
from topcli.contracts import Floats


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
