"""Explicit Runge-Kutta methods for every top, as baselines for the other schemes: `rk2` and `rk4`."""

from __future__ import annotations

from collections.abc import Callable

from topcli.arithmetic.vectors import add, axpy
from topcli.contracts import Floats, NoOptions, StepFunction, Stepper, Top
from topcli.schemes.declarations import explicit_limits, polynomial_invariants, rk2_limits
from topcli.schemes.registry import scheme

VectorField = Callable[[Floats, Floats], Floats]
Axpy = Callable[[Floats, float, Floats], Floats]
Add = Callable[[Floats, Floats], Floats]


def axpy3(s: Floats, a: float, k: Floats) -> Floats:
    """Return s + a k for vectors of length three."""
    return (s[0] + a * k[0], s[1] + a * k[1], s[2] + a * k[2])


def add3(v: Floats, w: Floats) -> Floats:
    """Return v + w for vectors of length three."""
    return (v[0] + w[0], v[1] + w[1], v[2] + w[2])


VECTOR_OPERATIONS: dict[int, tuple[Axpy, Add]] = {3: (axpy3, add3), 6: (axpy, add)}


def _vector_operations(top: Top) -> tuple[Axpy, Add]:
    """Vector operations for the state of ``top``."""
    d = len(top.components)
    if d not in VECTOR_OPERATIONS:
        known = " or ".join(str(length) for length in VECTOR_OPERATIONS)
        raise ValueError(f"top {top.form!r} has {d} components; rk2 and rk4 support only {known}")
    return VECTOR_OPERATIONS[d]


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


@scheme(
    "rk2",
    top=None,
    title="Explicit midpoint rule",
    order=2,
    explicit=True,
    self_adjoint=False,
    conserves=lambda top: polynomial_invariants(top, 1),
    citation="Runge 1895",
    formula=r"y' = y + h\,f\bigl(y + \tfrac h2 f(y)\bigr)",
    equations="y' = y + h f(y + h/2 f(y))",
    limits=rk2_limits,
)
def build_rk2(top: Top, options: NoOptions) -> Stepper:
    """General-purpose baseline of order two: not reversible, conserves linear integrals only."""
    return Stepper(rk2_step(top.field, _vector_operations(top)[0]), len(top.components))


@scheme(
    "rk4",
    top=None,
    title="Classical Runge-Kutta method",
    order=4,
    explicit=True,
    self_adjoint=False,
    conserves=lambda top: polynomial_invariants(top, 1),
    citation="Kutta 1901",
    formula=r"""
y' = y + \tfrac h6\,(k_1 + 2k_2 + 2k_3 + k_4), \qquad
k_1 = f(y), \quad k_2 = f(y + \tfrac h2 k_1), \quad k_3 = f(y + \tfrac h2 k_2), \quad k_4 = f(y + h k_3)
""",
    equations="y' = y + h/6 (k1 + 2 k2 + 2 k3 + k4)",
    limits=explicit_limits,
)
def build_rk4(top: Top, options: NoOptions) -> Stepper:
    """General-purpose baseline of order four: not reversible, conserves linear integrals only."""
    return Stepper(rk4_step(top.field, *_vector_operations(top)), len(top.components))
