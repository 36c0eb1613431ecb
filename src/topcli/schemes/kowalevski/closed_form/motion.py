"""Motions of the Kowalevski top at any time, without time stepping.

A state follows from the factors f_i = sqrt(s1 - e_i), g_i = sqrt(s2 - e_i) of the curve. With D = s1 - s2,
h_i = f_i - g_i, k_i = f_i + g_i, the indices 1, 2, 3 cyclic and r1, r2 as in ``curve.Curve``,

    La = 8 D² / prod (h_i - k_j)(h_i + k_j),    N_1 = 2 h_2 h_3/((h_2 - k_3)(h_3 + k_2)),    N = N_n + (e_n - r2) La,
    omega1 + i omega2 = x0 + r1 La/N,    m = N - 1,    A = ± f_4 f_5,    B = ± g_4 g_5,
    omega3 = 2 ((F B - F' A)(m² + 1) - 2 m (F A - F' B))/((m² - 1) D²),
    F = f1 f2 f3 + f1 g2 g3 + g1 f2 g3 + g1 g2 f3,    F' the same with f and g exchanged,
    c gamma3 = omega3 x1 + 2 r1 h1 h2 h3 La (A + B)/(D² N²),
    xi = ((f4 g5 ± f5 g4) h1 h2 h3 (N - 2)/(N D²))²,    c (gamma1 + i gamma2) = x1² - xi.

The form has no singular point at double roots. All g are multiplied by tau, so that s2 may pass through infinity
(tau = 0).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array
from topcli.schemes.kowalevski.closed_form.course import EPS, Course, JacobiPhase, Positions
from topcli.schemes.kowalevski.closed_form.table import OvalTable, Place

CYCLIC = ((0, 1), (1, 2), (2, 0))
TINY = 1e-300
MEETING = 0.02
"""Largest s1 - s2, relative to the differences of roots, at which h_i and k_i are found from each other."""
CHUNK = 4096
"""States evaluated together, so that the arrays stay in the cache."""
NO_TAU = 1e-100
WEAK = 1e-9
"""Round-off eps |omega|²/c, relative to gamma, from which on gravity is too weak for a motion that was refused."""
SIDEWAYS = 0.01
"""Part of gamma² across the angular momentum from which on gamma² determines its length."""


@dataclass(frozen=True)
class Formula:
    """Constants of the formula above: differences e_j - e_i of the cyclic pairs, e_i - r2, x0, r1, c and two signs."""

    differences: tuple[complex, complex, complex]
    centred: tuple[complex, complex, complex]
    x0: complex
    r1: complex
    c: float
    sign_a: int = 1
    sign_b: int = 1

    def states(self, f: Sequence[Any], g: Sequence[Any], tau: Array, D: Array) -> Array:
        """States, shape (m, 6), from f_i, tau g_i and tau² (s1 - s2)."""
        found = self._states(f, g, tau, D, False)
        meeting = MEETING * max(map(abs, self.differences)) * tau * tau > D
        if meeting.any():
            f, g = ([one[meeting] for one in both] for both in (f, g))
            found[meeting] = self._states(f, g, tau[meeting], D[meeting], True)
        return found

    def _states(self, f: Sequence[Any], g: Sequence[Any], tau: Array, D: Array, meeting: bool) -> Array:
        """The same; ``meeting`` avoids cancellation where s1 and s2 are close to each other and to a double root."""
        f1, f2, f3, f4, f5 = f
        g1, g2, g3, g4, g5 = g
        t2 = tau * tau
        h = [f[i] * tau - g[i] for i in range(3)]
        minus, plus_ij, plus_ji = self._mixed(f, g, tau, t2)
        k: list[Any] = []
        if meeting:
            k = [f[i] * tau + g[i] for i in range(3)]
            k, h = map(list, zip(*(_both(*both, D) for both in zip(k, h, strict=True)), strict=True))
            self._improve(minus, plus_ij, plus_ji, h, k, tau)
        product = h[0] * h[1] * h[2]
        squared = D * D
        La = 8.0 * squared / (minus[0] * minus[1] * minus[2] * plus_ij[0] * plus_ij[1] * plus_ij[2])
        n = min(range(3), key=lambda i: abs(self.centred[i]))
        pair = (n + 1) % 3
        i, j = CYCLIC[pair]
        N = 2.0 * h[i] * h[j] / (minus[pair] * plus_ji[pair]) + self.centred[n] * La
        below = N - 2.0 * tau
        m = N - tau
        slope = self.r1 * La / N
        x = self.x0 + slope
        A, B = self.sign_a * f4 * f5, self.sign_b * g4 * g5
        ff, gg = f2 * f3, g2 * g3
        mixed = f2 * g3 + g2 * f3
        F = f1 * (ff * t2 + gg) + g1 * mixed
        G = g1 * (gg + ff * t2) + f1 * mixed * t2
        if meeting:
            sums = k[0] * k[1] * k[2]
            F, G = 0.5 * (sums + product) / tau, 0.5 * (sums - product)
        scale = 1.0 / (N * squared)
        m2 = m * m
        w3 = 2.0 * ((F * B - G * A * tau) * (m2 + t2) - 2.0 * m * (F * A * (t2 * tau) - G * B)) * scale / below
        third = w3 * x + 2.0 * slope * product * (A * t2 + B) * scale
        root = (f4 * g5 + self.sign_a * self.sign_b * f5 * g4) * product * below * scale
        vertical = x * x - root * root
        found = np.empty((len(tau), 6))
        found[:, 0], found[:, 1], found[:, 2] = x.real, x.imag, w3.real
        found[:, 3], found[:, 4], found[:, 5] = vertical.real / self.c, vertical.imag / self.c, third.real / self.c
        return found

    @staticmethod
    def _improve(minus: list[Any], plus_ij: list[Any], plus_ji: list[Any], h: Any, k: Any, tau: Array) -> None:
        """Replace what ``_mixed`` returns by sums of h and k where these are smaller than its terms."""
        for pair, (i, j) in enumerate(CYCLIC):
            for found, one, other, sign, scale in (
                (minus, h[i], k[j], -1.0, 1.0),
                (plus_ij, h[i], k[j], 1.0, tau),
                (plus_ji, h[j], k[i], 1.0, tau),
            ):
                terms = np.maximum(_square(h[i]), _square(k[i])) + np.maximum(_square(h[j]), _square(k[j]))
                small = np.maximum(_square(one), _square(other)) < 0.1 * terms
                found[pair] = np.where(small, (one + sign * other) / scale, found[pair])

    def _mixed(
        self, f: Sequence[Any], g: Sequence[Any], tau: Array, t2: Array
    ) -> tuple[list[Any], list[Any], list[Any]]:
        """tau (h_i - k_j), h_i + k_j and h_j + k_i of the cyclic pairs.

        Of f_i + f_j and f_i - f_j the larger is computed, the other one is (e_j - e_i) divided by it.
        """
        minus, plus_ij, plus_ji = [], [], []
        for (i, j), apart in zip(CYCLIC, self.differences, strict=True):
            f_sum, f_difference = _both(f[i] + f[j], f[i] - f[j], apart)
            g_sum, g_difference = g[i] + g[j], g[i] - g[j]
            larger = _square(g_sum) >= _square(g_difference)
            divisor = np.where(larger, g_sum, g_difference)
            divisor = np.where(divisor == 0.0, TINY, divisor)
            other = tau * apart / divisor
            # the difference is needed divided by tau
            quotient = np.where(larger, other, g_difference / tau)
            minus.append(tau * f_difference - np.where(larger, g_sum, tau * other))
            plus_ij.append(f_sum - quotient)
            plus_ji.append(f_sum + quotient)
        return minus, plus_ij, plus_ji


def _square(z: Any) -> Array:
    return z.real * z.real + z.imag * z.imag


def _both(total: Any, difference: Any, product: complex | Array) -> tuple[Any, Any]:
    """Sum and difference, of which the smaller one is ``product`` divided by the larger."""
    larger = _square(total) >= _square(difference)
    divisor = np.where(larger, total, difference)
    other = product / np.where(divisor == 0.0, TINY, divisor)
    return np.where(larger, total, other), np.where(larger, other, difference)


@dataclass(frozen=True)
class Pendulum:
    """Motion with omega2 = 0: a pendulum (Bobylev 1896, Steklov 1896) with sin(theta/2) = size sn(``phase``).

    If omega2 = 0 and c gamma3 = omega1 omega3 at one time, they hold always and omega1 is constant. The argument theta
    of xi = omega1² - c (gamma1 + i gamma2) then satisfies theta' = -omega3, theta'' = -k sin theta, with k = |xi|
    constant.
    """

    omega1: float
    c: float
    k: float
    phase: JacobiPhase
    size: float
    rotates: bool

    def states(self, n: NDArray[np.int64], h: float) -> Array:
        """States (m, 6) after ``n`` (m,) steps of ``h``."""
        sn, cn, dn = self.phase.functions(n, h)
        if self.rotates:
            sine, cosine = sn, cn
            speed = 2.0 * float(self.phase.rate) * dn
        else:
            sine, cosine = self.size * sn, dn
            speed = 2.0 * float(self.phase.rate) * self.size * cn
        found = np.zeros((len(n), 6))
        found[:, 0], found[:, 2] = self.omega1, -speed
        found[:, 3] = (self.omega1**2 - self.k * (1.0 - 2.0 * sine * sine)) / self.c
        found[:, 4] = -self.k * 2.0 * sine * cosine / self.c
        found[:, 5] = -self.omega1 * speed / self.c
        return found


@dataclass(frozen=True)
class TripleRoot:
    """Motion with k = 0 and E = 2 l²/gamma² (Delone 1892), where three roots of the curve coincide.

    The body spins about its third axis when that is vertical, for example. With k = 0, a = |c gamma|, E = 2 omega1² +
    omega3²/2 and an angle phi,

        omega1 = s sqrt(E/2) sin phi,  omega2 = s phi',  omega3 = sqrt(2 E) cos phi,  c gamma3 = s a cos phi,
        c (gamma1 + i gamma2) = (omega1 + i omega2)²,     phi'² = sin phi (a - E/2 sin phi),

    where s is the sign of l. tan(phi/2) is an elliptic function of time: with the parameter m = 1/2 + E/(4 a) and the
    argument u = start + sqrt(a/2) t,

        sin phi = sn²/(1 + cn²),    cos phi = 2 cn/(1 + cn²),    phi' = sqrt(2 a) sn dn/(1 + cn²).

    If m > 1, functions of the parameter 1/m are used.

    ``phase`` is the argument of the elliptic functions, ``spin`` is sqrt(2 E), ``weight`` is |c gamma|, ``sign`` that
    of l. If ``folded``, the parameter m exceeds one and ``root`` is its root; ``mirrored`` if phi is then replaced by
    pi - phi.
    """

    c: float
    spin: float
    weight: float
    sign: float
    phase: JacobiPhase
    root: float
    folded: bool
    mirrored: bool

    def states(self, n: NDArray[np.int64], h: float) -> Array:
        """States (m, 6) after ``n`` (m,) steps of ``h``."""
        sn, cn, dn = self.phase.functions(n, h)
        if self.folded:
            sn, cn, dn = sn / self.root, dn, cn if self.phase.rate >= 0 else -cn
        below = 1.0 + cn * cn
        sine, cosine = sn * sn / below, 2.0 * cn / below
        change = np.sqrt(2.0 * self.weight) * sn * dn / below
        if self.mirrored:
            cosine, change = -cosine, -change
        w1, w2 = 0.5 * self.sign * self.spin * sine, self.sign * change
        found = np.empty((len(n), 6))
        found[:, 0], found[:, 1], found[:, 2] = w1, w2, self.spin * cosine
        found[:, 3] = (w1 * w1 - w2 * w2) / self.c
        found[:, 4] = 2.0 * w1 * w2 / self.c
        found[:, 5] = self.sign * self.weight * cosine / self.c
        return found


@dataclass(frozen=True)
class SeparatedMotion:
    """Motion whose s1 and s2 move on two ovals of the curve (``course``).

    No branch is followed: the signs of all square roots are those of the sine and cosine of the angles, and constants,
    which the initial state and a short step decide (``setup``). ``apart`` is the distance of the ovals; |s - sigma|
    below ``near`` is taken from the integral of ds/|w|.
    """

    c: float
    gamma_sq: float
    two_l: float
    near: float
    apart: float
    course: Course
    formula: Formula
    signs: tuple[int, ...] = (1, 1, 1)

    def with_signs(self, signs: tuple[int, ...]) -> SeparatedMotion:
        """The motion with other signs of f1, f2, f3; those of A and B follow, because both angles grow."""
        A, B = 1j * signs[0] * signs[1] * signs[2], -1j
        for f in self.course.first.factors(_middle(self.course.first)):
            A = A * complex(f[0])
        for g in self.course.second.factors(_middle(self.course.second)):
            B = B * complex(g[0])
        formula = replace(self.formula, sign_a=1 if A.real > 0.0 else -1, sign_b=1 if B.real > 0.0 else -1)
        return replace(self, signs=signs, formula=formula)

    def at(self, one: Place, two: Place) -> Array:
        """States (m, 6) at signed places of s1 and s2."""
        first, second = self.course.first, self.course.second
        f, g = first.factors(one), second.factors(two)
        f = [value if sign > 0 else -value for value, sign in zip(f, (*self.signs, 1, 1), strict=True)]
        tau = np.where(two.C == 0.0, NO_TAU, two.C)  # some factors are in tau, others in 1/tau
        D = (self.apart + first.length * one.S * one.S) * tau * tau + second.length * two.S * two.S
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

    def at_positions(self, positions: Positions) -> Array:
        """States (m, 6) at positions of the course."""
        return self.at(*self.course.places(positions, self.near))

    def states(self, n: NDArray[np.int64], h: float | Fraction) -> Array:
        """States (m, 6) after ``n`` (m,) steps of ``h``."""
        positions = self.course.positions(n, Fraction(h))
        states = np.empty((len(n), 6))
        with np.errstate(all="ignore"):
            for begin in range(0, len(n), CHUNK):
                part = slice(begin, begin + CHUNK)
                states[part] = self.at_positions(tuple(values[part] for values in positions))
        return states


def _middle(table: OvalTable) -> Place:
    """The point with theta = pi/4."""
    half = np.full(1, np.sqrt(0.5))
    past = 0.5 - np.sin(table.anchors[1:2]) ** 2 if len(table.anchors) == 3 else None
    return Place(np.zeros(1, dtype=np.int64), half, half, past)


Motion = Pendulum | TripleRoot | SeparatedMotion
