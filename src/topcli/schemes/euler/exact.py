"""Closed forms for the Euler top: its motion, and the iterates of its HK map.

Both are Jacobi elliptic functions of a phase that grows by the same amount in every step. The constants are
computed in decimal arithmetic from the exact values of the doubles (``arithmetic.elliptic``), so that neither long runs
nor the vicinity of the separatrix cost digits.

With the axis D about which the motion circulates, the middle axis S and the third axis C,

    omega_D = a_D dn u,   omega_S = a_S sn u,   omega_C = a_C cn u,   u = u_0 + n (step in u).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from decimal import Decimal, localcontext
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.elliptic import (
    DIGITS,
    PI,
    DoubleDouble,
    add,
    carlson_rf,
    carlson_rj,
    jacobi,
    multiple,
    reduce,
    to_dd,
)
from topcli.contracts import Array, Floats, NoOptions, Sampler, Top
from topcli.errors import RunError
from topcli.schemes.euler.hk import FORMS, hk_integrals
from topcli.schemes.layout import all_invariants
from topcli.schemes.registry import scheme


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


Vector = tuple[Decimal, Decimal, Decimal]
ONE = Decimal(1)


def _axes(w: Vector, moments: Vector, alpha: Vector) -> tuple[int, int, int]:
    """Axes (D, S, C): S is the middle axis, D the axis about which the motion circulates."""
    D, S, C = sorted(range(3), key=lambda i: -moments[i])
    if alpha[S] * (alpha[C] * w[D] ** 2 - alpha[D] * w[C] ** 2) > 0:
        return C, S, D
    return D, S, C


def _signed_root(norm_sq: Decimal, like: Decimal) -> Decimal:
    return norm_sq.sqrt().copy_sign(like)


@dataclass(frozen=True)
class StartPhase:
    """u_0 with s = sn u_0, c2 = cn² u_0, d2 = dn² u_0, and the signed amplitudes."""

    u: Decimal
    s: Decimal
    c2: Decimal
    d2: Decimal
    amplitudes: tuple[float, float, float]


def _phase(w: Vector, axes: tuple[int, int, int], squares: Vector, alpha: Vector) -> StartPhase:
    """Initial phase for the ``squares`` of the amplitudes of D, S, C.

    a_D and a_C have the signs of omega_D and omega_C, so that |u_0| <= K; the sign of a_S follows from
    omega_S' = alpha_S omega_C omega_D.
    """
    D, S, C = axes
    a_D, a_C = _signed_root(squares[0], w[D]), _signed_root(squares[2], w[C])
    a_S = _signed_root(squares[1], alpha[S] * a_C * a_D)
    s, c2, d2 = w[S] / a_S, w[C] ** 2 / squares[2], w[D] ** 2 / squares[0]
    return StartPhase(s * carlson_rf(c2, d2, ONE), s, c2, d2, (float(a_D), float(a_S), float(a_C)))


def _third_kind(u: Decimal, s: Decimal, c2: Decimal, d2: Decimal, n: Decimal) -> Decimal:
    """Integral of 1/(1 - n sn²) from 0 to u, from s = sn u, c2 = cn² u, d2 = dn² u; n <= 0 (DLMF 19.25.14)."""
    return u + n / 3 * s**3 * carlson_rj(c2, d2, ONE, 1 - n * s * s)


def free_motion(w: Vector, moments: Vector, h: Decimal) -> EllipticMotion:
    """Free motion from ``w``, for non-constant omega (Landau and Lifshitz, Mechanics, section 37).

    The rate of the angle psi of axis D about m is |m| (I_S omega_S² + I_C omega_C²)/(I_S² omega_S² + I_C² omega_C²).
    """
    alpha = _quotients(moments)
    axes = D, S, C = _axes(w, moments, alpha)
    I1, I2, I3 = moments[D], moments[S], moments[C]
    e12, e13, e23 = I1 - I2, I1 - I3, I2 - I3
    p = I2 * e12 * w[S] ** 2 + I3 * e13 * w[C] ** 2  # m.omega I_D - m²
    q = I1 * e13 * w[D] ** 2 + I2 * e23 * w[S] ** 2  # m² - m.omega I_C
    # m² - m.omega I_S, the only quantity with cancellation near the separatrix
    m1 = e13 * (I1 * e12 * w[D] ** 2 - I3 * e23 * w[C] ** 2) / (e12 * q)
    rate = (e12 * q / (I1 * I2 * I3)).sqrt()
    at = _phase(w, axes, (q / (I1 * e13), p / (I2 * e12), p / (I3 * e13)), alpha)
    quarter = carlson_rf(Decimal(0), m1, ONE) if m1 else None
    size = ((I1 * w[D]) ** 2 + (I2 * w[S]) ** 2 + (I3 * w[C]) ** 2).sqrt()
    n = -I1 * e23 / (I3 * e12)
    weight = size * e13 / (I1 * I3 * rate) / (2 * PI)
    half = Decimal(0) if quarter is None else 2 * _third_kind(quarter, ONE, Decimal(0), m1, n)
    precession = Precession(
        to_dd(size / I1 * h / (2 * PI)),
        to_dd(weight * half),
        float(weight),
        float(n),
        float(_third_kind(at.u, at.s, at.c2, at.d2, n)),
    )
    return EllipticMotion(
        axes,
        at.amplitudes,
        to_dd(at.u),
        to_dd(rate * h),
        None if quarter is None else to_dd(quarter),
        float(m1),
        precession,
    )


def hk_motion(w: Vector, moments: Vector, alpha: Vector, h: Decimal) -> EllipticMotion:
    """Iterates of the HK map from ``w``, for non-constant omega: u advances by 2 v per step.

    With K_i = 1 - d² alpha_j alpha_k omega_i² and d = h/2, cn² v = K_S/K_D and dn² v = K_S/K_C. The formulas for the
    amplitudes avoid differences of the K_i, so that no digits are lost as h -> 0. Raises RunError for steps so long
    that K_S <= 0, where v is not real.
    """
    axes = D, S, C = _axes(w, moments, alpha)
    d2 = (h / 2) ** 2
    KD = 1 - d2 * alpha[S] * alpha[C] * w[D] ** 2
    KS = 1 - d2 * alpha[C] * alpha[D] * w[S] ** 2
    KC = 1 - d2 * alpha[D] * alpha[S] * w[C] ** 2
    if KS <= 0:
        longest = abs(float(2 / ((alpha[C] * alpha[D]).sqrt() * w[S])))
        raise RunError(
            f"hk-exact: h = {float(h):g} is too large for the closed form: its phase is not real for this initial "
            f"state; use |h| < {longest:.3g}"
        )
    squares = (
        (w[D] ** 2 - alpha[D] / alpha[S] * w[S] ** 2) / KS,
        (w[S] ** 2 - alpha[S] / alpha[C] * w[C] ** 2) / KC,
        (w[C] ** 2 - alpha[C] / alpha[S] * w[S] ** 2) / KS,
    )
    bend = alpha[S] * w[D] ** 2 - alpha[D] * w[S] ** 2
    m1 = KS * alpha[S] * (alpha[C] * w[D] ** 2 - alpha[D] * w[C] ** 2) / (KC * alpha[C] * bend)
    sn_v = _signed_root(-d2 * alpha[C] * bend / KD, h)
    v = sn_v * carlson_rf(KS / KD, KS / KC, ONE)
    at = _phase(w, axes, squares, alpha)
    quarter = to_dd(carlson_rf(Decimal(0), m1, ONE)) if m1 else None
    return EllipticMotion(axes, at.amplitudes, to_dd(at.u), to_dd(2 * v), quarter, float(m1))


def _quotients(moments: Vector) -> Vector:
    A, B, C = moments
    return ((B - C) / A, (C - A) / B, (A - B) / C)


def _steady_rotation(w: Vector, h: Decimal, n: Array, gamma: Array) -> Array:
    """gamma (m, 3) after ``n`` (m,) steps at constant omega."""
    size = sum((x * x for x in w), Decimal(0)).sqrt()
    axis = np.array([float(x / size) if size else 0.0 for x in w])
    return rotated(axis, to_dd(size * h / (2 * PI)), n, gamma)


def exact_states(y0: Array, h: float, n: NDArray[np.int64], p: Floats) -> Array:
    """States (m, d) of the free motion after ``n`` (m,) steps of ``h`` from ``y0`` (d,), d = 3 or 6."""
    steps = n.astype(np.float64)
    with localcontext(prec=DIGITS):
        w, moments, step = _decimals(y0[:3]), _decimals(p[:3]), Decimal(h)
        if _at_rest(w, _quotients(moments)):
            omega = np.tile(y0[:3], (len(n), 1))
            return np.hstack([omega, _steady_rotation(w, step, steps, y0[3:])]) if len(y0) == 6 else omega
        elliptic = free_motion(w, moments, step)
    at = omega_at(elliptic, steps)
    if len(y0) == 3:
        return at.omega
    return np.hstack([at.omega, gamma_at(elliptic, steps, at, np.array(p[:3]), y0)])


def hk_states(y0: Array, h: float, n: NDArray[np.int64], p: Floats) -> Array:
    """States (m, 3) of the HK map after ``n`` (m,) steps of ``h`` from ``y0`` (3,), with the alphas of ``p``."""
    with localcontext(prec=DIGITS):
        w, moments, alpha = _decimals(y0), _decimals(p[:3]), _decimals(p[3:])
        if _at_rest(w, alpha):
            return np.tile(y0, (len(n), 1))
        elliptic = hk_motion(w, moments, alpha, Decimal(h))
    return omega_at(elliptic, n.astype(np.float64)).omega


def _decimals(values: Iterable[float]) -> Vector:
    a, b, c = (Decimal(float(value)) for value in values)
    return a, b, c


def _at_rest(w: Vector, alpha: Vector) -> bool:
    """True if omega is constant, that is, all its rates of change vanish."""
    return all(alpha[i] * w[(i + 1) % 3] * w[(i + 2) % 3] == 0 for i in range(3))


@scheme(
    "exact",
    top=FORMS,
    title="Solution in closed form",
    order=None,
    explicit=True,
    self_adjoint=True,
    conserves=all_invariants,
    citation="Jacobi 1850; Landau, Lifshitz, Mechanics, section 37",
    formula=r"""
\omega_1 = a_1\,\mathrm{dn}(u; k), \quad \omega_2 = a_2\,\mathrm{sn}(u; k), \quad
\omega_3 = a_3\,\mathrm{cn}(u; k), \quad u = \lambda\,(t - t_0) \qquad (A > B > C,\ m^2 > 2TB)

a_1^2 = \frac{m^2 - 2TC}{A(A - C)}, \quad a_2^2 = \frac{2TA - m^2}{B(A - B)}, \quad
a_3^2 = \frac{2TA - m^2}{C(A - C)}, \quad
\lambda^2 = \frac{(A - B)(m^2 - 2TC)}{ABC}, \quad k^2 = \frac{(B - C)(2TA - m^2)}{(A - B)(m^2 - 2TC)}
""",
    equations="the equations of motion, solved by Jacobi elliptic functions and Carlson integrals",
)
def build_exact(top: Top, options: NoOptions) -> Sampler:
    """The scheme computes omega by Jacobi functions sn, cn, dn, and gamma by an elliptic integral of the third kind.

    Every state is computed directly from the initial state. The error of a state is a few ulp (units in the last place)
    at any time, including on and near the separatrix. Rotations about a principal axis and the spherical top have
    formulas of their own.
    """
    return Sampler(exact_states)


@scheme(
    "hk-exact",
    top="euler",
    title="Closed-form solution of the Hirota-Kimura map",
    order=2,
    explicit=True,
    self_adjoint=True,
    modified=hk_integrals,
    citation="Hirota, Kimura 2000; Petrera, Suris 2010",
    formula=r"""
\omega_1 = a_1\,\mathrm{cn}\,\varphi_n, \quad \omega_2 = a_2\,\mathrm{sn}\,\varphi_n, \quad
\omega_3 = a_3\,\mathrm{dn}\,\varphi_n, \quad \varphi_n = \varphi_0 + 2nv, \qquad
K_i = 1 - \tfrac{h^2}{4}\,\alpha_j\alpha_k\,\omega_i^2

\mathrm{sn}^2 v = 1 - \frac{K_2}{K_3}, \qquad k^2\,\mathrm{sn}^2 v = 1 - \frac{K_2}{K_1}

\text{(second moment of inertia between the others; first and third axis exchanged if } k > 1)
""",
    equations="the first difference equations of section 1.2 of the paper, solved by Jacobi elliptic functions",
    limits={
        "singular-step": "For steps of the order of 2/|omega| and longer, the phase of the map may not be real. The "
        "scheme refuses such steps, and the message names the largest admissible step.",
    },
)
def build_hk_exact(top: Top, options: NoOptions) -> Sampler:
    """The scheme computes the states of ``hk`` without its round-off, by Jacobi elliptic functions of a phase.

    The orbits of HK lie on the elliptic curves defined by the modified integrals of HK. The phase grows by 2 v in each
    step. Both v and the modulus of the elliptic functions depend on h.
    """
    return Sampler(hk_states)
