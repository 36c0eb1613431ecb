"""Indicators of chaos on random orbits, against the verdicts of runs 20 times as long."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import topcli
from topcli.analysis.frequencies import agreement_digits
from topcli.analysis.lyapunov import growth_of
from topcli.config.load import load_experiment

ORBITS, N, LONGER = 64, 10_000, 20
CONFIG = {"name": "indicators", "scheme": "hk", "N": N, "initial": {"omega": [1, 0, 0], "gamma": [1, 0, 0]}}


def states(seed: int) -> NDArray[np.float64]:
    y = np.random.default_rng(seed).normal(size=(ORBITS, 6))
    y[:, :3] *= 1.5
    y[:, 3:] /= np.linalg.norm(y[:, 3:], axis=1)[:, None]
    return y


def verdicts(top: str, h: float, steps: int, y: NDArray[np.float64]) -> NDArray[np.str_]:
    experiment = load_experiment({**CONFIG, "top": top, "h": h})
    growth = growth_of(experiment.top, experiment.scheme, experiment.method(), h, steps, y)
    return np.array([verdict.value for verdict in growth.verdicts])


def fewest_digits(top: str, h: float, y: NDArray[np.float64]) -> NDArray[np.float64]:
    orbits = topcli.simulate({**CONFIG, "top": top, "h": h, "output": {"every": 1}}, states=y)
    return agreement_digits(np.moveaxis(orbits.states, 2, 1)).min(axis=1)


@pytest.mark.slow
@pytest.mark.parametrize(("h", "chaotic"), [(0.3, (4, 20)), (0.6, (20, 45))])
def test_verdicts_are_those_of_longer_runs(h: float, chaotic: tuple[int, int]) -> None:
    """Neither many misses nor a single false alarm among orbits of both kinds."""
    y = states(3)
    truth, found = verdicts("kowalevski", h, LONGER * N, y), verdicts("kowalevski", h, N, y)
    assert chaotic[0] <= (truth == "chaotic").sum() <= chaotic[1]
    known = np.isin(truth, ["regular", "chaotic"])
    assert known.sum() >= ORBITS - 3
    assert not ((found == "chaotic") & (truth == "regular")).any()
    assert ((found == "regular") & (truth == "chaotic")).sum() <= 2
    assert (known & (found == "undecided")).sum() <= 2
    digits = fewest_digits("kowalevski", h, y)
    assert np.median(digits[truth == "chaotic"]) < 3.0
    assert np.quantile(digits[truth == "regular"], 0.1) > 3.0


def test_no_orbit_of_an_integrable_map_is_chaotic() -> None:
    y = states(4)
    assert (verdicts("lagrange", 0.3, N, y) == "regular").all()
    assert np.quantile(fewest_digits("lagrange", 0.3, y), 0.1) > 4.0  # few have slow motions
