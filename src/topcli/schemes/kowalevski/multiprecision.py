"""Functions of mpmath in a context of their own, imported at first use.

The precision of mpmath's own context is shared by all threads and by other code. They have no types here, because in
mpmath's annotations every root is possibly complex.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from functools import cache
from typing import Any


@cache
def _lock() -> Any:
    return threading.RLock()


_lock()


@cache
def _context() -> Any:
    import mpmath

    return mpmath.mp.clone()


@contextmanager
def digits(count: int) -> Iterator[None]:
    """Compute with ``count`` decimal digits; other threads wait."""
    with _lock():
        context = _context()
        before = context.dps
        context.dps = count
        try:
            yield
        finally:
            context.dps = before


def fraction(x: Any) -> Fraction:
    """Real number of mpmath as an exact fraction, for use without mpmath."""
    sign, mantissa, exponent, _ = x.real._mpf_
    value = Fraction(int(mantissa)) * Fraction(2) ** int(exponent)
    return -value if sign else value


def __getattr__(name: str) -> Any:
    return _context() if name == "mp" else getattr(_context(), name)
