"""Series from elsewhere, judged like a run: exact motions, known defects, and runs of topcli itself."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from cases import table_of
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.errors import UsageError
from topcli.runs.run import run_experiment
from topcli.store.foreign import ForeignSeries
from topcli.studies.analyse_series import analyse_series, column_map
from topcli.studies.study import Result

SYMMETRIC: dict[str, Any] = {
    "top": {"kind": "euler", "A": 2.0, "B": 2.0, "C": 1.0},
    "initial": {"omega": [0.5 * math.cos(1.0), 0.5 * math.sin(1.0), 2.0]},
    "scheme": "hk",
    "h": 0.01,
    "N": 100,
}
"""A symmetric body: its first two components turn with the rate (A - C) omega3 / A = 1."""


def motion(t: np.ndarray) -> dict[str, np.ndarray]:
    """The exact motion of the symmetric body."""
    turn = t - 1.0
    return {"t": t, "omega1": 0.5 * np.cos(turn), "omega2": -0.5 * np.sin(turn), "omega3": np.full(len(t), 2.0)}


def analysed(
    folder: Path, data: dict[str, np.ndarray], experiment: Experiment | None = None, steps: int | None = None
) -> Result:
    path = folder / "series.parquet"
    pq.write_table(pa.table(data), path)
    return analyse_series(experiment or load_experiment(SYMMETRIC), ForeignSeries(path), {}, steps)


def refusal(folder: Path, data: dict[str, np.ndarray], experiment: Experiment | None = None) -> str:
    with pytest.raises(UsageError) as caught:
        analysed(folder, data, experiment)
    message = str(caught.value)
    assert "\n" not in message
    return message.removeprefix(f"{folder / 'series.parquet'}: ")


EVEN = np.linspace(0.0, 20.0, 2001)
TIMES = {
    "even": EVEN,
    "uneven": EVEN + 0.003 * np.sin(7.0 * EVEN) * EVEN * (20.0 - EVEN) / 100.0,
    "backward": -EVEN,
    "uneven backward": -(EVEN**1.2),
}


@pytest.mark.parametrize("kind", TIMES)
def test_an_exact_motion_has_no_error_and_its_swings(tmp_path: Path, kind: str) -> None:
    t = TIMES[kind]
    report = analysed(tmp_path, motion(t)).data
    assert report["times"] == ("uneven" if "uneven" in kind else "even")
    assert (report["rows"], report["steps"], report["steps_from"]) == (2001, 2000, "rows - 1")
    assert report["max_error"] < 1e-14
    assert {row["verdict"] for row in report["invariants"]} == {"exact"}
    assert [row["first"] for row in report["invariants"]] == pytest.approx([5.0, 4.5])
    first = 1.0 - 1.5 * math.pi if "backward" in kind else 1.0 + 0.5 * math.pi
    turns = 2.0 * math.pi * math.copysign(1.0, t[-1])
    swing = report["swing"]
    count = 5 if kind == "uneven backward" else 3
    for times in (swing["times"], swing["reference_times"]):
        np.testing.assert_allclose(times, first + turns * np.arange(count), atol=1e-7)
    assert swing["component"] == "omega2"
    assert swing["first_swing_spacing"] == pytest.approx(2.0 * math.pi, abs=1e-7)
    assert swing["reference_first_swing_spacing"] == pytest.approx(2.0 * math.pi, abs=1e-7)


@pytest.mark.parametrize("kind", TIMES)
def test_a_spin_that_grows_is_measured(tmp_path: Path, kind: str) -> None:
    """omega3 gains 1e-4 t, which moves m.omega = 4.5 by (2 + 1e-4 t)^2 - 4, and the state by 1e-4 |t|."""
    data = motion(TIMES[kind])
    data["omega3"] = 2.0 + 1e-4 * data["t"]
    analysis = analysed(tmp_path, data)
    report = analysis.data
    end = float(data["t"][-1])
    assert report["final_error"] == pytest.approx(1e-4 * abs(end), rel=1e-9)
    assert report["max_error"] == report["final_error"]
    np.testing.assert_allclose(analysis.arrays["error"], 1e-4 * np.abs(data["t"]), atol=1e-13)
    row = report["invariants"][1]
    assert row["name"] == "m_omega"
    assert row["verdict"] == "drifting"
    assert row["max_deviation"] == pytest.approx(abs((2.0 + 1e-4 * end) ** 2 - 4.0), rel=1e-9)
    assert row["drift"] == pytest.approx(4e-4, rel=2e-3)
    assert row["drift_over_run"] == pytest.approx(row["drift"] * end)


def test_the_largest_error_may_be_in_the_middle(tmp_path: Path) -> None:
    """omega3 is off by at most 1e-3, at t = 10; the deviation of m.omega = 4.5 is that of its square."""
    off = 1e-3 * np.sin(math.pi * EVEN / 20.0)
    data = motion(EVEN)
    data["omega3"] = 2.0 + off
    analysis = analysed(tmp_path, data)
    assert analysis.data["max_error"] == pytest.approx(1e-3, rel=1e-9)
    assert analysis.data["final_error"] < 1e-13
    np.testing.assert_allclose(analysis.arrays["deviation:m_omega"], 4.0 * off + off**2, atol=1e-14)
    np.testing.assert_array_equal(analysis.arrays["swing"], data["omega2"])


def test_times_may_start_anywhere(tmp_path: Path) -> None:
    data = motion(EVEN)
    shifted = {**data, "t": data["t"] + 7.0}
    report = analysed(tmp_path, shifted).data
    assert (report["t_first"], report["t_last"]) == (7.0, 27.0)
    assert report["max_error"] < 1e-13
    np.testing.assert_allclose(report["swing"]["times"], 8.0 + 0.5 * math.pi + 2.0 * math.pi * np.arange(3), atol=1e-7)


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_the_reference_starts_from_the_config_if_the_first_row_agrees(tmp_path: Path, factor: float) -> None:
    """The allowance is 1e-6 of the largest component, 2: 2e-6."""
    off = factor * 2e-6
    data = motion(EVEN)
    data["omega3"] = data["omega3"] + off
    report = analysed(tmp_path, data).data
    about = report["reference"]
    assert about["difference"] == pytest.approx(off, rel=1e-6)
    assert about["start"] == ("config" if factor < 1.0 else "first row")
    # from the first row, omega1 and omega2 turn faster by off / 2: 0.5 * 20 * off / 2 after t = 20
    expected = off if factor < 1.0 else 5.0 * off
    assert report["final_error"] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_times_are_even_within_a_millionth_of_their_spacing(tmp_path: Path, factor: float) -> None:
    t = EVEN.copy()
    t[1000] += factor * 1e-6 * 0.01
    assert analysed(tmp_path, motion(t)).data["times"] == ("even" if factor < 1.0 else "uneven")


@pytest.mark.parametrize("factor", [0.9, 1.1])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_unit_vector_begins_with_unit_length_within_a_thousandth(tmp_path: Path, factor: float, sign: float) -> None:
    experiment = load_experiment({**SYMMETRIC, "initial": {**SYMMETRIC["initial"], "gamma": [0, 0, 1]}})
    data = motion(EVEN[:100])
    length = 1.0 + sign * factor * 1e-3
    gamma = {"gamma1": 0.6 * length, "gamma2": 0.0, "gamma3": 0.8 * length}
    data |= {name: np.full(100, value) for name, value in gamma.items()}
    if factor < 1.0:
        report = analysed(tmp_path, data, experiment).data
        assert next(row["first"] for row in report["invariants"] if row["name"] == "gamma_sq") == pytest.approx(
            length**2
        )
    else:
        message = refusal(tmp_path, data, experiment)
        assert message.startswith(f"row 1: gamma has length {length:.6g}, and euler takes a unit vector (within 0.001)")


def test_steps_decide_the_round_off_bound(tmp_path: Path) -> None:
    data = motion(EVEN)
    bounds = {}
    for name, extra, steps in (("rows", {}, None), ("n", {"n": 5 + 10 * np.arange(2001)}, None), ("given", {}, 9)):
        report = analysed(tmp_path, {**data, **extra}, steps=steps).data
        bounds[report["steps_from"], report["steps"]] = report["invariants"][1]["round_off_bound"]
        assert report["times"] == "even", name
    expected = {("rows - 1", 2000): 2000, ("column n", 20000): 20000, ("--steps", 9): 9}
    assert bounds == {key: pytest.approx(20.0 * 2.0**-52 * math.sqrt(n) * 4.5) for key, n in expected.items()}
    report = analysed(tmp_path, {**data, "n": np.sin(EVEN)}).data  # another quantity of that name
    assert report["steps_from"] == "rows - 1"


@pytest.mark.parametrize(
    ("place", "value", "message"),
    table_of("""
4  0.3   row 5: t = 0.3 repeats that of row 4; times must differ
4  0.25  row 5: t = 0.25 after 0.3; times must be sorted (here: increase)
0  0.1   row 2: t = 0.1 repeats that of row 1; times must differ
"""),
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_wrong_times_are_named(tmp_path: Path, place: int, value: float, message: str, sign: float) -> None:
    t = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    t[place] = value
    if sign < 0.0:
        message = message.replace("0.", "-0.").replace("increase", "decrease")
    assert refusal(tmp_path, motion(sign * t)) == message


def test_too_many_rows_and_endless_times_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    t = np.array([-1.7e308, 0.0, 1.7e308])
    assert refusal(tmp_path, motion(EVEN[:3]) | {"t": t}) == (
        "t from -1.7e+308 to 1.7e+308 is a time beyond double precision"
    )
    monkeypatch.setattr("topcli.store.foreign.MAX_ROWS", 2000)
    assert refusal(tmp_path, motion(EVEN)) == "more than 2000 rows, which do not fit in memory; write fewer"
    monkeypatch.setattr("topcli.store.foreign.MAX_ROWS", 2001)
    assert analysed(tmp_path, motion(EVEN)).data["rows"] == 2001


def test_wrong_columns_and_rows_are_named(tmp_path: Path) -> None:
    data = motion(EVEN)
    assert refusal(tmp_path, {name: values[:1] for name, values in data.items()}) == (
        "1 row; a series needs at least 2"
    )
    assert refusal(tmp_path, {**data, "omega2": np.where(EVEN == 0.02, np.nan, EVEN)}) == (
        "row 3: omega2 is not a finite number: 'nan'"
    )
    renamed = {"t": data["t"], "omega1": data["omega1"], "omega_2": data["omega2"], "x": data["omega3"]}
    assert refusal(tmp_path, renamed) == (
        "no columns omega2, omega3; did you mean 'omega_2' or 'omega1'?; --rename omega2=COLUMN names it"
    )
    with_gamma = load_experiment({**SYMMETRIC, "initial": {**SYMMETRIC["initial"], "gamma": [0, 0, 1]}})
    assert refusal(tmp_path, data, with_gamma) == (
        "no columns gamma1, gamma2, gamma3; the file has the state of 'euler', "
        "which a config with initial.omega alone describes"
    )
    inertial = load_experiment("lagrange_bs")
    body = data | {f"gamma{i}": np.ones(2001) for i in (1, 2, 3)}
    assert "the file has the state of 'lagrange', which" in refusal(tmp_path, body, inertial)
    assert analysed(tmp_path, body).data["unread"] == ["gamma1", "gamma2", "gamma3"]


def test_columns_are_renamed(tmp_path: Path) -> None:
    top = load_experiment(SYMMETRIC).top
    given = column_map(["t=time, omega1=w_x", "omega2=w_y"], top)
    assert given == {"t": "time", "omega1": "w_x", "omega2": "w_y"}
    path = tmp_path / "x.csv"
    data = motion(EVEN)
    np.savetxt(path, np.column_stack(list(data.values())), delimiter=",", header="time,w_x,w_y,omega3", comments="")
    assert analyse_series(load_experiment(SYMMETRIC), ForeignSeries(path), given).data["max_error"] < 1e-14


@pytest.mark.parametrize(
    ("text", "message"),
    table_of("""
omega1         --rename 'omega1': write NAME=COLUMN, such as omega1=w_x
omga1=w        --rename 'omga1=w': unknown name 'omga1'; did you mean 'omega1' or 'omega3'?
t=a,t=b        --rename 't=b': t is given twice
omega1=w       --rename omega1=w: {path} has no column 'w'; known: omega1, omega2, omega3, t
omega1=omega2  {path}: column 'omega2' is taken for omega1 and omega2; name one with --rename omega1=...
n=omega1       {path}: column 'omega1' is taken for omega1 and n; name one with --rename omega1=...
"""),
)
def test_wrong_renaming_is_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "x.parquet"
    pq.write_table(pa.table(motion(EVEN)), path)
    experiment = load_experiment(SYMMETRIC)
    with pytest.raises(UsageError) as caught:
        analyse_series(experiment, ForeignSeries(path), column_map([text], experiment.top))
    assert str(caught.value) == message.format(path=path)


def test_a_reference_out_of_reach_leaves_the_rest(tmp_path: Path) -> None:
    data = motion(EVEN)
    data["t"] = EVEN * 1e9
    analysis = analysed(tmp_path, data)
    message = analysis.data["reference"]["message"]
    assert message.startswith("the reference would need at least 1e+10 Taylor steps to reach t = 2e+10; at most ")
    assert analysis.data["max_error"] is None
    assert analysis.data["swing"]["reference_times"] is None
    assert {row["verdict"] for row in analysis.data["invariants"]} == {"exact"}
    assert set(analysis.arrays) == {"t", "swing", "deviation:m_sq", "deviation:m_omega"}


@pytest.mark.parametrize("kind", ["even", "uneven"])
def test_a_motion_that_leaves_its_energy_surface_is_reported(tmp_path: Path, kind: str) -> None:
    """The limit is 100 times the sum of the terms: omega3^2 = 450 at most, beside 0.5."""
    experiment = load_experiment("heavy_hk")
    y0 = dict(zip(experiment.top.components, experiment.y0, strict=True))
    data = {"t": TIMES[kind][:50], **{name: np.full(50, value) for name, value in y0.items()}}
    assert analysed(tmp_path, data, experiment).data["left_motion"] is None
    data["omega1"][40:] = 1e4
    assert analysed(tmp_path, data, experiment).data["left_motion"] == {"row": 41, "t": data["t"][40]}
    data["n"] = 10 * np.arange(50)
    data["t"] = data["n"] * experiment.h
    report = analysed(tmp_path, data, experiment).data
    assert report["times"] == "steps of the config's h"
    assert report["left_motion"] == {"row": 41, "t": data["t"][40]}


SAME_BITS = ("name", "symbol", "first", "min", "max", "max_deviation", "max_deviation_relative", "model", "verdict")
ROUNDED = ("rms_deviation", "rms_deviation_relative", "drift_error", "round_off_bound")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "sets"),
    [
        ("kowalevski_hk", ["N=20000"]),
        ("euler_hk", ["N=3000", "h=-0.01", "output.every=3", "output.format=csv"]),
        ("lagrange_bs", ["N=4001", "output.every=7"]),
    ],
)
def test_a_stored_run_gets_its_own_report(tmp_path: Path, scene: str, sets: list[str]) -> None:
    """Extremes, deviations and verdicts are the same bits; sums differ by the order of addition.

    The tolerance is 1e-12, of the value or, for slopes, of the standard error; most agree to the bit, the others to
    3e-16.
    """
    experiment = load_experiment(scene, sets)
    stored = run_experiment(experiment, tmp_path).stored
    report = analyse_series(experiment, ForeignSeries(stored.series), {}).data
    own = stored.report()
    assert (report["times"], report["steps_from"]) == ("steps of the config's h", "column n")
    assert report["steps"] == (experiment.N // experiment.output.every) * experiment.output.every
    assert report["reference"]["start"] == "config"
    assert report["reference"]["difference"] == 0.0
    for found, row in zip(report["invariants"], own["invariants"], strict=True):
        assert {key: found[key] for key in SAME_BITS} == {key: row[key] for key in SAME_BITS}
        for key in ROUNDED:
            assert found[key] == pytest.approx(row[key], rel=1e-12), key
        assert found["drift"] == pytest.approx(row["drift"], rel=0.0, abs=1e-12 * row["drift_error"])
    for key in ("top", "round_off_ulps", "significance", "lost"):
        assert report[key] == own[key]


@pytest.mark.parametrize(("change", "modified"), [({}, True), ({"h": 0.02}, False)])
def test_modified_integrals_need_the_steps_of_the_config(
    tmp_path: Path, change: dict[str, float], modified: bool
) -> None:
    """They depend on h: another program's rows, or another h, have none."""
    experiment = load_experiment(SYMMETRIC)
    stored = run_experiment(experiment, tmp_path).stored
    report = analyse_series(load_experiment({**SYMMETRIC, **change}), ForeignSeries(stored.series), {}).data
    names = [row["name"] for row in report["invariants"]]
    assert names[:2] == ["m_sq", "m_omega"]
    assert ("modified_m_sq" in names) == modified
