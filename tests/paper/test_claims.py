"""Output on the claims: JSON and exit codes."""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Callable
from dataclasses import replace

import pytest
import typer

from topcli.cli.study import command
from topcli.paper.claim import FAILS, HOLDS, MISPRINT, NOT_TRIED, Measurement
from topcli.paper.decide import Claims, decide_claims
from topcli.paper.ledger import ledger, read_ledger
from topcli.paper.page import claims_page
from topcli.paper.study import CLAIMS as STUDY
from topcli.paper.study import decided_result
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


def test_a_figure_that_is_not_finite_is_null_in_json() -> None:
    found = small(ids=("one",))
    rows = tuple(replace(row, measurement=Measurement(math.nan)) for row in found.rows)
    controls = tuple(replace(row, measurement=Measurement(math.inf)) for row in found.controls)
    data = Claims(rows, controls).as_dict()
    json.dumps(data, allow_nan=False)
    assert data["claims"][0]["figure"] is None
    assert data["claims"][0]["verdict"] == FAILS
    assert rows[0].changed
