"""Hybrids of HK, the modified BS scheme and Bohlin's method (Sogo, section 3.2.3): `hybrid` and `hybrid-sym`.

**hybrid**, the paper's, needs only omega of the HK step; the Cayley rotation, the rotation of xi and the square root
need no angle and no call of libm.

**hybrid-sym** solves the three relations of the hybrid in terms of the new state, simultaneously. With half the change
of omega, v, the means o of omega and q of gamma, and xi = (w1 + i w2)² - c (g1 + i g2)::

    gamma' - gamma = h q x o                                       (Cayley rotation)
    2 v3 + h c q2 = 0                                              (omega3 by the trapezoidal rule)
    4 v12 o12 - c (gamma' - gamma)12 - (e^{-i h o3} - 1) xi = 0    (xi rotates by the mean omega3)

The last one is the change of (w1 + i w2)². Its square root corresponds to the choice of the solution: that to which
Newton's iteration converges from HK's step. All terms are differences, so that their rounding errors are proportional
to the change in the step. Exchanging old and new state together with h -> -h only changes the sign of v and of the
equations: the step is self-adjoint.

xi = k u with a unit number u, k and gamma² are carried; u and gamma are renormalized by a change of the size of one
rounding error, so that nothing accumulates. The difference between the carried xi and that computed from omega and
gamma, a rounding error, enters the equations.
"""

from __future__ import annotations

import math
from dataclasses import replace

from topcli.arithmetic.fused import fma, follow_precision
from topcli.arithmetic.vectors import Vector, cayley_increment, cayley_rotated, resolvent, rotation_increment, solve3
from topcli.contracts import Floats, NoOptions, StepFunction, Stepper, Top
from topcli.schemes.any_top.hk import build_hk
from topcli.schemes.kowalevski.bohlin import ROOTS, BranchOptions, Root
from topcli.schemes.registry import scheme
from topcli.schemes.steppers import first, stepper

_NEWTON_LIMIT = 30
"""Maximum number of Newton iterations; two or three are typical."""
HALVINGS = 8
"""Maximum number of halvings of a correction that does not reduce the residual."""
_SETTLED = 4.0 * 2.0**-52
"""Tolerance of the residual, relative to the terms of the equation: round-off."""
TINY = 1e-300
"""Avoids 0/0 in the residual of a body at rest."""
follow_precision(__name__, caps=("_NEWTON_LIMIT",), _SETTLED=1, TINY=20)


def hybrid_step(hk: StepFunction, root: Root) -> StepFunction:
    """Return the step whose square root is on the branch selected by ``root`` from the omega of the step ``hk``."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        w1, w2, w3, g1, g2, g3 = s
        q1, q2, v3, _, _, _ = hk(s, h, p)
        k = 0.25 * h
        n1, n2, n3 = cayley_rotated(k * (q1 + w1), k * (q2 + w2), k * (v3 + w3), g1, g2, g3)
        half = 0.5 * p[0]  # half of xi is rotated
        x = 0.5 * ((w1 - w2) * (w1 + w2)) - half * g1
        y = w1 * w2 - half * g2
        dx, dy = rotation_increment((0.5 * h) * (v3 + w3), x, y)
        v1, v2 = root(fma(half, n1, x + dx), fma(half, n2, y + dy), q1, q2)
        return (v1, v2, v3, n1, n2, n3)

    return step


@scheme(
    "hybrid",
    top="kowalevski",
    order=2,
    explicit=True,
    self_adjoint=False,
    conserves=("gamma_sq", "k_sq"),
    options=BranchOptions,
)
def build_hybrid(top: Top, options: BranchOptions) -> Stepper:
    r"""Hybrid of HK and Bohlin's method.

    HK gives omega3, a rotation with HK's mean omega gives gamma, and Bohlin's method gives omega1 + i omega2.

    HK is the Hirota-Kimura scheme (`hk`); its mean omega is the mean of omega before and after HK's step. The scheme
    conserves |gamma| and k = |xi|, where xi = (omega1 + i omega2)² - c (gamma1 + i gamma2). Contrary to what the paper
    states, the step is not self-adjoint: a step forward followed by a step back has an error of O(h⁴), and 2l and E
    drift. Where omega1 + i omega2 passes through 0, the square root in Bohlin's method is singular, and the order is
    reduced to 3/2. HK with the key `project: 1` of the scheme also conserves k² and has order 2 there.

    Source
    ------
    Sogo, Discrete Spinning Tops, section 3.2.3

    Equations
    ---------
    (dEulerPoisson), the modified BS scheme and (Kxi) of the paper

    Formula
    -------
    \gamma' - \gamma = h\,\bar\gamma\times\frac{\omega + \omega^{\mathrm{HK}}}{2}, \qquad
    \omega_3' = \omega_3^{\mathrm{HK}}, \qquad
    (\omega_1' + i\omega_2')^2 = e^{-ih\bar\omega_3}\,\xi + c\,(\gamma_1' + i\gamma_2')

    \xi = (\omega_1 + i\omega_2)^2 - c\,(\gamma_1 + i\gamma_2)

    Limits
    ------
    singular-step
        For certain step sizes of the order of 1/|omega| and larger, the determinant of HK's linear system vanishes, and
        the state jumps far away: the run ends as `left_motion` or `blew_up`. Choose h such that |h| |omega| is well
        below 1.
    huge
        |xi|² grows as |omega|⁴ and overflows if |omega| exceeds about 1e77. Choose a unit of time in which omega has a
        moderate size.
    """
    hk = build_hk(top, NoOptions())
    step = hybrid_step(hk.step, ROOTS[options.branch])
    return Stepper(step, 6, constants=hk.constants, source=hk.source)


def length_correction(now: float, target: float) -> float:
    """Relative correction of a vector of squared length ``now`` to the close value ``target``; 0 if that is 0."""
    return 0.5 * ((target - now) / target) if target > 0.0 else 0.0


def enter_carried(y: Floats, h: float, p: Floats) -> Floats:
    """Physical state, u, k and gamma². For xi = 0, Delone's motion, u is arbitrary."""
    x1, x2 = (y[0] - y[1]) * (y[0] + y[1]) - p[0] * y[3], 2.0 * y[0] * y[1] - p[0] * y[4]
    k = math.hypot(x1, x2)
    u1, u2 = (x1 / k, x2 / k) if k > 0.0 else (1.0, 0.0)
    g_sq = y[3] * y[3] + (y[4] * y[4] + y[5] * y[5])
    return (y[0], y[1], y[2], y[3], y[4], y[5], u1, u2, k, g_sq)


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
    row1 = (n1 - c2 * s11, -n2 - c2 * s12, -c2 * s13 - h * (x2 + t2))
    row2 = (n2 - c2 * s21, n1 - c2 * s22, -c2 * s23 + h * (x1 + t1))
    row3 = (k * s21, k * s22, 2.0 + k * s23)
    return solve3((*row1, *row2, *row3), -f[0], -f[1], -f[2])


def hybrid_sym_change(hk: StepFunction) -> StepFunction:
    """Return the change of omega, gamma and u, with the status and the number of iterations, from the step ``hk``."""

    def change(s: Floats, h: float, p: Floats) -> Floats:
        w1, w2, w3, g1, g2, g3, u1, u2, k, g_sq = s
        c = p[0]
        y = (w1, w2, w3, g1, g2, g3)
        iterations = 0.0
        # carried numbers: xi, its difference from that of omega and gamma, and corrections of two lengths
        x1, x2 = k * u1, k * u2
        z1 = ((w1 - w2) * (w1 + w2) - c * g1) - x1
        z2 = (2.0 * w1 * w2 - c * g2) - x2
        to_u = length_correction(u1 * u1 + u2 * u2, 1.0)
        xi = (x1, x2, z1, z2, to_u, length_correction(g1 * g1 + (g2 * g2 + g3 * g3), g_sq))
        # the step of HK is close enough to begin with; corrections are halved where they would lead away
        q1, q2, q3, _, _, _ = hk(y, h, p)
        v1, v2, v3 = 0.5 * (q1 - w1), 0.5 * (q2 - w2), 0.5 * (q3 - w3)
        f1, f2, f3, b1, b2, b3, off = residuals(y, xi, h, c, v1, v2, v3)
        status = math.nan
        for _ in range(_NEWTON_LIMIT):
            if off <= _SETTLED:
                status = 0.0
                break
            iterations += 1.0
            e1, e2, e3 = newton_correction(y, x1, x2, h, c, (v1, v2, v3), (f1, f2, f3), (b1, b2, b3))
            before = off
            n1, n2, n3 = v1 + e1, v2 + e2, v3 + e3
            f1, f2, f3, b1, b2, b3, off = residuals(y, xi, h, c, n1, n2, n3)
            for _ in range(HALVINGS):
                if off < before or off <= _SETTLED:
                    break
                e1, e2, e3 = 0.5 * e1, 0.5 * e2, 0.5 * e3
                n1, n2, n3 = v1 + e1, v2 + e2, v3 + e3
                f1, f2, f3, b1, b2, b3, off = residuals(y, xi, h, c, n1, n2, n3)
            v1, v2, v3 = n1, n2, n3
        # u turns like xi
        d1, d2 = rotation_increment(h * (w3 + v3), u1, u2)
        to_u1, to_u2 = d1 + to_u * u1, d2 + to_u * u2
        return (2.0 * v1, 2.0 * v2, 2.0 * v3, b1, b2, b3, to_u1, to_u2, status, iterations)

    return change


@scheme(
    "hybrid-sym",
    top="kowalevski",
    order=2,
    explicit=False,
    self_adjoint=True,
    conserves=("gamma_sq", "k_sq"),
)
def build_sym(top: Top, options: NoOptions) -> Stepper:
    r"""Self-adjoint hybrid of HK and Bohlin's method.

    The scheme solves all equations of `hybrid` at once, with its own new omega in place of HK's.

    HK is the Hirota-Kimura scheme (`hk`). Newton's method solves the equations; it starts from HK's step. The scheme is
    self-adjoint. `hybrid-sym` conserves |gamma| and k = |xi|, where xi = (omega1 + i omega2)² - c (gamma1 + i gamma2);
    2l and E deviate without drift.

    If a step does not converge, the run ends as `no_convergence`. Convergence may fail where omega1 + i omega2 comes so
    close to 0 that its two possible values, the two square roots, nearly coincide. There, errors do not fall regularly
    with h.

    Source
    ------
    after Sogo, Discrete Spinning Tops, section 3.2.3

    Equations
    ---------
    the modified BS scheme and (Kxi) of the paper, with the new omega instead of HK's

    Formula
    -------
    \gamma' - \gamma = h\,\bar\gamma\times\bar\omega

    \omega_3' - \omega_3 = -h c\,\bar\gamma_2, \qquad
    (\omega_1' + i\omega_2')^2 = e^{-ih\bar\omega_3}\,\xi + c\,(\gamma_1' + i\gamma_2'), \qquad
    \xi = (\omega_1 + i\omega_2)^2 - c\,(\gamma_1 + i\gamma_2)

    Limits
    ------
    resonance
        If h is the time of one revolution of the body or longer, Newton's method may find no solution. The run then
        ends as `no_convergence`.
    singular-step
        The iteration for the step starts from a step of HK (the scheme `hk`), whose linear system is singular for the h
        of this case. The iteration does not converge, and the run ends as `no_convergence`.
    huge
        The determinant of the linear system in Newton's method grows as |omega|³ and overflows if |omega| exceeds about
        1e103. The run then ends as `no_convergence`.
    """
    hk = build_hk(top, NoOptions())
    change = hybrid_sym_change(hk.step)
    method = stepper(change, 8, 2, counters=("iterations",), iterative=True, enter=enter_carried, leave=first(6))
    return replace(method, constants=hk.constants, source=hk.source)
