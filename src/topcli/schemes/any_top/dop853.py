"""SciPy's adaptive Runge-Kutta method of order 8 for every top, as a reference."""

from __future__ import annotations

import math

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from topcli.contracts import Array, Floats, Stepper, Top, check_stop
from topcli.schemes.registry import linear_invariants, scheme
from topcli.schemes.steppers import first

MAX_EVALUATIONS = 1_000_000
"""Evaluations of the equations in one step: some ten seconds."""
TRIAL = 500
"""Evaluations after which a step is given up that would need a hundred times as many as it may, at 12 an inner step."""


class Tolerances(BaseModel):
    """Tolerances of the adaptive method; the error per step is kept below ``atol + rtol |y|``."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    rtol: float = Field(default=1e-12, ge=2.5e-14, description="relative tolerance per inner step")
    atol: float = Field(default=1e-14, ge=0.0, description="absolute tolerance per inner step")


@scheme(
    "dop853",
    top=None,
    order=8,
    explicit=True,
    self_adjoint=False,
    adaptive=True,
    conserves=linear_invariants,
    options=Tolerances,
)
def build_dop853(top: Top, options: Tolerances) -> Stepper:
    r"""Dormand-Prince method of order 8 (SciPy).

    A widely used adaptive integrator, controlled by tolerances instead of a step size.

    DOP853 chooses inner steps within each h and reaches every t = n h exactly. DOP853 is therefore most efficient if h
    is longer than the inner steps. The method runs in the Python interpreter and is about a thousand times slower than
    the compiled steps of other schemes.

    The run ends as `no_convergence` if the inner steps shrink below round-off, or if one step of h takes more than a
    million evaluations of the equations of motion.

    Source
    ------
    Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, 1993; scipy.integrate.DOP853

    Equations
    ---------
    DOP853 from t to t + h, in as many inner steps as the tolerances require

    Formula
    -------
    y_{j+1} = y_j + h_j\sum_{i=1}^{12} b_i k_i, \qquad
    k_i = f\Bigl(y_j + h_j\sum_{l<i} a_{il} k_l\Bigr), \qquad \sum_j h_j = h

    Limits
    ------
    huge (euler, euler+gamma, heavy, kowalevski, lagrange, lagrange/inertial)
        SciPy divides the estimated error by the tolerance and squares the quotient. With rtol = 1e-12 the square
        overflows if |omega| exceeds about 1e140. Choose a unit of time in which omega has a moderate size.
    """
    from scipy.integrate import DOP853

    field, d = top.field, len(top.components)

    def step(s: Floats, h: float, p: Floats) -> Floats:
        def rates(_: float, y: Array) -> Floats:
            return field(tuple(y.tolist()), p)

        # the step size that the last call arrived at; a run that would exceed the evaluations ends after a trial
        length = min(s[d], abs(h)) or None
        with np.errstate(over="ignore", invalid="ignore"):
            solver = DOP853(rates, 0.0, np.array(s[:d]), h, rtol=options.rtol, atol=options.atol, first_step=length)
            while solver.status == "running" and solver.nfev < MAX_EVALUATIONS:
                solver.step()
                check_stop()
                if solver.nfev > TRIAL and 12.0 * abs(h - solver.t) > 100.0 * MAX_EVALUATIONS * solver.h_abs:
                    break
        settled = 0.0 if solver.status == "finished" else math.nan
        return (*solver.y.tolist(), float(solver.h_abs), settled, s[d + 2] + solver.nfev)

    def enter(y: Floats, h: float, p: Floats) -> Floats:
        return (*y, 0.0, 0.0, 0.0)

    return Stepper(step, d + 3, enter, first(d), ("evaluations",), plain=True, iterative=True)
