"""Runs in another precision than double: reports, series, comparison."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

import topcli
from conftest import Said
from topcli import simulate
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


def test_rational_report_states_equality(tmp_path: Path) -> None:
    report = run_experiment(precise("euler_hk", *EULER), tmp_path).report
    rows = {row["name"]: row for row in report["invariants"]}
    assert rows["modified_m_sq"]["reason"] == "equal at all 13 rows"
    assert rows["modified_m_sq"]["statement"] == "exact (equal at all 13 rows)"
    assert rows["m_sq"]["verdict"] != "exact"
    assert "equal" not in rows["m_sq"]["reason"]


def test_run_stops_at_max_digits(cli: Callable[..., Said]) -> None:
    gamma = "initial.gamma=[0.6, 0, 0.8]"
    sets = [text for one in (*EULER, gamma, "max_digits=2000", "name=x") for text in ("--set", one)]
    said = cli("run", "kowalevski_hk", *sets)
    assert said.code == 1
    assert "have more digits than max_digits" in said.err
    report = json.loads(Path("results/x/report.json").read_text())
    assert report["outcome"] == "digit_limit"
    said = cli("run", "kowalevski_hk", *sets, "--set", "h=1e-300", "--set", "max_digits=20")
    assert (said.code, "needs numbers of 997 binary digits, more than max_digits allows" in said.err) == (2, True)


REVERSIBLE = {"hk": True, "midpoint": True, "rk4": False}


@pytest.mark.slow
@pytest.mark.parametrize("digits", [30, 50])
def test_reversal_is_measured_in_the_digits_of_the_run(digits: int) -> None:
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


def test_integrals_with_conditions_are_judged_in_digits(tmp_path: Path) -> None:
    """The HK map of Volterra's gyrostat has an integral only for some parameters, which are decimals here."""
    report = run_experiment(precise("volterra_gentle", "precision=40", "N=30", "h=0.05"), tmp_path).report
    modified = [row["verdict"] for row in report["invariants"] if row["name"] not in ("m_sq", "energy")]
    assert modified == ["exact", "exact"]
