"""Branch prediction hint for compiled steps."""

from __future__ import annotations


def unlikely(condition: bool) -> bool:
    """Return ``condition`` unchanged; compiled code is laid out as if it were always false.

    A function called in the branch may overwrite every register. With this hint the branch itself saves and restores
    them, and the common path keeps its values in registers.
    """
    return condition
