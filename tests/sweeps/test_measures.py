"""Measures: their numbers against closed forms and single runs, their names, and what does not fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
import pytest

import topcli
from cases import table_of
from sweeping import measured
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array, Stepper
from topcli.errors import RunError, UsageError
from topcli.runs.references import REFERENCES
from topcli.schemes.registry import find_scheme
from topcli.sweeps.measures import fitting_measures, measure, resolve_measures
from topcli.tops.euler import euler_field
from topcli.tops.kowalevski import Kowalevski

A, C, OMEGA = 2.0, 1.0, (0.3, 0.4, 1.5)
SYMMETRIC = {"top": {"kind": "euler", "A": A, "B": A, "C": C}, "initial": {"omega": list(OMEGA)}}
"""A symmetric free top: omega1 + i omega2 turns about the axis at the rate (A - C)/A omega3."""


def one(experiment: Experiment, name: str) -> float:
    return float(measured(experiment, [name])[name][0])


def symmetric(scheme: str, h: float, N: int, **more: Any) -> Experiment:
    return load_experiment({**SYMMETRIC, "scheme": scheme, "h": h, "N": N, **more})


def precession(t: Array) -> Array:
    """omega (m, 3) of the symmetric free top, by hand."""
    rate = (A - C) / A * OMEGA[2]
    turned = (OMEGA[0] + 1j * OMEGA[1]) * np.exp(-1j * rate * t)
    return np.stack([turned.real, turned.imag, np.full_like(t, OMEGA[2])], axis=1)


def test_swings_of_the_symmetric_top_come_once_per_period() -> None:
    period = 2.0 * math.pi / ((A - C) / A * OMEGA[2])
    found = measured(symmetric("exact", 0.01, 5000), ["swings", "median_swing_spacing", "first_swing_spacing"])
    assert found["median_swing_spacing"][0] == pytest.approx(period, rel=1e-7)
    assert found["first_swing_spacing"][0] == pytest.approx(period, rel=1e-7)
    # omega2 sinks first at the phase -pi/2, which is reached at t = (pi/2 + arg) / rate
    first = (math.pi / 2.0 + math.atan2(OMEGA[1], OMEGA[0])) * period / (2.0 * math.pi)
    assert found["swings"][0] == math.floor((50.0 - first - period / 4.0) / period) + 1
    few = measured(symmetric("exact", 0.01, 1000), ["swings", "median_swing_spacing", "first_swing_spacing"])
    assert [float(values[0]) for values in few.values()] == pytest.approx([1.0, math.nan, math.nan], nan_ok=True)


@pytest.mark.parametrize(("every", "seen"), [(400, True), (1047, False), (4200, False)])
def test_swings_are_refused_in_rows_too_few_to_show_them(every: int, seen: bool) -> None:
    """The period is 41.9: rows every 10.47 are four a period; every 42, they creep along the oscillation.

    Ten rows every 4 show it; those every 42 look smooth, and only the equations of motion tell that they skip periods.
    """
    slow = {"initial": {"omega": [0.3, 0.4, 0.3]}, "output": {"every": every}}
    found = measured(symmetric("exact", 0.01, 100 * every, **slow), ["swings"])
    if seen:
        assert (found["swings"][0], found.faults) == (9.0, [])
    else:
        reason = f"rows {every / 100:.3g} apart in time are too few to show the swings of omega2; record more of them"
        assert math.isnan(found["swings"][0])
        assert found.faults == [(0, "swings", reason)]


def test_figures_of_columns_are_those_of_the_run() -> None:
    run = topcli.simulate(symmetric("rk2", 0.1, 400).resolved())
    energy, deviation = run["m_omega"], run["m_omega"] - run["m_omega"][0]
    expected = {
        "first.m_omega": energy[0],
        "max_deviation.m_omega": np.abs(deviation).max(),
        "rms_deviation.m_omega": np.sqrt((deviation**2).mean()),
        "final_deviation.m_omega": deviation[-1],
        "min.omega1": run["omega1"].min(),
        "max.omega1": run["omega1"].max(),
        "mean.m_omega": energy.mean(),
    }
    found = measured(symmetric("rk2", 0.1, 400), [*expected, "drift.m_omega", "frequency.omega1"])
    assert {name: found[name][0] for name in expected} == pytest.approx(expected, rel=1e-13)
    assert found["drift.m_omega"][0] == pytest.approx(np.polyfit(run.t, energy, 1)[0], rel=0.05)
    assert found["frequency.omega1"][0] == pytest.approx((A - C) / A * OMEGA[2] / (2.0 * math.pi), rel=1e-3)
    some = one(symmetric("rk2", 0.1, 400, output={"every": 5}), "frequency.omega1")
    assert some == pytest.approx(found["frequency.omega1"][0], rel=1e-3)
    backwards = measured(symmetric("rk2", -0.1, 400), ["drift.m_omega"])["drift.m_omega"][0]
    assert backwards == pytest.approx(np.polyfit(-run.t, energy, 1)[0], rel=0.05)


def test_errors_are_distances_from_the_closed_form() -> None:
    """rk2 of the symmetric top against the rotation written out here."""
    experiment = symmetric("rk2", 0.05, 403, output={"every": 10})
    run = topcli.simulate(symmetric("rk2", 0.05, 403).resolved())
    error = np.linalg.norm(run.states - precession(run.t), axis=1)
    found = measured(experiment, ["max_error", "final_error"])
    assert found["max_error"][0] == pytest.approx(error[::10].max(), rel=1e-9)
    assert found["final_error"][0] == pytest.approx(error[403], rel=1e-9)  # step 403 is not among the recorded rows
    assert found["final_error"][0] > 1e-3
    left = measured(symmetric("rk2", 0.5, 40), ["max_error"], 3.0 * np.array([OMEGA]))
    assert (left.batch.endings[0].outcome.value, left["max_error"][0] > 1e3) == ("left_motion", True)


def one_way_step(y: Any, h: float, p: Any) -> Any:
    if h < 0.0 and y[0] > 0.5:
        return (math.nan, y[1], y[2])
    f = euler_field(y, p)
    return (y[0] + h * f[0], y[1] + h * f[1], y[2] + h * f[2])


def test_the_reversal_is_the_defect_of_a_step_and_its_reverse(own_registry: None) -> None:
    """A step of Euler's rule and back differs by h² y''; it is infinite where a step back fails."""
    traits = {"order": 1, "explicit": True, "self_adjoint": False}

    @topcli.scheme("one-way", top="euler", **traits)
    def build(top: Any, options: Any) -> Stepper:
        """Euler's rule."""
        return Stepper(one_way_step, 3)

    base = {"top": {"kind": "euler", "A": A, "B": A, "C": C}, "scheme": "one-way", "h": 0.1, "N": 32}
    states = [(0.9, -0.4, 1.3), (0.2, 0.1, 0.3), (0.8, 0.1, 0.2)]
    experiment = load_experiment({**base, "initial": {"omega": list(states[0])}})
    found = measured(experiment, ["reversal_defect"], states)["reversal_defect"]
    assert np.isinf(found).tolist() == [True, False, True]
    rate, radius = (A - C) / A * 0.3, math.hypot(0.2, 0.1)
    assert found[1] == pytest.approx(0.1**2 * rate**2 * radius, rel=0.1)
    assert one(symmetric("hk", 0.2, 320), "reversal_defect") < 1e-15


ALL = ["swings", "median_swing_spacing", "max_error", "final_error", "reversal_defect", "steps"]


@pytest.mark.parametrize("count", [3, 30])
def test_failed_runs_have_no_numbers_and_disturb_no_others(count: int) -> None:
    """rk2 with large steps blows up for a fast top; the slow ones beside it are as they are alone."""
    experiment = symmetric("rk2", 0.5, 400)
    states = np.resize(np.array([OMEGA, (300.0, 400.0, 500.0), (0.1, 0.2, 0.3)]), (count, 3))
    names = [*ALL, "drift.m_sq", "max_deviation.m_sq"]
    found = measured(experiment, names, states)
    batch = found.batch
    assert [ending.outcome.value for ending in batch.endings][1] == "blew_up"
    assert found["steps"].tolist()[:3] == [400.0, float(batch.endings[1].step), 400.0]
    failed = batch.endings[1].step
    assert failed < 400
    reached = np.isfinite(batch.states[:, :, 1])
    assert reached[[0, 2]].all()
    assert reached[1].tolist() == [n < failed for n in range(401)]
    for name in names:
        if name != "steps":
            assert math.isnan(found[name][1]), name


def nearby(y0: Sequence[float], count: int, top: Any) -> Array:
    states = np.tile(np.array(y0), (count, 1))
    start, stop = top.vectors[next(iter(top.vectors))]
    states[:, start:stop] *= 1.0 + 0.01 * np.random.default_rng(5).uniform(-1.0, 1.0, (count, 1))
    return states


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "overrides", "more"),
    table_of("""
kowalevski_hybrid    ['h=0.02', 'output.every=7']  ['lyapunov', 'chaotic']
kowalevski_hk        ['scheme=midpoint', 'h=-0.05']  []
euler_gamma_hk       ['scheme=exact', 'h=0.1']       []
lagrange_bs          ['h=0.03']                      []
heavy_chaotic        ['output.every=10']             ['lyapunov', 'chaotic']
"""),
)
def test_a_batch_has_the_bits_of_its_single_runs(scene: str, overrides: list[str], more: list[str]) -> None:
    experiment = load_experiment(scene, [*overrides, "N=1000"])
    integrals = [name for family in ("drift", "max_deviation") for name in (f"{family}.{experiment.top.energy}",)]
    modified = [f"drift.{integral.name}" for integral in experiment.modified]
    names = [*ALL, *integrals, *modified, *more]
    states = nearby(experiment.y0, 21, experiment.top)
    alone = {i: measured(experiment, names, states[i : i + 1]) for i in (0, 7, 8, 20)}
    together = measured(experiment, names, states)
    for (i, one), name in product(alone.items(), names):
        assert together[name][i : i + 1].tobytes() == one[name].tobytes(), (name, i)
        assert np.isfinite(one[name][0]) or name in ("median_swing_spacing", "chaotic")


@pytest.mark.parametrize(
    ("N", "reason"), [(999, "N = 999: too few steps for an exponent; take at least 1000"), (1000, "")]
)
def test_too_few_steps_for_an_exponent_are_a_reason_of_each_row(N: int, reason: str) -> None:
    found = measured(symmetric("hk", 0.1, N), ["lyapunov", "chaotic"], [OMEGA, (0.1, 0.2, 0.3)])
    assert [text for _, _, text in found.faults] == ([reason] * 4 if reason else [])
    assert np.isnan(found["lyapunov"]).all() == bool(reason)


@pytest.fixture
def lowest(own_registry: None) -> list[int]:
    """A measure like a plugin's, which cannot cope with runs that start above omega1 = 0.5."""
    calls: list[int] = []

    @measure("test.lowest", summary="lowest omega1", needs=["omega1", "states"])
    def evaluate_lowest(batch: Any) -> Any:
        calls.append(len(batch))
        if (batch.columns["omega1"][:, 0] > 0.5).any():
            raise ValueError("too high")
        np.testing.assert_array_equal(batch.states[:, :, 0], batch.columns["omega1"])
        return batch.columns["omega1"].min(axis=1)

    return calls


def test_a_measure_that_fails_for_one_run_keeps_its_values_for_the_others(lowest: list[int]) -> None:
    experiment = symmetric("rk4", 0.1, 100)
    fast = (3e3, 4e3, 5e3)  # it blows up, so that no measure sees it
    states = [fast, (0.3, 0.4, 1.5), (0.6, 0.8, 1.5), (0.0, 0.5, 1.5)]
    found = measured(experiment, ["test.lowest", "steps"], states)
    np.testing.assert_allclose(found["test.lowest"], [math.nan, -0.5, math.nan, -0.5], atol=2e-3)
    assert found["steps"].tolist()[1:] == [100.0] * 3
    ((run, name, reason),) = found.faults
    assert (run, name) == (2, "test.lowest")
    assert reason.endswith("ValueError: too high")
    assert "test_measures.py:" in reason
    assert lowest == [3, 1, 1, 1]


@pytest.mark.parametrize("wrong", [1.0, [1.0, 2.0], "many", None, [[1.0]]])
def test_a_measure_that_returns_something_else_is_named(wrong: Any, own_registry: None) -> None:
    measure("test.wrong", summary="wrong")(lambda batch: wrong)
    found = measured(symmetric("rk4", 0.1, 10), ["test.wrong"])
    assert math.isnan(found["test.wrong"][0])
    ((_, _, reason),) = found.faults
    assert "'test.wrong'" in reason
    assert "one number for each run" in reason


def test_an_error_without_a_reference_is_no_number(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also for measures of users, which see the batch: not the zero with which the largest error begins."""
    real = REFERENCES.states

    def states(reference: Any, y0: Array, h: float, n: Any) -> Array:
        if y0[0] == 0.25:
            raise RunError("cannot be followed")
        return real(reference, y0, h, n)

    monkeypatch.setattr(REFERENCES, "states", states)
    batch = measured(symmetric("rk4", 0.1, 20), ["max_error", "final_error"], [(0.25, 0.5, 1.0), OMEGA]).batch
    for errors in (batch.max_error, batch.final_error):
        assert np.isnan(errors).tolist() == [True, False]
        assert errors[1] > 0.0
    assert batch.faults == {0: "cannot be followed"}


HK = find_scheme("hk", "kowalevski")


@pytest.mark.slow
def test_every_measure_that_is_listed_for_a_top_can_be_resolved_and_evaluated() -> None:
    for scene in ("kowalevski_hk", "euler_hk", "lagrange_hk"):
        overrides = ["h=0.1", "N=4000"]  # some oscillations, so that all have frequencies
        if scene != "euler_hk":  # far from a separatrix, so that there is a verdict
            overrides.append("initial.gamma=[0.6, 0.48, 0.64]")
        experiment = load_experiment(scene, overrides)
        fitting = [each.name for each in fitting_measures(experiment.top, experiment.scheme, experiment.options)]
        found = measured(experiment, fitting)
        assert list(found) == fitting
        missing = [name for name in found if not np.isfinite(found[name][0]) and "counter." not in name]
        assert set(missing) <= {"median_swing_spacing", "first_swing_spacing"}


def test_names_of_a_plugin_are_checked(own_registry: None) -> None:
    taken = dict.fromkeys(
        ["row", "outcome", "h", "T", "top.c0", "initial.NAME", "scheme.tol", "sample"], "has this name"
    )
    others = {"seconds": "already registered by topcli", "two words": "no spaces", "odd.NAME": "a family, and no other"}
    for name, message in (taken | others).items():
        with pytest.raises(ValueError, match=message):
            measure(name, summary="clash")
    with pytest.raises(ValueError, match="a family, and no other measure"):
        measure("odd", summary="odd", names=lambda top, scheme, options: ["a"])
    measure("odd", summary="odd", needs=["gamma7"])(lambda batch: None)
    with pytest.raises(UsageError, match="it needs 'gamma7', which top 'kowalevski' under scheme 'hk'"):
        resolve_measures(["odd"], Kowalevski(), HK)
