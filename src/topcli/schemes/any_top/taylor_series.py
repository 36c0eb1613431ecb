"""Taylor series of a polynomial field, arranged for SIMD vectors.

A product of more than two components is a product of two factors, of which each is a component or an auxiliary
component z = a b; the field is then quadratic. The coefficients y_m of the solution sum y_m t^m satisfy
(m + 1) y_(m+1) = J y_m + sum y_k * y_(m-k), the sum over k = 1..m-1, with J the Jacobian at y_0 and * the bilinear
part; an auxiliary component has the same equation without the factor, one stage earlier. The series of all components
share one vector:

- the critical path of a coefficient is J y_m, products of columns of J with permutations of y_m; the division by m + 1
  is a multiplication, exact where its rounding errors would accumulate;
- every product of two components has a lane of one of the vectors (left, right); for each k the sum needs one fused
  multiply-add for each of these vectors, two coefficients ahead of y_m;
- the coefficients of the field are vectors too, the ``tables``: fields with the same products share the machine code;
- the step size is chosen from coefficients before the last ones, while those are computed.

The state and the first coefficient have more than double precision. The other coefficients,
with their rounding errors, are multiplied by powers of a step well below one.

The algorithm is written in terms of the methods of ``taylor_vectors.IRWriter``, which append instructions in LLVM IR.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache

from topcli.field.polynomial import Field, Monomial
from topcli.schemes.any_top.taylor_vectors import IRWriter, LaneValue, Pair, Scalar, pair_add, pair_mul, pair_scale

Lanes = tuple[int, ...]
"""For each lane of a vector, the lane of another vector that it takes its number from."""
Entry = tuple[int, Monomial]
"""Coefficient of the field: its component and its monomial."""
_ONE: Entry = (-1, ())
"""Coefficient of the product that an auxiliary component is."""
Factors = tuple[int, ...]


@dataclass
class Stage:
    """Sums for the lanes of a stage; numbers of ``tables`` are those of their coefficients."""

    sums: list[tuple[int, Lanes, int]] = field(default_factory=list)
    """Products of two series: the vector that they are in, the lanes, the table."""
    linear: list[tuple[Lanes, int]] = field(default_factory=list)
    constant: int | None = None
    jacobian: list[tuple[Lanes, Lanes, int | None, int | None]] = field(default_factory=list)
    """Columns of the Jacobian: lanes of the y_m that it multiplies; lanes of y_0 and their table, and the table of what
    does not depend on y_0."""


class Arrangement:
    """Assignment of components, auxiliary components and products of a field to the lanes of vectors.

    ``pattern`` are the monomials of the field, component by component.

    Attributes
    ----------
    lanes : int
    components : int
    products : list of (tuple of int, tuple of int)
        Lanes of the left and right factors of each vector of products.
    stages : list of Stage
        The components, then the auxiliary components whose factors are known, and so on.
    level : tuple of int
        Stage of each lane.
    tables : list of tuple of Entry or None
        Coefficients, lane by lane; None is zero.
    """

    def __init__(self, pattern: Sequence[Sequence[Monomial]]) -> None:
        self.components = len(pattern)
        rows, levels = self._quadratic(pattern)
        self.lanes = max(4, 1 << (len(rows) - 1).bit_length())
        spare = self.lanes - len(rows)
        rows, self.level = [*rows, *([] for _ in range(spare))], (*levels, *[0] * spare)
        self.identity = tuple(range(self.lanes))
        self.tables: list[tuple[Entry | None, ...]] = []
        place = self._places(rows)
        needed = self._needed(place)
        self.stages = [self._stage(rows, place, level, needed) for level in range(1 + max(self.level))]
        columns = [lanes for lanes, *_ in self.stages[0].jacobian]
        sides = [
            tuple(side.get(lane, (columns[c] if c < len(columns) else self.identity)[lane]) for lane in self.identity)
            for c, side in enumerate(needed)
        ]
        self.products = list(zip(sides[::2], sides[1::2], strict=True))

    def _quadratic(self, pattern: Sequence[Sequence[Monomial]]) -> tuple[list[list[tuple[Entry, Factors]]], list[int]]:
        """Terms of the components and the auxiliary ones as products of at most two; and the stage of each."""
        auxiliary: dict[Factors, int] = {}

        def factor(monomial: Monomial) -> int:
            return monomial[0] if len(monomial) == 1 else auxiliary.setdefault(factors(monomial), self._next(auxiliary))

        def factors(monomial: Monomial) -> Factors:
            if len(monomial) <= 2:
                return monomial
            middle = len(monomial) // 2
            pair = factor(monomial[:middle]), factor(monomial[middle:])
            return min(pair), max(pair)

        rows = [[((i, m), factors(m)) for m in monomials] for i, monomials in enumerate(pattern)]
        levels = [0] * self.components
        for pair in auxiliary:
            levels.append(1 + max(levels[i] for i in pair))
            rows.append([(_ONE, pair)])
        return rows, levels

    def _next(self, auxiliary: dict[Factors, int]) -> int:
        return self.components + len(auxiliary)

    def _places(self, rows: list[list[tuple[Entry, Factors]]]) -> dict[Factors, tuple[int, int]]:
        """Vector and lane of each product: the k-th of a component in its own lane of vector k, or where there is room.

        They are packed if that saves a vector.
        """
        products = [[factors for _, factors in row if len(factors) == 2] for row in rows]
        most, count = max(map(len, products)), len({factors for row in products for factors in row})
        packed = most * self.lanes - count >= self.lanes
        place: dict[Factors, tuple[int, int]] = {}
        for k in range(most):
            for i, row in enumerate(products):
                if k < len(row) and not (packed and k):
                    place.setdefault(row[k], (k, i))
        taken = set(place.values())
        free = ((v, lane) for v in range(count) for lane in self.identity if (v, lane) not in taken)
        for factors in sorted({factors for row in products for factors in row} - place.keys()):
            place[factors] = next(free)
        return place

    def _needed(self, place: dict[Factors, tuple[int, int]]) -> list[dict[int, int]]:
        """Component that each lane of the left and the right factors of each vector has; other lanes are free."""
        needed: list[dict[int, int]] = [{} for _ in range(2 + 2 * max((v for v, _ in place.values()), default=-1))]
        for factors, (vector, lane) in place.items():
            for side, component in enumerate(factors):
                needed[2 * vector + side][lane] = component
        return needed

    def _table(self, entries: Iterable[Entry | None]) -> int | None:
        """Number of the table with these coefficients; None if all are zero."""
        column = tuple(entries)
        if not any(column):
            return None
        if column not in self.tables:
            self.tables.append(column)
        return self.tables.index(column)

    def _stage(
        self,
        rows: list[list[tuple[Entry, Factors]]],
        place: dict[Factors, tuple[int, int]],
        level: int,
        needed: list[dict[int, int]],
    ) -> Stage:
        stage = Stage()
        mine = [row if self.level[i] == level else [] for i, row in enumerate(rows)]
        for vector in range(len(needed) // 2):
            entries = [
                [(place[factors][1], entry) for entry, factors in row if place.get(factors, (-1, 0))[0] == vector]
                for row in mine
            ]
            stage.sums += [(vector, lanes, table) for lanes, table in self._columns(entries)]
        stage.linear = self._columns([[(f[0], entry) for entry, f in row if len(f) == 1] for row in mine])
        stage.constant = self._table(next((entry for entry, f in row if not f), None) for row in mine)
        slopes: list[list[tuple[int, int | None, Entry]]] = [[] for _ in rows]
        for slope, row in zip(slopes, mine, strict=True):
            for entry, f in row:
                slope += [(f[0], f[1], entry), (f[1], f[0], entry)] if len(f) == 2 else [(*f, None, entry)] if f else []
        count = max(map(len, slopes))
        needed = [needed[c] if c < len(needed) else {} for c in range(count)]
        ordered = [self._ordered(slope, [side.get(i) for side in needed]) for i, slope in enumerate(slopes)]
        for c, column in enumerate(zip(*ordered, strict=True)):
            lanes = tuple(needed[c].get(i, i) if slope is None else slope[0] for i, slope in enumerate(column))
            of = tuple(i if slope is None or slope[1] is None else slope[1] for i, slope in enumerate(column))
            quadratic = self._table(slope and slope[2] if slope and slope[1] is not None else None for slope in column)
            linear = self._table(slope and slope[2] if slope and slope[1] is None else None for slope in column)
            stage.jacobian.append((lanes, of, quadratic, linear))
        return stage

    def _ordered(
        self, slopes: list[tuple[int, int | None, Entry]], needed: list[int | None]
    ) -> list[tuple[int, int | None, Entry] | None]:
        """Slopes of a row in the columns of the Jacobian, so that these are permutations that the products need."""
        left = list(slopes)
        row: list[tuple[int, int | None, Entry] | None] = [None] * len(needed)
        for c, component in enumerate(needed):
            if (fit := next((slope for slope in left if slope[0] == component), None)) is not None:
                row[c] = fit
                left.remove(fit)
        free = sorted((c for c, slope in enumerate(row) if slope is None), key=lambda c: needed[c] is not None)
        for c, slope in zip(free, left, strict=False):
            row[c] = slope
        return row

    def _columns(self, rows: list[list[tuple[int, Entry]]]) -> list[tuple[Lanes, int]]:
        """The k-th entries of all rows as lanes and the table of their coefficients."""
        columns = []
        for k in range(max(map(len, rows))):
            column = [row[k] if k < len(row) else (i, None) for i, row in enumerate(rows)]
            table = self._table(entry for _, entry in column)
            assert table is not None
            columns.append((tuple(lane for lane, _ in column), table))
        return columns

    def values(self, field: Field) -> list[float]:
        """Numbers of all tables for a field of this pattern, or of a part of it."""
        return [
            0.0 if entry is None else 1.0 if entry is _ONE else float(field[entry[0]].terms.get(entry[1], 0))
            for table in self.tables
            for entry in table
        ]


@lru_cache(maxsize=256)
def arrangement_of(pattern: tuple[tuple[Monomial, ...], ...]) -> Arrangement:
    """The arrangement of a pattern of fields."""
    return Arrangement(pattern)


STEP_SIZE_LEAD = 3
"""Distance from the last coefficient to those that determine the step size, which is then known at the same time."""
EXACTLY_DIVIDED = 7
"""Coefficients up to this one are divided by their index with the inverse in two parts: the rounding error of 1/3 is
the same in every step, and its effect would accumulate systematically."""


def expand(o: IRWriter, a: Arrangement, order: int, y0: Pair, log2_tol: Scalar) -> tuple[Scalar, Scalar, LaneValue]:
    """Store the coefficients 0..order of the solution through ``y0`` as the array ``y``.

    ``y0`` is the state and its low part. Returns the two results of ``step_size`` and the low part of coefficient 1.
    """
    for level, stage in enumerate(a.stages[1:], start=1):  # these lanes hold the series of the last step
        auxiliary = _first(o, a, stage, y0)
        mask = o.constant(tuple(float(of != level) for of in a.level))
        y0 = o.fma(y0[0], mask, auxiliary[0]), o.fma(y0[1], mask, auxiliary[1])
    # what all coefficients need: columns of the Jacobian, and coefficient 1
    at = _store(o, a, 0, y0[0])
    columns = [_jacobian(o, stage, at) for stage in a.stages]
    y, missed = _first(o, a, a.stages[0], y0)
    sums = _ProductSums(o, a)
    step: tuple[Scalar, Scalar] = (None, None)
    for m in range(1, order):
        for stage, jacobian in zip(a.stages[1:], columns[1:], strict=True):
            y = o.add(y, _slope(stage, jacobian, o, _permuted(o, a, y), sums.earlier(m, stage)))
        at = _store(o, a, m, y)
        if m == order - STEP_SIZE_LEAD:
            step = step_size(o, order, log2_tol)
        y = _slope(a.stages[0], columns[0], o, at, sums.earlier(m, a.stages[0]))
        # divided by m + 1; products for later coefficients follow, behind the critical path
        inverse = 1.0 / (m + 1)
        missing = float(Fraction(1, m + 1) - Fraction(inverse))
        if missing != 0.0 and m < EXACTLY_DIVIDED:
            y = o.fma(y, o.constant((inverse,) * a.lanes), o.mul(y, o.constant((missing,) * a.lanes)))
        else:
            y = o.mul(y, o.constant((inverse,) * a.lanes))
        sums.accumulate_ahead(m, order)
        o.barrier()
    o.store("y", order, y)
    return step[0], step[1], missed


Permuted = Callable[[Lanes], LaneValue]


def _permuted(o: IRWriter, a: Arrangement, y: LaneValue) -> Permuted:
    """Function that permutes the lanes of ``y``, each way once."""
    permuted = {a.identity: y}

    def lanes(order: Lanes) -> LaneValue:
        if order not in permuted:
            permuted[order] = o.permute(y, order)
        return permuted[order]

    return lanes


def _store(o: IRWriter, a: Arrangement, m: int, y: LaneValue) -> Permuted:
    """Store coefficient m and the factors that later sums need."""
    at = _permuted(o, a, y)
    o.store("y", m, y)
    for v, (left, right) in enumerate(a.products):
        o.store(f"left{v}", m, at(left))
        o.store(f"right{v}", m, at(right))
    return at


def _first(o: IRWriter, a: Arrangement, stage: Stage, y0: Pair) -> Pair:
    """Terms of a stage at y_0."""

    def at(lanes: Lanes, of: Pair = y0) -> Pair:
        return of if lanes == a.identity else (o.permute(of[0], lanes), o.permute(of[1], lanes))

    products = [pair_mul(o, at(left), at(right)) for left, right in a.products]
    terms = [pair_scale(o, o.table(table), at(lanes, products[v])) for v, lanes, table in stage.sums]
    terms += [pair_scale(o, o.table(table), at(lanes)) for lanes, table in stage.linear]
    zero = o.constant((0.0,) * a.lanes)
    if stage.constant is not None:
        terms.append((o.table(stage.constant), zero))
    total = terms[0] if terms else (zero, zero)
    for term in terms[1:]:
        total = pair_add(o, total, term)
    return total


def _jacobian(o: IRWriter, stage: Stage, at: Permuted) -> list[LaneValue]:
    """Columns of the Jacobian at y_0."""
    columns = []
    for _, of, quadratic, linear in stage.jacobian:
        if quadratic is None:
            assert linear is not None
            columns.append(o.table(linear))
        elif linear is None:
            columns.append(o.mul(at(of), o.table(quadratic)))
        else:
            columns.append(o.fma(at(of), o.table(quadratic), o.table(linear)))
    return columns


def _slope(stage: Stage, columns: list[LaneValue], o: IRWriter, at: Permuted, earlier: LaneValue | None) -> LaneValue:
    """Sum of the products of columns and permutations, plus ``earlier``; in two halves, for a short chain."""
    halves = [earlier, None]
    for k, (column, (lanes, *_)) in enumerate(zip(columns, stage.jacobian, strict=True)):
        half, y = halves[k % 2], at(lanes)
        halves[k % 2] = o.mul(column, y) if half is None else o.fma(column, y, half)
    left, right = halves
    if left is None:
        return o.constant((0.0,) * o.lanes)
    return left if right is None else o.add(left, right)


class _ProductSums:
    """Sums over k = 1..m-1 of the products y_k y_(m-k), computed in pairs, two coefficients ahead.

    The products of older coefficients are added after the instructions of the critical path, so that the latter are
    issued first; the few products with one of the last two or three coefficients are added in ``_complete``. Each sum
    has two halves, to shorten its dependency chain.
    """

    def __init__(self, o: IRWriter, a: Arrangement) -> None:
        self.o, self.a = o, a
        self.halves: dict[tuple[int, int, int], LaneValue] = {}
        self.sums: dict[int, list[LaneValue]] = {}

    def _gather(self, m: int, k: int, half: int) -> None:
        o = self.o
        for v in range(len(self.a.products)):
            x, z, slot = o.load(f"left{v}", k), o.load(f"right{v}", m - k), (m, v, half)
            self.halves[slot] = o.fma(x, z, self.halves[slot]) if slot in self.halves else o.mul(x, z)

    def accumulate_ahead(self, m: int, order: int) -> None:
        """Add products of y_1..y_(m-1) to the sums for m + 2 and m + 3, m even: half of them now, half at m + 1."""
        even = m - m % 2
        ks = range(1, even)
        middle = len(ks) // 2
        for k in ks[middle:] if m % 2 else ks[:middle]:
            for target in (even + 2, even + 3):
                if target < order and target - k < even:
                    self._gather(target, k, k % 2)

    def _complete(self, m: int) -> list[LaneValue]:
        """Add the remaining products and return the sums for m."""
        newer = m - 2 - m % 2
        rest = [k for k in range(1, m) if k >= newer or m - k >= newer]
        for k in sorted(rest, key=lambda k: max(k, m - k)):
            self._gather(m, k, int(2 * k > m))
        sums = []
        for v in range(len(self.a.products)):
            both = [self.halves[m, v, half] for half in (0, 1) if (m, v, half) in self.halves]
            sums.append(self.o.add(*both) if len(both) == 2 else both[0])
        return sums

    def earlier(self, m: int, stage: Stage) -> LaneValue | None:
        """Terms of a stage that contain y_1..y_(m-1) only."""
        if m == 1 or not stage.sums:
            return None
        if m not in self.sums:
            self.sums[m] = self._complete(m)
        total, o = None, self.o
        for v, lanes, table in stage.sums:
            product = self.sums[m][v]
            product = product if lanes == self.a.identity else o.permute(product, lanes)
            total = o.mul(product, o.table(table)) if total is None else o.fma(product, o.table(table), total)
        return total


def taylor_increment(o: IRWriter, order: int, d: Scalar, missed: LaneValue) -> tuple[LaneValue, LaneValue]:
    """Return the sum of y_m d^m over m = 1..order as y_1 d rounded, and the rest; ``missed`` is the low part of y_1.

    The rest is summed by pairs, pairs of pairs and so on (Estrin's scheme), for a short dependency chain.
    """
    z, power = o.splat(d), d
    terms = [o.load("y", m) for m in range(2, order + 1)]
    while len(terms) > 1:
        factor = o.splat(power)
        joined = [o.fma(high, factor, low) for low, high in zip(terms[::2], terms[1::2], strict=False)]
        terms = joined + terms[2 * len(joined) :]
        power = o.mul(power, power)
    first = o.load("y", 1)
    main = o.mul(first, z)
    return main, o.fma(o.fma(terms[0], z, missed), z, o.fma(first, z, o.negative(main)))


MAX_STEP, SAFE_STEP = 4.0, 0.25
"""Longest step, in units in which the rates of change are of order one: of a state at rest, and if the coefficients
that determine the step vanish, as those of x'' = t^5 x from t = 0. With the second one, the terms that are left out are
below round-off."""
MAX_RADIUS_FRACTION = 0.6
"""Longest step, as a fraction of the radius of convergence estimated from the later coefficients."""


_NEAR_ZERO = 2.0**-10
"""Size of a state relative to its motion in the step, below which the latter counts."""
VANISHING = -1000.0
"""Logarithm of a coefficient that vanishes."""


def step_size(o: IRWriter, order: int, log2_tol: Scalar) -> tuple[Scalar, Scalar]:
    """Return the step for which the last term stays below tol times the state, and a logarithm to detect inf and nan.

    As in Jorba and Zou (Exp. Math. 14, 2005), the radius is estimated from two coefficients, because one may vanish by
    symmetry; these are not the last two, so that the estimate overlaps with their computation. If the coefficients are
    small for another reason than the radius, the ratio to the middle ones bounds the step. Near zero, the last term is
    compared with the motion in the step instead of the state.
    """
    half, last = order // 2, order - STEP_SIZE_LEAD
    y0, y1, before, late = (o.logarithm(o.load("y", m)) for m in (0, 1, last - 1, last))
    motion = o.add(y1, o.number(math.log2(_NEAR_ZERO)))
    middle = o.largest(o.logarithm(o.load("y", half - 1)), o.logarithm(o.load("y", half)))
    least = o.largest(before, late)

    def step_until(m: int, term: Scalar) -> Scalar:
        of_state = o.mul(o.sub(y0, term), o.number(1.0 / m))
        return o.largest(of_state, o.mul(o.sub(motion, term), o.number(1.0 / (m - 1))))

    ratio = o.largest(o.mul(o.sub(middle, least), o.number(1.0 / (last - half))), o.sub(o.number(VANISHING), middle))
    share = o.mul(log2_tol, o.number(1.0 / (order - 1)))
    step = o.least(step_until(last - 1, before), step_until(last, late))
    step = o.least(o.add(step, share), o.add(ratio, o.number(math.log2(MAX_RADIUS_FRACTION))))
    vanish = o.least(o.sub(o.number(VANISHING), o.least(middle, least)), o.sub(y1, o.number(VANISHING)))
    longest = o.largest(
        o.sub(o.number(math.log2(MAX_STEP)), o.largest(vanish, o.number(0.0))), o.number(math.log2(SAFE_STEP))
    )
    return o.power(o.largest(o.least(step, longest), o.number(-1000.0))), least
