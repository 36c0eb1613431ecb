"""Carried quantities of the Kowalevski top: xi = k u with |u| = 1, and the squared length of gamma.

If xi is recomputed from omega and gamma in every step, its rounding errors accumulate, as do those of the length of
gamma. As carried quantities, k and gamma² are constants, and u and gamma are renormalized in every step by a change of
the size of one rounding error. Nothing accumulates, no growing angle is needed, and libm is not called.
"""

from __future__ import annotations

import math

from topcli.contracts import Floats
from topcli.schemes.kowalevski.four_integrals import xi_of


def length_correction(now: float, wanted: float) -> float:
    """Relative correction of a vector of squared length ``now`` to the close value ``wanted``; 0 if that is 0."""
    return 0.5 * ((wanted - now) / wanted) if wanted > 0.0 else 0.0


def enter_carried(y: Floats, h: float, p: Floats) -> Floats:
    """Physical state, u, k and gamma². For xi = 0, Delone's motion, u is arbitrary."""
    x1, x2 = xi_of(y[0], y[1], y[3], y[4], p[0])
    k = math.hypot(x1, x2)
    u1, u2 = (x1 / k, x2 / k) if k > 0.0 else (1.0, 0.0)
    g_sq = y[3] * y[3] + (y[4] * y[4] + y[5] * y[5])
    return (y[0], y[1], y[2], y[3], y[4], y[5], u1, u2, k, g_sq)
