"""Claims of section 1.2: the discrete Euler top in the HK and BS schemes and under the midpoint rule."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import partial
from typing import Any

from topcli.paper import printed
from topcli.paper.algebra import Draws, cross, dot, minus, plus, times, weighted
from topcli.paper.claim import Claim
from topcli.paper.kinds.conservation import (
    BROKEN,
    CONSERVED,
    DEVIATION_ORDER,
    IRREVERSIBLE,
    REVERSIBLE,
    broken,
    conserved,
    deviation_order,
    irreversible,
    reversible,
)
from topcli.paper.kinds.identity import (
    IDENTITY,
    LINEAR,
    NOT_LINEAR,
    identity,
    linear_in_new,
    midpoint_residual,
    not_linear_in_new,
    rotation_residual,
)
from topcli.paper.kinds.maps import SAME_MAP, satisfies
from topcli.paper.scenes import AND_VARIED, FIFTY, RATIONAL, Scene

HK = Scene("euler_hk", (*RATIONAL, "N=20"))
BS = Scene("euler_bs", (*RATIONAL, "N=6"))
BS_IMPLICIT = Scene("euler_bs_implicit", (*FIFTY, "N=50"))
MIDPOINT = Scene("euler_midpoint", (*FIFTY, "N=50"))


def hk_residual(new: tuple[Any, ...], draws: Draws) -> Sequence[Any]:
    """The HK scheme as an equation for the new omega."""
    return printed.hk_euler(draws.moments(), draws.number(), draws.vector(), (new[0], new[1], new[2]))


def hk_step(value: Callable[[str], Fraction], h: Fraction, old: tuple[Any, ...], new: tuple[Any, ...]) -> Sequence[Any]:
    """Residual of the printed HK scheme."""
    moments = (value("A"), value("B"), value("C"))
    return printed.hk_euler(moments, h, (old[0], old[1], old[2]), (new[0], new[1], new[2]))


def special_case(draws: Draws) -> Sequence[Any]:
    """The equations of the Euler top against (Euler) with g = 0."""
    moments, w, c = draws.moments(), draws.vector(), draws.vector()
    return minus(printed.euler_top(moments, w), printed.euler(moments, (0, 0, 0), w, c))


def hk_consistent(draws: Draws) -> Sequence[Any]:
    """The HK scheme as both states coincide, divided by h, against the equations of the Euler top."""
    moments, h, w = draws.moments(), draws.number(), draws.vector()
    rates = tuple(a / b for a, b in zip(printed.euler_top(moments, w), moments, strict=True))
    return plus(times(1 / h, printed.hk_euler(moments, h, w, w)), rates)


def hk_symmetry(draws: Draws) -> Sequence[Any]:
    """The HK scheme with h -> -h and both states exchanged, plus the scheme itself."""
    moments, h, w, v = draws.moments(), draws.number(), draws.vector(), draws.vector()
    return plus(printed.hk_euler(moments, h, w, v), printed.hk_euler(moments, -h, v, w))


def hk_vector(draws: Draws) -> Sequence[Any]:
    """The vector form of the HK scheme against the moments times its components."""
    moments, h, w, v = draws.moments(), draws.number(), draws.vector(), draws.vector()
    left = printed.hk_euler_vector(h, weighted(moments, w), weighted(moments, v), w, v)
    return minus(left, weighted(moments, printed.hk_euler(moments, h, w, v)))


def hk_chain(draws: Draws) -> Sequence[Any]:
    """Neighbouring lines of the computation of m'² - m²."""
    h, m, n, w, v = draws.number(), draws.vector(), draws.vector(), draws.vector(), draws.vector()
    lines = (
        dot(plus(n, m), times(h / 2, plus(cross(n, w), cross(m, v)))),
        h / 2 * (dot(m, cross(n, w)) + dot(n, cross(m, v))),
        h / 2 * dot(minus(w, v), cross(m, n)),
    )
    return [lines[0] - lines[1], lines[1] - lines[2]]


def bs_implicit_residual(new: tuple[Any, ...], draws: Draws) -> Sequence[Any]:
    """(EulerBS) with the new omega, as an equation for the new m."""
    m, moments, h = draws.vector(), draws.moments(), draws.number()
    w = tuple(a / b for a, b in zip(new, moments, strict=True))
    return printed.bs(h, m, (new[0], new[1], new[2]), (w[0], w[1], w[2]))


def midpoint_energy(draws: Draws) -> Sequence[Any]:
    """The identity m'·omega = m·omega', and (omega' + omega)·(m' - m) against m'·omega' - m·omega."""
    moments, w, v = draws.moments(), draws.vector(), draws.vector()
    m, n = weighted(moments, w), weighted(moments, v)
    return [dot(n, w) - dot(m, v), dot(plus(v, w), minus(n, m)) - (dot(n, v) - dot(m, w))]


SECTION = "section 1.2"
CLAIMS = (
    Claim(
        "euler-equations",
        "The equations of the Euler top are (Euler) with g = 0.",
        f"{SECTION}, first equation",
        IDENTITY,
        "rational identity",
        partial(identity, special_case),
    ),
    Claim(
        "hk-euler-equation",
        "The HK scheme discretises the equations of the Euler top.",
        f"{SECTION}, HK scheme",
        IDENTITY,
        "rational identity: both states equal",
        partial(identity, hk_consistent),
    ),
    Claim(
        "hk-euler-explicit",
        "The HK scheme of the Euler top is explicit.",
        f"{SECTION}, HK scheme",
        LINEAR,
        "rational test of the printed equations",
        partial(linear_in_new, hk_residual, 3),
    ),
    Claim(
        "hk-euler-solved",
        "The HK equations of the Euler top determine the new ω.",
        f"{SECTION}, HK scheme",
        SAME_MAP,
        f"{Scene('euler_hk', RATIONAL).code}, put into the printed equations{AND_VARIED}",
        partial(satisfies, Scene("euler_hk", RATIONAL), hk_step),
    ),
    Claim(
        "hk-euler-reversible",
        "The HK scheme of the Euler top has time reversal symmetry.",
        f"{SECTION}, after the HK scheme",
        REVERSIBLE,
        HK.code + AND_VARIED,
        partial(reversible, HK),
    ),
    Claim(
        "hk-euler-exchange",
        "In the HK scheme h → -h corresponds to exchanging n and n+1.",
        f"{SECTION}, after the HK scheme",
        IDENTITY,
        "rational identity between the printed equations",
        partial(identity, hk_symmetry),
    ),
    Claim(
        "hk-euler-vector",
        "The vector form of the HK scheme is its component form.",
        f"{SECTION}, HK scheme in vector form",
        IDENTITY,
        "rational identity",
        partial(identity, hk_vector),
    ),
    Claim(
        "hk-euler-chain",
        "Under HK m² changes by (h/2)(ω - ω')·(m × m') in a step.",
        f"{SECTION}, chain of equations for m²",
        IDENTITY,
        "rational identity between neighbouring lines",
        partial(identity, hk_chain),
    ),
    Claim(
        "hk-euler-m-sq",
        "The HK scheme breaks m² = const.",
        f"{SECTION}, after the chain",
        BROKEN,
        HK.code,
        partial(broken, HK, "m_sq"),
    ),
    Claim(
        "hk-euler-energy",
        "The HK scheme breaks m·ω = const.",
        f"{SECTION}, after the chain",
        BROKEN,
        HK.code,
        partial(broken, HK, "m_omega"),
    ),
    Claim(
        "hk-euler-correction-order",
        "Under HK an O(h) correction of m² is necessary (read as: of order h).",
        f"{SECTION}, after the chain",
        DEVIATION_ORDER,
        "`topcli run euler_hk` at h = 0.02, 0.01, 0.005",
        partial(deviation_order, Scene("euler_hk"), "m_sq", 1),
    ),
    Claim(
        "hk-euler-corrected-m-sq",
        "HK conserves a corrected m² (Hirota, Kimura).",
        f"{SECTION}, after the chain",
        CONSERVED,
        f"{HK.code} (m²/K){AND_VARIED}",
        partial(conserved, HK, "modified_m_sq"),
    ),
    Claim(
        "hk-euler-corrected-energy",
        "HK conserves a corrected m·ω (Hirota, Kimura).",
        f"{SECTION}, after the chain",
        CONSERVED,
        f"{HK.code} (m·ω/K){AND_VARIED}",
        partial(conserved, HK, "modified_m_omega"),
    ),
    Claim(
        "bs-euler-m-sq",
        "The BS scheme conserves m² exactly.",
        f"{SECTION}, (EulerBS)",
        CONSERVED,
        BS.code + AND_VARIED,
        partial(conserved, BS, "m_sq"),
    ),
    Claim(
        "bs-euler-new-m-sq",
        "The BS scheme with the new ω conserves m² exactly.",
        f"{SECTION}, after (EulerBS)",
        CONSERVED,
        BS_IMPLICIT.code + AND_VARIED,
        partial(conserved, BS_IMPLICIT, "m_sq"),
    ),
    Claim(
        "bs-euler-explicit",
        "The BS scheme with the old ω is explicit.",
        f"{SECTION}, (EulerBS)",
        LINEAR,
        "rational test of the printed equation",
        partial(linear_in_new, rotation_residual, 3),
    ),
    Claim(
        "bs-euler-new-implicit",
        "The BS scheme with the new ω is implicit.",
        f"{SECTION}, after (EulerBS)",
        NOT_LINEAR,
        "rational test of the printed equation",
        partial(not_linear_in_new, bs_implicit_residual, 3),
    ),
    Claim(
        "bs-euler-irreversible",
        "The BS scheme breaks time reversal symmetry.",
        f"{SECTION}, after (EulerBS)",
        IRREVERSIBLE,
        BS.code,
        partial(irreversible, BS),
    ),
    Claim(
        "midpoint-m-sq",
        "The midpoint scheme conserves m² exactly.",
        f"{SECTION}, last scheme",
        CONSERVED,
        MIDPOINT.code + AND_VARIED,
        partial(conserved, MIDPOINT, "m_sq"),
    ),
    Claim(
        "midpoint-energy",
        "The midpoint scheme conserves m·ω exactly.",
        f"{SECTION}, last scheme",
        CONSERVED,
        MIDPOINT.code + AND_VARIED,
        partial(conserved, MIDPOINT, "m_omega"),
    ),
    Claim(
        "midpoint-proof",
        "m'·ω = m·ω', so (ω' + ω)·(m' - m) = 0 gives m'·ω' = m·ω.",
        f"{SECTION}, last equation",
        IDENTITY,
        "rational identity",
        partial(identity, midpoint_energy),
    ),
    Claim(
        "midpoint-reversible",
        "The midpoint scheme has time reversal symmetry.",
        f"{SECTION}, last sentence",
        REVERSIBLE,
        MIDPOINT.code + AND_VARIED,
        partial(reversible, MIDPOINT),
    ),
    Claim(
        "midpoint-implicit",
        "The midpoint scheme is not explicit.",
        f"{SECTION}, last sentence",
        NOT_LINEAR,
        "rational test of the printed equation",
        partial(not_linear_in_new, midpoint_residual, 3),
    ),
)
