"""Bobenko-Suris step of the Lagrange top in the inertial frame (Sogo, section 2.3)."""

from __future__ import annotations

from typing import Any

from topcli.arithmetic.fused import fma
from topcli.arithmetic.vectors import cayley_rotated
from topcli.contracts import Floats, Invariant, NoOptions, Stepper, Top, invariant_of
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


def bs_integrals(top: Top, h: float, options: NoOptions) -> tuple[Invariant, ...]:
    """Modified energy m²/2 + a·p + h/2 (a x m)·p, conserved by the BS map (Sogo, section 2.3, law 4)."""

    def modified_energy(y: Floats, p: Floats) -> Any:
        """energy plus h/2 (a×m)·p, which the BS map conserves."""
        m1, m2, m3, a1, a2, a3 = y
        return 0.5 * (m1**2 + m2**2 + m3**2) + a3 + 0.5 * h * (a1 * m2 - a2 * m1)

    return (invariant_of("modified_energy", modified_energy, (), ("E mod", r"\widetilde{E}")),)


@scheme(
    "bs",
    top="lagrange/inertial",
    order=1,
    explicit=True,
    self_adjoint=False,
    conserves=("a_sq", "m_p", "m_a"),
    modified=bs_integrals,
)
def build_bs(top: Top, options: NoOptions) -> Stepper:
    r"""Bobenko-Suris scheme.

    The new m is m + h p x a. A Cayley transform then rotates the axis a of the top about the new m.

    The scheme conserves a², m·p, m·a and a modified energy exactly; the modified energy differs from E by a term of
    size h. The map is integrable. Although the scheme has order 1 and is not self-adjoint, no integral drifts.

    Source
    ------
    Bobenko, Suris 1999; Sogo, Discrete Spinning Tops, section 2.3

    Equations
    ---------
    (L1) and (L2) of the paper

    Formula
    -------
    m' - m = h\,p\times a, \qquad a' - a = h\,m'\times\bar a
    """
    return Stepper(bs_step, 6)
