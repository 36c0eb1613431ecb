"""mpmath in a context of its own, so that no other code changes its precision; importing mpmath takes 40 ms."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from typing import Any

from mpmath.ctx_mp import MPContext

Real = Any
"""A number of mpmath, which has no types."""
mp: Any = MPContext()
DIGITS = 50
"""Decimal digits of the constants of a closed form."""
_LOCK = threading.RLock()


@contextmanager
def digits(count: int = DIGITS) -> Iterator[None]:
    """Compute with ``count`` decimal digits; other threads wait."""
    with _LOCK, mp.workdps(count):
        yield


def real(q: Fraction | float) -> Real:
    """Return ``q`` in multiprecision."""
    q = Fraction(q)
    return mp.mpf(q.numerator) / q.denominator


def cubic_roots(g2: Real, g3: Real, all_real: bool | None = None) -> list[Real]:
    """Roots of 4 s³ - g2 s - g3; a conjugate pair comes last. If ``all_real``, rounding cannot make one of them."""
    D = g2**3 - 27 * g3**2
    if all_real or (all_real is None and D >= 0):
        m = mp.sqrt(max(g2, mp.mpf(0)) / 3)
        angle = mp.acos(min(max(g3 / m**3, mp.mpf(-1)), mp.mpf(1))) / 3 if m else mp.mpf(0)
        return [mp.mpc(m * mp.cos(angle - 2 * mp.pi * j / 3)) for j in range(3)]
    q = mp.sqrt(abs(D) / 27)
    u = g3 + q if g3 >= 0 else g3 - q
    a = mp.sign(u) * mp.cbrt(abs(u) / 8)
    b = g2 / (12 * a)
    upper = mp.mpc(-(a + b) / 2, abs(mp.sqrt(mp.mpf(3)) * (a - b) / 2))
    return [mp.mpc(a + b), upper, mp.conj(upper)]
