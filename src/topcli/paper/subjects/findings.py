"""Findings beyond the paper's sentences: longer runs, other states and other steps than its own."""

from __future__ import annotations

from functools import partial

from topcli.paper.claim import Claim
from topcli.paper.kinds.first_steps import STATES, UNDEFINED, undefined
from topcli.paper.kinds.integrability import GENERIC
from topcli.paper.kinds.levels import GROWS, STAYS, grows, stays
from topcli.paper.kinds.motion import BOHLIN, BOHLINS, SLOPE, UNEQUAL, slopes_differ, unequal_quality
from topcli.paper.kinds.pictures import HK, INVISIBLE, OTHER_PERIOD, invisible_change, other_period
from topcli.paper.scenes import Scene
from topcli.paper.subjects.figures import AS_INACCURATE, IRREVERSIBLE

LONG = ("N=10000000", "output.every=1000")
"""The paper's scene to t = 10000."""

CLAIMS = (
    Claim(
        "period-of-reversible",
        "HK, reversible, has another period than the motion too if its E deviates as in Figure 3.",
        "section 3.2.2, after Figure 2",
        OTHER_PERIOD,
        AS_INACCURATE[0].code,
        partial(other_period, AS_INACCURATE[:1]),
        ours=True,
    ),
    Claim(
        "higher-order-hides-rise",
        "Irreversible schemes of higher order make no visible increase of E in Figure 3.",
        "section 3.2.2, Figure 3, right",
        INVISIBLE,
        "`kowalevski_rk2`, `_rk4`, `_hybrid`",
        partial(invisible_change, IRREVERSIBLE, "energy", BOHLIN),
        ours=True,
    ),
    Claim(
        "hk-k-sq-long",
        "Under HK k² still oscillates, without drift, up to t = 10000.",
        "section 3.2.1, before Figure 1",
        STAYS,
        HK.with_sets(*LONG).code,
        partial(stays, HK.with_sets(*LONG), "k_sq"),
        slow=True,
        ours=True,
    ),
    Claim(
        "bohlin-energy-grows",
        "Under Bohlin A E keeps rising beyond Figure 3, up to t = 10000.",
        "section 3.2.2, Figure 3",
        GROWS,
        BOHLIN.with_sets(*LONG).code,
        partial(grows, BOHLIN.with_sets(*LONG), "energy"),
        slow=True,
        ours=True,
    ),
    Claim(
        "bohlin-two-l-grows",
        "Under Bohlin A 2ℓ keeps rising beyond Figure 3, up to t = 10000.",
        "section 3.2.2, Figure 3",
        GROWS,
        BOHLIN.with_sets(*LONG).code,
        partial(grows, BOHLIN.with_sets(*LONG), "two_l"),
        slow=True,
        ours=True,
    ),
    Claim(
        "abc-quality-generic",
        "From a generic state (A), (B) and (C) differ in quality (E and 2ℓ).",
        "section 3.2.2, after Figure 2",
        UNEQUAL,
        "`kowalevski_bohlin_a`, `_b`, `_c` from ω = (0.7, -0.4, 1.3), γ = (0.6, 0.48, 0.64)",
        partial(unequal_quality, tuple(Scene(one.config, GENERIC) for one in BOHLINS), ["energy", "two_l"]),
        slow=True,
        ours=True,
    ),
    Claim(
        "abc-complete",
        "Some of (A), (B), (C), as printed, have no step from some states.",
        "section 3.2.2, (A), (B), (C)",
        UNDEFINED,
        "the printed formulas at γ₃ = -1 and at ω = 0, where the limit of R is 1",
        partial(undefined, STATES),
        ours=True,
    ),
    Claim(
        "reversal-important",
        "Over long times the hybrid drifts in E, and its reversible form does not.",
        "section 4, first paragraph",
        SLOPE,
        "64 random orbits of `hybrid` and `hybrid-sym` at E = 5, h = 0.1, to t = 5000",
        partial(slopes_differ, "hybrid", "hybrid-sym"),
        slow=True,
        ours=True,
    ),
)
