"""Tops: parameters, equations of motion, integrals; one module per top.

``TOPS`` maps the name of each form of a top to its class. A kind has several forms if its state can be written in
several ways. The first form is the default; the vectors of the initial state select the form.
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
    """Return the names of the tops: each kind, and each form that differs from its kind."""
    return list(dict.fromkeys(name for top in TOPS.values() for name in (top.kind, top.form)))


def forms(name: str) -> list[type[Top]]:
    """Return the forms of the top called ``name`` (case-insensitive): all those of a kind, its default first, or one.

    Raises UnknownNameError, with the nearest names, for an unknown kind.
    """
    wanted = name.lower()
    found = [top for top in TOPS.values() if top.kind == wanted]
    if not found and wanted in TOPS:
        return [TOPS[wanted]]
    if not found:
        raise UnknownNameError(f"unknown top {quoted(name)}; {nearest(name, top_names())}")
    return found


def top_class(name: str, vectors: Collection[str] = ()) -> type[Top]:
    """Return the form of the top called ``name`` whose initial state has the ``vectors``, else the default form.

    Raises UnknownNameError, with the nearest names, for an unknown kind.
    """
    found = forms(name)
    return next((top for top in found if set(top.vectors) == set(vectors)), found[0])
