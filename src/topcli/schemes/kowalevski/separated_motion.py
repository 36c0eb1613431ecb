"""Motion of the Kowalevski top at any time, from its separated variables, without time stepping.

Each of s1, s2 moves on an oval of the curve (``inversion``). No branch is followed: the signs of all square roots are
those of the sine and cosine of the angles, and constants, which the initial state and a short step decide.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, Floats
from topcli.errors import RunError
from topcli.schemes.kowalevski.inversion import EPS, Course, Lattice, Pinch, Positions
from topcli.schemes.kowalevski.oval import Oval
from topcli.schemes.kowalevski.oval_table import OvalTable, Place
from topcli.schemes.kowalevski.separation import (
    DIGITS,
    Curve,
    curve,
    integrals,
    real,
    separated,
    series_step,
)
from topcli.schemes.kowalevski.state_of_factors import Formula

SHIFTS = (0, 2, 3, 5)
"""Times, in units of 1/32, from which the constants are tried; at the first one s1 may be undetermined."""
FIT = 1e-7
"""Largest difference, relative to the state, between the initial state and that of the right signs."""
NEAR = 0.05
"""Part of the roots; if |s - sigma| is smaller than it, the angle is found from the integral of ds/|w|."""
CHUNK = 4096
"""States evaluated together, so that the arrays stay in the cache."""
PROBES = (-12, 0, 105, 1311, 16543, 195_201, 2_336_007, 28_480_001)
"""Multiples of ``PROBE_STEP`` at which a motion is compared with Taylor series before it is used."""
PROBE_STEP = 2.0**-5
AGREEMENT = 1e-10
"""Largest difference relative to the terms of the equations."""
NO_TAU = 1e-100
BOTH = (1, -1)
AT_END = 1e-45, 1e-26
"""Angles from 0 and pi/2 within which 60 digits do not show the direction."""
MOMENT = 2.0**-46
"""Time after the start at which the directions of s1 and s2 show."""
SIDEWAYS = 0.01
"""Part of gamma² across the angular momentum from which on gamma² determines its length."""
REFUSED = "kowalevski, scheme exact: {}; use scheme 'taylor'"


class _UnfitError(ArithmeticError):
    """No choice of the signs gives the initial state."""


class SeparatedMotion:
    """Motion from the state ``y`` (6,); omega and c gamma should be of the order of one.

    Raises RunError for motions that are not covered.
    """

    course: Course

    def __init__(self, y: Floats, c: float) -> None:
        from topcli.schemes.kowalevski.multiprecision import digits

        self.y, self.c = y, c
        of = integrals(y, c)
        with digits(2 * DIGITS):
            roots = curve(of)
        self.gamma_sq, self.two_l = float(of.G / Fraction(c) ** 2), float(2 * of.L / Fraction(c))
        self.near = NEAR * float(max(abs(v) for v in roots.e))
        failed = ""
        for shift in SHIFTS:
            try:
                self._start(roots, shift)
            except ZeroDivisionError:
                failed = "the separated variables are undetermined"
            except _UnfitError as error:
                failed = str(error)
            else:
                self._verify()
                return
        raise RunError(REFUSED.format(failed))

    def _start(self, roots: Curve, shift: int) -> None:
        """Set up ovals, tables, phases and signs from the state ``shift``/32 after the start."""
        from topcli.schemes.kowalevski.multiprecision import digits, mpf

        elapsed = Fraction(shift, 32)
        with digits(2 * DIGITS):
            time = mpf(shift) / 32
            start = [mpf(v) for v in self.y]
            if shift:
                start = series_step(start, mpf(self.c), time, 90)
            now = separated(roots.of, start)
            later = separated(roots.of, series_step(start, mpf(self.c), mpf(MOMENT), 8))
        with digits(DIGITS):
            ovals = _ovals(roots)
            angles, moved = ([oval.angle(s) for oval, s in zip(ovals, both, strict=True)] for both in (now, later))
            ways = [_direction(before, after) for before, after in zip(angles, moved, strict=True)]
            begun = [oval.from_regular_end(angle) for oval, angle in zip(ovals, angles, strict=True)]
            course, begun = _course(ovals, begun)
            self.course = course
            self.apart = float(ovals[0].a - ovals[1].a)
            self.formula = _formula(roots, self.c)
            self._choose(course, begun, (angles, ways), np.array([float(v) for v in start]), elapsed)

    def _choose(self, course: Lattice | Pinch, begun: Any, placed: Any, start: Array, time: Fraction) -> None:
        """Choose directions and signs so that the state and its change over a short time are the right ones.

        ``placed`` are the angles and the possible directions of each.
        """
        ((A, p), (B, q)), (angles, ways) = begun, placed
        size = 1.0 + float(np.abs(start).max())
        later = np.array(series_step(list(start), self.c, PROBE_STEP, 20))
        best, found = np.inf, None
        stands = course.stands if isinstance(course, Pinch) else 0
        for one, two in product(*ways):
            # a variable that rests in the double root is there at the end of its half period
            ends = one if stands != 1 else -1, two if stands != 2 else 1
            difference = -2 * (A + B) if stands else one * A - two * B
            begin = course.started(ends[0] * p + ends[1] * q, difference, real(time))
            for signs in product((1, -1), repeat=3):
                self._set_signs(signs)
                with np.errstate(all="ignore"):
                    missed = float(np.abs(self._at_angles(angles, (one, two)) - start).max())
                    if not missed < FIT * size:
                        continue
                    ahead = self._evaluate(begin, begin.positions(np.array([0, 1]), Fraction(PROBE_STEP) + time))[1]
                missed = max(missed, float(np.abs(ahead - later).max()))
                if missed < best:
                    best, found = missed, (begin, signs)
        if (found is None or not best < FIT * size) and ways != [BOTH, BOTH]:
            return self._choose(course, begun, (angles, [BOTH, BOTH]), start, time)
        if found is None or not best < FIT * size:
            raise _UnfitError("no choice of the signs of the square roots gives the initial state")
        self.course = found[0].lasting()
        self._set_signs(found[1])

    @property
    def first(self) -> OvalTable:
        """Oval of s1."""
        return self.course.first

    @property
    def second(self) -> OvalTable:
        """Oval of s2."""
        return self.course.second

    def _set_signs(self, signs: tuple[int, ...]) -> None:
        """Set the signs of f1, f2, f3; those of A and B follow, because both angles grow."""
        self.signs = signs
        one, two = 1j * signs[0] * signs[1] * signs[2], -1j
        for f in self.first.factors(_middle(self.first)):
            one = one * complex(f[0])
        for g in self.second.factors(_middle(self.second)):
            two = two * complex(g[0])
        self.formula = replace(self.formula, sign_a=1 if one.real > 0.0 else -1, sign_b=1 if two.real > 0.0 else -1)

    def _at_angles(self, angles: Any, directions: tuple[int, int]) -> Array:
        """State (6,) at the given angles in [0, pi/2], each on its way up (1) or down (-1)."""
        from topcli.schemes.kowalevski.multiprecision import cos, sin

        places = []
        for table, angle, direction in zip((self.first, self.second), angles, directions, strict=True):
            S, C = np.array([direction * float(sin(angle))]), np.array([float(cos(angle))])
            if table.touched[0]:
                S, C = direction * S, direction * C
            past = S * S - np.sin(table.anchors[1]) ** 2 if len(table.anchors) == 3 else None
            places.append(Place(np.zeros(1, dtype=np.int64), S, C, past))
        return self._states(*places)[0]

    def _states(self, one: Place, two: Place) -> Array:
        """States (m, 6) at signed places."""
        f, g = self.first.factors(one), self.second.factors(two)
        f = [value if sign > 0 else -value for value, sign in zip(f, (*self.signs, 1, 1), strict=True)]
        tau = np.where(two.C == 0.0, NO_TAU, two.C)  # some factors are in tau, others in 1/tau
        D = (self.apart + self.first.length * one.S * one.S) * tau * tau + self.second.length * two.S * two.S
        return self._on_vertical(self.formula.states(f, g, tau, D))

    def _on_vertical(self, found: Array) -> Array:
        """The states (m, 6) with gamma changed within its round-off, so that gamma² and m·gamma are exact.

        Gamma, a difference of terms of the size of |omega|²/c, is less accurate than omega.
        """
        moment, gamma = found[:, :3] * np.array([2.0, 2.0, 1.0]), found[:, 3:]
        square = (moment * moment).sum(axis=1)
        allowed = 32.0 * EPS * (np.sqrt(self.gamma_sq) + square / abs(self.c))
        missing = self.two_l - (gamma * moment).sum(axis=1)
        # next to rest the round-off of omega would decide
        missing = np.where(np.abs(missing) <= allowed * np.sqrt(square), missing, 0.0) / np.where(square, square, 1.0)
        gamma += moment * missing[:, None]
        across = gamma - moment * ((gamma * moment).sum(axis=1) / np.where(square, square, 1.0))[:, None]
        rest = (across * across).sum(axis=1)
        change = 0.5 * (self.gamma_sq - (gamma * gamma).sum(axis=1))
        usable = (rest > SIDEWAYS * self.gamma_sq) & (np.abs(change) <= allowed * np.sqrt(self.gamma_sq))
        gamma += across * (np.where(usable, change, 0.0) / np.where(usable, rest, 1.0))[:, None]
        return found

    def _evaluate(self, course: Course, at: Positions) -> Array:
        """States (m, 6) at the given positions of a course."""
        return self._states(*course.places(at, self.near))

    def states(self, n: NDArray[np.int64], h: float) -> Array:
        """States (m, 6) after ``n`` (m,) steps of ``h``."""
        positions = self.course.positions(n, Fraction(h))
        found = np.empty((len(n), 6))
        with np.errstate(all="ignore"):
            for begin in range(0, len(n), CHUNK):
                part = slice(begin, begin + CHUNK)
                found[part] = self._evaluate(self.course, tuple(one[part] for one in positions))
        return found

    def _verify(self) -> None:
        """Compare states over long times with Taylor series of the equations; raise RunError if they differ."""
        n = np.array(PROBES)
        both = self.states(np.concatenate([n, n + 1, [0]]), PROBE_STEP)
        here, there = both[: len(n)], both[len(n) : -1]
        with np.errstate(all="ignore"):
            expected = np.array(series_step(list(here.T), self.c, PROBE_STEP, 24)).T
            size = 1.0 + (np.abs(here).max() ** 2) / min(1.0, abs(self.c))
            missed = max(float(np.abs(expected - there).max()), float(np.abs(both[-1] - self.y).max())) / size
        if not missed < AGREEMENT:
            why = f"too close to a degenerate motion: a Taylor step differs by {missed:.0e} of the terms"
            raise RunError(REFUSED.format(why))


def _direction(before: Any, after: Any) -> tuple[int, ...]:
    """Directions in which an angle in [0, pi/2] may move that is ``after`` soon; both at an end, where they agree.

    Next to a turning point both fit the state, and the wrong one is a shift of time.
    """
    from topcli.schemes.kowalevski.multiprecision import pi

    clear = min(before, pi / 2 - before, abs(after - before)) > AT_END[before > 1]
    return BOTH if not clear else (1,) if after > before else (-1,)


def _middle(table: OvalTable) -> Place:
    """The point with theta = pi/4."""
    half = np.full(1, np.sqrt(0.5))
    past = 0.5 - np.sin(table.anchors[1:2]) ** 2 if len(table.anchors) == 3 else None
    return Place(np.zeros(1, dtype=np.int64), half, half, past)


def _ovals(of: Curve) -> tuple[Oval, Oval]:
    """The ovals of s1 and s2; sigma is in the middle of the gap between them."""
    top, low, high = of.occupied()
    sigma = (of.e[top].real + of.e[low].real) / 2
    return Oval(of, low, high, sigma), Oval(of, top, None, sigma)


def _course(ovals: tuple[Oval, Oval], begun: list[Any]) -> tuple[Lattice | Pinch, list[Any]]:
    """Course on the ovals, without its start, and the integrals of the start, also for points in a double root."""
    from topcli.schemes.kowalevski.multiprecision import log, mpf, sin, sqrt, tan

    first, second = ovals
    if first.touched[0] and second.touched[0] and first.a == second.a:
        stands = next((i + 1 for i in (0, 1) if begun[i] is None), 0)
        periods = [oval.half_periods for oval in ovals]
        begun = [periods[i] if begun[i] is None else begun[i] for i in (0, 1)]
        around = 1
        for root in first.curve.e:
            around *= abs(root - first.a) if root != first.a else 1
        cut = first.length * sin(first.panels[0].begin) ** 2, second.length * tan(second.panels[0].begin) ** 2
        jump = periods[0][0] - periods[1][0] + log(cut[0] / cut[1]) / (2 * sqrt(around))
        if stands:
            jump = mpf(0)
            begun = [periods[i] if i + 1 == stands else begun[i] for i in (0, 1)]
        one, two = (OvalTable(oval, mpf(0), False) for oval in ovals)
        return Pinch(one, two, (periods[0][1], periods[1][1]), jump, stands), begun
    tables, periods, starts = [], [], []
    for oval, at in zip(ovals, begun, strict=True):
        if all(oval.touched):
            raise RunError(REFUSED.format("an oval of the curve has a double root at both ends"))
        a, P = oval.half_periods
        if any(oval.touched):
            root = oval.a if oval.touched[0] else oval.b
            P, a = mpf(1), 1 / abs(root - oval.sigma)
        tables.append(OvalTable(oval, a / P, at is None))
        periods += [P, a]
        starts.append((mpf(0), mpf(0)) if at is None else at)
    P, a, Q, b = periods
    return Lattice(tables[0], tables[1], (P, a, Q, b)), starts


def _formula(of: Curve, c: float) -> Formula:
    e = of.e
    one, two, three = (complex(e[j] - e[i]) for i, j in ((0, 1), (1, 2), (2, 0)))
    a, b, d = (complex(e[i] - of.r2) for i in range(3))
    return Formula((one, two, three), (a, b, d), complex(of.x0), complex(of.r1), c)
