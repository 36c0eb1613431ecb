"""The fused multiply-add: a b + c, rounded once.

Where the machine has the instruction, compiled code uses it in the place of ``fma`` and nowhere else: what is fused is
said in the kernel and not left to a compiler, so that the results are the same on every machine.
"""

from __future__ import annotations

import math
from fractions import Fraction


def fma(a: float, b: float, c: float) -> float:
    """a b + c rounded once, by exact fractions: what the processor's instruction gives, bit for bit.

    Overflows to infinity, underflows gradually, and gives nan where a nan or an invalid operation goes in. Numbers of
    another kind, exact fractions or mpmath's, follow their own rules. Raises TypeError for arrays, whose products
    would be rounded.
    """
    if not (isinstance(a, float) and isinstance(b, float) and isinstance(c, float)):
        if any(hasattr(x, "__array__") and not isinstance(x, float) for x in (a, b, c)):
            raise TypeError("fma takes numbers, not arrays")
        return a * b + c
    if not (math.isfinite(a) and math.isfinite(b)):
        return a * b + c
    if not math.isfinite(c):
        return c
    exact = Fraction(a) * Fraction(b) + Fraction(c)
    if exact == 0:
        # an exact zero takes the sign that the two terms share, or is +0
        same = math.copysign(1.0, a) * math.copysign(1.0, b) * math.copysign(1.0, c) > 0.0
        return math.copysign(0.0, c) if same and c == 0.0 else 0.0
    try:
        return float(exact)
    except OverflowError:
        return math.inf if exact > 0 else -math.inf
