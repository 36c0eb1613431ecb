"""The ledger of the paper's claims: what it holds, how it is read, and its page of the documentation."""

from __future__ import annotations

import ast
import inspect
import math
import re
from dataclasses import replace
from pathlib import Path

import pytest

from cases import cases_of
from topcli.errors import ConfigError
from topcli.paper import ledger as module
from topcli.paper.claim import FAILS, HOLDS, HOLDS_WITHIN, MISPRINT, Bound
from topcli.paper.decide import Claims, decide_claims
from topcli.paper.ledger import ledger, read_ledger
from topcli.paper.page import claims_page
from topcli.paper.scenes import LedgerScene

SOURCES = Path(inspect.getfile(module)).parent
TEXT = (SOURCES / module.FILE).read_text(encoding="utf-8")
CLAIMS = {claim.id: claim for claim in ledger().claims}
EXCLUDED = ledger().excluded
RECORDED = {name: claim.recorded for name, claim in CLAIMS.items()}


def test_the_ledger_is_complete() -> None:
    assert len(ledger().claims) >= 40
    assert set(RECORDED.values()) == {HOLDS, HOLDS_WITHIN, FAILS, MISPRINT}
    assert {claim.check.name for claim in CLAIMS.values()} == {check.name for check in ledger().checks}
    for entry in (*CLAIMS.values(), *EXCLUDED):
        assert entry.statement.endswith("."), entry.id
        assert re.match(r"section|abstract", entry.source), entry.id
    for claim in CLAIMS.values():
        assert re.fullmatch(r"([^`{}]+|`[^`{}]+`)+", claim.experiment_text), claim.id
    for entry in EXCLUDED:
        assert set(re.findall(r"\b[a-z0-9]+(?:-[a-z0-9]+)+\b", entry.reason)) <= set(CLAIMS), entry.id


WRONG = r"""
check: reversible\n -> check: reversable\n
    hk-euler-reversible: check: unknown check 'reversable'.*'reve
scene: euler_bs rational N=6 -> scene: euler_bs rationel
    bs-euler-m-sq: scene: .* 'rationel'; did you
invariants: [m_sq]}\n        recorded -> invariant: m_sq}\n        recorded
    hk-euler-m-sq: invariants:
difference: kepler -> difference: keppler
    bohlin-kepler: difference: .*has a function 'keppler'
with: {equation: midpoint} -> with: {equation: midpoint, width: x}
    hybrid-explicit: width:
source: section 1.2, HK scheme\n -> sourse: section 1.2\n
    hk-euler-equation: source: Field required
id: direct\n -> id: kepler\n        id2: x\n
    kepler: id2: Extra inputs
function: reversal\n -> function: reversel\n
    reversible: no check function 'reversel'
control: {scheme: backlund, h: 0.4} -> control: {scheme: backlund}
    neighbours part under a map: h: Field required
recorded: misprint\n -> recorded: misprinted\n
    kowalevski-fourth: recorded:
"""


@pytest.mark.slow
@pytest.mark.parametrize(("change", "message"), cases_of(WRONG))
def test_a_wrong_entry_is_named_with_its_line(change: str, message: list[str]) -> None:
    old, new = change.replace("\\n", "\n").split(" -> ")
    assert old in TEXT
    with pytest.raises(ConfigError, match=message[0]) as caught:
        read_ledger(TEXT.replace(old, new, 1), "my.yaml")
    (number,) = re.findall(r"^my.yaml:(\d+): ", str(caught.value))
    assert -1 <= TEXT[: TEXT.index(old)].count("\n") + 1 - int(number) <= 20, "the line of the key or of its entry"


@pytest.mark.slow
def test_a_name_is_used_once() -> None:
    with pytest.raises(ConfigError, match="the name 'rotation' is used twice"):
        read_ledger(TEXT.replace("id: direct\n", "id: rotation\n"))


def test_claims_do_not_leave_the_papers_scope() -> None:
    """A claim on a figure runs the figure's state, window and step."""
    for name in ("fig1-k-sq", "fig1-oscillates", "fig2-period", "fig3-energy", "fig3-energy-rises", "fig3-two-l-rises"):
        (command,) = re.findall(r"`topcli run (.*)`", CLAIMS[name].experiment_text)
        assert command in ("kowalevski_hk", "kowalevski_bohlin_a"), name
    for name in ("kowalevski_hk", "kowalevski_bohlin_a", "kowalevski_bohlin_b", "kowalevski_bohlin_c"):
        experiment = LedgerScene(name).experiment()
        assert experiment.y0 == pytest.approx((2.0, 0.0, 0.0, math.sqrt(1.0 - 1e-6), 0.0, 1e-3), abs=1e-16)
        assert (experiment.h, experiment.N) == (0.001, 50000)


def test_integrability_is_asked_of_every_scheme_of_the_paper() -> None:
    """Of (B) the ledger says why not."""
    suffix = "-only-approximates"
    assert {name.removesuffix(suffix) for name in CLAIMS if name.endswith(suffix)} == {
        "hk",
        "hybrid",
        "bohlin-a",
        "bohlin-c",
    }
    assert "approximation-of-b" in [entry.id for entry in EXCLUDED]


# verdicts follow from measurements, not from what is recorded


def test_only_the_comparison_reads_the_recorded_verdicts() -> None:
    readers = [
        (path.stem, node.lineno)
        for path in SOURCES.glob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and node.attr == "recorded"
    ]
    assert {name for name, _ in readers} == {"decide"}
    assert len(readers) == 2, "the comparison and the plain data"


@pytest.mark.slow
def test_verdicts_do_not_depend_on_the_record() -> None:
    names = ("matrix-m", "hk-heavy-equation", "hk-euler-m-sq", "bohlin-explicit")
    swapped = re.sub(r"recorded: .*", f"recorded: {FAILS}", TEXT)
    decided = decide_claims(names, claims=read_ledger(swapped))
    assert [row.category for row in decided.rows] == [RECORDED[row.claim.id] for row in decided.rows]
    assert set(decided.changed) == set(names)


BOUNDS = [
    (Bound(0.0, 1.0), [0.0, 1.0], [-5e-324, math.nextafter(1.0, 2.0)]),
    (Bound(2.0), [2.0, math.inf], [math.nextafter(2.0, 0.0)]),
    (Bound(0.0, open_low=True), [5e-324], [0.0]),
    (Bound(1.9, 2.1), [1.9, 2.1], [math.nextafter(1.9, 0.0), math.nextafter(2.1, 3.0)]),
]


@pytest.mark.parametrize(("bound", "inside", "outside"), BOUNDS)
def test_verdict_follows_from_figure_and_bound(bound: Bound, inside: list[float], outside: list[float]) -> None:
    assert {bound.verdict(figure, None) for figure in inside} == {HOLDS}
    assert {bound.verdict(figure, None) for figure in (*outside, math.nan)} == {FAILS}
    assert {replace(bound, approximate=True).verdict(figure, None) for figure in inside} == {HOLDS_WITHIN}


def test_a_misprint_fails_as_printed_and_holds_corrected() -> None:
    exactly = Bound(0.0, 0.0)
    found = [exactly.verdict(figure, fixed) for figure, fixed in ((1.0, 0.0), (1.0, 1e-9), (0.0, 1.0), (1.0, math.nan))]
    assert found == [MISPRINT, FAILS, HOLDS, FAILS]


# everything decided, and the page


@pytest.fixture(scope="module")
def every_claim() -> Claims:
    return decide_claims()


@pytest.mark.slow
def test_all_claims_have_their_recorded_verdicts(every_claim: Claims) -> None:
    assert [row.claim.id for row in every_claim.rows] == list(CLAIMS)
    assert (every_claim.changed, every_claim.uncaught) == ((), ())


DEFECTS = """
identity: 486.6 1e-9
explicit: 24.88 1e-3
implicit: 0.0 0.0
independence: 2.0 0.0
conserved exactly: 7.69e-4 1e-2
not conserved: 0.0 1e-47
reversible: 3.588e-4 1e-3
not reversible: 0.0 0.0
equal maps: 2.986e-2 1e-3
neighbours part under a map: 3.40 4e-2
angles of the roots: 1.395 1e-3
order of an equation: 0.992 1e-2
printed formula: 1.32e-3 1e-2
symmetric equation: 6.491e-3 1e-3
growth of numbers: 1.55 1e-2
content of a spectrum: 4.0 0.0
neighbours part: 1.41 1e-2
choice of the root: 3.0 0.0
order of a deviation: 1.095 1e-2
order of convergence: 0.996 1e-2
oscillation: 0.8565 1e-3
rise at each swing: 1.48e-4 1e-2
small deviation: 0.283 1e-2
equal quality: 3.75e4 1e-2
stated range: 2.285e-5 1e-3
equal pictures: 11.57 1e-2
different pictures: 0.0 0.018
straight line: 14.887 1e-3
different period: 2.21e-5 1e-2
elliptic function: 6.0 0.0
"""
"""Figure of each kind of check on its defect, and the relative tolerance; absolute where the figure is 0."""


@pytest.mark.slow
def test_checks_find_their_defects(every_claim: Claims) -> None:
    lines = (line.partition(": ") for line in DEFECTS.strip().split("\n"))
    defects = {kind: map(float, numbers.split()) for kind, _, numbers in lines}
    assert {control.check.name for control in every_claim.controls} == set(defects)
    for control in every_claim.controls:
        value, tolerance = defects[control.check.name]
        assert control.category == FAILS
        assert control.measurement is not None
        assert control.measurement.figure == pytest.approx(value, rel=tolerance, abs=0.0 if value else tolerance)


@pytest.mark.slow
def test_the_page_lists_every_claim_with_its_verdict(every_claim: Claims) -> None:
    page = claims_page(every_claim)
    for row in every_claim.rows:
        entries = [line for line in page.splitlines() if line.startswith(f"| **{row.claim.id}**: ")]
        assert entries, row.claim.id
        assert all(f" | {row.verdict} | " in line for line in entries), row.claim.id
