"""Discrete Moser-Veselov step of the free body, between kicks by gravity (RATTLE).

The rotation of a step is that of the quaternion (e0, e) with h m_i = 2 (I_i e0 e_i + (I_k - I_j) e_j e_k), (i, j, k)
cyclic. Divided by 2 e0² this is a quadratic equation for the Cayley vector c = e/e0, without a square root::

    c_i = k_i (1 + |c|²) - r_i c_j c_k,    k_i = h m_i/(2 I_i),    r_i = (I_k - I_j)/I_i

and the step is the Cayley rotation of m and gamma by c. With d_i = (A + B + C)/2 - I_i > 0 it has a solution where the
matrix diag(d²) - (h/2)² (|m|² - m m^T) is positive definite (Cardoso, Leite 2003), thus in every direction of m if
h |m| < 2 min d_i; the solution near 0 often exists for longer steps. For equal moments the limit is h |omega| = 1.

For a free body the map conserves m² and the energy and is integrable (Moser, Veselov 1991). It moves on the exact orbit
of m, with an error in time alone. Hairer and Vilmart replace the moments by modified ones that depend on the constants
of the motion, which makes time and attitude accurate to order 4, 6, 8 or 10.

Performance: two fixed-point iterations, one Newton correction and two with the same matrix are enough for h |omega| up
to about 0.3; they need no loop and one division, so that ensembles are vectorised. A loop of Newton corrections goes on
where they do not suffice.

Moments of inertia with which the discrete Moser-Veselov step of a free body has order 4, 6, 8 or 10.

Hairer and Vilmart (2006) replace each inverse moment by 1/I_i (1 + s) + d. With s and d power series in h² whose
coefficients are polynomials in the constants of the motion C = m²/2 and H, the step becomes the exact motion; cut off
after h^(n - 2) it has order n. With a = h² C, b = h² H, and the elementary symmetric functions e1, e2, e3 of the
inverse moments::

    s = e2 a/6 - e1 b/3 + ...,    d = e2 b/6 - e3 a/3 + ...

The coefficients were derived from the condition that the Cayley vector of the step equals that of the motion, order by
order, in rational arithmetic, for enough bodies and states to determine all polynomials and to check them; the tests
measure the orders. The functions take floats or fractions. Coefficients that an order does not use cost nothing: the
compiler omits them and moves the others out of the loop.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Literal

from pydantic import Field

from topcli.arithmetic.fused import fma, follow_precision, unlikely
from topcli.arithmetic.vectors import VECTOR_VARIANTS, Matrix, Vector, cayley_increment, solve3
from topcli.contracts import EulerPoisson, Floats, Integrability, Stepper, Top, checked_equations
from topcli.errors import UsageError
from topcli.schemes.any_top.splitting import KEPT, entering, inverse_moments, kick, leaving, state_length
from topcli.schemes.layout import NO_LONG_STEP, Change, CompensatedOption, all_invariants, stepper
from topcli.schemes.registry import scheme

ORDERS = (4, 6, 8, 10)
Series = Callable[[Floats, float, float], float]


def scale_coefficients(e1: float, e2: float, e3: float) -> Floats:
    """Coefficients in s of a, b, a², ab, b², ..., up to the terms of degree four."""
    s11, s22, s33 = e1 * e1, e2 * e2, e3 * e3
    return (
        e2 / 6,
        -e1 / 3,
        -e1 * e3 / 10 + s22 / 30,
        -e1 * e2 / 30 + 2 * e3 / 15,
        s11 / 30 - e2 / 60,
        -11 * (e1 * e2 * e3) / 420 + 17 * (s22 * e2) / 2520 + 5 * s33 / 126,
        11 * (s11 * e3) / 210 - e1 * s22 / 70 - e2 * e3 / 84,
        s11 * e2 / 420 - 53 * (e1 * e3) / 630 + 41 * s22 / 2520,
        -s11 * e1 / 630 + e1 * e2 / 630 + e3 / 35,
        s11 * s33 / 120 - 19 * (e1 * s22 * e3) / 2520 + 31 * (s22 * s22) / 22680 + 97 * (e2 * s33) / 15120,
        17 * (s11 * e2 * e3) / 1260 - 11 * (e1 * s22 * e2) / 3240 - 47 * (e1 * s33) / 945 + 47 * (s22 * e3) / 7560,
        -17 * (s11 * e1 * e3) / 1260 + 13 * (s11 * s22) / 3780 + e1 * e2 * e3 / 252 + s22 * e2 / 2520 + 53 * s33 / 1260,
        -s11 * e1 * e2 / 11340 + 23 * (s11 * e3) / 945 - 11 * (e1 * s22) / 1890 - 23 * (e2 * e3) / 1260,
        s11 * s11 / 22680 - s11 * e2 / 15120 - 3 * (e1 * e3) / 280 + 17 * s22 / 5040,
    )


def shift_coefficients(e1: float, e2: float, e3: float) -> Floats:
    """Coefficients in d of a, b, a², ab, b², ..., up to the terms of degree four."""
    s11, s22, s33 = e1 * e1, e2 * e2, e3 * e3
    return (
        -e3 / 3,
        e2 / 6,
        -e2 * e3 / 60,
        2 * (e1 * e3) / 15 - s22 / 60,
        -e1 * e2 / 60 - e3 / 10,
        e1 * s33 / 35 - 19 * (s22 * e3) / 2520,
        -e1 * e2 * e3 / 1260 + s22 * e2 / 1260 - 22 * s33 / 315,
        -8 * (s11 * e3) / 315 + 13 * (e1 * s22) / 2520 + 11 * (e2 * e3) / 252,
        s11 * e2 / 1260 + e1 * e3 / 42 - 13 * s22 / 1260,
        3 * (e1 * e2 * s33) / 560 - 61 * (s22 * e2 * e3) / 45360 - 61 * (s33 * e3) / 4536,
        -2 * (s11 * s33) / 105 + 37 * (e1 * s22 * e3) / 7560 - s22 * s22 / 45360 + 19 * (e2 * s33) / 1260,
        19 * (s11 * e2 * e3) / 7560 - e1 * s22 * e2 / 1512 + 89 * (e1 * s33) / 1890 - 19 * (s22 * e3) / 1080,
        8 * (s11 * e1 * e3) / 2835 - s11 * s22 / 1512 - 23 * (e1 * e2 * e3) / 1890 + 97 * (s22 * e2) / 22680 - s33 / 35,
        -s11 * e1 * e2 / 45360 - s11 * e3 / 360 - e1 * s22 / 7560 + 17 * (e2 * e3) / 1680,
    )


def series4(c: Floats, a: float, b: float) -> float:
    """Terms of degree one in a and b."""
    return c[0] * a + c[1] * b


def series6(c: Floats, a: float, b: float) -> float:
    """Terms of degrees one and two."""
    return series4(c, a, b) + (c[2] * (a * a) + (c[3] * (a * b) + c[4] * (b * b)))


def series8(c: Floats, a: float, b: float) -> float:
    """Terms of degrees one to three."""
    aa, bb = a * a, b * b
    return series6(c, a, b) + ((c[5] * a + c[6] * b) * aa + (c[7] * a + c[8] * b) * bb)


def series10(c: Floats, a: float, b: float) -> float:
    """Terms of degrees one to four."""
    aa, ab, bb = a * a, a * b, b * b
    return series8(c, a, b) + ((c[9] * aa + c[10] * ab) * aa + (c[11] * aa + (c[12] * ab + c[13] * bb)) * bb)


SERIES: dict[int, Series] = {4: series4, 6: series6, 8: series8, 10: series10}


def modified_inverse_moments(series: Series, i: Floats, a: float, b: float) -> tuple[float, float]:
    """Return 1 + s and d for the inverse moments ``i``."""
    i1, i2, i3 = i
    e1, e2, e3 = i1 + (i2 + i3), i2 * i3 + (i3 * i1 + i1 * i2), i1 * (i2 * i3)
    return 1 + series(scale_coefficients(e1, e2, e3), a, b), series(shift_coefficients(e1, e2, e3), a, b)


NEEDED_BY = "scheme 'dmv'"
CORRECTIONS = 3.0
"""Corrections of every step."""
NEWTON_LIMIT = 30
"""Maximum number of Newton corrections beyond them; four to six are typical."""
HALVINGS, BISECTIONS = 64, 10
"""Steps of the search for the longest step."""
LONG_STEPS = {
    **dict.fromkeys(("euler", "euler+gamma", "heavy", "kowalevski", "lagrange"), ("resonance", "singular-step")),
    "lagrange/inertial": ("resonance",),
}
"""Hard cases of the paper's tops in which the steps are too long."""
LAST_BIT = 2.0**-50
"""Correction relative to c that is round-off."""
follow_precision(__name__, caps=("NEWTON_LIMIT",), LAST_BIT=1)
Solution = Floats
"""Cayley vector of a step, the status of the iteration (0.0 or nan), and the number of corrections."""
Rotation = Callable[[Vector, Floats, float], Solution]


class DmvOptions(CompensatedOption):
    """Options: modified moments, compensated sums."""

    moments: Literal["plain", "preprocessed"] = Field(
        default="plain",
        description="moments of inertia in the step: those of the top (plain), or modified ones that give the motion "
        "of a free body a higher order (preprocessed)",
    )
    order: Literal[4, 6, 8, 10] = Field(
        default=4, description="order of a step of the free body with preprocessed moments of inertia"
    )


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


def corrected(c: Vector, matrix: Matrix, k: Vector, r: Vector) -> tuple[Vector, Vector]:
    """Cayley vector after a Newton correction with the derivative ``matrix``, and the correction."""
    f1, f2, f3 = residual(c, k, r)
    e1, e2, e3 = solve3(matrix, f1, f2, f3)
    return (c[0] - e1, c[1] - e2, c[2] - e3), (e1, e2, e3)


def newton_from_zero(k: Vector, r: Vector) -> Solution:
    """Cayley vector on the branch through 0, by Newton's method; its status, and the number of corrections.

    From thousands of random states it converged to this branch or not at all. Without a solution c is 0, so that the
    step fails with the old state.
    """
    c: Vector = k
    count = 0.0
    for _ in range(NEWTON_LIMIT):
        count += 1.0
        c, e = corrected(c, jacobian(c, k, r), k, r)
        if size(e) <= LAST_BIT * size(c):
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
    c, _ = corrected(c, matrix, k, r)
    c, a = corrected(c, matrix, k, r)
    (c1, c2, c3), b = corrected(c, matrix, k, r)
    # the next correction would be last**2/before
    before, last, bits = size(a), size(b), LAST_BIT * size((c1, c2, c3))
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

    def fails(size: float) -> bool:
        try:
            return math.isnan(rotation(m, c, size)[3])
        except ZeroDivisionError:  # a singular matrix; compiled code divides without an exception
            return True

    low, high = 0.0, h
    for _ in range(HALVINGS):
        if not fails(high):
            break
        low, high = high, 0.5 * high
    else:
        return 0.0
    if low == 0.0:
        return 0.0
    good, bad = high, low
    for _ in range(BISECTIONS):
        middle = 0.5 * (good + bad)
        good, bad = (good, middle) if fails(middle) else (middle, bad)
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
    "by matrix factorization (Moser, Veselov 1991)",
    "Lie-Poisson bracket of so(3), or of e(3) if gamma is computed",
    "lie-poisson",
)


@scheme(
    "dmv",
    top=None,
    later=partial(checked_equations, needed_by=NEEDED_BY),
    title="Discrete Moser-Veselov scheme (RATTLE)",
    order=2,
    explicit=False,
    self_adjoint=True,
    conserves=lambda top: all_invariants(top) if top.form in ("euler", "euler+gamma") else KEPT.get(top.form, ()),
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
    """A kick (gravity alone for h/2), a discrete Moser-Veselov step of the free body for h, and another kick for h/2.

    The scheme is implicit, self-adjoint and canonical (a Poisson map). `dmv` conserves gamma² and m·gamma; the
    deviation of the energy oscillates, is of size h² and does not drift. For a free body the scheme is the integrable
    Moser-Veselov map, which also conserves m² and the energy.

    With `moments: preprocessed`, the map of the free body has order 4, 6, 8 or 10 (option `order`) for both m and
    gamma. A step takes hardly longer than with `moments: plain`.

    If |h| |omega| exceeds about 1, a step has no solution, and the run ends as `no_convergence`.
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
