"""The implicit midpoint rule for every top with gravity.

The step is written for the general Euler-Poisson equations. The six coefficients of the top at hand are carried in
the working state, so that one piece of machine code serves all tops. Bobenko and Suris' inertial form of Lagrange's
top, m' = p x a, a' = m x a, is the same equations with omega = -m, gamma = a, equal moments and g = p.

What makes it fast:
- given the mean omega Poisson's equation is Cayley's rotation in closed form: Newton has three unknowns, not six;
- its 3x3 systems are solved by Cramer's rule, the columns of the matrix from one reciprocal of 1 + |h omega/2|²;
- two iterations at h = 0.001, three at 0.01 and 0.1; one fewer would leave errors of one sign above round-off.
"""

from __future__ import annotations

from topcli.contracts import Floats, Stepper, Top, checked_equations
from topcli.kernels.euler_poisson import midpoint_change
from topcli.kernels.increments import carried_sums, first6
from topcli.schemes.compensated import CompensatedOption, compensation_wanted
from topcli.schemes.limits import LONG_NEWTON
from topcli.schemes.preserved import polynomial_invariants
from topcli.schemes.registry import scheme
from topcli.tops import TOPS

INERTIAL = "lagrange/inertial"
FORMS = tuple(form for form in ("heavy", "kowalevski", "lagrange", INERTIAL) if form in TOPS)

WIDTH = 14
"""omega, gamma; A, B, C, mg(x0, y0, z0); whether the iteration settled; the iterations so far."""


def midpoint_step(s: Floats, h: float, p: Floats) -> Floats:
    """One step of the working state."""
    w1, w2, w3, g1, g2, g3, A, B, C, x, y, z, _, iterations = s
    x1, x2, x3, y1, y2, y3, status, more = midpoint_change((w1, w2, w3, g1, g2, g3), h, (A, B, C, x, y, z))
    return (w1 + x1, w2 + x2, w3 + x3, g1 + y1, g2 + y2, g3 + y3, A, B, C, x, y, z, status, iterations + more)


def compensated_step(s: Floats, h: float, p: Floats) -> Floats:
    """One step of the working state with what the sums have lost, before the status."""
    w1, w2, w3, g1, g2, g3, A, B, C, x, y, z, e1, e2, e3, e4, e5, e6, _, iterations = s
    x1, x2, x3, y1, y2, y3, status, more = midpoint_change((w1, w2, w3, g1, g2, g3), h, (A, B, C, x, y, z))
    new, lost = carried_sums((w1, w2, w3, g1, g2, g3), (e1, e2, e3, e4, e5, e6), (x1, x2, x3, y1, y2, y3))
    return (*new, A, B, C, x, y, z, *lost, status, iterations + more)


def enter_inertial(y: Floats, h: float, p: Floats) -> Floats:
    """The working state of the inertial frame's m and a."""
    return (-y[0], -y[1], -y[2], y[3], y[4], y[5], 1.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0)


def leave_inertial(s: Floats, h: float, p: Floats) -> Floats:
    """The inertial frame's m and a."""
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
    equations="y' - y = h f((y' + y)/2) for EulerPoisson",
    options=CompensatedOption,
    limits=lambda top: {"singular-step": LONG_NEWTON} if top.form == "heavy" else {},
)
def build(top: Top, options: CompensatedOption) -> Stepper:
    """Solved by Newton's iteration to round-off; a step that does not settle ends the run as `no_convergence`.

    Its own inverse under h -> -h. Every quadratic integral is conserved exactly, for any top: gamma², m·gamma and the
    energy. Kowalevski's k² is of degree four and only stays close.
    """
    equations = checked_equations(top, "scheme 'midpoint'")
    coefficients = (*equations.moments, *equations.gravity)

    def enter_body(y: Floats, h: float, p: Floats) -> Floats:
        return (*y, *coefficients, 0.0, 0.0)

    inertial = top.form == INERTIAL
    enter, leave = (enter_inertial, leave_inertial) if inertial else (enter_body, first6)
    if not compensation_wanted(options):
        return Stepper(midpoint_step, WIDTH, enter, leave, ("iterations",), iterative=True)

    def enter_compensated(y: Floats, h: float, p: Floats) -> Floats:
        s = enter(y, h, p)
        return (*s[:12], *(0.0,) * 6, *s[12:])

    return Stepper(compensated_step, WIDTH + 6, enter_compensated, leave, ("iterations",), iterative=True)
