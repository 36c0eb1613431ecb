"""Bobenko-Suris step of the Lagrange top in the inertial frame.

The step needs one Cayley rotation in closed form and one division; products on the critical path are fused with the
following sum, and every component is old + increment.
"""

from __future__ import annotations

import numpy as np

from topcli.arithmetic.fused import fma
from topcli.arithmetic.rotations import cayley_rotated
from topcli.contracts import Array, Floats, Integrability, Invariant, NoOptions, Stepper, Top
from topcli.schemes.registry import scheme


def bs_step(state: Floats, h: float, p: Floats) -> Floats:
    """Step m' - m = h p x a, then a' - a = h/2 m' x (a' + a): Sogo's (L1), (L2)."""
    m1, m2, m3, a1, a2, a3 = state
    d = -0.5 * h
    n1 = fma(-h, a2, m1)
    n2 = fma(h, a1, m2)
    # fma(-h d, a2, d m1) in place of d n1 would shorten the critical path, but h d is rounded, and m.a would drift
    b1, b2, b3 = cayley_rotated(d * n1, d * n2, d * m3, a1, a2, a3)
    return (n1, n2, m3, b1, b2, b3)


def bs_modified(top: Top, h: float, options: NoOptions) -> tuple[Invariant, ...]:
    """Modified energy m²/2 + a·p + h/2 (a x m)·p, conserved by the BS map (Sogo, section 2.3, law 4)."""
    plain = top.invariants()[3]

    def value(y: Array) -> Array:
        return plain.value(y) + 0.5 * h * (y[:, 3] * y[:, 1] - y[:, 4] * y[:, 0])

    def scale(y: Array) -> Array:
        return plain.scale(y) + np.abs(0.5 * h) * (np.abs(y[:, 3] * y[:, 1]) + np.abs(y[:, 4] * y[:, 0]))

    meaning = "energy plus h/2 (a×m)·p, conserved by the BS map"
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
    formula=r"m' - m = h\,p\times a, \qquad a' - a = h\,m'\times\bar a",
    equations="L1, L2",
    integrable=Integrability("yes (Bobenko, Suris 1999)", "Lie-Poisson bracket of e(3)", "lie-poisson"),
)
def build_bs(top: Top, options: NoOptions) -> Stepper:
    """Two explicit substeps: m from the old axis, then a Cayley rotation of the axis about the new m.

    a², m·p, m·a and a modified energy, which differs from E by a term of size h, are conserved exactly. The map is
    integrable: although it is of order 1 and not self-adjoint, no integral drifts.
    """
    return Stepper(bs_step, 6)
