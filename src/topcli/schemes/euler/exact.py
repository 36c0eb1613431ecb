"""Solutions in closed form for the Euler top: of the motion itself, and of the HK map (sampled, not iterated).

Both are Jacobi's functions of a phase that grows by the same amount in every step (``elliptic_motion``). What
is constant is computed in decimal arithmetic from the doubles as exact numbers (``arithmetic.elliptic``), so that
neither the length of the run nor the nearness of the separatrix costs digits.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from decimal import Decimal, localcontext

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.elliptic import DIGITS, PI, carlson_rf, carlson_rj, to_dd
from topcli.contracts import Array, Floats, NoOptions, Sampler, Top
from topcli.errors import RunError
from topcli.schemes.euler.elliptic_motion import Elliptic, Precession, gamma_at, omega_at, turned
from topcli.schemes.euler.hk import hk_integrals
from topcli.schemes.euler.omega_gamma import FORMS
from topcli.schemes.registry import scheme

Vector = tuple[Decimal, Decimal, Decimal]
ONE = Decimal(1)


def _axes(w: Vector, moments: Vector, alpha: Vector) -> tuple[int, int, int]:
    """The axes (D, S, C): S is the middle one, D the one that the motion circulates about."""
    D, S, C = sorted(range(3), key=lambda i: -moments[i])
    if alpha[S] * (alpha[C] * w[D] ** 2 - alpha[D] * w[C] ** 2) > 0:
        return C, S, D
    return D, S, C


def _signed_root(square: Decimal, like: Decimal) -> Decimal:
    return square.sqrt().copy_sign(like)


@dataclass(frozen=True)
class Phase:
    """u_0 with s = sn u_0, c2 = cn² u_0, d2 = dn² u_0, and the signed amplitudes."""

    u: Decimal
    s: Decimal
    c2: Decimal
    d2: Decimal
    amplitudes: tuple[float, float, float]


def _phase(w: Vector, axes: tuple[int, int, int], squares: Vector, alpha: Vector) -> Phase:
    """The phase at the start for the ``squares`` of the amplitudes of D, S, C.

    a_D and a_C have the signs of omega_D and omega_C, so that |u_0| <= K; omega_S' = alpha_S omega_C omega_D gives a_S.
    """
    D, S, C = axes
    a_D, a_C = _signed_root(squares[0], w[D]), _signed_root(squares[2], w[C])
    a_S = _signed_root(squares[1], alpha[S] * a_C * a_D)
    s, c2, d2 = w[S] / a_S, w[C] ** 2 / squares[2], w[D] ** 2 / squares[0]
    return Phase(s * carlson_rf(c2, d2, ONE), s, c2, d2, (float(a_D), float(a_S), float(a_C)))


def _third_kind(u: Decimal, s: Decimal, c2: Decimal, d2: Decimal, n: Decimal) -> Decimal:
    """The integral of 1/(1 - n sn²) from 0 to u, by s = sn u, c2 = cn² u, d2 = dn² u; n <= 0 (DLMF 19.25.14)."""
    return u + n / 3 * s**3 * carlson_rj(c2, d2, ONE, 1 - n * s * s)


def motion(w: Vector, moments: Vector, h: Decimal) -> Elliptic:
    """The free motion from ``w``, which is not at rest (Landau and Lifshitz, Mechanics, section 37).

    The angle psi of axis D about m turns at the rate |m| (I_S omega_S² + I_C omega_C²)/(I_S² omega_S² + I_C² omega_C²).
    """
    alpha = _quotients(moments)
    axes = D, S, C = _axes(w, moments, alpha)
    I1, I2, I3 = moments[D], moments[S], moments[C]
    e12, e13, e23 = I1 - I2, I1 - I3, I2 - I3
    p = I2 * e12 * w[S] ** 2 + I3 * e13 * w[C] ** 2  # m.omega I_D - m²
    q = I1 * e13 * w[D] ** 2 + I2 * e23 * w[S] ** 2  # m² - m.omega I_C
    # m² - m.omega I_S: the one quantity that cancels near the separatrix
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
    return Elliptic(
        axes,
        at.amplitudes,
        to_dd(at.u),
        to_dd(rate * h),
        None if quarter is None else to_dd(quarter),
        float(m1),
        precession,
    )


def hk_motion(w: Vector, moments: Vector, alpha: Vector, h: Decimal) -> Elliptic:
    """The iterates of the HK map from ``w``, which is not at rest: u advances by 2 v a step.

    With K_i = 1 - d² alpha_j alpha_k omega_i², d = h/2, cn² v = K_S/K_D and dn² v = K_S/K_C. The amplitudes are
    written without the differences of the K's, so that they keep their digits as h -> 0. Raises RunError for steps so
    long that K_S <= 0, where v is no longer real.
    """
    axes = D, S, C = _axes(w, moments, alpha)
    d2 = (h / 2) ** 2
    KD = 1 - d2 * alpha[S] * alpha[C] * w[D] ** 2
    KS = 1 - d2 * alpha[C] * alpha[D] * w[S] ** 2
    KC = 1 - d2 * alpha[D] * alpha[S] * w[C] ** 2
    if KS <= 0:
        longest = abs(float(2 / ((alpha[C] * alpha[D]).sqrt() * w[S])))
        raise RunError(
            f"hk-exact: h = {float(h):g} is too long for this closed form, whose phase would not be real from this "
            f"state; take |h| < {longest:.3g}"
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
    return Elliptic(axes, at.amplitudes, to_dd(at.u), to_dd(2 * v), quarter, float(m1))


def _quotients(moments: Vector) -> Vector:
    A, B, C = moments
    return ((B - C) / A, (C - A) / B, (A - B) / C)


def _steadily(w: Vector, h: Decimal, n: Array, gamma: Array) -> Array:
    """gamma (m, 3) after ``n`` steps at constant omega."""
    size = sum((x * x for x in w), Decimal(0)).sqrt()
    axis = np.array([float(x / size) if size else 0.0 for x in w])
    return turned(axis, to_dd(size * h / (2 * PI)), n, gamma)


def exact_states(y0: Array, h: float, n: NDArray[np.int64], p: Floats) -> Array:
    """States (m, d) of the free motion after ``n`` (m,) steps of ``h`` from ``y0`` (d,), d = 3 or 6."""
    steps = n.astype(np.float64)
    with localcontext(prec=DIGITS):
        w, moments, step = _decimals(y0[:3]), _decimals(p[:3]), Decimal(h)
        if _at_rest(w, _quotients(moments)):
            omega = np.tile(y0[:3], (len(n), 1))
            return np.hstack([omega, _steadily(w, step, steps, y0[3:])]) if len(y0) == 6 else omega
        elliptic = motion(w, moments, step)
    omega, j, parts, dn = omega_at(elliptic, steps)
    if len(y0) == 3:
        return omega
    assert elliptic.precession is not None
    gamma = gamma_at(elliptic, elliptic.precession, steps, omega, j, parts, dn, np.array(p[:3]), y0)
    return np.hstack([omega, gamma])


def hk_states(y0: Array, h: float, n: NDArray[np.int64], p: Floats) -> Array:
    """States (m, 3) of the HK map after ``n`` (m,) steps of ``h`` from ``y0`` (3,); the alphas of ``p`` are exact."""
    with localcontext(prec=DIGITS):
        w, moments, alpha = _decimals(y0), _decimals(p[:3]), _decimals(p[3:])
        if _at_rest(w, alpha):
            return np.tile(y0, (len(n), 1))
        elliptic = hk_motion(w, moments, alpha, Decimal(h))
    return omega_at(elliptic, n.astype(np.float64))[0]


def _decimals(values: Iterable[float]) -> Vector:
    a, b, c = (Decimal(float(value)) for value in values)
    return a, b, c


def _at_rest(w: Vector, alpha: Vector) -> bool:
    """Whether omega is constant: no product of two components makes a torque."""
    return all(alpha[i] * w[(i + 1) % 3] * w[(i + 2) % 3] == 0 for i in range(3))


@scheme(
    "exact",
    top=FORMS,
    title="Solution in closed form",
    order=None,
    explicit=True,
    self_adjoint=True,
    conserves=lambda top: tuple(invariant.name for invariant in top.invariants()),
    citation="Jacobi 1849; Landau, Lifshitz, Mechanics, section 37",
    equations="the equations of motion themselves, by Jacobi's functions and Carlson's integrals",
)
def build_exact(top: Top, options: NoOptions) -> Sampler:
    """omega by Jacobi's functions sn, cn, dn, gamma by an elliptic integral of the third kind; no time stepping.

    Every state is found from the initial one alone, to some ulp, at any time; on the separatrix and next to it as well.
    Rotations about a principal axis and the spherical top are special cases of their own.
    """
    return Sampler(exact_states)


@scheme(
    "hk-exact",
    top="euler",
    title="Closed form of the Hirota-Kimura map",
    order=2,
    explicit=True,
    self_adjoint=True,
    modified=hk_integrals,
    citation="Hirota, Kimura 2000; Petrera, Suris 2010",
    equations="the first difference equations of section 1.2, solved by Jacobi's functions",
    limits={
        "singular-step": "Where K_S <= 0 the phase of the map is no longer real; such steps, of the order of "
        "2/|omega| and beyond, are refused with the longest that is not.",
    },
)
def build_hk_exact(top: Top, options: NoOptions) -> Sampler:
    """The states of ``hk`` without its round-off: Jacobi's functions at a phase that grows by 2 v a step.

    The map lives on the same elliptic curves as its modified integrals say; v and the modulus depend on h.
    """
    return Sampler(hk_states)
