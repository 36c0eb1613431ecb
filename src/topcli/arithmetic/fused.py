"""Arithmetic of doubles: fused multiply-add, double-double numbers, and constants that follow the precision.

**Fused multiply-add**, a b + c rounded once. Compiled code uses the machine instruction, if there is one, for calls of
``fma`` and nowhere else. The source code rather than the compiler decides which operations are fused, so the results
are the same on every machine. ``unlikely`` is a hint for the prediction of branches.

**Double-double.** A number is an unevaluated sum hi + lo of plain floats with |lo| <= ulp(hi)/2. This gives about 32
digits with the exponent range of a double. The operations and their error bounds, in units of u² with u = 2^-53, are
those of Joldes, Muller and Popescu, ACM Trans. Math. Softw. 44(2), 2017; they hold in the absence of overflow and
underflow. Each operation must be rounded separately: no reassociation, and no contraction other than the explicit
``fma``.

**Constants that follow the precision.** A module declares beside its constants which of them follow the rounding error,
and which are maximum numbers of iterations. In double precision the declaration has no effect; a copy of a function for
another arithmetic (``engine.numbers``) uses the constants scaled to it.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from fractions import Fraction
from functools import lru_cache
from typing import Any


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
    return double_of(exact)


def double_of(x: Fraction) -> float:
    """Nearest double; infinite beyond the range of doubles."""
    try:
        return float(x)
    except OverflowError:
        return math.inf if x > 0 else -math.inf


def defined(text: str, label: str, **names: Any) -> dict[str, Any]:
    """Functions that a text defines, by name; it may use the ``names``, among them the name of its module."""
    exec(_code(text, f"<{label}>"), names)
    return names


@lru_cache(maxsize=256)
def _code(text: str, label: str) -> Any:
    return compile(text, label, "exec")


def unlikely(condition: bool) -> bool:
    """Return ``condition`` unchanged; compiled code is laid out as if it were always false.

    A function called in the branch may overwrite every register. With this hint the branch itself saves and restores
    them, and the common path keeps its values in registers.
    """
    return condition


def two_sum(a: float, b: float) -> tuple[float, float]:
    """Return ``(s, e)`` with s = fl(a + b) and s + e = a + b exactly (Knuth)."""
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


def quick_two_sum(a: float, b: float) -> tuple[float, float]:
    """Return ``two_sum(a, b)``, for |a| >= |b| or a = 0 (Dekker)."""
    s = a + b
    return s, b - (s - a)


def compensated_sum(y: float, e: float, d: float) -> tuple[float, float]:
    """Return ``(s, r)``: the rounded sum s of y + (e + d) and its rounding error r, so that s + r = y + (e + d).

    It carries the rounding error of an addition state + change to the next step (Kahan, Comm. ACM 8 (1965) 40). Only
    the errors of the changes remain, and round-off grows as h sqrt(N) instead of sqrt(N). The change is still evaluated
    at the rounded state; the resulting error is smaller by a factor of h and as random as the rounding.

    Exact for |y| >= |e + d| (Dekker). In the one or two steps in which a component passes zero, r itself may be
    rounded, with an error of at most the last bit of d, no larger than the error of d. Compensation adds one addition
    to the critical path of a step.
    """
    return quick_two_sum(y, d + e)


def two_prod(a: float, b: float) -> tuple[float, float]:
    """Return ``(p, e)`` with p = fl(a b) and p + e = a b exactly, for |a b| > 2^-968 or a b = 0, without overflow."""
    p = a * b
    return p, fma(a, b, -p)


def dd_add(ah: float, al: float, bh: float, bl: float) -> tuple[float, float]:
    """Sum a + b; relative error at most 3u²/(1 - 4u), even with cancellation."""
    sh, sl = two_sum(ah, bh)
    th, tl = two_sum(al, bl)
    vh, vl = quick_two_sum(sh, sl + th)
    return quick_two_sum(vh, tl + vl)


def dd_mul(ah: float, al: float, bh: float, bl: float) -> tuple[float, float]:
    """Product a b; relative error at most 7u²."""
    p, e = two_prod(ah, bh)
    return quick_two_sum(p, e + (ah * bl + al * bh))


def dd_scale(ah: float, al: float, b: float) -> tuple[float, float]:
    """Product a b for a plain float b; relative error at most 2u²."""
    p, e = two_prod(ah, b)
    th, tl = quick_two_sum(p, al * b)
    return quick_two_sum(th, tl + e)


def dd_div(ah: float, al: float, b: float) -> tuple[float, float]:
    """Quotient a / b for a plain float b != 0; relative error at most 3u²."""
    q = ah / b
    p, e = two_prod(q, b)
    return quick_two_sum(q, (((ah - p) - e) + al) / b)


FOLLOWING: dict[tuple[str, object], float | None] = {}
"""Powers of the rounding error by name and value of a constant, which others may import; None for a cap."""


def follow_precision(module: str, *, caps: Sequence[str] = (), **powers: float) -> None:
    """Declare constants of ``module`` that follow the precision.

    Parameters
    ----------
    module : str
        ``__name__`` of the module.
    caps : sequence of str
        Names of maximum numbers of iterations, which grow in proportion to the number of digits.
    **powers
        Names of tolerances, each with the power of the rounding error to which it is proportional: 1 for a multiple of
        the rounding error, 0.5 for its square root. A guard against division by 0 has a large power.
    """
    for name, power in (dict.fromkeys(caps) | powers).items():
        FOLLOWING[name, getattr(sys.modules[module], name)] = power
