"""Adaptive method DOP853 of SciPy, for every top."""

from __future__ import annotations

import math

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from topcli.contracts import Array, Floats, Stepper, Top, check_stop
from topcli.schemes.declarations import polynomial_invariants
from topcli.schemes.registry import scheme

MAX_EVALUATIONS = 1_000_000
"""Evaluations of the equations in one step: some ten seconds."""
TRIAL = 500
"""Evaluations after which a step is given up if it would need ``HOPELESS`` times as many as it may at this pace."""
HOPELESS = 100.0
STAGES = 12
"""Evaluations of an internal step."""


class Tolerances(BaseModel):
    """Tolerances of the adaptive method; the error per step is kept below ``atol + rtol |y|``."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    rtol: float = Field(default=1e-12, ge=2.5e-14, description="relative tolerance per step, at least 2.5e-14")
    atol: float = Field(default=1e-14, ge=0.0, description="absolute tolerance per step")


@scheme(
    "dop853",
    top=None,
    title="Dormand-Prince method of order 8 (SciPy)",
    order=8,
    explicit=True,
    self_adjoint=False,
    adaptive=True,
    conserves=lambda top: polynomial_invariants(top, 1),
    citation="Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, 1993; scipy.integrate.DOP853",
    formula=r"""
y_{j+1} = y_j + h_j\sum_{i=1}^{12} b_i k_i, \qquad
k_i = f\Bigl(y_j + h_j\sum_{l<i} a_{il} k_l\Bigr), \qquad \sum_j h_j = h
""",
    equations="DOP853 from t to t + h, in as many internal steps as the tolerances require",
    options=Tolerances,
)
def build_dop853(top: Top, options: Tolerances) -> Stepper:
    """A widely used adaptive integrator, controlled by tolerances instead of a step size.

    It chooses internal steps within each h and ends at t = n h exactly; it is therefore most efficient if h is longer
    than its internal steps. The internal step size is carried from one step to the next. The method runs in the
    interpreter, about a thousand times slower than the compiled steps. If the internal steps shrink below round-off, or
    one h takes more than a million evaluations of the equations, the run ends as `no_convergence`; after 500 of them if
    the rest would take a hundred million.
    """
    from scipy.integrate import DOP853

    field, d = top.field, len(top.components)

    def step(s: Floats, h: float, p: Floats) -> Floats:
        def rates(_: float, y: Array) -> Floats:
            return field(tuple(y.tolist()), p)

        first = min(s[d], abs(h)) or None
        with np.errstate(over="ignore", invalid="ignore"):
            solver = DOP853(rates, 0.0, np.array(s[:d]), h, rtol=options.rtol, atol=options.atol, first_step=first)
            while solver.status == "running" and solver.nfev < MAX_EVALUATIONS:
                solver.step()
                check_stop()
                left = STAGES * abs(h - solver.t)
                if solver.nfev > TRIAL and left > HOPELESS * MAX_EVALUATIONS * solver.h_abs:
                    break
        settled = 0.0 if solver.status == "finished" else math.nan
        return (*solver.y.tolist(), float(solver.h_abs), settled, s[d + 2] + solver.nfev)

    def enter(y: Floats, h: float, p: Floats) -> Floats:
        return (*y, 0.0, 0.0, 0.0)

    def leave(s: Floats, h: float, p: Floats) -> Floats:
        return s[:d]

    return Stepper(step, d + 3, enter, leave, ("evaluations",), plain=True, iterative=True)
