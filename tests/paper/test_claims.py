"""The claims of the paper: their verdicts, and what follows from a verdict."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import topcli
from conftest import Said
from topcli.paper import claims as module
from topcli.paper.checks import TOLERANCE, Measured
from topcli.paper.claims import all_claims, chosen, excluded

NAMES = ("matrix-m", "hk-heavy-equation", "hybrid-reversible")


@pytest.mark.slow
def test_a_claim_of_each_kind_has_its_recorded_verdict() -> None:
    """``topcli claims`` tests them all."""
    ledger = all_claims()
    kinds = {claim.check["kind"]: claim.id for claim in reversed(ledger.values()) if not claim.slow}
    report = topcli.claims(*kinds.values())
    assert (report.errors, report.code) == ([], 0)
    assert report.table["verdict"].to_dict() == {name: ledger[name].recorded for name in report.table.index}


def test_recorded_verdicts() -> None:
    recorded = {claim.id: claim.recorded for claim in all_claims().values()}
    assert {*recorded.values()} == {"holds", "holds within", "misprint", "does not hold as stated"}
    assert [claim.id for claim in chosen((), fast=True)] == [id for id, claim in all_claims().items() if not claim.slow]
    assert [name for name, verdict in recorded.items() if not verdict.startswith("holds")] == [
        *("kowalevski-fourth", "hk-euler-correction-order", "hk-heavy-equation", "bohlin-angle", "branch-by-sign"),
        *("fig2-cause", "hybrid-k-sq-formula", "hybrid-reversible"),
    ]


def test_entries_are_complete() -> None:
    """Sentences with their sections; a reason for leaving a statement out names claims that exist."""
    entries = [(claim.id, claim.statement, claim.source, "") for claim in all_claims().values()]
    for name, statement, source, reason in (*entries, *excluded()):
        assert re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", name)
        assert statement.endswith(".")
        assert re.match(r"sections? \d|abstract", source)
        assert set(re.findall(r"\b[a-z0-9]+(?:-[a-z0-9]+)+\b", reason)) <= set(all_claims())
    assert not {name for name, *_ in excluded()} & set(all_claims())


@pytest.mark.slow
def test_changed_verdict_exits_with_4(cli: Callable[..., Said], monkeypatch: pytest.MonkeyPatch) -> None:
    """The verdict is measured and does not follow the recorded one."""
    recorded = {name: replace(all_claims()[name], recorded="holds") for name in NAMES}
    monkeypatch.setattr(module, "all_claims", lambda: recorded)
    said = cli("claims", "--json")
    every, exceptions = ([row["verdict"] for row in table["rows"]] for table in said.json()["tables"][:2])
    assert (said.code, every) == (4, ["holds", "misprint", "does not hold as stated"])
    assert exceptions == every[1:]
    assert "error: hk-heavy-equation: the verdict is 'misprint'; recorded: 'holds'" in said.err
    assert cli("claims", NAMES[0]).code == 0


@pytest.mark.parametrize(
    ("side", "limit", "inside", "outside"),
    [
        ("≤", 1.0, [0.0, 1.0], [math.nextafter(1.0, 2.0)]),
        ("≥", 2.0, [2.0, math.inf], [math.nextafter(2.0, 0.0)]),
        (">", 0.0, [5e-324], [0.0]),
        ("=", 4.0, [4.0], [3.0, 5.0]),
        ("≈", 2.0, [2.0 - 0.99 * TOLERANCE, 2.0 + 0.99 * TOLERANCE], [2.0 - 1.01 * TOLERANCE, 2.0 + 1.01 * TOLERANCE]),
    ],
)
def test_verdict_follows_from_figure_and_limit(
    side: str, limit: float, inside: list[float], outside: list[float]
) -> None:
    for figure in inside:
        assert Measured(figure, side, limit, "").verdict == "holds"
        assert Measured(figure, side, limit, "", approximate=True).verdict == "holds within"
        assert Measured(outside[0], side, limit, "", corrected=figure).verdict == "misprint"
    for figure in (*outside, math.nan):
        assert Measured(figure, side, limit, "", approximate=True).verdict == "does not hold as stated"
        assert Measured(outside[0], side, limit, "", corrected=figure).verdict == "does not hold as stated"


@pytest.mark.slow
def test_most_orbits_of_b_as_printed_end_at_the_pole() -> None:
    """The reason for which (B) is left out: 27 of 32 orbits end, each with gamma next to the third axis below."""
    draws = np.random.default_rng(1)
    drawn = [(draws.normal(scale=1.5, size=3), draws.normal(size=3)) for _ in range(32)]
    states = [np.concatenate([omega, gamma / np.linalg.norm(gamma)]) for omega, gamma in drawn]
    runs = topcli.simulate("kowalevski_bohlin_b", h=0.4, N=2000, states=states)
    ended = runs.last_n < 2000
    assert ended.sum() == 27
    assert (runs.last[ended, 5] < -0.99).all()
