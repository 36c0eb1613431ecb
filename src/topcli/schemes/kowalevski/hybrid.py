"""The paper's hybrid of HK, the modified BS scheme and Bohlin's method (Sogo, section 3.2.3).

What makes it fast:
- of the HK step only omega is needed, and once it is inlined the compiler drops the rest;
- Cayley's rotation, xi's turn and the square root are algebraic: no angle is ever formed, libm is not called;
- each is an increment or has its division off the longest chain of dependencies, and the two rotations overlap.
"""

from __future__ import annotations

from topcli.arithmetic.complex_plane import turn_increment
from topcli.arithmetic.fused import fma
from topcli.arithmetic.rotations import cayley_added
from topcli.contracts import Floats, StepFunction, Stepper, Top
from topcli.schemes.counting import AMBIGUOUS, NEAR_SINGULAR, counting, small_determinant, two_roots
from topcli.schemes.kowalevski.bohlin import ROOTS, BranchOptions, Root
from topcli.schemes.kowalevski.hk import hk_kowalevski, kowalevski_determinant
from topcli.schemes.limits import OVERFLOW, SINGULAR
from topcli.schemes.registry import scheme


def hybrid_step(root: Root) -> StepFunction:
    """The step with the square root on the branch that ``root`` chooses by HK's omega."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        w1, w2, w3, g1, g2, g3 = s
        q1, q2, v3, _, _, _ = hk_kowalevski(s, h, p)
        k = 0.25 * h
        n1, n2, n3 = cayley_added(k * (q1 + w1), k * (q2 + w2), k * (v3 + w3), g1, g2, g3)
        half = 0.5 * p[0]  # of xi, half is turned
        x = 0.5 * ((w1 - w2) * (w1 + w2)) - half * g1
        y = w1 * w2 - half * g2
        dx, dy = turn_increment((0.5 * h) * (v3 + w3), x, y)
        v1, v2 = root(fma(half, n1, x + dx), fma(half, n2, y + dy), q1, q2)
        return (v1, v2, v3, n1, n2, n3)

    return step


def hk_prediction(s: Floats, h: float, p: Floats) -> tuple[float, float]:
    """HK's omega1, omega2, by which the root is chosen."""
    q1, q2, _, _, _, _ = hk_kowalevski((s[0], s[1], s[2], s[3], s[4], s[5]), h, p)
    return (q1, q2)


def with_hk_counted(stepper: Stepper) -> Stepper:
    """``stepper`` with counters of the steps in which HK's solve was near singular or the roots hardly told apart."""
    counted = counting(stepper, NEAR_SINGULAR, small_determinant(kowalevski_determinant))
    return counting(counted, AMBIGUOUS, two_roots(hk_prediction))


@scheme(
    "hybrid",
    top="kowalevski",
    title="Hybrid of HK and Bohlin's method",
    order=2,
    explicit=True,
    self_adjoint=False,
    conserves=("gamma_sq", "k_sq"),
    citation="Sogo, Discrete Spinning Tops, section 3.2.3",
    equations="dEulerPoisson, modified BS scheme, Kxi",
    limits={"singular-step": SINGULAR, "huge": OVERFLOW},
    options=BranchOptions,
)
def build(top: Top, options: BranchOptions) -> Stepper:
    """HK once, then gamma again by Cayley's rotation with the mean omega, then omega1 + i omega2 by Bohlin's method.

    omega3 is HK's. |gamma| and k = |omega² - c gamma| are conserved. The step is not self-adjoint, against what the
    paper says: a step forward and back misses by O(h⁴), and 2l and E drift. Where omega1 + i omega2 passes 0 the
    square root is singular and the order falls to 3/2; `midpoint4` and `hk-symproj` keep k² and order 2 there.
    """
    return with_hk_counted(Stepper(hybrid_step(ROOTS[options.branch]), 6))
