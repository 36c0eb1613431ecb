"""The step as a function of states: the bits of a run, its tangent map, and what it refuses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import topcli
from topcli.config.load import load_experiment
from topcli.errors import TopcliError

SCENE = "kowalevski_generic_hk"


def test_steps_are_those_of_a_run() -> None:
    f = topcli.step(SCENE, ["h=0.1"])
    run = topcli.simulate(SCENE, overrides=["h=0.1", "N=7", "output.every=7"])
    assert np.array_equal(f(f.initial, 7), run.states[-1])
    assert f.components == ("omega1", "omega2", "omega3", "gamma1", "gamma2", "gamma3")
    assert repr(f) == "<map of hk for kowalevski, h = 0.1>"
    by_one = f.initial
    for _ in range(7):
        by_one = f(by_one)
    assert np.array_equal(by_one, run.states[-1])


LENGTHS = ({}, {"N": 1000}, {"T": 20}, {"T": 0.37}, {"N": 0}, {"N": 10, "output": {"every": 20, "nonsense": 1}})
SETTINGS = ([], ["N=3"], ["T=7"], ["T=0.37"], ["output.every=9"])


@pytest.mark.parametrize("length", LENGTHS, ids=str)
def test_a_map_needs_no_length_of_a_run(length: dict[str, Any]) -> None:
    data = {key: value for key, value in load_experiment(SCENE).resolved().items() if key not in ("N", "output")}
    for overrides in SETTINGS:
        f = topcli.step(data | length, ["h=0.1", *overrides])
        assert np.array_equal(f(f.initial), topcli.step(SCENE, ["h=0.1"])(f.initial))


@pytest.mark.parametrize("shape", [(6,), (1, 6), (100, 6), (4, 5, 6), (0, 6)])
def test_states_of_any_shape(shape: tuple[int, ...]) -> None:
    f = topcli.step(SCENE, ["h=0.1"])
    y = np.random.default_rng(1).normal(size=shape)
    new = f(y)
    assert new.shape == shape
    for i in range(len(y.reshape(-1, 6))):
        assert np.array_equal(new.reshape(-1, 6)[i], f(y.reshape(-1, 6)[i]))


def test_derivatives_are_those_of_differences() -> None:
    f = topcli.step(SCENE, ["h=0.1"])
    y, nudge = np.random.default_rng(1).normal(size=(3, 6)), 1e-6
    jacobian = f.jacobian(y, 2)
    assert jacobian.shape == (3, 6, 6)
    for j in range(6):
        change = nudge * np.eye(6)[j]
        slope = (f(y + change, 2) - f(y - change, 2)) / (2.0 * nudge)
        assert np.abs(jacobian[:, :, j] - slope).max() < 1e-8
    new, images = f.tangent(y, np.ones(6), 2)
    assert np.abs(new - f(y, 2)).max() < 1e-14
    assert images == pytest.approx(jacobian.sum(axis=2), rel=1e-12)


def test_a_step_that_fails_gives_nan_and_leaves_its_neighbours_alone() -> None:
    f = topcli.step(SCENE, ["h=0.1"])
    y = np.random.default_rng(1).normal(size=(10, 6))
    y[3, 0] = 1e200
    assert np.isnan(f(y)).all(axis=1).tolist() == [i == 3 for i in range(10)]
    new, images = f.tangent(y, np.ones(6))
    assert np.isnan(new[3]).all()
    assert np.isnan(images[3]).all()
    assert np.isfinite(np.delete(images, 3, axis=0)).all()


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda f: f(np.zeros(5)), r"states: the last axis has the 6 components omega1, .*, not \(5,\)"),
        (lambda f: f(1.0), r"not \(\)"),
        (lambda f: f(f.initial, 0), "steps = 0: must be a whole number from 1 on"),
        (lambda f: f(f.initial, 1.5), "steps = 1.5"),
        (lambda f: f.tangent(np.zeros((2, 6)), np.zeros((3, 6))), "states and vectors do not fit"),
    ],
)
def test_bad_input_is_refused(call, words: str) -> None:
    with pytest.raises(TopcliError, match=words):
        call(topcli.step(SCENE))
