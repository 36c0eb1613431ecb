"""Taylor series of high order for every top.

Performance:
- the field is rewritten with products of two factors, so that all coefficients follow from sums of products, several of
  them in one vector;
- a coefficient depends on four products with the previous one and on no division; all other sums are computed ahead,
  and the step size is chosen from coefficients before the last;
- a series of order 28 reaches a quarter of the radius of convergence; shorter steps h are evaluations of a polynomial.

The time loop is LLVM IR (``taylor.ll``), because numba has no vector types. See ``taylor_series`` for the mathematics.
"""

from __future__ import annotations

import math
from fractions import Fraction
from functools import partial
from itertools import count
from pathlib import Path
from string import Template

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from topcli.contracts import Array, Block, Top
from topcli.field.polynomial import Field as VectorField
from topcli.field.polynomial import required_field, variational
from topcli.field.units import NaturalUnits
from topcli.schemes.any_top.taylor_series import Arrangement, arrangement_of, expand, taylor_increment
from topcli.schemes.any_top.taylor_vectors import DECLARATIONS, IRWriter, literal, vector_two_sum
from topcli.schemes.registry import linear_invariants, scheme

STEP, FRACTION, LAG, TIME, LOG2_TOL, UNITS = range(6)
"""Slots of the working state after the two vectors of the expansion point: see ``series_loop``."""
MAX_EXPANSIONS = 50_000
"""Maximum number of expansions per call, about ten milliseconds."""
SHORTEST_REACH = 2.0**-26
"""Shortest reach of a series, in steps: a step takes at most 7e7 expansions, about ten seconds."""
EXACT_REACH = 256.0
"""If a series reaches fewer steps than this, its reach is rounded to a multiple of 2^-44 of a step, so that the
position of the next expansion point is exact."""


def series_loop(a: Arrangement, order: int) -> str:
    """Return the time loop of a Taylor series, a module with the function ``advance``.

    Arguments and result are those of the loop in ``engine.loops``. ``work`` contains, in this order: the state at the
    expansion point as an unevaluated sum of two vectors; the position of the expansion point in steps of h after the
    last step reached, integer part and fraction; the delay of the expansion point relative to that position, in time;
    the scale of time and the logarithm of the tolerance; the units of the components; the tables of the arrangement;
    the status; the number of expansions. The function may return before all steps are done, after
    ``MAX_EXPANSIONS`` expansions.
    """
    # three pieces of one loop: the series, the rows within its reach, and the step to its end
    names = count()
    base, d = 2 * a.lanes, a.components

    def text() -> IRWriter:
        return IRWriter(a.lanes, names)

    expansion, writing, moving = text(), text(), text()
    natural, late, missed = expand(expansion, a, order, ("%hi", "%lo"), "%slevel")
    written, written_rest = taylor_increment(writing, order, "%sd", missed)
    main, rest = taylor_increment(moving, order, "%sm", missed)
    new, lost = vector_two_sum(moving, "%hi", main)
    rest = moving.add(rest, moving.add("%lo", lost))
    hi = moving.add(new, rest)
    lo = moving.sub(rest, moving.sub(hi, new))
    # where the loop finds its numbers in the working state of ``series_block``
    arrays = ["y", *(f"{side}{v}" for v in range(len(a.products)) for side in ("left", "right"))]
    slots = {"lop": a.lanes, "stepp": base + STEP, "partp": base + FRACTION, "lagp": base + LAG, "timep": base + TIME}
    slots |= {"levelp": base + LOG2_TOL, "unitp": base + UNITS}
    slots |= {"statusp": series_width(a) - 2, "countp": series_width(a) - 1}
    slots |= {f"table{k}p": base + UNITS + (k + 1) * a.lanes for k in range(len(a.tables))}
    v, align = expansion.vector, 8 * a.lanes
    loop = Path(__file__).with_suffix(".ll").read_text(encoding="utf-8")
    return Template(loop).substitute(
        declarations=DECLARATIONS,
        v=v,
        arrays="\n".join(f"  %{name} = alloca [{order + 1} x {v}], align {align}" for name in arrays),
        pointers="\n".join(f"  %{name} = getelementptr double, ptr %work, i64 {slot}" for name, slot in slots.items()),
        tables="\n".join(f"  %table{k} = load {v}, ptr %table{k}p, align 8" for k in range(len(a.tables))),
        lanes=a.lanes,
        budget=MAX_EXPANSIONS,
        exact=literal(EXACT_REACH),
        shortest=literal(SHORTEST_REACH),
        expansion="\n".join(expansion.lines),
        natural=natural,
        late=late,
        writing="\n".join(writing.lines),
        written=written,
        written_rest=written_rest,
        moving="\n".join(moving.lines),
        hi=hi,
        lo=lo,
        d=d,
        first=", ".join(f"i32 {k}" for k in range(d)),
    )


def series_width(a: Arrangement) -> int:
    """Length of the working state of ``series_loop``."""
    return (3 + len(a.tables)) * a.lanes + UNITS + 2


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
        description="tolerance: size of the last terms of a series, relative to the state; 0 means round-off",
    )


def order_for(tol: float) -> int:
    """Return the order, a multiple of four, that reaches ``tol`` at the lowest measured cost."""
    digits = -math.log10(max(tol, ROUND_OFF))
    return min(max(4 * round((1.5 * digits + 5.0) / 4.0), ORDERS[0]), ORDERS[1])


@scheme(
    "taylor",
    top=None,
    requires=partial(required_field, needed_by="scheme 'taylor'"),
    order=None,
    explicit=True,
    self_adjoint=False,
    adaptive=True,
    conserves=linear_invariants,
    options=Tolerance,
)
def build_taylor(top: Top, options: Tolerance) -> Block:
    r"""Taylor series.

    An adaptive Taylor series with a tolerance that may be as small as round-off; h only sets the recorded times.

    Each series is accurate over a certain time, its reach. If h is shorter than the reach, the series is evaluated as a
    polynomial at every recorded t = n h. If h is longer, several series are used within one h. Times do not accumulate
    round-off: each series is expanded about a time r h, where double precision represents the number r exactly, and the
    rounding error of the product is compensated. The order of the series, 12 to 28, follows from the tolerance.

    Only linear integrals are conserved by construction. At the default tolerance, however, all integrals are conserved
    to round-off, which grows as sqrt(t). The counter `expansions` is the number of series. If the reach of a series is
    less than 1.5e-8 h, one step would take 7e7 series or more, and the run ends as `no_convergence`.

    Source
    ------
    Jorba, Zou, Experimental Mathematics 14 (2005) 99

    Equations
    ---------
    y(t + d) = sum of y_i d^i, with coefficients y_i that follow recursively from the equations of motion

    Formula
    -------
    y(t + \delta) = \sum_i y_i\,\delta^i, \qquad f(y) = Q(y, y) + B y + b, \qquad y_1 = f(y_0), \qquad
    (i + 1)\,y_{i+1} = \sum_{k=0}^i Q(y_k, y_{i-k}) + B y_i \quad (i \geq 1)
    """
    return series_block(required_field(top, "scheme 'taylor'", exact=Fraction), options.tol)


def series_block(field: VectorField, tol: float) -> Block:
    """Taylor series of any polynomial field to a tolerance; its tangent map is that of the variational field."""
    a = arrangement_of(tuple(tuple(sorted(rate.terms)) for rate in field))
    order, level = order_for(tol), math.log2(max(tol, ROUND_OFF))
    natural, base, d = NaturalUnits(field, order), 2 * a.lanes, len(field)
    tables: dict[tuple[int, ...], Array] = {}

    # states of one class of sizes share the units, and with them the table of coefficients
    def enter(y: Array, work: Array, p: Array, h: float) -> int:
        scaled, k, units = natural.at(y)
        key = (k, *units)
        if key not in tables:
            tables[key] = np.array(a.values(scaled))
        work[:] = 0.0
        with np.errstate(all="ignore"):
            work[:d] = np.ldexp(y, [-unit for unit in units])
            work[base + TIME], work[base + LOG2_TOL] = np.ldexp(1.0, k), level
            work[base + UNITS : base + UNITS + d] = np.ldexp(1.0, units)
        work[base + UNITS + a.lanes : -2] = tables[key]
        return 0

    return Block(
        lambda: series_loop(a, order),
        enter,
        series_width(a),
        ("expansions",),
        iterative=True,
        tangent=lambda: series_block(variational(field), tol),
    )
