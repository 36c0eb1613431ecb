"""The ledger of the paper's claims: its checks find known defects, and its verdicts follow from figures and bounds."""

from __future__ import annotations

import ast
import inspect
import math
import re
from pathlib import Path

import pytest

import topcli
from conftest import ROOT
from topcli.paper import decide
from topcli.paper.claim import FAILS, HOLDS, HOLDS_WITHIN, MISPRINT, Bound, Finding
from topcli.paper.excluded import EXCLUDED
from topcli.paper.ledger import LEDGER, SUBJECTS
from topcli.paper.recorded import RECORDED
from topcli.paper.result import Claims
from topcli.paper.scenes import Scene

PAGE = ROOT / "docs" / "claims.md"
NAMED = {claim.id: claim for claim in LEDGER}
KINDS = {claim.kind.name: claim.kind for claim in LEDGER}
SOURCES = Path(inspect.getfile(decide)).parent


def test_the_ledger_is_complete() -> None:
    assert len(LEDGER) >= 40
    assert len(NAMED) == len(LEDGER)
    assert list(RECORDED) == list(NAMED)
    assert set(RECORDED.values()) == {HOLDS, HOLDS_WITHIN, FAILS, MISPRINT}
    for claim in LEDGER:
        assert re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)+|[a-z]+", claim.id), claim.id
        assert claim.statement.endswith("."), claim.id
        assert claim.source.startswith("section"), claim.id
        assert claim.experiment.count("`") % 2 == 0, claim.id
    assert len({claim.statement for claim in LEDGER}) == len(LEDGER)


def test_every_entry_says_whether_it_is_the_papers_or_ours() -> None:
    """Findings have a section of their own, hold, and are not counted as claims of the paper."""
    ours = [claim.id for claim in LEDGER if claim.origin == "ours"]
    assert [claim.id for claim in SUBJECTS["Findings beyond the paper"]] == ours
    assert {claim.origin for claim in LEDGER} == {"paper", "ours"}
    assert {RECORDED[name] for name in ours} == {HOLDS}
    found = topcli.claims(["abc-complete", "hk-heavy-equation", "matrix-m"], progress=False)
    assert [one["origin"] for one in found.as_dict()["claims"]] == ["paper", "paper", "ours"]
    assert (found.counts, found.findings) == ({HOLDS: 1, MISPRINT: 1}, {HOLDS: 1})
    assert found.summary == "2 claims of the paper; holds: 1, misprint: 1. 1 finding of ours; holds: 1"


def test_claims_do_not_leave_the_papers_scope() -> None:
    """Long runs and states of ours are findings; a claim on a figure runs the figure's state, window and step."""
    for claim in LEDGER:
        if not claim.ours:
            assert "N=10000000" not in claim.experiment, claim.id
    for name in ("fig1-k-sq", "fig1-oscillates", "fig2-period", "fig3-energy", "fig3-energy-rises", "fig3-two-l-rises"):
        (command,) = re.findall(r"`topcli run (.*)`", NAMED[name].experiment)
        assert command in ("kowalevski_hk", "kowalevski_bohlin_a"), name
    for name in ("kowalevski_hk", "kowalevski_bohlin_a", "kowalevski_bohlin_b", "kowalevski_bohlin_c"):
        experiment = Scene(name).experiment()
        assert experiment.y0 == pytest.approx((2.0, 0.0, 0.0, math.sqrt(1.0 - 1e-6), 0.0, 1e-3), abs=1e-16)
        assert (experiment.h, experiment.N) == (0.001, 50000)


def test_what_is_left_out_has_a_name_and_a_reason() -> None:
    names = [one.name for one in EXCLUDED]
    assert len(set(names)) == len(names)
    assert not set(names) & set(NAMED)
    for one in EXCLUDED:
        assert one.statement.endswith("."), one.name
        assert re.match(r"section|abstract", one.source), one.name
        assert set(re.findall(r"\b[a-z0-9]+(?:-[a-z0-9]+)+\b", one.reason)) <= set(NAMED), one.name


def test_integrability_is_asked_of_every_scheme_of_the_paper() -> None:
    suffix = "-only-approximates"
    asked = {name.removesuffix(suffix) for name in NAMED if name.endswith(suffix)}
    assert asked == {"hk", "hybrid", "bohlin-a", "bohlin-c"}
    assert [one.statement for one in EXCLUDED if one.name == "approximation-of-b"] == [
        "Bohlin's method with (B) is merely an approximation: it is not integrable by itself."
    ]


def test_readme_counts_the_claims_of_the_paper() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (others,) = re.findall(r"decides this and (\d+) other statements of the paper", readme)
    assert int(others) + 1 == sum(not claim.ours for claim in LEDGER)


def test_no_check_knows_the_recorded_verdicts() -> None:
    """Only ``decide`` imports the record, and its comparison comes after the finding."""
    importing = set()
    for path in SOURCES.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import | ast.ImportFrom) else []
            if any(name.rpartition(".")[2] in ("recorded", "RECORDED") for name in names):
                importing.add(path.stem)
    assert importing == {"decide"}


@pytest.mark.parametrize(
    ("figure", "bound", "corrected", "verdict"),
    [
        (1.0, Bound(0.0, 1.0), None, HOLDS),
        (math.nextafter(1.0, 2.0), Bound(0.0, 1.0), None, FAILS),
        (0.5, Bound(0.0, 1.0, approximate=True), None, HOLDS_WITHIN),
        (2.0, Bound(2.0), None, HOLDS),
        (math.nextafter(2.0, 0.0), Bound(2.0), None, FAILS),
        (0.0, Bound(0.0, open_low=True), None, FAILS),
        (5e-324, Bound(0.0, open_low=True), None, HOLDS),
        (1.9, Bound(1.9, 2.1), None, HOLDS),
        (2.1, Bound(1.9, 2.1), None, HOLDS),
        (math.nextafter(1.9, 0.0), Bound(1.9, 2.1), None, FAILS),
        (math.nan, Bound(-math.inf, math.inf), None, FAILS),
        (1.0, Bound(0.0, 0.0), 0.0, MISPRINT),
        (1.0, Bound(0.0, 0.0), 1e-9, FAILS),
        (0.0, Bound(0.0, 0.0), 1.0, HOLDS),
        (1.0, Bound(0.0, 0.0), math.nan, FAILS),
    ],
)
def test_verdict_follows_from_figure_and_bound(
    figure: float, bound: Bound, corrected: float | None, verdict: str
) -> None:
    assert Finding(figure, bound, corrected).verdict == verdict


def test_bounds_are_written_with_their_sides() -> None:
    assert Bound(0.0, 1e-45).text == "≤ 1e-45"
    assert Bound(0.0, 0.0).text == "0"
    assert Bound(1.9, 2.1).text == "1.9 to 2.1"
    assert Bound(2.0).text == "≥ 2"
    assert Bound(0.0, open_low=True).text == "> 0"
    assert Bound(0.0, 0.17638, unit="mm").text == "≤ 0.18 mm"


DEFECTS: dict[str, tuple[float, float]] = {
    "identity": (486.6, 1e-9),
    "explicit": (24.88, 1e-3),
    "implicit": (0.0, 0.0),
    "independence": (2.0, 0.0),
    "conserved exactly": (7.69e-4, 1e-2),
    "not conserved": (0.0, 1e-47),
    "reversible": (3.588e-4, 1e-3),
    "not reversible": (0.0, 0.0),
    "equal maps": (2.986e-2, 1e-3),
    "neighbours part under a map": (3.50, 1e-2),
    "angles of the roots": (1.395, 1e-3),
    "order of an equation": (0.992, 1e-2),
    "undefined step": (0.0, 0.0),
    "different slopes": (0.241, 1e-2),
    "printed formula": (1.32e-3, 1e-2),
    "symmetric equation": (6.491e-3, 1e-3),
    "growth of numbers": (1.55, 1e-2),
    "content of a spectrum": (4.0, 0.0),
    "neighbours part": (1.41, 1e-2),
    "choice of the root": (3.0, 0.0),
    "order of a deviation": (1.095, 1e-2),
    "order of convergence": (0.996, 1e-2),
    "oscillation": (0.8565, 1e-3),
    "rise at each swing": (1.48e-4, 1e-2),
    "no growth": (17.9, 1e-2),
    "growth": (1.0, 1e-4),
    "small deviation": (0.283, 1e-2),
    "equal quality": (3.75e4, 1e-2),
    "stated range": (2.285e-5, 1e-3),
    "equal pictures": (11.57, 1e-2),
    "different pictures": (0.0, 0.018),
    "straight line": (14.887, 1e-3),
    "invisible change": (27.98, 1e-2),
    "different period": (2.21e-5, 1e-2),
    "elliptic function": (6.0, 0.0),
    "unequal quality": (1.122, 1e-3),
}
"""Figure of each kind of check on its defect, and the relative tolerance; absolute where the figure is 0."""


def test_every_kind_has_a_defect_of_known_size() -> None:
    assert set(DEFECTS) == set(KINDS)


@pytest.mark.slow
@pytest.mark.parametrize("name", DEFECTS)
def test_check_finds_its_defect(name: str) -> None:
    finding = KINDS[name].control()
    value, tolerance = DEFECTS[name]
    assert finding.verdict == FAILS
    assert finding.figure == pytest.approx(value, rel=tolerance, abs=0.0 if value else tolerance)


@pytest.mark.slow
def test_fast_claims_have_their_recorded_verdicts() -> None:
    found = topcli.claims(fast=True)
    assert len(found) == sum(not claim.slow for claim in LEDGER) > 90
    assert (found.changed, found.blunt) == ((), ())


@pytest.fixture(scope="module")
def every_claim() -> Claims:
    return topcli.claims()


@pytest.mark.slow
def test_all_claims_have_their_recorded_verdicts(every_claim: Claims) -> None:
    assert [row.claim.id for row in every_claim.rows] == list(NAMED)
    assert (every_claim.changed, every_claim.blunt) == ((), ())


NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w])")


def same_line(shown: str, now: str) -> bool:
    """True if two lines have equal words, and numbers that differ by a tenth at most or are both below 1e-9."""
    if NUMBER.sub("#", shown) != NUMBER.sub("#", now):
        return False
    pairs = zip(map(float, NUMBER.findall(shown)), map(float, NUMBER.findall(now)), strict=True)
    return all(math.isclose(a, b, rel_tol=0.11, abs_tol=1e-9) for a, b in pairs)


@pytest.mark.slow
def test_the_page_is_up_to_date(every_claim: Claims) -> None:
    shown, now = PAGE.read_text(encoding="utf-8").splitlines(), every_claim.to_markdown().splitlines()
    assert len(shown) == len(now), "run topcli claims --markdown > docs/claims.md"
    for a, b in zip(shown, now, strict=True):
        assert same_line(a, b), f"run topcli claims --markdown > docs/claims.md\n{a}\n{b}"


def test_lines_of_the_page_are_compared_by_value() -> None:
    assert same_line("| 2.1e-51 | holds |", "| 7.3e-52 | holds |")
    assert not same_line("| 2.1e-51 | holds |", "| 2.1e-05 | holds |")
    assert not same_line("| 1.9 | holds |", "| 1.5 | holds |")
    assert not same_line("| 1.9 | holds |", "| 1.9 | misprint |")


def test_page_lists_every_claim_with_its_recorded_verdict() -> None:
    """The page without running anything: each claim once in its section, with the verdict of the record."""
    sections = PAGE.read_text(encoding="utf-8").split("\n## ")
    for title, claims in SUBJECTS.items():
        (section,) = (text for text in sections if text.startswith(title + "\n"))
        rows = dict(re.findall(r"^\| \*\*([a-z0-9-]+)\*\*(?:[^|]|\\\|)*? \| ([^|]+) \| ", section, re.MULTILINE))
        assert list(rows) == [claim.id for claim in claims]
        for claim in claims:
            assert rows[claim.id].startswith(RECORDED[claim.id])
    for start, wanted in (
        ("What does not hold", [name for name, verdict in RECORDED.items() if verdict in (FAILS, MISPRINT)]),
        ("Not in the ledger", [one.name for one in EXCLUDED]),
    ):
        (other,) = (text for text in sections if text.startswith(start))
        assert re.findall(r"^\| \*\*([a-z0-9-]+)\*\*", other, re.MULTILINE) == wanted
    for ours, noun in ((False, "claims of the paper"), (True, "findings of ours")):
        verdicts = [RECORDED[claim.id] for claim in LEDGER if claim.ours is ours]
        (counts,) = re.findall(rf"(\d+) {noun}; ([^.]*)\.", sections[0])
        assert int(counts[0]) == len(verdicts)
        assert dict(part.rsplit(": ", 1) for part in counts[1].split(", ")) == {
            verdict: str(verdicts.count(verdict)) for verdict in set(verdicts)
        }
