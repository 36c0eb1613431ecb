"""Results of all functions that return a report: tables, plots, files, notebooks."""

from __future__ import annotations

import errno
import inspect
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

import topcli
from reading_html import read_html
from stored_results import BASE, START
from topcli.errors import ConfigError, RunError, UnknownNameError, UsageError
from topcli.show.report import SUFFIXES, Report, StudyReport
from topcli.show.results import RunReport, SweepReport
from topcli.store.series import read_series
from topcli.studies.compare import COMPARE
from topcli.studies.study import Result

CONFIG = {**BASE, "name": "one", "scheme": "hk"}
STUDY = {
    "name": "steps",
    "base": {"top": "kowalevski", "initial": START, "T": 4},
    "grid": {"h": [0.04, 0.02, 0.01], "scheme": ["hk", "rk4"]},
    "measure": ["deviation.energy", "error.max"],
}


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("results")


@pytest.fixture(scope="module")
def run(out: Path) -> RunReport:
    return topcli.run(CONFIG, out)


@pytest.fixture(scope="module")
def ensemble(out: Path) -> RunReport:
    return topcli.run({**CONFIG, "name": "many", "ensemble": {"random": {"count": 8, "gamma": "sphere"}}}, out)


@pytest.fixture(scope="module")
def compared() -> StudyReport:
    return topcli.compare("hk", "hk:h=0.02", "hybrid", config=CONFIG)


@pytest.fixture(scope="module")
def swept(out: Path) -> SweepReport:
    return topcli.sweep(STUDY, out)


@pytest.fixture(scope="module")
def ordered() -> StudyReport:
    return topcli.order("hk", "rk4", config="euler_hk", duration=2.0, sizes=[0.1, 0.05, 0.025])


@pytest.fixture(scope="module")
def stressed() -> StudyReport:
    return topcli.stress("hk", "dg4", cases=["delone", "pole", "racket-1e-3"])


@pytest.fixture(scope="module")
def claimed() -> StudyReport:
    return topcli.claims(["matrix-m", "hk-heavy-small", "hk-heavy-equation", "hybrid-reversible"])


@pytest.fixture(scope="module")
def laxed() -> StudyReport:
    return topcli.lax("euler", "hk", overrides=["N=100"])


@pytest.fixture(scope="module")
def rounded() -> StudyReport:
    return topcli.roundoff("hk", "euler_hk", steps=20_000, copies=2)


@pytest.fixture(scope="module")
def analysed(run: RunReport) -> StudyReport:
    return topcli.analyse(run.folder / "series.parquet", CONFIG)


FUNCTIONS = {
    "laxed": "lax",
    "rounded": "roundoff",
    "analysed": "analyse",
    "run": "run",
    "ensemble": "run",
    "compared": "compare",
    "swept": "sweep",
    "ordered": "order",
    "stressed": "stress",
    "claimed": "claims",
    "kowalevski_generic_hk": "motion",
    "euler_hk": "motion",
    "lagrange_hk": "motion",
    "heavy_hk": "motion",
}
"""Function that makes the report of each fixture, or of each packaged scene."""


@pytest.fixture(params=FUNCTIONS)
def report(request: pytest.FixtureRequest) -> Report:
    """Each kind of report in turn."""
    name = request.param
    return topcli.motion(name) if FUNCTIONS[name] == "motion" else request.getfixturevalue(name)


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


def test_every_function_that_returns_a_report_is_tested() -> None:
    functions = {name: getattr(topcli, name) for name in topcli.__all__}
    callables = {name: value for name, value in functions.items() if callable(value) and not isinstance(value, type)}
    returned = {name: str(inspect.signature(value).return_annotation) for name, value in callables.items()}
    assert {name for name, kind in returned.items() if str(kind).endswith("Report")} == set(FUNCTIONS.values())
    assert {kind.__name__ for kind in Report.__subclasses__()} == {returned[name] for name in FUNCTIONS.values()}


@pytest.mark.slow
def test_every_report_has_table_plain_data_plot_and_html(report: Report, axes: Any, tmp_path: Path) -> None:
    assert isinstance(report.table, pd.DataFrame)
    assert len(report.table) >= 2
    json.dumps(report.as_dict(), allow_nan=False)
    study = getattr(report, "declaration", COMPARE)
    drawable = study.figure or study.plotted
    if drawable:
        assert report.plot(axes) is axes
        assert axes.has_data()
    else:
        with pytest.raises(UsageError, match="lax has no picture; see its table"):
            report.plot(axes)
    html = report._repr_html_()
    assert "<svg" not in html, "nothing is drawn for it"
    (block,) = read_html(html).with_class("topcli-result")
    assert len(block.all("table")) == 1
    assert len(block.all("table")[0].cells()) >= 3
    assert repr(report).startswith(f"<{type(report).__name__} of ")
    for suffix in SUFFIXES if drawable else (".html", ".json", ".csv", ".parquet"):
        path = report.save(tmp_path / "new" / f"saved{suffix}")
        assert path.stat().st_size > 100
    page = read_html((tmp_path / "new" / "saved.html").read_text())
    assert not page.with_class("missing")
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "new" / "saved.parquet"), report.table)
    assert len(pd.read_csv(tmp_path / "new" / "saved.csv")) == len(report.table)
    assert json.loads((tmp_path / "new" / "saved.json").read_text()) == report.as_dict()


def test_a_run_is_in_its_folder_and_its_table_is_that_of_the_report(run: RunReport, out: Path) -> None:
    assert run.folder == out / "one"
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


def test_simulation_and_run_have_the_same_bits(run: RunReport) -> None:
    assert (run["omega1"] == topcli.simulate(CONFIG)["omega1"]).all()


def test_changes_name_the_run_by_its_digest(out: Path) -> None:
    changed = topcli.run("kowalevski_hk", out, N=50)
    assert changed.folder.name.startswith("kowalevski_hk-")
    assert topcli.run("kowalevski_hk", out, overrides=["N=50"]).folder == changed.folder
    assert topcli.run("kowalevski_hk", out, N=50, name="short").folder.name == "short"
    with pytest.raises(ConfigError, match="M: unknown key"):
        topcli.run("kowalevski_hk", out, M=50)
    with pytest.raises(UsageError, match="--resume works"):
        topcli.run({**CONFIG, "ensemble": {"random": {"count": 2, "gamma": "sphere"}}}, out, resume=True)


@pytest.mark.slow
def test_a_failed_run_is_repeated_only_on_request(tmp_path: Path) -> None:
    fails = {**CONFIG, "name": "fails", "scheme": "rk4", "initial": {"omega": [300, 200, 100], "gamma": [1, 0, 0]}}
    many = {**fails, "name": "many", "ensemble": {"states": [{"omega": [300, 200, 100]}]}}
    for config in ({**fails, "h": 0.05}, {**many, "h": 0.05}):
        assert topcli.run(config, tmp_path).outcome.value == "blew_up"
        again = [topcli.run(config, tmp_path, retry_failed=retry).status for retry in (False, True)]
        assert again == ["up to date", "ran"]


def test_the_interval_of_checkpoints_reaches_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: set[float] = set()
    monkeypatch.setattr("topcli.runs.recorder.Checkpoints.consider", lambda self, *chunk: seen.add(self.seconds))
    topcli.run(CONFIG, tmp_path)
    topcli.run(CONFIG, tmp_path, checkpoint_every=0.25, force=True)
    assert seen == {10.0, 0.25}


def test_plot_of_a_run_is_its_last_vector_or_the_chosen_columns(run: RunReport) -> None:
    lines = drawn(run.plot(Figure().add_subplot()))
    assert list(lines) == [r"$\gamma_1$", r"$\gamma_2$", r"$\gamma_3$"]
    for number in (1, 2, 3):
        x, y = lines[rf"$\gamma_{number}$"]
        np.testing.assert_array_equal(x, run["t"])
        np.testing.assert_array_equal(y, run[f"gamma{number}"])
    lines = drawn(run.plot(Figure().add_subplot(), columns=["energy", "omega1"]))
    np.testing.assert_array_equal(lines["$E$"][1], run["energy"])
    np.testing.assert_array_equal(lines[r"$\omega_1$"][1], run["omega1"])
    axes = run.plot(Figure().add_subplot(), deviation=True)
    assert axes.get_yscale() == "log"
    energy = np.abs(run["energy"] - run["energy"][0])
    np.testing.assert_array_equal(np.nan_to_num(drawn(axes)["$E$"][1]), energy)
    with pytest.raises(UsageError, match="did you mean 'energy'"):
        run.plot(columns=["enrgy"])


@pytest.mark.slow
@pytest.mark.parametrize("h", [0.01, -0.02])
def test_plot_of_a_run_without_times_is_over_those_of_its_steps(tmp_path: Path, h: float) -> None:
    output = {"columns": ["n", "gamma1", "gamma2", "gamma3", "energy"], "every": 4}
    run = topcli.run({**CONFIG, "h": h, "output": output}, tmp_path, progress=False)
    for options in ({}, {"columns": ["energy"]}, {"deviation": True}):
        for x, _ in drawn(run.plot(Figure().add_subplot(), **options)).values():
            np.testing.assert_allclose(x, np.linspace(0.0, 400 * h, 101), rtol=1e-13)


@pytest.mark.slow
def test_plots_keep_the_style_of_the_callers_axes(run: RunReport) -> None:
    with mpl.rc_context({"axes.prop_cycle": mpl.cycler(color=["#111111", "#222222", "#333333"])}):
        axes = Figure().add_subplot()
    before = dict(mpl.rcParams)
    run.plot(axes)
    assert [line.get_color() for line in axes.get_lines()] == ["#111111", "#222222", "#333333"]
    assert dict(mpl.rcParams) == before


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
def test_plot_of_an_ensemble_is_the_distribution_of_deviations(ensemble: RunReport) -> None:
    lines = drawn(ensemble.plot(Figure().add_subplot()))
    table = read_series(ensemble.folder / "trajectories.parquet")
    x, y = lines["E"]
    np.testing.assert_array_equal(y, np.sort(table["energy_max_deviation"]))
    np.testing.assert_allclose(x, (np.arange(8) + 0.5) / 8)
    median = ensemble.table.loc["energy", "max_deviation, median"]
    assert np.sort(table["energy_max_deviation"])[3] <= median <= np.sort(table["energy_max_deviation"])[4]
    assert ensemble.outcome.value == "completed"
    with pytest.raises(UsageError, match="an ensemble is drawn by"):
        ensemble.plot(columns=["gamma1"])


@pytest.mark.slow
def test_table_of_a_comparison_is_that_of_its_figures(compared: StudyReport) -> None:
    assert list(compared.table.index) == ["hk", "hk:h=0.02", "hybrid"]
    for figures in compared.figures["schemes"]:
        row = compared.table.loc[figures["label"]]
        assert row["max_error"] == figures["max_error"]
        assert row["end_error"] == figures["end_error"]
        assert row["reversal_defect"] == figures["reversal"]["defect"]
        energy = next(one for one in figures["invariants"] if one["name"] == "energy")
        assert (row["energy_max_deviation"], row["energy_drift"]) == (energy["max_deviation"], energy["drift"])
    errors = compared.table["max_error"]
    assert 3.8 < errors["hk:h=0.02"] / errors["hk"] < 4.2
    assert errors["hk"] == compared.series["error:hk"].max()


@pytest.mark.slow
def test_plots_of_a_comparison_are_errors_or_swings(compared: StudyReport) -> None:
    lines = drawn(compared.plot(Figure().add_subplot()))
    assert list(lines) == ["hk", "hk:h=0.02", "hybrid"]
    np.testing.assert_array_equal(lines["hk"][1][1:], compared.series["error:hk"][1:])
    assert np.isnan(lines["hk"][1][0]), "no error at the start, which a logarithmic axis cannot show"
    axes = compared.plot(Figure().add_subplot(), what="swing")
    np.testing.assert_array_equal(drawn(axes)["reference"][1], compared.series["swing:reference"])
    assert axes.get_lines()[0].get_color() == "0.8"
    with pytest.raises(UsageError, match="'error' or 'swing'"):
        compared.plot(what="x")  # pyright: ignore[reportArgumentType]
    with pytest.raises(UsageError, match="name at least one scheme"):
        topcli.compare()


@pytest.mark.slow
def test_comparison_of_an_ensemble(ensemble: RunReport) -> None:
    found = topcli.compare("hk", "rk4", config=ensemble.result.stored.manifest["config"], N=50)
    row = found.figures["schemes"][1]
    assert found.table.loc["rk4", "error.max, median"] == row["measures"]["error.max"]["median"]
    assert found.table.loc["rk4", "reached_end"] == 8
    with pytest.raises(UsageError, match="has no series"):
        found.plot()
    assert "--save" not in found._repr_html_()


@pytest.mark.slow
def test_a_saved_comparison_is_read_by_the_command(compared: StudyReport, tmp_path: Path) -> None:
    from topcli.pages.page import report_page

    path = compared.save(tmp_path / "compared.json")
    assert len(read_html(report_page([str(path)]).text).all("svg")) == 2


@pytest.mark.slow
def test_sweep_has_its_rows_and_draws_them(swept: SweepReport) -> None:
    assert len(swept.table) == 6
    assert swept.outcomes == {"completed": 6}
    lines = drawn(swept.plot(Figure().add_subplot()))
    assert [label.partition(":")[0] for label in lines] == ["hk", "rk4"]
    for scheme, (x, y) in zip(("hk", "rk4"), lines.values(), strict=True):
        mine = swept.table[swept.table["scheme"] == scheme].sort_values("h")
        np.testing.assert_array_equal(x, mine["h"])
        np.testing.assert_array_equal(y, mine["deviation.energy"])
    axes = swept.plot(Figure().add_subplot(), x="scheme", y="error.max", aggregate="max")
    assert axes.get_ylabel() == "error.max (max)"
    worst = swept.table.groupby("scheme")["error.max"].max()
    assert sorted(axes.get_lines()[0].get_ydata()) == sorted(worst)
    with pytest.raises(UnknownNameError, match="unknown measure 'x'"):
        swept.plot(y="x")
    with pytest.raises(UsageError, match=r"several rows|aggregate"):
        swept.plot(x="scheme", y="error.max")


@pytest.mark.slow
def test_sweep_of_an_edited_file_shows_its_own_rows(tmp_path: Path) -> None:
    """Rows of the earlier file stay in the folder, for the day when they are wanted again; nothing shows them."""
    topcli.sweep(STUDY, tmp_path, progress=False)
    edited = {**STUDY, "grid": {"h": [0.05, 0.02], "scheme": ["rk4"]}}
    found = topcli.sweep(edited, tmp_path, progress=False)
    stored = pd.read_parquet(found.folder / "rows.parquet")
    assert sorted(stored["current"]) == [False] * 5 + [True] * 2
    assert (found.result.ran, found.result.plan.left, found.outcomes) == (1, 5, {"completed": 2})
    assert found.table["h"].to_dict() == {0: 0.05, 1: 0.02}
    assert set(found.table["scheme"]) == {"rk4"}
    assert "current" not in found.table
    plain = found.as_dict()
    assert [(row["row"], row["h"], row["scheme"]) for row in plain["rows"]] == [(0, 0.05, "rk4"), (1, 0.02, "rk4")]
    values = {0.05: found.table["error.max"][0], 0.02: found.table["error.max"][1]}
    ((x, y),) = drawn(found.plot(Figure().add_subplot(), x="h", y="error.max")).values()
    assert dict(zip(x.tolist(), y.tolist(), strict=True)) == values
    saved = pd.read_csv(found.save(tmp_path / "table.csv"))
    assert saved["h"].tolist() == [0.05, 0.02]
    page = read_html(found.save(tmp_path / "page.html").read_text())
    (cells,) = [table.cells() for table in page.all("table") if table.cells()[0][0] == "row"]
    assert [row[:3] for row in cells[1:]] == [["0", "0.05", "rk4"], ["1", "0.02", "rk4"]]
    again = topcli.sweep(STUDY, tmp_path, progress=False)
    assert (again.result.ran, len(again.table)) == (0, 6)


@pytest.mark.slow
def test_orders_and_errors(ordered: StudyReport, axes: Any) -> None:
    assert ordered.table.loc["hk", "order"] == pytest.approx(2.0, abs=0.05)
    assert ordered.table.loc["rk4", "order"] == pytest.approx(4.0, abs=0.1)
    points = {one["h"]: one["error"] for one in ordered.study["schemes"][0]["points"]}
    assert ordered.errors["hk"].to_dict() == points
    assert ordered.table.loc["hk", "smallest_error"] == min(points.values())
    (hk, _) = drawn(ordered.plot(axes)).values()
    assert dict(zip(*map(np.ndarray.tolist, hk), strict=True)) == points


@pytest.mark.slow
def test_stress_table_and_grid(stressed: StudyReport, axes: Any) -> None:
    assert stressed.tops == ["kowalevski", "euler"]
    outcomes = {(one["scheme"], one["case"]): one["outcome"] for one in stressed.study["trials"]}
    for (scheme, case), outcome in outcomes.items():
        top = "euler" if case.startswith("racket") else "kowalevski"
        assert stressed.grid(top).loc[scheme, case] == outcome
    assert stressed.grid().shape == (2, 2)
    assert stressed.unexplained.empty
    broken = {**stressed.study, "trials": [one | {"verdict": "unexplained"} for one in stressed.study["trials"]]}
    assert len(replace(stressed, result=Result(broken)).unexplained) == len(stressed.table)
    assert stressed.plot(axes, top="euler").get_xlabel() == "euler"
    with pytest.raises(UnknownNameError, match="did you mean 'euler'"):
        stressed.grid("eulr")
    with pytest.raises(UsageError, match="none of the schemes has this option"):
        topcli.stress("hk", options={"nonsense": 1})


def test_a_file_of_another_type_is_refused_and_an_earlier_one_is_kept(run: RunReport, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"'run\.xlsx': unknown type of file; use \.html"):
        run.save(tmp_path / "run.xlsx")
    path = tmp_path / "run.csv"
    path.write_text("mine")

    def full(table: pd.DataFrame, target: Path) -> None:
        target.write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.MonkeyPatch.context() as broken:
        broken.setattr(pd.DataFrame, "to_csv", full)
        with pytest.raises(RunError, match=r"run\.csv: no space left on the device; nothing was written"):
            run.save(path)
    assert path.read_text() == "mine"
    assert [one.name for one in tmp_path.iterdir()] == ["run.csv"]


def test_html_of_a_report_is_escaped(run: RunReport) -> None:
    evil = "<script>alert(1)</script>"
    rows = [row | {"symbol": evil} for row in run.result.report["invariants"]]
    result = replace(run.result, report={**run.result.report, "name": evil, "invariants": rows})
    chapter = RunReport(result).chapter(None)
    chapter.title = chapter.message = evil
    from topcli.pages.page import fragment

    assert evil in read_html(fragment(chapter)).text
    assert not read_html(fragment(chapter)).all("script")


def test_an_error_of_the_user_has_no_traceback_in_a_notebook() -> None:
    """IPython shows the lines of ``_render_traceback_`` in place of one."""
    with pytest.raises(UnknownNameError) as caught:
        topcli.compare("hkk")
    assert caught.value._render_traceback_() == ["UnknownNameError: unknown scheme 'hkk'; did you mean 'hk'?"]
    assert not hasattr(RunError("x"), "_render_traceback_"), "a failure of a run keeps its place"
