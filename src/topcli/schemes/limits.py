"""Sentences on limits that several schemes share: where a scheme fails, and why."""

from __future__ import annotations

from collections.abc import Mapping

from topcli.contracts import Top

SINGULAR = (
    "There are steps of the order of 1/|omega| and beyond at which the determinant of the linear system vanishes: the "
    "new state is as large as round-off lets it be. Such solves are counted; take |h| |omega| well below 1."
)
LONG_HK = (
    "With steps of about a turn the determinant changes its sign along the motion, and the state jumps far away each "
    "time it comes close to zero."
)
NO_SOLUTION = (
    "With steps of about a turn or more, Newton's method may find no solution from HK's prediction; the run ends as "
    "`no_convergence`."
)
FAR_OVERFLOW = (
    "The determinant of Newton's equations is of the third power in omega and leaves the range of a double beyond "
    "|omega| of about 1e103; the run ends as `no_convergence`."
)
LONG_NEWTON = (
    "With steps of several units of time the equations may have no solution near the old state, and Newton's method "
    "finds none; the run ends as `no_convergence`."
)
NEWTON_SINGULAR = (
    "The iteration starts from HK's step, which is singular at this h, and does not converge; the run ends as "
    "`no_convergence`."
)
OVERFLOW = (
    "|xi|² is of the fourth power in omega: beyond |omega| of about 1e77 it leaves the range of a double. Choose "
    "units of time in which omega is of moderate size."
)
NO_FAR_STEPS = (
    "Explicit, and conserves no energy: with steps of about a turn the state grows without bound within a few steps."
)


def explicit_limits(top: Top) -> Mapping[str, str]:
    """The limits of explicit Runge-Kutta methods."""
    found = {"resonance": NO_FAR_STEPS}
    if top.form != "lagrange/inertial":
        found["singular-step"] = NO_FAR_STEPS
    return found


def rk2_limits(top: Top) -> Mapping[str, str]:
    """The limits of the explicit midpoint rule."""
    found = dict(explicit_limits(top))
    if top.form.startswith("lagrange"):
        found["drift"] = (
            "The energy grows steadily, by h³ a unit of time: with h = 0.1 the run ends as `blew_up` after about 1e4 "
            "steps, and with it the linear integral that is claimed."
        )
    return found
