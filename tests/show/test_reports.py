"""Results of all functions that return a report: tables whose cells are the stored fields, plots, files, notebooks."""

from __future__ import annotations

import errno
import functools
import json
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from matplotlib.figure import Figure

import topcli
from reading_html import read_html
from stored_results import BASE, START
from topcli.errors import RunError, UnknownNameError, UsageError
from topcli.show.report import ResultReport
from topcli.show.results import RunReport
from topcli.store.series import read_series
from topcli.studies.report import PICTURES

CONFIG = {**BASE, "name": "one", "scheme": "hk"}


EIGHT = {"random": {"count": 8, "gamma": "sphere"}}
STUDY = {
    "name": "steps",
    "base": {"top": "kowalevski", "initial": START, "T": 4},
    "grid": {"h": [0.04, 0.02, 0.01], "scheme": ["hk", "rk4"]},
    "measure": ["max_deviation.energy", "max_error"],
}


REPORTS: dict[str, Callable[[Path], ResultReport]] = {
    "run": lambda out: topcli.run(CONFIG, out),
    "run of many": lambda out: topcli.run({**CONFIG, "name": "many", "ensemble": EIGHT}, out),
    "sweep": lambda out: topcli.sweep(STUDY, out),
    "motion": lambda out: topcli.motion("kowalevski_generic_hk"),
    "motion of euler": lambda out: topcli.motion("euler_hk"),
    "motion of lagrange": lambda out: topcli.motion("lagrange_hk"),
}
"""A report of each kind, by the name of its function."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Any]:
    out = tmp_path_factory.mktemp("results")
    return functools.cache(lambda name: REPORTS[name](out))


@pytest.fixture
def run(made: Callable[[str], Any]) -> RunReport:
    return made("run")


@pytest.fixture
def ensemble(made: Callable[[str], Any]) -> RunReport:
    return made("run of many")


@pytest.fixture
def axes() -> Any:
    return Figure().add_subplot()


@pytest.fixture
def no_figure_is_left() -> Iterator[None]:
    from matplotlib import pyplot

    yield
    pyplot.close("all")


def drawn(axes: Any) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Data of the labelled lines."""
    lines = [line for line in axes.get_lines() if not line.get_label().startswith("_")]
    return {line.get_label(): (np.asarray(line.get_xdata()), np.asarray(line.get_ydata())) for line in lines}


@pytest.mark.slow
@pytest.mark.parametrize("name", REPORTS)
def test_every_report_has_table_plain_data_plot_and_html(
    name: str, made: Callable[[str], Any], axes: Any, tmp_path: Path
) -> None:
    report = made(name)
    assert isinstance(report.table, pd.DataFrame)
    assert len(report.table) >= 2
    json.dumps(report.as_dict(), allow_nan=False)
    drawn = report.plot(axes)
    assert (drawn is axes) == (drawn.name != "3d"), "a body needs axes of space"
    assert drawn.has_data()
    html = report._repr_html_()
    assert "<img" not in html, "nothing is drawn for it"
    assert len(read_html(html).all("table")[0].cells()) >= 3
    assert repr(report).startswith(f"<{type(report).__name__} of ")
    for suffix in (".html", ".json", ".csv", *(PICTURES if name == "run" else ())):
        (tmp_path / "new").mkdir(exist_ok=True)
        path = report.save(tmp_path / "new" / f"saved{suffix}")
        assert path.stat().st_size > 100
    expected = values_of(report.table)
    read = values_of(pd.read_csv(tmp_path / "new" / "saved.csv", keep_default_na=False, index_col=0))
    assert [list(row) for row in read] == [list(row) for row in expected]
    for row, other in zip(read, expected, strict=True):
        for key, value in other.items():
            if isinstance(value, int | float) and not isinstance(value, bool):
                assert float(row[key]) == value, key
            else:
                assert str(row[key]) == ("" if value is None else str(value)), key
    assert json.loads((tmp_path / "new" / "saved.json").read_text()) == report.as_dict()


def test_a_run_is_in_its_folder_and_its_table_is_that_of_the_report(run: RunReport) -> None:
    out = run.folder.parent
    assert run.folder.name == "one"
    assert (run.outcome.value, run.status) == ("completed", "ran")
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
@pytest.mark.usefixtures("no_figure_is_left")
def test_without_axes_a_figure_of_pyplot_is_made(run: RunReport) -> None:
    """pyplot's figures are those that a notebook shows."""
    from matplotlib import pyplot

    axes = run.plot()
    assert axes.figure.number in pyplot.get_fignums()
    assert [line.get_color() for line in axes.get_lines()][:2] == ["#0072B2", "#D55E00"]
    assert len(axes.get_legend().get_texts()) == 3


@pytest.mark.slow
def test_sweep_has_its_rows_and_draws_them(made: Callable[[str], Any]) -> None:
    swept = made("sweep")
    assert len(swept.table) == 6
    assert swept.outcomes == {"completed": 6}
    lines = drawn(swept.plot(Figure().add_subplot()))
    assert [label.partition(":")[0] for label in lines] == ["HK", "RK4"]
    for scheme, (x, y) in zip(("hk", "rk4"), lines.values(), strict=True):
        mine = swept.table[swept.table["scheme"] == scheme].sort_values("h")
        np.testing.assert_array_equal(x, mine["h"])
        np.testing.assert_array_equal(y, mine["max_deviation.energy"])
    axes = swept.plot(Figure().add_subplot(), x="scheme", y="max_error", aggregate="max")
    assert axes.get_ylabel() == "max error (max)"
    worst = swept.table.groupby("scheme")["max_error"].max()
    assert sorted(axes.get_lines()[0].get_ydata()) == sorted(worst)
    with pytest.raises(UsageError, match="unknown measure 'x'"):
        swept.plot(y="x")
    with pytest.raises(UsageError, match=r"several rows|aggregate"):
        swept.plot(x="scheme", y="max_error")


@pytest.mark.slow
def test_sweep_of_an_edited_file_shows_its_own_rows(tmp_path: Path) -> None:
    """Rows of the earlier file stay in the folder, for the day when they are wanted again; nothing shows them."""
    topcli.sweep(STUDY, tmp_path, progress=False)
    edited = {**STUDY, "grid": {"h": [0.05, 0.02], "scheme": ["rk4"]}}
    found = topcli.sweep(edited, tmp_path, progress=False)
    assert (found.result.ran, found.outcomes) == (1, {"completed": 2})
    assert found.table["h"].to_dict() == {0: 0.05, 1: 0.02}
    assert set(found.table["scheme"]) == {"rk4"}
    plain = found.as_dict()
    assert [(row["row"], row["h"], row["scheme"]) for row in plain["rows"]] == [(0, 0.05, "rk4"), (1, 0.02, "rk4")]
    values = {0.05: found.table["max_error"][0], 0.02: found.table["max_error"][1]}
    ((x, y),) = drawn(found.plot(Figure().add_subplot(), x="h", y="max_error")).values()
    assert dict(zip(x.tolist(), y.tolist(), strict=True)) == values
    again = topcli.sweep(STUDY, tmp_path, progress=False)
    assert (again.result.ran, len(again.table)) == (0, 6)


def test_a_file_of_another_type_is_refused_and_an_earlier_one_is_kept(run: RunReport, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"'run\.xlsx': unknown type of file; use \.html"):
        run.save(tmp_path / "run.xlsx")
    path = tmp_path / "run.csv"
    path.write_text("mine")

    def full(file: Path, content: bytes) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.MonkeyPatch.context() as broken:
        broken.setattr(Path, "write_bytes", full)
        with pytest.raises(RunError, match=r"run\.csv: no space left on the device; nothing was written"):
            run.save(path)
    assert path.read_text() == "mine"
    assert [one.name for one in tmp_path.iterdir()] == ["run.csv"]


def test_html_of_a_report_is_escaped(run: RunReport) -> None:
    evil = "<script>alert(1)</script>"
    rows = [row | {"symbol": evil} for row in run.result.report["invariants"]]
    report = RunReport(replace(run.result, report={**run.result.report, "name": evil, "invariants": rows}))
    page = read_html(report._repr_html_())
    assert evil in page.text
    assert not page.all("script")


def test_an_error_of_the_user_has_no_traceback_in_a_notebook() -> None:
    """IPython shows the lines of ``_render_traceback_`` in place of one."""
    with pytest.raises(UnknownNameError) as caught:
        topcli.compare("hkk")
    assert caught.value._render_traceback_() == ["UnknownNameError: unknown scheme 'hkk'; did you mean 'hk'?"]
    assert not hasattr(RunError("x"), "_render_traceback_"), "a failure of a run keeps its place"


def values_of(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of a table with its index, as plain data; missing numbers are None."""
    rows = table.reset_index().to_dict("records")
    plain = [
        {key: value.item() if isinstance(value, np.generic) else value for key, value in row.items()} for row in rows
    ]
    return [{k: None if isinstance(v, float) and math.isnan(v) else v for k, v in row.items()} for row in plain]


def test_a_table_of_a_sweep_is_its_file(tmp_path: Path) -> None:
    base = {key: value for key, value in CONFIG.items() if key not in ("name", "h", "N")} | {"T": 0.4}
    grid = {"h": [0.04, 0.02], "scheme": ["hk", "rk4"]}
    measures = ["max_deviation.energy", "max_error"]
    found = topcli.sweep({"name": "s", "base": base, "grid": grid, "measure": measures}, tmp_path)
    rows = pq.read_table(tmp_path / "s" / "rows.parquet").to_pylist()
    assert values_of(found.table) == rows
    assert found.as_dict()["rows"] == rows
