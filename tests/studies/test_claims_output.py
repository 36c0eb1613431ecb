"""Output on the claims: tables, details, JSON, files, exit codes."""

from __future__ import annotations

import json
import math
import re
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import topcli
from reading_html import read_html
from topcli.errors import RunError
from topcli.figures.claims import VerdictPanel
from topcli.paper import decide, recorded
from topcli.paper.claim import FAILS, HOLDS, HOLDS_WITHIN, MISPRINT, NOT_TRIED, Bound, Finding, Kind
from topcli.paper.decided import Control, Decided
from topcli.paper.ledger import LEDGER
from topcli.paper.recorded import RECORDED
from topcli.paper.result import Claims

NAMED = {claim.id: claim for claim in LEDGER}
IDS = ("matrix-m", "hk-heavy-equation", "hybrid-reversible")


@pytest.mark.slow
def test_json_has_one_list_of_claims(cli) -> None:
    said = cli("claims", *IDS, "--json")
    assert said.code == 0
    document = json.loads(said.out)
    assert [key for key, value in document.items() if isinstance(value, list)] == ["claims"]
    assert [one["id"] for one in document["claims"]] == list(IDS)
    for one in document["claims"]:
        assert one.keys() >= {"id", "origin", "statement", "source", "figure", "bound", "verdict"}
        claim = NAMED[one["id"]]
        assert (one["statement"], one["source"], one["recorded"]) == (claim.statement, claim.source, RECORDED[claim.id])
        assert one["origin"] == "paper"
    assert document["verdicts"] == {FAILS: 1, HOLDS: 1, MISPRINT: 1}
    assert document["findings"] == {}
    assert [one["verdict"] for one in document["claims"]] == [HOLDS, MISPRINT, FAILS]
    assert document["claims"][1]["bound"] == {"low": 0.0, "high": 0.0}
    assert document["claims"][1]["corrected"] == 0.0
    assert set(document["controls"]) == {"identity", "reversible"}


@pytest.mark.slow
def test_details_and_json_agree(cli) -> None:
    (one,) = json.loads(cli("claims", "hk-heavy-small", "--json").out)["claims"]
    assert one["verdict"] == "holds within 0.00064"
    said = cli("claims", "HK-heavy-small")
    assert said.code == 0
    lines = dict(line.strip().split(": ", 1) for line in said.out.splitlines())
    assert lines["hk-heavy-small"] == one["verdict"]
    assert {key: lines[key] for key in ("statement", "origin", "source", "experiment")} == {
        key: one[key] for key in ("statement", "origin", "source", "experiment")
    }
    assert lines["figure"] == f"{one['figure']:.2g} ({one['measures']})"
    assert lines["bound"] == f"{one['bound_text']} ({one['bound_reason']})"
    assert one["bound"]["high"] == pytest.approx(6.4e-4, rel=1e-2)


def finding(figure: float, verdict_bound: Bound | None = None) -> Finding:
    return Finding(figure, verdict_bound or Bound(0.0, 1.0))


@pytest.fixture
def small_ledger(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """A ledger of three claims, which hold, hold approximately and fail; ``control`` can be spoilt."""
    content: dict[str, Any] = {"control": finding(2.0)}
    kind = Kind("dummy", "a number", "the number 2", lambda: content["control"])
    model = LEDGER[0]
    findings = (finding(0.25), finding(0.5, Bound(0.0, 1.0, approximate=True, unit="mm")), finding(3.0))
    claims = [
        replace(
            model, id=name, statement=f"<b>{name}</b> | x.", kind=kind, decide=lambda one=one: one, ours=name == "two"
        )
        for name, one in zip(("one", "two", "three"), findings, strict=True)
    ]
    monkeypatch.setattr(decide, "chosen", lambda ids, fast: [one for one in claims if not ids or one.id in ids])
    monkeypatch.setattr("topcli.paper.ledger.LEDGER", tuple(claims))
    for name, verdict in (("one", HOLDS), ("two", HOLDS_WITHIN), ("three", FAILS)):
        monkeypatch.setitem(recorded.RECORDED, name, verdict)
    content["claims"] = claims
    return content


def test_table_shows_the_figures_of_each_claim(cli, small_ledger: dict[str, Any]) -> None:
    said = cli("claims")
    assert said.code == 0
    header, *lines = said.out.splitlines()
    assert re.split(r"\s{2,}", header.strip()) == ["id", "origin", "statement", "verdict", "figure", "bound", "source"]
    source = LEDGER[0].source
    assert [re.split(r"\s{2,}", line.strip()) for line in lines] == [
        ["one", "paper", "<b>one</b> | x.", "holds", "0.25", "≤ 1", source],
        ["two", "ours", "<b>two</b> | x.", "holds within 1 mm", "0.5", "≤ 1 mm", source],
        ["three", "paper", "<b>three</b> | x.", "does not hold as stated", "3", "≤ 1", source],
    ]
    summary = "2 claims of the paper; does not hold as stated: 1, holds: 1. 1 finding of ours; holds within: 1"
    assert said.err.strip() == summary


def test_a_changed_verdict_exits_with_4(cli, small_ledger: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(recorded.RECORDED, "two", HOLDS)
    said = cli("claims")
    assert said.code == 4
    assert "error: two: the verdict is 'holds within 1 mm'; recorded: 'holds'" in said.err
    assert cli("claims", "one").code == 0
    monkeypatch.delitem(recorded.RECORDED, "one")
    assert cli("claims", "one", "--json").code == 4


def test_a_check_that_misses_its_defect_exits_with_4(cli, small_ledger: dict[str, Any]) -> None:
    small_ledger["control"] = finding(1.0)
    said = cli("claims")
    assert said.code == 4
    assert "error: check 'dummy': did not find its positive control: the number 2" in said.err


def test_missing_package_is_not_tried(cli, small_ledger: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    def needs_heyoka() -> Finding:
        import heyoka_that_nobody_has  # pyright: ignore[reportMissingImports]

        return heyoka_that_nobody_has.finding()

    small_ledger["claims"][0] = replace(small_ledger["claims"][0], decide=needs_heyoka)
    said = cli("claims", "--json")
    assert said.code == 0
    one = json.loads(said.out)["claims"][0]
    assert (one["verdict"], one["figure"], one["bound"]) == (NOT_TRIED, None, None)
    assert one["note"] == "not tried: needs the package heyoka_that_nobody_has, which is not installed"
    assert one["note"] in said.err
    said = cli("claims")
    assert said.code == 0
    assert re.search(r"^one .* not tried +– +– ", said.out, re.MULTILINE)
    page = topcli.claims().to_markdown()
    assert "not tried: 1" in page
    listed = page.partition("## What does not hold")[2].partition("## Kinds")[0]
    assert "**three**" in listed
    assert "**one**" not in listed
    (line,) = (line for line in listed.splitlines() if "**three**" in line)
    assert line.endswith("| does not hold as stated | 3 | ≤ 1 |")


def test_failed_run_leaves_the_other_verdicts(cli, small_ledger: dict[str, Any]) -> None:
    def fails() -> Finding:
        raise RunError("euler_bs: blew up at step 3", "second line")

    small_ledger["claims"][0] = replace(small_ledger["claims"][0], decide=fails)
    said = cli("claims", "--json")
    assert said.code == 1
    assert [one["verdict"] for one in json.loads(said.out)["claims"]] == [
        NOT_TRIED,
        "holds within 1 mm",
        FAILS,
    ]
    assert said.err.splitlines()[-1] == "error: one: euler_bs: blew up at step 3"
    small_ledger["control"] = None
    kind = replace(small_ledger["claims"][1].kind, control=fails)
    small_ledger["claims"][1] = replace(small_ledger["claims"][1], kind=kind)
    said = cli("claims", "two")
    assert said.code == 4
    assert "error: check 'dummy': did not find its positive control" in said.err


@pytest.mark.slow
def test_a_claim_about_pictures_without_scipy_is_not_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "scipy.spatial", None)
    (row,) = topcli.claims("fig2-abc").rows
    assert row.verdict == NOT_TRIED
    assert "scipy.spatial" in row.reason
    assert not row.changed


def test_unknown_claims_name_the_nearest(cli) -> None:
    said = cli("claims", "hybrid-reversable")
    assert said.code == 2
    assert "unknown claim 'hybrid-reversable'; did you mean 'hybrid-reversible'" in said.err
    assert said.out == ""
    said = cli("claims", "qqq")
    assert said.code == 2
    assert "topcli claims --fast lists the claims" in said.err
    assert cli("claims", "--json", "--markdown").code == 2


def test_progress_counts_claims_and_controls(small_ledger: dict[str, Any]) -> None:
    steps: list[tuple[int, int]] = []
    decide.decide_claims(on_progress=lambda done, total: steps.append((done, total)))
    assert steps == [(1, 4), (2, 4), (3, 4), (4, 4)]


@pytest.mark.slow
def test_report_has_the_figures_of_each_claim_and_escapes_their_texts(small_ledger: dict[str, Any]) -> None:
    found = topcli.claims()
    assert repr(found).endswith("1 holds, 1 does not hold as stated; findings of ours: 1 holds within>")
    assert found.table.loc["two", ["figure", "bound", "verdict"]].tolist() == [0.5, "≤ 1 mm", "holds within 1 mm"]
    html = found._repr_html_()
    assert "&lt;b&gt;one&lt;/b&gt;" in html
    assert "<b>one" not in html
    (table,) = read_html(html).all("table")
    assert table.cells()[2][:2] == ["two", "ours"]
    assert table.cells()[2][3:6] == ["holds within 1 mm", "0.5", "≤ 1 mm"]


@pytest.mark.slow
def test_plot_counts_the_verdicts_of_each_part_of_the_paper() -> None:
    names = ("hk-heavy-small", "hk-heavy-equation", "hybrid-k-sq", "hybrid-reversible")
    axes = topcli.claims(names, progress=False).plot(Figure().add_subplot())
    assert [label.get_text() for label in axes.get_yticklabels()] == [
        "HK scheme of heavy tops",
        "Hybrid scheme and summary",
    ]
    bars = {one.get_label(): [bar.get_width() for bar in one] for one in axes.containers}
    assert bars == {HOLDS: [0, 1], HOLDS_WITHIN: [1, 0], MISPRINT: [1, 0], FAILS: [0, 1]}
    assert sorted(text.get_text() for text in axes.texts) == ["1"] * 4
    assert [bar.get_x() for bar in axes.containers[-1]] == [2, 1], "bars are side by side"


def test_bars_of_verdicts_have_their_numbers_within_and_their_own_colours() -> None:
    """Blue is what holds, orange what does not, grey what was not tried; the number is in the middle of its bar."""
    counts = {
        HOLDS: [4.0, 0.0],
        HOLDS_WITHIN: [2.0, 1.0],
        MISPRINT: [1.0, 3.0],
        FAILS: [3.0, 2.0],
        NOT_TRIED: [0.0, 5.0],
    }
    panel = VerdictPanel(("first", "second"), tuple(counts))
    axes = Figure().add_subplot()
    panel.paint(axes, {name: np.array(values) for name, values in counts.items()}, {})
    texts = {text.get_position(): text.get_text() for text in axes.texts}
    hues = {}
    for verdict, bars in zip(counts, axes.containers, strict=True):
        assert bars.get_label() == verdict
        for row, (bar, count) in enumerate(zip(bars, counts[verdict], strict=True)):
            assert bar.get_width() == count
            if count:
                assert texts.pop((bar.get_x() + 0.5 * count, row)) == f"{count:.0f}"
        red, _, blue, _ = bars[0].get_facecolor()
        hues[verdict] = "blue" if blue > red + 0.3 else "orange" if red > blue + 0.3 else "grey"
    assert not texts
    assert list(hues.values()) == ["blue", "blue", "orange", "orange", "grey"]
    assert len({bars[0].get_facecolor() for bars in axes.containers}) == len(counts)
    legend = axes.get_legend()
    shown = {text.get_text(): patch for text, patch in zip(legend.get_texts(), legend.get_patches(), strict=True)}
    assert all(shown[bars.get_label()].get_facecolor() == bars[0].get_facecolor() for bars in axes.containers)


def test_a_figure_that_is_not_finite_is_null_in_json() -> None:
    row = Decided(LEDGER[0], finding(math.nan), "", HOLDS, 0.0)
    control = Control(NAMED["matrix-m"].kind, finding(math.inf), "")
    found = Claims((row,), (control,)).as_dict()
    json.dumps(found, allow_nan=False)
    assert found["claims"][0]["figure"] is None
    assert found["claims"][0]["verdict"] == FAILS
    assert row.changed
