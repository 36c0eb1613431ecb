"""Self-adjoint hybrid: the three relations of the paper's hybrid in terms of the new state, solved simultaneously.

With half the change of omega, v, the means o of omega and q of gamma, and xi = (w1 + i w2)² - c (g1 + i g2)::

    gamma' - gamma = h q x o                                       (Cayley rotation)
    2 v3 + h c q2 = 0                                              (omega3 by the trapezoidal rule)
    4 v12 o12 - c (gamma' - gamma)12 - (e^{-i h o3} - 1) xi = 0    (xi rotates by the mean omega3)

The last one is the change of (w1 + i w2)². Its square root corresponds to the choice of the solution: that to which
Newton's iteration converges from HK's step. All terms are differences, so that their rounding errors are proportional
to the change in the step. Exchanging old and new state together with h -> -h only changes the sign of v and of the
equations: the step is self-adjoint.

xi = k u with |u| = 1, and k and gamma² are carried (``carried_xi``), so that round-off does not accumulate in them. The
difference between the carried xi and that computed from omega and gamma, a rounding error, enters the equations.

Performance:
- HK's step is so accurate that Newton's method in three unknowns needs one iteration at h = 0.001, two at 0.1;
- the 3x3 systems are solved by Cramer's rule, and gamma is eliminated by a Cayley rotation in closed form;
- the rotation of xi is evaluated by polynomials, without calls of libm.
"""

from __future__ import annotations

import math

from topcli.arithmetic.complex_plane import rotation_increment
from topcli.arithmetic.increments import compensated_sums, first6
from topcli.arithmetic.linear import solve3
from topcli.arithmetic.rotations import Vector, cayley_increment, resolvent
from topcli.arithmetic.tolerances import follow_precision
from topcli.contracts import Floats, Stepper, Top
from topcli.schemes.compensated import CompensatedOption
from topcli.schemes.formulas import BOHLIN
from topcli.schemes.kowalevski.carried_xi import enter_carried, length_correction
from topcli.schemes.kowalevski.hk import hk_kowalevski
from topcli.schemes.limits import FAR_OVERFLOW, NEWTON_SINGULAR, NO_SOLUTION
from topcli.schemes.registry import scheme

NEWTON_LIMIT = 30
"""Maximum number of Newton iterations; two or three are typical."""
HALVINGS = 8
"""Maximum number of halvings of a correction that does not reduce the residual."""
SETTLED = 4.0 * 2.0**-52
"""Tolerance of the residual, relative to the terms of the equation: round-off."""
TINY = 1e-300
follow_precision(__name__, caps=("NEWTON_LIMIT",), SETTLED=1, TINY=20)
Floats7 = tuple[float, float, float, float, float, float, float]
Floats10 = tuple[float, float, float, float, float, float, float, float, float, float]


def residuals(y: Floats, xi: Floats, h: float, c: float, v1: float, v2: float, v3: float) -> Floats7:
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


def hybrid_sym_change(s: Floats10, h: float, p: Floats) -> Floats10:
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


def hybrid_sym_step(s: Floats, h: float, p: Floats) -> Floats:
    """One step on omega, gamma; u, k, gamma²; the status; the iterations so far."""
    w1, w2, w3, g1, g2, g3, u1, u2, k, g_sq, _, iterations = s
    old = (w1, w2, w3, g1, g2, g3, u1, u2, k, g_sq)
    x1, x2, x3, y1, y2, y3, z1, z2, status, more = hybrid_sym_change(old, h, p)
    u1, u2 = u1 + z1, u2 + z2
    return (w1 + x1, w2 + x2, w3 + x3, g1 + y1, g2 + y2, g3 + y3, u1, u2, k, g_sq, status, iterations + more)


def compensated_step(s: Floats, h: float, p: Floats) -> Floats:
    """One compensated step; the rounding errors of the sums of omega3, gamma and u are in the slots before the status.

    omega1 and omega2 need no compensation: in every step they are determined by u and gamma.
    """
    w1, w2, w3, g1, g2, g3, u1, u2, k, g_sq, e3, e4, e5, e6, e7, e8, _, iterations = s
    old = (w1, w2, w3, g1, g2, g3, u1, u2, k, g_sq)
    x1, x2, x3, y1, y2, y3, z1, z2, status, more = hybrid_sym_change(old, h, p)
    w1, w2 = w1 + x1, w2 + x2
    (w3, g1, g2, g3, u1, u2), lost = compensated_sums(
        (w3, g1, g2, g3, u1, u2), (e3, e4, e5, e6, e7, e8), (x3, y1, y2, y3, z1, z2)
    )
    return (w1, w2, w3, g1, g2, g3, u1, u2, k, g_sq, *lost, status, iterations + more)


def enter(y: Floats, h: float, p: Floats) -> Floats:
    """Working state: physical state, carried quantities, status, number of iterations."""
    return (*enter_carried(y, h, p), 0.0, 0.0)


def enter_compensated(y: Floats, h: float, p: Floats) -> Floats:
    """Working state of the compensated step."""
    return (*enter_carried(y, h, p), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


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
    equations="modified BS scheme, Kxi, with the new omega instead of HK's",
    options=CompensatedOption,
    limits={"resonance": NO_SOLUTION, "singular-step": NEWTON_SINGULAR, "huge": FAR_OVERFLOW},
)
def build(top: Top, options: CompensatedOption) -> Stepper:
    """The relations of the hybrid between old and new state, solved simultaneously by Newton's method from HK's step.

    Self-adjoint. |gamma| and k = |omega² - c gamma| are conserved; 2l and E deviate without drift. If a step does not
    converge, the run ends as `no_convergence`. This can happen where omega1 + i omega2 comes so close to 0 that the two
    square roots nearly coincide; the order is erratic there. `midpoint4` and `hk-symproj`, which need no square root,
    conserve k² and have order 2.
    """
    if options.compensated:
        return Stepper(compensated_step, 18, enter_compensated, first6, ("iterations",), iterative=True)
    return Stepper(hybrid_sym_step, 12, enter, first6, ("iterations",), iterative=True)
