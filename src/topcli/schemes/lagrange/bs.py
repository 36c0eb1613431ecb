"""The scheme of Bobenko and Suris for the Lagrange top, in the inertial frame.

One Cayley rotation in closed form, one division, each product that another waits for fused with the sum after it; every
component is old + increment.
"""

from __future__ import annotations

import numpy as np

from topcli.arithmetic.fused import fma
from topcli.arithmetic.rotations import cayley_added
from topcli.contracts import Array, Floats, Invariant, NoOptions, Stepper, Top
from topcli.schemes.registry import scheme


def bs_step(state: Floats, h: float, p: Floats) -> Floats:
    """m' - m = h p x a, then a' - a = h/2 m' x (a' + a): Sogo's (L1), (L2)."""
    m1, m2, m3, a1, a2, a3 = state
    d = -0.5 * h
    n1 = fma(-h, a2, m1)
    n2 = fma(h, a1, m2)
    # d n1 as fma(-h d, a2, d m1) would be ready sooner, but h d is rounded, and m.a would drift
    b1, b2, b3 = cayley_added(d * n1, d * n2, d * m3, a1, a2, a3)
    return (n1, n2, m3, b1, b2, b3)


def bs_modified(top: Top, h: float, options: NoOptions) -> tuple[Invariant, ...]:
    """The energy m²/2 + a·p + h/2 (a x m)·p, which the BS map conserves (Sogo, section 2.3, law 4)."""
    plain = top.invariants()[3]

    def value(y: Array) -> Array:
        return plain.value(y) + 0.5 * h * (y[:, 3] * y[:, 1] - y[:, 4] * y[:, 0])

    def scale(y: Array) -> Array:
        return plain.scale(y) + np.abs(0.5 * h) * (np.abs(y[:, 3] * y[:, 1]) + np.abs(y[:, 4] * y[:, 0]))

    meaning = "energy with the term h/2 (a×m)·p, as the BS map conserves it"
    return (Invariant("modified_energy", "E mod", r"\widetilde{E}", meaning, value, scale),)


@scheme(
    "bs",
    top="lagrange/inertial",
    title="Bobenko-Suris scheme",
    order=1,
    explicit=True,
    self_adjoint=False,
    conserves=("a_sq", "m_p", "m_a"),
    modified=bs_modified,
    citation="Bobenko, Suris 1999; Sogo, Discrete Spinning Tops, section 2.3",
    equations="L1, L2",
)
def build_bs(top: Top, options: NoOptions) -> Stepper:
    """Two explicit steps: m by the old axis, then the axis turned by Cayley's rotation about the new m.

    a², m·p and m·a are conserved exactly, and so is an energy with a term of size h. The map is integrable; it is
    of order 1 and not self-adjoint, and yet no quantity drifts.
    """
    return Stepper(bs_step, 6)
