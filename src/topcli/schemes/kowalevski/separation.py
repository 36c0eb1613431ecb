"""Motion of the Kowalevski top by separated variables, at any time without time stepping.

With the integrals A0, B0 of ds/|w| over the ovals of s1 and s2 and p, q of |s - sigma| ds/|w|, all growing, the
equations of motion are p + q = t + const and A0(p) - B0(q) = const: two phases that grow linearly, and one scalar
equation. A state follows from the factors f_i = sqrt(s1 - e_i), g_i = sqrt(s2 - e_i) of the curve. With D = s1 - s2,
h_i = f_i - g_i, k_i = f_i + g_i, the indices 1, 2, 3 cyclic and r1, r2 as in ``curve.Curve``,

    La = 8 D² / prod (h_i - k_j)(h_i + k_j),    N_1 = 2 h_2 h_3/((h_2 - k_3)(h_3 + k_2)),    N = N_n + (e_n - r2) La,
    omega1 + i omega2 = x0 + r1 La/N,    m = N - 1,    A = ± f_4 f_5,    B = ± g_4 g_5,
    omega3 = 2 ((F B - F' A)(m² + 1) - 2 m (F A - F' B))/((m² - 1) D²),
    F = f1 f2 f3 + f1 g2 g3 + g1 f2 g3 + g1 g2 f3,    F' the same with f and g exchanged,
    c gamma3 = omega3 x1 + 2 r1 h1 h2 h3 La (A + B)/(D² N²),
    xi = ((f4 g5 ± f5 g4) h1 h2 h3 (N - 2)/(N D²))²,    c (gamma1 + i gamma2) = x1² - xi.

The form has no singular point at double roots. All g are multiplied by tau, so that s2 may pass through infinity
(tau = 0). No branch is followed: the signs of all square roots are those of the sine and cosine of the angles on the
ovals, and constants, which the initial state decides.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.elliptic import phase
from topcli.arithmetic.multiprecision import DIGITS, Real, digits, mp, real
from topcli.contracts import Array
from topcli.errors import RunError
from topcli.schemes.kowalevski.curve import REFUSED, Curve, Integers, Integrals, Oval, Place, separated

Phase = tuple[Integers, Array]
"""Quarter turns of an angle: whole numbers (m,), and rests (m,) in [-1/2, 1/2]."""
EPS = 2.0**-52
ROOT_DIGITS = 400
"""Digits of the roots and of s1 and s2, which may be close to each other."""
MOMENT = 2.0**-300
"""Time after the start at which the directions of s1 and s2 show."""
FIT = 1e-60
"""Largest difference between the initial state and that of the right signs, in multiprecision."""
_NEAR = 0.05
"""Part of the roots; if |s - sigma| is smaller than it, the angle is computed from the integral of ds/|w|."""
_PROBES = (-12, 0, 105, 1311, 16543, 195_201, 2_336_007, 28_480_001)
"""Multiples of ``PROBE_STEP`` at which a motion is compared with Taylor series before it is used."""
PROBE_STEP = 2.0**-5
_AGREEMENT = 1e-12
"""Largest difference relative to the terms of the equations."""
ITERATIONS = 400
CYCLIC = ((0, 1), (1, 2), (2, 0))
_TINY = 1e-300
NO_TAU = 1e-100
MEETING = 0.02
"""Largest s1 - s2, relative to the differences of roots, at which h_i and k_i are computed from each other."""
PASSAGE, AFTER = 2.0**-45, 2.0**-48
"""Distances of s1 and s2 from sigma, in units of ``_NEAR``, that are lost in rounding, and the time after which not."""
_CHUNK = 4096
"""States evaluated together, so that the arrays stay in the cache."""


class Separated:
    """Motion on a torus of the two angles of s1 and s2, whose phases turn at constant rates."""

    def __init__(self, curve: Curve, c: float) -> None:
        top, low, high = curve.occupied()
        e, self.c, self.curve = curve.e, c, curve
        self.sigma = (e[top].real + e[low].real) / 2
        self.one, self.two = Oval(curve, low, high, self.sigma), Oval(curve, top, None, self.sigma)
        self.near = _NEAR * float(max(abs(v) for v in e))
        self.apart = float(self.one.a - self.two.a)
        self.formula = Formula.of(curve, c).rounded()
        (a, P), (b, Q) = self.one.half, self.two.half
        self.determinant = P * b + Q * a
        self.rates = b / self.determinant, a / self.determinant
        self.starts: tuple[Real, Real]

    def set_start(self, angles: Sequence[Real], directions: Sequence[int]) -> None:
        """Let the two angles in [0, pi/2] be those of the start, in the ``directions`` +1 or -1."""
        (a, P), (b, Q) = self.one.half, self.two.half
        (A, p), (B, q) = (
            way * oval.up_to(angle) for way, oval, angle in zip(directions, (self.one, self.two), angles, strict=True)
        )
        self.starts = (
            ((p + q) * b + Q * (A - B)) / self.determinant,
            ((p + q) * a - P * (A - B)) / self.determinant,
        )

    def with_signs(self, formula: Formula, signs: tuple[int, ...]) -> Formula:
        """Copy of a formula with these signs of f1, f2, f3; those of A and B follow, because both angles grow."""
        zero, half = np.zeros(1, dtype=np.int64), np.full(1, 0.5)
        f, g = (oval.factors(oval.place(zero, half * oval.halves[1], 1)[0]) for oval in (self.one, self.two))
        A, B = (
            unit * math.prod(complex(v[0]) for v in values) for unit, values in ((1j * math.prod(signs), f), (-1j, g))
        )
        return formula._replace(signs=(*signs, 1, 1), A=1 if A.real > 0.0 else -1, B=1 if B.real > 0.0 else -1)

    def formula_of_state(
        self, y: Sequence[Real], s: Sequence[Real], angles: Sequence[Real], ways: Sequence[int]
    ) -> Formula:
        """Formula with the signs that give the state ``y`` at s1, s2 with these angles and directions.

        Next to a motion with equal roots, wrong signs may give almost the same state; doubles would not tell.
        """
        f, g = (o.factors_at(v, way) for o, v, way in zip((self.one, self.two), angles, ways, strict=True))
        tau, exact = mp.cos(angles[1]), Formula.of(self.curve, self.c)

        def missed(formula: Formula) -> Real:
            state = formula.states(f, g, tau, (s[0] - s[1]) * tau * tau)[0]
            return max(abs(v - w) for v, w in zip(state, y, strict=True))

        best = min((self.with_signs(exact, signs) for signs in product((1, -1), repeat=3)), key=missed)
        if not missed(best) < FIT:
            raise RunError(REFUSED.format("no choice of the signs of the square roots gives the initial state"))
        return best.rounded()

    def states(self, n: NDArray[Any], h: float) -> Array:
        """States (m, 6) after ``n`` (m,) steps of ``h``, which may be fractions."""
        states = np.empty((len(n), 6))
        with digits(DIGITS):
            first, second = (phase(x, rate * real(h), n) for x, rate in zip(self.starts, self.rates, strict=True))
        with np.errstate(all="ignore"):
            for begin in range(0, len(n), _CHUNK):
                part = slice(begin, begin + _CHUNK)
                here, there = ((whole[part], rest[part]) for whole, rest in (first, second))
                states[part] = self.at(*self.places(here, there))
        return states

    def places(self, first_phase: Phase, second_phase: Phase, nudge: bool = True) -> tuple[Place, Place]:
        """Places of s1 and s2; with ``nudge``, a common passage through a double root is left a little later."""
        bounded, unbounded, (k1, at1), (k2, at2) = self.one, self.two, first_phase, second_phase
        (a, P), (b, Q) = bounded.halves, unbounded.halves
        p, q, slope = P * at1, Q * at2, bounded.slope + unbounded.slope

        def equation(x: Array, i: NDArray[np.intp]) -> tuple[Array, Array, Array]:
            first, A = bounded.place(k1[i], p[i] + x, 1)
            second, B = unbounded.place(k2[i], q[i] - x, 1)
            rate = 1.0 / bounded.gap(first) + second.C * second.C / unbounded.gap(second)
            return slope * x + A - B, rate, np.abs(A) + np.abs(B) + bounded.slope * np.abs(x)

        x = _solved(equation, len(p), 2.02 * float(a + b) / slope, min(1.0, P, Q))
        first, A = bounded.place(k1, p + x, 1)
        second, B = unbounded.place(k2, q - x, 1)
        u1, u2 = bounded.gap(first), unbounded.gap(second) / np.maximum(second.C * second.C, _TINY)
        if nudge and (by := (u1 < PASSAGE * self.near) & (u2 < PASSAGE * self.near)).any():
            at1, at2 = (at + np.where(by, AFTER * float(v), 0.0) for at, v in zip((at1, at2), self.rates, strict=True))
            return self.places((k1, at1), (k2, at2), False)
        # next to sigma, p does not determine the angle well, but the integral of ds/|w| does: that of the other angle
        if (by := (u1 <= u2) & (u1 < self.near)).any():
            first = _replaced(first, by, bounded.place(k1[by], (a * at1 + B - unbounded.slope * x)[by], 0)[0])
        if (by := (u2 < u1) & (u2 < self.near)).any():
            second = _replaced(second, by, unbounded.place(k2[by], (b * at2 + A + bounded.slope * x)[by], 0)[0])
        return first, second

    def at(self, first: Place, second: Place) -> Array:
        """States (m, 6) at places of s1 and s2."""
        f, g = self.one.factors(first), self.two.factors(second)
        tau = np.where(second.C == 0.0, NO_TAU, second.C)  # some factors are in tau, others in 1/tau
        D = (self.apart + float(self.one.length) * first.S**2) * tau * tau + float(self.two.length) * second.S**2
        states = self.formula.states(f, g, tau, D)
        close = MEETING * max(map(abs, self.formula.differences)) * tau * tau > D
        if close.any():
            f, g = ([value[close] for value in both] for both in (f, g))
            states[close] = self.formula.states(f, g, tau[close], D[close], True)
        return states


class Formula(NamedTuple):
    """Constants of the formula of the states, in doubles or in multiprecision, and signs of f, A and B."""

    c: float
    x0: Any
    r1: Any
    differences: tuple[Any, ...]
    """e_j - e_i of the cyclic pairs."""
    centred: tuple[Any, ...]
    """e_i - r2."""
    signs: tuple[int, ...] = (1, 1, 1, 1, 1)
    A: int = 1
    B: int = 1

    @classmethod
    def of(cls, curve: Curve, c: float) -> Formula:
        """Formula in multiprecision."""
        e = curve.e
        differences, centred = tuple(e[j] - e[i] for i, j in CYCLIC), tuple(e[i] - curve.r2 for i in range(3))
        return cls(c, curve.x0, curve.r1, differences, centred)

    def rounded(self) -> Formula:
        """Formula in doubles."""
        differences, centred = (tuple(map(complex, values)) for values in (self.differences, self.centred))
        return self._replace(x0=complex(self.x0), r1=complex(self.r1), differences=differences, centred=centred)

    def states(self, f: Sequence[Any], g: Sequence[Any], tau: Any, D: Any, close: bool = False) -> Array:
        """States (m, 6) from f_i, tau g_i and tau² D; ``close`` avoids cancellation where s1 is close to s2."""
        f1, f2, f3, f4, f5 = f = [sign * value for sign, value in zip(self.signs, f, strict=True)]
        g1, g2, g3, g4, g5 = g
        t2 = tau * tau
        h, k = ([f[i] * tau + sign * g[i] for i in range(3)] for sign in (-1.0, 1.0))
        if close:
            k, h = map(list, zip(*(_both(*both, D) for both in zip(k, h, strict=True)), strict=True))
        # tau (h_i - k_j), h_i + k_j and h_j + k_i of the cyclic pairs, whose products are the denominators
        mixed = [self._mixed(f, g, tau, pair) for pair in range(3)]
        if close:
            mixed = [_improved(mixed[pair], h, k, tau, *CYCLIC[pair]) for pair in range(3)]
        minus, plus, cross = zip(*mixed, strict=True)
        everything, squared = h[0] * h[1] * h[2], D * D
        La = 8.0 * squared / (math.prod(minus) * math.prod(plus))
        # N by that of its three forms with the smallest second term
        n = min(range(3), key=lambda i: abs(self.centred[i]))
        pair = (n + 1) % 3
        i, j = CYCLIC[pair]
        N = 2.0 * h[i] * h[j] / (minus[pair] * cross[pair]) + self.centred[n] * La
        below, m, slope = N - 2.0 * tau, N - tau, self.r1 * La / N
        x = self.x0 + slope
        A, B = self.A * f4 * f5, self.B * g4 * g5
        # F and F', from products of h and k where s1 and s2 are close
        if close:
            sums = k[0] * k[1] * k[2]
            F, G = 0.5 * (sums + everything) / tau, 0.5 * (sums - everything)
        else:
            same, other = f2 * f3 * t2 + g2 * g3, f2 * g3 + g2 * f3
            F, G = f1 * same + g1 * other, g1 * same + f1 * other * t2
        scale, m2 = 1.0 / (N * squared), m * m
        w3 = 2.0 * ((F * B - G * A * tau) * (m2 + t2) - 2.0 * m * (F * A * (t2 * tau) - G * B)) * scale / below
        third = w3 * x + 2.0 * slope * everything * (A * t2 + B) * scale
        root = (f4 * g5 + self.A * self.B * f5 * g4) * everything * below * scale
        xi = x * x - root * root
        gamma = np.array([xi.real, xi.imag, third.real]) / self.c
        return np.column_stack([x.real, x.imag, w3.real, *gamma])

    def _mixed(self, f: Sequence[Any], g: Sequence[Any], tau: Array, pair: int) -> tuple[Any, Any, Any]:
        """tau (h_i - k_j), h_i + k_j and h_j + k_i.

        Of f_i + f_j and f_i - f_j the larger is computed, the other one is (e_j - e_i) divided by it.
        """
        (i, j), apart = CYCLIC[pair], self.differences[pair]
        f_sum, f_less = _both(f[i] + f[j], f[i] - f[j], apart)
        g_sum, g_less = g[i] + g[j], g[i] - g[j]
        larger = _square(g_sum) >= _square(g_less)
        other = tau * apart / _nonzero(np.where(larger, g_sum, g_less))
        quotient = np.where(larger, other, g_less / tau)  # the difference is needed divided by tau
        return tau * f_less - np.where(larger, g_sum, tau * other), f_sum - quotient, f_sum + quotient


def _improved(mixed: Sequence[Any], h: Any, k: Any, tau: Array, i: int, j: int) -> list[Any]:
    """The ``mixed`` values, as sums of h and k where these are smaller than the terms of the values."""
    terms = np.maximum(_square(h[i]), _square(k[i])) + np.maximum(_square(h[j]), _square(k[j]))
    sums = (h[i], -k[j], 1.0), (h[i], k[j], tau), (h[j], k[i], tau)
    return [
        np.where(np.maximum(_square(left), _square(right)) < 0.1 * terms, (left + right) / scale, value)
        for value, (left, right, scale) in zip(mixed, sums, strict=True)
    ]


def _square(z: Any) -> Array:
    return z.real * z.real + z.imag * z.imag


def _nonzero(z: Any) -> Any:
    return np.where(z == 0.0, _TINY, z)


def _both(total: Any, difference: Any, product: complex | Array) -> tuple[Any, Any]:
    """Sum and difference, of which the smaller one is ``product`` divided by the larger."""
    larger = _square(total) >= _square(difference)
    other = product / _nonzero(np.where(larger, total, difference))
    return np.where(larger, total, other), np.where(larger, other, difference)


def _replaced(place: Place, where: NDArray[np.bool_], by: Place) -> Place:
    """Copy of ``place`` with the points ``by`` at the positions ``where``."""
    copies: list[Any] = [values.copy() for values in place]
    for values, better in zip(copies, by, strict=True):
        values[where] = better
    return Place(*copies)


def _solved(equation: Callable[..., tuple[Array, Array, Array]], count: int, bound: float, scale: float) -> Array:
    """Zeros (m,) of growing functions between -bound and bound, by Newton's method in a bracket, from 0."""
    x, low, high = np.zeros(count), np.full(count, -bound), np.full(count, bound)
    left, width = np.arange(count), high - low
    for iteration in range(ITERATIONS):
        here = x[left]
        value, slope, size = equation(here, left)
        low[left], high[left] = np.where(value > 0.0, low[left], here), np.where(value > 0.0, here, high[left])
        lo, hi = low[left], high[left]
        new = here - value / slope
        scaled = EPS * (np.abs(here) + scale)
        done = (np.abs(new - here) <= 2.0 * scaled) | (np.abs(value) <= EPS * size) | (hi - lo <= scaled)
        bisect = ~((new >= lo) & (new <= hi))
        if iteration % 3 == 2:  # Newton's steps may be short on one side of a logarithm
            bisect |= hi - lo > 0.5 * width[left]
            width[left] = hi - lo
        x[left] = np.where(bisect, np.where(done, here, 0.5 * (lo + hi)), new)
        left = left[~done]
        if not len(left):
            break
    return x


def series_step(y: Sequence[Any], c: Any, t: Any, order: int) -> list[Any]:
    """State after the time ``t`` by a Taylor series; the components may be numbers of any kind or arrays."""

    def product(a: list[Any], b: list[Any]) -> Any:
        return sum(u * v for u, v in zip(a, reversed(b), strict=True))

    columns = w1, w2, w3, g1, g2, g3 = [[v] for v in y]
    for m in range(1, order + 1):
        rates = (
            product(w2, w3) / 2,
            (c * g3[-1] - product(w3, w1)) / 2,
            -c * g2[-1],
            product(g2, w3) - product(g3, w2),
            product(g3, w1) - product(g1, w3),
            product(g1, w2) - product(g2, w1),
        )
        for column, rate in zip(columns, rates, strict=True):
            column.append(rate / m)
    return [sum(v * t**m for m, v in enumerate(column)) for column in columns]


def separated_motion(y: Sequence[Fraction], c: float) -> Separated:
    """Motion from the state ``y`` (6,); omega and c gamma should be of the order of one.

    Raises ZeroDivisionError if s1 and s2 are undetermined, and RunError for other motions that are not covered.
    """
    of = Integrals.of(y, c)
    with digits(ROOT_DIGITS):
        curve = Curve.with_integrals(of)
        start = [real(v) for v in y]
        soon = series_step(start, mp.mpf(c), mp.mpf(MOMENT), 4)
        variables = [separated(of, s) for s in (start, soon)]
        motion = Separated(curve, c)
        ovals = motion.one, motion.two
        for oval in ovals:
            oval.tabulate()
        before, after = ([oval.angle(s) for oval, s in zip(ovals, both, strict=True)] for both in variables)
        ways = [1 if b > a else -1 for a, b in zip(before, after, strict=True)]
        motion.set_start(before, ways)
        motion.formula = motion.formula_of_state(soon, variables[1], after, ways)
    _verify(motion, np.array([float(v) for v in y]))
    return motion


def _verify(motion: Separated, y: Array) -> None:
    """Compare states over long times with Taylor series of the equations; raise RunError if they differ."""
    n = np.array(_PROBES)
    here, there = motion.states(n, PROBE_STEP), motion.states(n + 1, PROBE_STEP)
    with np.errstate(all="ignore"):
        expected = np.array(series_step(list(here.T), motion.c, PROBE_STEP, 24)).T
        size = 1.0 + np.abs(here).max() ** 2 / min(1.0, abs(motion.c))
        missed = max(np.abs(expected - there).max(), np.abs(here[_PROBES.index(0)] - y).max()) / size
    if not missed < _AGREEMENT:
        why = f"too close to a degenerate motion: a Taylor step differs by {missed:.0e} of the terms"
        raise RunError(REFUSED.format(why))
