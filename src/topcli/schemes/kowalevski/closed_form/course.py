"""Angles of the separated Kowalevski top at any time: linear phases, reduced exactly, and one scalar equation.

With the integrals A0, B0 of ds/|w| and p, q of |s - sigma| ds/|w|, all growing, the equations of motion are

    p + q = t + const,    A0(p) - B0(q) = const.

Whole periods of both are removed in integers; p is the zero of a monotone function.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.elliptic import add, jacobi, multiple
from topcli.contracts import Array
from topcli.schemes.kowalevski.closed_form.table import SLOW, OvalTable, Place, Real

Positions = tuple[Array, ...]
Equation = Callable[[Array, NDArray[np.intp]], tuple[Array, Array, Array]]
"""Value, slope and size of the terms of an equation for arguments (m,) at the given indices."""
ITERATIONS = 400
EPS = float(np.finfo(float).eps)
ZERO, QUARTER = Fraction(0), Fraction(1, 4)
AT_PASSAGE = 1.0 - 2.0**-51
"""Largest part of the time between two passages that is used."""
BITS = 128
TURN = 1 << BITS
LOW = (1 << 64) - 1
HALF = np.uint64(32)
MASK = np.uint64((1 << 32) - 1)


def fraction(x: Real) -> Fraction:
    """Real number of mpmath as an exact fraction, for use without mpmath."""
    sign, mantissa, exponent, _ = x.real._mpf_
    value = Fraction(int(mantissa)) * Fraction(2) ** int(exponent)
    return -value if sign else value


@dataclass(frozen=True)
class Phase:
    """Phase ``start`` + n ``step`` modulo one turn, both in units of 2^-128 turns; ``step`` may be several turns."""

    start: int
    step: int

    @classmethod
    def of(cls, start: Fraction, step: Fraction) -> Phase:
        """Phase from numbers of turns."""
        return cls(math.floor(start * TURN) % TURN, math.floor(step * TURN))

    def turns(self, n: Array | NDArray[np.int64], fine: bool = False) -> Array:
        """Phases after ``n`` (m,) steps of either sign, in [-1/2, 1/2) turns; the error is less than 2^-64 + ulp.

        With ``fine``, and between two steps, small phases have 128 bits, less those of ``n``.
        """
        if n.dtype.kind == "f" and (n != np.floor(n)).any():
            return np.array([self._between(*x.as_integer_ratio()) for x in n.tolist()])
        count = n.astype(np.int64).view(np.uint64)
        low = np.uint64(self.step & LOW)
        high = np.uint64(self.step >> 64 & LOW) * count + _upper_half(low, count)
        high -= np.where(n < 0, low, np.uint64(0))  # n was taken modulo 2^64
        lower = low * count + np.uint64(self.start & LOW)
        carry = lower < np.uint64(self.start & LOW)
        total = high + np.uint64(self.start >> 64) + carry
        upper = total.view(np.int64) * 2.0**-64
        return upper + lower * 2.0**-128 if fine else upper

    def _between(self, top: int, bottom: int) -> float:
        """Phase after ``top``/``bottom`` steps, rounded once."""
        return ((self.start + self.step * top // bottom + TURN // 2) % TURN - TURN // 2) / TURN


def _upper_half(a: np.uint64, b: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Upper 64 bits of the products of 64-bit integers."""
    a1, a0, b1, b0 = a >> HALF, a & MASK, b >> HALF, b & MASK
    low, middle = a0 * b0, a1 * b0
    cross = a0 * b1 + (low >> HALF) + (middle & MASK)
    return a1 * b1 + (middle >> HALF) + (cross >> HALF)


@dataclass(frozen=True)
class JacobiPhase:
    """Phase ``start`` + ``rate`` t of Jacobi's functions with the complementary parameter ``m1``.

    ``quarter`` is the quarter period of sn, None if ``m1`` is zero.
    """

    start: Fraction
    rate: Fraction
    quarter: Fraction | None
    m1: float

    @classmethod
    def of(cls, start: Real, rate: Real, quarter: Real, m1: Real) -> JacobiPhase:
        """Phase from numbers of mpmath."""
        whole = None if quarter is None else fraction(quarter)
        return cls(fraction(start), fraction(rate), whole, float(m1))

    def functions(self, n: NDArray[np.int64], h: float) -> tuple[Array, Array, Array]:
        """Jacobi's sn, cn, dn, each of shape (m,), after ``n`` (m,) steps of ``h``."""
        step = self.rate * Fraction(h)
        if self.quarter is None:
            u = add(multiple(_pair(step), n.astype(np.float64)), _pair(self.start))
            return jacobi(u, None, 0.0)
        turn = 4 * self.quarter
        turns = Phase.of(self.start / turn, step / turn).turns(n)
        quarter = _pair(self.quarter)
        far = np.abs(turns) > 0.25
        near = np.where(far, np.copysign(0.5, turns) - turns, turns)
        u = multiple(quarter, 4.0 * near)
        sn, cn, dn = jacobi(u, quarter, self.m1)
        return sn, np.where(far, -cn, cn), dn


def _pair(x: Fraction) -> tuple[float, float]:
    """Return ``x`` as a sum of two doubles."""
    high = float(x)
    return (high, float(x - Fraction(high))) if math.isfinite(high) else (high, 0.0)


def solved(equation: Equation, x: Array, low: Array, high: Array, scale: float) -> Array:
    """Zero (m,) of a growing function between ``low`` and ``high``, by Newton's method in a bracket, from ``x``."""
    x, low, high = x.copy(), low.copy(), high.copy()
    left = np.arange(len(x))
    width = high - low
    for iteration in range(ITERATIONS):
        here = x[left]
        value, slope, size = equation(here, left)
        lo, hi = np.where(value > 0.0, low[left], here), np.where(value > 0.0, here, high[left])
        step = value / slope
        new = here - step
        scaled = np.abs(here) + scale
        done = (np.abs(step) <= 2.0 * EPS * scaled) | (np.abs(value) <= EPS * size) | (hi - lo <= EPS * scaled)
        bisect = ~((new >= lo) & (new <= hi))
        if iteration % 3 == 2:  # Newton's steps may be short on one side of a logarithm
            bisect |= hi - lo > 0.5 * width[left]
            width[left] = hi - lo
        new = np.where(bisect, np.where(done, here, 0.5 * (lo + hi)), new)
        x[left], low[left], high[left] = new, lo, hi
        left = left[~done]
        if not len(left):
            break
    return x


@dataclass(frozen=True)
class Pair:
    """The ovals of s1 and s2; s2 moves on the unbounded one."""

    first: OvalTable
    second: OvalTable

    def refined(self, one: Place, two: Place, u1: Array, u2: Array, times: tuple[Array, Array], near: float) -> Any:
        """Signed places, of which the one next to sigma is determined by the integral of ds/|w| of the other.

        ``u1`` and ``u2`` are their ``OvalTable.gap``.
        """
        u2 = u2 / np.maximum(two.C * two.C, 1e-300)  # |s2 - sigma|, infinite where s2 is
        by_second = (u1 <= u2) & (u1 < near)
        by_first = (u2 < u1) & (u2 < near)
        if by_second.any() and not self.first.at_root:
            one = _replaced(one, by_second, self.first.at_time(times[0][by_second]))
        if by_first.any() and not self.second.at_root:
            two = _replaced(two, by_first, self.second.at_time(times[1][by_first]))
        return one.signed(), two.signed()


@dataclass(frozen=True)
class Lattice(Pair):
    """Course of angles that turn independently; ``periods`` are (P, a) of (p, A0) and (Q, b) of (q, B0).

    An angle that tends to a double root does not turn; its P and a are one and the slope of A0 there. ``rates`` are the
    turns of the two angles per unit of time, ``starts`` the turns at the time zero.
    """

    periods: tuple[Real, Real, Real, Real]
    rates: tuple[Fraction, Fraction] = (ZERO, ZERO)
    starts: tuple[Fraction, Fraction] = (ZERO, ZERO)

    def started(self, total: Real, difference: Real, time: Real) -> Lattice:
        """The course with p + q = ``total`` and A0 - B0 = ``difference`` at ``time``, without numbers of mpmath."""
        P, a, Q, b = self.periods
        determinant = 4 * (P * b + Q * a)
        rates = b / determinant, a / determinant
        one = (total * b + Q * difference) / determinant - rates[0] * time
        two = (total * a - P * difference) / determinant - rates[1] * time
        starts = [
            fraction(start) - (QUARTER if table.from_high and not table.endless else 0)
            for table, start in zip((self.first, self.second), (one, two), strict=True)
        ]
        return Lattice(
            self.first,
            self.second,
            (float(P), float(a), float(Q), float(b)),
            (fraction(rates[0]), fraction(rates[1])),
            (starts[0], starts[1]),
        )

    def positions(self, n: NDArray[np.int64], h: Fraction) -> Positions:
        """Phases in turns after ``n`` (m,) steps of ``h``; reduced if the angle turns."""
        found = []
        for table, start, rate in zip((self.first, self.second), self.starts, self.rates, strict=True):
            step = rate * h
            turns = any(table.touched)
            reduced = Phase.of(start, step)
            found.append(float(start) + float(step) * n if turns else reduced.turns(n, table.from_high))
        return tuple(found)

    def places(self, at: Positions, near: float) -> tuple[Place, Place]:
        """Places on the two ovals, signed."""
        P, _, Q, b = self.periods
        p, q = 4.0 * P * at[0], 4.0 * Q * at[1]
        first, second = self.first, self.second
        slope = first.slope + second.slope

        def equation(x: Array, index: NDArray[np.intp]) -> tuple[Array, Array, Array]:
            _, excess, gap = first.at(p[index] + x)
            two, other, other_gap = second.at(q[index] - x)
            size = np.abs(excess) + np.abs(other) + first.slope * np.abs(x)
            return slope * x + excess - other, 1.0 / gap + two.C * two.C / other_gap, size

        bound = np.full_like(p, 1.01 * (first.largest_excess + second.largest_excess) / slope)
        x = solved(equation, np.zeros_like(p), -bound, bound, 0.1 * min(P, max(Q, 10.0), SLOW))
        one, A, u1 = first.at(p + x)
        two, B, u2 = second.at(q - x)
        # A0 and B0 up to the same multiples of the periods as p and q
        B_zero, A_zero = 4.0 * b * at[1], first.slope * p
        times = B - second.slope * x + A_zero, A + first.slope * x + B_zero
        return self.refined(one, two, u1, u2, times, near)


@dataclass(frozen=True)
class Pinch(Pair):
    """Course on ovals that meet in a double root, which s1 and s2 pass together every 2 (P + Q).

    At each passage A0 - B0 changes by -2 ``jump``; ``stands`` is 1 or 2 if s1 or s2 rests in the double root.
    """

    periods: tuple[Real, Real]
    jump: Real
    stands: int
    period: Fraction = ZERO
    total: Fraction = ZERO
    difference: float = 0.0

    def started(self, total: Real, difference: Real, time: Real) -> Pinch:
        """The course with p + q = ``total`` and A0 - B0 = ``difference`` at ``time``, without numbers of mpmath."""
        P, Q = self.periods
        period = fraction(4 * (P + Q))
        start = fraction(total - time), float(difference)
        return Pinch(self.first, self.second, (float(P), float(Q)), float(self.jump), self.stands, period, *start)

    def positions(self, n: NDArray[np.int64], h: Fraction) -> Positions:
        """p + q reduced to [-(P + Q), P + Q], A0 - B0, and the number of passages."""
        period = self.period
        start, step = self.total / period, h / period
        turns = Phase.of(start, step).turns(n)  # of two passages each
        half = np.floor(2.0 * turns + 0.5)
        whole = np.rint(float(start) + float(step) * n.astype(np.float64) - turns)
        passages = 2.0 * whole + half
        reduced = float(period) * (turns - 0.5 * half)
        return reduced, self.difference - 2.0 * self.jump * passages, passages

    def places(self, at: Positions, near: float) -> tuple[Place, Place]:
        """Places on the two ovals, signed."""
        total, difference, passages = at
        P, Q = self.periods

        def equation(x: Array, index: NDArray[np.intp]) -> tuple[Array, Array, Array]:
            _, A, gap = self.first.at(x)
            two, B, other_gap = self.second.at(total[index] - x)
            slope = 1.0 / gap + two.C * two.C / other_gap
            c = difference[index]
            return A - B - c, slope, np.abs(A) + np.abs(B) + np.abs(c)

        if self.stands:
            one, two = self._in_turn(total)
        else:
            # at the passage itself the ratio of the two distances is lost
            total = np.clip(total, -(P + Q) * AT_PASSAGE, (P + Q) * AT_PASSAGE)
            low, high = np.maximum(-P, total - Q), np.minimum(P, total + Q)
            p = solved(equation, 0.5 * (low + high), low, high, 0.1 * P)
            one, A, u1 = self.first.at(p)
            two, B, u2 = self.second.at(total - p)
            times = B + difference, A - difference
            one, two = self.refined(one, two, u1, u2, times, near)
        sign = 1.0 - 2.0 * np.mod(passages, 2.0)
        return one._replace(S=one.S * sign, C=one.C * sign), two._replace(S=two.S * sign, C=two.C * sign)

    def _in_turn(self, total: Array) -> tuple[Place, Place]:
        """Signed places if one variable rests in the double root while the other moves: first s2, then s1."""
        P, Q = self.periods
        second_moves = total <= Q - P
        one = self.first.at(np.where(second_moves, -P, total - Q))[0].signed()
        two = self.second.at(np.where(second_moves, total + P, Q))[0].signed()
        return (
            one._replace(S=np.where(second_moves, 0.0, one.S)),
            two._replace(S=np.where(second_moves, two.S, 0.0)),
        )


def _replaced(place: Place, where: NDArray[np.bool_], by: Place) -> Place:
    """Copy of ``place`` with the points ``by`` at the positions ``where``."""
    copies = []
    for old, new in zip(place, by, strict=True):
        if old is None or new is None:
            copies.append(None)
            continue
        copy = old.copy()
        copy[where] = new
        copies.append(copy)
    return Place(*copies)


Course = Lattice | Pinch
