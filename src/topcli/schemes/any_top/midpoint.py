"""The implicit midpoint rule: of the Euler-Poisson equations with weight, and of any polynomial field.

For a top of a user's file, Newton's step is generated from the field (``field.implicit``). For the built-in tops it is
written out. With I = (A, B, C), g = mg(x0, y0, z0), d = h/2 and a = d omega, Poisson's equation gives the change of
gamma in terms of that of omega by the inverse of 1 - (. x a), which exists for every a. Three equations for the change
of omega remain, with the matrix K::

    K delta = delta - d I^-1 (I omega x delta + I delta x omega + zeta x g),   zeta - zeta x a = d gamma x delta

The unknowns are *changes* of the state: their rounding errors are proportional to the change, and the one addition
state + change rounds without bias.

The coefficients of the top are part of the working state, so that the same machine code serves all tops. The inertial
form of Lagrange's top of Bobenko and Suris, m' = p x a, a' = m x a, is the special case omega = -m, gamma = a with
equal moments and g = p.

Performance:
- given the mean omega, the change of gamma is a Cayley rotation: three unknowns are left, not six;
- the 3x3 systems are solved by Cramer's rule; the columns of the matrix need one reciprocal, of 1 + |h omega/2|²;
- the compiler moves expressions in the moments and h out of the loop;
- a step takes two iterations at h = 0.001, three at 0.01 and 0.1; one fewer would leave errors of one sign
  above round-off.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

from topcli.arithmetic.fused import follow_precision, two_sum
from topcli.arithmetic.vectors import Matrix, Vector, cayley_increment, resolvent, solve3
from topcli.contracts import Floats, Stepper, Top, checked_equations
from topcli.field.implicit import NewtonStep, Rates, generated
from topcli.field.polynomial import required_field
from topcli.field.straight_line import function_of
from topcli.schemes.layout import (
    LONG_NEWTON,
    Change,
    CompensatedOption,
    is_compensated,
    polynomial_invariants,
    stepper,
)
from topcli.schemes.registry import scheme
from topcli.tops import TOPS


def implicit_matrix(a: Vector, gamma: Vector, d: float, p: Floats) -> Matrix:
    """Matrix K, in row-major order, for a = d omega and gamma; ``p`` is (A, B, C, mg x0, mg y0, mg z0)."""
    a1, a2, a3 = a
    A, B, C, x, y, z = p
    e1, e2, e3 = d * gamma[0], d * gamma[1], d * gamma[2]
    s11, s21, s31 = resolvent(a1, a2, a3, 0.0, e3, -e2)
    s12, s22, s32 = resolvent(a1, a2, a3, -e3, 0.0, e1)
    s13, s23, s33 = resolvent(a1, a2, a3, e2, -e1, 0.0)
    f1, f2, f3 = 1.0 / A, 1.0 / B, 1.0 / C
    k1, k2, k3 = f1 * (B - C), f2 * (C - A), f3 * (A - B)
    f1, f2, f3 = d * f1, d * f2, d * f3
    return (
        1.0 - f1 * (s21 * z - s31 * y),
        -k1 * a3 - f1 * (s22 * z - s32 * y),
        -k1 * a2 - f1 * (s23 * z - s33 * y),
        -k2 * a3 - f2 * (s31 * x - s11 * z),
        1.0 - f2 * (s32 * x - s12 * z),
        -k2 * a1 - f2 * (s33 * x - s13 * z),
        -k3 * a2 - f3 * (s11 * y - s21 * x),
        -k3 * a1 - f3 * (s12 * y - s22 * x),
        1.0 - f3 * (s13 * y - s23 * x),
    )


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


def midpoint_change(state: Floats, h: float, p: Floats) -> Floats:
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


def midpoint(state: Floats, h: float, p: Floats) -> Floats:
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
def build_midpoint(top: Top, options: CompensatedOption) -> Stepper:
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


_CHANGE = """
def change(s, h, p):
    u = ({zeros})
    status = nan
    iterations = 0.0
    for _ in range(NEWTON_LIMIT):
        iterations += 1.0
        v = newton(({state}{half}), h, p)
        correction = {correction}
        u = v
        if correction <= SETTLED * ({size}):
            status = 0.0
            break
    f = rates(({mean}), h, p)
    return ({changes}status, iterations)
"""


@lru_cache(maxsize=256)  # tops with one pattern share their machine code
def _generated_change(newton: NewtonStep, rates: Rates) -> Change:
    """Change in a step of the midpoint rule by Newton's method, with its status and the number of iterations.

    After the last iteration the change is evaluated from the field once more.
    """
    every = range(len(newton.field))
    text = _CHANGE.format(
        zeros="0.0, " * len(every),
        state="".join(f"s[{i}], " for i in every),
        half="".join(f"u[{i}], " for i in every),
        correction=" + ".join(f"abs(v[{i}] - u[{i}])" for i in every),
        size=" + ".join(f"abs(s[{i}])" for i in every),
        mean="".join(f"s[{i}] + u[{i}], " for i in every),
        changes="".join(f"f[{i}], " for i in every),
    )
    scope: dict[str, Any] = {
        "newton": function_of(newton.graph, "newton", newton.outputs),
        "rates": function_of(rates.graph, "rates", rates.outputs),
        "nan": math.nan,
        "NEWTON_LIMIT": NEWTON_LIMIT,
        "SETTLED": SETTLED,
        "__name__": __name__,
    }
    exec(compile(text, f"<midpoint rule {len(every)}>", "exec"), scope)
    return scope["change"]


@scheme(
    "midpoint",
    top=(),
    later=partial(required_field, needed_by="scheme 'midpoint'"),
    title="Implicit midpoint rule",
    order=2,
    explicit=False,
    self_adjoint=True,
    conserves=lambda top: polynomial_invariants(top, 2),
    citation="Cooper 1987",
    formula=r"y' = y + h\,f(\bar y)",
    equations="y' - y = h f((y' + y)/2)",
    options=CompensatedOption,
)
def build_generated(top: Top, options: CompensatedOption) -> Stepper:
    """Solved to round-off by Newton's method, whose step is generated from the field, a polynomial of any degree.

    If a step does not converge, the run ends as `no_convergence`. The step is self-adjoint. Every quadratic integral is
    conserved exactly.
    """
    field = required_field(top, "scheme 'midpoint'")
    constants = len(top.constants())
    newton = generated(NewtonStep, field, constants)
    rates = generated(Rates, field, constants + len(newton.constants))
    lost = range(len(field) * is_compensated(options))
    found = stepper(
        _generated_change(newton.code, rates.code), len(field), lost=lost, counters=("iterations",), iterative=True
    )
    return replace(found, constants=(*newton.constants, *rates.constants), generated=True)
