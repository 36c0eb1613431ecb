"""Units of time and of the components in which the rates of change of a field are about one.

All units are powers of two, so that a change of units rounds nothing. Without it, coefficients of a Taylor series of
order 37 overflow at an angular velocity of 1e8.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction

from topcli.field.polynomial import Field, Polynomial, strongly_connected

NOTHING = -(2**20)
"""Exponent that stands for zero."""
FREE = -(2**13)
"""A unit of time of 2^-FREE is longer than any: a field for which it will do has none of its own."""


def natural_units(field: Field, y: Sequence[float]) -> tuple[Field, int, list[int]]:
    """The field with time in units of 2^-k and component i in units of 2^units[i], exactly; ``k``; and ``units``.

    ``y`` is a state. Its components, and their rates of change while they are of this size, are at most about one in
    these units. Components that occur in each other's products have the same unit. The unit of time is the longest that
    there is. Terms with a component that is zero for ever are left out.
    """
    terms = [[(_exponent(c), monomial) for monomial, c in rate.terms.items()] for rate in field]
    nonlinear = [{j for _, monomial in rate if len(monomial) > 1 for j in monomial} for rate in terms]
    groups = strongly_connected(nonlinear, range(len(y)))
    sizes = [_exponent(x) for x in y]
    start = [max(sizes[j] for j in group) for i in range(len(y)) for group in groups if i in group]

    def units(k: int) -> list[int] | None:
        """Units of the components for a unit of time; None if rates are above one for any."""
        found = list(start)
        for _ in range(4 * len(groups) + 4):
            grown = False
            for group in groups:
                rate = max((c + sum(found[j] for j in m) for i in group for c, m in terms[i]), default=NOTHING)
                if rate - k > found[group[0]] and rate > NOTHING // 2:
                    grown = True
                    for i in group:
                        found[i] = rate - k
            if not grown:
                return found
        return None

    rates = (
        c + sum(start[j] for j in m) - start[i] for i, rate in enumerate(terms) for c, m in rate if start[i] > NOTHING
    )
    first = max((rate for rate in rates if rate > NOTHING // 2), default=0)
    if units(FREE) is not None:
        k = first  # nothing repeats: there is no unit of time
    else:
        below, k, leap = FREE, first, 1
        while units(k) is None:
            below, k, leap = k, k + leap, 2 * leap
        leap = 1
        while k - leap > below and units(k - leap) is not None:
            k, leap = k - leap, 2 * leap
        below = max(below, k - leap)
        while k - below > 1:
            middle = (k + below) // 2
            below, k = (middle, k) if units(middle) is None else (below, middle)
    found = units(k) or start
    moving = {i for i, unit in enumerate(found) if unit > NOTHING // 2}

    def scaled(i: int, rate: Polynomial) -> Polynomial:
        kept = {m: c for m, c in rate.terms.items() if moving.issuperset(m)}
        return Polynomial({m: c * Fraction(2) ** (sum(found[j] for j in m) - found[i] - k) for m, c in kept.items()})

    return tuple(scaled(i, rate) for i, rate in enumerate(field)), k, [found[i] * (i in moving) for i in range(len(y))]


def _exponent(x: float | Fraction) -> int:
    """Exponent of a power of two that the magnitude is below, or at for a fraction; ``NOTHING`` for 0."""
    if not x:
        return NOTHING
    if isinstance(x, float):
        return math.frexp(x)[1]
    exponent = x.numerator.bit_length() - x.denominator.bit_length()
    return exponent + (abs(x) > Fraction(2) ** exponent)
