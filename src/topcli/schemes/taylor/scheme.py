"""Taylor series of high order for every top: the most accurate trajectory at the least cost.

What makes it fast:
- the equations are quadratic, so that all coefficients follow from sums of products, eight of them in one vector;
- a coefficient waits for four products of the one before it and no division; all other sums run ahead of it, and the
  step is found from coefficients before the last;
- a series of order 28 reaches a quarter of the radius of convergence; steps h within it are polynomials.
"""

from __future__ import annotations

import math

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from topcli.contracts import Array, Block, EulerPoisson, Floats, Top, checked_equations
from topcli.schemes.preserved import polynomial_invariants
from topcli.schemes.registry import scheme
from topcli.schemes.taylor.series import arrangement_of
from topcli.schemes.taylor.time_loop import LEVEL, TABLES, TIME, series_loop, series_width

ROUND_OFF = 2.0**-56
"""Where a smaller tolerance gains nothing."""
ORDERS = (12, 28)
"""The least and the greatest order."""


class Tolerance(BaseModel):
    """How far the series is followed."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    tol: float = Field(
        default=1e-17,
        ge=0.0,
        le=1.0,
        description="size of the last terms of a series, relative to the state; 0 for what round-off allows",
    )


def order_of(tol: float) -> int:
    """The order that reaches ``tol`` at the least cost, as measured: a multiple of four."""
    digits = -math.log10(max(tol, ROUND_OFF))
    return min(max(4 * round((1.5 * digits + 5.0) / 4.0), ORDERS[0]), ORDERS[1])


def careful(order: int) -> bool:
    """Whether the first coefficient is wanted to more than a double: at the tolerance of round-off."""
    return order == ORDERS[1]


def quotients(equations: EulerPoisson) -> tuple[Floats, Floats, Floats]:
    """alpha, beta and -delta of ``series``, each of length three."""
    moments, gravity = equations.moments, equations.gravity
    turns = tuple((i, (i + 1) % 3, (i + 2) % 3) for i in range(3))
    with np.errstate(all="ignore"):
        return (
            tuple(float(np.float64(moments[j] - moments[k]) / moments[i]) for i, j, k in turns),
            tuple(float(np.float64(gravity[k]) / moments[i]) for i, j, k in turns),
            tuple(-float(np.float64(gravity[j]) / moments[i]) for i, j, k in turns),
        )


def exponent(x: float) -> int:
    """The power of two next above x, within what a double can be scaled by; 0 for 0, inf and nan."""
    return min(max(math.frexp(x)[1], -1000), 1000)


def scales(equations: EulerPoisson, y: Array) -> tuple[int, int]:
    """``(k, m)``: with time in units of 2^-k and gamma in units of 2^m the rates of change are of the order of one.

    ``y`` is a state (d,). Powers of two round nothing, and no coefficient of the series overflows in these units.
    """
    alpha, beta, delta = quotients(equations)
    omega, gamma = float(np.abs(y[:3]).max()), float(np.abs(y[3:]).max(initial=0.0))
    gravity = max(abs(x) for x in (*beta, *delta))
    swing = math.sqrt(gravity) * math.sqrt(gamma) if gamma > 0.0 else 0.0
    return exponent(max(omega * max(1.0, *(abs(x) for x in alpha)), swing)), exponent(gamma)


def log2_of(tol: float) -> float:
    """The logarithm of the tolerance, no smaller than round-off."""
    return math.log2(max(tol, ROUND_OFF))


@scheme(
    "taylor",
    top=None,
    title="Taylor series",
    order=None,
    explicit=True,
    self_adjoint=False,
    adaptive=True,
    conserves=lambda top: polynomial_invariants(top, 1),
    citation="Jorba, Zou, Experimental Mathematics 14 (2005) 99",
    equations="y(t + d) = sum of y_m d^m, (m + 1) y_(m+1) = sum of f(y_k, y_(m-k)) over k = 0..m, f bilinear",
    options=Tolerance,
)
def build(top: Top, options: Tolerance) -> Block:
    """The solution itself, to a tolerance down to round-off; h only says when a state is recorded.

    Where h is shorter than the series reaches, the series is evaluated as a polynomial at every recorded t = n h;
    where h is longer, as many series as needed follow each other within it. Times are exact: the centres lie at
    fractions of h that a double holds exactly, and what the product with h rounds is carried along. The order follows
    the tolerance, 12 to 28. Linear integrals alone are conserved by construction; at the default tolerance all
    integrals are, to round-off that grows as sqrt(t). `expansions` counts the series. A run ends as `no_convergence`
    where their steps shrink below 1e-13 of h.
    """
    equations = checked_equations(top, "scheme 'taylor'")
    alpha, beta, delta = quotients(equations)
    d = len(top.components)
    a = arrangement_of(d, alpha[2])
    order = order_of(options.tol)
    sign, base, level = equations.omega_sign, 2 * a.lanes, log2_of(options.tol)

    def enter(y: Array, work: Array, p: Array, h: float) -> int:
        k, m = scales(equations, y)
        units = [sign * 2.0**k] * 3 + [2.0**m] * (d - 3)
        tables = np.zeros((3, a.lanes))
        tables[:, :3] = alpha, beta, delta
        tables[0, 3:d] = 1.0
        work[:] = 0.0
        with np.errstate(all="ignore"):
            tables[1:] = np.ldexp(tables[1:], m - 2 * k)
            work[: a.lanes] = a.spread(y / units)
        work[base + TIME], work[base + LEVEL] = 2.0**k, level
        at = base + TABLES
        work[at : at + 3 * a.lanes] = tables.ravel()
        work[at + 3 * a.lanes : at + 4 * a.lanes] = a.spread(units)
        return 0

    return Block(
        lambda: series_loop(a, d, order, careful(order)), enter, series_width(a), ("expansions",), iterative=True
    )
