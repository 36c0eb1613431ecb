"""Display names of the schemes: one for each, and no two alike."""

from __future__ import annotations

import pytest

from topcli.schemes.compose import COMPOSITIONS
from topcli.schemes.display import COMPOSED, NAMES, display_name
from topcli.schemes.registry import all_schemes


def test_every_scheme_and_composition_has_its_own_display_name() -> None:
    built_in = {one.name for one in all_schemes() if one.origin == "topcli"}
    assert built_in <= set(NAMES)
    assert len(set(NAMES.values())) == len(NAMES)
    assert set(COMPOSITIONS) == set(COMPOSED)


@pytest.mark.parametrize(
    ("label", "shown"),
    [
        ("hk", "HK"),
        ("bohlin-a", "Bohlin A"),
        ("hybrid:branch=sign,h=0.01", "hybrid (branch=sign, h=0.01)"),
        ("hk+suzuki4", "HK + Suzuki 4"),
        ("backlund:nodes=exact", "Bäcklund, exact nodes"),
        ("hk+unknown", "hk+unknown"),
        ("my-scheme:h=0.1", "my-scheme:h=0.1"),
        ("h = 0.01", "h = 0.01"),
    ],
)
def test_display_names_keep_composition_and_settings(label: str, shown: str) -> None:
    assert display_name(label) == shown
