"""Hirota-Kimura (Kahan) step of the Lagrange top, and Bobenko-Suris step in the inertial frame.

HK leads to a 6x6 linear system, solved in closed form. With d = h/2, alpha = (A - C)/A = ``p[0]``, nu = mg z0/A =
``p[1]``, s = omega3, k = alpha s and complex numbers w = omega1 + i omega2, g = gamma1 + i gamma2, the discrete
equations (Sogo, dEulerPoisson with A = B, x0 = y0 = 0, last sign corrected) leave s unchanged and are linear in the
changes X of w, Y of g and y of gamma3:

    X = -i d (k (2 w + X) + nu (2 g + Y))
    Y = -i d s (2 g + Y) + i d (2 gamma3 w + y w + gamma3 X)
    y = d Im(2 conj(g) w + conj(Y) w + conj(g) X)

Write K = d k, S = d s, z = d**2 nu gamma3, D = (1 + iS)(1 + iK) - z. Then

1. the first equation gives X (1 + iK) = -i (2 K w + d nu (2 g + Y));
2. inserted into the second, D Y = P + y Q with P = 2 ((z + S K - i S) g + i d gamma3 w), Q = i d (1 + iK) w;
3. inserted into the third, y (1 - d Im(Q V/D)) = d Im(2 conj(g) w + conj(g) X0 + P V/D), where X = X0 + X1 Y and
   V = conj(g) X1 - conj(w). This is multiplied by |D|**2, so that both divisions are independent, and
   Im(2 conj(g) w + conj(g) X0) = 2 (Im(conj(g) w) - K Re(conj(g) w) - d nu |g|**2)/(1 + K**2).

X and Y are linear in y: their coefficients are computed before y is known, and then one operation remains.

S and K are the same in every step, and so are the rounding errors of expressions in S and K alone; they would grow as N
instead of sqrt(N). Hence S + K is made exact, and 1/(1 + K**2) and S K are used with their rounding errors. The
compiler moves these computations out of the loop.

The Bobenko-Suris step needs one Cayley rotation in closed form and one division; products on the critical path are
fused with the following sum, and every component is old + increment.
"""

from __future__ import annotations

import numpy as np

from topcli.arithmetic.fused import fma, two_prod, two_sum
from topcli.arithmetic.vectors import cayley_rotated
from topcli.contracts import UNKNOWN, Array, Floats, Integrability, Invariant, NoOptions, Stepper, Top
from topcli.schemes.layout import (
    HIROTA_KIMURA,
    LONG_HK,
    NEAR_SINGULAR,
    SINGULAR,
    CompensatedOption,
    is_compensated,
    small_determinant,
    stepper,
    with_counter,
)
from topcli.schemes.registry import scheme
from topcli.tops.lagrange import Lagrange


def pivot(state: Floats, h: float, p: Floats) -> Floats:
    """Divisor in the equation for y, and the intermediate results shared with the rest of the step.

    Returns the divisor, |D|**2, b, S, K, 1/(1 + K**2) and its low part, D1, D2, V1, V2, T1, T2.
    """
    w1, w2, s, g1, g2, g3 = state
    d = 0.5 * h
    f = d * p[1]

    # functions of omega3 only
    K = d * (p[0] * s)
    D2 = d * s + K
    S = D2 - K
    K = D2 - S  # now S + K = D2 exactly
    sk, sk_low = two_prod(S, K)
    kk, kk_low = two_prod(K, K)
    q, q_low = two_sum(1.0, kk)
    rq = 1.0 / q
    one, one_low = two_prod(rq, q)
    rq_low = rq * (((1.0 - one) - one_low) - rq * (q_low + kk_low))
    F = f * rq

    # D and P/2 use the same b, so that D + P/(2 g) = 1 + iK for w = 0; then Q/2 and 2 d V
    b = fma(d * f, g3, sk_low) + sk
    D1 = 1.0 - b
    DD = fma(D1, D1, D2 * D2)
    half = 0.5 * d
    Q1 = -half * fma(K, w1, w2)
    Q2 = half * fma(-K, w2, w1)
    V1 = h * fma(-F, fma(K, g1, g2), -w1)
    V2 = h * fma(F, fma(K, g2, -g1), w2)
    # conj(D) Q/2, then the divisor of y
    T1 = fma(Q1, D1, Q2 * D2)
    T2 = fma(Q2, D1, -(Q1 * D2))
    return (fma(-T1, V2, fma(-T2, V1, DD)), DD, b, S, K, rq, rq_low, D1, D2, V1, V2, T1, T2)


def hk_lagrange_change(state: Floats, h: float, p: Floats) -> Floats:
    """Change of omega and gamma in one HK step; omega3 is constant: x + -0.0 is x, for x = -0.0 too.

    The system is singular only for step sizes far too large to be useful.
    """
    w1, w2, _, g1, g2, g3 = state
    d = 0.5 * h
    f = d * p[1]
    divisor, DD, b, S, K, rq, rq_low, D1, D2, V1, V2, T1, T2 = pivot(state, h, p)
    F = f * rq
    rest = 1.0 / divisor
    r = 2.0 / DD
    e = d * g3
    P1 = fma(b, g1, fma(S, g2, -(e * w2)))
    P2 = fma(b, g2, fma(-S, g1, e * w1))
    # conj(D) P/2
    R1 = fma(P1, D1, P2 * D2)
    R2 = fma(P2, D1, -(P1 * D2))
    turn = fma(-f, fma(g1, g1, g2 * g2), fma(-K, fma(g1, w1, g2 * w2), fma(g1, w2, -(g2 * w1))))
    y = rest * fma(h * fma(rq, turn, rq_low * turn), DD, fma(R2, V1, R1 * V2))
    # X0 = -2i (K w + f g)/(1 + iK) and X1 = -i f/(1 + iK)
    t1 = fma(K, w1, f * g1)
    t2 = fma(K, w2, f * g2)
    X1 = 2.0 * fma(-K, t1, t2)
    X2 = -2.0 * fma(K, t2, t1)
    X1 = fma(rq, X1, rq_low * X1)
    X2 = fma(rq, X2, rq_low * X2)
    # Y = (P + y Q) conj(D)/|D|**2
    R1 = r * R1
    R2 = r * R2
    T1 = r * T1
    T2 = r * T2
    return (
        fma(y, F * fma(-K, T1, T2), fma(F, fma(-K, R1, R2), X1)),
        fma(y, -F * fma(K, T2, T1), fma(-F, fma(K, R2, R1), X2)),
        -0.0,
        fma(y, T1, R1),
        fma(y, T2, R2),
        y,
    )


def lagrange_determinant(state: Floats, h: float, p: Floats) -> tuple[float, float]:
    """Divisor of the step in the equation for the change of gamma3, and the size of its terms."""
    shared = pivot((state[0], state[1], state[2], state[3], state[4], state[5]), h, p)
    value, DD = shared[0], shared[1]
    return (value, DD + abs(DD - value))


def hk_corrections(top: Lagrange, h: float, y: Array) -> tuple[Array, Array, Array]:
    """Differences of the integrals of the HK map from gamma², m·gamma and E at states ``y`` (n, 6): three arrays (n,).

    They are of size h² and follow from the conserved quantities J = (v + K u + K + S)/y, c2 and c0 of Kimura and Hirota
    (2000), rearranged to avoid cancellation for small h or small mu. With d = h/2,
    W = k (omega1, omega2) + nu (gamma1, gamma2), q = nu gamma3 + k s and H = (omega1, omega2).W + (k + s) q,
    c2 + 1 = d^4 y (N + (d H/y)²)/R, N = |W|² + q².
    """
    alpha, nu = top.constants()
    d = 0.5 * h
    w1, w2, s, g1, g2, Z = y.T
    k = alpha * s
    K, S, n = d * k, d * s, d * d * nu
    U, V, G = w1 * w1 + w2 * w2, w1 * g1 + w2 * g2, g1 * g1 + g2 * g2
    wW, gW = k * U + nu * V, k * V + nu * G
    x = nu * Z
    q = x + k * s
    KS, dq = K * S, d * d * q
    Y = dq - 1.0
    H = wW + (k + s) * q
    N = k * wW + nu * gW + q * q
    z, u, v, r = n * Z, d * d * U, d * n * V, n * n * G
    R = (
        Y * r
        + 2.0 * v * (K * z + S * (1.0 + K * K))
        + u * ((K * K - 1.0) * z + (1.0 + K * K) * (1.0 + KS))
        + (z + 1.0 + KS) * (Y * Y + (K + S) ** 2)
    )
    eps = d**4 * Y * (N + (d * H / Y) ** 2) / R
    # linear coefficient of gamma1² + gamma2² as a polynomial in gamma3, in powers of d²
    a4 = gW + Z * (q - k * k)
    a6 = (
        (V + Z * s) * wW
        + (k * k - k * s - 2.0 * x) * gW
        + V * (k * x + s * q)
        + Z * (q * (s * s + k * k - q) - (k * k + k * s - q) ** 2)
    )
    a8 = (
        wW * (k * (nu * G + U * Z + (k - s) * V) + k * Z * (2.0 * (x - k * k) + k * s))
        + (x - k * k) * q * gW
        + k * U * Z * (k * x + s * q)
        + k * s * s * (k * k - q) * V
        + Z * q * q * (q - k * k)
    )
    a10 = -k * (N * (V * q + k * U * Z) + k * k * nu * s * (w1 * g2 - w2 * g1) ** 2)
    a1 = 2.0 * d * d * (a4 + d * d * (a6 + d * d * (a8 + d * d * a10))) / (Y * R)
    gamma_sq = Z * (Z * (K * K * (1.0 - eps) - eps) - a1)
    b1 = 2.0 * K * k * S + d * d * H / Y - 2.0 * k * (1.0 + KS) * eps
    m_gamma = -top.A * Z * (b1 + k * (1.0 - eps) * z)
    energy = 0.5 * top.A * (2.0 * x * (KS * (1.0 - eps) - eps) + (1.0 - eps) * (d * x) ** 2)
    return gamma_sq, m_gamma, energy


def hk_modified(top: Lagrange, h: float, options: CompensatedOption) -> tuple[Invariant, ...]:
    """gamma², m·gamma and E with the corrections of the HK map, which conserves them exactly for this h."""

    def made(index: int, plain: Invariant) -> Invariant:
        return Invariant(
            f"modified_{plain.name}",
            f"{plain.symbol} mod",
            rf"\widetilde{{{plain.tex}}}",
            f"{plain.meaning}, modified: conserved by the HK map",
            lambda y: plain.value(y) + hk_corrections(top, h, y)[index],
            lambda y: plain.scale(y) + np.abs(hk_corrections(top, h, y)[index]),
        )

    return tuple(made(index, plain) for index, plain in enumerate(top.invariants()[:3]))


@scheme(
    "hk",
    top="lagrange",
    title="Hirota-Kimura scheme",
    order=2,
    explicit=True,
    self_adjoint=True,
    conserves=("m_axis",),
    modified=hk_modified,
    citation="Kahan 1993; Kimura, Hirota 2000; Petrera, Pfadler, Suris 2011 (integrability); "
    "Sogo, Discrete Spinning Tops, sections 2.1 and 2.2",
    integrable=Integrability(UNKNOWN, UNKNOWN),
    formula=HIROTA_KIMURA,
    equations="dEulerPoisson, with the last term of its last line corrected to gamma_2^n omega_1^{n+1}",
    options=CompensatedOption,
    limits={"singular-step": SINGULAR, "resonance": LONG_HK},
)
def build_hk(top: Top, options: CompensatedOption) -> Stepper:
    """Linear in the new state, solved in closed form.

    omega3 is conserved bit for bit. gamma², m·gamma and E are not conserved, but each differs by O(h²) from a modified
    integral, which the map conserves exactly for every h. The map is integrable.
    """
    lost = (0, 1, 3, 4, 5) if is_compensated(options) else ()
    made = stepper(hk_lagrange_change, 6, lost=lost, checked=6)
    return with_counter(made, NEAR_SINGULAR, small_determinant(lagrange_determinant))


def bs_step(state: Floats, h: float, p: Floats) -> Floats:
    """Step m' - m = h p x a, then a' - a = h/2 m' x (a' + a): Sogo's (L1), (L2)."""
    m1, m2, m3, a1, a2, a3 = state
    d = -0.5 * h
    n1 = fma(-h, a2, m1)
    n2 = fma(h, a1, m2)
    # fma(-h d, a2, d m1) in place of d n1 would shorten the critical path, but h d is rounded, and m.a would drift
    b1, b2, b3 = cayley_rotated(d * n1, d * n2, d * m3, a1, a2, a3)
    return (n1, n2, m3, b1, b2, b3)


def bs_modified(top: Top, h: float, options: NoOptions) -> tuple[Invariant, ...]:
    """Modified energy m²/2 + a·p + h/2 (a x m)·p, conserved by the BS map (Sogo, section 2.3, law 4)."""
    plain = top.invariants()[3]

    def value(y: Array) -> Array:
        return plain.value(y) + 0.5 * h * (y[:, 3] * y[:, 1] - y[:, 4] * y[:, 0])

    def scale(y: Array) -> Array:
        return plain.scale(y) + np.abs(0.5 * h) * (np.abs(y[:, 3] * y[:, 1]) + np.abs(y[:, 4] * y[:, 0]))

    meaning = "energy plus h/2 (a×m)·p, conserved by the BS map"
    return (Invariant("modified_energy", "E mod", r"\widetilde{E}", meaning, value, scale),)


@scheme(
    "bs",
    top="lagrange/inertial",
    title="Bobenko-Suris scheme",
    order=1,
    explicit=True,
    self_adjoint=False,
    conserves=("a_sq", "m_p", "m_a"),
    modified=bs_modified,
    citation="Bobenko, Suris 1999; Sogo, Discrete Spinning Tops, section 2.3",
    formula=r"m' - m = h\,p\times a, \qquad a' - a = h\,m'\times\bar a",
    equations="L1, L2",
    integrable=Integrability("yes (Bobenko, Suris 1999)", "Lie-Poisson bracket of e(3)", "lie-poisson"),
)
def build_bs(top: Top, options: NoOptions) -> Stepper:
    """Two explicit substeps: m from the old axis, then a Cayley rotation of the axis about the new m.

    a², m·p, m·a and a modified energy, which differs from E by a term of size h, are conserved exactly. The map is
    integrable: although it is of order 1 and not self-adjoint, no integral drifts.
    """
    return Stepper(bs_step, 6)
