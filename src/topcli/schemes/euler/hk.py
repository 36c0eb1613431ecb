"""Hirota-Kimura (Kahan) step of the Euler top and its integrals, without and with the vertical gamma.

Notation: d = h/2, alpha_1 = (B - C)/A and cyclically, c_i = d alpha_i, u_i = c_i omega_j omega_k (half of Euler's
rule), i, j, k cyclic. The matrix of both HK and Newton's method for the midpoint rule is
M = 1 - [c_i (omega_k e_j + omega_j e_k)]. With b_i = c_j c_k omega_i² and v_i = omega_i + u_i, M x = r is solved by

    x_i = ((1 - b_i) r_i + c_i (v_k r_j + v_j r_k))/Delta,    Delta = 1 - (b_1 + b_2 + b_3) - 2 u_1 c_2 c_3 omega_1.

Every function returns omega' - omega (or half of it). The only operation that rounds at the size of omega is then one
addition, so that round-off is a random walk. The step has a closed form with one division, which overlaps with the
computation of gamma. Code generated from the field takes 3 to 6 % longer for one trajectory; with gamma, its modified
gamma² drifts by 4e4 to 6e4 ulp over 1e8 steps of 0.1, that of this step by 2e3.

Integrals of the map, with I = (A, B, C):

    K_i = 1 - d² alpha_j alpha_k omega_i²,    q_i = alpha_j omega_k² - alpha_k omega_j²,    K_j - K_k = d² alpha_i q_i,
    R_i = K_j K_k - d⁴ q_j q_k.

The map of omega conserves K_i/K_j, m²/K_i and m·omega/K_i (Hirota, Kimura 2000; Petrera, Pfadler, Suris 2011). The map
of omega and gamma also conserves modified forms of m·gamma and gamma²; K is the mean of the K_i:

    J = sum_i rho_i omega_i gamma_i/K³,
        rho_i = I_i K_j K_k + d² [(I_k K_j + I_j K_k) q_i/2
                                  + (I_i (K_j + K_k) - d² (I_j + I_k) q_i) (alpha_k q_k - alpha_j q_j)/4],
    G = (sum_i R_j R_k gamma_i²/K_i + d² K_1 K_2 K_3 S²)/K⁴,    S = sum_i (1 + d² q_i/K_i) omega_i gamma_i.

No difference of moments appears in a denominator and no two nearly equal terms are subtracted, so that J -> m·gamma and
G -> gamma² without loss of digits as h -> 0, also for bodies with two or three equal moments.
The signs of the K_i relative to each other and those of the R_i are conserved. If all K_i > 0 and all R_i have one
sign, G is positive definite in gamma and bounds its length. Otherwise it is indefinite.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from topcli.arithmetic.fused import fma
from topcli.arithmetic.vectors import Vector
from topcli.contracts import UNKNOWN, Array, Floats, Integrability, Invariant, Stepper, Top
from topcli.schemes.any_top.kahan import kahan_tangent
from topcli.schemes.layout import (
    NEAR_SINGULAR,
    SINGULAR,
    Change,
    CompensatedOption,
    increment_stepper,
    is_compensated,
    small_determinant,
    with_counter,
)
from topcli.schemes.registry import scheme
from topcli.tops.euler import Euler

FORMS = ("euler", "euler+gamma")
CITATION = "Sogo, Discrete Spinning Tops, section 1.2"
OmegaChange = Callable[[float, float, float, float, Floats], Vector]
"""``change(w1, w2, w3, d, p)`` returns omega' - omega, for d = h/2."""
LONGEST = 2.0**511
"""Steps from here on have squares that are no double."""


def hk_integrals(top: Euler, h: float, options: Any = None) -> tuple[Invariant, ...]:
    """Exact integrals of the HK map: five of omega and, if gamma is part of the state, two with gamma.

    m² and m·omega are divided by the mean of the three K_i. Instead of K_1/K_2 = 1 + (h/2)² alpha_3 q, the integral is
    q = (alpha_1 omega_2² - alpha_2 omega_1²)/K_2: it loses no digits for small h and tends to an integral of the motion
    as h -> 0.
    """
    m_sq, m_omega = top.invariants()[:2]
    of_omega = (
        _over_mean(top, h, m_sq, "m²"),
        _over_mean(top, h, m_omega, "m·ω"),
        _ratio(top, h, 0, 1),
        _ratio(top, h, 1, 2),
        _ratio(top, h, 2, 0),
    )
    return of_omega if len(top.components) == 3 else (*of_omega, *_gamma_integrals(top, h))


def _square(h: float) -> float:
    return (0.5 * h) ** 2 if abs(h) < LONGEST else math.inf


def _k(top: Euler, h: float, y: Array) -> Array:
    """K_1, K_2, K_3 of states (n, d), as an array (n, 3)."""
    alpha = np.array(top.constants()[3:])
    return 1.0 - _square(h) * np.roll(alpha, -1) * np.roll(alpha, -2) * y[:, :3] ** 2


def _over_mean(top: Euler, h: float, invariant: Invariant, subject: str) -> Invariant:
    def value(y: Array) -> Array:
        return invariant.value(y) / _k(top, h, y).mean(axis=1)

    def scale(y: Array) -> Array:
        return invariant.scale(y) / np.abs(_k(top, h, y)).mean(axis=1)

    meaning = f"{subject} divided by the mean of K1, K2, K3"
    return Invariant(f"modified_{invariant.name}", f"{invariant.symbol}/K", f"{invariant.tex}/K", meaning, value, scale)


def _ratio(top: Euler, h: float, i: int, j: int) -> Invariant:
    alpha = top.constants()[3:]

    def value(y: Array) -> Array:
        return (alpha[i] * y[:, j] ** 2 - alpha[j] * y[:, i] ** 2) / _k(top, h, y)[:, j]

    def scale(y: Array) -> Array:
        return (abs(alpha[i]) * y[:, j] ** 2 + abs(alpha[j]) * y[:, i] ** 2) / np.abs(_k(top, h, y)[:, j])

    a, b = i + 1, j + 1
    meaning = f"(K{a}/K{b} - 1)/((h/2)² α{6 - a - b})"
    return Invariant(f"modified_k{a}{b}", f"κ{a}{b}", rf"\kappa_{{{a}{b}}}", meaning, value, scale)


class _Parts(NamedTuple):
    """Parts of J and G at states (n, 6): the K_i and their mean, rho_i, R_i and the factors of omega_i gamma_i in S."""

    k: Array
    mean: Array
    rho: Array
    r: Array
    along: Array


def _parts(top: Euler, h: float, y: Array) -> _Parts:
    constants = np.array(top.constants())
    moments, alpha, square = constants[:3], constants[3:], _square(h)
    k = _k(top, h, y)
    squares = y[:, :3] ** 2
    alpha_j, alpha_k = np.roll(alpha, -1), np.roll(alpha, -2)
    q = alpha_j * _third(squares) - alpha_k * _second(squares)
    k_j, k_k, q_j, q_k = _second(k), _third(k), _second(q), _third(q)
    moment_j, moment_k = np.roll(moments, -1), np.roll(moments, -2)
    even = 0.5 * (moment_k * k_j + moment_j * k_k) * q
    odd = 0.25 * (moments * (k_j + k_k) - square * (moment_j + moment_k) * q) * (alpha_k * q_k - alpha_j * q_j)
    rho = moments * k_j * k_k + square * (even + odd)
    return _Parts(k, k.mean(axis=1), rho, k_j * k_k - (square * q_j) * (square * q_k), 1.0 + square * q / k)


def _second(values: Array) -> Array:
    """Columns j of ``values`` (n, 3), in the order of i."""
    return np.roll(values, -1, axis=1)


def _third(values: Array) -> Array:
    """Columns k of ``values`` (n, 3), in the order of i."""
    return np.roll(values, -2, axis=1)


def _gamma_integrals(top: Euler, h: float) -> tuple[Invariant, Invariant]:
    """J and G: modified m·gamma and gamma²."""

    def m_gamma(magnitude: Callable[[Array], Array]) -> Callable[[Array], Array]:
        def value(y: Array) -> Array:
            parts = _parts(top, h, y)
            return magnitude(parts.rho * y[:, :3] * y[:, 3:]).sum(axis=1) / magnitude(parts.mean**3)

        return value

    def gamma_sq(magnitude: Callable[[Array], Array]) -> Callable[[Array], Array]:
        def value(y: Array) -> Array:
            parts = _parts(top, h, y)
            diagonal = magnitude(_second(parts.r) * _third(parts.r) / parts.k * y[:, 3:] ** 2).sum(axis=1)
            along = magnitude(parts.along * y[:, :3] * y[:, 3:]).sum(axis=1)
            rank_one = magnitude(_square(h) * parts.k.prod(axis=1) * along**2)
            return (diagonal + rank_one) / parts.mean**4

        return value

    gamma, m = r"\boldsymbol{\gamma}", r"\boldsymbol{m}"
    return (
        Invariant(
            "modified_m_gamma",
            "J",
            rf"J({m}\cdot{gamma})",
            "m·γ, modified so that the HK map conserves it",
            m_gamma(np.positive),
            m_gamma(np.abs),
        ),
        Invariant(
            "modified_gamma_sq",
            "G",
            rf"G({gamma}^2)",
            "γ², modified so that the HK map conserves it",
            gamma_sq(np.positive),
            gamma_sq(np.abs),
        ),
    )


def hk_quotient(w1: float, w2: float, w3: float, c1: float, c2: float, c3: float) -> tuple[float, Vector]:
    """Factor 2/Delta and vector whose product is the change in the HK scheme, the solution of M x = 2 u.

    With the products c_i v_j u_k expanded, the numerators are u_i (1 + b_i) + c_i (omega_j u_k + omega_k u_j). The last
    term equals omega_i (b_j + b_k), but the rounding errors of the coefficients of b are the same in every step and
    their effect would accumulate. The denominator is computed first, so that the division overlaps with the rest.
    """
    a1 = (c2 * c3) * w1
    t1 = (2.0 * c1) * w2
    a2 = (c3 * c1) * w2
    a3 = (c1 * c2) * w3
    b2 = a2 * w2
    b3 = a3 * w3
    t1 = t1 * w3
    r = 2.0 / (fma(-a1, t1, fma(-a1, w1, 1.0)) - (b2 + b3))
    b1 = a1 * w1
    u1 = 0.5 * t1
    u2 = c2 * (w3 * w1)
    u3 = c3 * (w1 * w2)
    return r, (
        fma(c1, fma(w2, u3, w3 * u2), fma(b1, u1, u1)),
        fma(c2, fma(w3, u1, w1 * u3), fma(b2, u2, u2)),
        fma(c3, fma(w1, u2, w2 * u1), fma(b3, u3, u3)),
    )


def hk_increment(w1: float, w2: float, w3: float, c1: float, c2: float, c3: float) -> Vector:
    """Change omega' - omega in the HK scheme."""
    r, (n1, n2, n3) = hk_quotient(w1, w2, w3, c1, c2, c3)
    return (r * n1, r * n2, r * n3)


def hk_gamma_increment(
    a1: float, a2: float, a3: float, x1: float, x2: float, x3: float, g1: float, g2: float, g3: float
) -> Vector:
    """Change y = gamma' - gamma in the HK scheme, from the linear system y - y x a = gamma x (2 a + x).

    ``a`` is d omega and ``x`` is d (omega' - omega). With b = gamma x (2 a + x) the solution is
    y = (b + b x a + a (a.b))/(1 + a.a).
    """
    s1 = fma(2.0, a1, x1)
    s2 = fma(2.0, a2, x2)
    s3 = fma(2.0, a3, x3)
    b1 = fma(g2, s3, -(g3 * s2))
    b2 = fma(g3, s1, -(g1 * s3))
    b3 = fma(g1, s2, -(g2 * s1))
    r = 1.0 / (fma(a1, a1, 1.0) + fma(a2, a2, a3 * a3))
    along = a1 * b1 + fma(a2, b2, a3 * b3)
    return (
        r * fma(a1, along, b1 + fma(b2, a3, -(b3 * a2))),
        r * fma(a2, along, b2 + fma(b3, a1, -(b1 * a3))),
        r * fma(a3, along, b3 + fma(b1, a2, -(b2 * a1))),
    )


def hk_step(s: Floats, h: float, p: Floats) -> Floats:
    """HK step of omega, p = (A, B, C, alpha_1, alpha_2, alpha_3); each component is rounded once."""
    w1, w2, w3 = s
    d = 0.5 * h
    r, (n1, n2, n3) = hk_quotient(w1, w2, w3, d * p[3], d * p[4], d * p[5])
    return (fma(r, n1, w1), fma(r, n2, w2), fma(r, n3, w3))


def hk_gamma_step(s: Floats, h: float, p: Floats) -> Floats:
    """HK step of omega and gamma; omega is the same as in ``hk_step``."""
    w1, w2, w3, g1, g2, g3 = s
    d = 0.5 * h
    r, (n1, n2, n3) = hk_quotient(w1, w2, w3, d * p[3], d * p[4], d * p[5])
    f = d * r
    y1, y2, y3 = hk_gamma_increment(d * w1, d * w2, d * w3, f * n1, f * n2, f * n3, g1, g2, g3)
    return (fma(r, n1, w1), fma(r, n2, w2), fma(r, n3, w3), g1 + y1, g2 + y2, g3 + y3)


def euler_determinant(state: Floats, h: float, p: Floats) -> tuple[float, float]:
    """Delta of ``hk_quotient`` and the sum of the magnitudes of its terms."""
    w1, w2, w3 = state[0], state[1], state[2]
    d = 0.5 * h
    c1, c2, c3 = d * p[3], d * p[4], d * p[5]
    a1 = (c2 * c3) * w1
    a2 = (c3 * c1) * w2
    a3 = (c1 * c2) * w3
    b2 = a2 * w2
    b3 = a3 * w3
    t1 = ((2.0 * c1) * w2) * w3
    value = fma(-a1, t1, fma(-a1, w1, 1.0)) - (b2 + b3)
    return (value, (1.0 + abs(a1 * w1)) + ((abs(b2) + abs(b3)) + abs(a1 * t1)))


GAMMA_GROWS = (
    "The conserved m²/K and m·omega/K keep omega bounded. The modified integral that HK conserves in place of "
    "gamma² is a quadratic form in gamma. For short steps the form is positive definite and keeps gamma bounded. If h "
    "is about the time of one revolution of the body, the form may be indefinite, and gamma then grows without bound. "
    "The page What HK conserves with gamma gives the exact condition."
)


def hk_change(w1: float, w2: float, w3: float, d: float, p: Floats) -> Vector:
    """Change of omega in an HK step."""
    return hk_increment(w1, w2, w3, d * p[3], d * p[4], d * p[5])


def omega_change(change: OmegaChange) -> Change:
    """Return the change in a step of omega alone."""

    def changed(s: Floats, h: float, p: Floats) -> Floats:
        w1, w2, w3 = s
        return change(w1, w2, w3, 0.5 * h, p)

    return changed


def hk_gamma_change(s: Floats, h: float, p: Floats) -> Floats:
    """Change of omega and gamma in an HK step."""
    w1, w2, w3, g1, g2, g3 = s
    d = 0.5 * h
    x1, x2, x3 = hk_change(w1, w2, w3, d, p)
    y1, y2, y3 = hk_gamma_increment(d * w1, d * w2, d * w3, d * x1, d * x2, d * x3, g1, g2, g3)
    return (x1, x2, x3, y1, y2, y3)


BI_HAMILTONIAN = "a family of brackets of this map (Petrera, Suris 2010)"


@scheme(
    "hk",
    top=FORMS,
    title="Hirota-Kimura scheme",
    order=2,
    explicit=True,
    self_adjoint=True,
    modified=hk_integrals,
    citation="Kahan 1993; Hirota, Kimura 2000; Petrera, Pfadler, Suris 2011 (integrability); " + CITATION,
    formula=r"""
\frac{\omega_i' - \omega_i}{h} = \frac{\alpha_i}{2}\,(\omega_j'\omega_k + \omega_j\omega_k'), \quad
\alpha_1 = \frac{B - C}{A} \text{ and cyclically}, \qquad
\frac{\gamma' - \gamma}{h} = \tfrac12\,(\gamma\times\omega' + \gamma'\times\omega)
""",
    integrable=lambda top: Integrability(UNKNOWN, BI_HAMILTONIAN if top.form == "euler" else UNKNOWN),
    equations="the first difference equations of section 1.2 of the paper and, for gamma, its (dEulerPoisson) with "
    "the last line corrected",
    options=CompensatedOption,
    limits=lambda top: {"singular-step": SINGULAR} | ({} if len(top.components) == 3 else {"resonance": GAMMA_GROWS}),
)
def build_hk(top: Top, options: CompensatedOption) -> Stepper:
    """In Euler's equations every product y z becomes (y' z + y z')/2; each step solves one linear system.

    A prime marks a value after the step. HK conserves m²/K and m·omega/K, with a function K = 1 + O(h²) of omega and h.
    HK does not conserve m² and m·omega themselves, but their deviations are of size h² and do not grow. If gamma is
    part of the state, HK conserves modified forms of gamma² and m·gamma too.
    """
    d = len(top.components)
    if is_compensated(options):
        made = increment_stepper(omega_change(hk_change) if d == 3 else hk_gamma_change, d, options)
    else:
        made = Stepper(hk_step if d == 3 else hk_gamma_step, d)
    made = with_counter(made, NEAR_SINGULAR, small_determinant(euler_determinant), branch=True)
    return replace(made, tangent=partial(kahan_tangent, top))
