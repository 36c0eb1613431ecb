"""What several schemes declare: limits, formulas in LaTeX, and polynomial invariants of low degree.

Conventions of the formulas are those of ``contracts.Scheme``. Every Runge-Kutta method conserves linear invariants; the
implicit midpoint rule also conserves quadratic ones (Cooper 1987).
"""

from __future__ import annotations

from collections.abc import Mapping
from math import comb

import numpy as np

from topcli.contracts import Top

SINGULAR = (
    "For certain step sizes of the order of 1/|omega| and larger, the determinant of the linear system vanishes, and "
    "the new state is limited only by round-off. Such solves are counted; choose |h| |omega| well below 1."
)
LONG_HK = (
    "With steps of about one revolution the determinant changes sign along the motion, and the state jumps far away "
    "whenever the determinant is close to zero."
)
NO_SOLUTION = (
    "With steps of about one revolution or more, Newton's method may find no solution from HK's prediction; the run "
    "ends as `no_convergence`."
)
FAR_OVERFLOW = (
    "The determinant of Newton's equations is cubic in omega and overflows beyond |omega| of about 1e103; the run ends "
    "as `no_convergence`."
)
LONG_NEWTON = (
    "With steps of several units of time the equations may have no solution near the old state, and Newton's method "
    "does not converge; the run ends as `no_convergence`."
)
NO_LONG_STEP = (
    "A step turns the body by less than half a turn and has no solution beyond a length of the order of 1/|omega|; "
    "the run ends as `no_convergence` and names the largest h that works."
)
LONG_SPLITTING = (
    "With steps of several radians the kicks and rotations are no longer close to any motion: the energy wanders off "
    "by several times its size."
)
NEWTON_SINGULAR = (
    "The iteration starts from HK's step, which is singular for this h, and does not converge; the run ends as "
    "`no_convergence`."
)
OVERFLOW = (
    "|xi|² is quartic in omega and overflows beyond |omega| of about 1e77. Choose a unit of time in which omega has a "
    "moderate size."
)
NO_FAR_STEPS = (
    "The method is explicit and does not conserve the energy: with steps of about one revolution the state grows "
    "without bound within a few steps."
)


def explicit_limits(top: Top) -> Mapping[str, str]:
    """Limits of explicit Runge-Kutta methods."""
    limits = {"resonance": NO_FAR_STEPS}
    if top.form != "lagrange/inertial":
        limits["singular-step"] = NO_FAR_STEPS
    return limits


def rk2_limits(top: Top) -> Mapping[str, str]:
    """Limits of the explicit midpoint rule."""
    limits = dict(explicit_limits(top))
    if top.form.startswith("lagrange"):
        limits["drift"] = (
            "The energy grows steadily, by h³ per unit time: with h = 0.1 the run ends as `blew_up` after about 1e4 "
            "steps, and the linear integral is lost as well."
        )
    return limits


HIROTA_KIMURA = r"""
J\,\frac{\omega' - \omega}{h} = \tfrac12\,(J\omega\times\omega' + J\omega'\times\omega) + \bar\gamma\times r, \qquad
\frac{\gamma' - \gamma}{h} = \tfrac12\,(\gamma\times\omega' + \gamma'\times\omega)
"""
XI = r"\xi = (\omega_1 + i\omega_2)^2 - c\,(\gamma_1 + i\gamma_2)"
BOHLIN = rf"""
\omega_3' - \omega_3 = -h c\,\bar\gamma_2, \qquad
(\omega_1' + i\omega_2')^2 = e^{{-ih\bar\omega_3}}\,\xi + c\,(\gamma_1' + i\gamma_2'), \qquad {XI}
"""
HYBRID = r"""
\gamma' - \gamma = h\,\bar\gamma\times\frac{\omega + \omega^{\mathrm{HK}}}{2}, \qquad
\omega_3' = \omega_3^{\mathrm{HK}}, \qquad
(\omega_1' + i\omega_2')^2 = e^{-ih\bar\omega_3}\,\xi + c\,(\gamma_1' + i\gamma_2')
"""
LAGRANGE_AXIS = r"""
\dot u^2 = (2E - s^2 - 2u)(1 - u^2) - (l - su)^2, \qquad
u = u_1 + (u_2 - u_1)\,\mathrm{sn}^2\Bigl(\sqrt{\tfrac{u_3 - u_1}{2}}\;(t + t_0)\,;\ k\Bigr), \quad
k^2 = \frac{u_2 - u_1}{u_3 - u_1}

u = \gamma_3 = a\cdot p, \quad s = m\cdot e_3 = m\cdot a, \quad l = m\cdot\gamma = m\cdot p, \quad
E = \tfrac12 m^2 + u, \qquad u_1 \leq u_2 \leq u_3 \text{ the zeros of } \dot u^2; \quad A = \mu = 1
"""


LINES = 3


def polynomial_invariants(top: Top, degree: int) -> tuple[str, ...]:
    """Return the names of the invariants of ``top`` that are polynomials of the state of at most ``degree``.

    This is determined numerically: along a line, the finite difference of order ``degree + 1`` of such a polynomial
    vanishes. Three lines in general position are used, with a tolerance for round-off.
    """
    d = len(top.components)
    orders = np.arange(degree + 2.0)
    weights = np.array([(-1.0) ** k * comb(degree + 1, k) for k in range(degree + 2)])
    names = []
    for invariant in top.invariants():
        excess = 0.0
        for line in range(LINES):
            start, along = np.cos(np.arange(2.0 * d) + 2.0 * d * line + 1.0).reshape(2, d)
            states = start + orders[:, None] * along
            scale = float(invariant.scale(states).max()) or 1.0
            excess = max(excess, abs(float(weights @ invariant.value(states))) / scale)
        if excess < 1e-13 * 2.0 ** (degree + 1):
            names.append(invariant.name)
    return tuple(names)
