"""Descriptions of limits that several schemes share: when a scheme fails, and why."""

from __future__ import annotations

from collections.abc import Mapping

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
    found = {"resonance": NO_FAR_STEPS}
    if top.form != "lagrange/inertial":
        found["singular-step"] = NO_FAR_STEPS
    return found


def rk2_limits(top: Top) -> Mapping[str, str]:
    """Limits of the explicit midpoint rule."""
    found = dict(explicit_limits(top))
    if top.form.startswith("lagrange"):
        found["drift"] = (
            "The energy grows steadily, by h³ per unit time: with h = 0.1 the run ends as `blew_up` after about 1e4 "
            "steps, and the linear integral is lost as well."
        )
    return found
