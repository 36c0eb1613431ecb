"""Claims about Figures 1 to 3 (sections 3.2.1 and 3.2.2) and what the paper infers from them."""

from __future__ import annotations

from functools import partial

from topcli.paper.claim import Claim
from topcli.paper.kinds.levels import RETURNS, RISES, returns, rises
from topcli.paper.kinds.motion import BOHLIN, BOHLINS, QUALITY, RANGE, same_quality, stated_range
from topcli.paper.kinds.pictures import (
    CONSTANT_LINE,
    HK,
    OTHER_PERIOD,
    OTHER_PICTURE,
    SAME_PICTURE,
    constant_line,
    other_period,
    other_picture,
    same_picture,
)
from topcli.paper.scenes import Scene

IRREVERSIBLE = (Scene("kowalevski_rk2"), Scene("kowalevski_rk4"), Scene("kowalevski_hybrid"))

AS_INACCURATE = (HK.with_sets("h=0.0625", "N=800"), HK.with_sets("scheme=splitting", "h=0.2", "N=250"))
"""Reversible schemes at steps at which E deviates by 0.005 as in Figure 3."""

CLAIMS = (
    Claim(
        "fig1-motion",
        "Figure 1 shows the behaviour of the motion (the paper compares with Yoshida's figure).",
        "section 3.2.1, Figure 1",
        SAME_PICTURE,
        "`kowalevski_hk` against the closed form, `kowalevski_exact`",
        partial(same_picture, HK, (Scene("kowalevski_exact"),)),
        slow=True,
    ),
    Claim(
        "fig1-k-sq",
        "Under HK k² changes between 9.000003 and 9.000011.",
        "section 3.2.1, before Figure 1",
        RANGE,
        HK.code,
        partial(stated_range, HK, "k_sq", 9.000003, 9.000011, 1e-6),
    ),
    Claim(
        "fig1-oscillates",
        "Under HK k² oscillates.",
        "section 3.2.1, before Figure 1",
        RETURNS,
        HK.code,
        partial(returns, "k_sq", HK),
    ),
    Claim(
        "fig2-abc",
        "(A), (B) and (C) give indistinguishable figures.",
        "section 3.2.2, before Figure 2",
        SAME_PICTURE,
        "`kowalevski_bohlin_a` against `_b` and `_c`",
        partial(same_picture, BOHLIN, BOHLINS[1:]),
        slow=True,
    ),
    Claim(
        "abc-quality",
        "(A), (B), (C) have almost the same quality in Figure 2 (E and 2ℓ).",
        "section 3.2.2, before Figure 2",
        QUALITY,
        "`kowalevski_bohlin_a`, `_b`, `_c`: deviations of E and 2ℓ",
        partial(same_quality, BOHLINS, ["energy", "two_l"]),
        slow=True,
    ),
    Claim(
        "fig2-differs",
        "Figure 2 differs obviously from Figure 1.",
        "section 3.2.2, after Figure 2",
        OTHER_PICTURE,
        "`kowalevski_bohlin_a` against `kowalevski_hk`",
        partial(other_picture, HK, BOHLIN),
        slow=True,
    ),
    Claim(
        "fig2-period",
        "Figure 2 has another period than Figure 1.",
        "section 3.2.2, after Figure 2",
        OTHER_PERIOD,
        BOHLIN.code,
        partial(other_period, (BOHLIN,)),
    ),
    Claim(
        "fig2-cause",
        "The other period of Figure 2 implies that time reversal symmetry is extremely important.",
        "section 3.2.2, after Figure 2; section 4, first paragraph",
        OTHER_PERIOD,
        "`kowalevski_rk2`, `_rk4`, `_hybrid`, which break the symmetry too",
        partial(other_period, IRREVERSIBLE),
    ),
    Claim(
        "fig3-two-l",
        "In Figure 3 (left) 2ℓ seems to be constant.",
        "section 3.2.2, Figure 3, left",
        CONSTANT_LINE,
        BOHLIN.code,
        partial(constant_line, BOHLIN, "two_l", 6.0),
    ),
    Claim(
        "fig3-energy",
        "In Figure 3 (left) E seems to be constant.",
        "section 3.2.2, Figure 3, left",
        CONSTANT_LINE,
        BOHLIN.code,
        partial(constant_line, BOHLIN, "energy", 6.0),
    ),
    Claim(
        "fig3-energy-rises",
        "In Figure 3 (right) E makes an increase periodically, at each swing.",
        "section 3.2.2, Figure 3, right",
        RISES,
        BOHLIN.code,
        partial(rises, BOHLIN, "energy"),
    ),
    Claim(
        "fig3-two-l-rises",
        "Under Bohlin A 2ℓ behaves almost like E: it increases at each swing.",
        "section 3.2.2, before Figure 3",
        RISES,
        BOHLIN.code,
        partial(rises, BOHLIN, "two_l"),
    ),
    Claim(
        "fig3-cause",
        "The increase of E in Figure 3 is a consequence of time reversal asymmetry.",
        "section 3.2.2, before Figure 3",
        RETURNS,
        "reversible schemes with E as inaccurate: `kowalevski_hk` at h = 0.0625, `splitting` at h = 0.2",
        partial(returns, "energy", *AS_INACCURATE),
    ),
)
