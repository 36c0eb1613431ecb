"""``topcli plot section``: the crossings of stored runs."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from topcli.config.load import load
from topcli.errors import UsageError
from topcli.figures.section import section_figure
from topcli.runs.run import run_experiment

CONFIG = {
    "name": "one",
    "top": "kowalevski",
    "initial": {"omega": [0.3, 0.2, 1.1], "gamma": [0.6, 0.0, 0.8]},
    "scheme": "hk",
    "h": 0.1,
    "N": 4000,
    "section": {"component": "gamma2"},
}


def test_points_are_the_crossings_of_all_runs(tmp_path: Path) -> None:
    states = [{"omega": [0.3, 0.2, 1.1]}, {"omega": [1.0, 0.2, 0.5]}]
    many = {**CONFIG, "name": "many", "ensemble": {"states": states}}
    runs = [run_experiment(load(config), tmp_path).stored for config in (CONFIG, many)]
    figure = section_figure([run.folder for run in runs], "gamma1", "omega3", "verdict")
    assert figure.name == "section-one-many-gamma1-omega3-verdict"
    drawn = pd.read_parquet(figure.make(tmp_path / "figures", ("png",))[-1])
    one, two = (pd.read_parquet(run.series) for run in runs)
    for name in ("gamma1", "omega3"):
        assert np.array_equal(drawn[name], np.concatenate([one[name], two[name]]))
    assert np.array_equal(drawn["orbit"], np.concatenate([np.zeros(len(one)), 1 + two["trajectory"]]))
    assert (drawn["verdict"][drawn["orbit"] == 0] == drawn["verdict"][drawn["orbit"] == 1].iloc[0]).all()


def test_what_cannot_be_drawn_is_refused(tmp_path: Path) -> None:
    folder = run_experiment(load(CONFIG), tmp_path).stored.folder
    plain = {name: value for name, value in CONFIG.items() if name != "section"} | {"name": "plain"}
    steps = run_experiment(load(plain), tmp_path).stored.folder
    never = {**CONFIG, "name": "never", "section": {"component": "gamma2", "value": 2}}
    empty = run_experiment(load(never), tmp_path).stored.folder
    other = {**CONFIG, "name": "other", "section": {"component": "gamma3"}}
    apart = run_experiment(load(other), tmp_path).stored.folder
    for folders, x, colour, message in (
        ([], None, None, "name folders of runs"),
        ([tmp_path / "none"], None, None, "no finished run here"),
        ([steps], None, None, "recorded steps, not a section"),
        ([empty], None, None, "nothing to draw: completed 4000 steps .*; never crossed"),
        ([folder, apart], None, None, "its top, scheme, h, section or quantities differ"),
        ([folder], "gama1", None, "no such column; did you mean 'gamma1'"),
        ([folder], None, "drift", "coloured by orbit, or with --colour verdict"),
    ):
        with pytest.raises(UsageError, match=message):
            section_figure(folders, x, None, colour)
