"""Free motion of the Euler top and HK map in Jacobi elliptic functions, evaluated after any number of steps.

With the axis D about which the motion circulates, the middle axis S and the third axis C,

    omega_D = a_D dn u,   omega_S = a_S sn u,   omega_C = a_C cn u,   u = u_0 + n (step in u).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from topcli.arithmetic.elliptic import DoubleDouble, add, jacobi, multiple, reduce
from topcli.contracts import Array


@dataclass(frozen=True)
class Precession:
    """Rotation of the body about its angular momentum m: the angle psi of axis D, in revolutions.

    psi advances by ``per_step`` per step, by ``per_half`` per half period 2K of u, and within a half period by
    ``weight`` (P(r) - P(u_0)), with the elliptic integral P of the third kind with characteristic ``n``.
    """

    per_step: DoubleDouble
    per_half: DoubleDouble
    weight: float
    n: float
    start: float


@dataclass(frozen=True)
class EllipticMotion:
    """omega in elliptic functions: axes (D, S, C), signed amplitudes, start and step of u, quarter period K."""

    axes: tuple[int, int, int]
    amplitudes: tuple[float, float, float]
    start: DoubleDouble
    step: DoubleDouble
    quarter: DoubleDouble | None
    """None on the separatrix, where K is infinite."""
    m1: float
    precession: Precession | None = None


class Evaluated(NamedTuple):
    """omega (m, 3) and the functions of u = 2 K j + r that it is made of, (m,) each."""

    omega: Array
    j: Array
    r: Array
    sn: Array
    cn: Array
    dn: Array


def omega_at(elliptic: EllipticMotion, n: Array) -> Evaluated:
    """Return omega after ``n`` (m,) steps; ``sn`` and ``cn`` are those of r."""
    u = add(elliptic.start, multiple(elliptic.step, n))
    if elliptic.quarter is None:
        j, r = np.zeros_like(n), u
    else:
        j, r = reduce(u, (2.0 * elliptic.quarter[0], 2.0 * elliptic.quarter[1]))
    sn, cn, dn = jacobi(r, elliptic.quarter, elliptic.m1)
    turn = np.where(j % 2.0 == 0.0, 1.0, -1.0)
    omega = np.empty((len(n), 3))
    for axis, size, value in zip(elliptic.axes, elliptic.amplitudes, (dn, turn * sn, turn * cn), strict=True):
        omega[:, axis] = size * value
    return Evaluated(omega, j, r[0], sn, cn, dn)


def _frame(m: Array, axis: int) -> tuple[Array, Array, Array]:
    """m/|m| and two unit vectors normal to it, the first in the plane of m and the body ``axis``; each (m, 3)."""
    exponent = np.frexp(np.abs(m).max(axis=1, keepdims=True))[1]
    m = np.ldexp(m, -exponent)  # exact, and no square overflows
    along = m / np.linalg.norm(m, axis=1, keepdims=True)
    second, third = (axis + 1) % 3, (axis + 2) % 3
    normal = np.zeros_like(along)
    rho = np.hypot(along[:, second], along[:, third])
    normal[:, second], normal[:, third] = along[:, third] / rho, -along[:, second] / rho
    return along, np.cross(normal, along), normal


def gamma_at(elliptic: EllipticMotion, n: Array, at: Evaluated, moments: Array, y0: Array) -> Array:
    """gamma (m, 3): its component along m is constant, the rest rotates by -psi in the frame of m and axis D.

    ``at`` is ``omega_at(elliptic, n)``.
    """
    from scipy.special import elliprj

    omega, j, r, s, c, dn = at
    precession = elliptic.precession
    assert precession is not None
    k = precession.n
    if elliptic.quarter is None:
        root = np.sqrt(-k)
        within = (r + root * np.arctan(root * s)) / (1.0 - k)
    else:
        within = r + k / 3.0 * s**3 * elliprj(c * c, dn * dn, 1.0, 1.0 - k * s * s)
    high, low = add(multiple(precession.per_step, n), multiple(precession.per_half, j))
    psi = 2.0 * np.pi * ((high - np.round(high)) + low + precession.weight * (within - precession.start))
    axis = elliptic.axes[0]
    along, normal, other = _frame(omega * moments, axis)
    along0, normal0, other0 = (part[0] for part in _frame((y0[:3] * moments)[None], axis))
    x, y = float(y0[3:] @ normal0), float(y0[3:] @ other0)
    cos, sin = np.cos(psi), np.sin(psi)
    return float(y0[3:] @ along0) * along + (x * cos + y * sin)[:, None] * normal + (y * cos - x * sin)[:, None] * other


def rotated(axis: Array, turns: DoubleDouble, n: Array, gamma: Array) -> Array:
    """``gamma`` (3,) rotated by -``turns`` revolutions per step about the unit vector ``axis``, ``n`` (m,) steps."""
    high, low = multiple(turns, n)
    angle = 2.0 * np.pi * ((high - np.round(high)) + low)
    along = (axis @ gamma) * axis
    return along + np.cos(angle)[:, None] * (gamma - along) + np.sin(angle)[:, None] * np.cross(gamma, axis)
