"""Growth of the iterates of a rational map: degrees along a line, and digits of rational orbits.

The degrees of the iterates grow polynomially under an integrable map, exponentially under most others; the rate of the
exponential growth is the map's algebraic entropy (Bellon, Viallet, Comm. Math. Phys. 204 (1999) 425). The length of
the numbers of a rational orbit grows like the degrees (Halburd, J. Phys. A 38 (2005) L263).

The degree of an iterate is that of a random quotient of two affine functions of the state, along a random line of
initial states, modulo a prime. It is exact unless the random numbers are in special position.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from topcli.arithmetic.elimination import linear_solution
from topcli.engine.numbers import ROOM, longest
from topcli.engine.residues import PRIME, Jet, RationalMap, Residues, folded

FEW_POINTS, MOST_POINTS = 64, 17_000
"""Points on the line, of which a rational function of degree D needs 2 D + 2."""
MOST_TERMS = 20
SURPLUS = 2
"""Terms of a sequence beyond those that fix its recurrence, at least; twice as many while they are cheap."""
_SHORT = 500
"""Degree up to which an iterate is cheap."""
SALEM = 1.1
"""Roots of an integer polynomial of low degree that lie within this radius are roots of unity or zero."""
POLYNOMIAL, EXPONENTIAL = "polynomial", "exponential"


def degree_of(numerator: Residues, denominator: Residues, t: Residues) -> int | None:
    """Degree of the rational function that has the values numerator/denominator at the points t, modulo the prime.

    Its continued fraction (Thiele 1909) is developed without divisions until it ends; None if it does not end.
    """
    u, v = numerator, denominator
    for level in range(len(t)):
        if v[0] % PRIME == 0:
            zero = v % PRIME == 0
            if zero.all():
                return level // 2
            order = np.argsort(zero, kind="stable")
            u, v, t = u[order], v[order], t[order]
        a = int(u[0]) * pow(int(v[0]), -1, PRIME) % PRIME
        u, v, t = (t[1:] - t[0]) * v[1:], folded(u[1:] + (PRIME - a) * v[1:]), t[1:]
    return None


class Line:
    """Random line of initial states, and a random quotient of affine functions of the state; repeated by ``seed``."""

    def __init__(self, step: RationalMap, seed: int) -> None:
        random = np.random.default_rng(seed)
        self.step = step
        self.base, self.direction = random.integers(1, PRIME, (2, step.d, 1))
        self.over, self.under = random.integers(1, PRIME, (2, step.d + 1)).tolist()

    def states(self, t: Residues, steps: int) -> Any:
        """State of the scheme after some steps from the points t of the line."""
        y = (self.base + self.direction * t) % PRIME
        state = self.step.enter([Jet(x[None, :]) for x in y])
        for _ in range(steps):
            state = self.step.step(state)
        return state

    def degree(self, state: Any, t: Residues) -> int | None:
        """Degree of the state as a function of t; None for too few points."""
        values: list[Residues] = []
        for first, *others in (self.over, self.under):
            total = Jet(np.full((1, len(t)), first))
            for x, c in zip(self.step.leave(state), others, strict=True):
                total = total + x * c
            values.append(total.a[0])
        return degree_of(values[0], values[1], t)


@dataclass(frozen=True)
class DegreeGrowth:
    """Growth of a sequence of degrees by its shortest linear recurrence.

    ``law`` is "polynomial", with its ``power``, or "exponential", with the ``factor`` per step; None if no recurrence
    is known. ``characteristic`` are the coefficients of the recurrence's polynomial, highest first, none if the law is
    only fitted. ``surplus`` terms confirm it.
    """

    law: str | None = None
    power: int | None = None
    factor: float | None = None
    characteristic: tuple[int, ...] = ()
    surplus: int = 0

    @property
    def entropy(self) -> float | None:
        """Algebraic entropy, the logarithm of the factor; None if the law is unknown."""
        return math.log(self.factor or 1.0) if self.law else None


def degree_growth(degrees: Sequence[int], surplus: int = SURPLUS) -> DegreeGrowth:
    """Return the law of the shortest recurrence with whole coefficients that at least ``surplus`` terms confirm."""
    for omitted in range(3):
        e = [1, *degrees][omitted:]
        for order in range(1, (len(e) - surplus) // 2 + 1):
            c = linear_solution([e[i : i + order + 1] for i in range(order)])
            if c is None or any(x.denominator > 1 for x in c):
                continue
            if all(sum(x * y for x, y in zip(c, e[i:], strict=False)) == e[i + order] for i in range(len(e) - order)):
                characteristic = (1, *(-int(x) for x in reversed(c)))
                return _law(characteristic, len(e) - 2 * order)
    return DegreeGrowth()


def _law(characteristic: tuple[int, ...], surplus: int) -> DegreeGrowth:
    """Growth from the polynomial of a recurrence."""
    factor = float(np.abs(np.roots(characteristic)).max())
    if factor > SALEM:
        return DegreeGrowth(EXPONENTIAL, None, factor, characteristic, surplus)
    ones, left = 0, list(characteristic)
    while sum(left) == 0 and len(left) > 1:  # divide by x - 1
        left = [sum(left[: i + 1]) for i in range(len(left) - 1)]
        ones += 1
    return DegreeGrowth(POLYNOMIAL, max(ones - 1, 0), None, characteristic, surplus)


def degrees(step: RationalMap, seed: int = 1, most: int = MOST_TERMS) -> list[int]:
    """Degrees of the iterates of a map along a random line, until their growth is known or they become too large.

    Raises ZeroDivisionError in special position: try another seed.
    """
    line, degrees = Line(step, seed), list[int]()
    t = np.arange(1, FEW_POINTS + 1)
    state = line.states(t, 0)
    while len(degrees) < most:
        state = step.step(state)
        while (degree := line.degree(state, t)) is None:
            if len(t) >= MOST_POINTS:
                return degrees
            t = np.arange(1, min(2 * len(t), MOST_POINTS) + 1)
            state = line.states(t, len(degrees) + 1)
        degrees.append(degree)
        if degree_growth(degrees, SURPLUS * (2 if degree < _SHORT else 1)).law:
            break
    return degrees


HEIGHT_BITS, HEIGHT_STEPS = 5_000, 40
"""Length of numbers at which a rational orbit ends, and its largest number of steps."""
LONGEST_HEIGHT = ROOM * HEIGHT_BITS


def heights(step: RationalMap) -> list[int]:
    """Binary digits of the longest number of the states of a rational orbit, the initial state first.

    ``step`` is in rational numbers of at most ``LONGEST_HEIGHT`` bits. The orbit ends before a step that fails.
    """
    state, bits = step.enter([step.number(Fraction(2 * i + 3, i + 5)) for i in range(step.d)]), list[int]()
    with suppress(ArithmeticError):
        while len(bits) <= HEIGHT_STEPS and not (bits and bits[-1] > HEIGHT_BITS):
            bits.append(longest(step.leave(state)))
            state = step.step(state)
    return bits


FACTOR, AGREEMENT = 2.0, 0.15
"""Smallest factor of an exponential law that is fitted, and relative difference of those of degrees and heights."""


def confirmed_growth(degrees: Sequence[int], bits: Sequence[int]) -> DegreeGrowth:
    """Law of the recurrence of ``degrees``, or an exponential law that the ``bits`` of an orbit confirm.

    That is the law of a recurrence that a single further term confirms, or that of a fit.
    """
    exact = degree_growth(degrees)
    if exact.law:
        return exact
    fit, height = (_fitted_factor(first, row) for first, row in ((1, degrees), (0, bits)))
    short = degree_growth(degrees, SURPLUS - 1)
    factor = short.factor if short.law else fit
    if factor and height and abs(factor / height - 1.0) < AGREEMENT:
        return short if short.law else DegreeGrowth(EXPONENTIAL, factor=factor)
    return exact


def _fitted_factor(first: int, sizes: Sequence[int]) -> float | None:
    """Factor of the exponential law that fits sizes at steps from ``first``; None for another law or a small factor."""
    law, factor = fitted_law(first, sizes)
    return factor if law == EXPONENTIAL and factor > FACTOR else None


FEWEST = 4
"""Fewest steps from which a law is fitted."""


def fitted_law(first: int, sizes: Sequence[int]) -> tuple[str | None, float]:
    """Law that fits sizes at steps from ``first`` best, in the later half of the steps, and its power or factor.

    None for too few steps.
    """
    bits, n = np.array(sizes), np.arange(first, first + len(sizes))
    if not len(n):
        return None, math.nan
    late = (n >= n[-1] // 2) & (n > 0) & (bits > 0)
    if late.sum() < FEWEST:
        late = (n > 0) & (bits > 0)
    if late.sum() < FEWEST:
        return None, math.nan
    steps, size = n[late].astype(float), np.log(bits[late].astype(float))
    power, factor = (np.polyfit(x, size, 1) for x in (np.log(steps), steps))
    off_power = float(np.abs(np.polyval(power, np.log(steps)) - size).max())
    off_factor = float(np.abs(np.polyval(factor, steps) - size).max())
    if off_power <= off_factor:
        return POLYNOMIAL, float(power[0])
    return EXPONENTIAL, float(np.exp(factor[0]))
