"""Output on the claims: tables, details, JSON, the page, exit codes."""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import typer
from matplotlib.figure import Figure

import topcli
from topcli.cli.study import command
from topcli.figures.outcomes import VerdictPanel
from topcli.paper.claim import FAILS, HOLDS, HOLDS_WITHIN, MISPRINT, NOT_TRIED, Measurement
from topcli.paper.decide import Claims, decide_claims
from topcli.paper.ledger import ledger, read_ledger
from topcli.paper.page import claims_page
from topcli.paper.study import CLAIMS as STUDY
from topcli.paper.study import decided_result
from topcli.show.report import StudyReport
from topcli.studies import SILENT, Watch
from topcli.studies.study import Result

CLAIMS = {claim.id: claim for claim in ledger().claims}
IDS = ("matrix-m", "hk-heavy-equation", "hybrid-reversible")


@pytest.mark.slow
def test_json_has_one_list_of_claims(cli) -> None:
    said = cli("claims", *IDS, "--json")
    assert said.code == 0
    document = said.json()
    rows = document["claims"]
    for row, name in zip(rows, IDS, strict=True):
        claim = CLAIMS[name]
        assert (row["id"], row["kind"], row["measures"]) == (name, claim.check.name, claim.check.measures)
        assert all(row[key] == getattr(claim, key) for key in ("statement", "source", "recorded", "slow"))
    assert [row["verdict"] for row in rows] == [HOLDS, MISPRINT, FAILS]
    assert document["verdicts"] == {FAILS: 1, HOLDS: 1, MISPRINT: 1}
    assert (rows[1]["bound"], rows[1]["corrected"]) == ({"low": 0.0, "high": 0.0}, 0.0)
    reasons = ["the two sides of an identity are equal in rational numbers"] * 2 + ["rounding with 50 digits"]
    assert [row["bound_reason"] for row in rows] == reasons
    assert set(document["controls"]) == {"identity", "reversible"}


@pytest.mark.slow
def test_details_and_json_agree(cli) -> None:
    (row,) = json.loads(cli("claims", "hk-heavy-small", "--json").out)["claims"]
    assert row["verdict"] == "holds within 0.00064"
    said = cli("claims", "HK-heavy-small")
    assert said.code == 0
    lines = dict(line.strip().split(": ", 1) for line in said.out.splitlines())
    assert lines["hk-heavy-small"] == row["verdict"]
    for key in ("statement", "source", "experiment"):
        assert lines[key] == row[key]
    assert lines["measured"] == f"{row['figure']:.2g} ({row['measures']})"
    assert lines["bound"] == f"{row['bound_text']} ({row['bound_reason']})"
    assert row["bound"]["high"] == pytest.approx(6.4e-4, rel=1e-2)


SMALL = """
checks:
  - {name: rank, function: independence, measures: a number, side: at most, defect: the number 4,
     control: {integrals: kowalevski_laws, count: 3}}
  - {name: near, function: independence, measures: a number, side: at most, unit: mm, approximate: true,
     defect: the number 4 beside 3, control: {integrals: kowalevski_laws, count: 3}}
  - {name: law, function: conservation, measures: a number, side: at most, defect: a failed run,
     control: {scene: euler_bs rational N=30 max_digits=100, invariants: [m_sq]}}
sections:
  - title: Small
    claims:
      - {id: one, statement: <b>one</b> | x., source: section 1, check: rank, experiment: some,
         with: {integrals: kowalevski_laws, count: 4}, recorded: holds}
      - {id: two, statement: <b>two</b> | x., source: section 1, check: near, experiment: some,
         with: {integrals: kowalevski_laws, count: 5}, recorded: holds within}
      - {id: three, statement: <b>three</b> | x., source: section 1, check: rank, experiment: some,
         with: {integrals: kowalevski_laws, count: 3}, recorded: does not hold as stated}
excluded: []
"""
"""Three claims on a figure, which is 4: it lies within the first two bounds."""


def small(*changes: tuple[str, str], ids: tuple[str, ...] = ()) -> Claims:
    """The small ledger with parts of its text replaced, decided."""
    text = SMALL
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return decide_claims(ids, claims=read_ledger(text))


@pytest.fixture
def report(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Exit code, output and messages of the command on decided claims."""

    def printed(
        found: Claims, details: bool = False, as_json: bool = False, verbose: bool = False
    ) -> tuple[int, str, str]:
        def measure(watch: Watch = SILENT) -> Result:
            return decided_result(replace(found, named=details))

        code = 0
        try:
            own = replace(STUDY, measure=measure)
            command(own)(as_json=as_json, verbose=verbose, markdown=False, quiet=False, force=False, save=None)
        except typer.Exit as leaving:
            code = leaving.exit_code
        return code, *capsys.readouterr()

    return printed


def test_table_shows_the_figures_of_each_claim(report) -> None:
    """Claims that do not hold come first; with details the others follow."""
    summary = "3 claims of the paper: 1 holds, 1 holds within its bound, 1 does not hold as stated"
    code, out, err = report(small())
    assert (code, err) == (0, "")
    said, blank, title, header, *lines = out.splitlines()
    assert (said, blank, title) == (summary, "", "claims that do not hold as stated, or were not decided")
    assert re.split(r"\s{2,}", header.strip()) == ["id", "verdict", "measured", "bound", "statement"]
    rows = [re.split(r"\s{2,}", line.strip()) for line in lines]
    assert rows == [["three", "does not hold as stated", "4", "≤ 3", "<b>three</b> | x."]]
    lines = report(small(), verbose=True)[1].splitlines()
    header = ["id", "verdict", "measured", "bound", "source", "statement"]
    assert re.split(r"\s{2,}", lines[7].strip()) == header
    assert [re.split(r"\s{2,}", line.strip()) for line in (lines[4], *lines[8:])] == [
        ["three", "does not hold as stated", "4", "≤ 3", "section 1", "<b>three</b> | x."],
        ["one", "holds", "4", "≤ 4", "section 1", "<b>one</b> | x."],
        ["two", "holds within 5 mm", "4", "≤ 5 mm", "section 1", "<b>two</b> | x."],
    ]


@pytest.mark.slow
def test_a_changed_verdict_exits_with_4(report) -> None:
    changed = ("recorded: holds within", "recorded: holds")
    code, _, err = report(small(changed))
    assert code == 4
    assert "error: two: the verdict is 'holds within 5 mm'; recorded: 'holds'" in err
    assert report(small(changed, ids=("one",)))[0] == 0
    assert report(small(changed, ids=("two",)), as_json=True)[0] == 4


def test_a_check_that_misses_its_defect_exits_with_4(report) -> None:
    found = small(("defect: the number 4,\n     control: {integrals: kowalevski_laws, count: 3}", DEFECTLESS))
    code, _, err = report(found)
    assert (code, found.uncaught) == (4, ("rank",))
    assert "error: check 'rank': did not detect its deliberate error: none" in err


DEFECTLESS = "defect: none,\n     control: {integrals: kowalevski_laws, count: 4}"
FAILING = "check: law, with: {scene: euler_bs rational N=30 max_digits=100, invariants: [m_sq]}"


@pytest.mark.slow
def test_failed_run_leaves_the_other_verdicts(report) -> None:
    run = "euler_bs rational N=30 max_digits=100"
    first = ("check: rank, experiment: some,\n         with: {integrals: kowalevski_laws, count: 4}", FAILING)
    found = small(first, (f"control: {{scene: {run}", "control: {scene: euler_hk rational N=3"))
    code, out, err = report(found, as_json=True)
    assert code == 1
    rows = json.loads(out)["claims"]
    assert [row["verdict"] for row in rows] == [NOT_TRIED, "holds within 5 mm", FAILS]
    assert re.fullmatch(r"error: one: euler_bs: stopped at step .*", err.splitlines()[-1])
    code, _, err = report(small((first[0], FAILING.replace("N=30 max_digits=100", "N=2")), ids=("one",)))
    assert code == 4
    assert "error: check 'law': did not detect its deliberate error: a failed run" in err


@pytest.mark.slow
def test_missing_package_is_not_tried(report, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "scipy.spatial", None)
    found = decide_claims(("fig2-abc", "hk-heavy-equation"))
    code, out, err = report(found, as_json=True)
    assert code == 0
    _, row = json.loads(out)["claims"]
    assert (row["verdict"], row["figure"], row["bound"]) == (NOT_TRIED, None, None)
    assert row["note"] == "not tried: needs the package scipy.spatial, which is not installed"
    assert row["note"] in err
    assert not found.rows[1].changed
    code, out, _ = report(found)
    assert code == 0
    assert re.search(r"^fig2-abc +not tried +– +– +Methods", out, re.MULTILINE)
    page = claims_page(found)
    assert "1 was not tried" in page
    listed = page.partition("## What does not hold")[2].partition("## HK scheme")[0]
    assert "**fig2-abc**" not in listed
    (line,) = (line for line in listed.splitlines() if "**hk-heavy-equation**" in line)
    assert re.search(r"\| misprint \| largest difference [^|]* \| \d.*; corrected: 0 \| 0 \|$", line)


def test_progress_counts_claims_and_controls() -> None:
    steps: list[tuple[int, int]] = []
    decide_claims(claims=read_ledger(SMALL), on_progress=lambda done, total: steps.append((done, total)))
    assert steps == [(done, 5) for done in range(1, 6)]


@pytest.mark.slow
def test_report_has_the_figures_of_each_claim() -> None:
    found = small()
    shown = StudyReport(STUDY, decided_result(found))
    assert repr(shown).endswith("3 claims of the paper: 1 holds, 1 holds within its bound, 1 does not hold as stated>")
    assert shown.table.loc["two", ["figure", "bound", "verdict"]].tolist() == [4.0, "≤ 5 mm", "holds within 5 mm"]
    assert "&lt;b&gt;one&lt;/b&gt;" in shown._repr_html_()


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
    rows = {HOLDS: [4.0, 0.0], HOLDS_WITHIN: [2.0, 1.0], MISPRINT: [1.0, 3.0], FAILS: [3.0, 2.0], NOT_TRIED: [0.0, 5.0]}
    axes = Figure().add_subplot()
    VerdictPanel(("first", "second"), tuple(rows)).paint(axes, {name: np.array(rows[name]) for name in rows}, {})
    texts = {text.get_position(): text.get_text() for text in axes.texts}
    legend = axes.get_legend()
    keys = dict(zip([text.get_text() for text in legend.get_texts()], legend.get_patches(), strict=True))
    hues = []
    for (verdict, counts), bars in zip(rows.items(), axes.containers, strict=True):
        assert [bar.get_width() for bar in bars] == counts
        for row, (bar, count) in enumerate(zip(bars, counts, strict=True)):
            assert not count or texts.pop((bar.get_x() + 0.5 * count, row)) == f"{count:.0f}"
        assert keys[verdict].get_facecolor() == bars[0].get_facecolor()
        red, _, blue, _ = bars[0].get_facecolor()
        hues.append("blue" if blue > red + 0.3 else "orange" if red > blue + 0.3 else "grey")
    assert not texts
    assert hues == ["blue", "blue", "orange", "orange", "grey"]
    assert len({bars[0].get_facecolor() for bars in axes.containers}) == len(rows)


def test_a_figure_that_is_not_finite_is_null_in_json() -> None:
    found = small(ids=("one",))
    rows = tuple(replace(row, measurement=Measurement(math.nan)) for row in found.rows)
    controls = tuple(replace(row, measurement=Measurement(math.inf)) for row in found.controls)
    data = Claims(rows, controls).as_dict()
    json.dumps(data, allow_nan=False)
    assert data["claims"][0]["figure"] is None
    assert data["claims"][0]["verdict"] == FAILS
    assert rows[0].changed
