"""Quantities of ``output``: columns, reports and measures of formulas that a user writes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import topcli
from custom_tops import config
from sweeping import sweep, table
from topcli.config.load import load
from topcli.errors import ConfigError
from topcli.runs.run import run_experiment
from topcli.store.series import read_series

QUANTITIES = {"spin": "sqrt(w1**2 + w2**2 + w3**2)", "phase": "w3*t + k*h - 0.1", "half": 0.5}
FIGURES = ("first", "last", "min", "max", "mean")


def with_quantities(**changes):
    output = {"quantities": QUANTITIES, **changes.pop("output", {})}
    return config(output=output, name="observed", **changes)


def expected(columns, k: float = 0.3, h: float = 0.01):
    spin = np.sqrt(columns["w1"] ** 2 + columns["w2"] ** 2 + columns["w3"] ** 2)
    return {"spin": spin, "phase": columns["w3"] * columns["t"] + k * h - 0.1, "half": np.full(len(spin), 0.5)}


@pytest.mark.parametrize("fmt", ["parquet", "csv"])
def test_quantities_are_columns_and_their_figures_are_in_the_report(tmp_path: Path, fmt: str) -> None:
    result = run_experiment(load(with_quantities(output={"format": fmt})), tmp_path)
    series = read_series(result.stored.series)
    assert list(series) == ["n", "t", "w1", "w2", "w3", "energy", "momentum", "spin", "phase", "half"]
    rows = {row["name"]: row for row in result.report["quantities"]}
    assert [row["formula"] for row in rows.values()] == [QUANTITIES["spin"], QUANTITIES["phase"], "0.5"]
    for name, values in expected(series).items():
        assert series[name] == pytest.approx(values, rel=1e-15, abs=1e-16)
        figures = (values[0], values[-1], values.min(), values.max(), values.mean())
        assert [rows[name][figure] for figure in FIGURES] == pytest.approx(figures, rel=1e-12)
    stored = json.loads((result.stored.folder / "report.json").read_text())
    assert stored["quantities"] == result.report["quantities"]


def test_quantities_of_an_ensemble(tmp_path: Path) -> None:
    many = with_quantities(ensemble={"grid": {"top.k": [0.1, 0.6], "w1": [0.5, 0.7]}})
    result = run_experiment(load(many), tmp_path)
    series = read_series(result.stored.series)
    for trajectory in range(4):
        rows = {name: values[series["trajectory"] == trajectory] for name, values in series.items()}
        for name, values in expected(rows, k=(0.1, 0.6)[trajectory // 2]).items():
            assert rows[name] == pytest.approx(values, rel=1e-15, abs=1e-16)
    ensemble = topcli.simulate(many)
    trajectories = ensemble.trajectories()
    assert ensemble["phase"][3] == pytest.approx(rows["phase"], rel=1e-15)
    assert ensemble[3]["spin"].tolist() == ensemble["spin"][3].tolist()

    table, report = read_series(result.stored.folder / "trajectories.parquet"), result.report
    for row in report["quantities"]:
        name = row["name"]
        values = series[name].reshape(4, -1)
        figures = (values[:, 0], values[:, -1], values.min(axis=1), values.max(axis=1), values.mean(axis=1))
        joined = (np.mean, np.mean, np.min, np.max, np.mean)
        for figure, numbers, join in zip(FIGURES, figures, joined, strict=True):
            assert table[f"{figure}.{name}"] == pytest.approx(numbers, rel=1e-14)
            assert trajectories[f"{figure}.{name}"].tolist() == table[f"{figure}.{name}"].tolist()
            assert row[figure] == pytest.approx(join(numbers), rel=1e-14)


@pytest.mark.parametrize("store", ["trajectories", "final", "statistics"])
def test_the_last_value_is_that_of_the_last_step(tmp_path: Path, store: str) -> None:
    """Also where N is no multiple of ``every``; of a trajectory that ends early, it is that of its last row."""
    explosion = {"field": {"x": "x**2"}, "kind": "custom", "components": ["x"]}
    given = {"name": "x", "top": explosion, "scheme": "rk4", "h": 0.01, "N": 103, "initial": {}}
    given |= {"output": {"every": 10, "quantities": {"later": "x + t"}}}
    run = run_experiment(load({**given, "ensemble": {"states": [{"x": 0.5}, {"x": 4}], "store": store}}), tmp_path)
    table = read_series(run.stored.folder / "trajectories.parquet")
    assert table["outcome"].tolist() == ["completed", "blew_up"]
    for i, (start, n) in enumerate([(0.5, 103), (4, table["n"][1] // 10 * 10)]):
        alone = topcli.simulate({**given, "initial": {"x": start}, "output": {}})
        assert table["last.later"][i] == alone["x"][n] + alone.t[n]


def test_a_quantity_without_a_value_is_no_number_in_any_precision(tmp_path: Path) -> None:
    """A logarithm, a quotient, an arc: at the start only, in all rows, or nowhere."""
    quantities = {"root": "log(-w1**2)", "pole": "1/t", "arc": "acos(2 + w1**2)", "turn": "atan2(w2, w1)/pi"}
    given = config(output={"quantities": quantities}, N=20)
    double = topcli.simulate(given)
    run = run_experiment(load({**given, "precision": 40}), tmp_path)
    series = read_series(run.stored.series)
    for name in quantities:
        finite = np.isfinite(double[name])
        assert finite.sum() == {"pole": 20, "turn": 21}.get(name, 0)
        assert series[name][finite] == pytest.approx(double[name][finite], rel=1e-14)
        assert np.array_equal(np.isfinite(series[name]), finite)


def test_measures_of_quantities(tmp_path: Path) -> None:
    base = {**config(), "output": {"quantities": QUANTITIES, "every": 5}}
    study = {
        "name": "study",
        "base": base,
        "grid": {"top.parameters.k": [0.1, 0.4]},
        "measure": ["max.spin", "mean.phase"],
    }
    sweep(tmp_path, study)
    for row in table(tmp_path):
        k = row["top.parameters.k"]
        run = topcli.simulate(config(output={"every": 5}), overrides=[f"top.parameters.k={k}"])
        observed = expected({name: run[name] for name in ("t", "w1", "w2", "w3")}, k)
        assert row["max.spin"] == pytest.approx(observed["spin"].max(), rel=1e-14)
        assert row["mean.phase"] == pytest.approx(observed["phase"].mean(), rel=1e-13)


@pytest.mark.parametrize(
    ("quantities", "message"),
    [
        ({"x": "w4"}, "output.quantities.x: column 1: unknown name 'w4'; known: w1, w2"),
        ({"x": "energy"}, "output.quantities.x: column 1: unknown name 'energy'; known: w1, w2, w3, t, A, B, C, k, h"),
        ({"x": [1]}, "output.quantities.x: must be a formula such as 2*w1, not a list"),
        ({"x": {"value": "w1"}}, "output.quantities.x: must be a formula such as 2*w1, not a section"),
        ({"w1": "w2"}, "output.quantities.w1: 'w1' already names the component"),
        ({"k": "w2"}, "output.quantities.k: 'k' already names the parameter"),
        ({"energy": "w2"}, "output.quantities.energy: 'energy' already names the invariant"),
        ({"psi": "w2"}, "output.quantities.psi: 'psi' already names the column of the attitude"),
        ({"t": "w2"}, "output.quantities.t: 't' is taken"),
        ({"a b": "w2"}, "a name has letters, digits and _"),
        ("w1", "output.quantities: must be a section, not the text 'w1'"),
    ],
)
def test_what_is_no_quantity_is_refused(quantities, message: str) -> None:
    with pytest.raises(ConfigError) as error:
        load(config(output={"quantities": quantities}))
    assert message in str(error.value)
    study = {"name": "s", "base": config(output={"quantities": quantities}), "grid": {"h": [0.1, 0.2]}}
    with pytest.raises(ConfigError) as error:
        topcli.sweep({**study, "measure": ["steps"]})
    assert message in str(error.value)
