"""The tops: parameters, equations of motion, integrals. One file a top.

``TOPS`` lists every form of every top. A kind has several forms where its state can be written in several ways; the
first of them is the kind's own, and the vectors of the initial state tell which is meant.
"""

from __future__ import annotations

from collections.abc import Collection

from topcli.contracts import Top
from topcli.errors import UnknownNameError, nearest, quoted
from topcli.tops.euler import Euler, EulerGamma
from topcli.tops.heavy import Heavy
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange, LagrangeInertial

TOPS: dict[str, type[Top]] = {
    top.form: top for top in (Kowalevski, Euler, EulerGamma, Lagrange, LagrangeInertial, Heavy)
}


def top_names() -> list[str]:
    """Names of the tops, wherever one is named: each kind, and each form that differs from its kind."""
    return list(dict.fromkeys(name for top in TOPS.values() for name in (top.kind, top.form)))


def forms(name: str) -> list[type[Top]]:
    """Forms of the top called ``name``, matched without case: all those of a kind, its own first, or one form.

    Raises UnknownNameError with the nearest names.
    """
    wanted = name.lower()
    found = [top for top in TOPS.values() if top.kind == wanted]
    if not found and wanted in TOPS:
        return [TOPS[wanted]]
    if not found:
        raise UnknownNameError(f"unknown top {quoted(name)}; {nearest(name, top_names())}")
    return found


def top_class(name: str, vectors: Collection[str] = ()) -> type[Top]:
    """The form of the top called ``name`` whose initial state has the ``vectors``; its own form when none fits.

    Raises UnknownNameError with the nearest names.
    """
    found = forms(name)
    return next((top for top in found if set(top.vectors) == set(vectors)), found[0])
