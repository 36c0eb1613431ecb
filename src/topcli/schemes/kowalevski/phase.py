"""Phases that grow by the same amount in every step, reduced exactly: integers in units of 2^-128 turns."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array

BITS = 128
TURN = 1 << BITS
LOW = (1 << 64) - 1
HALF = np.uint64(32)
MASK = np.uint64((1 << 32) - 1)


@dataclass(frozen=True)
class Phase:
    """Phase ``start`` + n ``step`` modulo one turn, both in units of 2^-128 turns."""

    start: int
    step: int

    @classmethod
    def of(cls, start: Fraction, step: Fraction) -> Phase:
        """Phase from numbers of turns."""
        return cls(math.floor(start * TURN) % TURN, math.floor(step * TURN) % TURN)

    def turns(self, n: NDArray[np.int64], fine: bool = False) -> Array:
        """Phases after ``n`` (m,) steps of either sign, in [-1/2, 1/2) turns; the error is less than 2^-64 + ulp.

        With ``fine`` small phases have 128 bits, less those of ``n``.
        """
        count = n.astype(np.int64).view(np.uint64)
        low = np.uint64(self.step & LOW)
        high = np.uint64(self.step >> 64) * count + _upper_half(low, count)
        high -= np.where(n < 0, low, np.uint64(0))  # n was taken modulo 2^64
        lower = low * count + np.uint64(self.start & LOW)
        carry = lower < np.uint64(self.start & LOW)
        total = high + np.uint64(self.start >> 64) + carry
        upper = total.view(np.int64) * 2.0**-64
        return upper + lower * 2.0**-128 if fine else upper


def _upper_half(a: np.uint64, b: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Upper 64 bits of the products of 64-bit integers."""
    a1, a0, b1, b0 = a >> HALF, a & MASK, b >> HALF, b & MASK
    low, middle = a0 * b0, a1 * b0
    cross = a0 * b1 + (low >> HALF) + (middle & MASK)
    return a1 * b1 + (middle >> HALF) + (cross >> HALF)
