"""Claims of section 2.3: the Bobenko-Suris scheme of the Lagrange top."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import partial
from typing import Any

from topcli.paper import printed
from topcli.paper.algebra import Draws, cross, dot
from topcli.paper.claim import Claim
from topcli.paper.kinds.conservation import (
    CONSERVED,
    DEVIATION_ORDER,
    conserved,
    deviation_order,
)
from topcli.paper.kinds.identity import IDENTITY, LINEAR, identity, linear_in_new
from topcli.paper.kinds.maps import SAME_MAP, satisfies
from topcli.paper.kinds.motion import CONVERGENCE, convergence_order
from topcli.paper.kinds.rank import ELLIPTIC, elliptic
from topcli.paper.scenes import AND_VARIED, RATIONAL, Scene

BS = Scene("lagrange_bs", (*RATIONAL, "N=8"))
SOURCE = "section 2.3, conservation laws"


def step(value: Callable[[str], Fraction], h: Fraction, old: tuple[Any, ...], new: tuple[Any, ...]) -> Sequence[Any]:
    """Residual of (L1) and (L2), which have no parameters."""
    m, a, n, b = ((v[0], v[1], v[2]) for v in (old[:3], old[3:], new[:3], new[3:]))
    return [*printed.lagrange_l1(h, m, n, a), *printed.lagrange_l2(h, n, a, b)]


def first_residual(new: tuple[Any, ...], draws: Draws) -> Sequence[Any]:
    """(L1) as an equation for the new m, and (L2) for the new a at a given new m."""
    n, b = (new[0], new[1], new[2]), (new[3], new[4], new[5])
    h, m, a, known = draws.number(), draws.vector(), draws.vector(), draws.vector()
    return [*printed.lagrange_l1(h, m, n, a), *printed.lagrange_l2(h, known, a, b)]


def _law(name: str, statement: str, number: int, invariant: str) -> Claim:
    return Claim(
        f"bs-lagrange-{name}",
        statement,
        f"{SOURCE} {number}",
        CONSERVED,
        BS.code + AND_VARIED,
        partial(conserved, BS, invariant),
    )


def continuous_elliptic(draws: Draws) -> Sequence[Any]:
    """u = a·p: (du/dt)² against a cubic of u with the integrals as coefficients, along m' = p x a, a' = m x a."""
    m, a = draws.vector(), draws.unit()
    u, about, vertical = a[2], dot(m, a), m[2]
    energy = dot(m, m) / 2 + u
    rate = cross(m, a)[2]
    return [rate * rate - (2 * (energy - u) * (1 - u * u) + 2 * vertical * about * u - vertical**2 - about**2)]


CLAIMS = (
    Claim(
        "bs-lagrange-explicit",
        "(L1), (L2) are an explicit solver in two steps.",
        "section 2.3, after (L2)",
        LINEAR,
        "rational test: m' from (L1), then a' from (L2) with this m'",
        partial(linear_in_new, first_residual, 6),
    ),
    Claim(
        "bs-lagrange-solved",
        "(L1), (L2) determine the new m and a.",
        "section 2.3, (L1), (L2)",
        SAME_MAP,
        f"{Scene('lagrange_bs', RATIONAL).code}, put into the printed equations{AND_VARIED}",
        partial(satisfies, Scene("lagrange_bs", RATIONAL), step),
    ),
    Claim(
        "bs-lagrange-motion",
        "(L1), (L2) discretise the Lagrange top.",
        "section 2.3, (L1), (L2)",
        CONVERGENCE,
        "`topcli run lagrange_bs` at h = 0.02, 0.01, 0.005, against the reference",
        partial(convergence_order, Scene("lagrange_bs"), 1),
        slow=True,
    ),
    _law("a-sq", "(L1), (L2) conserve a².", 1, "a_sq"),
    _law("m-p", "(L1), (L2) conserve m·p.", 2, "m_p"),
    _law("m-a", "(L1), (L2) conserve m·a.", 3, "m_a"),
    _law("energy", "(L1), (L2) conserve E with the term (h/2)(a × m)·p.", 4, "modified_energy"),
    Claim(
        "lagrange-elliptic",
        "The continuous Lagrange top has exact solutions by elliptic functions.",
        "section 2.3, first and last paragraph",
        IDENTITY,
        "rational identity: (du/dt)² is a cubic of u = a·p, whose coefficients are integrals",
        partial(identity, continuous_elliptic),
    ),
    Claim(
        "bs-lagrange-elliptic",
        "The discrete Lagrange top has exact solutions by elliptic functions.",
        "section 2.3, first and last paragraph",
        ELLIPTIC,
        f"{BS.with_sets('N=9').code}: a·p of successive states{AND_VARIED}",
        partial(elliptic, BS.with_sets("N=9"), 5),
    ),
    Claim(
        "bs-lagrange-energy-term",
        "The correction of E is of O(h).",
        "section 2.3, after the conservation laws",
        DEVIATION_ORDER,
        "`topcli run lagrange_bs` at h = 0.02, 0.01, 0.005",
        partial(deviation_order, Scene("lagrange_bs"), "energy", 1),
    ),
)
