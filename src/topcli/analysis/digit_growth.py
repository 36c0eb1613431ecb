"""Growth of the numbers along an orbit in rational arithmetic.

Under a map of degree d the length of the numbers grows like the degree of its iterates: quadratically if the map is
integrable, exponentially otherwise (algebraic entropy: Bellon, Viallet, Comm. Math. Phys. 204 (1999) 425).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

FEWEST = 4
"""Fewest rows from which a law is fitted."""


@dataclass(frozen=True)
class DigitGrowth:
    """Growth of the binary digits of the longest number of a state.

    ``law`` is "polynomial", with its ``power``, or "exponential", with the ``factor`` per step; None if there are too
    few rows.
    """

    bits: int
    step: int
    law: str | None = None
    power: float | None = None
    factor: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """Plain data, ready for JSON."""
        return asdict(self)


def digit_growth(n: NDArray[np.int64], bits: NDArray[np.int64]) -> DigitGrowth | None:
    """Return the law that fits ``bits`` (m,) at the steps ``n`` (m,) best, in the later half of the rows."""
    if not len(n):
        return None
    last = DigitGrowth(int(bits[-1]), int(n[-1]))
    late = (n >= n[-1] // 2) & (n > 0) & (bits > 0)
    if late.sum() < FEWEST:
        late = (n > 0) & (bits > 0)
    if late.sum() < FEWEST:
        return last
    steps, size = n[late].astype(float), np.log(bits[late].astype(float))
    power, factor = (np.polyfit(x, size, 1) for x in (np.log(steps), steps))
    off_power = float(np.abs(np.polyval(power, np.log(steps)) - size).max())
    off_factor = float(np.abs(np.polyval(factor, steps) - size).max())
    if off_power <= off_factor:
        return DigitGrowth(last.bits, last.step, "polynomial", power=float(power[0]))
    return DigitGrowth(last.bits, last.step, "exponential", factor=float(np.exp(factor[0])))
