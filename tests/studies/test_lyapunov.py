"""The study ``lyapunov``: its answers, refusals and tables, and the measures of sweeps."""

from __future__ import annotations

import re
from typing import Any

import pytest

import topcli
from orbits import LORENZ, of_field
from topcli.errors import TopcliError
from topcli.studies.report import Report


def orbit_of(report: Report) -> Any:
    return report.tables[1].rows[0]


def test_a_regular_orbit() -> None:
    report = topcli.lyapunov("kowalevski_generic_hk", ["N=20000"])
    assert (orbit_of(report)["verdict"], orbit_of(report)["T"]) == ("regular", 200.0)
    assert report.table.loc[1, "per unit of time"] == "0.028 ± 0.048"
    assert re.match(r"regular: .* no faster than in proportion to t; the run would", report.answer)
    assert report.columns["exponent_1"][-1] == pytest.approx(orbit_of(report)["growth"] / 200.0)


def test_a_chaotic_orbit_with_its_spectrum() -> None:
    overrides = ["scheme=hk", "h=0.05", "N=40000"]
    report, alone = (topcli.lyapunov("heavy_chaotic", overrides, spectrum=each) for each in (True, False))
    x, error = report.table["exponent"].to_list(), report.table["error"].to_list()
    assert orbit_of(report)["verdict"] == orbit_of(alone)["verdict"] == "chaotic"
    assert x == sorted(x, reverse=True)
    assert len(x) == 6
    assert x[0] > 10.0 * orbit_of(report)["regular_exponent"]
    assert abs(alone.table.loc[1, "exponent"] - x[0]) < 4.0 * (alone.table.loc[1, "error"] + error[0])


@pytest.mark.parametrize(
    ("config", "overrides", "discard", "words"),
    [
        ("kowalevski_hk", ["scheme=exact"], None, "scheme 'exact' is a solution in closed form"),
        ("kowalevski_hk", ["N=999"], None, "N = 999: too few steps for an exponent; take at least 1000"),
        ("kowalevski_ensemble", [], None, "a single trajectory is needed"),
        ("kowalevski_generic_hk", ["N=4000"], 41.0, "--discard 41: must be a time from 0 to T = 40"),
        ("kowalevski_generic_hk", ["N=4000"], 30.5, "N = 4000 after --discard 30.5: too few steps"),
    ],
)
def test_refusals(config: str, overrides: list[str], discard: float | None, words: str) -> None:
    with pytest.raises(TopcliError, match=words):
        topcli.lyapunov(config, overrides, discard=discard)


def test_an_orbit_that_breaks_off_is_a_failure() -> None:
    report = topcli.lyapunov("lagrange_hk", ["scheme=rk2", "h=1", "N=1000"])
    assert (orbit_of(report)["verdict"], report.code, report.draw) == ("broke off", 1, None)
    assert report.tables[0].cells().lines == [["1", "–", "–", "–"]]
    (step,) = map(int, re.findall(r"broke off at or soon after step (\d+): it blew up", report.errors[0]))
    failed = topcli.simulate("lagrange_hk", ["scheme=rk2", "h=1", "N=1000"]).ending.step
    assert step <= failed <= step + 20


ANSWERS = {
    "separatrix": (
        "euler_hk",
        "initial.omega=[1e-6,1,1e-6] h=0.05 N=200000",
        r"regular: .* exp\(15.\d\) over T = 10000, but not exponentially: it fell back, or came to an end; the run",
    ),
    "chaotic": ("heavy_chaotic", "", r"chaotic: the largest exponent is 0\.2\d ± 0\.\d\d \(95 %\) per unit of time, "),
    "undecided": ("heavy_chaotic", "N=5500", r"undecided: .*, as on a regular or a weakly chaotic orbit; run longer"),
    "deep": (
        "euler_hk",
        "initial.omega=[1e-9,1,1e-9] h=0.2 N=200000",
        r"undecided: .*, with falls by factors down to exp\(-\d\d\), as next to a separatrix",
    ),
    "unstable": (
        "clebsch_gentle",
        "initial.m=[1e-6,0,0] initial.p=[0,0,1] scheme=midpoint h=0.05",
        r"unstable: .*exp\(1627.*, at a rate of 1\.627 ± 0\.013, but the orbit repeats itself",
    ),
}


@pytest.mark.parametrize("name", ANSWERS)
def test_answers(name: str) -> None:
    config, overrides, words = ANSWERS[name]
    assert re.match(words, topcli.lyapunov(config, overrides.split()).answer)


def test_a_transient_is_left_out_and_noted() -> None:
    """Lorenz's system from the neighbourhood of a spiral; --discard 0 includes it, and --discard skips a given time."""
    config = of_field(LORENZ, (0.0, 10.0, 0.0), "rk4", 0.01, 40_000).resolved()
    reports = [topcli.lyapunov(config, discard=discard) for discard in (None, 0.0, 60.0)]
    default, whole, late = map(orbit_of, reports)
    (note,) = reports[0].notes
    assert note.startswith(f"the exponents leave out the first {default['transient']:g} of T = 400, in which")
    assert 25.0 <= default["transient"] <= 75.0
    assert (whole["transient"], late["transient"], late["discarded"], late["T"]) == (0.0, 0.0, 60.0, 340.0)
    assert not [*reports[1].notes, *reports[2].notes]
    assert {orbit["completed_steps"] for orbit in (default, whole, late)} == {40_000}
    first = [report.table.loc[1] for report in reports]
    for row in (first[0], first[2]):
        assert row["exponent"] == pytest.approx(0.9056, abs=row["error"])
        assert row["error"] < 0.5 * first[1]["error"]
    assert first[1]["exponent"] < 0.88
