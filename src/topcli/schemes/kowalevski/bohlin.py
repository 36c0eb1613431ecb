"""Bohlin's method with gamma by Method A, B or C (Sogo, section 3.2.2) for the Kowalevski top.

What makes it fast:
- omega1 and omega2 are known last, a square root: all that the old gamma and omega3 say alone is ready by then;
- gamma' gives the angle at once, not by way of omega3'; small angles take polynomials, whose sums are fused, no libm;
- the square root is algebraic, with its division and the choice of its sign beside the square root, not after it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from topcli.arithmetic.complex_plane import root_nearest, root_sign, turn_added
from topcli.arithmetic.fused import fma
from topcli.arithmetic.rotations import cayley_added, rodrigues_increment
from topcli.contracts import Floats, StepFunction, Stepper, Top
from topcli.schemes.counting import AMBIGUOUS, counting, two_roots
from topcli.schemes.limits import OVERFLOW
from topcli.schemes.registry import scheme

CITATION = "Sogo, Discrete Spinning Tops, section 3.2.2"
CONSERVES = ("gamma_sq", "k_sq")
LIMITS = {
    "homoclinic-spacing": "Of order 1 near a separatrix: its error acts as a larger distance from the homoclinic "
    "orbit, and the swings follow each other after 15.3 instead of 28.17 (the paper's Figure 2).",
    "rest-on-axis": "Rest with gamma along the third axis, where xi = 0, is a fixed point of the map: it never moves, "
    "and counts an ambiguous root in every step.",
    "huge": OVERFLOW,
}
SWITCH_BELOW = -0.8
"""Method B leaves the paper's chart where gamma3 is below this, |z| > 3 (the other chart then has |z| < 1/3).

Not at the equator, because Euler's rule on the other chart is another scheme of order 1: so late a switch leaves
the paper's own scene, where gamma3 >= -0.663, to the paper's own chart.
"""
Root = Callable[[float, float, float, float], tuple[float, float]]
Method = Callable[[float, float, float, float, float, float, float], tuple[float, float, float]]
ROOTS: dict[str, Root] = {"nearest": root_nearest, "sign": root_sign}


class BranchOptions(BaseModel):
    """Which of the two square roots becomes omega1 + i omega2."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    branch: Literal["nearest", "sign"] = Field(
        default="nearest",
        description="the root nearest to the prediction, or the one whose argument has its sign (the paper)",
    )


class ChartOptions(BranchOptions):
    """Options of Method B: the branch, and the chart of the sphere."""

    chart: Literal["switch", "single"] = Field(
        default="switch",
        description="go to the other pole's coordinate near gamma3 = -1, or keep the paper's, which fails there",
    )


def method_a(w1: float, w2: float, w3: float, g1: float, g2: float, g3: float, h: float) -> tuple[float, float, float]:
    """Gamma by Method A, the BS scheme: gamma' - gamma = h/2 (gamma' + gamma) x omega."""
    d = 0.5 * h
    return cayley_added(d * w1, d * w2, d * w3, g1, g2, g3)


def _euler_on_chart(
    side: float, w1: float, w2: float, w3: float, g1: float, g2: float, g3: float, h: float
) -> tuple[float, float, float]:
    """Euler's rule for z = (gamma1 + i gamma2)/(1 + side gamma3), and gamma from the new z.

    dz/dt = i/2 (side omega - 2 omega3 z - side conj(omega) z**2) with side = 1 is the paper's equation; the
    other pole's chart is its mirror image gamma3 -> -gamma3, (omega1, omega2) -> -(omega1, omega2). What gamma and
    omega3 say alone is known long before omega1 and omega2, which are a square root.
    """
    r = 1.0 / fma(side, g3, 1.0)
    x = g1 * r
    y = g2 * r
    d = side * (0.5 * h)
    xx = x * x - y * y
    xy = d * (2.0 * x * y)
    turn = h * w3
    x, y = (
        fma(-w2, fma(d, xx, d), fma(w1, xy, fma(turn, y, x))),
        fma(w1, fma(-d, xx, d), fma(-w2, xy, fma(-turn, x, y))),
    )
    n = 2.0 / (fma(x, x, 1.0) + y * y)
    return (x * n, y * n, (0.5 * side) * n * (1.0 - fma(x, x, y * y)))


def method_b_single(
    w1: float, w2: float, w3: float, g1: float, g2: float, g3: float, h: float
) -> tuple[float, float, float]:
    """Gamma by Method B on the paper's one chart, which has no point for gamma3 = -1."""
    return _euler_on_chart(1.0, w1, w2, w3, g1, g2, g3, h)


def method_b_switch(
    w1: float, w2: float, w3: float, g1: float, g2: float, g3: float, h: float
) -> tuple[float, float, float]:
    """Gamma by Method B on the paper's chart, or the other pole's near its missing point: |z| <= 3 before a step."""
    return _euler_on_chart(-1.0 if g3 < SWITCH_BELOW else 1.0, w1, w2, w3, g1, g2, g3, h)


def method_c(w1: float, w2: float, w3: float, g1: float, g2: float, g3: float, h: float) -> tuple[float, float, float]:
    """Gamma by Method C, the rotation by the angle h |omega| about omega; the identity at omega = 0."""
    d1, d2, d3 = rodrigues_increment(h * w1, h * w2, h * w3, g1, g2, g3)
    return (g1 + d1, g2 + d2, g3 + d3)


def bohlin_step(method: Method, root: Root) -> StepFunction:
    """The step in three parts, gamma by ``method``, omega3, omega1 + i omega2 by ``root`` (section 3.2.2)."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        w1, w2, w3, g1, g2, g3 = s
        half = 0.5 * p[0]
        f = h * half
        n1, n2, n3 = method(w1, w2, w3, g1, g2, g3, h)
        # half of xi, then of what is put in front of e^{-i chi} - 1
        x = 0.5 * ((w1 - w2) * (w1 + w2)) - half * g1
        y = w1 * w2 - half * g2
        chi = fma(-(0.5 * h * f), n2, fma(-(0.5 * h * f), g2, h * w3))  # h/2 (v3 + w3), without waiting for v3
        z1, z2 = turn_added(chi, x, y, fma(half, n1, x), fma(half, n2, y))
        q1, q2 = direct(s, h, p)
        v1, v2 = root(z1, z2, q1, q2)
        return (v1, v2, fma(-f, n2 + g2, w3), n1, n2, n3)

    return step


def direct(s: Floats, h: float, p: Floats) -> tuple[float, float]:
    """Euler's rule for omega1, omega2, by which the root is chosen (direct)."""
    d = 0.5 * h
    return (s[0] + d * (s[2] * s[1]), s[1] - d * (s[2] * s[0] - p[0] * s[5]))


def with_roots_counted(stepper: Stepper) -> Stepper:
    """``stepper`` with a counter of the steps in which the two roots were hardly told apart."""
    return counting(stepper, AMBIGUOUS, two_roots(direct))


def counting_step(step: StepFunction) -> StepFunction:
    """``step`` with a seventh slot that counts the changes of the chart, in either direction."""

    def counted(s: Floats, h: float, p: Floats) -> Floats:
        w1, w2, w3, g1, g2, g3, count = s
        v1, v2, v3, n1, n2, n3 = step((w1, w2, w3, g1, g2, g3), h, p)
        if (n3 < SWITCH_BELOW) != (g3 < SWITCH_BELOW):
            count = count + 1.0
        return (v1, v2, v3, n1, n2, n3, count)

    return counted


def enter_counted(s: Floats, h: float, p: Floats) -> Floats:
    """The physical state with a count of zero."""
    return (s[0], s[1], s[2], s[3], s[4], s[5], 0.0)


def leave_counted(s: Floats, h: float, p: Floats) -> Floats:
    """The physical state without the count."""
    return (s[0], s[1], s[2], s[3], s[4], s[5])


@scheme(
    "bohlin-a",
    top="kowalevski",
    title="Bohlin's method with gamma by the BS scheme",
    order=1,
    explicit=True,
    self_adjoint=False,
    conserves=CONSERVES,
    citation=CITATION,
    equations="(A), Kxi, direct",
    limits=LIMITS,
    options=BranchOptions,
)
def build_a(top: Top, options: BranchOptions) -> Stepper:
    """Gamma turns by Cayley's rotation with the old omega.

    Then omega3 follows by the trapezoidal rule, and omega1 + i omega2 is the square root of e^{-i chi} xi + c gamma',
    where xi = omega² - c gamma turns by chi = h/2 (omega3' + omega3). |gamma| and |xi| = k are conserved. The order
    is lost where omega1 + i omega2 passes 0, where the square root is singular. From rest with gamma along the third
    axis, where xi = 0, the true top falls but no scheme of this family ever moves: it is a fixed point of the map.
    """
    return with_roots_counted(Stepper(bohlin_step(method_a, ROOTS[options.branch]), 6))


@scheme(
    "bohlin-b",
    top="kowalevski",
    title="Bohlin's method with gamma by a stereographic coordinate",
    order=1,
    explicit=True,
    self_adjoint=False,
    conserves=CONSERVES,
    citation=CITATION,
    equations="(B), Kxi, direct",
    limits=LIMITS,
    options=ChartOptions,
)
def build_b(top: Top, options: ChartOptions) -> Stepper:
    """Euler's rule for the stereographic coordinate z of gamma; omega as in bohlin-a.

    The paper's z = (gamma1 + i gamma2)/(1 + gamma3) is infinite at gamma3 = -1. By default the step takes the
    coordinate from the other pole, 1/conj(z), where gamma3 < -0.8. Euler's rule on it is a slightly different scheme
    of the same order, and z is found anew from gamma at each step, so that nothing but the state is carried, a switch
    costs nothing, and a resumed run equals a whole one. The run reports how often the chart was switched.
    """
    root = ROOTS[options.branch]
    if options.chart == "single":
        return with_roots_counted(Stepper(bohlin_step(method_b_single, root), 6))
    step = counting_step(bohlin_step(method_b_switch, root))
    return with_roots_counted(Stepper(step, 7, enter_counted, leave_counted, counters=("chart_switches",)))


@scheme(
    "bohlin-c",
    top="kowalevski",
    title="Bohlin's method with gamma by an instantaneous rotation",
    order=1,
    explicit=True,
    self_adjoint=False,
    conserves=CONSERVES,
    citation=CITATION,
    equations="(C), Kxi, direct",
    limits={
        **LIMITS,
        "drift": "Conserves no energy: in the case's steps of 0.1 it rises from 2.1 to more than 200 within t = 6500, "
        "and the run ends as `left_motion`, though gamma² and k² are kept.",
    },
    options=BranchOptions,
)
def build_c(top: Top, options: BranchOptions) -> Stepper:
    """Gamma turns by Rodrigues' rotation through the angle h |omega| about the old omega; omega as in bohlin-a.

    The rotation needs no axis, so omega = 0 is an ordinary point.
    """
    return with_roots_counted(Stepper(bohlin_step(method_c, ROOTS[options.branch]), 6))
