"""Units of time and of the components that make the rates of change of a field of order one.

All units are powers of two, so that a change of units rounds nothing. Without it, coefficients of a Taylor series of
order 37 overflow at an angular velocity of 1e8.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from fractions import Fraction

from topcli.contracts import Array
from topcli.field.polynomial import Field, Polynomial, strongly_connected

_NOTHING = -(2**20)
"""Exponent that stands for zero."""
FREE = -(2**13)
"""A unit of time of 2^-FREE is longer than any: if it will do, the motion is a polynomial in time."""
_LONG = -64
"""The unit of time is then 2^-_LONG, which no run exceeds, ..."""
_ROOM = 512
"""... or a shorter one with which no unit of a component exceeds 2^_ROOM."""


class NaturalUnits:
    """Units in which the rates of change of one ``field`` are at most about one, for series of an ``order``.

    Components that occur in each other's products have the same unit. The unit of time is the longest possible one. A
    polynomial in time whose degree is at most the order is its own series at every step: its unit of time must not be
    that of its first rates, which from a component near zero can be tiny.
    """

    def __init__(self, field: Field, order: int) -> None:
        self.field, self.order = field, order
        self.groups = strongly_connected([rate.nonlinear() for rate in field], range(len(field)))
        self._terms = [[(_exponent(c), monomial) for monomial, c in rate.terms.items()] for rate in field]
        self._scaled: dict[tuple[int, ...], tuple[Field, int, list[int]]] = {}

    def at(self, y: Sequence[float] | Array) -> tuple[Field, int, list[int]]:
        """The field with time in units of 2^-k and component i in units of 2^units[i], exactly; ``k``; and ``units``.

        The components of the state ``y``, and their rates of change while they are of this size, are at most about one.
        A component that stays zero has the unit 2^_NOTHING, which is zero, and the terms with it are left out; ``k``
        and ``units`` thus determine the field.
        """
        start = [_NOTHING] * len(self.field)
        for group in self.groups:
            for i in group:
                start[i] = max(_exponent(float(y[j])) for j in group)
        if (sizes := tuple(start)) not in self._scaled:
            k = self._time(start)
            units = self._units(start, k) or start
            moving = {i for i, unit in enumerate(units) if unit > _NOTHING // 2}
            field = []
            for unit, rate in zip(units, self.field, strict=True):
                terms = {m: c for m, c in rate.terms.items() if moving.issuperset(m)}
                scales = {m: Fraction(2) ** (sum(units[j] for j in m) - unit - k) for m in terms}
                field.append(Polynomial({m: c * scales[m] for m, c in terms.items()}))
            self._scaled[sizes] = tuple(field), k, units
        return self._scaled[sizes]

    def _rate(self, i: int, units: list[int]) -> int:
        """Exponent of the largest term in the rate of a component; below ``_NOTHING``/2 if it does not move."""
        return max((c + sum(units[j] for j in m) for c, m in self._terms[i]), default=_NOTHING)

    def _units(self, start: list[int], k: int) -> list[int] | None:
        """Units of the components for a unit of time, at least ``start``; None if rates are above one for any."""
        units = list(start)
        for _ in range(4 * len(self.groups) + 4):
            before = list(units)
            for group in self.groups:
                rate = max(self._rate(i, units) for i in group)
                if rate - k > units[group[0]] and rate > _NOTHING // 2:
                    for i in group:
                        units[i] = rate - k
            if units == before:
                return units
        return None

    def _degree(self, units: list[int]) -> int:
        """Degree in time of a motion that is a polynomial; components with a unit near ``_NOTHING`` stay zero."""
        degrees = [0] * len(units)
        for _ in units:
            moving = [
                [sum(degrees[j] for j in m) for _, m in terms if all(units[j] > _NOTHING // 2 for j in m)]
                for terms in self._terms
            ]
            degrees = [1 + max(each) if each else 0 for each in moving]
        return max(degrees)

    def _time(self, start: list[int]) -> int:
        """Smallest k that has units. If any k does: that of ``_LONG``, or the largest rate at the start."""
        if (free := self._units(start, FREE)) is None:
            return FREE + bisect_left(range(FREE, -FREE), True, key=lambda k: self._units(start, k) is not None)
        rates = (self._rate(i, start) - start[i] for i in range(len(start)) if start[i] > _NOTHING)
        k = max((rate for rate in rates if rate > _NOTHING // 2), default=0)
        long = range(_LONG if self._degree(free) <= self.order else k, k, 16)
        return next((j for j in long if max(self._units(start, j) or [_ROOM + 1]) <= _ROOM), k)


def _exponent(x: float | Fraction) -> int:
    """Exponent of a power of two that the magnitude is below, or at for a fraction; ``_NOTHING`` for 0."""
    if not x:
        return _NOTHING
    if isinstance(x, float):
        return math.frexp(x)[1]
    exponent = x.numerator.bit_length() - x.denominator.bit_length()
    return exponent + (abs(x) > Fraction(2) ** exponent)
