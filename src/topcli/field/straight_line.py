"""Straight-line code: a shared graph of floating-point sums and products, and its source.

A *sum* is a tuple of terms ``(c, factors)``: an exact coefficient times the product of nodes of the graph. ``()`` is
zero, ``ONE`` is one. A sum becomes a node when its value is needed: its products are formed so that factors that are
known late are multiplied last, products and additions are fused, common factors are taken out where that saves a
product, and the terms are added in the order in which they become known. Equal operations are one node.
"""

from __future__ import annotations

import heapq
import sys
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from functools import lru_cache
from typing import Any

from topcli.arithmetic.fused import defined, fma
from topcli.errors import UsageError

Term = tuple[Fraction, tuple[int, ...]]
Sum = tuple[Term, ...]

ONE: Sum = ((Fraction(1), ()),)

LATENCY = {"input": 0, "fixed": 0, "abs": 1, "+": 3, "-": 3, "*": 3, "fma": 4, "/": 13}
"""Cycles until the result of an operation is known."""
BEFORE = -1
"""Time of nodes that do not depend on the state: they are computed before the loop over the steps."""


def minus(terms: Sum) -> Sum:
    """The sum with the opposite sign."""
    return tuple((-c, factors) for c, factors in terms)


def is_power_of_two(c: Fraction) -> bool:
    """True if products with ``c`` > 0 are exact."""
    return all(k & (k - 1) == 0 for k in (c.numerator, c.denominator))


class Graph:
    """Operations, each a node with a number: ``nodes[i]`` is its kind and arguments, ``time[i]`` when it is known.

    Arguments that are nodes are numbers, others are text. ``constants`` are the numbers that the code reads from its
    parameters ``p``, beginning at ``p[first]``.
    """

    def __init__(self, first: int = 0) -> None:
        self.first = first
        self.constants: list[Fraction] = []
        self.nodes: list[tuple[Any, ...]] = []
        self.time: list[int] = []
        self._known: dict[tuple[Any, ...], int] = {}
        self.one, self.two = self.fixed("1.0"), self.fixed("2.0")

    def node(self, kind: str, *arguments: int | str) -> int:
        """Node of an operation; the same one for the same operation."""
        operation = (kind, *arguments)
        if operation not in self._known:
            times = [self.time[a] for a in arguments if isinstance(a, int)]
            before = kind == "fixed" or (bool(times) and max(times) == BEFORE)
            self._known[operation] = len(self.nodes)
            self.nodes.append(operation)
            self.time.append(BEFORE if before else max([0, *times]) + LATENCY[kind])
        return self._known[operation]

    def knows(self, kind: str, *arguments: int | str) -> bool:
        """True if there is a node of this operation."""
        return (kind, *arguments) in self._known

    def input(self, text: str) -> int:
        """Node of a component of the state."""
        return self.node("input", text)

    def fixed(self, text: str) -> int:
        """Node of a number that is the same in every step."""
        return self.node("fixed", text)

    def constant(self, c: Fraction) -> int:
        """Node of c > 0: a literal for a power of two, otherwise a constant times a power of two.

        Raises UsageError for a number beyond the doubles, of a parameter that is very large or very small.
        """
        if c > sys.float_info.max:
            size = c.numerator.bit_length() - c.denominator.bit_length()
            raise UsageError(f"the field has a coefficient of about 2^{size}, which no double holds")
        if is_power_of_two(c):
            return self.fixed(repr(float(c)))
        for i, other in enumerate(self.constants):
            if is_power_of_two(c / other):
                return self.product(self.fixed(f"p[{self.first + i}]"), self.constant(c / other))
        self.constants.append(c)
        return self.fixed(f"p[{self.first + len(self.constants) - 1}]")

    def product(self, a: int, b: int) -> int:
        """Node of a b."""
        a, b = sorted((a, b), key=lambda node: (node in (self.one, self.two), node))
        if b == self.one:
            return a
        return self.node("+", a, a) if b == self.two else self.node("*", a, b)

    def is_product(self, factors: Sequence[int]) -> bool:
        """True if the product of two ``factors`` is a node already."""
        return self.knows("*", *sorted(factors))

    def _last_factors(self, c: Fraction, factors: tuple[int, ...]) -> tuple[int, ...]:
        """|c| times the product of ``factors``, as the one or two factors that are left to multiply: the latest."""
        left = [*factors, *([self.constant(abs(c))] if abs(c) != 1 else [])]
        left.sort(key=lambda node: (self.time[node], node))
        while len(left) > 2:
            left = sorted([self.product(*left[:2]), *left[2:]], key=lambda node: (self.time[node], node))
        pair = tuple(sorted(left)) or (self.one,)
        return (self.product(*pair),) if len(pair) == 2 and self.is_product(pair) else pair

    def _ready(self, factors: Iterable[int]) -> int:
        return max(self.time[node] for node in factors)

    def _factored(self, terms: list[Term]) -> list[Term]:
        """The terms with common factors taken out, which saves a product each time."""
        while True:
            users: dict[int, list[int]] = {}
            for at, (_, factors) in enumerate(terms):
                if len(factors) > 1 and not self.is_product(factors):
                    for node in set(factors):
                        users.setdefault(node, []).append(at)
            common = max(users, key=lambda node: (len(users[node]), -self.time[node], -node), default=None)
            if common is None or len(users[common]) < 2:
                return terms
            inner = []
            for at in users[common]:
                c, factors = terms[at]
                place = factors.index(common)
                inner.append((c, factors[:place] + factors[place + 1 :]))
            terms = [term for at, term in enumerate(terms) if at not in users[common]]
            terms += [(c, (common, *factors)) for c, factors in self.value(inner)]

    def value(self, terms: Iterable[Term]) -> Sum:
        """The sum as one term of one factor; the terms that are known first are added first."""
        heap = []
        for c, factors in self._factored(list(terms)):
            pair = self._last_factors(c, factors)
            heap.append((self._ready(pair), len(heap), 1 if c > 0 else -1, pair))
        heapq.heapify(heap)
        while len(heap) > 1:
            first, second = heapq.heappop(heap), heapq.heappop(heap)
            sign, node = self._added(*first[2:], *second[2:])
            heapq.heappush(heap, (self.time[node], len(self.nodes) + len(heap), sign, (node,)))
        return tuple((Fraction(sign), (self.product(*f) if len(f) == 2 else f[0],)) for _, _, sign, f in heap)

    def _added(self, s: int, a: tuple[int, ...], t: int, b: tuple[int, ...]) -> tuple[int, int]:
        """Sign and node of s a + t b for signs s and t and one or two factors a and b; the later product is fused."""
        if len(a) == 2 and (len(b) == 1 or self._ready(a) > self._ready(b)):
            s, a, t, b = t, b, s, a
        first = self.product(*a) if len(a) == 2 else a[0]
        if len(b) == 2:
            sign = s if s == t else 1
            return sign, self.node("fma", *b, first, "" if t == sign else "-", "" if s == sign else "-")
        if s == t:
            return s, self.node("+", *sorted((first, b[0])))
        return 1, self.node("-", *((first, b[0]) if s > 0 else (b[0], first)))

    def single(self, terms: Sum) -> Sum:
        """The sum as at most one term of at most one factor."""
        simple = len(terms) <= 1 and all((len(f) <= 1 and abs(c) == 1) or not f for c, f in terms)
        return terms if simple else self.value(terms)

    def times(self, a: Sum, b: Sum) -> Sum:
        """Product of two sums."""
        return tuple((s * t, f + g) for s, f in self.single(a) for t, g in self.single(b))

    def quotient(self, numerator: int, divisor: Term) -> Sum:
        """A whole number over a term of at most one factor."""
        c, factors = divisor
        if not factors:
            return ((numerator / c, ()),)
        twice = ("/", self.constant(Fraction(2 * numerator)), *factors)
        if self.knows(*twice):  # half of it is exact
            return ((c, (self.product(self.node(*twice), self.constant(Fraction(1, 2))),)),)
        return ((c, (self.node("/", self.constant(Fraction(numerator)), *factors),)),)

    def node_of(self, terms: Sum) -> int:
        """Node of the value of a sum, with its sign."""
        if not terms:
            return self.fixed("0.0")
        ((sign, (node,)),) = self.value(terms)
        return node if sign > 0 else self.node("*", node, self.fixed("-1.0"))

    def needed(self, outputs: Iterable[int]) -> list[int]:
        """Nodes that the ``outputs`` need, in the order of computation."""
        nodes: set[int] = set()
        stack = list(outputs)
        while stack:
            node = stack.pop()
            if node not in nodes:
                nodes.add(node)
                stack += [a for a in self.nodes[node][1:] if isinstance(a, int)]
        return sorted(nodes)

    def size(self, node: int) -> int:
        """Node of the sum of the magnitudes of the terms that ``node`` adds up."""
        sizes = [self.node("abs", term) for term in self._terms(node)]
        total = sizes[0]
        for size in sizes[1:]:
            total = self.node("+", total, size)
        return total

    def _terms(self, node: int) -> list[int]:
        kind, *arguments = self.nodes[node]
        if kind in ("+", "-"):
            return [term for a in arguments for term in self._terms(a)]
        if kind == "fma":
            _, _, before, _, sign = arguments  # the product is what it adds to the sum before
            return [*self._terms(before), self.node("+" if sign else "-", node, before)]
        return [node]

    def source(self, name: str, outputs: Sequence[int]) -> str:
        """Source of the function ``name(s, h, p)`` that returns the ``outputs``."""
        names: dict[int, str] = {}
        lines = []
        for node in self.needed(outputs):
            kind, *arguments = self.nodes[node]
            if kind in ("input", "fixed"):
                names[node] = arguments[0]
                continue
            x = [names[a] for a in arguments if isinstance(a, int)]
            if kind == "abs":
                text = f"abs({x[0]})"
            elif kind == "fma":
                text = f"fma({arguments[3]}{x[0]}, {x[1]}, {arguments[4]}{x[2]})"
            else:
                text = f"{x[0]} {kind} {x[1]}"
            names[node] = f"v{node}"
            lines.append(f"    v{node} = {text}\n")
        returned = ", ".join(names[node] for node in outputs)
        value = f"({returned},)" if returned else "()"
        return f"def {name}(s, h, p):\n{''.join(lines)}    return {value}\n"


def compiled_function(graph: Graph, name: str, outputs: Sequence[int]) -> Callable[..., Any]:
    """The function ``name(s, h, p)`` that returns the ``outputs``; graphs with the same source share it."""
    return _function(graph.source(name, outputs), name)


@lru_cache(maxsize=1024)  # tops that share a function share its machine code
def _function(source: str, name: str) -> Callable[..., Any]:
    return defined(source, f"generated {name}", fma=fma, __name__=__name__)[name]
