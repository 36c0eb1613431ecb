"""The tops: parameters, equations of motion, integrals. One file a top; ``TOPS`` lists them by kind."""

from __future__ import annotations

from topcli.contracts import Top
from topcli.errors import UnknownNameError, nearest
from topcli.tops.kowalevski import Kowalevski

TOPS: dict[str, type[Top]] = {top.kind: top for top in (Kowalevski,)}


def top_class(kind: str) -> type[Top]:
    """The class of the top called ``kind`` (matched without case).

    Raises UnknownNameError with the nearest names.
    """
    try:
        return TOPS[kind.lower()]
    except KeyError:
        raise UnknownNameError(f"unknown top {kind!r}; {nearest(kind, TOPS)}") from None
