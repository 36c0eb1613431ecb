"""What a kernel knows about its branches and a compiler does not."""

from __future__ import annotations


def rarely(condition: bool) -> bool:
    """``condition`` itself. Compiled code is laid out as if it never held.

    What the rare branch calls may overwrite every register; said to be rare, it saves and restores them itself, and
    the common way keeps its values in registers.
    """
    return condition
