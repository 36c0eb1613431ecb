"""Measures of finished runs, against closed forms and against numbers worked out by hand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

import topcli
from cases import table_of
from sweeping import measured
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array, Outcome, Stepper
from topcli.engine.consumer import Consumer
from topcli.engine.endings import Endings
from topcli.engine.plan import Plan
from topcli.engine.rows import Rows
from topcli.errors import RunError
from topcli.runs.references import REFERENCES
from topcli.sweeps.batch import Measuring, evaluate
from topcli.sweeps.measures import measure, resolve_measures
from topcli.tops.euler import field

A, C = 2.0, 1.0


OMEGA = (0.3, 0.4, 1.5)


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
    found = measured(symmetric("exact", 0.01, 5000), ["swings", "median_swing_spacing"])
    assert found["median_swing_spacing"][0] == pytest.approx(period, rel=1e-7)
    # omega2 sinks first at the phase -pi/2, which is reached at t = (pi/2 + arg) / rate
    first = (math.pi / 2.0 + math.atan2(OMEGA[1], OMEGA[0])) * period / (2.0 * math.pi)
    assert found["swings"][0] == math.floor((50.0 - first - period / 4.0) / period) + 1


@pytest.mark.parametrize("h", [0.01, -0.01])
def test_the_spacing_is_the_median_and_the_first_one_the_first(h: float) -> None:
    """Dips at 1, 3, 4, 5.2: the spacings are 2, 1, 1.2; the second run has a single one, the third none."""
    t = np.arange(0.0, 7.0, 0.01)

    def dips(*places: float) -> Array:
        return -np.exp(-((t[:, None] - np.array(places)) ** 2) / 0.005).sum(axis=1)

    batch = recorded(
        symmetric("rk4", h, len(t) - 1),
        ["median_swing_spacing", "first_swing_spacing", "swings"],
        np.stack([dips(1.0, 3.0, 4.0, 5.2), dips(1.0, 2.0), dips(3.0)]),
        "omega2",
    )
    assert batch["swings"].tolist() == [4.0, 2.0, 1.0]
    np.testing.assert_allclose(batch["median_swing_spacing"], [1.2, 1.0, math.nan], atol=1e-13)  # typically 2e-16
    np.testing.assert_allclose(batch["first_swing_spacing"], [2.0, 1.0, math.nan], atol=1e-13)


def recorded(
    experiment: Experiment, names: Sequence[str], values: Array, component: str, pieces: int = 1
) -> dict[str, Array]:
    """Measures of made-up runs in which only ``component`` moves: ``values`` (runs, m)."""
    measures = resolve_measures(names, experiment.top, experiment.scheme, experiment.options)
    count, m = values.shape
    states = np.zeros((count, m, len(experiment.top.components)))
    states[:, :, experiment.top.components.index(component)] = values

    def drive(plan: Plan, consumers: Sequence[Consumer], **options: Any) -> Any:
        """What the driver does, for the made-up rows."""
        for consumer in consumers:
            consumer.begin(plan)
        for rows in filter(len, np.array_split(np.arange(m), pieces)):
            piece = Rows(plan, rows * plan.every, states[:, rows])
            for consumer in consumers:
                consumer.take(consumer.add(piece))
        endings = Endings.of_none(count, plan.h)
        endings.put(slice(None), Outcome.COMPLETED, plan.N, np.zeros((count, 0)))
        last = {"last": states[:, -1], "last_n": np.full(count, plan.N)}
        run: Any = SimpleNamespace(plan=plan, endings=endings, seconds=np.zeros(1), **last)
        for consumer in consumers:
            consumer.end(run)
        return run

    with patch("topcli.sweeps.batch.drive", drive):
        return evaluate(measures, Measuring(experiment, measures, threads=1).finished(states[:, 0]))


SLOPE = 3e-4


def wavy(rows: int, h: float) -> Array:
    """omega1 (1, rows) whose contribution A omega1² to m·omega has the slope SLOPE and a fast oscillation."""
    t = h * np.arange(rows)
    return np.sqrt((1.0 + SLOPE * t + 1e-3 * np.sin(40.0 * t)) / A)[None]


def test_a_drift_averages_oscillations_out_and_knows_the_recorded_interval() -> None:
    values = wavy(20_001, 0.1)
    found = recorded(symmetric("rk4", 0.1, 20_000), ["drift.m_omega"], values, "omega1")
    assert found["drift.m_omega"][0] == pytest.approx(SLOPE, rel=1e-4)
    sparse = symmetric("rk4", 0.02, 100_000, output={"every": 5})
    assert recorded(sparse, ["drift.m_omega"], values, "omega1")["drift.m_omega"][0] == pytest.approx(SLOPE, rel=1e-4)
    backwards = recorded(symmetric("rk4", -0.1, 20_000), ["drift.m_omega"], values, "omega1")
    assert backwards["drift.m_omega"][0] == pytest.approx(-SLOPE, rel=1e-4)


def test_drifts_do_not_depend_on_the_pieces_in_which_rows_come() -> None:
    values = wavy(3001, 0.1)
    experiment = symmetric("rk4", 0.1, 3000)
    names = ["drift.m_omega", "max_deviation.m_omega", "drift.m_sq", "max_error"]
    whole = recorded(experiment, names, values, "omega1")
    for pieces in (2, 7, 500):
        cut = recorded(experiment, names, values, "omega1", pieces)
        assert {name: cut[name].tobytes() for name in names} == {name: whole[name].tobytes() for name in names}


@pytest.mark.parametrize("pieces", [1, 3, 21])
def test_the_largest_error_may_lie_in_any_piece(pieces: int) -> None:
    """A steady rotation is at rest, so the deviations of made-up rows are their errors."""
    values = np.full((2, 21), 0.5)
    values[0, 4], values[1, 15], values[:, 20] = 0.75, 0.125, 0.53125
    found = recorded(symmetric("rk4", 0.1, 20), ["max_error", "final_error"], values, "omega1", pieces)
    assert found["max_error"].tolist() == [0.25, 0.375]
    assert found["final_error"].tolist() == [0.03125, 0.03125]


def test_errors_are_distances_from_the_closed_form() -> None:
    """rk2 of the symmetric top against the rotation written out here."""
    experiment = symmetric("rk2", 0.05, 403, output={"every": 10})
    run = topcli.simulate(symmetric("rk2", 0.05, 403).resolved())
    error = np.linalg.norm(run.states - precession(run.t), axis=1)
    found = measured(experiment, ["max_error", "final_error"])
    assert found["max_error"][0] == pytest.approx(error[::10].max(), rel=1e-9)
    assert found["final_error"][0] == pytest.approx(error[403], rel=1e-9)  # step 403 is not among the recorded rows
    assert found["final_error"][0] > 1e-3


def explicit_midpoint(y: Array, h: float) -> Array:
    def field(w: Array) -> Array:
        return np.array([(A - C) / A * w[1] * w[2], (C - A) / A * w[2] * w[0], 0.0])

    return y + h * field(y + 0.5 * h * field(y))


@pytest.mark.slow
def test_the_reversal_is_the_defect_of_a_step_and_its_reverse() -> None:
    h, N = 0.2, 320
    run = topcli.simulate(symmetric("rk2", h, N).resolved())
    probes = run.states[:: (N + 1) // 16][:16]
    expected = max(np.abs(explicit_midpoint(explicit_midpoint(y, h), -h) - y).max() for y in probes)
    assert one(symmetric("rk2", h, N), "reversal_defect") == pytest.approx(expected, rel=1e-9)
    assert expected > 1e-5
    assert one(symmetric("hk", h, N), "reversal_defect") < 1e-15
    assert one(symmetric("rk2", -h, N), "reversal_defect") == pytest.approx(expected, rel=0.1)


def one_way_step(y: Any, h: float, p: Any) -> Any:
    if h < 0.0 and y[0] > 0.5:
        return (math.nan, y[1], y[2])
    f = field(y, p)
    return (y[0] + h * f[0], y[1] + h * f[1], y[2] + h * f[2])


@pytest.fixture
def one_way(own_registry: None) -> None:
    traits = {"order": 1, "explicit": True, "self_adjoint": False, "citation": "none", "equations": "none"}

    @topcli.scheme("one-way", top="euler", title="Euler's rule", **traits)
    def build(top: Any, options: Any) -> Stepper:
        """Euler's rule, which fails backwards where omega1 > 0.5."""
        return Stepper(one_way_step, 3)


@pytest.mark.usefixtures("one_way")
def test_a_reversal_that_fails_is_infinite_and_never_missing() -> None:
    """Two of three trajectories cannot be stepped back."""
    base = {"top": {"kind": "euler", "A": A, "B": A, "C": C}, "scheme": "one-way", "h": 0.1, "N": 32}
    states = [(0.9, -0.4, 1.3), (0.2, 0.1, 0.3), (0.8, 0.1, 0.2)]
    experiment = load_experiment({**base, "initial": {"omega": list(states[0])}})
    found = measured(experiment, ["reversal_defect"], states)["reversal_defect"]
    assert np.isinf(found).tolist() == [True, False, True]
    assert 1e-6 < found[1] < 1e-3


def test_options_and_parameters_have_their_own_code() -> None:
    """One after the other in one process, each equal to its run elsewhere."""
    values = []
    for overrides in (["scheme.tol=1e-6"], ["scheme.tol=1e-10"], ["top.c0=0.5"]):
        experiment = load_experiment("kowalevski_hk", ["scheme=taylor", "N=200", "h=0.25", *overrides])
        run = topcli.simulate(experiment.resolved())
        values.append(one(experiment, "max_deviation.two_l"))
        assert values[-1] == np.abs(run["two_l"] - run["two_l"][0]).max(), overrides
    assert len(set(values)) == 3


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
    reached = np.isfinite(batch.columns["omega2"])
    assert reached[[0, 2]].all()
    assert reached[1].tolist() == [n < failed for n in range(401)]
    for name in names:
        if name != "steps":
            assert math.isnan(found[name][1]), name
    for i in (0, 2):
        alone = measured(experiment, names, states[i : i + 1])
        for name in names:
            assert found[name][i : i + 1].tobytes() == alone[name].tobytes(), name


def test_a_run_that_left_its_energy_surface_keeps_its_numbers() -> None:
    """It took all its steps: the error is that of a whole run, and the outcome says what it is worth."""
    experiment = symmetric("rk2", 2.9, 40)
    found = measured(experiment, ["final_error", "max_deviation.m_omega", "swings"], [(3.0, 4.0, 1.5)])
    assert found.batch.endings[0].outcome.value == "left_motion"
    assert found["max_deviation.m_omega"][0] > 100.0 * (2.0 * 25.0 + 2.25)
    assert np.isfinite(found["final_error"][0])


def nearby(y0: Sequence[float], count: int, top: Any) -> Array:
    states = np.tile(np.array(y0), (count, 1))
    start, stop = top.vectors[next(iter(top.vectors))]
    states[:, start:stop] *= 1.0 + 0.01 * np.random.default_rng(5).uniform(-1.0, 1.0, (count, 1))
    return states


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "overrides"),
    table_of("""
kowalevski_hybrid    ['h=0.02', 'output.every=7']
kowalevski_hk        ['scheme=midpoint', 'h=-0.05']
euler_gamma_hk       ['scheme=exact', 'h=0.1']
lagrange_bs          ['h=0.03']
"""),
)
def test_a_batch_has_the_bits_of_its_single_runs(scene: str, overrides: list[str]) -> None:
    experiment = load_experiment(scene, [*overrides, "N=1000"])
    integrals = [name for family in ("drift", "max_deviation") for name in (f"{family}.{experiment.top.energy}",)]
    modified = [f"drift.{integral.name}" for integral in experiment.modified]
    names = [*ALL, *integrals, *modified]
    states = nearby(experiment.y0, 21, experiment.top)
    alone = {i: measured(experiment, names, states[i : i + 1]) for i in (0, 7, 8, 20)}
    together = measured(experiment, names, states)
    for (i, one), name in product(alone.items(), names):
        assert together[name][i : i + 1].tobytes() == one[name].tobytes(), (name, i)
        assert np.isfinite(one[name][0]) or name == "median_swing_spacing"


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
