"""Projection of the state onto the initial values of the top's integrals, for steps of any scheme.

A round solves for the shortest correction that restores all integrals to first order: one integral after the other,
along the part of its gradient that is normal to the earlier gradients. A gradient that depends on the earlier ones, as
on degenerate tori, is left out. The correction shrinks quadratically, so that three rounds reach round-off from
deviations of 1 %; a step whose last correction is still visible has failed.

The values and the gradients are straight-line code that is generated from the polynomials, without loops or branches,
so that ensembles are vectorised.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from typing import Any, cast

import numpy as np

from topcli.arithmetic.fused import defined, follow_precision
from topcli.arithmetic.sized import Operators
from topcli.contracts import Floats, Invariant, Method, StepFunction, Stepper, Top, same_state
from topcli.errors import UsageError
from topcli.field.integrals import polynomial_value
from topcli.field.polynomial import NotPolynomialError, Polynomial, decimal
from topcli.field.straight_line import ONE, Graph, Sum, compiled_function, minus

DEPENDENT = 2.0**-30
"""Squared sine of the angle to the earlier gradients below which a gradient is left out."""
_SETTLED = 2.0**-52
"""Largest square of the last correction, relative to the square of the state."""
ROUNDS = 3
follow_precision(__name__, caps=("ROUNDS",), DEPENDENT=1, _SETTLED=1)


@dataclass(frozen=True)
class Projection:
    """Functions of a projection onto ``count`` integrals and the constants that they read from ``p``.

    ``values(y, h, p)`` are the integrals, which are the targets at the initial state. ``project(y, targets, p)`` is
    the projected state, followed by the status: 0.0, or nan if it did not converge.
    """

    count: int
    values: StepFunction
    project: Callable[[Floats, Floats, Floats], Floats]
    constants: tuple[Fraction, ...]
    text: str


class TracedSum(Operators):
    """Formula of a polynomial as operations of a graph.

    A sum of terms is kept as it is written: expanded, the integral ((w1 - w2)(w1 + w2) - c g1)² + ... would lose its
    digits where it is small.
    """

    def __init__(self, graph: Graph, terms: Sum) -> None:
        self.graph, self.terms = graph, terms

    def _of(self, other: Any) -> Sum:
        if isinstance(other, TracedSum):
            return other.terms
        c = decimal(other)
        return ((c, ()),) if c else ()

    def __add__(self, other: Any) -> TracedSum:
        return TracedSum(self.graph, self.terms + self._of(other))

    def __mul__(self, other: Any) -> TracedSum:
        return TracedSum(self.graph, self.graph.times(self.terms, self._of(other)))

    def __neg__(self) -> TracedSum:
        return TracedSum(self.graph, minus(self.terms))

    def __truediv__(self, divisor: Any) -> TracedSum:
        return self * (1 / decimal(divisor))

    def __pow__(self, exponent: Any) -> TracedSum:
        return math.prod([self] * int(exponent), start=TracedSum(self.graph, ONE))


@lru_cache(maxsize=256)
def projection(top: Top, first: int) -> Projection:
    """Projection onto the integrals of ``top``; its constants begin at ``p[first]``.

    Raises UsageError for a top without integrals, or with an integral that is not a polynomial.
    """
    graph, d = Graph(first), len(top.components)
    y = [graph.input(f"s[{j}]") for j in range(d)]
    formulas: Any = np.array([[TracedSum(graph, ((Fraction(1), (node,)),)) for node in y]], dtype=object)

    def node(polynomial: Polynomial) -> int:
        terms = sorted(polynomial.terms.items())
        return graph.node_of(tuple((c, tuple(y[j] for j in monomial)) for monomial, c in terms))

    integrals = _polynomials(top)
    n, values = len(integrals), [graph.node_of(invariant.value(formulas)[0].terms) for invariant, _ in integrals]
    slopes = [node(integral.derivative(j)) for _, integral in integrals for j in range(d)]
    evaluated, text = compiled_function(graph, "evaluated", [*values, *slopes]), graph.source("values", values)
    limits = {"DEPENDENT": DEPENDENT, "_SETTLED": _SETTLED, "ROUNDS": ROUNDS, "nan": math.nan}
    project = defined(_source(n, d), f"projection {n}/{d}", evaluated=evaluated, __name__=__name__, **limits)["project"]
    return Projection(n, compiled_function(graph, "values", values), project, tuple(graph.constants), text)


def _source(n: int, d: int) -> str:
    """Source of ``project`` for ``n`` integrals of ``d`` components, by the modified Gram-Schmidt process.

    ``q`` are the normal parts of the gradients, ``u`` their inverse squares (0 if left out), ``e`` the correction.
    """

    def dot(a: str, b: str) -> str:
        return " + ".join(f"{a}{j} * {b}{j}" for j in range(d))

    state = "".join(f"y{j}, " for j in range(d))
    lines = [f"{state}= y", f"v = evaluated(({state}), 0.0, p)"]
    for i in range(n):
        lines += [f"a{j} = v[{n + i * d + j}]" for j in range(d)]
        lines += [f"q{i}_{j} = a{j}" for j in range(d)]
        for k in range(i):
            lines.append(f"m = ({dot('a', f'q{k}_')}) * u{k}")
            lines += [f"q{i}_{j} = q{i}_{j} - m * q{k}_{j}" for j in range(d)]
        lines.append(f"z, w = {dot(f'q{i}_', f'q{i}_')}, {dot('a', 'a')}")
        lines.append(f"u{i} = 1.0 / z if z > DEPENDENT * w else 0.0")
        earlier = f" - ({dot('a', 'e')})" if i else ""
        lines.append(f"m = (t[{i}] - v[{i}]{earlier}) * u{i}")
        lines += [f"e{j} = {f'e{j} + ' if i else ''}m * q{i}_{j}" for j in range(d)]
    lines += [f"y{j} = y{j} + e{j}" for j in range(d)]
    lines.append(f"status = 0.0 if {dot('e', 'e')} <= _SETTLED * ({dot('y', 'y')}) else nan")
    body = "\n    ".join(lines)
    return (
        f"def corrected(y, t, p):\n    {body}\n    return ({state}status)\n"
        f"def project(y, t, p):\n    {state}= y\n    w = ({state}0.0)\n"
        f"    for _ in range(ROUNDS):\n        w = corrected(w[:{d}], t, p)\n    return w\n"
    )


def _polynomials(top: Top) -> list[tuple[Invariant, Polynomial]]:
    """Integrals that every motion of ``top`` conserves, with their polynomials; see ``projection``."""
    integrals = []
    for invariant in top.invariants():
        if not invariant.on:
            try:
                integrals.append((invariant, polynomial_value(invariant.value, len(top.components))))
            except NotPolynomialError as error:
                needs = f"scheme.project needs polynomial integrals, but {invariant.name!r} {error}"
                raise UsageError(f"top {top.kind!r}: {needs}") from None
    if not integrals:
        raise UsageError(f"top {top.kind!r}: scheme.project needs integrals, and this top declares none")
    return integrals


def projected(method: Method, top: Top, every: int) -> Stepper:
    """``method`` with a projection onto the initial values of all integrals of ``top`` after every ``every`` steps.

    The working state is that of ``method`` up to its status, the targets, the number of steps to the next projection,
    the status and the counters. If the working state of ``method`` does not begin with the physical state, it is made
    again from the projected state.

    Raises UsageError for a method with its own time loop, for a top without integrals, or with an integral that is not
    a polynomial.
    """
    if not isinstance(method, Stepper):
        raise UsageError("scheme.project: a scheme with its own time loop cannot be projected")
    d, before = len(top.components), len(method.parameters(top))  # numbers of constants before those of the projection
    used = projection(cast(Any, top), before)
    inner, values, project, period = method.step, used.values, used.project, float(every)
    always = every == 1  # known to the compiler, unlike the number of steps
    enter, leave = method.enter or same_state, method.leave or same_state
    tail = method.width - len(method.counters)
    carried, targets = tail - method.iterative, tail - method.iterative + used.count
    others = targets + 1 + (not method.iterative)  # the status and the counters of the method

    # a step fails if the scheme or its projection does: both statuses are 0.0 or nan, and are added
    def status_of(new: Floats) -> float:
        return new[carried]

    def settled(new: Floats) -> float:
        return 0.0

    status = status_of if method.iterative else settled

    def in_place(new: Floats, t: Floats, h: float, p: Floats) -> Floats:
        z = project(new[:d], t, p)
        return (*z[:d], *new[d:carried], z[d])

    def entered(new: Floats, t: Floats, h: float, p: Floats) -> Floats:
        z = project(leave(new, h, p[:before]), t, p)
        return (*enter(z[:d], h, p[:before])[:carried], z[d])

    def unchanged(new: Floats) -> Floats:
        return (*new[:carried], 0.0)

    restored = in_place if _begins_with_state(method, top) else entered

    def step(s: Floats, h: float, p: Floats) -> Floats:
        new = inner((*s[:carried], *s[others:]), h, p[:before])
        left = s[targets] - 1.0
        w = unchanged(new)
        if always or left <= 0.0:
            left = period
            w = restored(new, s[carried:targets], h, p)
        return (*w[:carried], *s[carried:targets], left, w[carried] + status(new), *new[tail:])

    # states enter with the targets, and leave without them
    def begin(y: Floats, h: float, p: Floats) -> Floats:
        s = enter(y, h, p[:before])
        return (*s[:carried], *values(y, h, p), period, status(s), *s[tail:])

    def state(s: Floats, h: float, p: Floats) -> Floats:
        return leave((*s[:carried], *s[others:]), h, p[:before])

    return replace(
        method,
        step=step,
        width=method.width + (others - carried),
        enter=begin,
        leave=state,
        iterative=True,
        checked=0,
        stages=None,
        constants=(*method.constants, *used.constants),
        source=lambda: (method.source() if method.source else "") + used.text,
        tangent=None,
    )


def _begins_with_state(method: Stepper, top: Top) -> bool:
    """True if the working state of ``method`` begins with the physical state, tried at one state.

    What follows there, such as the lengths of exact nodes, is set up once and may not be compilable.
    """
    if method.enter is None:
        return True
    y = tuple(0.5 * math.cos(j + 1.0) for j in range(len(top.components)))
    return method.enter(y, 0.01, tuple(map(float, method.parameters(top))))[: len(y)] == y
