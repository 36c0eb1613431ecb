"""Explicit Runge-Kutta methods for every top, to compare the special schemes with: `rk2` and `rk4`."""

from __future__ import annotations

from collections.abc import Callable

from topcli.contracts import Floats, NoOptions, StepFunction, Stepper, Top
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
