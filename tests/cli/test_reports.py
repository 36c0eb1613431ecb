"""Results of the functions that return a report: tables whose cells are the stored fields, plots, files, notebooks."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from matplotlib import pyplot
from matplotlib.figure import Figure

import topcli
from reading_html import read_html
from stored_results import BASE, START
from topcli.cli.reports import RunReport
from topcli.errors import RunError, UnknownNameError, UsageError
from topcli.store.series import read_series
from topcli.studies.report import PICTURES, Report

CONFIG = {**BASE, "name": "one", "scheme": "hk"}
EIGHT = {"random": {"count": 8, "gamma": "sphere"}}
STUDY = {
    "name": "steps",
    "base": {"top": "kowalevski", "initial": START, "T": 4},
    "grid": {"h": [0.04, 0.02, 0.01], "scheme": ["hk", "rk4"]},
    "measure": ["max_deviation.energy", "max_error"],
}
REPORTS: dict[str, Callable[[Path], Report]] = {
    "run": lambda out: topcli.run(CONFIG, out),
    "run of many": lambda out: topcli.run({**CONFIG, "name": "many", "ensemble": EIGHT}, out),
    "sweep": lambda out: topcli.sweep(STUDY, out),
}
"""A report of each kind, by the name of its function."""


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Any]:
    out = tmp_path_factory.mktemp("results")
    return functools.cache(lambda name: REPORTS[name](out))


@pytest.fixture
def run(reported: Callable[[str], Any]) -> RunReport:
    return reported("run")


@pytest.mark.slow
@pytest.mark.parametrize("name", REPORTS)
def test_every_report_has_table_plain_data_plot_and_html(
    name: str, reported: Callable[[str], Any], tmp_path: Path
) -> None:
    report, axes = reported(name), Figure().add_subplot()
    assert len(report.table) >= 2
    json.dumps(report.as_dict(), allow_nan=False)
    if name == "run of many":
        with pytest.raises(UsageError, match="has no picture"):
            report.plot(axes)
    else:
        assert report.plot(axes) is axes
        assert axes.has_data()
    html = report._repr_html_()
    assert "<img" not in html, "nothing is drawn for it"
    assert len(read_html(html).all("table")[0].cells()) >= 3
    assert repr(report).startswith(f"<{type(report).__name__} of ")
    for suffix in (".json", ".csv", ".html", *(PICTURES if name == "run" else ())):
        assert report.save(tmp_path / "new" / f"saved{suffix}").stat().st_size > 100
    saved = json.loads((tmp_path / "new" / "saved.json").read_text())
    assert report.as_dict().items() <= saved.items()
    read = pd.read_csv(tmp_path / "new" / "saved.csv", index_col=0)
    numbers = report.table.select_dtypes("float")
    assert len(numbers.columns) > 1
    np.testing.assert_array_equal(read[numbers.columns], numbers)


def test_a_run_is_in_its_folder_and_its_table_is_that_of_the_report(run: RunReport) -> None:
    out = run.folder.parent
    assert (run.folder.name, run.outcome.value, run.status) == ("one", "completed", "ran")
    stored = json.loads((out / "one" / "report.json").read_text())
    assert list(run.table.index) == [row["name"] for row in stored["invariants"]]
    for row in stored["invariants"]:
        assert run.table.loc[row["name"]].to_dict() == {key: value for key, value in row.items() if key != "name"}
    series = read_series(out / "one" / "series.parquet")
    np.testing.assert_array_equal(run["gamma2"], series["gamma2"])
    assert list(run.series) == list(series)
    assert topcli.run(CONFIG, out).status == "up to date"
    with pytest.raises(UsageError, match="did you mean 'gamma2'"):
        run["gama2"]


@pytest.mark.slow
def test_without_axes_a_figure_of_pyplot_is_made(run: RunReport) -> None:
    """pyplot's figures are those that a notebook shows."""
    axes = run.plot()
    assert axes.figure.number in pyplot.get_fignums()
    assert [line.get_color() for line in axes.get_lines()][:2] == ["#0072B2", "#D55E00"]
    assert len(axes.get_legend().get_texts()) == 3
    pyplot.close("all")


@pytest.mark.slow
def test_a_sweep_has_the_rows_of_its_file_and_draws_them(tmp_path: Path) -> None:
    """Rows of an earlier sweep file stay in the folder; nothing shows them."""
    swept = topcli.sweep(STUDY, tmp_path, progress=False)
    assert swept.outcomes == {"completed": 6}
    assert swept.as_dict()["rows"] == pq.read_table(tmp_path / "steps" / "rows.parquet").to_pylist()
    lines = swept.plot(Figure().add_subplot()).get_lines()
    for scheme, line in zip(("hk", "rk4"), lines, strict=True):
        mine = swept.table[swept.table["scheme"] == scheme].sort_values("h")
        np.testing.assert_array_equal(line.get_xydata(), mine[["h", "max_deviation.energy"]])
    edited = topcli.sweep({**STUDY, "grid": {"h": [0.05, 0.02], "scheme": ["rk4"]}}, tmp_path, progress=False)
    assert edited.outcomes == {"completed": 2}
    assert edited.table["h"].to_dict() == {0: 0.05, 1: 0.02}


def test_an_error_of_the_user_has_no_traceback_in_a_notebook() -> None:
    """IPython shows the lines of ``_render_traceback_`` in place of one."""
    with pytest.raises(UnknownNameError) as caught:
        topcli.compare("hkk")
    assert caught.value._render_traceback_() == ["UnknownNameError: unknown scheme 'hkk'; did you mean 'hk'?"]
    assert not hasattr(RunError("x"), "_render_traceback_"), "a failure of a run keeps its place"
