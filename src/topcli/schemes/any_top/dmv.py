"""Discrete Moser-Veselov step of the free body, between kicks by gravity (RATTLE).

The rotation of a step is that of the quaternion (e0, e) with h m_i = 2 (I_i e0 e_i + (I_k - I_j) e_j e_k), (i, j, k)
cyclic. Divided by 2 e0² this is a quadratic equation for the Cayley vector c = e/e0, without a square root::

    c_i = k_i (1 + |c|²) - r_i c_j c_k,    k_i = h m_i/(2 I_i),    r_i = (I_k - I_j)/I_i

and the step is the Cayley rotation of m and gamma by c. With d_i = (A + B + C)/2 - I_i > 0 it has a solution where the
matrix diag(d²) - (h/2)² (|m|² - m m^T) is positive definite (Cardoso, Leite 2003), thus in every direction of m if
h |m| < 2 min d_i; the solution near 0 often exists for longer steps. For equal moments the limit is h |omega| = 1.

For a free body the map conserves m² and the energy and is integrable (Moser, Veselov 1991). It moves on the exact orbit
of m, with an error in time alone. Hairer and Vilmart replace the moments by modified ones that depend on the constants
of the motion, which makes time and attitude accurate to order 4, 6, 8 or 10 (``preprocessed``).

Performance: two fixed-point iterations, one Newton correction and two with the same matrix are enough for h |omega| up
to about 0.3; they need no loop and one division, so that ensembles are vectorised. A loop of Newton corrections goes on
where they do not suffice.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Literal

from pydantic import Field

from topcli.arithmetic.branches import unlikely
from topcli.arithmetic.fused import fma
from topcli.arithmetic.linear import Matrix, solve3
from topcli.arithmetic.rotations import VECTOR_VARIANTS, Vector, cayley_increment
from topcli.arithmetic.tolerances import follow_precision
from topcli.contracts import EulerPoisson, Floats, Integrability, Stepper, Top, checked_equations
from topcli.errors import UsageError
from topcli.schemes.any_top.momentum import KEPT, entering, inverse_moments, kick, leaving, state_length
from topcli.schemes.any_top.preprocessed import ORDERS, SERIES, modified_inverse_moments
from topcli.schemes.layout import Change, CompensatedOption, stepper
from topcli.schemes.limits import NO_LONG_STEP
from topcli.schemes.registry import scheme

NEEDED_BY = "scheme 'dmv'"
CORRECTIONS = 3.0
"""Corrections of every step."""
NEWTON_LIMIT = 30
"""Maximum number of Newton corrections beyond them; four to six are typical."""
HALVINGS, BISECTIONS = 64, 10
"""Steps of the search for the longest step."""
LONG_STEPS = dict.fromkeys(KEPT, ("resonance", "singular-step")) | {"lagrange/inertial": ("resonance",)}
"""Hard cases of each built-in top in which the steps are too long."""
LAST_BIT = 2.0**-50
"""Correction relative to c that is round-off."""
follow_precision(__name__, caps=("NEWTON_LIMIT",), LAST_BIT=1)
Solution = tuple[float, float, float, float, float]
Rotation = Callable[[Vector, Floats, float], Solution]


class DmvOptions(CompensatedOption):
    """Options: modified moments, compensated sums."""

    moments: Literal["plain", "preprocessed"] = Field(
        default="plain",
        description="moments of inertia of the step: those of the top, or modified ones that make the motion of a free "
        "body accurate to the given order",
    )
    order: Literal[4, 6, 8, 10] = Field(default=4, description="order of a step with preprocessed moments")


def residual(c: Vector, k: Vector, r: Vector) -> Vector:
    """Residual of the quadratic equation for c."""
    c1, c2, c3 = c
    q = fma(c1, c1, 1.0) + fma(c2, c2, c3 * c3)
    return (
        fma(r[0], c2 * c3, fma(-k[0], q, c1)),
        fma(r[1], c3 * c1, fma(-k[1], q, c2)),
        fma(r[2], c1 * c2, fma(-k[2], q, c3)),
    )


def fixed_point(c: Vector, k: Vector, r: Vector) -> Vector:
    """Right-hand side of the equation for c."""
    c1, c2, c3 = c
    q = fma(c1, c1, 1.0) + fma(c2, c2, c3 * c3)
    return (
        fma(k[0], q, -(r[0] * (c2 * c3))),
        fma(k[1], q, -(r[1] * (c3 * c1))),
        fma(k[2], q, -(r[2] * (c1 * c2))),
    )


def jacobian(c: Vector, k: Vector, r: Vector) -> Matrix:
    """Derivative of ``residual``, in row-major order."""
    c1, c2, c3 = c
    t1, t2, t3 = 2.0 * c1, 2.0 * c2, 2.0 * c3
    return (
        fma(-k[0], t1, 1.0),
        fma(-k[0], t2, r[0] * c3),
        fma(-k[0], t3, r[0] * c2),
        fma(-k[1], t1, r[1] * c3),
        fma(-k[1], t2, 1.0),
        fma(-k[1], t3, r[1] * c1),
        fma(-k[2], t1, r[2] * c2),
        fma(-k[2], t2, r[2] * c1),
        fma(-k[2], t3, 1.0),
    )


def size(x: Vector) -> float:
    """Sum of the magnitudes of three components."""
    return abs(x[0]) + (abs(x[1]) + abs(x[2]))


def newton_from_zero(k: Vector, r: Vector) -> Solution:
    """Cayley vector on the branch through 0, by Newton's method; its status, and the number of corrections.

    From thousands of random states it converged to this branch or not at all. Without a solution c is 0, so that the
    step fails with the old state.
    """
    c: Vector = k
    count = 0.0
    for _ in range(NEWTON_LIMIT):
        count += 1.0
        f1, f2, f3 = residual(c, k, r)
        e1, e2, e3 = solve3(jacobian(c, k, r), f1, f2, f3)
        c = (c[0] - e1, c[1] - e2, c[2] - e3)
        if size((e1, e2, e3)) <= LAST_BIT * size(c):
            return (c[0], c[1], c[2], 0.0, count)
    return (0.0, 0.0, 0.0, math.nan, count)


def given_up(k: Vector, r: Vector) -> Solution:
    """Not a number: the trajectory needs a scalar step."""
    return (math.nan, math.nan, math.nan, math.nan, 0.0)


VECTOR_VARIANTS[newton_from_zero] = given_up


def cayley_vector(k: Vector, r: Vector) -> Solution:
    """Cayley vector c of the step, the status of the iteration (0.0 or nan), and the number of corrections."""
    c = fixed_point(fixed_point(k, k, r), k, r)
    matrix = jacobian(c, k, r)
    f1, f2, f3 = residual(c, k, r)
    a1, a2, a3 = solve3(matrix, f1, f2, f3)
    c = (c[0] - a1, c[1] - a2, c[2] - a3)
    f1, f2, f3 = residual(c, k, r)
    a1, a2, a3 = solve3(matrix, f1, f2, f3)
    c = (c[0] - a1, c[1] - a2, c[2] - a3)
    f1, f2, f3 = residual(c, k, r)
    b1, b2, b3 = solve3(matrix, f1, f2, f3)
    c1, c2, c3 = c[0] - b1, c[1] - b2, c[2] - b3
    # the next correction would be last**2/before
    before, last, bits = size((a1, a2, a3)), size((b1, b2, b3)), LAST_BIT * size((c1, c2, c3))
    status, count = 0.0, CORRECTIONS
    if unlikely(not (last <= bits or 16.0 * last * last <= before * bits)):
        c1, c2, c3, status, more = newton_from_zero(k, r)
        count += more
    return (c1, c2, c3, status, count)


def momentum_change(c: Vector, m: Vector, r: Vector) -> Vector:
    """Change of m in the rotation by c; exactly zero along an axis of symmetry, for which r_i = 0."""
    x1, x2, x3 = cayley_increment(c[0], c[1], c[2], m[0], m[1], m[2])
    return (x1 if r[0] != 0.0 else 0.0, x2 if r[1] != 0.0 else 0.0, x3 if r[2] != 0.0 else 0.0)


def plain_rotation(m: Vector, c: Floats, h: float) -> Solution:
    """Cayley vector of a step; ``c`` are the inverse moments and the r_i."""
    d = 0.5 * h
    return cayley_vector(((d * c[0]) * m[0], (d * c[1]) * m[1], (d * c[2]) * m[2]), (c[3], c[4], c[5]))


def preprocessed_rotation(order: int) -> Rotation:
    """Return the rotation of a step of the given order; its coefficients are the inverse moments and differences."""
    series = SERIES[order]

    def rotation(m: Vector, c: Floats, h: float) -> Solution:
        i1, i2, i3, d1, d2, d3 = c
        t1, t2, t3 = m[0] * m[0], m[1] * m[1], m[2] * m[2]
        half = 0.5 * (h * h)
        a, b = half * (t1 + (t2 + t3)), half * (t1 * i1 + (t2 * i2 + t3 * i3))
        s, e = modified_inverse_moments(series, (i1, i2, i3), a, b)
        j1, j2, j3 = fma(i1, s, e), fma(i2, s, e), fma(i3, s, e)
        d = 0.5 * h
        r = ((j1 * (s * d1)) / (j2 * j3), (j2 * (s * d2)) / (j3 * j1), (j3 * (s * d3)) / (j1 * j2))
        return cayley_vector(((d * j1) * m[0], (d * j2) * m[1], (d * j3) * m[2]), r)

    return rotation


def coefficients(equations: EulerPoisson, options: DmvOptions) -> Floats:
    """Coefficients of the rotation after the inverse moments."""
    i1, i2, i3 = inverse_moments(equations)
    A, B, C = equations.moments
    if options.moments == "plain":
        return ((C - B) / A, (A - C) / B, (B - A) / C)
    return ((C - B) * (i2 * i3), (A - C) * (i3 * i1), (B - A) * (i1 * i2))


def longest_step(rotation: Rotation, m: Vector, c: Floats, h: float) -> float:
    """Largest step, in size, of the sign of ``h`` that has a solution for m, to three digits.

    0.0 if there is none down to 2^-64 of ``h``.
    """
    low, high = 0.0, h
    for _ in range(HALVINGS):
        if not math.isnan(rotation(m, c, high)[3]):
            break
        low, high = high, 0.5 * high
    else:
        return 0.0
    if low == 0.0:
        return 0.0
    good, bad = high, low
    for _ in range(BISECTIONS):
        middle = 0.5 * (good + bad)
        good, bad = (good, middle) if math.isnan(rotation(m, c, middle)[3]) else (middle, bad)
    return good


def advice_with(rotation: Rotation, d: int) -> Callable[[Sequence[float], float], str]:
    """Return the hint of a run that did not converge, from its working state of (m, gamma) or m."""

    def advice(work: Sequence[float], h: float) -> str:
        m, c = (work[0], work[1], work[2]), tuple(work[d : d + 6])
        longest = longest_step(rotation, m, c, h)
        return f"the largest h that works from there is about {longest:.3g}" if longest else ""

    return advice


def free_change(rotation: Rotation) -> Change:
    """Return the change of m; the coefficients of the top follow m."""

    def change(s: Floats, h: float, p: Floats) -> Floats:
        m, c = (s[0], s[1], s[2]), s[3:9]
        c1, c2, c3, status, more = rotation(m, c, h)
        return (*momentum_change((c1, c2, c3), m, (c[3], c[4], c[5])), status, more)

    return change


def heavy_change(rotation: Rotation) -> Change:
    """Return the change of m and gamma, half a kick, the rotation, half a kick; coefficients and weight follow."""

    def change(s: Floats, h: float, p: Floats) -> Floats:
        g1, g2, g3, c = s[3], s[4], s[5], s[6:12]
        x, y, z = s[12:15]
        d = 0.5 * h
        u1, u2, u3 = kick(d, g1, g2, g3, x, y, z)
        m: Vector = (s[0] + u1, s[1] + u2, s[2] + u3)
        c1, c2, c3, status, more = rotation(m, c, h)
        a1, a2, a3 = momentum_change((c1, c2, c3), m, (c[3], c[4], c[5]))
        b1, b2, b3 = cayley_increment(c1, c2, c3, g1, g2, g3)
        v1, v2, v3 = kick(d, g1 + b1, g2 + b2, g3 + b3, x, y, z)
        return ((u1 + v1) + a1, (u2 + v2) + a2, (u3 + v3) + a3, b1, b2, b3, status, more)

    return change


FREE_MAP = Integrability(
    "by matrix factorization (Moser, Veselov 1991)", "Lie-Poisson bracket of so(3), or e(3) with gamma", "lie-poisson"
)


@scheme(
    "dmv",
    top=None,
    title="Discrete Moser-Veselov scheme (RATTLE)",
    order=2,
    explicit=False,
    self_adjoint=True,
    conserves=lambda top: (
        tuple(one.name for one in top.invariants()) if top.form in ("euler", "euler+gamma") else KEPT.get(top.form, ())
    ),
    citation="Moser, Veselov 1991; McLachlan, Scovel 1995; McLachlan, Zanna 2005 (equal to RATTLE, preprocessed); "
    "Hairer, Vilmart 2006 (preprocessed)",
    formula=r"""
m^- = m + \tfrac h2\,\gamma\times r, \qquad
h\,m^-_i = 2\,\bigl(I_i e_0 e_i + (I_k - I_j)\,e_j e_k\bigr), \quad e_0^2 + |e|^2 = 1, \quad (i, j, k) \text{ cyclic}

v \mapsto v + 2e_0\,v\times e + 2\,(v\times e)\times e \ \text{ takes } m^-, \gamma \text{ to } m^+, \gamma'

m' = m^+ + \tfrac h2\,\gamma'\times r
""",
    equations="kick h/2 by gamma x g, rotation of m and gamma by the quaternion (e0, e) with "
    "h m_i = 2 (I_i e0 e_i + (I_k - I_j) e_j e_k), kick h/2",
    options=DmvOptions,
    limits=lambda top: dict.fromkeys(LONG_STEPS.get(top.form, ("long steps",)), NO_LONG_STEP),
    integrable=lambda top: FREE_MAP if top.form in ("euler", "euler+gamma") else None,
    order_with=lambda options: options.order if options.moments == "preprocessed" else 2,
)
def build(top: Top, options: DmvOptions) -> Stepper:
    """Discrete Moser-Veselov rotation of m and gamma between two half kicks by gravity.

    Implicit, self-adjoint and canonical: gamma² and m·gamma are exact, the energy oscillates by h² and does not drift.
    For a free body it is the integrable Moser-Veselov map, which keeps m² and the energy as well; with
    `moments: preprocessed` it has order 4, or 6, 8 or 10 with `order`, in m and in gamma, at nearly the same cost. If
    |h| |omega| is too large, of the order of 1, a step has no solution and the run ends as `no_convergence`.
    """
    equations = checked_equations(top, NEEDED_BY)
    d = state_length(top, NEEDED_BY)
    if options.moments == "preprocessed" and any(equations.gravity):
        raise UsageError(
            "moments: preprocessed needs a free body, and this top has weight; use moments: plain, "
            "and a composition such as dmv+kahan-li6 for a higher order"
        )
    if options.moments == "plain" and options.order != ORDERS[0]:
        raise UsageError(f"order: {options.order} needs moments: preprocessed; with plain moments the order is 2")
    rotation = plain_rotation if options.moments == "plain" else preprocessed_rotation(options.order)
    c = coefficients(equations, options)
    return stepper(
        free_change(rotation) if d == 3 else heavy_change(rotation),
        d,
        6 if d == 3 else 9,
        lost=range(d * options.compensated),
        counters=("iterations",),
        iterative=True,
        enter=entering(equations, d, c if d == 3 else (*c, *equations.gravity)),
        leave=leaving(equations, d),
        advice=advice_with(rotation, d),
    )
