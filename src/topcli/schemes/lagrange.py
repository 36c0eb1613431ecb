"""The Lagrange top's own schemes: Hirota-Kimura in the body frame, Bobenko-Suris in the inertial frame.

What makes them fast:
- HK: the 6x6 system shrinks in closed form to one real equation, in whose root all changes are linear; two divisions
  run at the same time, and what depends on omega3 alone, which never changes, is computed once;
- BS: one Cayley rotation in closed form, one division, each product that another waits for fused with the sum after it;
- every component is old + increment.
"""

from __future__ import annotations

import numpy as np

from topcli.contracts import Array, Floats, Invariant, NoOptions, Sampler, Stepper, Top
from topcli.kernels.fused import fma
from topcli.kernels.hk_determinant import lagrange_determinant
from topcli.kernels.hk_lagrange import enter_compensated, hk_lagrange, hk_lagrange_compensated
from topcli.kernels.increments import first6
from topcli.kernels.so3 import cayley_added
from topcli.schemes.compensated import CompensatedOption, compensation_wanted
from topcli.schemes.counting import NEAR_SINGULAR, counting, small_determinant
from topcli.schemes.limits import LONG_HK, SINGULAR
from topcli.schemes.registry import scheme
from topcli.tops.lagrange import Lagrange
from topcli.tops.lagrange_exact import body_states, inertial_states


def hk_corrections(top: Lagrange, h: float, y: Array) -> tuple[Array, Array, Array]:
    """What HK's own integrals add to gamma², m·gamma and E at states ``y`` (n, 6): three arrays (n,), of size h².

    They follow from the conserved J = (v + K u + K + S)/y, c2 and c0 of Kimura and Hirota (2000) with all that
    cancels for small h or small mu taken out by hand: with d = h/2, W = k (omega1, omega2) + nu (gamma1, gamma2),
    q = nu gamma3 + k s and H = (omega1, omega2).W + (k + s) q, c2 + 1 = d^4 y (N + (d H/y)²)/R, N = |W|² + q².
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
    # the linear coefficient of gamma1² + gamma2² as a polynomial in gamma3, by powers of d²
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
    """gamma², m·gamma and E with HK's own corrections, conserved exactly by the map at this h."""

    def made(index: int, plain: Invariant) -> Invariant:
        return Invariant(
            f"modified_{plain.name}",
            f"{plain.symbol} mod",
            rf"\widetilde{{{plain.tex}}}",
            f"{plain.meaning}, as the HK map conserves it",
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
    citation="Kimura, Hirota 2000; Sogo, Discrete Spinning Tops, sections 2.1 and 2.2",
    equations="dEulerPoisson, with the last term of its last line corrected to gamma_2^n omega_1^{n+1}",
    options=CompensatedOption,
    limits={"singular-step": SINGULAR, "resonance": LONG_HK},
)
def build_hk(top: Top, options: CompensatedOption) -> Stepper:
    """Linear in the new state, solved in closed form.

    omega3 is conserved bit for bit. gamma², m·gamma and E are not, but each is by O(h²) from an integral of the map
    itself: the modified integrals, exact at every h. The map is integrable.
    """
    made = Stepper(hk_lagrange, 6)
    if compensation_wanted(options):
        made = Stepper(hk_lagrange_compensated, 11, enter_compensated, first6, checked=6)
    return counting(made, NEAR_SINGULAR, small_determinant(lagrange_determinant))


def bs_step(state: Floats, h: float, p: Floats) -> Floats:
    """m' - m = h p x a, then a' - a = h/2 m' x (a' + a): Sogo's (L1), (L2)."""
    m1, m2, m3, a1, a2, a3 = state
    d = -0.5 * h
    n1 = fma(-h, a2, m1)
    n2 = fma(h, a1, m2)
    # d n1 as fma(-h d, a2, d m1) would be ready sooner, but h d is rounded, and m.a would drift
    b1, b2, b3 = cayley_added(d * n1, d * n2, d * m3, a1, a2, a3)
    return (n1, n2, m3, b1, b2, b3)


def bs_modified(top: Top, h: float, options: NoOptions) -> tuple[Invariant, ...]:
    """The energy m²/2 + a·p + h/2 (a x m)·p, which the BS map conserves (Sogo, section 2.3, law 4)."""
    plain = top.invariants()[3]

    def value(y: Array) -> Array:
        return plain.value(y) + 0.5 * h * (y[:, 3] * y[:, 1] - y[:, 4] * y[:, 0])

    def scale(y: Array) -> Array:
        return plain.scale(y) + np.abs(0.5 * h) * (np.abs(y[:, 3] * y[:, 1]) + np.abs(y[:, 4] * y[:, 0]))

    meaning = "energy with the term h/2 (a×m)·p, as the BS map conserves it"
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
    equations="L1, L2",
)
def build_bs(top: Top, options: NoOptions) -> Stepper:
    """Two explicit steps: m by the old axis, then the axis turned by Cayley's rotation about the new m.

    a², m·p and m·a are conserved exactly, and so is an energy with a term of size h. The map is integrable; it is
    of order 1 and not self-adjoint, and yet no quantity drifts.
    """
    return Stepper(bs_step, 6)


@scheme(
    "exact",
    top="lagrange",
    title="closed form by elliptic functions",
    order=None,
    explicit=True,
    self_adjoint=True,
    conserves=("gamma_sq", "m_gamma", "energy", "m_axis"),
    citation="Lagrange 1788; Jacobi; Whittaker, Analytical Dynamics, section 71",
    equations="(Euler), (Poisson) with A = B, x0 = y0 = 0",
    limits={
        "sleeping-threshold": "Asymptotic to the upright top, or within 1e-6 of it at the edge of stability, the "
        "period is infinite or too long to resolve; such motions are refused.",
    },
)
def build_exact(top: Top, options: NoOptions) -> Sampler:
    """gamma3 by Jacobi functions, the angle by the Fourier series of its rate; to round-off at any time.

    Motions asymptotic to the upright top have no period and are refused, and so are almost planar ones.
    """
    return Sampler(body_states)


@scheme(
    "exact",
    top="lagrange/inertial",
    title="closed form by elliptic functions",
    order=None,
    explicit=True,
    self_adjoint=True,
    conserves=("a_sq", "m_p", "m_a", "energy"),
    citation="Lagrange 1788; Jacobi; Whittaker, Analytical Dynamics, section 71",
    equations="m' = p x a, a' = m x a",
)
def build_exact_inertial(top: Top, options: NoOptions) -> Sampler:
    """a.p by Jacobi functions, the precession by the Fourier series of its rate; to round-off at any time.

    Motions asymptotic to the upright top have no period and are refused, and so are almost planar ones.
    """
    return Sampler(inertial_states)
