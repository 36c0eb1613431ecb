"""Functions of mpmath in their own context, so that other code does not change their precision.

Only what computes in multiprecision imports this module, because mpmath takes a while to import. The functions have no
types here, because in mpmath's annotations every root is possibly complex.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import mpmath

mp: Any = mpmath.mp.clone()
_LOCK = threading.RLock()


@contextmanager
def digits(count: int) -> Iterator[None]:
    """Compute with ``count`` decimal digits; other threads wait."""
    with _LOCK:
        before = mp.dps
        mp.dps = count
        try:
            yield
        finally:
            mp.dps = before


def __getattr__(name: str) -> Any:
    return getattr(mp, name)
