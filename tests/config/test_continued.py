"""Runs that go on, or back, from the last state of another run, and states that nearly have unit vectors."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import topcli
from conftest import Said
from custom_tops import SECTION
from topcli.config.load import load, load_experiment
from topcli.errors import ConfigError
from topcli.runs.run import run_experiment

BODY: dict[str, Any] = {
    "name": "one",
    "top": "kowalevski",
    "initial": {"omega": [0.3, 0.2, 1.1], "gamma": [0.6, 0.0, 0.8]},
    "scheme": "hk",
    "h": 0.05,
    "N": 300,
}
CUSTOM = {**BODY, "top": SECTION, "initial": {"w1": 0.9, "w2": -0.4, "w3": 1.2}}
INERTIAL = {**BODY, "top": "lagrange", "initial": {"m": [0.3, 0.2, 1.1], "a": [0.6, 0.0, 0.8]}, "scheme": "midpoint"}


def rows_of(config: dict[str, Any], out: Path) -> np.ndarray:
    """States (m, d) of a run into a folder of results."""
    stored = run_experiment(load(config), out).stored
    table = pd.read_parquet(stored.series) if stored.series.suffix == ".parquet" else pd.read_csv(stored.series)
    return table[list(load_experiment(config).top.components)].to_numpy()


@pytest.mark.parametrize(
    ("config", "file_format"),
    [(BODY, "parquet"), (CUSTOM, "csv"), (INERTIAL, "csv"), ({**BODY, "scheme": "rk4"}, "csv")],
)
def test_a_run_goes_on_and_back(in_tmp: Path, config: dict[str, Any], file_format: str) -> None:
    """On, with the bits of the run of both lengths; back, to the first state within round-off or the order's error."""
    config = {**config, "output": {"format": file_format}}
    results = in_tmp / "results"
    first = rows_of(config, results)
    on = rows_of({**config, "name": "on", "initial": {"from": "one"}}, results)
    whole = rows_of({**config, "name": "whole", "N": 600}, results)
    assert np.array_equal(np.vstack([first, on[1:]]), whole)
    back = rows_of({**config, "name": "back", "initial": {"from": "results/on"}, "h": -0.05, "N": 600}, results)
    assert np.abs(back[-1] - first[0]).max() < (1e-4 if config["scheme"] == "rk4" else 1e-9)


def test_the_config_of_a_continued_run_is_complete(in_tmp: Path) -> None:
    """It holds the state, not the name: the run stays the same if the other one is gone or has changed."""
    first = rows_of(BODY, in_tmp / "results")
    experiment = load({**BODY, "name": "on", "initial": {"from": "one"}})
    assert experiment.resolved()["initial"] == {"omega": first[-1, :3].tolist(), "gamma": first[-1, 3:].tolist()}
    scaled = load_experiment({**BODY, "initial": {"from": "one", "normalize": True}})
    assert math.fsum(value * value for value in scaled.y0[3:]) == pytest.approx(1.0, abs=1e-15)
    precise = load_experiment({**BODY, "initial": {"from": "one"}, "precision": 30}, any_precision=True)
    assert precise.y0 == tuple(first[-1])
    many = load({**BODY, "initial": {"from": "one"}, "ensemble": {"states": [{}, {"omega": [1, 0, 0]}]}})
    assert many.ensemble
    assert many.ensemble.states[:, 3:].tolist() == [first[-1, 3:].tolist()] * 2


@pytest.mark.parametrize(
    ("run", "changes", "message"),
    [
        ({}, {"initial": {"from": "two"}}, "'two' is no finished run; give its name in results"),
        ({}, {"initial": {"from": "one", "omega": [1, 0, 0]}}, "from gives the whole state; leave out omega"),
        ({}, {"top": {"kind": "kowalevski", "c0": -0.5}}, "the run .*one has another top"),
        ({"output": {"every": 7}}, {}, "did not record its last state, for 300 steps are"),
        ({"output": {"columns": ["t", "omega1", "gamma1"]}}, {}, "did not record omega2, omega3, gamma2, gamma3"),
        ({"section": {"component": "gamma2"}}, {}, "recorded crossings"),
        ({"ensemble": {"states": [{}]}}, {}, "is an ensemble"),
        ({"precision": 30, "N": 10}, {}, "is in another precision"),
        ({"scheme": "rk2", "h": 3.0}, {}, "failed: it (blew up|left)"),
        ({"h": 0.3}, {}, r"gamma² = .* is off by .* \(allowed: 0.01\)"),
    ],
)
def test_what_cannot_be_continued_is_refused(
    in_tmp: Path, run: dict[str, Any], changes: dict[str, Any], message: str
) -> None:
    first = {**BODY, **run, "output": {"every": 1, **run.get("output", {})}}
    run_experiment(load(first), in_tmp / "results")
    with pytest.raises(ConfigError, match=message):
        load({**BODY, "name": "on", "initial": {"from": "one"}, **changes})


OFF = [0.6, 0.0, 0.8 + 5e-5]
"""gamma² is off by 8e-5."""
WARNING = "initial gamma is not a unit vector: gamma² is off by 8e-05, which the run keeps"


def test_commands_and_functions_warn_of_states_off_the_unit_sphere(cli: Callable[..., Said]) -> None:
    said = cli("run", "kowalevski_hk", "--set", f"initial.gamma={OFF}", "--set", "N=100")
    assert f"{WARNING}; initial.normalize: true makes it one" in said.err
    assert said.err.count("unit vector") == 1
    state = [0.3, 0.2, 1.1, *OFF]
    with pytest.warns(UserWarning, match=WARNING) as caught:
        topcli.simulate({**BODY, "initial": {"omega": state[:3], "gamma": OFF}})
    assert caught[0].filename == __file__
    with pytest.warns(UserWarning, match=WARNING):
        topcli.simulate(BODY, states=[[0.3, 0.2, 1.1, 0.6, 0.0, 0.8], state])
    with pytest.warns(UserWarning, match=WARNING):
        topcli.simulate({**BODY, "ensemble": {"grid": {"gamma3": [0.8, OFF[2]], "omega1": [0.1, 0.2]}}})
