"""Taylor series of eight trajectories side by side: a lane each, in LLVM's intermediate language.

Where ``series`` puts the components of one trajectory into the lanes, here every component is a vector of its own and
nothing is permuted; a lane takes its own steps, and waits once it is done. It is the multiplications that count, and
half of them are saved by forming the sums from products of sums: see ``series_pairs``. This
subtracts numbers of the size of the squared coefficients, which would not do where these grow or fall with their
number; hence the unit of time is two to four times the last step: powers of two, which round nothing.
"""

from __future__ import annotations

import math
from itertools import count

from topcli.schemes.taylor.batch_coefficients import LANES, expand_all
from topcli.schemes.taylor.llvm_vectors import DECLARATIONS, Text
from topcli.schemes.taylor.series import SHARE
from topcli.schemes.taylor.time_loop import EXACT
from topcli.schemes.taylor.vectors import scaled, two_sum

FASTEST = 256.0
"""The most that the unit of time changes by from one step to the next."""
HI, LO, STEP, PART, LAG, COUNT = 0, 6, 12, 13, 14, 15
"""Vectors of the working state: the centre (6 and 6), its position in steps (whole, fraction), its lateness, moves."""
TIME, LEVEL, ALPHA, BETA, DELTA, UNIT, SLOTS = 16, 17, 18, 21, 24, 27, 33
"""Those that stay: the scale of time, the logarithm of the tolerance, alpha, beta, -delta (3 each), the units (6)."""


def _logarithm(o: Text, d: int, m: int) -> str:
    """The base-2 logarithm of the largest coefficient m in each lane, as ``Operations.logarithm`` finds it."""
    kind, largest = f"<{LANES} x i64>", ""
    kept = "<" + ", ".join(["i64 9223372036854775807"] * LANES) + ">"
    for c in range(d):
        bits = o.line(f"bitcast {o.vector} {o.load('y', m * d + c)} to {kind}")
        size = o.line(f"and {kind} {bits}, {kept}")
        largest = o.line(f"call {kind} @llvm.smax.v{LANES}i64({kind} {largest}, {kind} {size})") if largest else size
    number = o.line(f"sitofp {kind} {largest} to {o.vector}")
    return o.fma(number, _all(o, 2.0**-52), _all(o, -1023.0))


def _all(o: Text, x: float) -> str:
    return o.constant((x,) * LANES)


def _chosen(o: Text, word: str, x: str, y: str) -> str:
    """The smaller (olt) or the larger (ogt) in each lane."""
    chosen = o.line(f"fcmp {word} {o.vector} {x}, {y}")
    return o.line(f"select <{LANES} x i1> {chosen}, {o.vector} {x}, {o.vector} {y}")


def _natural(o: Text, d: int, order: int) -> tuple[str, str]:
    """``series.natural_step`` in each lane, by the last two coefficients; no longer than the unit of time."""
    half = order // 2
    y0, before, last, low, high = (_logarithm(o, d, m) for m in (0, order - 1, order, half - 1, half))
    middle, late = _chosen(o, "ogt", low, high), _chosen(o, "ogt", before, last)
    level = o.add(y0, "%level")
    first = o.mul(o.sub(level, before), _all(o, 1.0 / (order - 1)))
    second = o.mul(o.sub(level, last), _all(o, 1.0 / order))
    bound = o.add(o.mul(o.sub(middle, late), _all(o, 1.0 / (order - half))), _all(o, math.log2(SHARE)))
    step = _chosen(o, "olt", _chosen(o, "olt", first, second), bound)
    step = _chosen(o, "ogt", _chosen(o, "olt", step, _all(o, 0.0)), _all(o, -1000.0))
    kind = f"<{LANES} x i64>"
    biased = o.add(step, _all(o, 1023.0))
    whole = o.line(f"fptosi {o.vector} {biased} to {kind}")
    part = o.sub(biased, o.line(f"sitofp {kind} {whole} to {o.vector}"))
    shifts = "<" + ", ".join(["i64 52"] * LANES) + ">"
    two = o.line(f"bitcast {kind} {o.line(f'shl {kind} {whole}, {shifts}')} to {o.vector}")
    rest = o.fma(part, o.fma(part, _all(o, 0.34383), _all(o, 0.65617)), _all(o, 1.0))
    return o.mul(two, rest), late


def _tails(o: Text, d: int, order: int, at: str, missed: list[str]) -> list[tuple[str, str]]:
    """``series.tail`` of each series, by Horner's rule: the series are side by side already."""
    totals = [o.load("y", order * d + c) for c in range(d)]
    for m in range(order - 1, 1, -1):
        totals = [o.fma(totals[c], at, o.load("y", m * d + c)) for c in range(d)]
    found = []
    for c in range(d):
        main, lost = scaled(o, at, (o.load("y", d + c), missed[c]))
        found.append((main, o.fma(o.mul(totals[c], at), at, lost)))
    return found


_LOOP = """
define i64 @advance(ptr %work, ptr %out, ptr %params, double %h, i64 %steps, i64 %every, i64 %until) #0 {{
entry:
  %y = alloca [{n} x {v}], align 64
{loads}
  %h1 = insertelement {v} poison, double %h, i32 0
  %hs = shufflevector {v} %h1, {v} poison, {zeros}
  %scaled_0 = fmul {v} %hs, %time_0
  %size = call {v} @llvm.fabs.{f}({v} %scaled_0)
  %inverse_0 = fdiv {v} {ones}, %size
  %stepsd = sitofp i64 %steps to double
  %steps1 = insertelement {v} poison, double %stepsd, i32 0
  %last = shufflevector {v} %steps1, {v} poison, {zeros}
  %everyd = sitofp i64 %every to double
  %every1 = insertelement {v} poison, double %everyd, i32 0
  %stride = shufflevector {v} %every1, {v} poison, {zeros}
  %untild = sitofp i64 %until to double
  %until1 = insertelement {v} poison, double %untild, i32 0
  %row0 = shufflevector {v} %until1, {v} poison, {zeros}
  br label %expand

expand:
{phis}
{expansion}
  %fine0 = fcmp olt {v} {late}, {infinite}
  %asked = fmul {v} {natural}, %inverse
  %capped = call {v} @llvm.minnum.{f}({v} %asked, {v} {cap})
  %long = fcmp oge {v} %capped, {exact}
  %whole = call {v} @llvm.floor.{f}({v} %capped)
  %raised = fadd {v} %capped, {exact}
  %short = fsub {v} %raised, {exact}
  %shortend = fadd {v} %part, %short
  %reach0 = select {i} %long, {v} %whole, {v} %shortend
  %moves = fcmp ogt {v} %reach0, %part
  %fine = select {i} %fine0, {i} %moves, {i} zeroinitializer
  %reach = select {i} %fine, {v} %reach0, {v} {endless}
  %du = fsub {v} %reach, %part
  br label %serve

serve:
  %row = phi {v} [ %rowe, %expand ], [ %rownext, %write ]
  %placed = phi <8 x i64> [ %placede, %expand ], [ %placednext, %write ]
  %within = fcmp ole {v} %row, %last
  %wanted = fsub {v} %row, %step
  %reached = fcmp ole {v} %wanted, %reach
  %serves = and {i} %within, %reached
  %any = call i1 @llvm.vector.reduce.or.v8i1({i} %serves)
  br i1 %any, label %write, label %served

write:
  %off = fsub {v} %wanted, %part
  %near = fmul {v} %off, %scaled
  %late1 = fsub {v} %near, %lag
  %offset = select {i} %fine, {v} %late1, {v} {nan}
{writing}
  %placedmore = add <8 x i64> %placed, {stride}
  %placednext = select {i} %serves, <8 x i64> %placedmore, <8 x i64> %placed
  %rowmore = fadd {v} %row, %stride
  %rownext = select {i} %serves, {v} %rowmore, {v} %row
  br label %serve

served:
  %left = fsub {v} %last, %step
  %done = fcmp ole {v} %left, %reach
  %all = call i1 @llvm.vector.reduce.and.v8i1({i} %done)
  br i1 %all, label %finish, label %move

move:
  %gone = fmul {v} %du, %scaled
  %distance = fsub {v} %gone, %lag
  %gonen = fneg {v} %gone
  %rest = call {v} @llvm.fmuladd.{f}({v} %du, {v} %scaled, {v} %gonen)
  %further = fsub {v} %distance, %gone
  %behind = fadd {v} %further, %lag
  %lagmoved = fsub {v} %behind, %rest
  %gonebits = bitcast {v} %gone to <8 x i64>
  %exponent = and <8 x i64> %gonebits, {exponents}
  %growbits = sub <8 x i64> {quarter}, %exponent
  %grow = bitcast <8 x i64> %growbits to {v}
  %least = call {v} @llvm.maxnum.{f}({v} %grow, {v} {slowest})
  %bounded = call {v} @llvm.minnum.{f}({v} %least, {v} {fastest})
  %unitlarger = select {i} %done, {v} {ones}, {v} %bounded
  %unitsmaller = fdiv {v} {ones}, %unitlarger
  %square = fmul {v} %unitsmaller, %unitsmaller
  %lagkept = select {i} %done, {v} %lag, {v} %lagmoved
  %lagnew = fmul {v} %lagkept, %unitlarger
{rescaled}
  %passed = call {v} @llvm.floor.{f}({v} %reach)
  %partmoved = fsub {v} %reach, %passed
  %partnew = select {i} %done, {v} %part, {v} %partmoved
  %stepmoved = fadd {v} %step, %passed
  %stepnew = select {i} %done, {v} %step, {v} %stepmoved
  %countmoved = fadd {v} %count, {ones}
  %countnew = select {i} %done, {v} %count, {v} %countmoved
{moving}
  br label %expand

finish:
  %after = fsub {v} %step, %last
{stores}
  ret i64 %steps
}}

{declarations}
declare {v} @llvm.fmuladd.{f}({v}, {v}, {v})
declare {v} @llvm.fabs.{f}({v})
declare {v} @llvm.floor.{f}({v})
declare {v} @llvm.minnum.{f}({v}, {v})
declare {v} @llvm.maxnum.{f}({v}, {v})
declare <8 x i64> @llvm.smax.v8i64(<8 x i64>, <8 x i64>)
declare i1 @llvm.vector.reduce.or.v8i1({i})
declare i1 @llvm.vector.reduce.and.v8i1({i})
declare void @llvm.masked.scatter.v8f64.v8p0({v}, <8 x ptr>, i32, {i})
attributes #0 = {{ nounwind "prefer-vector-width"="512" "min-legal-vector-width"="512" "no-builtins" }}
"""


def batch_loop(d: int, order: int, lacks: frozenset[str]) -> str:
    """The time loop of eight Taylor series as a module with the function ``advance``.

    Its arguments are those of ``engine.driver``'s loop; ``work`` holds ``SLOTS`` vectors of eight lanes each. The
    states go into ``out[row, component, lane]``; those of a lane that is not finite are nan. ``lacks`` names the
    coefficients that are zero, ``alpha2`` for the third alpha.
    """
    names = count()

    def text() -> Text:
        return Text(LANES, names, d + d)

    v = text().vector
    carried = {f"hi{c}": HI + c for c in range(d)} | {f"lo{c}": LO + c for c in range(d)}
    carried |= {"step": STEP, "part": PART, "lag": LAG, "count": COUNT}
    # with the time go the units of omega, and gravity against their square
    larger = {"time": TIME} | {f"unit{c}": UNIT + c for c in range(3)}
    smaller = {f"{table}{i}": at + i for table, at in (("beta", BETA), ("delta", DELTA)) for i in range(3)}
    carried |= larger | smaller
    fixed = {"level": LEVEL} | {f"unit{c}": UNIT + c for c in range(3, d)} | {f"alpha{i}": ALPHA + i for i in range(3)}
    loads, phis, stores = [], [], []
    for name, slot in (carried | fixed).items():
        loads.append(f"  %p_{name} = getelementptr {v}, ptr %work, i64 {slot}")
        loads.append(f"  %{name}{'_0' if name in carried else ''} = load {v}, ptr %p_{name}, align 8")
    for name in carried:
        phis.append(f"  %{name} = phi {v} [ %{name}_0, %entry ], [ %{name}new, %move ]")
        stores.append(f"  store {v} %{'after' if name == 'step' else name}, ptr %p_{name}, align 8")
    rescaled = [f"  %{name}new = fmul {v} %{name}, %unitlarger" for name in (*larger, "scaled")]
    rescaled += [f"  %{name}new = fmul {v} %{name}, %square" for name in smaller]
    rescaled.append(f"  %inversenew = fmul {v} %inverse, %unitsmaller")
    for name in ("scaled", "inverse"):
        phis.append(f"  %{name} = phi {v} [ %{name}_0, %entry ], [ %{name}new, %move ]")
    places = ", ".join(f"i64 {lane}" for lane in range(LANES))
    phis.append(f"  %rowe = phi {v} [ %row0, %entry ], [ %row, %move ]")
    phis.append(f"  %placede = phi <8 x i64> [ <{places}>, %entry ], [ %placed, %move ]")

    expansion, writing, moving = text(), text(), text()
    for c in range(d):
        expansion.store("y", c, f"%hi{c}")
    missed = expand_all(expansion, d, order, lacks)
    natural, late = _natural(expansion, d, order)
    for c, (main, rest) in enumerate(_tails(writing, d, order, "%offset", missed)):
        change = writing.add(main, writing.add(rest, f"%lo{c}"))
        state = writing.mul(writing.add(f"%hi{c}", change), f"%unit{c}")
        shift = "<" + ", ".join([f"i64 {c * LANES}"] * LANES) + ">"
        place = writing.line(f"add <8 x i64> %placed, {shift}")
        where = writing.line(f"getelementptr double, ptr %out, <8 x i64> {place}")
        writing.lines.append(
            f"  call void @llvm.masked.scatter.v8f64.v8p0({v} {state}, <8 x ptr> {where}, i32 8, <8 x i1> %serves)"
        )
    for c, (main, rest) in enumerate(_tails(moving, d, order, "%distance", missed)):
        moved, lost = two_sum(moving, f"%hi{c}", main)
        new, lost = two_sum(moving, moved, moving.add(rest, moving.add(f"%lo{c}", lost)))
        for name, moved in ((f"hi{c}", new), (f"lo{c}", lost)):
            kept = moving.line(f"select <8 x i1> %done, {v} %{name}, {v} {moved}")
            moving.lines.append(f"  %{name}new = fmul {v} {kept}, {'%unitsmaller' if c < 3 else _all(moving, 1.0)}")
    return _LOOP.format(
        declarations=DECLARATIONS,
        n=(order + 1) * d,
        v=v,
        f=f"v{LANES}f64",
        i=f"<{LANES} x i1>",
        zeros=f"<{LANES} x i32> zeroinitializer",
        ones=_all(expansion, 1.0),
        infinite=_all(expansion, 1024.0),
        cap=_all(expansion, 2.0**40),
        exact=_all(expansion, EXACT),
        endless=_all(expansion, math.inf),
        nan=_all(expansion, math.nan),
        stride="<" + ", ".join([f"i64 {d * LANES}"] * LANES) + ">",
        exponents="<" + ", ".join([f"i64 {0x7FF << 52}"] * LANES) + ">",
        quarter="<" + ", ".join([f"i64 {2044 << 52}"] * LANES) + ">",
        slowest=_all(expansion, 1.0 / FASTEST),
        fastest=_all(expansion, FASTEST),
        rescaled="\n".join(rescaled),
        loads="\n".join(loads),
        phis="\n".join(phis),
        stores="\n".join(stores),
        expansion="\n".join(expansion.lines),
        writing="\n".join(writing.lines),
        moving="\n".join(moving.lines),
        natural=natural,
        late=late,
    )
