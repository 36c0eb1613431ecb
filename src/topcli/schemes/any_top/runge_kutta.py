"""Explicit Runge-Kutta methods for every top, as baselines: `rk2` and `rk4`.

Limits
------
resonance (euler, euler+gamma, heavy, kowalevski, lagrange, lagrange/inertial)
    The method is explicit and does not conserve the energy. If h is about the time of one revolution of the body,
    the state grows without bound within a few steps.
singular-step (euler, euler+gamma, heavy, kowalevski, lagrange)
    The method is explicit and does not conserve the energy. If h is about the time of one revolution of the body,
    the state grows without bound within a few steps.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial

from topcli.arithmetic.fused import defined
from topcli.contracts import Floats, NoOptions, StepFunction, Stepper, Top
from topcli.schemes.registry import linear_invariants, scheme

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
    long runs (lagrange, lagrange/inertial)
        The energy grows steadily, at a rate of about h³. With h = 0.1 the run ends as `blew_up` after about 1e4
        steps, and the linear integral is lost as well.
    """
    return Stepper(rk2_step(top.field, vector_operations(len(top.components))[0]), len(top.components))


@runge_kutta(
    "rk4",
    order=4,
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
