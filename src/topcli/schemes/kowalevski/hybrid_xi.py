"""The paper's hybrid with xi carried along instead of recomputed: xi = k u, |u| = 1 (``carried_xi``).

What makes it fast: as for the hybrid; u and gamma are brought back to their lengths beside the long chain of
dependencies, and u's turn is the polynomial that the hybrid needs anyway.
"""

from __future__ import annotations

from topcli.arithmetic.complex_plane import turn_increment
from topcli.arithmetic.fused import fma
from topcli.arithmetic.increments import carried_sum
from topcli.arithmetic.rotations import cayley_increment
from topcli.contracts import Floats, StepFunction, Stepper, Top
from topcli.schemes.compensated import CompensatedOption
from topcli.schemes.kowalevski.bohlin import ROOTS, BranchOptions, Root
from topcli.schemes.kowalevski.carried_xi import enter_carried, leave_carried, to_length_sq
from topcli.schemes.kowalevski.hk import hk_kowalevski, hk_kowalevski_change
from topcli.schemes.kowalevski.hybrid import with_hk_counted
from topcli.schemes.limits import OVERFLOW, SINGULAR
from topcli.schemes.registry import scheme


def hybrid_xi_step(root: Root) -> StepFunction:
    """The step with the square root on the branch that ``root`` chooses by HK's omega."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        w1, w2, w3, g1, g2, g3, u1, u2, k, g_sq = s
        half_c, half_k = 0.5 * p[0], 0.5 * k
        q1, q2, v3, _, _, _ = hk_kowalevski((w1, w2, w3, g1, g2, g3), h, p)
        m = 0.25 * h
        d1, d2, d3 = cayley_increment(m * (q1 + w1), m * (q2 + w2), m * (v3 + w3), g1, g2, g3)
        to_g = to_length_sq(g1 * g1 + (g2 * g2 + g3 * g3), g_sq)
        t1, t2 = turn_increment((0.5 * h) * (v3 + w3), u1, u2)
        to_u = to_length_sq(u1 * u1 + u2 * u2, 1.0)
        n1 = g1 + (d1 + to_g * g1)
        n2 = g2 + (d2 + to_g * g2)
        x1 = u1 + (t1 + to_u * u1)
        x2 = u2 + (t2 + to_u * u2)
        v1, v2 = root(fma(half_c, n1, half_k * x1), fma(half_c, n2, half_k * x2), q1, q2)
        return (v1, v2, v3, n1, n2, g3 + (d3 + to_g * g3), x1, x2, k, g_sq)

    return step


def compensated_step(root: Root) -> StepFunction:
    """The same with what the sums of omega3, gamma and u have lost; omega1 and omega2 are no sums but a root."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        w1, w2, w3, g1, g2, g3, u1, u2, k, g_sq, e3, e4, e5, e6, e7, e8 = s
        half_c, half_k = 0.5 * p[0], 0.5 * k
        x1, x2, x3, _, _, _ = hk_kowalevski_change((w1, w2, w3, g1, g2, g3), h, p)
        m = 0.25 * h
        o3 = 2.0 * w3 + x3
        d1, d2, d3 = cayley_increment(m * (2.0 * w1 + x1), m * (2.0 * w2 + x2), m * o3, g1, g2, g3)
        to_g = to_length_sq(g1 * g1 + (g2 * g2 + g3 * g3), g_sq)
        t1, t2 = turn_increment((0.5 * h) * o3, u1, u2)
        to_u = to_length_sq(u1 * u1 + u2 * u2, 1.0)
        q1, q2 = w1 + x1, w2 + x2
        w3, e3 = carried_sum(w3, e3, x3)
        g1, e4 = carried_sum(g1, e4, d1 + to_g * g1)
        g2, e5 = carried_sum(g2, e5, d2 + to_g * g2)
        g3, e6 = carried_sum(g3, e6, d3 + to_g * g3)
        u1, e7 = carried_sum(u1, e7, t1 + to_u * u1)
        u2, e8 = carried_sum(u2, e8, t2 + to_u * u2)
        w1, w2 = root(fma(half_c, g1, half_k * u1), fma(half_c, g2, half_k * u2), q1, q2)
        return (w1, w2, w3, g1, g2, g3, u1, u2, k, g_sq, e3, e4, e5, e6, e7, e8)

    return step


def enter_compensated(y: Floats, h: float, p: Floats) -> Floats:
    """The physical state with what is carried; nothing lost yet."""
    return (*enter_carried(y, h, p), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class HybridOptions(BranchOptions, CompensatedOption):
    """The branch of the root, and the compensation."""


@scheme(
    "hybrid-xi",
    top="kowalevski",
    title="Hybrid of HK and Bohlin's method with carried xi",
    order=2,
    explicit=True,
    self_adjoint=False,
    conserves=("gamma_sq", "k_sq"),
    citation="Sogo, Discrete Spinning Tops, section 3.2.3",
    equations="dEulerPoisson, modified BS scheme, Kxi",
    limits={
        "singular-step": SINGULAR,
        "resonance": "What brings u and gamma back to their lengths is added along the old directions: where they "
        "turn by more than a right angle in one step it drives the lengths away instead, and gamma² grows.",
        "huge": OVERFLOW,
    },
    options=HybridOptions,
)
def build(top: Top, options: HybridOptions) -> Stepper:
    """The paper's hybrid, the same trajectory up to round-off, without round-off's drift of gamma² and k².

    k and gamma² keep the values of the initial state: xi = k u is carried as a unit number u that turns, gamma is kept
    at its length. Like the hybrid it is not self-adjoint, 2l and E drift, and the order falls to 3/2 where
    omega1 + i omega2 passes 0; `midpoint4` and `hk-symproj` keep k² and order 2 there.
    """
    if options.compensated:
        step = compensated_step(ROOTS[options.branch])
        return with_hk_counted(Stepper(step, 16, enter_compensated, leave_carried, checked=6))
    step = hybrid_xi_step(ROOTS[options.branch])
    return with_hk_counted(Stepper(step, 10, enter_carried, leave_carried, checked=6))
