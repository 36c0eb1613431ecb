"""The implicit midpoint rule for every top with gravity.

The step is written for the general Euler-Poisson equations. The six coefficients of the top at hand are carried in
the working state, so that one piece of machine code serves all tops. Bobenko and Suris' inertial form of Lagrange's
top, m' = p x a, a' = m x a, is the same equations with omega = -m, gamma = a, equal moments and g = p.
"""

from __future__ import annotations

from topcli.contracts import Floats, NoOptions, Stepper, Top
from topcli.kernels.euler_poisson import midpoint
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
    v1, v2, v3, n1, n2, n3, status, more = midpoint((w1, w2, w3, g1, g2, g3), h, (A, B, C, x, y, z))
    return (v1, v2, v3, n1, n2, n3, A, B, C, x, y, z, status, iterations + more)


def leave(s: Floats, h: float, p: Floats) -> Floats:
    """Omega and gamma."""
    return (s[0], s[1], s[2], s[3], s[4], s[5])


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
    limits=lambda top: {"singular-step": LONG_NEWTON} if top.form == "heavy" else {},
)
def build(top: Top, options: NoOptions) -> Stepper:
    """Solved by Newton's iteration to round-off; a step that does not settle ends the run as `no_convergence`.

    Its own inverse under h -> -h. Every quadratic integral is conserved exactly, for any top: gamma², m·gamma and the
    energy. Kowalevski's k² is of degree four and only stays close.
    """
    if top.form == INERTIAL:
        return Stepper(midpoint_step, WIDTH, enter_inertial, leave_inertial, ("iterations",), iterative=True)
    equations = top.euler_poisson()
    coefficients = (*equations.moments, *equations.gravity)

    def enter(y: Floats, h: float, p: Floats) -> Floats:
        return (*y, *coefficients, 0.0, 0.0)

    return Stepper(midpoint_step, WIDTH, enter, leave, ("iterations",), iterative=True)
