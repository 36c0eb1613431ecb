"""Functions of mpmath, imported at first use and without types, which would make every root possibly complex."""

from __future__ import annotations

from typing import Any


def __getattr__(name: str) -> Any:
    import mpmath

    return getattr(mpmath, name)
