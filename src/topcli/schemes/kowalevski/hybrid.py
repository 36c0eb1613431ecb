"""Hybrids of HK, the modified BS scheme and Bohlin's method (Sogo, section 3.2.3): `hybrid`, `hybrid-xi`, `hybrid-sym`.

**hybrid**, the paper's. Performance:

- only omega of the HK step is needed; once the step is inlined, the compiler removes the rest;
- the Cayley rotation, the rotation of xi and the square root need no angle and no call of libm;
- divisions are off the critical path, and the two rotations overlap.

**Carried xi.** If xi is recomputed from omega and gamma in every step, its rounding errors accumulate, as do those of
the length of gamma. As carried quantities, xi = k u with |u| = 1, k and gamma² are constants, and u and gamma are
renormalized in every step by a change of the size of one rounding error. Nothing accumulates, no growing angle is
needed, and libm is not called. **hybrid-xi** does this for the hybrid; the renormalization is off the critical path,
and the rotation of u needs the same polynomials as that of xi.

**hybrid-sym** solves the three relations of the hybrid in terms of the new state, simultaneously. With half the change
of omega, v, the means o of omega and q of gamma, and xi = (w1 + i w2)² - c (g1 + i g2)::

    gamma' - gamma = h q x o                                       (Cayley rotation)
    2 v3 + h c q2 = 0                                              (omega3 by the trapezoidal rule)
    4 v12 o12 - c (gamma' - gamma)12 - (e^{-i h o3} - 1) xi = 0    (xi rotates by the mean omega3)

The last one is the change of (w1 + i w2)². Its square root corresponds to the choice of the solution: that to which
Newton's iteration converges from HK's step. All terms are differences, so that their rounding errors are proportional
to the change in the step. Exchanging old and new state together with h -> -h only changes the sign of v and of the
equations: the step is self-adjoint.

xi = k u and gamma² are carried. The difference between the carried xi and that computed from omega and gamma, a
rounding error, enters the equations.

Performance:
- HK's step is so accurate that Newton's method in three unknowns needs one iteration at h = 0.001, two at 0.1;
- the 3x3 systems are solved by Cramer's rule, and gamma is eliminated by a Cayley rotation in closed form;
- the rotation of xi is evaluated by polynomials, without calls of libm.
"""

from __future__ import annotations

import math

from topcli.arithmetic.fused import compensated_sum, fma, follow_precision
from topcli.arithmetic.vectors import Vector, cayley_increment, cayley_rotated, resolvent, rotation_increment, solve3
from topcli.contracts import Floats, StepFunction, Stepper, Top
from topcli.schemes.kowalevski.bohlin import ROOTS, BranchOptions, Root
from topcli.schemes.kowalevski.four_integrals import xi_of
from topcli.schemes.kowalevski.hk import hk_kowalevski, hk_kowalevski_change, kowalevski_determinant
from topcli.schemes.layout import (
    AMBIGUOUS,
    BOHLIN,
    FAR_OVERFLOW,
    HYBRID,
    NEAR_SINGULAR,
    NEWTON_SINGULAR,
    NO_SOLUTION,
    OVERFLOW,
    SINGULAR,
    XI,
    CompensatedOption,
    ambiguous_root,
    first,
    small_determinant,
    stepper,
    with_counter,
)
from topcli.schemes.registry import scheme

NEWTON_LIMIT = 30
"""Maximum number of Newton iterations; two or three are typical."""
HALVINGS = 8
"""Maximum number of halvings of a correction that does not reduce the residual."""
SETTLED = 4.0 * 2.0**-52
"""Tolerance of the residual, relative to the terms of the equation: round-off."""
TINY = 1e-300
follow_precision(__name__, caps=("NEWTON_LIMIT",), SETTLED=1, TINY=20)


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
    equations="(dEulerPoisson), the modified BS scheme and (Kxi) of the paper",
    limits={"singular-step": SINGULAR, "huge": OVERFLOW},
    options=BranchOptions,
)
def build_hybrid(top: Top, options: BranchOptions) -> Stepper:
    """HK gives omega3, a rotation with HK's mean omega gives gamma, and Bohlin's method gives omega1 + i omega2.

    HK is the Hirota-Kimura scheme (`hk`); its mean omega is the mean of omega before and after HK's step. The scheme
    conserves |gamma| and k = |xi|, where xi = (omega1 + i omega2)² - c (gamma1 + i gamma2). Contrary to what the paper
    states, the step is not self-adjoint: a step forward followed by a step back has an error of O(h⁴), and 2l and E
    drift. Where omega1 + i omega2 passes through 0, the square root in Bohlin's method is singular, and the order is
    reduced to 3/2. The schemes `midpoint4` and `hk-symproj` also conserve k² and have order 2 there.
    """
    return with_hk_counters(Stepper(hybrid_step(ROOTS[options.branch]), 6))


def length_correction(now: float, wanted: float) -> float:
    """Relative correction of a vector of squared length ``now`` to the close value ``wanted``; 0 if that is 0."""
    return 0.5 * ((wanted - now) / wanted) if wanted > 0.0 else 0.0


def enter_carried(y: Floats, h: float, p: Floats) -> Floats:
    """Physical state, u, k and gamma². For xi = 0, Delone's motion, u is arbitrary."""
    x1, x2 = xi_of(y[0], y[1], y[3], y[4], p[0])
    k = math.hypot(x1, x2)
    u1, u2 = (x1 / k, x2 / k) if k > 0.0 else (1.0, 0.0)
    g_sq = y[3] * y[3] + (y[4] * y[4] + y[5] * y[5])
    return (y[0], y[1], y[2], y[3], y[4], y[5], u1, u2, k, g_sq)


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


def compensated_xi_step(root: Root) -> StepFunction:
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


class HybridOptions(BranchOptions, CompensatedOption):
    """Options: branch of the root, compensated sums."""


@scheme(
    "hybrid-xi",
    top="kowalevski",
    title="Hybrid of HK and Bohlin's method with xi as a variable",
    order=2,
    explicit=True,
    self_adjoint=False,
    conserves=("gamma_sq", "k_sq"),
    citation="Sogo, Discrete Spinning Tops, section 3.2.3",
    formula=HYBRID + "\n" + r"\xi = k\,e^{i\theta}, \qquad \theta' = \theta - h\,\bar\omega_3",
    equations="(dEulerPoisson), the modified BS scheme and (Kxi) of the paper",
    limits={
        "singular-step": SINGULAR,
        "resonance": "Each step restores the lengths of u and gamma by a change along their directions before the "
        "step. If u and gamma rotate by more than a right angle in one step, this change makes the deviations "
        "of their lengths grow.",
        "huge": OVERFLOW,
    },
    options=HybridOptions,
)
def build_xi(top: Top, options: HybridOptions) -> Stepper:
    """A variant of the paper's scheme `hybrid` in which round-off makes neither gamma² nor k² drift.

    The trajectory is that of `hybrid` up to round-off, but k and gamma² keep their initial values. The variable xi =
    (omega1 + i omega2)² - c (gamma1 + i gamma2) is stored as k u with |u| = 1. Each step rotates u, leaves k unchanged,
    and restores the length of gamma.

    This scheme, like `hybrid`, is not self-adjoint. Under both schemes 2l and E drift, and the order is reduced to 3/2
    where omega1 + i omega2 passes through 0. The schemes `midpoint4` and `hk-symproj` also conserve k² and have order 2
    there.
    """
    compensated = options.compensated
    step = (compensated_xi_step if compensated else hybrid_xi_step)(ROOTS[options.branch])
    errors = (0.0,) * (6 * compensated)

    def enter(y: Floats, h: float, p: Floats) -> Floats:
        return (*enter_carried(y, h, p), *errors)

    return with_hk_counters(Stepper(step, 10 + len(errors), enter, first(6), checked=6))


def residuals(y: Floats, xi: Floats, h: float, c: float, v1: float, v2: float, v3: float) -> Floats:
    """Residuals of the complex equation and of that for omega3, the change of gamma, the largest relative residual.

    ``xi`` consists of the carried xi, the difference of the xi computed from omega and gamma, and the relative length
    corrections of u and gamma.
    """
    w1, w2, w3, g1, g2, g3 = y
    x1, x2, z1, z2, to_u, to_g = xi
    d = 0.5 * h
    o1, o2, o3 = w1 + v1, w2 + v2, w3 + v3
    b1, b2, b3 = cayley_increment(d * o1, d * o2, d * o3, g1, g2, g3)
    b1, b2, b3 = b1 + to_g * g1, b2 + to_g * g2, b3 + to_g * g3
    t1, t2 = rotation_increment(h * o3, x1, x2)
    t1, t2 = t1 + to_u * x1, t2 + to_u * x2
    f1 = ((4.0 * (v1 * o1 - v2 * o2) - c * b1) - t1) + z1
    f2 = ((4.0 * (v1 * o2 + v2 * o1) - c * b2) - t2) + z2
    f3 = 2.0 * v3 + (h * c) * (g2 + 0.5 * b2)
    size = 4.0 * (abs(v1) + abs(v2)) * (abs(o1) + abs(o2)) + abs(c) * (abs(b1) + abs(b2)) + (abs(t1) + abs(t2))
    size3 = abs(h * c) * (abs(g2) + 0.5 * abs(b2)) + 2.0 * abs(v3)
    off = max((abs(f1) + abs(f2)) / (size + (abs(z1) + abs(z2)) + TINY), abs(f3) / (size3 + TINY))
    return (f1, f2, f3, b1, b2, b3, off)


def newton_correction(y: Floats, x1: float, x2: float, h: float, c: float, v: Floats, f: Floats, b: Floats) -> Vector:
    """Newton correction of ``v`` for the residuals ``f`` and the change ``b`` of gamma."""
    w1, w2, w3, g1, g2, g3 = y
    d = 0.5 * h
    a1, a2, a3 = d * (w1 + v[0]), d * (w2 + v[1]), d * (w3 + v[2])
    e1, e2, e3 = d * (g1 + 0.5 * b[0]), d * (g2 + 0.5 * b[1]), d * (g3 + 0.5 * b[2])
    # columns: derivatives of the mean gamma with respect to the components of v
    s11, s21, _ = resolvent(a1, a2, a3, 0.0, e3, -e2)
    s12, s22, _ = resolvent(a1, a2, a3, -e3, 0.0, e1)
    s13, s23, _ = resolvent(a1, a2, a3, e2, -e1, 0.0)
    t1, t2 = rotation_increment(2.0 * a3, x1, x2)
    n1, n2 = 4.0 * (w1 + 2.0 * v[0]), 4.0 * (w2 + 2.0 * v[1])
    c2 = 2.0 * c
    k = h * c
    return solve3(
        (
            n1 - c2 * s11,
            -n2 - c2 * s12,
            -c2 * s13 - h * (x2 + t2),
            n2 - c2 * s21,
            n1 - c2 * s22,
            -c2 * s23 + h * (x1 + t1),
            k * s21,
            k * s22,
            2.0 + k * s23,
        ),
        -f[0],
        -f[1],
        -f[2],
    )


def hybrid_sym_change(s: Floats, h: float, p: Floats) -> Floats:
    """Change of omega, gamma and u, the status (0.0, or nan without convergence), and the number of iterations."""
    w1, w2, w3, g1, g2, g3, u1, u2, k, g_sq = s
    c = p[0]
    y = (w1, w2, w3, g1, g2, g3)
    iterations = 0.0
    x1, x2 = k * u1, k * u2
    z1 = ((w1 - w2) * (w1 + w2) - c * g1) - x1
    z2 = (2.0 * w1 * w2 - c * g2) - x2
    to_u = length_correction(u1 * u1 + u2 * u2, 1.0)
    xi = (x1, x2, z1, z2, to_u, length_correction(g1 * g1 + (g2 * g2 + g3 * g3), g_sq))
    q1, q2, q3, _, _, _ = hk_kowalevski(y, h, p)
    v1, v2, v3 = 0.5 * (q1 - w1), 0.5 * (q2 - w2), 0.5 * (q3 - w3)
    f1, f2, f3, b1, b2, b3, off = residuals(y, xi, h, c, v1, v2, v3)
    status = math.nan
    for _ in range(NEWTON_LIMIT):
        if off <= SETTLED:
            status = 0.0
            break
        iterations += 1.0
        e1, e2, e3 = newton_correction(y, x1, x2, h, c, (v1, v2, v3), (f1, f2, f3), (b1, b2, b3))
        before = off
        n1, n2, n3 = v1 + e1, v2 + e2, v3 + e3
        f1, f2, f3, b1, b2, b3, off = residuals(y, xi, h, c, n1, n2, n3)
        for _ in range(HALVINGS):
            if off < before or off <= SETTLED:
                break
            e1, e2, e3 = 0.5 * e1, 0.5 * e2, 0.5 * e3
            n1, n2, n3 = v1 + e1, v2 + e2, v3 + e3
            f1, f2, f3, b1, b2, b3, off = residuals(y, xi, h, c, n1, n2, n3)
        v1, v2, v3 = n1, n2, n3
    d1, d2 = rotation_increment(h * (w3 + v3), u1, u2)
    to_u1, to_u2 = d1 + to_u * u1, d2 + to_u * u2
    return (2.0 * v1, 2.0 * v2, 2.0 * v3, b1, b2, b3, to_u1, to_u2, status, iterations)


@scheme(
    "hybrid-sym",
    top="kowalevski",
    title="Self-adjoint hybrid of HK and Bohlin's method",
    order=2,
    explicit=False,
    self_adjoint=True,
    conserves=("gamma_sq", "k_sq"),
    citation="after Sogo, Discrete Spinning Tops, section 3.2.3",
    formula=r"\gamma' - \gamma = h\,\bar\gamma\times\bar\omega" + "\n" + BOHLIN,
    equations="the modified BS scheme and (Kxi) of the paper, with the new omega instead of HK's",
    options=CompensatedOption,
    limits={"resonance": NO_SOLUTION, "singular-step": NEWTON_SINGULAR, "huge": FAR_OVERFLOW},
)
def build_sym(top: Top, options: CompensatedOption) -> Stepper:
    """The scheme solves all equations of `hybrid` at once, with its own new omega in place of HK's.

    HK is the Hirota-Kimura scheme (`hk`). Newton's method solves the equations; it starts from HK's step. The scheme is
    self-adjoint. `hybrid-sym` conserves |gamma| and k = |xi|, where xi = (omega1 + i omega2)² - c (gamma1 + i gamma2);
    2l and E deviate without drift.

    If a step does not converge, the run ends as `no_convergence`. Convergence may fail where omega1 + i omega2 comes so
    close to 0 that its two possible values, the two square roots, nearly coincide. There, errors do not fall regularly
    with h. The schemes `midpoint4` and `hk-symproj` need no square root; they also conserve k² and have order 2.
    """
    lost = range(2, 8) if options.compensated else ()  # u and gamma determine omega1 and omega2 in every step
    iterations = ("iterations",)
    return stepper(hybrid_sym_change, 8, 2, lost=lost, counters=iterations, iterative=True, enter=enter_carried)
