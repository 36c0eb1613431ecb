"""Claims of sections 2.1 and 2.2: the HK scheme of the general top and of its integrable cases."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import partial
from typing import Any

from topcli.paper import printed
from topcli.paper.algebra import Draws, minus
from topcli.paper.claim import Claim
from topcli.paper.kinds.conservation import BROKEN, CONSERVED, REVERSIBLE, broken, conserved, reversible
from topcli.paper.kinds.identity import IDENTITY, LINEAR, identity, linear_in_new
from topcli.paper.kinds.integrability import GENERIC
from topcli.paper.kinds.maps import SAME_MAP, same_map, satisfies
from topcli.paper.kinds.motion import SMALL, small
from topcli.paper.scenes import AND_VARIED, RATIONAL, ExactMap, Scene

HEAVY = Scene("heavy_hk", (*RATIONAL, "N=3"))
LAGRANGE = Scene("lagrange_hk", (*RATIONAL, "N=10"))
KOWALEVSKI = Scene("kowalevski_hk", (*RATIONAL, *GENERIC))
Parameters = Callable[[Callable[[str], Any]], tuple[Any, ...]]
"""A, B, C, x0, y0, z0 of the general top that is the special top with the given parameters."""


def _general(parameters: Parameters, found: ExactMap) -> Scene:
    """The general top with the parameters of a special one; both start from the same state."""
    names = ("A", "B", "C", "x0", "y0", "z0")
    values = parameters(found.parameter)
    return Scene("heavy_hk", (*RATIONAL, *(f"top.{name}={x}" for name, x in zip(names, values, strict=True))))


def consistent(corrected: bool) -> Any:
    """Difference of (dEulerPoisson) from the continuous equations as both states coincide, divided by h."""

    def difference(draws: Draws) -> Sequence[Any]:
        moments, g, w, c, h = draws.moments(), draws.vector(), draws.vector(), draws.vector(), draws.number()
        state = (*w, *c)
        discrete = [-x / h for x in printed.hk_heavy(moments, g, h, state, state, corrected)]
        rates = [a / b for a, b in zip(printed.euler(moments, g, w, c), moments, strict=True)]
        return minus(discrete, [*rates, *printed.poisson(w, c)])

    return difference


def residual(new: tuple[Any, ...], draws: Draws) -> Sequence[Any]:
    """Corrected (dEulerPoisson) as an equation for the new state."""
    moments, g, h = draws.moments(), draws.vector(), draws.number()
    old = (*draws.vector(), *draws.vector())
    return printed.hk_heavy(moments, g, h, old, new, corrected=True)


def step(value: Callable[[str], Fraction], h: Fraction, old: tuple[Any, ...], new: tuple[Any, ...]) -> Sequence[Any]:
    """Residual of the corrected (dEulerPoisson) with the parameters of the scene."""
    moments, gravity = (value("A"), value("B"), value("C")), (value("x0"), value("y0"), value("z0"))
    return printed.hk_heavy(moments, gravity, h, old, new, corrected=True)


def _broken(name: str, symbol: str) -> Claim:
    return Claim(
        f"hk-heavy-{name.replace('_', '-')}",
        f"HK of the general top breaks {symbol} = const.",
        "section 2.1, after (dEulerPoisson)",
        BROKEN,
        HEAVY.code,
        partial(broken, HEAVY, name),
    )


def _special(name: str, title: str, source: str, special: Scene, parameters: Parameters) -> Claim:
    return Claim(
        f"hk-is-{name}",
        f"With special parameters HK of the general top is HK of the {title}.",
        source,
        SAME_MAP,
        f"{special.code} against heavy_hk with these parameters{AND_VARIED}",
        partial(same_map, special, partial(_general, parameters)),
    )


CLAIMS = (
    Claim(
        "hk-heavy-equation",
        "(dEulerPoisson) discretises the Euler-Poisson equations.",
        "section 2.1, (dEulerPoisson), last line",
        IDENTITY,
        "rational identity: both states equal; the corrected last term is γ₂ω₁' instead of γ₁ω₂'",
        partial(identity, consistent(False), consistent(True)),
    ),
    Claim(
        "hk-heavy-explicit",
        "HK of the general top is solved by linear algebra.",
        "section 2.1, after (dEulerPoisson)",
        LINEAR,
        "rational test of the equations, last line corrected",
        partial(linear_in_new, residual, 6),
    ),
    Claim(
        "hk-heavy-solved",
        "The HK equations of the general top determine the new ω and γ.",
        "section 2.1, after (dEulerPoisson)",
        SAME_MAP,
        f"{Scene('heavy_hk', RATIONAL).code}, put into the corrected equations{AND_VARIED}",
        partial(satisfies, Scene("heavy_hk", RATIONAL), step),
    ),
    Claim(
        "hk-heavy-reversible",
        "HK of the general top has time reversal symmetry.",
        "section 2.1, after (dEulerPoisson)",
        REVERSIBLE,
        HEAVY.code + AND_VARIED,
        partial(reversible, HEAVY),
    ),
    _broken("gamma_sq", "γ²"),
    _broken("m_gamma", "m·γ"),
    _broken("energy", "E"),
    Claim(
        "hk-heavy-small",
        "HK violates the laws of the general top very little.",
        "section 2.1, last sentence; section 4, first paragraph",
        SMALL,
        "`topcli run heavy_hk`",
        partial(small, Scene("heavy_hk"), ("gamma_sq", "m_gamma", "energy")),
    ),
    _special(
        "euler",
        "Euler top",
        "sections 1.2, 2.1, 4",
        Scene("euler_gamma_hk", (*RATIONAL, *GENERIC)),
        lambda value: (value("A"), value("B"), value("C"), 0, 0, 0),
    ),
    _special(
        "lagrange",
        "Lagrange top",
        "section 2.2",
        Scene("lagrange_hk", (*RATIONAL, *GENERIC)),
        lambda value: (value("A"), value("A"), value("C"), 0, 0, value("mu")),
    ),
    _special("kowalevski", "Kowalevski top", "section 2.2", KOWALEVSKI, lambda value: (2, 2, 1, value("c0"), 0, 0)),
    Claim(
        "hk-lagrange-gamma-sq",
        "HK of the Lagrange top conserves a corrected γ² (Kimura, Hirota).",
        "section 2.2",
        CONSERVED,
        LAGRANGE.code + AND_VARIED,
        partial(conserved, LAGRANGE, "modified_gamma_sq"),
    ),
    Claim(
        "hk-lagrange-m-gamma",
        "HK of the Lagrange top conserves a corrected m·γ.",
        "section 2.2",
        CONSERVED,
        LAGRANGE.code + AND_VARIED,
        partial(conserved, LAGRANGE, "modified_m_gamma"),
    ),
    Claim(
        "hk-lagrange-energy",
        "HK of the Lagrange top conserves a corrected E.",
        "section 2.2",
        CONSERVED,
        LAGRANGE.code + AND_VARIED,
        partial(conserved, LAGRANGE, "modified_energy"),
    ),
    Claim(
        "hk-kowalevski-broken",
        "HK of the Kowalevski top breaks the four laws.",
        "section 2.2, last sentence",
        BROKEN,
        f"{KOWALEVSKI.with_sets('N=3').code}: the law with the smallest deviation",
        partial(broken, KOWALEVSKI.with_sets("N=3"), "gamma_sq", "two_l", "energy", "k_sq"),
    ),
    Claim(
        "hk-kowalevski-small",
        "HK of the Kowalevski top violates the laws very little.",
        "section 2.2, last sentence",
        SMALL,
        "`topcli run kowalevski_generic_hk`",
        partial(small, Scene("kowalevski_generic_hk"), ("gamma_sq", "two_l", "energy", "k_sq")),
    ),
)
