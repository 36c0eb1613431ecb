"""Rates of wrong verdicts on invariants, judged by runs 100 times longer, as in docs/verdicts.md."""

from __future__ import annotations

import importlib.util
import sys
from collections import Counter

import pytest

from conftest import ROOT

SPEC = importlib.util.spec_from_file_location("verdicts", ROOT / "benchmarks" / "verdicts.py")
assert SPEC
assert SPEC.loader
verdicts = sys.modules[SPEC.name] = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(verdicts)


@pytest.mark.slow
def test_verdicts_are_rarely_wrong() -> None:
    """Eight schemes, ten scenes, ten lengths: false alarms at most 2 %, bounds that are too low at most 5 %.

    The controls: rk4 is found to drift, HK is not, and conserved invariants are exact.
    """
    found = verdicts.measured(0.1)
    of_scheme = {title: Counter(one.row.verdict for one in found if one.scheme == title) for title in verdicts.SCHEMES}
    counts = Counter(one.row.verdict for one in found)
    assert counts["drifting"] > 80
    assert counts["no drift seen"] > 300
    assert sum(one.false_alarm for one in found) <= 0.02 * counts["drifting"]
    assert sum(one.bound_too_low for one in found) <= 0.05 * counts["no drift seen"]
    assert of_scheme["rk4"]["drifting"] > 40
    assert of_scheme["HK"]["drifting"] == of_scheme["midpoint"]["drifting"] == 0
    assert of_scheme["HK, projected"]["exact"] == of_scheme["HK, projected"].total()


@pytest.mark.slow
def test_bounds_cover_changes_at_the_ends_of_runs() -> None:
    """Jumps, ramps and cubics added to real deviations, once, three and ten times as large as their range.

    Of the changes as large as the range, 3 to 28 % exceed the bound, and 30 % of the jumps after 99.5 %. With the
    slope and its error alone, all jumps and ramps do at every size, and 10 to 35 % of the cubics.
    """
    counts = verdicts.with_changes(0.1, (60.0, 100.0, 180.0))
    for change in verdicts.CHANGES:
        for size in verdicts.SIZES:
            low, covered = counts[change, size, True], counts[change, size, False]
            assert low + covered > 20, change
            allowed = {"line": 0.0, "jump after 99.5 %": 0.5}.get(change, 0.3)
            assert low <= (allowed if size == 1.0 else 0.05) * (low + covered), (change, size)
