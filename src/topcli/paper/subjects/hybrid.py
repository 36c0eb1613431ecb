"""Claims of section 3.2.3, the hybrid, and of the summary."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from topcli.paper import printed
from topcli.paper.algebra import Draws
from topcli.paper.claim import Claim
from topcli.paper.kinds.conservation import CONSERVED, REVERSIBLE, conserved, reversible
from topcli.paper.kinds.formula import FORMULA, formula_conserved
from topcli.paper.kinds.identity import LINEAR, linear_in_new
from topcli.paper.kinds.integrability import (
    DIGITS_GROW,
    GENERIC,
    MAP_PARTS,
    PAIRS,
    PARTING_STEPS,
    digits_grow,
    map_parts_neighbours,
)
from topcli.paper.kinds.pictures import HK, SAME_PICTURE, same_picture
from topcli.paper.scenes import AND_VARIED, FIFTY, RATIONAL, Scene

HYBRID = Scene("kowalevski_hybrid", (*FIFTY, "N=50", *GENERIC))
GROWTH = Scene("kowalevski_hk", (*RATIONAL, "max_digits=100000", *GENERIC))
SECTION = "section 3.2.3"
REMARK = "section 4, second paragraph"
SCHEMES = (
    ("hybrid", "The hybrid", 0.4),
    ("bohlin-a", "Bohlin's method with (A)", 0.8),
    ("bohlin-c", "Bohlin's method with (C)", 1.0),
)
"""Schemes whose numbers do not stay rational, and a step at which they are tried; without (B), see ``excluded``."""


def _approximates(name: str, title: str, h: float) -> Claim:
    return Claim(
        f"{name}-only-approximates",
        f"{title} is merely an approximation: it is not integrable by itself.",
        REMARK,
        MAP_PARTS,
        f"{PAIRS} random orbits of `{name}` at h = {h:g}, {PARTING_STEPS} steps, and 1e-9 beside them",
        partial(map_parts_neighbours, name, h),
        slow=True,
    )


def modified_bs(new: tuple[Any, ...], draws: Draws) -> Sequence[Any]:
    """Second step of the hybrid as an equation for the new gamma, at the omega of the first step."""
    h, c, w, v = draws.number(), draws.vector(), draws.vector(), draws.vector()
    return printed.midpoint(h, c, (new[0], new[1], new[2]), w, v)


CLAIMS = (
    Claim(
        "hybrid-explicit",
        "The modified BS step is explicit once HK has given ω'.",
        f"{SECTION}, (2)",
        LINEAR,
        "rational test of the printed equation",
        partial(linear_in_new, modified_bs, 3),
    ),
    Claim(
        "hybrid-gamma-sq",
        "The hybrid keeps γ² = 1 exactly.",
        f"{SECTION}; abstract",
        CONSERVED,
        HYBRID.code + AND_VARIED,
        partial(conserved, HYBRID, "gamma_sq"),
    ),
    Claim(
        "hybrid-k-sq",
        "The hybrid keeps k² = |ω² - c₀γ|² exactly.",
        f"{SECTION}, last sentence; abstract",
        CONSERVED,
        HYBRID.code + AND_VARIED,
        partial(conserved, HYBRID, "k_sq"),
    ),
    Claim(
        "hybrid-k-sq-formula",
        "The hybrid keeps k² = |ω - c₀γ|².",
        f"{SECTION}, after the scheme",
        FORMULA,
        f"{HYBRID.code}; corrected to |ω² - c₀γ|²",
        partial(formula_conserved, HYBRID, printed.k_squared_hybrid, printed.k_squared),
    ),
    Claim(
        "hybrid-reversible",
        "The hybrid has time reversal symmetry.",
        f"{SECTION}, after the scheme",
        REVERSIBLE,
        HYBRID.with_sets("N=1").code + AND_VARIED,
        partial(reversible, HYBRID.with_sets("N=1"), Scene("kowalevski_hybrid")),
    ),
    Claim(
        "fig4-fig1",
        "Figure 4 looks almost the same as Figure 1.",
        f"{SECTION}, last sentence",
        SAME_PICTURE,
        "`kowalevski_hybrid` against `kowalevski_hk`",
        partial(same_picture, HK, (Scene("kowalevski_hybrid"),)),
        slow=True,
    ),
    Claim(
        "hk-only-approximates",
        "HK of the Kowalevski top is merely an approximation: it is not integrable by itself.",
        REMARK,
        DIGITS_GROW,
        GROWTH.with_sets("N=5").code,
        partial(digits_grow, GROWTH),
    ),
    *(_approximates(*one) for one in SCHEMES),
)
