"""Runs in another precision than double: reports, series, comparison."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import topcli
from conftest import Said
from topcli import simulate
from topcli.analysis.algebraic_growth import digit_growth
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.runs.report import precision_note
from topcli.runs.run import run_experiment
from topcli.store.series import read_series

EULER = ("precision=rational", "h=1/10", "N=12")


def precise(scene: str, *overrides: str) -> Experiment:
    return load_experiment(scene, overrides, any_precision=True)


def test_report_holds_deviations_of_the_precision(tmp_path: Path) -> None:
    experiment = precise("kowalevski_hybrid", "precision=50", "h=0.01", "N=20")
    result = run_experiment(experiment, tmp_path)
    rows = {row["name"]: row for row in result.report["invariants"]}
    assert 0.0 < rows["k_sq"]["max_deviation"] < 1e-47
    assert rows["k_sq"]["verdict"] == rows["gamma_sq"]["verdict"] == "exact"
    assert rows["k_sq"]["first"] == pytest.approx(9.000003, rel=1e-9)
    assert result.report["precision"] == 50
    assert precision_note(result.report) == "computed with 50 digits"
    series = read_series(result.stored.series)
    assert series["omega1"].tolist() == simulate(experiment.resolved())["omega1"].tolist()


OSCILLATOR = {
    "top": {"kind": "custom", "components": ["x", "v"], "field": {"x": "v", "v": "-x"}},
    "initial": {"x": 1, "v": 0},
    "scheme": "rk4",
    "h": 0.25,
    "N": 40,
}


@pytest.mark.slow
@pytest.mark.parametrize("formula", ["sqrt(x)", "log(v)", "x**-1.5", "1/v", "1/(t - 0.25)", "log(x - x)", "1/(v - v)"])
def test_quantities_without_a_value_are_not_finite(formula: str, tmp_path: Path, library: str) -> None:
    """At the rows where a double is not finite, in numbers and in texts."""
    plain = simulate(OSCILLATOR | {"output": {"quantities": {"q": formula}}})["q"]
    assert not np.isfinite(plain).all()
    output = {"quantities": {"q": formula}}
    config = OSCILLATOR | {"precision": 40, "output": output}
    result = run_experiment(load_experiment(config, any_precision=True), tmp_path)
    series = read_series(result.stored.series)
    finite = np.isfinite(plain)
    assert series["q"][finite] == pytest.approx(plain[finite], rel=1e-9)
    assert not np.isfinite(series["q"][~finite]).any()


WRITTEN = {
    "a fraction": ["h=1/3"],
    "backwards": ["h=-1/7"],
    "many digits": ["h=0.12345678901234567890123456789"],
    "parameters": ["top.A=8/3", "top.C=1.00000000000000000000001", "h=1/7"],
    "states": ["initial.omega=[1/3, -4/7, 1.30000000000000000000000001]", "h=1/16"],
}


@pytest.mark.slow
@pytest.mark.parametrize("precision", [30, "rational"])
@pytest.mark.parametrize("numbers", WRITTEN)
def test_runs_are_intact_however_numbers_are_written(
    precision: int | str, numbers: str, cli: Callable[..., Said]
) -> None:
    words = [word for text in (f"precision={precision}", *WRITTEN[numbers], "N=4") for word in ("--set", text)]
    run = ("run", "euler_hk", *words, "--set", "name=written")
    assert cli(*run).err.splitlines()[0].endswith("(ran)")
    assert cli(*run).err.splitlines()[0].endswith("(up to date)")
    assert cli("verify", "results/written").code == 0
    assert cli("run", "results/written/config.yaml").err.splitlines()[0].endswith("(up to date)")
    if numbers == "a fraction":
        page = cli("report", "results/written", "--out", "page.html")
        assert (page.code, page.err) == (0, "wrote page.html\n")


def test_conserved_by_the_algebra_or_by_luck() -> None:
    # near the separatrix the hybrid keeps 2l to 1e-17 over this run: round-off, to a judge in doubles
    trajectory = simulate("kowalevski_hybrid", precision=50, h=0.01, N=60)
    plain = simulate("kowalevski_hybrid", h=0.01, N=60)
    precise, doubles = ({row.name: row.verdict for row in one.invariant_rows()} for one in (trajectory, plain))
    assert (precise["k_sq"], precise["two_l"]) == ("exact", "undecided")
    assert doubles["two_l"] == "exact"
    assert trajectory.states == pytest.approx(plain.states, abs=1e-14)


def test_rational_report_states_equality_and_growth(tmp_path: Path) -> None:
    report = run_experiment(precise("euler_hk", *EULER), tmp_path).report
    rows = {row["name"]: row for row in report["invariants"]}
    assert rows["modified_m_sq"]["reason"] == "equal at all 13 rows"
    assert rows["modified_m_sq"]["verdict"] == "exact"
    assert rows["m_sq"]["verdict"] != "exact"
    assert "equal" not in rows["m_sq"]["reason"]
    growth = report["digit_growth"]
    assert growth["law"] == "polynomial"
    assert growth["power"] == pytest.approx(2.0, abs=0.15)
    assert growth["step"] == 12


def test_run_stops_at_max_digits(cli: Callable[..., Said]) -> None:
    gamma = "initial.gamma=[0.6, 0, 0.8]"
    sets = [text for one in (*EULER, gamma, "max_digits=2000", "name=x") for text in ("--set", one)]
    said = cli("run", "kowalevski_hk", *sets)
    assert said.code == 1
    assert "have more digits than max_digits" in said.err
    assert "the bits grow exponentially" in said.err
    report = json.loads(Path("results/x/report.json").read_text())
    assert report["outcome"] == "digit_limit"
    assert report["digit_growth"]["factor"] > 3.0
    assert report["digit_growth"]["bits"] < 2000 * 3.33


@pytest.mark.parametrize("law", ["polynomial", "exponential"])
def test_growth_law(law: str) -> None:
    n = np.arange(41)
    bits = 30 + 17 * n**2 if law == "polynomial" else np.round(40 * 1.5**n).astype(np.int64)
    found = digit_growth(n, bits)
    assert found is not None
    assert found.law == law
    if law == "polynomial":
        assert found.power == pytest.approx(2.0, abs=0.02)
    else:
        assert found.factor == pytest.approx(1.5, abs=1e-3)
    few = digit_growth(n[:3], bits[:3])
    assert few is not None
    assert (few.law, few.bits) == (None, bits[2])


@pytest.mark.slow
def test_comparison_shows_the_defects_of_the_precision(library: str) -> None:
    def deviations(*sets: str) -> dict[str, float]:
        report = topcli.compare("hk", "bohlin-a", config="kowalevski_generic_hk", overrides=["h=0.1", "N=20", *sets])
        return {row["scheme"]: row["max_deviation"] for row in report.tables[3].rows if row["invariant"] == "k²"}

    precise_ones, plain = deviations("precision=50"), deviations()
    assert precise_ones["bohlin-a"] < 1e-47
    assert precise_ones["hk"] == pytest.approx(plain["hk"], rel=1e-9)
    assert plain["hk"] > 1e-4


REVERSIBLE = {"hk": True, "midpoint": True, "rk4": False}


@pytest.mark.slow
@pytest.mark.parametrize("digits", [30, 50])
def test_reversal_is_measured_in_the_digits_of_the_run(digits: int, library: str) -> None:
    """In doubles the defect of a reversible scheme would be 1e-17; that of RK4 is of order 6 down to any size."""
    sets = [f"precision={digits}", "h=1/1000", "N=4"]
    report = topcli.compare(*REVERSIBLE, config="kowalevski_generic_hk", overrides=sets)
    for row, reversible in zip(report.tables[0].rows, REVERSIBLE.values(), strict=True):
        if reversible:
            assert row["its_order"] is None
            assert row["reversal_defect"] < 100.0 * 10.0**-digits
        else:
            assert row["its_order"] == pytest.approx(6.0, abs=0.01)
            assert 1e-22 < row["reversal_defect"] < 1e-18


def test_reversal_in_rational_numbers_is_exact(cli: Callable[..., Said]) -> None:
    """Few digits are allowed for the run, and do not limit the steps that are tried."""
    sets = ("precision=rational", "h=1/10", "N=2", "initial.gamma=[3/5, 0, 4/5]", "max_digits=200")
    words = [word for text in sets for word in ("--set", text)]
    hk, rk2 = cli("compare", "hk", "rk2", *words, "--json").json()["tables"][0]["rows"]
    assert (hk["reversal_defect"], hk["its_order"]) == (0.0, None)
    assert 1e-6 < rk2["reversal_defect"] < 1e-2
    assert rk2["its_order"] == pytest.approx(4.0, abs=0.2)


def test_long_runs_are_warned_of(cli: Callable[..., Said]) -> None:
    said = cli("run", "euler_hk", "--set", "precision=50", "--set", "N=2000000", "--dry-run")
    assert said.code == 0
    assert "2000000 steps in precision 50 take 20 s to 5:33:20 h" in said.err
    assert "warning" not in cli("run", "euler_hk", "--set", "precision=50", "--dry-run").err
