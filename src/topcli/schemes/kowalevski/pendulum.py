"""Motions of the Kowalevski top with omega2 = 0 for ever: a pendulum (Bobylev 1896, Steklov 1896).

If omega2 = 0 and c gamma3 = omega1 omega3 at one time, they hold always and omega1 is constant. The argument theta of
xi = omega1² - c (gamma1 + i gamma2) then satisfies theta' = -omega3, theta'' = -k sin theta, with k = |xi| constant.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, Floats
from topcli.schemes.kowalevski.jacobi_phase import JacobiPhase
from topcli.schemes.kowalevski.separation import DIGITS, real


def is_pendulum(y: Floats, c: float) -> bool:
    """True if omega2 = 0 and c gamma3 = omega1 omega3, exactly."""
    w1, w2, w3, _, _, g3 = map(Fraction, y)
    return w2 == 0 and Fraction(c) * g3 == w1 * w3


@dataclass(frozen=True)
class Pendulum:
    """Pendulum with sin(theta/2) = size sn of the ``phase``."""

    omega1: float
    c: float
    k: float
    phase: JacobiPhase
    size: float
    rotates: bool

    @classmethod
    def of(cls, y: Floats, c: float) -> Pendulum:
        """Pendulum of the state ``y`` (6,), which is not at rest."""
        from topcli.schemes.kowalevski.multiprecision import (
            arg,
            atan2,
            atanh,
            cos,
            digits,
            ellipf,
            ellipk,
            mpc,
            sign,
            sin,
            sqrt,
        )

        w1, _, w3, g1, g2, _ = map(Fraction, y)
        square = (w1 * w1 - Fraction(c) * g1, -Fraction(c) * g2)
        energy, k_sq = w3 * w3 - 2 * square[0], square[0] ** 2 + square[1] ** 2
        with digits(DIGITS):
            k = sqrt(real(k_sq))
            half, v, n = arg(mpc(real(square[0]), real(square[1]))) / 2, -real(w3), sqrt(k)
            size = sqrt(v * v / (4 * k) + sin(half) ** 2)
            if energy >= 0 and energy**2 == 4 * k_sq:
                way = sign(v)
                phase = JacobiPhase.of(atanh(sin(half)), way * n, None, 0)
                return cls(float(w1), c, float(k), phase, 1.0, False)
            past = (cos(half) ** 2 - v * v / (4 * k)).real  # 1 - size²
            if past > 0:
                start = ellipf(atan2(sin(half) / size, v / (2 * n * size)), size**2)
                phase = JacobiPhase.of(start, n, ellipk(size**2), past)
                return cls(float(w1), c, float(k), phase, float(size), False)
            m = 1 / size**2
            start, rate = ellipf(half, m), sign(v) * n * size
            return cls(float(w1), c, float(k), JacobiPhase.of(start, rate, ellipk(m), -past * m), float(size), True)

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
