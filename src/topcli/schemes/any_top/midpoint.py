"""Implicit midpoint rule for every top with gravity.

The step solves the general Euler-Poisson equations. Their six coefficients are part of the working state, so that the
same machine code serves all tops. The inertial form of Lagrange's top of Bobenko and Suris, m' = p x a, a' = m x a, is
the special case omega = -m, gamma = a with equal moments and g = p.

Performance:
- given the mean omega, Poisson's equation is a Cayley rotation in closed form, so that Newton's method has three
  unknowns, not six;
- the 3x3 systems are solved by Cramer's rule; the columns of the matrix need one reciprocal, of 1 + |h omega/2|²;
- two iterations at h = 0.001, three at 0.01 and 0.1; one fewer would leave errors of one sign above round-off.
"""

from __future__ import annotations

import math

from topcli.arithmetic.double_double import two_sum
from topcli.arithmetic.rotations import Vector, cayley_increment
from topcli.arithmetic.tolerances import follow_precision
from topcli.arithmetic.vectors import solve3
from topcli.contracts import Floats, Stepper, Top, checked_equations
from topcli.schemes.declarations import LONG_NEWTON, polynomial_invariants
from topcli.schemes.heavy.hk import implicit_matrix
from topcli.schemes.layout import CompensatedOption, is_compensated, stepper
from topcli.schemes.registry import scheme
from topcli.tops import TOPS

INERTIAL = "lagrange/inertial"
FORMS = tuple(form for form in ("heavy", "kowalevski", "lagrange", INERTIAL) if form in TOPS)
NEWTON_LIMIT = 25
"""Maximum number of Newton iterations; three or four are typical."""
SETTLED = 2.0**-33
"""Tolerance of the last correction relative to omega; by quadratic convergence the error is far below the last bit."""
follow_precision(__name__, caps=("NEWTON_LIMIT",), SETTLED=0.5)


def angular_acceleration(o1: float, o2: float, o3: float, q1: float, q2: float, q3: float, p: Floats) -> Vector:
    """Angular acceleration I^-1 (I omega x omega + gamma x g) at omega = o, gamma = q.

    The differences of the moments are used with their rounding errors: the three must add up to zero, otherwise the
    energy drifts by an ulp per unit time.
    """
    A, B, C, x, y, z = p
    k1, r1 = two_sum(B, -C)
    k2, r2 = two_sum(C, -A)
    k3, r3 = two_sum(A, -B)
    o23, o31, o12 = o2 * o3, o3 * o1, o1 * o2
    return (
        ((k1 * o23 + r1 * o23) + (q2 * z - q3 * y)) / A,
        ((k2 * o31 + r2 * o31) + (q3 * x - q1 * z)) / B,
        ((k3 * o12 + r3 * o12) + (q1 * y - q2 * x)) / C,
    )


def midpoint_change(
    state: Floats, h: float, p: Floats
) -> tuple[float, float, float, float, float, float, float, float]:
    """Change in one step of the implicit midpoint rule; ``p`` is (A, B, C, mg x0, mg y0, mg z0).

    Returns the change, the status (0.0, or nan if Newton's iteration did not converge), and the number of iterations.

    Given the mean omega, Poisson's equation is a Cayley rotation of gamma; Newton's iteration finds half the change of
    omega, v. After the last iteration the change of omega is evaluated again from the equations, so that the remaining
    error of the iteration is comparable to a rounding error of the change.
    """
    w1, w2, w3, g1, g2, g3 = state
    A, B, C, x, y, z = p
    d = 0.5 * h
    gravity = (abs(x) + abs(y) + abs(z)) * (abs(g1) + abs(g2) + abs(g3)) * (1.0 / A + 1.0 / B + 1.0 / C)
    tolerance = SETTLED * (abs(w1) + abs(w2) + abs(w3) + abs(d) * gravity)
    v1, v2, v3 = 0.0, 0.0, 0.0
    status = math.nan
    iterations = 0.0
    for _ in range(NEWTON_LIMIT):
        iterations += 1.0
        o1, o2, o3 = w1 + v1, w2 + v2, w3 + v3
        a1, a2, a3 = d * o1, d * o2, d * o3
        b1, b2, b3 = cayley_increment(a1, a2, a3, g1, g2, g3)
        q1, q2, q3 = g1 + 0.5 * b1, g2 + 0.5 * b2, g3 + 0.5 * b3
        f1, f2, f3 = angular_acceleration(o1, o2, o3, q1, q2, q3, p)
        e1, e2, e3 = solve3(implicit_matrix((a1, a2, a3), (q1, q2, q3), d, p), d * f1 - v1, d * f2 - v2, d * f3 - v3)
        v1, v2, v3 = v1 + e1, v2 + e2, v3 + e3
        if abs(e1) + abs(e2) + abs(e3) <= tolerance:
            status = 0.0
            break
    o1, o2, o3 = w1 + v1, w2 + v2, w3 + v3
    b1, b2, b3 = cayley_increment(d * o1, d * o2, d * o3, g1, g2, g3)
    f1, f2, f3 = angular_acceleration(o1, o2, o3, g1 + 0.5 * b1, g2 + 0.5 * b2, g3 + 0.5 * b3, p)
    return (h * f1, h * f2, h * f3, b1, b2, b3, status, iterations)


def midpoint(state: Floats, h: float, p: Floats) -> tuple[float, float, float, float, float, float, float, float]:
    """One step of the implicit midpoint rule: new state, then status and iterations as in ``midpoint_change``."""
    w1, w2, w3, g1, g2, g3 = state
    x1, x2, x3, y1, y2, y3, status, iterations = midpoint_change(state, h, p)
    return (w1 + x1, w2 + x2, w3 + x3, g1 + y1, g2 + y2, g3 + y3, status, iterations)


def midpoint_stage(s: Floats, h: float, p: Floats) -> Floats:
    """``midpoint_change`` of a state followed by the coefficients A, B, C, mg(x0, y0, z0) of its top."""
    return midpoint_change(s[:6], h, s[6:])


def enter_inertial(y: Floats, h: float, p: Floats) -> Floats:
    """State and coefficients from m and a of the inertial frame."""
    return (-y[0], -y[1], -y[2], y[3], y[4], y[5], 1.0, 1.0, 1.0, 0.0, 0.0, 1.0)


def leave_inertial(s: Floats, h: float, p: Floats) -> Floats:
    """m and a of the inertial frame, from the working state."""
    return (-s[0], -s[1], -s[2], s[3], s[4], s[5])


@scheme(
    "midpoint",
    top=FORMS,
    title="Implicit midpoint rule",
    order=2,
    explicit=False,
    self_adjoint=True,
    conserves=lambda top: polynomial_invariants(top, 2),
    citation="Cooper 1987; Sogo, Discrete Spinning Tops, section 1.2 (for Euler's top)",
    formula=r"y' = y + h\,f(\bar y)",
    equations="y' - y = h f((y' + y)/2) for EulerPoisson",
    options=CompensatedOption,
    limits=lambda top: {"singular-step": LONG_NEWTON} if top.form == "heavy" else {},
)
def build(top: Top, options: CompensatedOption) -> Stepper:
    """Solved to round-off by Newton's method; if a step does not converge, the run ends as `no_convergence`.

    The step is self-adjoint. Every quadratic integral is conserved exactly, for any top: gamma², m·gamma and the
    energy. Kowalevski's k², of degree four, is only approximately conserved.
    """
    equations = checked_equations(top, "scheme 'midpoint'")
    coefficients = (*equations.moments, *equations.gravity)

    def enter_body(y: Floats, h: float, p: Floats) -> Floats:
        return (*y, *coefficients)

    enter, leave = (enter_inertial, leave_inertial) if top.form == INERTIAL else (enter_body, None)
    lost = range(6 * is_compensated(options))
    return stepper(midpoint_stage, 6, 6, lost=lost, counters=("iterations",), iterative=True, enter=enter, leave=leave)
