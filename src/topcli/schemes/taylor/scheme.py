"""Taylor series of high order for every top.

Performance:
- the equations are quadratic, so that all coefficients follow from sums of products, eight of them in one vector;
- a coefficient depends on four products with the previous one and on no division; all other sums are computed ahead,
  and the step size is chosen from coefficients before the last;
- a series of order 28 reaches a quarter of the radius of convergence; shorter steps h are evaluations of a polynomial.
"""

from __future__ import annotations

import math

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from topcli.contracts import Array, Block, EulerPoisson, Floats, Top, checked_equations
from topcli.schemes.preserved import polynomial_invariants
from topcli.schemes.registry import scheme
from topcli.schemes.taylor.series import arrangement_of
from topcli.schemes.taylor.time_loop import LOG2_TOL, SHORTEST_REACH, TABLES, TIME, series_loop, series_width

ROUND_OFF = 2.0**-56
"""Tolerance below which the result does not improve."""
ORDERS = (12, 28)
"""Smallest and largest order."""


class Tolerance(BaseModel):
    """Tolerance of the Taylor series."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    tol: float = Field(
        default=1e-17,
        ge=0.0,
        le=1.0,
        description="size of the last terms of a series, relative to the state; 0 means round-off",
    )


def order_for(tol: float) -> int:
    """Return the order, a multiple of four, that reaches ``tol`` at the lowest measured cost."""
    digits = -math.log10(max(tol, ROUND_OFF))
    return min(max(4 * round((1.5 * digits + 5.0) / 4.0), ORDERS[0]), ORDERS[1])


def extended_precision(order: int) -> bool:
    """True if the first coefficient is needed in more than double precision: at the tolerance of round-off."""
    return order == ORDERS[1]


def quotients(equations: EulerPoisson) -> tuple[Floats, Floats, Floats]:
    """Return alpha, beta and -delta of ``series``, each of length three."""
    moments, gravity = equations.moments, equations.gravity
    turns = tuple((i, (i + 1) % 3, (i + 2) % 3) for i in range(3))
    with np.errstate(all="ignore"):
        return (
            tuple(float(np.float64(moments[j] - moments[k]) / moments[i]) for i, j, k in turns),
            tuple(float(np.float64(gravity[k]) / moments[i]) for i, j, k in turns),
            tuple(-float(np.float64(gravity[j]) / moments[i]) for i, j, k in turns),
        )


def binary_exponent(x: float) -> int:
    """Return the exponent of the next power of two above x, limited to ±1000; 0 for 0, inf and nan."""
    return min(max(math.frexp(x)[1], -1000), 1000)


def scales(equations: EulerPoisson, y: Array) -> tuple[int, int]:
    """Return ``(k, m)`` such that the rates of change are of order one with time in units of 2^-k, gamma of 2^m.

    ``y`` is a state (d,). Scaling by powers of two is exact, and no coefficient of the series overflows in these units.
    """
    alpha, beta, delta = quotients(equations)
    omega, gamma = float(np.abs(y[:3]).max()), float(np.abs(y[3:]).max(initial=0.0))
    gravity = max(abs(x) for x in (*beta, *delta))
    swing = math.sqrt(gravity) * math.sqrt(gamma) if gamma > 0.0 else 0.0
    return binary_exponent(max(omega * max(1.0, *(abs(x) for x in alpha)), swing)), binary_exponent(gamma)


def log2_tolerance(tol: float) -> float:
    """Base-2 logarithm of the tolerance, at least that of round-off."""
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
    formula=r"""
y(t + \delta) = \sum_m y_m\,\delta^m, \qquad
(m + 1)\,y_{m+1} = B y_m + \sum_{k=0}^m Q(y_k, y_{m-k}), \qquad f(y) = Q(y, y) + B y
""",
    equations="y(t + d) = sum of y_m d^m, (m + 1) y_(m+1) = sum of f(y_k, y_(m-k)) over k = 0..m, f bilinear",
    options=Tolerance,
)
def build(top: Top, options: Tolerance) -> Block:
    """Solution to a tolerance down to round-off; h only determines the recorded times.

    If h is shorter than the reach of a series, the series is evaluated as a polynomial at every recorded t = n h; if h
    is longer, several series are used within one h. Times are exact: the expansion points are multiples of h by
    fractions that are exact in double precision, and the rounding error of the product with h is compensated. The
    order, 12 to 28, follows from the tolerance. Only linear integrals are conserved by construction, but at the
    default tolerance all integrals are conserved to round-off, which grows as sqrt(t). The counter `expansions` is the
    number of series. If a series reaches less than 1.5e-8 of h, so that one step would take 7e7 of them or more, the
    run ends as `no_convergence`.
    """
    equations = checked_equations(top, "scheme 'taylor'")
    alpha, beta, delta = quotients(equations)
    d = len(top.components)
    a = arrangement_of(d, alpha[2])
    order = order_for(options.tol)
    sign, base, level = equations.omega_sign, 2 * a.lanes, log2_tolerance(options.tol)

    def enter(y: Array, work: Array, p: Array, h: float) -> int:
        k, m = scales(equations, y)
        units = [sign * 2.0**k] * 3 + [2.0**m] * (d - 3)
        tables = np.zeros((3, a.lanes))
        tables[:, :3] = alpha, beta, delta
        tables[0, 3:d] = 1.0
        work[:] = 0.0
        with np.errstate(all="ignore"):
            tables[1:] = np.ldexp(tables[1:], m - 2 * k)
            work[: a.lanes] = a.to_lanes(y / units)
        work[base + TIME], work[base + LOG2_TOL] = 2.0**k, level
        at = base + TABLES
        work[at : at + 3 * a.lanes] = tables.ravel()
        work[at + 3 * a.lanes : at + 4 * a.lanes] = a.to_lanes(units)
        return 0

    return Block(
        lambda: series_loop(a, d, order, extended_precision(order)),
        enter,
        series_width(a),
        ("expansions",),
        iterative=True,
        advice=lambda work, h: f"a step of {h:g} would need {1.0 / SHORTEST_REACH:.0e} series or more",
    )
