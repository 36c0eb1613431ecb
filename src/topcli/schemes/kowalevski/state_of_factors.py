"""State of the Kowalevski top from the factors f_i = sqrt(s1 - e_i), g_i = sqrt(s2 - e_i) of its curve.

With D = s1 - s2, h_i = f_i - g_i, k_i = f_i + g_i, the indices 1, 2, 3 cyclic and r1, r2 as in ``separation.Curve``,

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
from dataclasses import dataclass
from typing import Any

import numpy as np

from topcli.contracts import Array

CYCLIC = ((0, 1), (1, 2), (2, 0))
TINY = 1e-300
MEETING = 0.02
"""Largest s1 - s2, relative to the differences of roots, at which h_i and k_i are found from each other."""


@dataclass(frozen=True)
class Formula:
    """Constants of the formula: differences e_j - e_i of the cyclic pairs, e_i - r2, x0, r1, c and two signs."""

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
