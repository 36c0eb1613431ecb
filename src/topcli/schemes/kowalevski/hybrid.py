"""Hybrid of HK, the modified BS scheme and Bohlin's method (Sogo, section 3.2.3).

Performance:
- only omega of the HK step is needed; once the step is inlined, the compiler removes the rest;
- the Cayley rotation, the rotation of xi and the square root need no angle and no call of libm;
- divisions are off the critical path, and the two rotations overlap.
"""

from __future__ import annotations

from topcli.arithmetic.complex_plane import rotation_increment
from topcli.arithmetic.fused import fma
from topcli.arithmetic.rotations import cayley_rotated
from topcli.contracts import Floats, StepFunction, Stepper, Top
from topcli.schemes.counting import AMBIGUOUS, NEAR_SINGULAR, ambiguous_root, small_determinant, with_counter
from topcli.schemes.formulas import HYBRID, XI
from topcli.schemes.kowalevski.bohlin import ROOTS, BranchOptions, Root
from topcli.schemes.kowalevski.hk import hk_kowalevski, kowalevski_determinant
from topcli.schemes.limits import OVERFLOW, SINGULAR
from topcli.schemes.registry import scheme


def hybrid_step(root: Root) -> StepFunction:
    """Return the step whose square root is on the branch selected by ``root`` from HK's omega."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        w1, w2, w3, g1, g2, g3 = s
        q1, q2, v3, _, _, _ = hk_kowalevski(s, h, p)
        k = 0.25 * h
        n1, n2, n3 = cayley_rotated(k * (q1 + w1), k * (q2 + w2), k * (v3 + w3), g1, g2, g3)
        half = 0.5 * p[0]  # half of xi is rotated
        x = 0.5 * ((w1 - w2) * (w1 + w2)) - half * g1
        y = w1 * w2 - half * g2
        dx, dy = rotation_increment((0.5 * h) * (v3 + w3), x, y)
        v1, v2 = root(fma(half, n1, x + dx), fma(half, n2, y + dy), q1, q2)
        return (v1, v2, v3, n1, n2, n3)

    return step


def hk_prediction(s: Floats, h: float, p: Floats) -> tuple[float, float]:
    """Prediction of omega1, omega2 by HK, which selects the root."""
    q1, q2, _, _, _, _ = hk_kowalevski((s[0], s[1], s[2], s[3], s[4], s[5]), h, p)
    return (q1, q2)


def with_hk_counters(stepper: Stepper) -> Stepper:
    """Add counters of the steps with a nearly singular HK system and of those with an ambiguous root to ``stepper``."""
    counted = with_counter(stepper, NEAR_SINGULAR, small_determinant(kowalevski_determinant))
    return with_counter(counted, AMBIGUOUS, ambiguous_root(hk_prediction))


@scheme(
    "hybrid",
    top="kowalevski",
    title="Hybrid of HK and Bohlin's method",
    order=2,
    explicit=True,
    self_adjoint=False,
    conserves=("gamma_sq", "k_sq"),
    citation="Sogo, Discrete Spinning Tops, section 3.2.3",
    formula=HYBRID + "\n" + XI,
    equations="dEulerPoisson, modified BS scheme, Kxi",
    limits={"singular-step": SINGULAR, "huge": OVERFLOW},
    options=BranchOptions,
)
def build(top: Top, options: BranchOptions) -> Stepper:
    """omega3 by HK, gamma by a Cayley rotation with the mean omega of HK, omega1 + i omega2 by Bohlin's method.

    |gamma| and k = |omega² - c gamma| are conserved. Contrary to the paper, the step is not self-adjoint: a step
    forward and back has an error of O(h⁴), and 2l and E drift. Where omega1 + i omega2 passes 0 the square root is
    singular and the order is reduced to 3/2; `midpoint4` and `hk-symproj` conserve k² and have order 2 there.
    """
    return with_hk_counters(Stepper(hybrid_step(ROOTS[options.branch]), 6))
