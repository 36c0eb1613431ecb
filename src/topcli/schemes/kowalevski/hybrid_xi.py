"""Hybrid of the paper with xi as a carried quantity: xi = k u, |u| = 1 (``carried_xi``).

Performance: as for the hybrid. The renormalization of u and gamma is off the critical path, and the rotation of u needs
the same polynomials as the rotation of xi in the hybrid.
"""

from __future__ import annotations

from topcli.arithmetic.complex_plane import rotation_increment
from topcli.arithmetic.fused import fma
from topcli.arithmetic.increments import compensated_sum, first6
from topcli.arithmetic.rotations import cayley_increment
from topcli.contracts import Floats, StepFunction, Stepper, Top
from topcli.schemes.compensated import CompensatedOption
from topcli.schemes.formulas import HYBRID
from topcli.schemes.kowalevski.bohlin import ROOTS, BranchOptions, Root
from topcli.schemes.kowalevski.carried_xi import enter_carried, length_correction
from topcli.schemes.kowalevski.hk import hk_kowalevski, hk_kowalevski_change
from topcli.schemes.kowalevski.hybrid import with_hk_counters
from topcli.schemes.limits import OVERFLOW, SINGULAR
from topcli.schemes.registry import scheme


def hybrid_xi_step(root: Root) -> StepFunction:
    """Return the step whose square root is on the branch selected by ``root`` from HK's omega."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        w1, w2, w3, g1, g2, g3, u1, u2, k, g_sq = s
        half_c, half_k = 0.5 * p[0], 0.5 * k
        q1, q2, v3, _, _, _ = hk_kowalevski((w1, w2, w3, g1, g2, g3), h, p)
        m = 0.25 * h
        d1, d2, d3 = cayley_increment(m * (q1 + w1), m * (q2 + w2), m * (v3 + w3), g1, g2, g3)
        to_g = length_correction(g1 * g1 + (g2 * g2 + g3 * g3), g_sq)
        t1, t2 = rotation_increment((0.5 * h) * (v3 + w3), u1, u2)
        to_u = length_correction(u1 * u1 + u2 * u2, 1.0)
        n1 = g1 + (d1 + to_g * g1)
        n2 = g2 + (d2 + to_g * g2)
        x1 = u1 + (t1 + to_u * u1)
        x2 = u2 + (t2 + to_u * u2)
        v1, v2 = root(fma(half_c, n1, half_k * x1), fma(half_c, n2, half_k * x2), q1, q2)
        return (v1, v2, v3, n1, n2, g3 + (d3 + to_g * g3), x1, x2, k, g_sq)

    return step


def compensated_step(root: Root) -> StepFunction:
    """Return the compensated step, with the rounding errors of omega3, gamma and u; omega1, omega2 are not sums."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        w1, w2, w3, g1, g2, g3, u1, u2, k, g_sq, e3, e4, e5, e6, e7, e8 = s
        half_c, half_k = 0.5 * p[0], 0.5 * k
        x1, x2, x3, _, _, _ = hk_kowalevski_change((w1, w2, w3, g1, g2, g3), h, p)
        m = 0.25 * h
        o3 = 2.0 * w3 + x3
        d1, d2, d3 = cayley_increment(m * (2.0 * w1 + x1), m * (2.0 * w2 + x2), m * o3, g1, g2, g3)
        to_g = length_correction(g1 * g1 + (g2 * g2 + g3 * g3), g_sq)
        t1, t2 = rotation_increment((0.5 * h) * o3, u1, u2)
        to_u = length_correction(u1 * u1 + u2 * u2, 1.0)
        q1, q2 = w1 + x1, w2 + x2
        w3, e3 = compensated_sum(w3, e3, x3)
        g1, e4 = compensated_sum(g1, e4, d1 + to_g * g1)
        g2, e5 = compensated_sum(g2, e5, d2 + to_g * g2)
        g3, e6 = compensated_sum(g3, e6, d3 + to_g * g3)
        u1, e7 = compensated_sum(u1, e7, t1 + to_u * u1)
        u2, e8 = compensated_sum(u2, e8, t2 + to_u * u2)
        w1, w2 = root(fma(half_c, g1, half_k * u1), fma(half_c, g2, half_k * u2), q1, q2)
        return (w1, w2, w3, g1, g2, g3, u1, u2, k, g_sq, e3, e4, e5, e6, e7, e8)

    return step


def enter_compensated(y: Floats, h: float, p: Floats) -> Floats:
    """Working state of the compensated step: physical state, carried quantities, compensation terms."""
    return (*enter_carried(y, h, p), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class HybridOptions(BranchOptions, CompensatedOption):
    """Options: branch of the root, compensated sums."""


@scheme(
    "hybrid-xi",
    top="kowalevski",
    title="Hybrid of HK and Bohlin's method with carried xi",
    order=2,
    explicit=True,
    self_adjoint=False,
    conserves=("gamma_sq", "k_sq"),
    citation="Sogo, Discrete Spinning Tops, section 3.2.3",
    formula=HYBRID + "\n" + r"\xi = k\,e^{i\theta}, \qquad \theta' = \theta - h\,\bar\omega_3",
    equations="dEulerPoisson, modified BS scheme, Kxi",
    limits={
        "singular-step": SINGULAR,
        "resonance": "u and gamma are renormalized along their old directions: if they rotate by more than a right "
        "angle in one step, this increases the deviation of the lengths, and gamma² grows.",
        "huge": OVERFLOW,
    },
    options=HybridOptions,
)
def build(top: Top, options: HybridOptions) -> Stepper:
    """The hybrid of the paper without the drift of gamma² and k² by round-off; the same trajectory up to round-off.

    k and gamma² keep their initial values: of xi = k u only u with |u| = 1 is rotated, and the length of gamma is
    renormalized. Like the hybrid it is not self-adjoint, 2l and E drift, and the order is reduced to 3/2 where
    omega1 + i omega2 passes 0; `midpoint4` and `hk-symproj` conserve k² and have order 2 there.
    """
    if options.compensated:
        step = compensated_step(ROOTS[options.branch])
        return with_hk_counters(Stepper(step, 16, enter_compensated, first6, checked=6))
    step = hybrid_xi_step(ROOTS[options.branch])
    return with_hk_counters(Stepper(step, 10, enter_carried, first6, checked=6))
