"""The paper's hybrid with xi carried along instead of recomputed: xi = k u, |u| = 1 (``kernels/carried.py``).

What makes it fast: as for the hybrid; u and gamma are brought back to their lengths beside the long chain of
dependencies, and u's turn is the polynomial that the hybrid needs anyway.
"""

from __future__ import annotations

from topcli.contracts import Floats, StepFunction, Stepper, Top
from topcli.kernels.carried import enter_carried, leave_carried, to_length_sq
from topcli.kernels.hk_kowalevski import hk_kowalevski
from topcli.kernels.roots import turn_increment
from topcli.kernels.so3 import cayley_increment
from topcli.schemes.bohlin import ROOTS, BranchOptions, Root
from topcli.schemes.registry import scheme


def hybrid_xi_step(root: Root) -> StepFunction:
    """The step with the square root on the branch that ``root`` chooses by HK's omega."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        w1, w2, w3, g1, g2, g3, u1, u2, k, g_sq = s
        c = p[0]
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
        v1, v2 = root(k * x1 + c * n1, k * x2 + c * n2, q1, q2)
        return (v1, v2, v3, n1, n2, g3 + (d3 + to_g * g3), x1, x2, k, g_sq)

    return step


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
    options=BranchOptions,
)
def build(top: Top, options: BranchOptions) -> Stepper:
    """The paper's hybrid, the same trajectory up to round-off, without round-off's drift of gamma² and k².

    k and gamma² keep the values of the initial state: xi = k u is carried as a unit number u that turns, gamma is kept
    at its length. Like the hybrid it is not self-adjoint, 2l and E drift, and the order falls to 3/2 where
    omega1 + i omega2 passes 0; `midpoint4` and `hk-symproj` keep k² and order 2 there.
    """
    return Stepper(hybrid_xi_step(ROOTS[options.branch]), 10, enter_carried, leave_carried)
