"""Tops: parameters, equations of motion, integrals; one module per top.

``TOPS`` maps the name of each form of a top to its class. A kind has several forms if its state can be written in
several ways. The first form is the default; the vectors of the initial state select the form.
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
    """Return the names of tops that a config may use."""
    return list(dict.fromkeys(top.kind for top in TOPS.values()))


def forms(kind: str) -> list[type[Top]]:
    """Return the forms of the top called ``kind`` (case-insensitive), the default form first.

    Raises UnknownNameError, with the nearest names, for an unknown kind.
    """
    found = [top for top in TOPS.values() if top.kind == kind.lower()]
    if not found:
        raise UnknownNameError(f"unknown top {kind!r}; {nearest(kind, kinds())}")
    return found


def top_class(kind: str, vectors: Collection[str] = ()) -> type[Top]:
    """Return the form of the top called ``kind`` whose initial state has the ``vectors``, else the default form.

    Raises UnknownNameError, with the nearest names, for an unknown kind.
    """
    found = forms(kind)
    return next((top for top in found if set(top.vectors) == set(vectors)), found[0])
