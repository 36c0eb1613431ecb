"""Comparisons: entries with options and steps of their own, errors against the reference."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import topcli
from conftest import ROOT
from reading_html import read_html
from topcli.config.load import load_experiment
from topcli.errors import UsageError
from topcli.studies.compare_runs import compare_schemes
from topcli.studies.study import Result

HK = ROOT / "configs" / "kowalevski_hk.yaml"


FIVE = ("hk", "bohlin-a", "bohlin-b", "bohlin-c", "hybrid")


@pytest.fixture(scope="module")
def paper() -> Result:
    """The paper's scene under the paper's five schemes."""
    return compare_schemes(load_experiment(HK), FIVE)


def of(comparison: Result, scheme: str) -> dict:
    return next(one for one in comparison.data["schemes"] if one["scheme"] == scheme)


@pytest.mark.slow
def test_the_reference_swings_as_the_theory_says(paper: Result) -> None:
    """Half the period is sqrt 2 ln(8 sqrt 7/eps) to leading order in eps = gamma3(0), the first swing at 14.086."""
    spacing = paper.data["reference"]["first_swing_spacing"]
    assert spacing == pytest.approx(28.171, abs=1e-3)
    assert spacing / 2 == pytest.approx(math.sqrt(2) * math.log(8 * math.sqrt(7) / 1e-3), abs=2e-3)
    assert of(paper, "hk")["swing_times"][0] == pytest.approx(14.086, abs=1e-3)


@pytest.mark.slow
def test_verdicts_of_compared_schemes(paper: Result) -> None:
    verdicts = {scheme: {row["name"]: row["verdict"] for row in of(paper, scheme)["invariants"]} for scheme in FIVE}
    assert set(verdicts["hk"].values()) == {"no drift seen"}
    for scheme in FIVE[1:]:
        assert verdicts[scheme]["gamma_sq"] == verdicts[scheme]["k_sq"] == "exact"
    for scheme in ("bohlin-a", "bohlin-c"):
        assert verdicts[scheme]["energy"] == verdicts[scheme]["two_l"] == "drifting"


def test_reversal_defect_and_order_are_reported(paper: Result) -> None:
    """The paper calls the hybrid reversible: it misses by O(h⁴). Bohlin's schemes miss by O(h²), HK not at all."""
    assert of(paper, "hk")["reversal_order"] is None
    assert of(paper, "hk")["reversal_defect"] < 1e-15
    assert of(paper, "hybrid")["reversal_order"] == pytest.approx(4.0, abs=0.1)
    for scheme in ("bohlin-a", "bohlin-b", "bohlin-c"):
        assert of(paper, scheme)["reversal_order"] == pytest.approx(2.0, abs=0.1)


def test_errors_are_against_an_independent_reference(paper: Result) -> None:
    """The error of HK at the end of the run agrees with the distance from a run with a step four times smaller."""
    fine = topcli.simulate(HK, h=2.5e-4, N=200_000, output={"every": 200_000})
    coarse = topcli.simulate(HK, output={"every": 50_000})
    assert of(paper, "hk")["final_error"] == pytest.approx(np.linalg.norm(fine.states[-1] - coarse.states[-1]), rel=0.1)
    assert of(paper, "hk")["max_error"] == np.nanmax(paper.arrays["error:hk"])


@pytest.mark.slow
def test_a_scheme_that_blows_up_is_compared_as_far_as_it_went() -> None:
    experiment = load_experiment(
        HK,
        [
            "initial.omega=[0.01, 0, 3]",
            "initial.gamma=[1e-8, 0, -auto]",
            "scheme=bohlin-b",
            "h=0.1",
            "N=500",
        ],
    )
    comparison = compare_schemes(experiment, ["bohlin-b", "hk"])
    broken = of(comparison, "bohlin-b")
    assert broken["outcome"] == "blew_up"
    assert broken["final_error"] is None
    assert np.isnan(comparison.arrays["error:bohlin-b"][-1])
    assert of(comparison, "hk")["outcome"] == "completed"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "scheme", "power"), [("euler_hk", "hk", 2), ("lagrange_hk", "hk", 2), ("lagrange_bs", "bs", 1)]
)
def test_modified_integrals_differ_from_the_physical_by_a_term_of_the_order_of_the_scheme(scene, scheme, power) -> None:
    """The coefficient of h^p hardly depends on h, while the integral itself stays at round-off: at h and at h/4."""
    coefficients = []
    for h in (0.02, 0.005):
        comparison = compare_schemes(load_experiment(scene, [f"h={h}", "N=4000"]), [scheme, "rk4"])
        assert of(comparison, "rk4")["modified"] == []  # it has no integrals of its own
        rows = of(comparison, scheme)["modified"]
        assert all(row["verdict"] == "exact" for row in rows)
        corrections = [row["correction"] for row in rows if "correction" in row]
        assert corrections
        assert {one["power"] for one in corrections} == {power}
        coefficients.append([one["coefficient"] for one in corrections])
    assert coefficients[0] == pytest.approx(coefficients[1], rel=0.1)


@pytest.mark.slow
def test_a_state_of_a_closed_form_has_its_time() -> None:
    found = compare_schemes(load_experiment(HK, ["N=2000"]), ["hk", "exact"])
    hk, exact = of(found, "hk"), of(found, "exact")
    assert not hk["closed_form"]
    assert exact["closed_form"]
    assert 300.0 < exact["nanoseconds_per_step"] < 1e5  # no state costs 4 ns


@pytest.mark.slow
def test_the_reference_swings_at_the_rows_of_the_finest_entry() -> None:
    """Its spacing is found to fourth order in the distance of the rows: coarse ones alone see another."""
    experiment = load_experiment("kowalevski_generic_hk", ["N=600", "h=0.1"])

    def spacing(*entries: str) -> float:
        return compare_schemes(experiment, entries).data["reference"]["first_swing_spacing"]

    coarse, fine = spacing("hk:h=0.3"), spacing("hk")
    assert abs(coarse - fine) > 1e-5
    assert spacing("hk", "hk:h=0.3") == spacing("hk:h=0.3", "hk") == fine


FREE = {"top": {"kind": "euler", "A": 3.0, "B": 2.0, "C": 1.0}, "initial": {"omega": [0.3, 0.4, 1.5]}}


FREE_RUN = {**FREE, "name": "free", "scheme": "hk", "h": 0.1, "N": 300}


REFERENCES = {"taylor": "Taylor series in double-double arithmetic", "exact": "closed form (scheme exact)"}


@pytest.mark.slow
@pytest.mark.parametrize("kind", REFERENCES)
def test_errors_are_against_the_reference_that_is_asked_for(kind: str) -> None:
    """The scheme ``exact`` differs from the series, and not from itself, so that it shows which reference was used."""
    run = topcli.compare("hk", "exact", config=FREE_RUN, reference=kind, progress=False)
    assert run.figures["reference"]["method"] == REFERENCES[kind]
    itself = run.figures["schemes"][1]["max_error"]
    assert (itself <= 2.0**-53) == (kind == "exact")  # row 0 is the initial state itself
    assert itself < 1e-13


@pytest.mark.slow
@pytest.mark.parametrize("kind", REFERENCES)
def test_every_output_names_the_reference_that_was_used(
    cli: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("free.json").write_text(json.dumps({key: one for key, one in FREE_RUN.items() if key != "name"}))
    Path("free.yaml").write_text(Path("free.json").read_text())
    command = ("compare", "hk", "--config", "free.yaml", "--reference", kind)
    wanted = f"Errors are norms of the difference of states from the reference, a {REFERENCES[kind]}."
    said = cli(*command, "--save", "saved.json")
    assert said.code == 0
    assert [line for line in said.out.splitlines() if line.startswith(wanted)]
    stored = json.loads(Path("saved.json").read_text())["reference"]
    assert (stored["kind"], stored["method"]) == (kind, REFERENCES[kind])
    assert cli(*command, "--json").json()["reference"] == stored
    assert cli("report", "saved.json", "--out", "page.html").code == 0
    topcli.compare("hk", config=FREE_RUN, reference=kind, progress=False).save("python.html")
    for page in ("page.html", "python.html"):
        text = Path(page).read_text()
        assert [one for one in read_html(text).with_class("caption") if one.text.startswith(wanted)]
        assert REFERENCES["exact" if kind == "taylor" else "taylor"] not in text


def test_a_closed_form_that_a_top_does_not_have_is_refused(cli: Callable[..., Any]) -> None:
    said = cli("compare", "hk", "--config", "heavy_hk", "--set", "N=10", "--reference", "exact")
    assert (said.code, said.out) == (2, "")
    assert "the top heavy has no scheme exact to compare with; use the reference taylor" in said.err
    with pytest.raises(UsageError, match="unknown reference 'theta'; use taylor or exact"):
        topcli.compare("hk", config=FREE_RUN, reference="theta")
