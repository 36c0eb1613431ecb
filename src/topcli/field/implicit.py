"""Implicit steps of polynomial fields as straight-line code: Kahan's step and Newton's step of the midpoint rule.

Both solve a linear system for half of the change, u, with d = h/2 and the Jacobian f':

- Kahan's step of a quadratic field (Kahan 1993; Hirota and Kimura's for tops): (1 - d f'(y)) u = d f(y), y' = y + 2 u;
- Newton's step for u = d f(y + u), any degree: (1 - d f'(m)) v = d f(m) - u at m = y + u, and the new u is u + v.

The system is solved symbolically, once for each field:

1. **Blocks.** The components split into blocks that depend only on themselves and on earlier blocks. A later block sees
   the field at the means y + u of the earlier components.
2. **Shift.** In a block, let the components A be those whose equations contain the others, B, only linearly: omega,
   given gamma. If each equation of A contains one component of B at most, A is solved as if B did not change,
   u_A = u0, and B sees A at its means. Then u_A = u0 + e v, where e is d times the largest coefficient of B in A. The
   equations for v have no right-hand side, and constants of size at most one in the columns of B.
3. **Elimination.** Constant entries of size at least 1/2 are eliminated first, without a division: those that change
   the fewest entries, but first the second best of them. Cramer's rule solves for the remaining two unknowns (up to
   four if there is no such entry), with one division.
4. **Numerators.** An eliminated unknown is a known part plus a numerator times 1/determinant, so that one fused product
   and one sum follow the division.

The choices in 2 and 3 are fixed rules. On twelve tops, the best of all orders of elimination costs 1.5 % less at most.

The unknowns are changes of the state: their rounding errors are proportional to the change, and the one addition
state + change rounds without bias.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any, TypeVar

from topcli.field.polynomial import Field, strongly_connected, variational
from topcli.field.straight_line import ONE, Graph, Sum, Term, is_power_of_two, minus

HALF = Fraction(1, 2)
SMALLEST_PIVOT = HALF
"""Constant entries below this size are not pivots."""
CORE, LARGEST_CORE = 2, 4
"""Unknowns that Cramer's rule solves for, and at most if no constant entry is left."""
_Matrix = dict[tuple[int, int], Sum]


@dataclass(frozen=True)
class Solution:
    """Solution of a linear system: unknown i is ``part[i] + numerator[i]/divisor``."""

    part: Mapping[int, Sum]
    numerator: Mapping[int, Sum]
    divisor: Term


class KahanStep:
    """Kahan's step of a quadratic field; nodes ``outputs`` of the ``graph`` of operations are the new state.

    The step reads its constants from ``p[first]`` on.
    """

    factor = 2
    """The output is the input plus this multiple of the solution."""

    def __init__(self, field: Field, first: int = 0) -> None:
        self.field, self.graph = field, Graph(first)
        graph, every = self.graph, range(len(field))
        self.half: dict[int, Sum] = {}
        """Half of the change of the components that are solved."""
        self.change: dict[int, Sum] = {}
        self._began = False
        self._determinants: list[int] = []
        self._pivots: dict[tuple[Sum, ...], list[tuple[int, int]]] = {}
        self.d = graph.product(graph.fixed("h"), graph.constant(HALF))
        self.start, self.y = self._inputs()
        self.mean = dict(enumerate(self.y))
        """The mean of a solved component, and the component itself before."""

        links, square = [rate.variables() for rate in field], [rate.nonlinear() for rate in field]
        for block in self._in_turn(strongly_connected(links, every)):
            lead = tuple(sorted(itertools.chain(*strongly_connected(square, block)[:-1])))
            rest = tuple(i for i in block if i not in lead)
            linear = [sum((j,) in field[i].terms for j in rest) for i in lead]
            if max(linear, default=0) == 1:
                self._finish(self._shifted(block, lead, rest, strongly_connected(links, lead)))
            else:
                self._finish(self._solved(block))
        self.outputs = [self._plus(self.start[i], self.change[i]) for i in sorted(self.change)]

    @property
    def constants(self) -> tuple[Fraction, ...]:
        """Constants that the step reads."""
        return tuple(self.graph.constants)

    def source(self, name: str) -> str:
        """Source of the step, with the values of its constants."""
        values = (f"# p[{self.graph.first + i}] = {c}\n" for i, c in enumerate(self.constants))
        return "".join(values) + self.graph.source(name, self.outputs)

    def _in_turn(self, blocks: list[tuple[int, ...]]) -> list[tuple[int, ...]]:
        """The blocks to solve, in this order."""
        return blocks

    def _inputs(self) -> tuple[list[int], list[int]]:
        """Nodes of what the solution is added to, and of the state at which the Jacobian is taken."""
        y = [self.graph.input(f"s[{i}]") for i in range(len(self.field))]
        return y, y

    def _side(self, i: int) -> Sum:
        """Right-hand side d f_i, with the solved components at their means."""
        terms: Sum = ()
        for monomial, c in sorted(self.field[i].terms.items()):
            if len(monomial) == 2 and set(monomial) <= self.half.keys():  # y z becomes y (mean of z) + (half of y) z
                a, b = monomial
                terms += self._scaled(c, [self.y[a], self.mean[b]])
                terms += self.graph.times(self._scaled(c, [self.y[b]]), self.half[a])
            else:
                terms += self._scaled(c, [self.mean[k] for k in monomial])
        return terms

    def _plus(self, node: int, terms: Sum) -> int:
        """Node of ``node`` + sum, rounded once at the size of ``node``."""
        if len(terms) > 1:
            terms = self.graph.value(terms)
        ((_, (node,)),) = self.graph.value((*terms, (Fraction(1), (node,))))
        return node

    def _scaled(self, c: Fraction, nodes: Sequence[int]) -> Sum:
        """d c times the ``nodes``; a product of d c with one of them is shared if it is known."""
        graph = self.graph
        factor = graph.value(((abs(c), (self.d,)),))[0][1][0]
        ordered = sorted(nodes, key=lambda node: (not graph.is_product((factor, node)), node))
        factors = (graph.product(factor, ordered[0]), *ordered[1:]) if ordered else (factor,)
        return ((Fraction(1 if c > 0 else -1), factors),)

    def _entry(self, i: int, j: int) -> Sum:
        """Entry of the matrix 1 - d f'."""
        slope = sorted(self.field[i].derivative(j).terms.items())
        terms = (minus(self._scaled(c, [self.y[k] for k in monomial])) for monomial, c in slope)
        return sum(terms, start=ONE if i == j else ())

    def _system(self, block: Sequence[int]) -> _Matrix:
        return {(i, j): self._entry(i, j) for i in block for j in block}

    def _solved(self, block: Sequence[int]) -> Solution:
        return self._eliminated(self._system(block), {i: self._side(i) for i in block}, block)

    def _shifted(
        self, block: Sequence[int], lead: Sequence[int], rest: Sequence[int], parts: Sequence[Sequence[int]]
    ) -> Solution:
        """Solution of a block whose components ``lead`` contain the ``rest`` linearly; ``parts`` are blocks of lead."""
        graph, field = self.graph, self.field
        for part in parts:
            solved = self._solved(part)
            self._determinants += solved.divisor[1]
            self._hold(solved)
        largest = max(abs(field[i].terms.get((j,), Fraction(0))) for i in lead for j in rest)
        e = graph.single(((largest, (self.d,)),))
        matrix = self._system(block)
        for i, j in itertools.product(lead, rest):
            c = field[i].terms.get((j,), Fraction(0)) / largest
            matrix[i, j] = ((-c, ()),) if c else ()
            matrix[j, i] = graph.times(e, matrix[j, i])
        solution = self._eliminated(matrix, {i: () if i in lead else self._side(i) for i in block}, block)
        part = {i: self.half[i] + graph.times(e, solution.part[i]) if i in lead else solution.part[i] for i in block}
        numerator = {i: graph.times(e, n) if i in lead else n for i, n in solution.numerator.items()}
        return Solution(part, numerator, solution.divisor)

    def _next_pivot(self, matrix: _Matrix, rows: Sequence[int], columns: Sequence[int]) -> tuple[int, int] | None:
        """Place of a constant that is not small, otherwise on the diagonal; None to leave the rest to Cramer's rule."""

        def is_constant(entry: Sum) -> bool:
            return len(entry) == 1 and not entry[0][1] and abs(entry[0][0]) >= SMALLEST_PIVOT

        def fill(place: tuple[int, int]) -> tuple[int, tuple[int, int]]:
            in_row = sum(bool(matrix[place[0], j]) for j in columns) - 1
            return in_row * (sum(bool(matrix[i, place[1]]) for i in rows) - 1), place

        places = [(i, j) for i in rows for j in columns if is_constant(matrix[i, j])]
        if len(rows) <= (CORE if places else LARGEST_CORE):
            return None
        places = sorted(places or [(i, i) for i in rows if i in columns], key=fill)
        second = not self._began and len(places) > 1
        self._began = True
        return places[second]

    def _eliminated(self, matrix: _Matrix, side: dict[int, Sum], names: Sequence[int]) -> Solution:
        """Solve ``matrix`` u = ``side``; a matrix that was solved before gets the same pivots."""
        graph = self.graph
        rows, columns = list(names), list(names)
        same = tuple(matrix[i, j] for i in names for j in names)
        # an equal matrix is eliminated in the same order again
        planned = iter([*self._pivots[same], None]) if same in self._pivots else None
        done: list[tuple[int, int]] = []
        while True:
            if planned is None:
                place = self._next_pivot(matrix, rows, columns)
            else:
                numbers = next(planned)
                place = numbers and (names[numbers[0]], names[numbers[1]])
            if place is None:
                break
            row, column = place
            rows.remove(row)
            columns.remove(column)
            if matrix[place] != ONE:
                inverse = graph.quotient(1, *graph.single(matrix[place]))
                for j in columns:
                    matrix[row, j] = graph.times(matrix[row, j], inverse)
                side[row] = graph.times(side[row], inverse)
            for i in rows + [r for r, _ in done]:
                if matrix[i, column]:
                    a = graph.single(matrix[i, column])
                    for j in columns:
                        matrix[i, j] += minus(graph.times(a, matrix[row, j]))
                    side[i] += minus(graph.times(a, side[row]))
            done.append(place)
        self._pivots[same] = [(names.index(i), names.index(j)) for i, j in done]

        # what is left has no pivot that is never zero, and is solved by determinants
        for i, j in itertools.product(rows, columns):
            matrix[i, j] = graph.single(matrix[i, j])
        numerator, divisor = self._cramer(matrix, {i: graph.single(side[i]) for i in rows}, rows, columns)
        part: dict[int, Sum] = dict.fromkeys(columns, ())
        for i, j in done:
            part[j] = side[i]
            terms = (minus(graph.times(matrix[i, k], numerator[k])) for k in columns)
            numerator[j] = graph.single(sum(terms, start=()))
        return Solution(part, numerator, divisor)

    def _cramer(
        self, matrix: _Matrix, side: Mapping[int, Sum], rows: Sequence[int], columns: Sequence[int]
    ) -> tuple[dict[int, Sum], Term]:
        """Numerator of each column, and the determinant, by minors of the matrix extended by ``side``."""
        graph, right = self.graph, -1
        extended = matrix | {(i, right): terms for i, terms in side.items()}
        minors: dict[tuple[tuple[int, ...], tuple[int, ...]], Sum] = {}

        def minor(rows: tuple[int, ...], columns: tuple[int, ...]) -> Sum:
            if len(rows) < 2:
                return extended[rows[0], columns[0]] if rows else ONE
            if (rows, columns) not in minors:
                terms: Sum = ()
                k = 2 if len(rows) > 3 else 1  # Laplace's expansion by one row, or by two of four
                for top in itertools.combinations(range(len(columns)), k):
                    a = minor(rows[:k], tuple(columns[c] for c in top))
                    b = minor(rows[k:], tuple(c for i, c in enumerate(columns) if i not in top)) if a else ()
                    sign = (-1) ** (sum(top) + k * (k - 1) // 2)
                    terms += tuple((sign * s, factors) for s, factors in graph.times(a, b))
                minors[rows, columns] = graph.single(terms)
            return minors[rows, columns]

        numerator = {}
        for k, j in enumerate(columns):
            value = minor(tuple(rows), (*columns[:k], *columns[k + 1 :], right))
            numerator[j] = value if (len(columns) - k) % 2 else minus(value)
        (divisor,) = minor(tuple(rows), tuple(columns))
        return numerator, divisor

    def _hold(self, solution: Solution) -> None:
        """Half changes that are known from now on."""
        inverse = self.graph.quotient(1, solution.divisor)
        for i, numerator in solution.numerator.items():
            self.half[i] = self.graph.single(solution.part[i] + self.graph.times(numerator, inverse))
            self.mean[i] = self._plus(self.y[i], self.half[i])

    def _finish(self, solution: Solution) -> None:
        """Changes of a block, and its half changes and means for later ones."""
        graph = self.graph
        inverse = graph.quotient(self.factor, solution.divisor)
        for i, numerator in solution.numerator.items():
            part = tuple((self.factor * c, factors) for c, factors in graph.single(solution.part[i]))
            self.change[i] = part + graph.times(numerator, inverse)
        self._determinants += solution.divisor[1]
        self._hold(solution)

    def changes(self) -> list[int]:
        """Nodes of the changes of the components."""
        return [self.graph.node_of(self.change[i]) for i in sorted(self.change)]

    @property
    def determinants(self) -> list[int]:
        """Nodes of all determinants."""
        return self._determinants


class KahanTangent(KahanStep):
    """Kahan's step and its tangent map: input (y, v), output the new y and the image of v.

    This is Kahan's step of the variational field. The linear systems for y and v have the same matrix, which is
    eliminated once; y gets the bits of ``KahanStep``.
    """

    def __init__(self, field: Field, first: int = 0) -> None:
        self._d = len(field)
        super().__init__(variational(field), first)

    def _in_turn(self, blocks: list[tuple[int, ...]]) -> list[tuple[int, ...]]:
        return sorted(blocks, key=lambda block: block[0] // self._d)


class MidpointTangent(KahanTangent):
    """Tangent map of the midpoint rule, for a field of any degree: input (y, u, v), output the image of v.

    u is half of the change of y. With the mean m = y + u it solves (1 - d f'(m)) w = d f'(m) v; the image is v + 2 w.
    """

    def _inputs(self) -> tuple[list[int], list[int]]:
        graph, d = self.graph, self._d
        y, u, v = ([graph.input(f"s[{k * d + i}]") for i in range(d)] for k in range(3))
        mean = [graph.node("+", *pair) for pair in zip(y, u, strict=True)]
        return [*y, *v], [*mean, *v]

    def _in_turn(self, blocks: list[tuple[int, ...]]) -> list[tuple[int, ...]]:
        return [block for block in blocks if block[0] >= self._d]


class NewtonStep(KahanStep):
    """Newton's step of the midpoint rule, for a field of any degree: input (y, u), output the new u, then sizes.

    The size of a component is the sum of the magnitudes of the terms of d f. Round-off in its u is relative to it.

    The right-hand sides are sums with short coefficients, such as B - C, divided by a short number, such as A: rounding
    errors of quotients (B - C)/A would be a torque, and the integrals would drift.
    """

    factor = 1

    def __init__(self, field: Field, first: int = 0) -> None:
        self._sizes: dict[int, int] = {}
        super().__init__(field, first)
        self.outputs += [self._sizes[i] for i in range(len(field))]

    def _inputs(self) -> tuple[list[int], list[int]]:
        graph, d = self.graph, len(self.field)
        half = [graph.input(f"s[{d + i}]") for i in range(d)]
        return half, [graph.node("+", graph.input(f"s[{i}]"), half[i]) for i in range(d)]

    def _side(self, i: int) -> Sum:
        """Right-hand side d f_i - u_i, where f_i is a sum with coefficients below two, divided by one number."""
        terms: Sum = ((Fraction(-1), (self.start[i],)),)
        graph, coefficients = self.graph, self.field[i].terms.values()
        common = math.lcm(*(c.denominator for c in coefficients))
        largest = max((int(abs(c) * common) for c in coefficients), default=1)
        divisor = Fraction(common, 1 << (largest.bit_length() - 1))
        rate = tuple((c * divisor, tuple(self.y[k] for k in m)) for m, c in sorted(self.field[i].terms.items()))
        if rate:
            ((sign, (node,)),) = graph.value(rate)
            size = graph.size(node)
            if not is_power_of_two(divisor):
                node, size = (graph.node("/", x, graph.constant(divisor)) for x in (node, size))
                divisor = Fraction(1)
            factor = graph.product(self.d, graph.constant(1 / divisor))
            terms += ((sign, (factor, node)),)
            self._sizes[i] = graph.product(factor, size)
        else:
            self._sizes[i] = graph.fixed("0.0")
        for j in self.half:
            terms += self.graph.times(minus(self._entry(i, j)), self.half[j])
        return terms


_Kind = TypeVar("_Kind", bound=KahanStep)


@lru_cache(maxsize=256)
def _generated(kind: type[KahanStep], field: Field, first: int) -> Any:
    return kind(field, first)


def generated(kind: type[_Kind], field: Field, first: int = 0) -> _Kind:
    """Code of a ``kind`` for a field; its constants begin at ``p[first]``."""
    return _generated(kind, field, first)
