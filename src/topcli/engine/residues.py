"""Numbers modulo a prime, in arrays and with derivatives, for exact and fast runs of rational steps.

A quantity that is a rational function of the state, such as one step of a scheme written with ``+ - * /``, has a value
modulo a prime. There a number never grows and nothing is rounded, and what holds for random residues holds identically,
up to a probability of the order of the degree over the prime.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar, copy_context
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from itertools import repeat
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.sized import Operators
from topcli.contracts import Scheme, StepFunction, Top
from topcli.engine.numbers import NotRationalError, Numbers, precise_scheme, rationals, refused, short_fraction
from topcli.field.polynomial import DECIDES, decimal

PRIME = 2**31 - 1
Residues = NDArray[np.int64]
MOST_DECISIONS = 10**4
"""Comparisons of residues in a step; more are an endless loop."""
decisions: ContextVar[Iterator[bool] | None] = ContextVar("decisions", default=None)
"""Outcomes of comparisons by size; None for false. Residues have no order; they are equal if they are at all points."""


def folded(x: Residues) -> Residues:
    """Residues from -1 to PRIME + 2 of any integers; the prime is 2**31 - 1."""
    x = (x >> 31) + (x & PRIME)
    return (x >> 31) + (x & PRIME)


def inverse(values: Residues) -> Residues:
    """Inverses of residues, by Fermat's theorem. Raises ZeroDivisionError."""
    if not values.all():
        raise ZeroDivisionError("a denominator is zero modulo the prime")
    power, result, exponent = values, np.ones_like(values), PRIME - 2
    while exponent:
        if exponent & 1:
            result = result * power % PRIME
        power, exponent = power * power % PRIME, exponent >> 1
    return result


@lru_cache(maxsize=4096)
def residue(value: Fraction) -> int:
    """A rational number modulo the prime. Raises ZeroDivisionError."""
    if value.denominator % PRIME == 0:
        raise ZeroDivisionError("a denominator is zero modulo the prime")
    return int(value.numerator * pow(value.denominator, -1, PRIME) % PRIME)  # mpmath may have integers of its own


class Jet(Operators):
    """A quantity at several points, with derivatives: ``a[0]`` are its values, the other rows derivatives (k, points).

    The derivatives are those along the directions in which the initial components were given some.
    """

    __slots__ = ("a",)

    def __init__(self, a: Residues) -> None:
        self.a = a

    @staticmethod
    def _other(other: Any) -> Any:
        if isinstance(other, Jet):
            return other
        if isinstance(other, float):
            other = short_fraction(other)
        return residue(Fraction(other)) if isinstance(other, int | Fraction) else None

    def __add__(self, other: Any) -> Jet:
        value = self._other(other)
        if value is None:
            return NotImplemented
        if isinstance(value, Jet):
            return Jet((self.a + value.a) % PRIME)
        a = self.a.copy()
        a[0] = (a[0] + value) % PRIME
        return Jet(a)

    def __mul__(self, other: Any) -> Jet:
        value = self._other(other)
        if value is None:
            return NotImplemented
        if not isinstance(value, Jet):
            return Jet(self.a * value % PRIME)
        a = self.a * value.a[0] % PRIME
        a[1:] = (a[1:] + self.a[0] * value.a[1:]) % PRIME
        return Jet(a)

    def __neg__(self) -> Jet:
        return Jet(-self.a % PRIME)

    def reciprocal(self) -> Jet:
        """Return 1 over the quantity. Raises ZeroDivisionError."""
        value = inverse(self.a[0])
        a = self.a * (value * (PRIME - value) % PRIME) % PRIME
        a[0] = value
        return Jet(a)

    def __truediv__(self, other: Any) -> Jet:
        value = self._other(other)
        if value is None:
            return NotImplemented
        return self * (value.reciprocal() if isinstance(value, Jet) else pow(value, -1, PRIME))

    def __rtruediv__(self, other: Any) -> Jet:
        return self.reciprocal() * other

    def __pow__(self, exponent: Any) -> Jet:
        if not isinstance(exponent, int):
            raise NotRationalError(f"takes the power {float(exponent):g} of the state")
        base, result = self if exponent >= 0 else self.reciprocal(), Jet(np.zeros_like(self.a)) + 1
        for _ in range(abs(exponent)):
            result = result * base
        return result

    def _decide(self, *other: object) -> bool:
        answers = decisions.get()
        answer = False if answers is None else next(answers, None)
        if answer is None:
            raise NotRationalError(DECIDES)
        return answer

    __lt__ = __le__ = __gt__ = __ge__ = _decide

    def __bool__(self) -> bool:
        return bool(self.a[0].any())

    def __eq__(self, other: object) -> bool:
        return not (self - other)

    __hash__ = None  # pyright: ignore[reportAssignmentType]

    def __abs__(self) -> Jet:
        return self if self._decide() else -self


Map = Callable[[Sequence[Any]], Sequence[Any]]


@dataclass(frozen=True)
class RationalMap:
    """One step of a scheme of a top with ``d`` components as a rational map, with constants made by ``number``.

    ``enter`` makes the scheme's own state of a state, which ``step`` advances and from which
    ``leave`` returns the state.
    """

    d: int
    enter: Map
    step: Map
    leave: Map
    number: Callable[[Fraction], Any] = Fraction


def rational_map(scheme: Scheme, top: Top, options: Any, h: Fraction, numbers: Numbers) -> RationalMap:
    """Map of a scheme with the step size h in rational ``numbers``; parameters are the decimals that they print as.

    Raises UsageError, naming the scheme and the reason, if its step is not a rational function.
    """
    parameters = {name: decimal(value) for name, value in dict(top).items() if isinstance(value, float)}
    _, method = precise_scheme(scheme, top, options, parameters, numbers)

    size: Any = numbers.number(h)

    def with_size(function: StepFunction | None) -> Map:
        return (lambda y: function(tuple(y), size, ())) if function else lambda y: y

    return RationalMap(
        len(top.components), *map(with_size, (method.enter, method.step, method.leave)), number=numbers.number
    )


def modular_map(scheme: Scheme, top: Top, options: Any, h: Fraction) -> RationalMap:
    """Map of a scheme on states of ``Jet``s; its constants are rational numbers, which can be compared.

    Raises UsageError as ``rational_map``, and for a step that decides by the state.
    """
    numbers = replace(rationals(), name="rational functions", purpose="integrability")
    step = rational_map(scheme, top, options, h, numbers)
    try:
        if _two_steps(step, False) != _two_steps(step, True):
            raise NotRationalError(DECIDES)
    except NotRationalError as error:
        raise refused(scheme, numbers, str(error)) from None
    return step


def _two_steps(step: RationalMap, answer: bool) -> list[int]:
    """State after two steps in which all comparisons are ``answer``; those of counters do not matter.

    Raises NotRationalError for a state that is not a function of the one before.
    """
    y, context = [Jet(np.array([[PRIME // (i + 3)]])) for i in range(step.d)], copy_context()
    context.run(decisions.set, repeat(answer, MOST_DECISIONS))
    state = context.run(lambda: step.leave(step.step(step.step(step.enter(y)))))
    if not all(isinstance(x, Jet) for x in state):
        raise NotRationalError("returns a component that does not depend on the state")
    return [int(x.a[0, 0]) for x in state]
