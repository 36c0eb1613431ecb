"""Motion of any top from a state, as far as its closed form is known."""

from __future__ import annotations

from topcli.analysis.motion.euler import free_motion_of
from topcli.analysis.motion.result import Motion, integrals_of
from topcli.contracts import Floats, Top
from topcli.errors import UsageError
from topcli.tops.euler import Euler
from topcli.tops.heavy import Heavy
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange, LagrangeInertial

LARGEST = 1e70
"""Largest number of a state or a top; the fourth power of larger ones overflows."""


def motion_of(top: Top, y0: Floats) -> Motion:
    """Motion of ``top`` from the state ``y0`` (d,); of a top without a closed form only its integrals.

    Raises UsageError if the integrals overflow.
    """
    y = tuple(float(v) for v in y0)
    if max(map(abs, (*y, *top.constants()))) > LARGEST:
        raise UsageError(f"motion: the state or the parameters are too large: more than {LARGEST:g} in magnitude")
    top = closed_form_top(top)
    if isinstance(top, Kowalevski):
        from topcli.analysis.motion.kowalevski import kowalevski_motion

        return kowalevski_motion(top, y)
    if isinstance(top, Lagrange | LagrangeInertial):
        from topcli.analysis.motion.lagrange import lagrange_motion

        return lagrange_motion(top, y)
    if isinstance(top, Euler):
        return free_motion_of(top.form, (top.A, top.B, top.C), y, integrals_of(top, y))
    title = "no closed form is known for a top with these parameters"
    return Motion(top.form, "no closed form", title, y, integrals_of(top, y))


def closed_form_top(top: Top) -> Top:
    """Return ``top``; in place of a heavy top the Euler, Lagrange or Kowalevski top with its parameters, if any."""
    from topcli.tops.euler import EulerGamma

    if not isinstance(top, Heavy):
        return top
    A, B, C = top.A, top.B, top.C
    if top.x0 == top.y0 == top.z0 == 0.0:
        return EulerGamma(A=A, B=B, C=C)
    if A == B and top.x0 == top.y0 == 0.0:
        return Lagrange(A=A, C=C, mu=top.z0)
    if A == B == 2.0 * C and top.y0 == top.z0 == 0.0:
        return Kowalevski(A=A, c0=top.x0)
    return top
