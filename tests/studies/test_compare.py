"""Comparisons: what is measured of each scheme, against what is known of the paper's scene."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import topcli
from conftest import GEN, PAPER, ROOT, random_states
from steppers import RK2
from topcli.analysis.swings import swing_spacing
from topcli.config.load import load_experiment
from topcli.engine.loop import Run
from topcli.errors import UsageError
from topcli.schemes.registry import find_scheme
from topcli.studies.compare import compare_schemes
from topcli.studies.entries import under_scheme
from topcli.studies.study import Result
from topcli.tops.kowalevski import Kowalevski

HK = ROOT / "configs" / "kowalevski_hk.yaml"
FIVE = ("hk", "bohlin-a", "bohlin-b", "bohlin-c", "hybrid")


@pytest.fixture(scope="module")
def paper() -> Result:
    """The paper's scene under the paper's five schemes."""
    return compare_schemes(load_experiment(HK), FIVE)


def of(comparison: Result, scheme: str) -> dict:
    return next(one for one in comparison.data["schemes"] if one["scheme"] == scheme)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scheme", "spacing"),
    [("hk", 28.172), ("hybrid", 28.167), ("bohlin-a", 15.30), ("bohlin-b", 15.35), ("bohlin-c", 15.30)],
)
def test_spacing_of_the_swings(paper: Result, scheme: str, spacing: float) -> None:
    """HK and the hybrid keep the period; the schemes of order 1 halve it, being of order 1 near a separatrix."""
    assert of(paper, scheme)["swing_spacing"] == pytest.approx(spacing, abs=6e-3 if spacing < 20 else 1e-3)


def test_the_reference_swings_as_the_theory_says(paper: Result) -> None:
    """Half the period is sqrt 2 ln(8 sqrt 7/eps) to leading order in eps = gamma3(0), the first swing at 14.086."""
    spacing = paper.data["reference"]["swing_spacing"]
    assert spacing == pytest.approx(28.171, abs=1e-3)
    assert spacing / 2 == pytest.approx(math.sqrt(2) * math.log(8 * math.sqrt(7) / 1e-3), abs=2e-3)
    assert of(paper, "hk")["swing_times"][0] == pytest.approx(14.086, abs=1e-3)


def test_irreversibility_alone_does_not_halve_the_period() -> None:
    """The explicit midpoint rule is irreversible too, and of order 2: it keeps the period."""
    states = Run(Kowalevski(), RK2, PAPER, 1e-3, 50_000).collect().states
    assert swing_spacing(np.arange(50_001) * 1e-3, states[:, 3]) == pytest.approx(28.170, abs=1e-3)


def largest_jump(branch: str, y0: np.ndarray, h: float) -> float:
    """The largest change of omega1, omega2 in one step of Bohlin A, up to t = 20."""
    scheme = find_scheme("bohlin-a", "kowalevski")
    run = Run(Kowalevski(), scheme.build(Kowalevski(), scheme.options(branch=branch)), y0, h, round(20 / h))
    states = run.collect().states
    return float(np.abs(np.diff(states[:, :2], axis=0)).max())


@pytest.mark.slow
def test_the_papers_branch_rule_takes_wrong_roots_and_the_default_none() -> None:
    """As omega1 + i omega2 crosses the real axis, the signs of the arguments mislead: omega jumps to -omega."""
    jumps = {
        branch: sum(largest_jump(branch, y0, 0.05) > 1.5 for y0 in random_states(200, seed=1))
        for branch in ("sign", "nearest")
    }
    assert jumps == {"sign": 2, "nearest": 0}


def test_verdicts_of_compared_schemes(paper: Result) -> None:
    verdicts = {scheme: {row["name"]: row["verdict"] for row in of(paper, scheme)["invariants"]} for scheme in FIVE}
    assert set(verdicts["hk"].values()) == {"bounded"}
    for scheme in FIVE[1:]:
        assert verdicts[scheme]["gamma_sq"] == verdicts[scheme]["k_sq"] == "exact"
    for scheme in ("bohlin-a", "bohlin-c"):
        assert verdicts[scheme]["energy"] == verdicts[scheme]["two_l"] == "drifting"


def test_reversal_defect_and_order_are_reported(paper: Result) -> None:
    """The paper calls the hybrid reversible: it misses by O(h⁴). Bohlin's schemes miss by O(h²), HK not at all."""
    assert of(paper, "hk")["reversal"]["order"] is None
    assert of(paper, "hk")["reversal"]["defect"] < 1e-15
    assert of(paper, "hybrid")["reversal"]["order"] == pytest.approx(4.0, abs=0.1)
    for scheme in ("bohlin-a", "bohlin-b", "bohlin-c"):
        assert of(paper, scheme)["reversal"]["order"] == pytest.approx(2.0, abs=0.1)


def test_errors_are_against_an_independent_reference(paper: Result) -> None:
    """The error of HK at the end of the run agrees with the distance from a run with a step four times smaller."""
    fine = topcli.simulate(HK, h=2.5e-4, N=200_000, output={"every": 200_000})
    coarse = topcli.simulate(HK, output={"every": 50_000})
    assert of(paper, "hk")["end_error"] == pytest.approx(np.linalg.norm(fine.states[-1] - coarse.states[-1]), rel=0.1)
    assert of(paper, "hk")["max_error"] == np.nanmax(paper.arrays["error:hk"])


def test_speed_and_series_are_reported(paper: Result) -> None:
    for scheme in FIVE:
        assert {"nanoseconds_per_step", "compile_seconds"} <= of(paper, scheme).keys()
        assert len(paper.arrays[f"error:{scheme}"]) == len(paper.arrays["t"]) == 50_001
    json.dumps(paper.data, allow_nan=False)


def test_options_belong_to_their_scheme() -> None:
    experiment = load_experiment(HK, ["scheme={name: hybrid, branch: sign}"])
    assert under_scheme(experiment, "Hybrid").options.model_dump() == {"branch": "sign"}
    assert under_scheme(experiment, "bohlin-a").options.model_dump() == {"branch": "nearest"}


@pytest.mark.slow
def test_a_scheme_that_blows_up_is_compared_as_far_as_it_went() -> None:
    experiment = load_experiment(
        HK,
        [
            "initial.omega=[0.01, 0, 3]",
            "initial.gamma=[1e-8, 0, -auto]",
            "scheme={name: bohlin-b, chart: single}",
            "h=0.1",
            "N=500",
        ],
    )
    comparison = compare_schemes(experiment, ["bohlin-b", "hk"])
    broken = of(comparison, "bohlin-b")
    assert broken["outcome"] == "blew_up"
    assert broken["end_error"] is None
    assert np.isnan(comparison.arrays["error:bohlin-b"][-1])
    assert of(comparison, "hk")["outcome"] == "completed"


@pytest.mark.slow
def test_pictures_of_a_comparison(tmp_path: Path) -> None:
    from topcli.figures.comparison import loaded_comparison
    from topcli.figures.figure import write_figure

    comparison = compare_schemes(load_experiment(HK, ["N=2000", "h=0.01"]), ["hk", "hybrid"])
    files = write_figure("compare", loaded_comparison(comparison), tmp_path)
    assert [file.name for file in files] == ["compare.png", "compare.pdf", "compare.parquet"]
    assert "error:hk" in pq.read_schema(files[-1]).names


def test_the_python_interface() -> None:
    trajectory = topcli.simulate(
        top={"kind": "kowalevski", "c0": 1.0},
        initial={"omega": GEN[:3], "gamma": GEN[3:]},
        scheme="hybrid",
        h=0.01,
        N=1000,
    )
    frame = trajectory.to_pandas()
    assert list(frame.columns[:3]) == ["n", "t", "omega1"]
    assert len(frame) == len(trajectory) == 1001
    assert (frame["k_sq"].to_numpy() == trajectory["k_sq"]).all()
    assert trajectory.invariants().loc["k_sq", "verdict"] == "exact"
    assert trajectory.ending.message == "completed 1000 steps (t = 10)"
    shorter = topcli.simulate("kowalevski_hk", overrides=["h=0.01"], N=10)
    assert shorter.t[-1] == 10 * 0.01


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "scheme", "power"), [("euler_hk", "hk", 2), ("lagrange_hk", "hk", 2), ("lagrange_bs", "bs", 1)]
)
def test_modified_integrals_differ_from_the_physical_by_a_term_of_the_order_of_the_scheme(scene, scheme, power) -> None:
    """The coefficient of h^p hardly depends on h, while the integral itself stays at round-off: at h and at h/4."""
    coefficients = []
    for h in (0.02, 0.005):
        comparison = compare_schemes(load_experiment(scene, [f"h={h}", "N=4000"]), [scheme])
        rows = of(comparison, scheme)["modified"]
        assert all(row["verdict"] == "exact" for row in rows)
        corrections = [row["correction"] for row in rows if "correction" in row]
        assert corrections
        assert {one["power"] for one in corrections} == {power}
        coefficients.append([one["coefficient"] for one in corrections])
    assert coefficients[0] == pytest.approx(coefficients[1], rel=0.1)


def test_a_scheme_without_integrals_of_its_own_has_none() -> None:
    comparison = compare_schemes(load_experiment("euler_hk", ["N=100"]), ["hk", "bs"])
    assert of(comparison, "hk")["modified"]
    assert of(comparison, "bs")["modified"] == []


@pytest.mark.slow
def test_the_closed_form_as_the_reference() -> None:
    """It agrees with the Taylor series to round-off, of which it knows nothing; its own error is then nearly zero."""
    experiment = load_experiment(HK, ["N=2000", "h=0.01"])
    series = compare_schemes(experiment, ["hk", "exact"])
    closed = compare_schemes(experiment, ["hk", "exact"], reference="exact")
    assert series.data["reference"]["method"] == "Taylor series in double-double arithmetic"
    assert closed.data["reference"]["method"] == "closed form (scheme exact)"
    assert of(closed, "hk")["max_error"] == pytest.approx(of(series, "hk")["max_error"], rel=1e-9)
    assert 0.0 < of(series, "exact")["max_error"] < 1e-13
    assert of(closed, "exact")["max_error"] < 1e-16  # row 0 is the initial state itself
    assert np.abs(series.arrays["swing:reference"] - closed.arrays["swing:reference"]).max() < 1e-13


@pytest.mark.slow
def test_a_state_of_a_closed_form_and_its_set_up_have_their_times() -> None:
    found = compare_schemes(load_experiment(HK, ["N=2000"]), ["hk", "exact"])
    hk, exact = of(found, "hk"), of(found, "exact")
    assert (hk["closed_form"], hk["setup_seconds"]) == (False, None)
    assert exact["closed_form"]
    assert exact["setup_seconds"] >= 0.0
    assert 300.0 < exact["nanoseconds_per_step"] < 1e5  # no state costs 4 ns


def test_the_reference_swings_at_the_rows_of_the_finest_entry() -> None:
    """Its spacing is found to fourth order in the distance of the rows: coarse ones alone see another."""
    experiment = load_experiment("kowalevski_generic_hk", ["N=600", "h=0.1"])

    def spacing(*entries: str) -> float:
        return compare_schemes(experiment, entries).data["reference"]["swing_spacing"]

    coarse, fine = spacing("hk:h=0.3"), spacing("hk")
    assert abs(coarse - fine) > 1e-5
    assert spacing("hk", "hk:h=0.3") == spacing("hk:h=0.3", "hk") == fine


@pytest.mark.parametrize(
    ("config", "reference", "words"),
    [
        (HK, "theta", "unknown reference 'theta'; use taylor or exact"),
        ("heavy_hk", "exact", "the top heavy has no scheme exact to compare with; use the reference taylor"),
    ],
)
def test_a_reference_that_there_is_not(config: str, reference: str, words: str) -> None:
    with pytest.raises(UsageError, match=re.escape(words)):
        compare_schemes(load_experiment(config, ["N=10"]), ["hk"], reference=reference)
