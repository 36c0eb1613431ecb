"""The section ``ensemble`` of a config: what it means, what is refused, and the laws of the random draws."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from config_texts import CONFIGS, ENSEMBLES, refusal, write
from test_config_schema import fits
from topcli.config.ensemble import EnsembleExperiment
from topcli.config.load import load, load_experiment
from topcli.config.schema import config_schema
from topcli.errors import ConfigError, TopcliError

TEXT = """\
top: {kind: kowalevski, c0: 1}
initial:
  omega: [2, 0, 0]
  gamma: [auto, 0, 1e-3]
ensemble:
  random:
    count: 50
    gamma: sphere
scheme: hk
h: 0.001
N: 100
"""
BASE: dict[str, Any] = {
    "top": "kowalevski",
    "initial": {"omega": [2, 0, 0], "gamma": ["auto", 0, 1e-3]},
    "scheme": "hk",
    "h": 0.001,
    "N": 100,
}


def ensemble(**section: Any) -> EnsembleExperiment:
    return loaded({**BASE, "ensemble": section})


def loaded(data: dict[str, Any]) -> EnsembleExperiment:
    found = load(data)
    assert isinstance(found, EnsembleExperiment)
    return found


def states(found: EnsembleExperiment) -> np.ndarray:
    return np.concatenate([group.states for group in found.members.groups])


def same(one: EnsembleExperiment, other: EnsembleExperiment) -> bool:
    return one.digest == other.digest and np.array_equal(states(one), states(other))


@pytest.mark.parametrize("path", ENSEMBLES, ids=lambda path: path.name)
def test_the_shipped_ensembles_round_trip(path: Path, tmp_path: Path) -> None:
    found = load(path)
    assert isinstance(found, EnsembleExperiment)
    assert found.name == path.stem
    assert same(found, loaded(found.resolved()))
    again = load(write(tmp_path, found.to_yaml(), "again.yaml"))
    assert isinstance(again, EnsembleExperiment)
    assert same(found, again)
    assert fits(config_schema(), found.resolved())
    assert found.member(found.count - 1).y0 == tuple(states(found)[-1])
    with pytest.raises(IndexError):
        found.member(found.count)


@pytest.mark.parametrize("path", ENSEMBLES, ids=lambda path: path.name)
def test_a_single_run_is_not_made_of_an_ensemble(path: Path) -> None:
    assert "ensemble: this is an ensemble of" in refusal(path)
    with pytest.raises(ConfigError, match="simulate_ensemble"):
        load_experiment(path)


# ---------------------------------------------------------------- lists and grids


def test_list_of_states_is_completed_from_initial() -> None:
    found = ensemble(states=[{"omega": [1, 2, 3]}, {"gamma": [0, "-auto", 0.6]}, {}])
    paper = (math.sqrt(1 - 1e-6), 0.0, 1e-3)
    assert states(found).tolist() == [[1, 2, 3, *paper], [2, 0, 0, 0, -0.8, 0.6], [2, 0, 0, *paper]]
    assert same(found, loaded(found.resolved()))


def test_a_grid_is_a_product_in_the_order_of_the_components() -> None:
    spaced = {"from": -1, "to": 1, "count": 3}
    found = ensemble(grid={"gamma3": [0.6, 0.8], "omega2": spaced, "top.c0": [1, 2], "omega1": [5, 4]})
    assert [group.top.model_dump()["c0"] for group in found.members.groups] == [1.0, 2.0]
    wanted = [
        (a, b, 0.0, math.sqrt(1 - c * c), 0.0, c) for a, b, c in itertools.product((5, 4), (-1, 0, 1), (0.6, 0.8))
    ]
    for group in found.members.groups:
        assert np.allclose(group.states, wanted, rtol=0, atol=1e-16)
    assert found.count == 24
    assert found.member(12).top == found.members.groups[1].top
    reordered = ensemble(grid=dict(reversed(found.resolved()["ensemble"]["grid"].items())))
    assert same(found, reordered)
    assert same(found, loaded(found.resolved()))


def test_a_grid_over_a_whole_vector_needs_no_initial_one() -> None:
    axes = {f"omega{i}": [0.1, 0.2] for i in (1, 2, 3)}
    found = loaded({**BASE, "top": "euler", "initial": {}, "ensemble": {"grid": axes}})
    assert states(found).tolist() == [list(x) for x in itertools.product((0.1, 0.2), repeat=3)]


def test_random_vectors_decide_the_form_of_a_top() -> None:
    random = {"count": 5, "m": {"sphere": 2}, "a": "sphere"}
    found = load({**BASE, "top": "lagrange", "initial": {}, "scheme": "bs", "ensemble": {"random": random}})
    assert isinstance(found, EnsembleExperiment)
    assert found.top.form == "lagrange/inertial"
    random = {"count": 5, "omega": {"energy": 2}, "gamma": "sphere"}
    found = load({**BASE, "top": "euler", "initial": {}, "ensemble": {"random": random}})
    assert isinstance(found, EnsembleExperiment)
    assert found.top.form == "euler+gamma"


# ---------------------------------------------------------------- mistakes


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("  random:", "  randum:", (":6: ensemble.randum: unknown key; did you mean 'random'?", "has none of them")),
        ("    count: 50\n", "", (":6: ensemble.random.count: missing; give the number of trajectories",)),
        ("count: 50", "count: 0", (":7: ensemble.random.count: must be at least 1, not 0",)),
        ("count: 50", "count: 5e7", (":7: ensemble.random.count: must be at most 1000000",)),
        ("count: 50", "count: 50\n    seed: -1", (":8: ensemble.random.seed: must be at least 0",)),
        ("gamma: sphere", "gama: sphere", (":8: ensemble.random.gama: unknown key; did you mean 'gamma'?",)),
        (
            "gamma: sphere",
            "gamma: sphre",
            (":8:", "must have one of sphere, near, not the text 'sphre'", "write gamma: sphere or gamma: {near: 0.1}"),
        ),
        ("gamma: sphere", "gamma: {near: 4}", (":8: ensemble.random.gamma.near: must be at most 3.14159",)),
        ("gamma: sphere", "gamma: {sphere: 2}", ("gamma.sphere: must be at most 1.0, not 2",)),
        ("gamma: sphere", "gamma: {energy: 2}", ("gamma: cannot have an energy: its length is 1",)),
        ("gamma: sphere", "omega: {energy: -3}", ("no state has the energy -3.0: the potential alone exceeds it",)),
        ("gamma: sphere", "omega: sphere", ("write omega: {sphere: 2}, omega: {near: 0.1} or omega: {energy: 1.5}",)),
        ("gamma: sphere", "omega: {near: 0}", ("must be greater than 0",)),
        (
            "gamma: sphere",
            "omega: {near: 1, sphere: 1}",
            ("must have one of sphere, near, energy, not 'near' and 'sphere'"),
        ),
        (
            "gamma: sphere\n",
            "\n",
            (":6: ensemble.random: no vector is random; for example random: {count: 100, omega: {sphere: 2}, gamma",),
        ),
        ("  random:", "  store: everything\n  random:", (":6: ensemble.store: must be 'trajectories', 'final'",)),
        ("  random:", "  grid: {omega1: [1]}\n  random:", (":5: ensemble: must have one of", "has grid and random")),
        ("  gamma: [auto, 0, 1e-3]\n", "  gama: [0, 0, 1]\n", ("initial.gama: unknown key; did you mean 'gamma'?",)),
    ],
)
def test_mistakes_are_reported_with_file_and_line(tmp_path: Path, old: str, new: str, said: tuple[str, ...]) -> None:
    assert old in TEXT
    message = refusal_of(write(tmp_path, TEXT.replace(old, new)))
    for part in said:
        assert part in message


def refusal_of(path: Path) -> str:
    with pytest.raises(TopcliError) as caught:
        load(path)
    assert caught.value.exit_code == 2
    assert 1 <= len(str(caught.value).splitlines()) <= 3
    return str(caught.value)


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ({"grid": {}}, "ensemble.grid: has no axes"),
        ({"grid": {"omega4": [1]}}, "ensemble.grid.omega4: unknown key; did you mean 'omega"),
        ({"grid": {"top.c1": [1]}}, "unknown key; did you mean 'top.c0'"),
        (
            {"grid": {"omega1": {"start": 0, "stop": 1, "count": 3}}},
            "omega1: a range has the keys from, to and count; write {from: 0, to: 1, count: 3}",
        ),
        ({"grid": {"omega1": 3}}, "must be a list of values or a range, not 3"),
        ({"grid": {"omega1": []}}, "not an empty list"),
        ({"grid": {"omega1": [1, "x"]}}, "must hold finite numbers, not the text 'x'"),
        (
            {"grid": {"omega1": {"from": 0, "end": 1, "count": 3}}},
            "ensemble.grid.omega1.end: unknown key; known: count, from, spacing, to",
        ),
        (
            {
                "grid": {
                    "omega1": {"from": 0, "to": 1, "count": 2000},
                    "omega2": {"from": 0, "to": 1, "count": 2000},
                }
            },
            "4000000 combinations",
        ),
        ({"grid": {"gamma3": [0.5, 1.5]}}, "at gamma3 = 1.5: gamma: auto cannot make it a unit vector"),
        ({"grid": {"gamma1": [1.0], "gamma3": [0.5]}}, "gamma: must be a unit vector"),
        ({"grid": {"top.A": [1, -2]}}, "at A = -2.0: top.A: must be greater than 0"),
        ({"states": []}, "not an empty one"),
        ({"states": [{"omega": [1, 2, 3]}, {"omega": [1, 2]}]}, "ensemble.states[1].omega: must be a list of 3"),
        ({"states": [{"omga": [1, 2, 3]}]}, "did you mean 'omega'?"),
        ({"states": 3}, "ensemble.states: must be a list, not 3"),
        ([], "must be a section with states, grid, random, store, not a list"),
        ({"random": 7}, "must be a section with count"),
    ],
)
def test_mistakes_in_lists_and_grids_are_reported(section: Any, said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load({**BASE, "ensemble": section})
    assert said in str(caught.value)


@pytest.mark.parametrize("number", [math.inf, math.nan, 2**1024 - 1], ids=["inf", "nan", "too large"])
@pytest.mark.parametrize(
    "section",
    [
        {"grid": {"omega1": [0.5, 1.0]}},
        {"states": [{"omega": [1, 0, 0]}]},
        {"random": {"count": 2, "omega": {"sphere": 1}}},
    ],
    ids=["grid", "states", "random"],
)
def test_numbers_that_are_replaced_are_finite_too(section: Any, number: float) -> None:
    initial = {"omega": [number, 0, 0], "gamma": [0, 0, 1]}
    with pytest.raises(ConfigError, match=r"initial\.omega: must hold finite numbers, not (inf|nan)"):
        load({**BASE, "initial": initial, "ensemble": section})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("section", "good"),
    [
        ({"random": {"count": 3, "gamma": "sphere"}}, True),
        ({"random": {"count": 3, "gamma": {"near": 0.1}, "omega": {"energy": 4.0}}, "store": "final"}, True),
        ({"grid": {"omega1": [1.0], "top.c0": {"from": 0.0, "to": 1.0, "count": 2}}}, True),
        ({"states": [{"omega": [1, 2, 3]}]}, True),
        ({"states": [{"omga": [1, 2, 3]}]}, False),
        ({"states": []}, False),
        ({"random": {"count": 3}}, False),
        ({"random": {"count": 0, "gamma": "sphere"}}, False),
        ({"random": {"count": 3, "gamma": {"energy": 1}}}, False),
        ({"grid": {"omega4": [1]}}, False),
        ({"grid": {"omega1": {"from": 0, "to": 1}}}, False),
        ({"random": {"count": 3, "gamma": "sphere"}, "store": "some"}, False),
        ({"store": "final"}, False),
    ],
)
def test_schema_and_loader_agree(section: Any, good: bool) -> None:
    data = {**BASE, "ensemble": section}
    assert fits(config_schema(), data) == good
    if good:
        loaded(data)
    else:
        with pytest.raises(TopcliError):
            load(data)


def test_schema_requires_initial_states() -> None:
    data = {key: value for key, value in BASE.items() if key != "initial"}
    assert not fits(config_schema(), data)
    assert not fits(config_schema(), {**BASE, "initial": {"omega": [1, 2, 3]}})
    assert fits(
        config_schema(), {**data, "ensemble": {"random": {"count": 1, "gamma": "sphere", "omega": {"sphere": 1}}}}
    )


def test_overrides_reach_the_section() -> None:
    path = CONFIGS / "kowalevski_ensemble.yaml"
    found = load(path, ["ensemble.random.seed=9", "ensemble.store=final", "ensemble.random.count=4"])
    assert isinstance(found, EnsembleExperiment)
    assert (found.count, found.rows) == (4, 4)
    assert found.resolved()["ensemble"]["random"]["seed"] == 9


numbers = st.one_of(st.integers(-3, 3), st.floats(), st.sampled_from(["auto", "sphere", None, True]))
draws = st.one_of(numbers, st.dictionaries(st.sampled_from(["sphere", "near", "energy", "x"]), numbers, max_size=2))
axes = st.one_of(
    numbers,
    st.lists(numbers, max_size=3),
    st.fixed_dictionaries({"from": numbers, "to": numbers, "count": st.one_of(numbers, st.integers(1, 4))}),
)
vectors = st.dictionaries(st.sampled_from(["omega", "gamma", "m", "normalize"]), st.lists(numbers, max_size=3))
sections = st.one_of(
    st.fixed_dictionaries(
        {
            "random": st.fixed_dictionaries(
                {"count": st.integers(0, 4)}, optional={"gamma": draws, "omega": draws, "seed": numbers}
            )
        }
    ),
    st.fixed_dictionaries(
        {
            "grid": st.dictionaries(
                st.sampled_from(["omega1", "gamma3", "gamma1", "top.c0", "top.A", "x"]), axes, max_size=3
            )
        }
    ),
    st.fixed_dictionaries({"states": st.one_of(numbers, st.lists(st.one_of(vectors, numbers), max_size=3))}),
    st.dictionaries(st.sampled_from(["random", "grid", "states", "store", "x"]), numbers, max_size=3),
)


@pytest.mark.slow
@given(section=sections)
@settings(settings.get_profile("ci"), deadline=None, max_examples=200)
def test_any_section_is_refused_in_words_or_round_trips(section: Any) -> None:
    refused = ""
    found = None
    try:
        found = load({**BASE, "ensemble": section})
    except TopcliError as error:
        refused = str(error)
    if refused:
        assert len(refused.splitlines()) <= 3
        return
    assert isinstance(found, EnsembleExperiment)
    assert np.isfinite(states(found)).all()
    assert np.abs((states(found)[:, 3:] ** 2).sum(axis=1) - 1.0).max() <= 2e-12
    assert same(found, loaded(found.resolved()))
