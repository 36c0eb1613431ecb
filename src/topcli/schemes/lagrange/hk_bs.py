"""Hirota-Kimura (Kahan) step of the Lagrange top and its integrals, and Bobenko-Suris step in the inertial frame.

The Bobenko-Suris step needs one Cayley rotation in closed form and one division; products on the critical path are
fused with the following sum, and every component is old + increment.
"""

from __future__ import annotations

import numpy as np

from topcli.arithmetic.fused import fma
from topcli.arithmetic.vectors import cayley_rotated
from topcli.contracts import UNKNOWN, Array, Floats, Integrability, Invariant, NoOptions, Stepper, Top
from topcli.schemes.any_top.kahan import kahan_stepper
from topcli.schemes.layout import (
    HIROTA_KIMURA,
    LONG_HK,
    SINGULAR,
    CompensatedOption,
)
from topcli.schemes.registry import scheme
from topcli.tops.lagrange import Lagrange, hk_corrections


def hk_modified(top: Lagrange, h: float, options: CompensatedOption) -> tuple[Invariant, ...]:
    """gamma², m·gamma and E with the corrections of the HK map, which conserves them exactly for this h."""

    alpha, nu = top.constants()

    def corrections(y: Array) -> tuple[Array, Array, Array]:
        return hk_corrections(top.A, nu, alpha * y[:, 2], h, y.T)

    def made(index: int, plain: Invariant) -> Invariant:
        return Invariant(
            f"modified_{plain.name}",
            f"{plain.symbol} mod",
            rf"\widetilde{{{plain.tex}}}",
            f"{plain.meaning}, modified so that the HK map conserves it",
            lambda y: plain.value(y) + corrections(y)[index],
            lambda y: plain.scale(y) + np.abs(corrections(y)[index]),
        )

    return tuple(made(index, plain) for index, plain in enumerate(top.invariants()[:3]))


@scheme(
    "hk",
    top="lagrange",
    title="Hirota-Kimura scheme",
    order=2,
    explicit=True,
    self_adjoint=True,
    conserves=("m_axis",),
    modified=hk_modified,
    citation="Kahan 1993; Kimura, Hirota 2000; Petrera, Pfadler, Suris 2011 (integrability); "
    "Sogo, Discrete Spinning Tops, sections 2.1 and 2.2",
    integrable=Integrability(UNKNOWN, UNKNOWN),
    formula=HIROTA_KIMURA,
    equations="(dEulerPoisson) of the paper, with the last line corrected so that it ends with gamma_2^n omega_1^{n+1}",
    options=CompensatedOption,
    limits={"singular-step": SINGULAR, "resonance": LONG_HK},
)
def build_hk(top: Top, options: CompensatedOption) -> Stepper:
    """Kahan's method for quadratic equations of motion: each step solves one linear system, in closed form.

    HK conserves omega3 without any rounding error. HK conserves none of gamma², m·gamma and E, but each of them differs
    by O(h²) from a modified integral that HK conserves exactly for every h. The map is integrable.
    """
    return kahan_stepper(top, options)


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

    meaning = "energy plus h/2 (a×m)·p, which the BS map conserves"
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
    equations="(L1) and (L2) of the paper",
    integrable=Integrability("yes (Bobenko, Suris 1999)", "Lie-Poisson bracket of e(3)", "lie-poisson"),
)
def build_bs(top: Top, options: NoOptions) -> Stepper:
    """The new m is m + h p x a. A Cayley transform then rotates the axis a of the top about the new m.

    The scheme conserves a², m·p, m·a and a modified energy exactly; the modified energy differs from E by a term of
    size h. The map is integrable. Although the scheme has order 1 and is not self-adjoint, no integral drifts.
    """
    return Stepper(bs_step, 6)
