"""The outcome ``left_motion``: a finite state far off its energy surface, found at the first recorded step."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from conftest import GEN, Said
from topcli.contracts import Outcome, Top
from topcli.engine.consumers import EnergyWatch
from topcli.engine.rows import Plan, Rows
from topcli.runs.simulate import simulate
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import LagrangeInertial

BIG = ["h=2", "N=1000", "name=big"]
"""HK with so long a step that gamma² grows to 2e59; the state stays finite."""


def kowalevski_energy(y: np.ndarray) -> tuple[float, float]:
    """Energy and magnitudes of its terms for A = B = 2, C = c0 = 1, written out."""
    kinetic = y[0] ** 2 + y[1] ** 2 + 0.5 * y[2] ** 2
    return kinetic + y[3], kinetic + abs(y[3])


def inertial_energy(y: np.ndarray) -> tuple[float, float]:
    kinetic = 0.5 * (y[0] ** 2 + y[1] ** 2 + y[2] ** 2)
    return kinetic + y[5], kinetic + abs(y[5])


TOPS = [(Kowalevski(), kowalevski_energy), (LagrangeInertial(), inertial_energy)]


def departing(top: Top, energy: Callable[..., tuple[float, float]], factor: float, at: int) -> np.ndarray:
    """States (1000, d): the first one until ``at``, from there on off by ``factor`` of the energy's terms."""
    start = np.array(GEN[: len(top.components)])
    first, scale = energy(start)
    low, high = 1.0, 1e3
    while low < 0.5 * (low + high) < high:  # omega (or m) times this has the energy wanted
        middle = 0.5 * (low + high)
        state = np.where(np.arange(len(start)) < 3, middle * start, start)
        low, high = (middle, high) if energy(state)[0] - first < factor * scale else (low, middle)
    states = np.tile(start, (1000, 1))
    states[at:, :3] *= low
    return states


def left_by_each(top: Top, states: np.ndarray) -> set[int | None]:
    """The step of leaving, alone and beside a state at rest, in one piece and in pieces; every third step recorded."""
    n, found = 3 * np.arange(len(states)), set[int | None]()
    for pieces in (1, 7, 400):
        for resting in (0, 1):
            both = np.stack([*[np.tile(states[0], (len(states), 1))] * resting, states])
            plan, watch = Plan(top, None, both[:, 0], 0.1, int(n[-1]), 3, invariants=top.invariants()), EnergyWatch()
            watch.begin(plan)
            for part in np.array_split(np.arange(len(states)), pieces):
                watch.add(Rows(plan, n[part], both[:, part]))
            assert (watch.left[:resting] == -1).all()
            found.add(None if watch.left[resting] < 0 else int(watch.left[resting]))
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("top", "energy"), TOPS, ids=["kowalevski", "lagrange/inertial"])
@pytest.mark.parametrize("at", [1, 417])
def test_energy_limit_separates_both_sides(top: Top, energy, at: int) -> None:
    """A hundred times the magnitudes of the energy's terms at the start."""
    assert left_by_each(top, departing(top, energy, 99.9, at)) == {None}
    assert left_by_each(top, departing(top, energy, 100.1, at)) == {3 * at}


@pytest.mark.slow
@pytest.mark.parametrize("value", [1e160, math.nan])
def test_an_energy_beyond_the_range_of_numbers_has_left(value: float) -> None:
    states = departing(Kowalevski(), kowalevski_energy, 1.0, 500)
    states[500:, 1] = value
    with np.errstate(all="ignore"):
        assert left_by_each(Kowalevski(), states) == {1500}


@pytest.mark.slow
@pytest.mark.parametrize("gamma", [(0.0, 0.0, 1.0), (1e-12, 0.6, 0.8)])
def test_a_start_whose_terms_vanish_has_the_scale_of_its_lengths(gamma: tuple[float, ...]) -> None:
    """At rest with the centre of gravity level the energy's terms are 0: no error is a hundred times as large."""
    states = np.tile(np.array([0.0, 0.0, 0.0, *gamma]), (1000, 1))
    for factor, left in ((0.99, None), (1.01, 900)):  # of c0 |gamma|
        states[300:, 1] = math.sqrt(factor)
        assert left_by_each(Kowalevski(), states) == {left}
    falls = simulate(
        {"top": "kowalevski", "initial": {"omega": [0, 0, 0], "gamma": [0, 0, 1]}, "scheme": "hk", "h": 0.1, "N": 500}
    )
    assert falls.outcome is Outcome.COMPLETED
    assert np.ptp(falls["energy"]) == pytest.approx(0.000625, rel=0.05)


@pytest.mark.slow
def test_the_run_goes_on_and_says_so_everywhere(cli: Callable[..., Said], in_tmp: Path) -> None:
    done = cli("run", "kowalevski_hk", *(part for text in BIG for part in ("--set", text)))
    assert done.code == 1
    assert "left its energy surface at step 14 (t = 28)" in done.err
    folder = in_tmp / "results" / "big"
    series = pq.read_table(folder / "series.parquet")
    energy = series.column("energy").to_numpy()
    assert series.num_rows == 1001
    assert np.flatnonzero(np.abs(energy - energy[0]) > 100.0 * (4.0 + math.sqrt(1.0 - 1e-6)))[0] == 14
    report, manifest = (json.loads((folder / f"{name}.json").read_text()) for name in ("report", "manifest"))
    for kept in (report, manifest):
        assert kept["outcome"] == "left_motion"
        assert (kept["step"], "step 14 " in kept["message"]) == (1000, True)
    assert report["left_motion"] == {"step": 14, "t": 28.0}
    metadata = pq.read_metadata(folder / "series.parquet").metadata
    assert json.loads(metadata[b"topcli.left_motion"]) == {"step": 14, "t": 28.0}
    assert cli("list", "runs", "--json").json()["runs"][0]["outcome"] == "left_motion"
    again = cli("run", "kowalevski_hk", *(part for text in BIG for part in ("--set", text)))
    assert (again.code, "(not run again, because it ended as left_motion before" in again.err) == (1, True)
    compared = cli("compare", "hk", "midpoint", "--set", "h=2", "--set", "N=100", "--json")
    assert compared.code == 1
    assert [row["outcome"] for row in compared.json()["tables"][0]["rows"]] == ["left_motion", "completed"]


def test_a_later_failure_keeps_its_outcome_and_mentions_it() -> None:
    found = simulate("kowalevski_hk", overrides=["scheme=rk4", "h=2", "N=200"])
    assert (found.outcome, found.ending.left) == (Outcome.BLEW_UP, 8)
    assert found.ending.message.startswith("blew up at step 10 ")
    assert "left its energy surface at step 8 (t = 16)" in found.ending.message
    assert "energy" not in simulate("kowalevski_hk", scheme="rk4", N=100).ending.message
