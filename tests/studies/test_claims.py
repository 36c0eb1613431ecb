"""The ledger of the paper's claims: its checks find known defects, and its verdicts follow from figures and bounds."""

from __future__ import annotations

import ast
import inspect
import math
import re
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import topcli
from conftest import ROOT
from topcli.studies.claims import decide, printed
from topcli.studies.claims.algebra import I_UNIT, Draws, Dual, Gauss, commutator, cross, dot
from topcli.studies.claims.claim import FAILS, HOLDS, HOLDS_WITHIN, MISPRINT, Bound, Finding
from topcli.studies.claims.kinds import motion, pictures, rank
from topcli.studies.claims.ledger import LEDGER, SUBJECTS
from topcli.studies.claims.recorded import RECORDED
from topcli.studies.claims.result import Claims
from topcli.studies.claims.scenes import Scene, trajectory
from topcli.tops.euler import Euler

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
    "printed formula": (1.32e-3, 1e-2),
    "symmetric equation": (1.393e-3, 1e-3),
    "growth of numbers": (1.55, 1e-2),
    "content of a spectrum": (4.0, 0.0),
    "neighbours part": (1.41, 1e-2),
    "choice of the root": (3.0, 0.0),
    "order of a deviation": (1.095, 1e-2),
    "order of convergence": (0.996, 1e-2),
    "periodic change": (17.9, 1e-2),
    "small deviation": (0.283, 1e-2),
    "equal quality": (3.75e4, 1e-2),
    "completed run": (2e-4, 1e-9),
    "stated range": (2.285e-5, 1e-3),
    "equal pictures": (11.57, 1e-2),
    "different pictures": (0.0, 0.018),
    "straight line": (14.887, 1e-3),
    "visible change": (1.009e-2, 1e-2),
    "different period": (2.21e-5, 1e-2),
    "elliptic function": (6.0, 0.0),
    "unequal quality": (1.0, 1e-3),
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
    (other,) = (text for text in sections if text.startswith("What does not hold"))
    listed = re.findall(r"^\| \*\*([a-z0-9-]+)\*\*", other, re.MULTILINE)
    assert listed == [name for name, verdict in RECORDED.items() if verdict in (FAILS, MISPRINT)]


# the checks themselves, on defects other than their controls


def test_wrong_transcription_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sign in (K1), which every identity about it notices."""

    def wrong(c0: Any, w: Any, c: Any) -> Any:
        return (w[1] * w[2] / 2, -w[2] * w[0] / 2 - c0 / 2 * c[2], -c0 * c[1]), right(c0, w, c)[1]

    right = printed.kowalevski
    names = [
        "kowalevski-equations",
        "kowalevski-complex-omega",
        "kowalevski-xi",
        "kowalevski-energy",
        "kowalevski-k-sq",
    ]
    assert {row.category for row in topcli.claims(names).rows} == {HOLDS}
    monkeypatch.setattr(printed, "kowalevski", wrong)
    assert {row.category for row in topcli.claims(names).rows} == {FAILS}


def test_corrected_equation_is_no_misprint(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the last term corrected as printed, (dEulerPoisson) simply holds; with a wrong correction it fails."""
    original = printed.hk_heavy
    assert topcli.claims("hk-heavy-equation").rows[0].category == MISPRINT
    monkeypatch.setattr(printed, "hk_heavy", lambda *at: original(*at[:-1], True))
    assert topcli.claims("hk-heavy-equation").rows[0].category == HOLDS
    monkeypatch.setattr(printed, "hk_heavy", lambda *at: original(*at[:-1], False))
    assert topcli.claims("hk-heavy-equation").rows[0].category == FAILS


def test_the_misprint_is_one_half_of_a_term() -> None:
    """Both states equal, the printed last line gives (gamma_1 omega_2 - gamma_2 omega_1)/2 instead of twice that."""
    w, c = (Fraction(1), Fraction(2), Fraction(3)), (Fraction(5), Fraction(7), Fraction(11))
    one, zero = (Fraction(1),) * 3, (Fraction(0),) * 3
    for corrected, factor in ((False, Fraction(1, 2)), (True, Fraction(1))):
        left = printed.hk_heavy(one, zero, Fraction(1), (*w, *c), (*w, *c), corrected)
        assert -left[5] == factor * (5 * 2 - 7 * 1)


@pytest.mark.slow
def test_return_defect_of_the_hybrid_is_that_of_plain_doubles() -> None:
    """1.4e-5 at h = 0.1 and of order 4, at 50 digits and by plain doubles here."""
    finding = NAMED["hybrid-reversible"].decide()
    assert finding.figure == pytest.approx(1.36e-5, rel=1e-2)
    found = re.fullmatch(r"of order (\d\.\d\d) in h", finding.note)
    assert found
    assert float(found[1]) == pytest.approx(4.0, abs=0.1)
    state = {"initial": {"omega": [0.7, -0.4, 1.3], "gamma": [0.6, 0.48, 0.64]}, "N": 1}
    there = topcli.simulate("kowalevski_hybrid", h=0.1, **state).states[-1].tolist()
    back = {"omega": there[:3], "gamma": there[3:]}
    again = topcli.simulate("kowalevski_hybrid", h=-0.1, N=1, initial=back).states[-1]
    assert np.abs(again - [0.7, -0.4, 1.3, 0.6, 0.48, 0.64]).max() == pytest.approx(finding.figure, rel=1e-6)


# arithmetic of the ledger


def test_gaussian_rationals_are_complex_numbers() -> None:
    a, b = Gauss(Fraction(3), Fraction(-2)), Gauss(Fraction(1, 4), Fraction(5))
    x, y = 3 - 2j, 0.25 + 5j
    pairs = (a + b, x + y), (a - b, x - y), (a * b, x * y), (a / b, x / y), (2 - a, 2 - x), (3 * b, 3 * y), (-a, -x)
    for found, expected in (*pairs, (a.bar, 3 + 2j), (I_UNIT * a, 1j * x), (a / 2, x / 2)):
        assert complex(float(found.re), float(found.im)) == pytest.approx(expected, rel=1e-15)


def test_duals_follow_the_rules_of_differentiation() -> None:
    """d/dt of f(x, y) with x' = 2, y' = -3, by hand."""
    x, y = Dual(Fraction(5), Fraction(2)), Dual(Fraction(7), Fraction(-3))
    assert (x * y).rate == 2 * 7 - 3 * 5
    assert (x / y).rate == Fraction(2 * 7 + 3 * 5, 49)
    assert (x * x - 4 * y + 1).rate == 2 * 5 * 2 + 12
    assert (1 - x).rate == -2


def test_draws_are_exact_and_repeatable() -> None:
    draws, again = Draws(7), Draws(7)
    for _ in range(20):
        assert dot(unit := draws.unit(), unit) == 1
        c, s = draws.circle()
        assert c * c + s * s == 1
        again.unit()
        assert again.circle() == (c, s)


def test_the_hat_has_the_sign_of_the_paper() -> None:
    u, v = (1, 2, 3), (5, 7, -4)
    assert commutator(printed.hat(u), printed.hat(v)) == printed.hat(cross(v, u))
    assert cross((1, 0, 0), (0, 1, 0)) == (0, 0, 1)


def test_rank_of_rational_matrices() -> None:
    assert rank.rank([[1, 2, 3], [2, 4, 6]]) == 1
    assert rank.rank([[0, 1, 0], [1, 0, 0], [0, 0, 1]]) == 3
    assert rank.rank([[0, 0], [0, 0]]) == 0


@pytest.mark.slow
def test_distance_between_pictures() -> None:
    """Two horizontal lines 0.3 mm apart, and one with a bump of 2 mm."""
    x = np.linspace(0.0, 45.0, 500)
    flat, bump = np.zeros_like(x), 2.0 * np.exp(-((x - 20.0) ** 2))
    lines = [pictures._resampled(x, y) for y in (flat, flat + 0.3, bump)]
    assert pictures._apart(lines[0], lines[1]) == pytest.approx(0.3, abs=0.01)
    assert pictures._apart(lines[0], lines[2]) == pytest.approx(2.0, abs=0.02)
    assert pictures._apart(lines[2], lines[0]) == pictures._apart(lines[0], lines[2])


def test_rate_of_change_is_the_norm_of_the_jacobian() -> None:
    """Euler's field at omega = (0, 0, w): a 2x2 block with entries w (B - C)/A and w (C - A)/B."""
    states = np.array([[0.0, 0.0, 2.0], [0.0, 0.0, -3.0]])
    assert motion.rate_of_change(Euler(A=3.0, B=2.0, C=1.0), states) == pytest.approx(3.0, rel=1e-12)


def test_scenes_are_shown_as_commands_and_overrides_replace() -> None:
    scene = Scene("euler_hk", ("h=0.1", "initial.omega=[1, 2, 3]"))
    assert str(scene) == "topcli run euler_hk --set h=0.1 --set 'initial.omega=[1, 2, 3]'"
    assert scene.with_sets("h=0.2", "N=3").sets == ("initial.omega=[1, 2, 3]", "h=0.2", "N=3")


def test_a_run_that_fails_is_no_verdict() -> None:
    """The state blows up: the experiment has failed, not the claim."""
    from topcli.errors import RunError
    from topcli.studies.claims.kinds.conservation import conserved

    scene = Scene("euler_bs", ("precision=rational", "h=1/10", "N=30", "max_digits=100"))
    with pytest.raises(RunError, match=r"euler_bs: stopped at step .* more digits than max_digits"):
        conserved(scene, "m_sq")


@pytest.mark.slow
def test_runs_in_doubles_are_carried_out_once() -> None:
    assert trajectory(Scene("euler_hk")) is trajectory(Scene("euler_hk"))
