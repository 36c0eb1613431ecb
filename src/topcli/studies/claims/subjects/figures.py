"""Claims about Figures 1 to 3 (sections 3.2.1 and 3.2.2) and what the paper infers from them."""

from __future__ import annotations

from functools import partial

from topcli.studies.claims.claim import Claim
from topcli.studies.claims.kinds.motion import BOHLIN, PERIODIC, RANGE, periodic, stated_range
from topcli.studies.claims.kinds.pictures import (
    CONSTANT_LINE,
    HK,
    OTHER_PERIOD,
    OTHER_PICTURE,
    SAME_PICTURE,
    VISIBLE,
    constant_line,
    other_period,
    other_picture,
    same_picture,
    visible_change,
)
from topcli.studies.claims.scenes import Scene

RK2, RK4, HYBRID = Scene("kowalevski_rk2"), Scene("kowalevski_rk4"), Scene("kowalevski_hybrid")
LONG = ("N=10000000", "output.every=1000")
"""The paper's scene to t = 10000."""
BOHLIN_B, BOHLIN_C = Scene("kowalevski_bohlin_b"), Scene("kowalevski_bohlin_c")

CLAIMS = (
    Claim(
        "fig1-motion",
        "Figure 1 shows the motion (Yoshida's behaviour).",
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
        "Under HK k² oscillates (no drift to t = 10000).",
        "section 3.2.1, before Figure 1",
        PERIODIC,
        Scene("kowalevski_hk", LONG).code,
        partial(periodic, Scene("kowalevski_hk", LONG), "k_sq"),
        slow=True,
    ),
    Claim(
        "fig2-abc",
        "(A), (B) and (C) give indistinguishable figures.",
        "section 3.2.2, before Figure 2",
        SAME_PICTURE,
        "`kowalevski_bohlin_a` against `_b` and `_c`",
        partial(same_picture, BOHLIN, (BOHLIN_B, BOHLIN_C)),
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
        "Figure 2's period differs because time reversal is broken.",
        "section 3.2.2, after Figure 2; summary",
        OTHER_PERIOD,
        "`kowalevski_rk2`, `_rk4`, `_hybrid`, which break it too",
        partial(other_period, (RK2, RK4, HYBRID)),
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
        "fig3-energy-periodic",
        "Under Bohlin A E changes periodically (to t = 10000).",
        "section 3.2.2, Figure 3, right",
        PERIODIC,
        Scene("kowalevski_bohlin_a", LONG).code,
        partial(periodic, Scene("kowalevski_bohlin_a", LONG), "energy"),
        slow=True,
    ),
    Claim(
        "fig3-two-l-periodic",
        "Under Bohlin A 2ℓ changes periodically (to t = 10000).",
        "section 3.2.2, before Figure 3",
        PERIODIC,
        Scene("kowalevski_bohlin_a", LONG).code,
        partial(periodic, Scene("kowalevski_bohlin_a", LONG), "two_l"),
        slow=True,
    ),
    Claim(
        "fig3-cause",
        "The change of E in Figure 3 is due to time reversal asymmetry.",
        "section 3.2.2, before Figure 3",
        VISIBLE,
        "`kowalevski_rk2`, `_rk4`, `_hybrid`, which break it too",
        partial(visible_change, (RK2, RK4, HYBRID), "energy", BOHLIN),
    ),
)
