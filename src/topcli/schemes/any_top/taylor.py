"""Taylor series of high order for every top.

Performance:
- the field is rewritten with products of two factors, so that all coefficients follow from sums of products, several of
  them in one vector;
- a coefficient depends on four products with the previous one and on no division; all other sums are computed ahead,
  and the step size is chosen from coefficients before the last;
- a series of order 28 reaches a quarter of the radius of convergence; shorter steps h are evaluations of a polynomial.

Time loop of the Taylor series in LLVM IR; numba has no vector types. See ``taylor_series`` for the mathematics.
"""

from __future__ import annotations

import math
from fractions import Fraction
from functools import partial
from itertools import count

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
_LOOP = """
define i64 @advance(ptr %work, ptr %out, ptr %params, double %h, i64 %steps, i64 %every, i64 %until) #0 {{
entry:
{arrays}
{pointers}
  %hi0 = load {v}, ptr %work, align 8
  %lo0 = load {v}, ptr %lop, align 8
  %stepd = load double, ptr %stepp, align 8
  %step0 = fptosi double %stepd to i64
  %part0 = load double, ptr %partp, align 8
  %lag0 = load double, ptr %lagp, align 8
  %time = load double, ptr %timep, align 8
  %slevel = load double, ptr %levelp, align 8
  %count0 = load double, ptr %countp, align 8
{tables}
  %unit = load {v}, ptr %unitp, align 8
  %sh = fmul double %h, %time
  %size = call double @llvm.fabs.f64(double %sh)
  %inverse = fdiv double 1.0, %size
  br label %expand

expand:
  %hi = phi {v} [ %hi0, %entry ], [ {hi}, %move ]
  %lo = phi {v} [ %lo0, %entry ], [ {lo}, %move ]
  %step = phi i64 [ %step0, %entry ], [ %stepnew, %move ]
  %part = phi double [ %part0, %entry ], [ %partnew, %move ]
  %slag = phi double [ %lag0, %entry ], [ %slagnew, %move ]
  %count = phi double [ %count0, %entry ], [ %countnew, %move ]
  %row0 = phi i64 [ %until, %entry ], [ %row, %move ]
  %place0 = phi ptr [ %out, %entry ], [ %place, %move ]
  %budget = phi i64 [ {budget}, %entry ], [ %left, %move ]
{expansion}
  %finite = fcmp olt double {late}, 1024.0
  br i1 %finite, label %measure, label %broken

measure:
  %natural = fmul double {natural}, %inverse
  %capped = call double @llvm.minnum.f64(double %natural, double 0x4270000000000000)
  %long = fcmp oge double %capped, {exact}
  %whole = call double @llvm.floor.f64(double %capped)
  %raised = fadd double %capped, {exact}
  %short = fsub double %raised, {exact}
  %shortend = fadd double %part, %short
  %reach = select i1 %long, double %whole, double %shortend
  %du = fsub double %reach, %part
  %moves = fcmp oge double %du, {shortest}
  br i1 %moves, label %serve, label %stuck

serve:
  %row = phi i64 [ %row0, %measure ], [ %rownext, %write ]
  %place = phi ptr [ %place0, %measure ], [ %placenext, %write ]
  %within = icmp sle i64 %row, %steps
  %rowleft = sub i64 %row, %step
  %wanted = sitofp i64 %rowleft to double
  %reached = fcmp ole double %wanted, %reach
  %serves = and i1 %within, %reached
  br i1 %serves, label %write, label %served

write:
  %off = fsub double %wanted, %part
  %sp = fmul double %off, %sh
  %sd = fsub double %sp, %slag
{writing}
  %tlo = fadd {v} {written_rest}, %lo
  %t = fadd {v} {written}, %tlo
  %there = fadd {v} %hi, %t
  %physical = fmul {v} %there, %unit
  %recorded = shufflevector {v} %physical, {v} poison, <{d} x i32> <{first}>
  store <{d} x double> %recorded, ptr %place, align 8
  %rownext = add i64 %row, %every
  %placenext = getelementptr double, ptr %place, i64 {d}
  br label %serve

served:
  %stepsleft = sub i64 %steps, %step
  %end = sitofp i64 %stepsleft to double
  %done = fcmp ole double %end, %reach
  br i1 %done, label %finish, label %move

move:
  %passed = call double @llvm.floor.f64(double %reach)
  %partnew = fsub double %reach, %passed
  %passedn = fptosi double %passed to i64
  %stepnew = add i64 %step, %passedn
  %sq = fmul double %du, %sh
  %sm = fsub double %sq, %slag
  %sqn = fneg double %sq
  %rest = call double @llvm.fmuladd.f64(double %du, double %sh, double %sqn)
  %gone = fsub double %sm, %sq
  %behind = fadd double %gone, %slag
  %slagnew = fsub double %behind, %rest
{moving}
  %countnew = fadd double %count, 1.0
  %left = sub i64 %budget, 1
  %more = icmp sgt i64 %left, 0
  br i1 %more, label %expand, label %finish

finish:
  %result = phi i64 [ %steps, %served ], [ %stepnew, %move ]
  %hiend = phi {v} [ %hi, %served ], [ {hi}, %move ]
  %loend = phi {v} [ %lo, %served ], [ {lo}, %move ]
  %stepend = phi i64 [ %step, %served ], [ %stepnew, %move ]
  %partend = phi double [ %part, %served ], [ %partnew, %move ]
  %lagend = phi double [ %slag, %served ], [ %slagnew, %move ]
  %countend = phi double [ %count, %served ], [ %countnew, %move ]
  %after = sub i64 %stepend, %result
  %afterd = sitofp i64 %after to double
  store {v} %hiend, ptr %work, align 8
  store {v} %loend, ptr %lop, align 8
  store double %afterd, ptr %stepp, align 8
  store double %partend, ptr %partp, align 8
  store double %lagend, ptr %lagp, align 8
  store double %countend, ptr %countp, align 8
  ret i64 %result

stuck:
  store double 0x7FF8000000000000, ptr %statusp, align 8
  br label %broken

broken:
  %behindit = icmp slt i64 %step, 0
  %before = select i1 %behindit, i64 0, i64 %step
  %failed = xor i64 %before, -1
  store {v} %hi, ptr %work, align 8
  store double %count, ptr %countp, align 8
  ret i64 %failed
}}

declare {v} @llvm.fmuladd.v{lanes}f64({v}, {v}, {v})
declare double @llvm.fmuladd.f64(double, double, double)
{declarations}
declare double @llvm.fabs.f64(double)
declare double @llvm.floor.f64(double)
declare double @llvm.minnum.f64(double, double)
declare i64 @llvm.vector.reduce.smax.v{lanes}i64(<{lanes} x i64>)
attributes #0 = {{ nounwind "prefer-vector-width"="512" "min-legal-vector-width"="512" "no-builtins" }}
"""


def series_loop(a: Arrangement, order: int, extended_precision: bool) -> str:
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
    y0 = "%hi", "%lo" if extended_precision else None
    natural, late, missed = expand(expansion, a, order, y0, "%slevel")
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
    return _LOOP.format(
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


def extended_precision(order: int) -> bool:
    """True if the first coefficient is needed in more than double precision: at the tolerance of round-off."""
    return order == ORDERS[1]


def log2_tolerance(tol: float) -> float:
    """Base-2 logarithm of the tolerance, at least that of round-off."""
    return math.log2(max(tol, ROUND_OFF))


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
    order, level = order_for(tol), log2_tolerance(tol)
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
        lambda: series_loop(a, order, extended_precision(order)),
        enter,
        series_width(a),
        ("expansions",),
        iterative=True,
        tangent=lambda: series_block(variational(field), tol),
    )
