"""Discrete Moser-Veselov step of the free body, between kicks by gravity (RATTLE).

The rotation of a step is that of the quaternion (e0, e) with h m_i = 2 (I_i e0 e_i + (I_k - I_j) e_j e_k), (i, j, k)
cyclic. Divided by 2 e0² this is a quadratic equation for the Cayley vector c = e/e0, without a square root::

    c_i = k_i (1 + |c|²) - r_i c_j c_k,    k_i = h m_i/(2 I_i),    r_i = (I_k - I_j)/I_i

and the step is the Cayley rotation of m and gamma by c. With d_i = (A + B + C)/2 - I_i > 0 it has a solution where the
matrix diag(d²) - (h/2)² (|m|² - m m^T) is positive definite (Cardoso, Leite 2003), thus in every direction of m if
h |m| < 2 min d_i; the solution near 0 often exists for longer steps. For equal moments the limit is h |omega| = 1.

For a free body the map conserves m² and the energy and is integrable (Moser, Veselov 1991). It moves on the exact orbit
of m, with an error in time alone.

Performance: two fixed-point iterations, one Newton correction and two with the same matrix are enough for h |omega| up
to about 0.3; they need no loop and one division, so that ensembles are vectorised. A loop of Newton corrections goes on
where they do not suffice.
"""

from __future__ import annotations

import math
from functools import partial

from topcli.arithmetic.fused import fma, follow_precision, unlikely
from topcli.arithmetic.vectors import VECTOR_VARIANTS, Matrix, Vector, cayley_increment, solve3
from topcli.contracts import Floats, NoOptions, Stepper, Top
from topcli.schemes.any_top.splitting import KEPT, kicked
from topcli.schemes.registry import all_invariants, scheme
from topcli.tops.bodies import checked_equations

NEEDED_BY = "scheme 'dmv'"
CORRECTIONS = 3.0
"""Corrections of every step."""
_NEWTON_LIMIT = 30
"""Maximum number of Newton corrections beyond them; four to six are typical."""
LAST_BIT = 2.0**-50
"""Correction relative to c that is round-off."""
follow_precision(__name__, caps=("_NEWTON_LIMIT",), LAST_BIT=1)
_Solution = Floats
"""Cayley vector of a step, the status of the iteration (0.0 or nan), and the number of corrections."""


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
    row1 = (fma(-k[0], t1, 1.0), fma(-k[0], t2, r[0] * c3), fma(-k[0], t3, r[0] * c2))
    row2 = (fma(-k[1], t1, r[1] * c3), fma(-k[1], t2, 1.0), fma(-k[1], t3, r[1] * c1))
    row3 = (fma(-k[2], t1, r[2] * c2), fma(-k[2], t2, r[2] * c1), fma(-k[2], t3, 1.0))
    return (*row1, *row2, *row3)


def size(x: Vector) -> float:
    """Sum of the magnitudes of three components."""
    return abs(x[0]) + (abs(x[1]) + abs(x[2]))


def corrected(c: Vector, matrix: Matrix, k: Vector, r: Vector) -> tuple[Vector, Vector]:
    """Cayley vector after a Newton correction with the derivative ``matrix``, and the correction."""
    f1, f2, f3 = residual(c, k, r)
    e1, e2, e3 = solve3(matrix, f1, f2, f3)
    return (c[0] - e1, c[1] - e2, c[2] - e3), (e1, e2, e3)


def newton_from_zero(k: Vector, r: Vector) -> _Solution:
    """Cayley vector on the branch through 0, by Newton's method; its status, and the number of corrections.

    From thousands of random states it converged to this branch or not at all. Without a solution c is 0, so that the
    step fails with the old state.
    """
    c: Vector = k
    count = 0.0
    for _ in range(_NEWTON_LIMIT):
        count += 1.0
        c, e = corrected(c, jacobian(c, k, r), k, r)
        if size(e) <= LAST_BIT * size(c):
            return (c[0], c[1], c[2], 0.0, count)
    return (0.0, 0.0, 0.0, math.nan, count)


def given_up(k: Vector, r: Vector) -> _Solution:
    """Not a number: the trajectory needs a scalar step."""
    return (math.nan, math.nan, math.nan, math.nan, 0.0)


VECTOR_VARIANTS[newton_from_zero] = given_up


def cayley_vector(k: Vector, r: Vector) -> _Solution:
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


def free(m: Vector, g: Vector, c: Floats, h: float) -> tuple[Vector, Vector, Vector, Floats]:
    """Changes of m and gamma, the new gamma; status and count. ``c`` are the inverse moments and the r_i."""
    d, r = 0.5 * h, (c[3], c[4], c[5])
    c1, c2, c3, status, more = cayley_vector(((d * c[0]) * m[0], (d * c[1]) * m[1], (d * c[2]) * m[2]), r)
    b1, b2, b3 = cayley_increment(c1, c2, c3, g[0], g[1], g[2])
    return momentum_change((c1, c2, c3), m, r), (b1, b2, b3), (g[0] + b1, g[1] + b2, g[2] + b3), (status, more)


@scheme(
    "dmv",
    top=None,
    requires=partial(checked_equations, needed_by=NEEDED_BY),
    order=2,
    explicit=False,
    self_adjoint=True,
    conserves=lambda top: all_invariants(top) if top.form in ("euler", "euler+gamma") else KEPT.get(top.form, ()),
)
def build_dmv(top: Top, options: NoOptions) -> Stepper:
    r"""Discrete Moser-Veselov scheme (RATTLE).

    A kick (gravity alone for h/2), a discrete Moser-Veselov step of the free body for h, and another kick for h/2.

    The scheme is implicit, self-adjoint and canonical (a Poisson map). `dmv` conserves gamma² and m·gamma; the
    deviation of the energy oscillates, is of size h² and does not drift. For a free body the scheme is the integrable
    Moser-Veselov map, which also conserves m² and the energy.

    If |h| |omega| exceeds about 1, a step has no solution, and the run ends as `no_convergence`.

    Source
    ------
    Moser, Veselov 1991; McLachlan, Scovel 1995; McLachlan, Zanna 2005 (equal to RATTLE)

    Equations
    ---------
    kick h/2 by gamma x g, rotation of m and gamma by the quaternion (e0, e) with h m_i = 2 (I_i e0 e_i + (I_k - I_j)
    e_j e_k), kick h/2

    Formula
    -------
    m^- = m + \tfrac h2\,\gamma\times r, \qquad
    h\,m^-_i = 2\,\bigl(I_i e_0 e_i + (I_k - I_j)\,e_j e_k\bigr), \quad e_0^2 + |e|^2 = 1,
    \quad (i, j, k) \text{ cyclic}

    v \mapsto v + 2e_0\,v\times e + 2\,(v\times e)\times e \ \text{ takes } m^-, \gamma \text{ to } m^+, \gamma'

    m' = m^+ + \tfrac h2\,\gamma'\times r

    Limits
    ------
    resonance (euler, euler+gamma, heavy, kowalevski, lagrange, lagrange/inertial)
        If h is longer than about 1/|omega|, the equation for the rotation of the body in a step has no solution.
        The run then ends as `no_convergence`.
    singular-step (euler, euler+gamma, heavy, kowalevski, lagrange), long steps (goryachev-chaplygin, hess-appelrot)
        If h is longer than about 1/|omega|, the equation for the rotation of the body in a step has no solution.
        The run then ends as `no_convergence`.
    """
    equations = checked_equations(top, NEEDED_BY)
    A, B, C = equations.moments
    r = ((C - B) / A, (A - C) / B, (B - A) / C)
    return kicked(top, equations, free, r, ("iterations",), needed_by=NEEDED_BY)
