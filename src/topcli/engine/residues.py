"""Numbers modulo a prime, in arrays and with derivatives, for exact and fast runs of rational steps.

A quantity that is a rational function of the state, such as one step of a scheme written with ``+ - * /``, has a value
modulo a prime. There a number never grows and nothing is rounded, and what holds for random residues holds identically,
up to a probability of the order of the degree over the prime.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Scheme, StepFunction, Top
from topcli.engine.precise import precise_method, precise_top, refused
from topcli.engine.precise_numbers import NotRationalError, Rational, Rationals, StrayDoubleError, is_short
from topcli.field.polynomial import DECIDES, decimal

PRIME = 2**31 - 1
Residues = NDArray[np.int64]
MOST_DECISIONS = 10**4
"""Comparisons of residues in a step; more are an endless loop."""
_decision: ContextVar[Callable[[], bool]] = ContextVar("decision", default=lambda: False)
"""Outcome of comparisons by size: residues have no order. They are equal if they are at all points."""


@contextmanager
def deciding(answer: bool) -> Iterator[None]:
    """Let all comparisons of residues be ``answer``. Raises NotRationalError after ``MOST_DECISIONS``."""
    left = iter(range(MOST_DECISIONS))

    def decide() -> bool:
        if next(left, None) is None:
            raise NotRationalError(DECIDES)
        return answer

    token = _decision.set(decide)
    try:
        yield
    finally:
        _decision.reset(token)


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
    return int(value.numerator * pow(value.denominator, -1, PRIME) % PRIME)  # gmpy2 has integers of its own


class Jet:
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
        if isinstance(other, Rational):
            return residue(other.q)
        if isinstance(other, float) and not is_short(other):
            raise StrayDoubleError(other)
        return residue(Fraction(other)) if isinstance(other, int | float | Fraction) else None

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

    __radd__, __rmul__ = __add__, __mul__

    def __neg__(self) -> Jet:
        return Jet(-self.a % PRIME)

    def __pos__(self) -> Jet:
        return self

    def __sub__(self, other: Any) -> Jet:
        return self + -other

    def __rsub__(self, other: Any) -> Jet:
        return -self + other

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
        return _decision.get()()

    __lt__ = __le__ = __gt__ = __ge__ = _decide

    def __bool__(self) -> bool:
        return bool(self.a[0].any())

    def __eq__(self, other: object) -> bool:
        return not (self - other)

    __hash__ = None  # pyright: ignore[reportAssignmentType]

    def __abs__(self) -> Jet:
        return self if self._decide() else -self


class Modular(Rationals):
    """Arithmetic of ``Jet``s; constants are rational numbers, which can be compared."""

    purpose = "integrability"

    def __init__(self) -> None:
        super().__init__()
        self.name = "rational functions"


@dataclass(frozen=True)
class RationalMap:
    """One step of a scheme of a top with ``d`` components as a rational map.

    ``enter`` makes the scheme's own state of a state, which ``step`` advances and from which
    ``leave`` returns the state.
    """

    d: int
    enter: Callable[[Sequence[Any]], Sequence[Any]]
    step: Callable[[Sequence[Any]], Sequence[Any]]
    leave: Callable[[Sequence[Any]], Sequence[Any]]


def rational_map(scheme: Scheme, top: Top, options: Any, h: Fraction, arithmetic: Rationals) -> RationalMap:
    """Map of a scheme with the step size h; parameters are the decimal numbers that they print as.

    In the ``arithmetic`` ``Modular()`` a state is a tuple of ``Jet``s, in ``Rationals()`` of rational numbers.

    Raises UsageError, naming the scheme and the reason, if its step is not a rational function.
    """
    parameters = {name: decimal(value) for name, value in dict(top).items() if isinstance(value, float)}
    exact = precise_top(top, parameters)
    precise = precise_top(top, {name: arithmetic.number(value) for name, value in parameters.items()})
    method = precise_method(scheme, top, options, precise, arithmetic, exact)
    p: Any
    step_size: Any
    p, step_size = (*precise.constants(), *map(arithmetic.number, method.constants)), arithmetic.number(h)

    def with_constants(function: StepFunction | None) -> Callable[[Sequence[Any]], Sequence[Any]]:
        return (lambda y: function(tuple(y), step_size, p)) if function else lambda y: y

    made = RationalMap(len(top.components), *map(with_constants, (method.enter, method.step, method.leave)))
    if isinstance(arithmetic, Modular):
        try:
            decided = _is_decided(made)
        except NotRationalError as error:
            raise refused(scheme, arithmetic, str(error)) from None
        if decided:
            raise refused(scheme, arithmetic, DECIDES)
    return made


def _is_decided(step: RationalMap) -> bool:
    """True if the state after two steps depends on comparisons; those of counters do not matter.

    Raises NotRationalError for a state that is not a function of the one before.
    """
    y = [Jet(np.array([[PRIME // (i + 3)]])) for i in range(step.d)]
    found: list[list[int]] = []
    for answer in (False, True):
        with deciding(answer):
            state = step.leave(step.step(step.step(step.enter(y))))
        if not all(isinstance(x, Jet) for x in state):
            raise NotRationalError("returns a component that does not depend on the state")
        found.append([int(x.a[0, 0]) for x in state])
    return found[0] != found[1]
