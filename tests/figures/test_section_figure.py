"""``topcli plot section``: the crossings of a stored run."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from topcli.config.load import load
from topcli.errors import UsageError
from topcli.figures.stored import section_figure
from topcli.runs.run import run_experiment

CONFIG = {
    "name": "one",
    "top": "kowalevski",
    "initial": {"omega": [0.3, 0.2, 1.1], "gamma": [0.6, 0.0, 0.8]},
    "scheme": "hk",
    "h": 0.4,
    "N": 4000,
    "section": {"component": "gamma2"},
}


@pytest.mark.parametrize("ensemble", [None, {"states": [{"omega": [0.3, 0.2, 1.1]}, {"omega": [2.0, 1.0, 3.0]}]}])
def test_points_are_the_crossings_of_all_orbits(tmp_path: Path, ensemble: Any) -> None:
    run = run_experiment(load(CONFIG | ({"ensemble": ensemble} if ensemble else {})), tmp_path).stored
    figure = section_figure(run.folder, "gamma1", "omega3", "verdict")
    assert figure.name == "section-one-gamma1-omega3-verdict"
    drawn = pd.read_parquet(figure.make(tmp_path / "figures", ("png",))[-1])
    rows = pd.read_parquet(run.series)
    for name in ("gamma1", "omega3"):
        assert np.array_equal(drawn[name], rows[name])
    orbits = rows["trajectory"] if ensemble else 0 * rows["n"]
    assert np.array_equal(drawn["orbit"], orbits)
    verdicts = drawn.groupby("orbit")["verdict"].unique().explode().tolist()
    assert verdicts == (["chaotic", "regular"] if ensemble else ["chaotic"])


def test_what_cannot_be_drawn_is_refused(tmp_path: Path) -> None:
    folder = run_experiment(load(CONFIG), tmp_path).stored.folder
    never = {**CONFIG, "name": "never", "section": {"component": "gamma2", "value": 2}}
    empty = run_experiment(load(never), tmp_path).stored.folder
    for place, x, message in (
        (tmp_path / "none", None, "no finished run here"),
        (empty, None, "nothing to draw: completed 4000 steps .*; no crossing"),
        (folder, "gama1", "no such column; did you mean 'gamma1'"),
    ):
        with pytest.raises(UsageError, match=message):
            section_figure(place, x, None, None)
