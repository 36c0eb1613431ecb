"""The sweep files in ``configs/sweeps``: short, and with measures that fit every scheme they name."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

from conftest import ROOT
from topcli.config.files import scene_files
from topcli.config.load import load_experiment
from topcli.config.text import parse_yaml
from topcli.schemes.registry import all_schemes, find_scheme
from topcli.sweeps.batch_run import BatchRun, evaluate
from topcli.sweeps.measures import resolve_measures
from topcli.tops import top_class

FILES = sorted((ROOT / "configs" / "sweeps").iterdir())
SWINGS = "kowalevski_swings"


def sweep(name: str) -> Any:
    path = ROOT / "configs" / "sweeps" / f"{name}.yaml"
    return parse_yaml(path.read_text(encoding="utf-8"), str(path))[0]


@pytest.mark.parametrize("name", [path.stem for path in FILES])
def test_a_ready_sweep_is_short_and_its_measures_fit(name: str) -> None:
    path = ROOT / "configs" / "sweeps" / f"{name}.yaml"
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 30
    assert path.stem not in scene_files()
    found = sweep(name)
    assert found["name"] == name
    top = top_class(found["base"]["top"]).new()
    for scheme in found["grid"]["scheme"]:
        measures = resolve_measures(found["measure"], top, find_scheme(scheme, top.form))
        assert [one.name for one in measures] == found["measure"]


def test_the_sweeps_of_kowalevski_s_top_name_all_of_its_schemes() -> None:
    known = {scheme.name for scheme in all_schemes() if scheme.top == "kowalevski" and scheme.origin == "topcli"}
    assert set(sweep("kowalevski_errors")["grid"]["scheme"]) == known
    assert set(sweep(SWINGS)["grid"]["scheme"]) == known - {"dop853"}


def test_durations_are_whole_numbers_of_steps() -> None:
    for name in ("kowalevski_errors", SWINGS):
        found = sweep(name)
        for h in found["grid"]["h"]:
            assert math.isclose(found["base"]["T"] / h, round(found["base"]["T"] / h), rel_tol=1e-12)


@pytest.mark.slow
def test_the_floor_of_the_swings_is_as_the_sweep_says() -> None:
    """With eps = 1e-3 and 1e-5: the law and the schemes that keep it, HK's floor, and Bohlin A's law in h."""
    eps, law = np.array([1e-3, 1e-5]), 2.0 * math.sqrt(2.0) * np.log(8.0 * math.sqrt(7.0) / np.array([1e-3, 1e-5]))
    states = np.array([(2.0, 0.0, 0.0, math.sqrt(1.0 - x * x), 0.0, x) for x in eps])
    found = {}
    for scheme, h in itertools.product(("dg4", "taylor", "hk", "bohlin-a"), (1e-2, 2e-3)):
        experiment = load_experiment("kowalevski_hk", [f"scheme={scheme}", f"h={h}", f"N={round(70 / h)}"])
        measures = resolve_measures(["swing_spacing.first"], experiment.top, experiment.scheme)
        batch = BatchRun(experiment, measures, threads=1).finished(states)
        found[scheme, h] = evaluate(measures, batch)["swing_spacing.first"]
    for scheme, h in (("dg4", 1e-2), ("taylor", 1e-2)):
        np.testing.assert_allclose(found[scheme, h], law, atol=2e-3)
    assert found["hk", 2e-3][0] == pytest.approx(law[0], abs=0.02)
    assert found["hk", 1e-2][1] < law[1] - 3.0
    for h in (1e-2, 2e-3):
        assert found["bohlin-a", h][0] == pytest.approx(found["bohlin-a", h][1], abs=5e-3)
    slope = (found["bohlin-a", 1e-2][1] - found["bohlin-a", 2e-3][1]) / math.log(5.0)
    assert slope == pytest.approx(-math.sqrt(2.0), rel=0.01)
