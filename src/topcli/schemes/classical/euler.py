"""Closed-form motion of the Euler top (``exact``), and iterates of its HK map (``hk-exact``).

The motion is given by Jacobi elliptic functions of an argument that grows by the same amount in every step. The
constants are computed in multiprecision from the exact values of the doubles, so that neither long runs nor the
vicinity of the separatrix cost digits. With the axis D about which the motion circulates, the middle axis S and the
third axis C,

    omega_D = a_D dn u,   omega_S = a_S sn u,   omega_C = a_C cn u,   u = u_0 + n (step in u)

(Landau and Lifshitz, Mechanics, section 37).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.elliptic import Argument, phase, third_kind
from topcli.arithmetic.multiprecision import Real, digits, mp, real
from topcli.contracts import Array, Floats, NoOptions, Sampler, Top
from topcli.errors import RunError
from topcli.schemes.any_top.hk_integrals import euler_hk_integrals
from topcli.schemes.registry import closed_form, scheme

Rationals = Sequence[Fraction]


class Elliptic(NamedTuple):
    """omega_D = a_D dn u, omega_S = a_S sn u, omega_C = a_C cn u, with ``s``, ``c2``, ``d2`` = sn, cn², dn² of u_0."""

    axes: tuple[int, int, int]
    """D, S, C."""
    amplitudes: tuple[float, float, float]
    argument: Argument
    s: Real
    c2: Real
    d2: Real

    @classmethod
    def of(cls, w: Rationals, alpha: Rationals, axes: tuple[int, int, int], squares: Rationals, m1: Real) -> Elliptic:
        """Motion with the ``squares`` of the amplitudes of D, S and C, and u at rest.

        a_D and a_C have the signs of omega_D and omega_C, so that |u_0| <= K; omega_S' = alpha_S omega_C omega_D.
        """
        D, S, C = axes
        signs = [-1 if w[i] < 0 else 1 for i in (D, C)]
        sign = -signs[0] * signs[1] if alpha[S] < 0 else signs[0] * signs[1]
        a_D, a_S, a_C = (k * mp.sqrt(real(v)) for k, v in zip((signs[0], sign, signs[1]), squares, strict=True))
        s, c2, d2 = real(w[S]) / a_S, real(w[C] ** 2 / squares[2]), real(w[D] ** 2 / squares[0])
        argument = Argument.of(s * mp.elliprf(c2, d2, 1), mp.mpf(0), m1)
        return cls(axes, (float(a_D), float(a_S), float(a_C)), argument, s, c2, d2)

    def turning(self, rate: Real) -> Elliptic:
        """Copy in which u grows at this rate."""
        return self._replace(argument=replace(self.argument, rate=rate))

    def omega(self, functions: Sequence[Array]) -> Array:
        """omega (m, 3) from sn, cn and dn of u."""
        omega, (sn, cn, dn) = np.empty((len(functions[0]), 3)), functions
        for axis, size, value in zip(self.axes, self.amplitudes, (dn, sn, cn), strict=True):
            omega[:, axis] = size * value
        return omega


def axes_of(w: Rationals, moments: Rationals, alpha: Rationals) -> tuple[int, int, int] | None:
    """Axes D, S, C of the motion; None if omega is constant."""
    if all(alpha[i] * w[(i + 1) % 3] * w[(i + 2) % 3] == 0 for i in range(3)):
        return None
    D, S, C = sorted(range(3), key=lambda i: -moments[i])
    return (C, S, D) if alpha[S] * (alpha[C] * w[D] ** 2 - alpha[D] * w[C] ** 2) > 0 else (D, S, C)


class Free(NamedTuple):
    """Free motion: omega, and the angle psi of axis D about the angular momentum, in revolutions.

    psi advances by ``turn`` per unit of time on average. The rest is ``weight`` (p(u) - p(u_0)), with the periodic part
    p(u) = P(u) - ``mean`` u of the elliptic integral P of the third kind with characteristic ``n``.
    """

    elliptic: Elliptic
    turn: Real
    weight: Real
    mean: Real
    n: Real
    begin: Real
    """p(u_0)."""

    def periodic(self, u: Array, functions: Sequence[Array]) -> Array:
        """p (m,) at ``u`` (m,) between -K and K, from sn, cn and dn up to the same sign.

        If two moments are almost equal, psi is many times larger than p, which must not be a difference.
        """
        from scipy.special import elliprj

        n, argument = float(self.n), self.elliptic.argument
        sn, cn, dn = functions
        sn = np.copysign(sn, u)
        if argument.quarter is None:
            return (-n) ** 0.5 / (1.0 - n) * np.arctan((-n) ** 0.5 * sn)
        if n > -1.0:
            return n / 3.0 * sn**3 * elliprj(cn * cn, dn * dn, 1.0, 1.0 - n * sn * sn) - float(self.mean - 1) * u
        rest, m1 = np.copysign(float(argument.quarter) - np.abs(u), u), float(argument.m1)
        s, c2, d2, part = np.copysign(cn / dn, u), m1 * (sn / dn) ** 2, m1 / dn**2, m1 / (1.0 - n)
        beyond = (rest - n * part / 3.0 * s**3 * elliprj(c2, d2, 1.0, c2 + part * s * s)) / (1.0 - n)  # P(K) - P(u)
        return float(self.mean) * rest - beyond


@lru_cache(maxsize=64)
@digits()
def free_motion(omega: Floats, moments: Floats) -> Free | None:
    """Free motion from ``omega``; None if that is constant.

    The rate of the angle psi of axis D about m is |m| (I_S omega_S² + I_C omega_C²)/(I_S² omega_S² + I_C² omega_C²).
    """
    w, J = ([Fraction(v) for v in values] for values in (omega, moments))
    alpha = [(J[(i + 1) % 3] - J[(i + 2) % 3]) / J[i] for i in range(3)]
    axes = axes_of(w, J, alpha)
    if axes is None:
        return None
    D, S, C = axes
    I1, I2, I3 = J[D], J[S], J[C]
    e12, e13, e23 = I1 - I2, I1 - I3, I2 - I3
    P = I2 * e12 * w[S] ** 2 + I3 * e13 * w[C] ** 2  # m.omega I_D - m²
    Q = I1 * e13 * w[D] ** 2 + I2 * e23 * w[S] ** 2  # m² - m.omega I_C
    m1 = real(e13 * (I1 * e12 * w[D] ** 2 - I3 * e23 * w[C] ** 2) / (e12 * Q))
    rate = mp.sqrt(real(e12 * Q / (I1 * I2 * I3)))
    at = Elliptic.of(w, alpha, axes, (Q / (I1 * e13), P / (I2 * e12), P / (I3 * e13)), m1).turning(rate)
    size = mp.sqrt(real(sum((i * v) ** 2 for i, v in zip(J, w, strict=True))))
    n, weight = real(-I1 * e23 / (I3 * e12)), size * real(e13 / (I1 * I3)) / rate / (2 * mp.pi)
    K, start = at.argument.quarter, at.argument.start
    mean = third_kind(K, mp.mpf(1), mp.mpf(0), m1, n) / K if K else 1 / (1 - n)
    begin = third_kind(start, at.s, at.c2, at.d2, n) - mean * start
    return Free(at, size / real(I1) / (2 * mp.pi) + weight * mean * rate, weight, mean, n, begin)


def _frame(m: Array, axis: int) -> tuple[Array, Array, Array]:
    """m/|m| and two unit vectors normal to it, the first in the plane of m and the body ``axis``; each (m, 3)."""
    m = np.ldexp(m, -np.frexp(np.abs(m).max(axis=1, keepdims=True))[1])  # exact, and no square overflows
    along = m / np.linalg.norm(m, axis=1, keepdims=True)
    normal = np.cross(along, np.eye(3)[axis])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return along, np.cross(normal, along), normal


def _gamma(free: Free, omega: Array, psi: Array, y0: Array, moments: Floats) -> Array:
    """gamma (m, 3): its component along m is constant, the rest rotates by -psi in the frame of m and axis D."""
    axis = free.elliptic.axes[0]
    along, normal, other = _frame(omega * moments, axis)
    up, x, y = (float(y0[3:] @ part[0]) for part in _frame((y0[:3] * moments)[None], axis))
    cos, sin = np.cos(psi), np.sin(psi)
    return up * along + (x * cos + y * sin)[:, None] * normal + (y * cos - x * sin)[:, None] * other


def _rotated(y0: Array, h: float, n: NDArray[Any]) -> Array:
    """gamma (m, 3) after ``n`` (m,) steps at constant omega."""
    w = [real(float(v)) for v in y0[:3]]
    size, gamma = mp.sqrt(sum(v * v for v in w)), y0[3:]
    axis = np.array([float(v / size) if size else 0.0 for v in w])
    angle = 2.0 * np.pi * phase(mp.mpf(0), size * real(h) / (2 * mp.pi), n)[1]
    along = (axis @ gamma) * axis
    return along + np.cos(angle)[:, None] * (gamma - along) + np.sin(angle)[:, None] * np.cross(gamma, axis)


def euler_states(y0: Array, h: float, n: NDArray[np.int64], p: Floats) -> Array:
    """States (m, d) of the free motion after ``n`` (m,) steps of ``h`` from ``y0`` (d,), d = 3 or 6."""
    moments = tuple(float(v) for v in p[:3])
    with digits():
        free = free_motion(tuple(float(v) for v in y0[:3]), moments)
        if free is None:
            omega = np.tile(y0[:3], (len(n), 1))
            return np.hstack([omega, _rotated(y0, h, n)]) if len(y0) == 6 else omega
        step = real(h)
        _, u, *functions = free.elliptic.argument.functions(n, step)
        turned = phase(mp.mpf(0), free.turn * step, n)[1]
    omega = free.elliptic.omega(functions)
    if len(y0) == 3:
        return omega
    psi = 2.0 * np.pi * (turned + float(free.weight) * (free.periodic(u, functions) - float(free.begin)))
    return np.hstack([omega, _gamma(free, omega, psi, y0, moments)])


@closed_form(top=("euler", "euler+gamma"))
def build_euler(top: Top, options: NoOptions) -> Sampler:
    r"""Solution in closed form.

    The scheme computes omega by Jacobi functions sn, cn, dn, and gamma by an elliptic integral of the third kind.

    Every state is computed directly from the initial state. The error of a state is a few ulp (units in the last place)
    at any time, including on and near the separatrix. Rotations about a principal axis and the spherical top have
    formulas of their own.

    Source
    ------
    Jacobi 1850; Landau, Lifshitz, Mechanics, section 37

    Equations
    ---------
    the equations of motion, solved by Jacobi elliptic functions and Carlson integrals

    Formula
    -------
    \omega_1 = a_1\,\mathrm{dn}(u; k), \quad \omega_2 = a_2\,\mathrm{sn}(u; k), \quad
    \omega_3 = a_3\,\mathrm{cn}(u; k), \quad u = \lambda\,(t - t_0) \qquad (A > B > C,\ m^2 > 2TB)

    a_1^2 = \frac{m^2 - 2TC}{A(A - C)}, \quad a_2^2 = \frac{2TA - m^2}{B(A - B)}, \quad
    a_3^2 = \frac{2TA - m^2}{C(A - C)}, \quad
    \lambda^2 = \frac{(A - B)(m^2 - 2TC)}{ABC}, \quad k^2 = \frac{(B - C)(2TA - m^2)}{(A - B)(m^2 - 2TC)}
    """
    return Sampler(euler_states)


@lru_cache(maxsize=64)
@digits()
def hk_motion(y0: Floats, h: float, p: Floats) -> Elliptic | None:
    """Iterates from ``y0`` (3,), with u per step; None if omega is constant.

    With K_i = 1 - d² alpha_j alpha_k omega_i² and d = h/2, u advances by 2 v per step, where cn² v = K_S/K_D and
    dn² v = K_S/K_C. The formulas of the amplitudes avoid differences of the K_i. Raises RunError for steps so long
    that K_S <= 0, where v is not real.
    """
    w, moments, alpha = ([Fraction(v) for v in values] for values in (y0, p[:3], p[3:6]))
    axes = axes_of(w, moments, alpha)
    if axes is None:
        return None
    D, S, C = axes
    d2 = (Fraction(h) / 2) ** 2
    KD = 1 - d2 * alpha[S] * alpha[C] * w[D] ** 2
    KS = 1 - d2 * alpha[C] * alpha[D] * w[S] ** 2
    KC = 1 - d2 * alpha[D] * alpha[S] * w[C] ** 2
    if KS <= 0:
        longest = float(2 / (mp.sqrt(real(alpha[C] * alpha[D])) * abs(real(w[S]))))
        raise RunError(
            f"hk-exact: h = {h:g} is too large for the closed form: its phase is not real for this initial state; "
            f"use |h| < {longest:.3g}"
        )
    bend = alpha[S] * w[D] ** 2 - alpha[D] * w[S] ** 2
    m1 = real(KS * alpha[S] * (alpha[C] * w[D] ** 2 - alpha[D] * w[C] ** 2) / (KC * alpha[C] * bend))
    sn_v = mp.sqrt(real(-d2 * alpha[C] * bend / KD))
    v = (-sn_v if h < 0 else sn_v) * mp.elliprf(real(KS / KD), real(KS / KC), 1)
    squares = (
        (w[D] ** 2 - alpha[D] / alpha[S] * w[S] ** 2) / KS,
        (w[S] ** 2 - alpha[S] / alpha[C] * w[C] ** 2) / KC,
        (w[C] ** 2 - alpha[C] / alpha[S] * w[S] ** 2) / KS,
    )
    return Elliptic.of(w, alpha, axes, squares, m1).turning(2 * v)


def hk_states(y0: Array, h: float, n: NDArray[np.int64], p: Floats) -> Array:
    """States (m, 3) after ``n`` (m,) steps of ``h`` from ``y0`` (3,). Raises RunError if ``h`` is too long."""
    with digits():
        motion = hk_motion(tuple(map(float, y0)), float(h), tuple(map(float, p[:6])))
        if motion is None:
            return np.tile(y0, (len(n), 1))
        return motion.omega(motion.argument.functions(n, mp.mpf(1))[2:])


@scheme(
    "hk-exact",
    top="euler",
    order=2,
    explicit=True,
    self_adjoint=True,
    modified=lambda top, h, options: euler_hk_integrals(top, h),
)
def build_hk_exact(top: Top, options: NoOptions) -> Sampler:
    r"""Closed-form solution of the Hirota-Kimura map.

    The scheme computes the states of ``hk`` without its round-off, by Jacobi elliptic functions of a phase.

    The orbits of HK lie on the elliptic curves defined by the modified integrals of HK. The phase grows by 2 v in each
    step. Both v and the modulus of the elliptic functions depend on h.

    Source
    ------
    Hirota, Kimura 2000; Petrera, Suris 2010

    Equations
    ---------
    the first difference equations of section 1.2 of the paper, solved by Jacobi elliptic functions

    Formula
    -------
    \omega_1 = a_1\,\mathrm{cn}\,\varphi_n, \quad \omega_2 = a_2\,\mathrm{sn}\,\varphi_n, \quad
    \omega_3 = a_3\,\mathrm{dn}\,\varphi_n, \quad \varphi_n = \varphi_0 + 2nv, \qquad
    K_i = 1 - \tfrac{h^2}{4}\,\alpha_j\alpha_k\,\omega_i^2

    \mathrm{sn}^2 v = 1 - \frac{K_2}{K_3}, \qquad k^2\,\mathrm{sn}^2 v = 1 - \frac{K_2}{K_1}

    \text{(second moment of inertia between the others; first and third axis exchanged if } k > 1)

    Limits
    ------
    singular-step
        For steps of the order of 2/|omega| and longer, the phase of the map may not be real. The scheme refuses such
        steps, and the message names the largest admissible step.
    """
    return Sampler(hk_states)
