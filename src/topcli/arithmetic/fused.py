"""Fused multiply-add, a b + c rounded once, and a hint for the prediction of branches.

Compiled code uses the machine instruction, if there is one, for calls of ``fma`` and nowhere else. The source code
rather than the compiler decides which operations are fused, so the results are the same on every machine.
"""

from __future__ import annotations

import math
from fractions import Fraction


def fma(a: float, b: float, c: float) -> float:
    """Return a b + c rounded once, computed with exact fractions; bit-identical to the processor's instruction.

    Overflow gives infinity, underflow is gradual, and a nan or an invalid operation gives nan. For other types of
    numbers, such as ``Fraction`` or mpmath's, the result is ``a * b + c``. Raises TypeError for arrays, whose products
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
        # an exact zero has the sign common to both terms, else +0
        same = math.copysign(1.0, a) * math.copysign(1.0, b) * math.copysign(1.0, c) > 0.0
        return math.copysign(0.0, c) if same and c == 0.0 else 0.0
    try:
        return float(exact)
    except OverflowError:
        return math.inf if exact > 0 else -math.inf


def unlikely(condition: bool) -> bool:
    """Return ``condition`` unchanged; compiled code is laid out as if it were always false.

    A function called in the branch may overwrite every register. With this hint the branch itself saves and restores
    them, and the common path keeps its values in registers.
    """
    return condition
