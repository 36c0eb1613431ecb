"""Jacobi's elliptic functions of a phase that grows with time and is reduced exactly, for motions of genus one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.elliptic import add, jacobi, multiple
from topcli.contracts import Array
from topcli.schemes.kowalevski.phase import Phase
from topcli.schemes.kowalevski.separation import Real

Pair = tuple[float, float]


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
        from topcli.schemes.kowalevski.multiprecision import fraction

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


def _pair(x: Fraction) -> Pair:
    """Return ``x`` as a sum of two doubles."""
    high = float(x)
    return (high, float(x - Fraction(high))) if math.isfinite(high) else (high, 0.0)
