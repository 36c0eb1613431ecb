"""The section ``ensemble`` of a config: what it means, and the laws and energies of its random draws."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from config_texts import ENSEMBLES, PLAIN, refusal, write
from declared import BODIES
from json_schema import fits
from topcli.config.ensemble import Ensemble
from topcli.config.load import load, load_experiment
from topcli.config.models import Experiment
from topcli.config.schema import config_schema
from topcli.contracts import Array, Top
from topcli.errors import ConfigError
from topcli.tops import TOPS


def ensemble(**section: Any) -> Experiment:
    return load({**PLAIN, "ensemble": section})


def many(experiment: Experiment) -> Ensemble:
    assert experiment.ensemble
    return experiment.ensemble


def states(experiment: Experiment) -> Array:
    return many(experiment).states


def same(one: Experiment, other: Experiment) -> bool:
    return one.digest == other.digest and np.array_equal(states(one), states(other))


@pytest.mark.slow
@pytest.mark.parametrize("path", ENSEMBLES, ids=lambda path: path.name)
def test_the_shipped_ensembles_round_trip(path: Path, tmp_path: Path) -> None:
    experiment = load(path)
    assert experiment.name == path.stem
    assert same(experiment, load(experiment.resolved()))
    assert same(experiment, load(write(tmp_path, experiment.to_yaml(), "again.yaml")))
    assert fits(config_schema(), experiment.resolved())
    count = many(experiment).count
    assert experiment.trajectory(count - 1).y0 == tuple(states(experiment)[-1])
    with pytest.raises(IndexError):
        experiment.trajectory(count)
    assert "ensemble: this is an ensemble of" in refusal(path)
    with pytest.raises(ConfigError, match=r"topcli\.simulate take"):
        load_experiment(path)


def test_list_of_states_is_completed_from_initial() -> None:
    found = ensemble(states=[{"omega": [1, 2, 3]}, {"gamma": [0, "-auto", 0.6]}, {}])
    paper = (math.sqrt(1 - 1e-6), 0.0, 1e-3)
    assert states(found).tolist() == [[1, 2, 3, *paper], [2, 0, 0, 0, -0.8, 0.6], [2, 0, 0, *paper]]
    assert same(found, load(found.resolved()))


def test_a_grid_is_a_product_in_the_order_of_the_components() -> None:
    spaced = {"from": -1, "to": 1, "count": 3}
    found = ensemble(grid={"gamma3": [0.6, 0.8], "omega2": spaced, "top.c0": [1, 2], "omega1": [5, 4]})
    assert [top.model_dump()["c0"] for top in many(found).tops] == [1.0, 2.0]
    wanted = [
        (a, b, 0.0, math.sqrt(1 - c * c), 0.0, c) for a, b, c in itertools.product((5, 4), (-1, 0, 1), (0.6, 0.8))
    ]
    assert np.allclose(states(found), wanted, rtol=0, atol=1e-16)
    assert many(found).count == 24
    assert found.trajectory(12).top == many(found).tops[1]
    reordered = ensemble(grid=dict(reversed(found.resolved()["ensemble"]["grid"].items())))
    assert same(found, reordered)
    assert same(found, load(found.resolved()))


@pytest.mark.parametrize(
    ("top", "random", "form"),
    [
        ("lagrange", {"m": {"sphere": 2}, "a": "sphere"}, "lagrange/inertial"),
        ("euler", {"omega": {"energy": 2}, "gamma": "sphere"}, "euler+gamma"),
    ],
)
def test_random_vectors_decide_the_form_of_a_top(top: str, random: dict[str, Any], form: str) -> None:
    section = {"random": {"count": 5, **random}}
    assert load({**PLAIN, "top": top, "initial": {}, "scheme": "bs", "ensemble": section}).top.form == form


# random draws


def test_draws_are_those_of_the_seed() -> None:
    first, fewer, other = (
        states(ensemble(random={"count": count, "seed": seed, "gamma": gamma, "omega": {"near": 0.1}}))
        for count, seed, gamma in ((3000, 5, "sphere"), (700, 5, {"sphere": 1}), (3000, 6, "sphere"))
    )
    assert np.array_equal(first[:700], fewer)
    assert not np.array_equal(first, other)


def within(values: np.ndarray, mean: float, variance: float) -> bool:
    """True if the mean of independent values of a known law is within four standard errors."""
    return abs(float(values.mean()) - mean) < 4.0 * math.sqrt(variance / len(values))


def test_the_sphere_is_uniform() -> None:
    """First, second and fourth moments of every component, the mixed ones, and the length to round-off."""
    gamma = states(ensemble(random={"count": 40_000, "seed": 2, "gamma": "sphere"}))[:, 3:]
    assert np.abs((gamma**2).sum(axis=1) - 1.0).max() < 1e-15
    for x, y in zip(gamma.T, np.roll(gamma, 1, axis=1).T, strict=True):
        assert within(x, 0.0, 1 / 3)
        assert within(x**2, 1 / 3, 1 / 5 - 1 / 9)
        assert within(x**4, 1 / 5, 1 / 9 - 1 / 25)
        assert within(x * y, 0.0, 1 / 15)
    heights = np.sort(gamma[:, 1])  # Archimedes: uniform in [-1, 1]; Kolmogorov's distance
    assert np.abs((heights + 1) / 2 - (np.arange(40_000) + 0.5) / 40_000).max() < 1.95 / math.sqrt(40_000)


def test_a_cap_is_uniform_in_area_and_a_ball_in_volume() -> None:
    found = states(ensemble(random={"count": 20_000, "gamma": {"near": 0.3}, "omega": {"near": 0.5}}))
    centre = np.array([math.sqrt(1 - 1e-6), 0.0, 1e-3])
    assert np.abs((found[:, 3:] ** 2).sum(axis=1) - 1.0).max() < 1e-15
    depth = (1.0 - found[:, 3:] @ centre) / (1.0 - math.cos(0.3))
    assert depth.min() >= -1e-12
    assert depth.max() <= 1.0 + 1e-12
    assert within(depth, 1 / 2, 1 / 12)
    assert within(depth**2, 1 / 3, 1 / 5 - 1 / 9)
    assert within(found[:, 4], 0.0, 0.3**2 / 4)
    distance = np.linalg.norm(found[:, :3] - [2, 0, 0], axis=1) / 0.5
    assert distance.max() <= 1.0
    assert within(distance**3, 1 / 2, 1 / 12)


def body_energy(top: Top, states: Array) -> tuple[Array, Array]:
    """Energy of a body with moments (A, B, C) and mg(x0, y0, z0), and the sum of the magnitudes of its terms."""
    body = top.euler_poisson()
    terms = 0.5 * np.array(body.moments) * states[:, :3] ** 2
    if states.shape[1] == 6:
        terms = np.hstack([terms, np.array(body.gravity) * states[:, 3:]])
    return terms.sum(axis=1), np.abs(terms).sum(axis=1)


@pytest.mark.parametrize("form", BODIES)
def test_energies_are_exact(form: str) -> None:
    """To round-off of the terms, for every form of a top, with directions uniform on the sphere.

    With gravity, some potentials are above the energy, and these states are drawn once more.
    """
    cls = TOPS[form]
    top = cls.new()
    moving = next(name for name in cls.vectors if name not in cls.unit_vectors)
    random = {"count": 20_000, moving: {"energy": 0.3}, **dict.fromkeys(cls.unit_vectors, "sphere")}
    data = {**PLAIN, "top": cls.kind, "scheme": "rk4", "initial": {}, "ensemble": {"random": random}}
    drawn = states(load(data))
    energy, scale = body_energy(top, drawn)
    assert (np.abs(energy - 0.3) <= 4 * np.finfo(float).eps * (scale + 0.3)).all()
    start, stop = cls.vectors[moving]
    unit = drawn[:, start:stop] / np.linalg.norm(drawn[:, start:stop], axis=1, keepdims=True)
    for x in unit.T:
        assert within(x, 0.0, 1 / 3)
        assert within(x**2, 1 / 3, 1 / 5 - 1 / 9)
