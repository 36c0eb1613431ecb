"""Runge-Kutta methods for every top, as baselines: `rk2`, `rk4`, and SciPy's adaptive `dop853`.

Limits
------
resonance, singular-step
    The method is explicit and does not conserve the energy. If h is about the time of one revolution of the body,
    the state grows without bound within a few steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, partial

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from topcli.arithmetic.fused import defined
from topcli.contracts import Array, Floats, NoOptions, StepFunction, Stepper, Top, check_stop
from topcli.schemes.registry import has_own_cases, linear_invariants, scheme

VectorField = Callable[[Floats, Floats], Floats]
Axpy = Callable[[Floats, float, Floats], Floats]
Add = Callable[[Floats, Floats], Floats]


@cache
def vector_operations(d: int) -> tuple[Axpy, Add]:
    """Functions that return s + a k and v + w for vectors of length ``d``."""
    text = (
        f"def axpy(s, a, k):\n    return ({', '.join(f's[{i}] + a * k[{i}]' for i in range(d))},)\n"
        f"def add(v, w):\n    return ({', '.join(f'v[{i}] + w[{i}]' for i in range(d))},)\n"
    )
    functions = defined(text, f"vectors {d}", __name__=__name__)
    return functions["axpy"], functions["add"]


def explicit_limits(top: Top) -> tuple[str, ...]:
    """Hard cases in which an explicit Runge-Kutta method fails."""
    if not has_own_cases(top):
        return ()
    return ("resonance",) if top.form == "lagrange/inertial" else ("resonance", "singular-step")


def rk2_step(field: VectorField, axpy: Axpy) -> StepFunction:
    """Step of the explicit midpoint rule."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        return axpy(s, h, field(axpy(s, 0.5 * h, field(s, p)), p))

    return step


def rk4_step(field: VectorField, axpy: Axpy, add: Add) -> StepFunction:
    """Step of the classical Runge-Kutta method."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        k1 = field(s, p)
        k2 = field(axpy(s, 0.5 * h, k1), p)
        k3 = field(axpy(s, 0.5 * h, k2), p)
        k4 = field(axpy(s, h, k3), p)
        return axpy(s, h / 6.0, axpy(add(k1, k4), 2.0, add(k2, k3)))

    return step


runge_kutta = partial(scheme, top=None, explicit=True, self_adjoint=False, conserves=linear_invariants)


@runge_kutta(
    "rk2",
    order=2,
    limits=lambda top: (*explicit_limits(top), "long runs") if top.kind == "lagrange" else explicit_limits(top),
)
def build_rk2(top: Top, options: NoOptions) -> Stepper:
    r"""Explicit midpoint rule.

    A general-purpose method of order 2. The method is not reversible and conserves only linear integrals.

    Source
    ------
    Runge 1895

    Equations
    ---------
    y' = y + h f(y + h/2 f(y))

    Formula
    -------
    y' = y + h\,f\bigl(y + \tfrac h2 f(y)\bigr)

    Limits
    ------
    long runs
        The energy grows steadily, at a rate of about h³. With h = 0.1 the run ends as `blew_up` after about 1e4
        steps, and the linear integral is lost as well.
    """
    return Stepper(rk2_step(top.field, vector_operations(len(top.components))[0]), len(top.components))


@runge_kutta(
    "rk4",
    order=4,
    limits=explicit_limits,
)
def build_rk4(top: Top, options: NoOptions) -> Stepper:
    r"""Classical Runge-Kutta method.

    A general-purpose method of order 4. The method is not reversible and conserves only linear integrals.

    Source
    ------
    Kutta 1901

    Equations
    ---------
    y' = y + h/6 (k1 + 2 k2 + 2 k3 + k4)

    Formula
    -------
    y' = y + \tfrac h6\,(k_1 + 2k_2 + 2k_3 + k_4), \qquad
    k_1 = f(y), \quad k_2 = f(y + \tfrac h2 k_1), \quad k_3 = f(y + \tfrac h2 k_2), \quad k_4 = f(y + h k_3)
    """
    return Stepper(rk4_step(top.field, *vector_operations(len(top.components))), len(top.components))


MAX_EVALUATIONS = 1_000_000
"""Evaluations of the equations in one step: some ten seconds."""
TRIAL = 500
"""Evaluations after which a step is given up that would need a hundred times as many as it may, at 12 an inner step."""


class Tolerances(BaseModel):
    """Tolerances of the adaptive method; the error per step is kept below ``atol + rtol |y|``."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    rtol: float = Field(default=1e-12, ge=2.5e-14, description="relative tolerance per inner step")
    atol: float = Field(default=1e-14, ge=0.0, description="absolute tolerance per inner step")


@runge_kutta(
    "dop853",
    order=8,
    adaptive=True,
    options=Tolerances,
    limits=lambda top: ("huge",) if has_own_cases(top) else (),
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
    huge
        SciPy divides the estimated error by the tolerance and squares the quotient. With rtol = 1e-12 the square
        overflows if |omega| exceeds about 1e140. Choose a unit of time in which omega has a moderate size.
    """
    from scipy.integrate import DOP853

    field, d = top.field, len(top.components)

    def step(s: Floats, h: float, p: Floats) -> Floats:
        def rates(_: float, y: Array) -> Floats:
            return field(tuple(y.tolist()), p)

        # the step size that the last call arrived at; a run that would exceed the evaluations ends after a trial
        first = min(s[d], abs(h)) or None
        with np.errstate(over="ignore", invalid="ignore"):
            solver = DOP853(rates, 0.0, np.array(s[:d]), h, rtol=options.rtol, atol=options.atol, first_step=first)
            while solver.status == "running" and solver.nfev < MAX_EVALUATIONS:
                solver.step()
                check_stop()
                if solver.nfev > TRIAL and 12.0 * abs(h - solver.t) > 100.0 * MAX_EVALUATIONS * solver.h_abs:
                    break
        settled = 0.0 if solver.status == "finished" else math.nan
        return (*solver.y.tolist(), float(solver.h_abs), settled, s[d + 2] + solver.nfev)

    def enter(y: Floats, h: float, p: Floats) -> Floats:
        return (*y, 0.0, 0.0, 0.0)

    def leave(s: Floats, h: float, p: Floats) -> Floats:
        return s[:d]

    return Stepper(step, d + 3, enter, leave, ("evaluations",), plain=True, iterative=True)
