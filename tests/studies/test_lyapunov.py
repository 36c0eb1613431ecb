"""The study ``lyapunov``: its answer in the terminal and in JSON, the measures of sweeps."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import topcli
from steppers import built
from topcli.analysis.lyapunov import LEAST_STEPS, growth_of
from topcli.config.load import load_experiment
from topcli.errors import TopcliError
from topcli.figures.chaos import loaded_lyapunov
from topcli.studies.lyapunov import LYAPUNOV, measure

REGULAR = ("kowalevski_generic_hk", ["N=20000"])
CHAOTIC = ("heavy_chaotic", ["scheme=hk", "h=0.05", "N=40000"])


def test_a_regular_orbit() -> None:
    report = topcli.lyapunov(REGULAR[0], overrides=REGULAR[1])
    study = report.study
    experiment = load_experiment(*REGULAR)
    method = built("hk", experiment.top)
    growth = growth_of(experiment.top, experiment.scheme, method, 0.01, 20_000, np.array([experiment.y0]))
    assert study["verdict"] == "regular"
    assert study["exponents"] == growth.exponents.tolist()
    assert study["T"] == 200.0
    assert study["exponents"][0] < study["detectable"]
    assert list(report.table["exponent"]) == study["exponents"]


def test_a_chaotic_orbit_with_its_spectrum() -> None:
    report = topcli.lyapunov(CHAOTIC[0], overrides=CHAOTIC[1], spectrum=True)
    x = report.study["exponents"]
    assert report.study["verdict"] == "chaotic"
    assert x == sorted(x, reverse=True)
    assert len(x) == 6
    assert x[0] > 10.0 * report.study["regular_exponent"]
    alone = topcli.lyapunov(CHAOTIC[0], overrides=CHAOTIC[1]).study
    assert abs(alone["exponents"][0] - x[0]) < 4.0 * (alone["errors"][0] + report.study["errors"][0])


def test_command(cli) -> None:
    shown = cli("lyapunov", REGULAR[0], "--set", REGULAR[1][0])
    assert "per unit of time" in shown.out
    assert "would have detected an exponent above" in shown.out + shown.err


@pytest.mark.parametrize(
    ("config", "overrides", "words"),
    [
        ("kowalevski_hk", ["scheme=exact"], "scheme 'exact' is a solution in closed form"),
        ("heavy_hk", ["scheme=dop853"], "scheme 'dop853' calls library functions"),
        ("kowalevski_hk", ["N=999"], "N = 999: too few steps for an exponent; take at least 1000"),
        ("kowalevski_ensemble", [], "a single trajectory is needed"),
    ],
)
def test_refusals(config: str, overrides: list[str], words: str) -> None:
    with pytest.raises(TopcliError, match=words):
        measure(config, overrides=overrides)


def test_an_orbit_that_broke_off_is_a_failure() -> None:
    result = measure("lagrange_hk", overrides=["scheme=rk2", "h=1", "N=1000"])
    assert result.data["verdict"] == "broke off"
    faults = LYAPUNOV.faults(result.data)
    assert faults.code == 1
    (step,) = map(int, re.findall(r"broke off at or soon after step (\d+): it blew up", faults.lines[0]))
    failed = topcli.simulate("lagrange_hk", ["scheme=rk2", "h=1", "N=1000"]).ending.step
    assert step <= failed <= step + 20
    assert not loaded_lyapunov(result).panels


def test_measures_of_a_sweep(tmp_path: Path) -> None:
    """A row has the numbers of the study; a row that fails has none."""
    sweep = {
        "base": {"top": "kowalevski", "initial": {"omega": [2, 0.5, 0.3], "gamma": [0.6, 0, 0.8]}, "N": 4000},
        "grid": {"scheme": ["hk", "rk2"], "h": [0.1, 0.6]},
        "measure": ["lyapunov", "chaotic"],
    }
    table = topcli.sweep(sweep, tmp_path).table
    for _, row in table.iterrows():
        config = {**sweep["base"], "scheme": row["scheme"], "h": row["h"]}
        study = measure(config).data
        if row["outcome"] != "completed":
            assert np.isnan(row["lyapunov"])
            continue
        assert row["lyapunov"] == study["exponents"][0]
        assert {1.0: "chaotic", 0.0: "regular"}.get(row["chaotic"], "undecided") == study["verdict"]
    assert set(table["chaotic"]) & {0.0, 1.0}


ROWS = {
    "base": {"top": "heavy", "scheme": "hk", "h": 0.05, "N": 1200, "initial": {}},
    "random": {"count": 200, "seed": 3, "omega": {"sphere": 2.0}, "gamma": "sphere"},
    "measure": ["lyapunov", "chaotic"],
}


@pytest.mark.slow
def test_a_row_of_a_sweep_does_not_depend_on_the_other_rows(tmp_path: Path) -> None:
    """Bit for bit that of the same state alone, and of a sweep over fewer states."""
    table = topcli.sweep(ROWS, tmp_path, progress=False).table
    fewer = {**ROWS, "name": "fewer", "random": {**ROWS["random"], "count": 137}}
    assert table["lyapunov"][:137].tolist() == topcli.sweep(fewer, tmp_path, progress=False).table["lyapunov"].tolist()
    for _, row in table.iloc[[0, 1, 77, 199]].iterrows():
        initial = {name: [row[f"drawn.initial.{name}{i}"] for i in (1, 2, 3)] for name in ("omega", "gamma")}
        assert measure({**ROWS["base"], "initial": initial}).data["exponents"][0] == row["lyapunov"]


def test_a_row_of_too_few_steps_has_no_measure(tmp_path: Path) -> None:
    """Not even "not chaotic", where the command refuses to answer."""
    sweep = {**ROWS, "base": {**ROWS["base"], "N": LEAST_STEPS - 1}}
    table = topcli.sweep(sweep, tmp_path, progress=False).table
    assert (table["outcome"] == "completed").all()
    assert table[["lyapunov", "chaotic"]].isna().all().all()


@pytest.mark.parametrize("settings", [["scheme=dmv", "h=0.6"], ["scheme=hybrid-sym", "h=2"]])
def test_an_orbit_with_a_step_that_does_not_converge_breaks_off(settings: list[str]) -> None:
    """Of these runs a step in the middle of a block fails, and later ones do not."""
    result = measure(REGULAR[0], overrides=[*settings, "N=2000"])
    assert result.data["verdict"] == "broke off"
    assert result.data["exponents"] == [None]


ANSWERS = {
    "regular": ("kowalevski_generic_hk", ["N=20000"], r"regular: .* no faster than in proportion to t; the run would"),
    "separatrix": (
        "euler_hk",
        ["initial.omega=[1e-6, 1, 1e-6]", "h=0.05", "N=200000"],
        r"regular: .* exp\(15.\d\) over T = 10000, but not exponentially: it fell back, or came to an end; the run",
    ),
    "chaotic": ("heavy_chaotic", [], r"chaotic: the largest exponent is 0\.2\d ± 0\.\d\d \(95 %\) per unit of time, "),
    "undecided": ("heavy_chaotic", ["N=5500"], r"undecided: .*, as on a regular or a weakly chaotic orbit; run longer"),
    "deep": (
        "euler_hk",
        ["initial.omega=[1e-9, 1, 1e-9]", "h=0.2", "N=200000"],
        r"undecided: .*, with falls by factors down to exp\(-\d\d\), as next to a separatrix",
    ),
    "unstable": (
        "clebsch_gentle",
        ["initial.m=[1e-6,0,0]", "initial.p=[0,0,1]", "scheme=midpoint", "h=0.05"],
        r"unstable: .*exp\(1627.*, at a rate of 1\.627 ± 0\.013, but the orbit repeats itself",
    ),
    "saddle": (
        "euler_hk",
        ["initial.omega=[0, 1, 0]", "h=0.05"],
        r"equilibrium: the orbit is at rest, and unstable: .* at a rate of 0\.5774 ± 0\.00\d\d",
    ),
    "centre": ("euler_hk", ["initial.omega=[1, 0, 0]"], r"equilibrium: the orbit is at rest, and not unstable, as far"),
}


@pytest.mark.parametrize("name", ANSWERS)
def test_answers(name: str) -> None:
    config, overrides, words = ANSWERS[name]
    data = measure(config, overrides).data
    assert re.match(words, LYAPUNOV.answer(data))
    assert LYAPUNOV.answer(data).startswith(data["verdict"])


def test_an_escape_has_an_answer_and_no_fault() -> None:
    top = {"kind": "custom", "components": ["x"], "field": {"x": "0.1*x"}}
    data = measure({"name": "escape", "top": top, "initial": {"x": 1}, "scheme": "rk4", "h": 0.1, "N": 3000}).data
    assert LYAPUNOV.answer(data).startswith("escaping: the tangent vector grew by a factor exp(30.0) over T = 300, ")
    assert not LYAPUNOV.faults(data).code


def test_a_transient_is_left_out_and_noted() -> None:
    """Lorenz's system from the neighbourhood of a spiral; --discard 0 includes it, and --discard skips a given time."""
    field = {"x": "10*(y - x)", "y": "28*x - y - x*z", "z": "x*y - 8/3*z"}
    top = {"kind": "custom", "components": ["x", "y", "z"], "field": field}
    config = {"name": "l", "top": top, "initial": {"x": 0, "y": 10, "z": 0}, "scheme": "rk4", "h": 0.01, "N": 40_000}
    default, whole, late = (measure(config, discard=discard).data for discard in (None, 0.0, 60.0))
    (note,) = LYAPUNOV.notes(default)
    assert note.startswith(f"the exponents leave out the first {default['transient']:g} of T = 400, in which")
    assert 25.0 <= default["transient"] <= 75.0
    assert (whole["transient"], late["transient"], late["discarded"], late["T"]) == (0.0, 0.0, 60.0, 340.0)
    assert not LYAPUNOV.notes(whole) + LYAPUNOV.notes(late)
    for data in (default, late):
        assert data["exponents"][0] == pytest.approx(0.9056, abs=data["errors"][0])
        assert data["errors"][0] < 0.5 * whole["errors"][0]
    assert whole["exponents"][0] < 0.88


@pytest.mark.parametrize(
    ("discard", "words"),
    [(-1.0, "--discard -1: must be a time from 0 to T = 40"), (41.0, "to T = 40"), (30.5, "N = 4000 after --discard")],
)
def test_times_that_cannot_be_discarded(discard: float, words: str) -> None:
    with pytest.raises(TopcliError, match=words):
        measure("kowalevski_generic_hk", ["N=4000"], discard=discard)
