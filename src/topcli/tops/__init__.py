"""The tops: parameters, equations of motion, integrals. One file a top.

``TOPS`` lists every form of every top. A kind has several forms where its state can be written in several ways; the
first of them is the kind's own, and the vectors of the initial state tell which is meant.
"""

from __future__ import annotations

from collections.abc import Collection

from topcli.contracts import Top
from topcli.errors import UnknownNameError, nearest
from topcli.tops.euler import Euler, EulerGamma
from topcli.tops.heavy import Heavy
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange, LagrangeInertial

TOPS: dict[str, type[Top]] = {
    top.form: top for top in (Kowalevski, Euler, EulerGamma, Lagrange, LagrangeInertial, Heavy)
}


def kinds() -> list[str]:
    """The names that a config may use for a top."""
    return list(dict.fromkeys(top.kind for top in TOPS.values()))


def forms(kind: str) -> list[type[Top]]:
    """The forms of the top called ``kind`` (matched without case), its own first.

    Raises UnknownNameError with the nearest names.
    """
    found = [top for top in TOPS.values() if top.kind == kind.lower()]
    if not found:
        raise UnknownNameError(f"unknown top {kind!r}; {nearest(kind, kinds())}")
    return found


def top_class(kind: str, vectors: Collection[str] = ()) -> type[Top]:
    """The form of the top called ``kind`` whose initial state has the ``vectors``; its own form when none fits.

    Raises UnknownNameError with the nearest names.
    """
    found = forms(kind)
    return next((top for top in found if set(top.vectors) == set(vectors)), found[0])
