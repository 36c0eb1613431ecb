"""General-purpose methods for every top, to compare the special ones with: `rk2`, `rk4` and SciPy's `dop853`."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from topcli.contracts import Array, Floats, NoOptions, StepFunction, Stepper, Top, heed_stop
from topcli.schemes.limits import explicit_limits, rk2_limits
from topcli.schemes.preserved import polynomial_invariants
from topcli.schemes.registry import scheme

Field_ = Callable[[Floats, Floats], Floats]
Moved = Callable[[Floats, float, Floats], Floats]
Mean = Callable[[Floats, Floats, Floats, Floats], Floats]


def moved3(s: Floats, a: float, k: Floats) -> Floats:
    """S + a k, of length three."""
    return (s[0] + a * k[0], s[1] + a * k[1], s[2] + a * k[2])


def moved6(s: Floats, a: float, k: Floats) -> Floats:
    """S + a k, of length six."""
    return (
        s[0] + a * k[0],
        s[1] + a * k[1],
        s[2] + a * k[2],
        s[3] + a * k[3],
        s[4] + a * k[4],
        s[5] + a * k[5],
    )


def simpson(a: float, b: float, c: float, d: float) -> float:
    """The weights of the four slopes of the classical Runge-Kutta method, times six."""
    return (a + d) + 2.0 * (b + c)


def mean3(a: Floats, b: Floats, c: Floats, d: Floats) -> Floats:
    """``simpson`` of vectors of length three."""
    return (simpson(a[0], b[0], c[0], d[0]), simpson(a[1], b[1], c[1], d[1]), simpson(a[2], b[2], c[2], d[2]))


def mean6(a: Floats, b: Floats, c: Floats, d: Floats) -> Floats:
    """``simpson`` of vectors of length six."""
    return (
        simpson(a[0], b[0], c[0], d[0]),
        simpson(a[1], b[1], c[1], d[1]),
        simpson(a[2], b[2], c[2], d[2]),
        simpson(a[3], b[3], c[3], d[3]),
        simpson(a[4], b[4], c[4], d[4]),
        simpson(a[5], b[5], c[5], d[5]),
    )


VECTORS: dict[int, tuple[Moved, Mean]] = {3: (moved3, mean3), 6: (moved6, mean6)}


def _vectors(top: Top) -> tuple[Moved, Mean]:
    """The vector operations for the state of ``top``."""
    d = len(top.components)
    if d not in VECTORS:
        raise ValueError(f"top {top.form!r} has {d} components; rk2 and rk4 are written for {sorted(VECTORS)}")
    return VECTORS[d]


def rk2_step(field: Field_, moved: Moved) -> StepFunction:
    """The explicit midpoint rule for a field."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        return moved(s, h, field(moved(s, 0.5 * h, field(s, p)), p))

    return step


def rk4_step(field: Field_, moved: Moved, mean: Mean) -> StepFunction:
    """The classical Runge-Kutta method for a field."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        k1 = field(s, p)
        k2 = field(moved(s, 0.5 * h, k1), p)
        k3 = field(moved(s, 0.5 * h, k2), p)
        k4 = field(moved(s, h, k3), p)
        return moved(s, h / 6.0, mean(k1, k2, k3, k4))

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
    equations="y' = y + h f(y + h/2 f(y))",
    limits=rk2_limits,
)
def build_rk2(top: Top, options: NoOptions) -> Stepper:
    """A general-purpose baseline of order two: irreversible, conserves linear integrals only."""
    return Stepper(rk2_step(top.field, _vectors(top)[0]), len(top.components))


@scheme(
    "rk4",
    top=None,
    title="Classical Runge-Kutta method",
    order=4,
    explicit=True,
    self_adjoint=False,
    conserves=lambda top: polynomial_invariants(top, 1),
    citation="Kutta 1901",
    equations="y' = y + h/6 (k1 + 2 k2 + 2 k3 + k4)",
    limits=explicit_limits,
)
def build_rk4(top: Top, options: NoOptions) -> Stepper:
    """A general-purpose baseline of order four: irreversible, conserves linear integrals only."""
    return Stepper(rk4_step(top.field, *_vectors(top)), len(top.components))


MAX_EVALUATIONS = 1_000_000
"""Evaluations of the equations in one step: some ten seconds."""


class Tolerances(BaseModel):
    """The tolerances of an adaptive method: its error per step is kept below ``atol + rtol |y|``."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    rtol: float = Field(default=1e-12, ge=2.5e-14, description="relative tolerance per step, at least 2.5e-14")
    atol: float = Field(default=1e-14, ge=0.0, description="absolute tolerance per step")


@scheme(
    "dop853",
    top=None,
    title="Dormand and Prince's method of order 8 (SciPy)",
    order=8,
    explicit=True,
    self_adjoint=False,
    adaptive=True,
    conserves=lambda top: polynomial_invariants(top, 1),
    citation="Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, 1993; scipy.integrate.DOP853",
    equations="DOP853 from t to t + h, in as many steps of its own as the tolerances ask for",
    options=Tolerances,
)
def build_dop853(top: Top, options: Tolerances) -> Stepper:
    """The adaptive integrator that most people would reach for, with tolerances instead of a step size.

    It chooses its own steps within each h and ends on t = n h exactly, so that an h longer than its own steps costs
    it least. What it learnt about its step size is carried along. It runs in the interpreter, some thousand times
    slower than the compiled steps. Where its steps shrink below round-off, or one h takes more than a million
    evaluations of the equations, the run ends as `no_convergence`.
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
                heed_stop()
        settled = 0.0 if solver.status == "finished" else math.nan
        return (*solver.y.tolist(), float(solver.h_abs), settled, s[d + 2] + solver.nfev)

    def enter(y: Floats, h: float, p: Floats) -> Floats:
        return (*y, 0.0, 0.0, 0.0)

    def leave(s: Floats, h: float, p: Floats) -> Floats:
        return s[:d]

    return Stepper(step, d + 3, enter, leave, ("evaluations",), plain=True, iterative=True)
