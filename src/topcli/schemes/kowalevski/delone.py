"""Motions of the Kowalevski top with k = 0 and E = 2 l²/gamma² (Delone 1892), where three roots of the curve coincide.

The body spins about its third axis when that is vertical, for example. With k = 0, a = |c gamma|, E = 2 omega1² +
omega3²/2 and an angle phi,

    omega1 = s sqrt(E/2) sin phi,  omega2 = s phi',  omega3 = sqrt(2 E) cos phi,  c gamma3 = s a cos phi,
    c (gamma1 + i gamma2) = (omega1 + i omega2)²,     phi'² = sin phi (a - E/2 sin phi),

where s is the sign of l. tan(phi/2) is an elliptic function of time: with the parameter m = 1/2 + E/(4 a) and the
argument u = start + sqrt(a/2) t,

    sin phi = sn²/(1 + cn²),    cos phi = 2 cn/(1 + cn²),    phi' = sqrt(2 a) sn dn/(1 + cn²).

If m > 1, functions of the parameter 1/m are used.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, Floats
from topcli.schemes.kowalevski.jacobi_phase import JacobiPhase
from topcli.schemes.kowalevski.separation import DIGITS, integrals, real


def has_triple_root(y: Floats, c: float) -> bool:
    """True if k = 0 and E = 2 l²/gamma², exactly."""
    of = integrals(y, c)
    return of.k_sq == 0 and 3 * of.l1 * of.G == 2 * of.L**2


@dataclass(frozen=True)
class TripleRoot:
    """Motion with k = 0 and E = 2 l²/gamma², from the ``phase`` of its elliptic functions.

    ``spin`` is sqrt(2 E), ``weight`` is |c gamma|, ``sign`` that of l. If ``folded``, the parameter m exceeds one and
    ``root`` is its root; ``mirrored`` if phi is then replaced by pi - phi.
    """

    c: float
    spin: float
    weight: float
    sign: float
    phase: JacobiPhase
    root: float
    folded: bool
    mirrored: bool

    @classmethod
    def of(cls, y: Floats, c: float) -> TripleRoot:
        """Motion from the state ``y`` (6,), which is not at rest."""
        from topcli.schemes.kowalevski.multiprecision import asin, atan2, atanh, digits, ellipf, ellipk, mpf, sqrt

        of = integrals(y, c)
        sign = -1 if of.L < 0 else 1
        w1, w2, _, _, _, g3 = map(Fraction, y)
        with digits(DIGITS):
            a, E = sqrt(real(of.G)), 3 * real(of.l1)
            m, critical = mpf(1) / 2 + E / (4 * a), (3 * of.l1) ** 2 == 4 * of.G
            # cn = (1 - x)/(1 + x) with x = tan(phi/2), and the sign of sn is that of phi'
            cosine = sign * real(Fraction(c) * g3) / a
            sine = real(w1 * w1 + w2 * w2) / a
            cn = cosine / (1 + sine)
            sn, upwards = sqrt(2 * sine / (1 + sine)) if sine else mpf(0), sign * w2 >= 0
            rate = sqrt(a / 2)
            folded, mirrored = critical or m > 1, False
            if not folded:
                start = ellipf(atan2(sn if upwards else -sn, cn), m)
                phase = JacobiPhase.of(start, rate, ellipk(m), 1 - m)
            else:
                m = mpf(1) if critical else m
                mirrored = cn < 0
                upwards ^= bool(mirrored)
                amplitude = asin(min(sqrt(m) * sn, mpf(1)))
                rate = sqrt(m) * rate if upwards else -sqrt(m) * rate
                start = atanh(sn) if critical else ellipf(amplitude, 1 / m)
                phase = JacobiPhase.of(start, rate, None if critical else ellipk(1 / m), 0 if critical else 1 - 1 / m)
            return cls(c, float(sqrt(2 * E)), float(a), float(sign), phase, float(sqrt(m)), folded, bool(mirrored))

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
