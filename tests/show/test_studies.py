"""What follows from the declaration of a study and of a table, and the progress of functions."""

from __future__ import annotations

import inspect
import io
import math
import sys
from types import ModuleType
from typing import Any, get_args

import pytest

import topcli
from topcli.cli.study import command
from topcli.show import progress
from topcli.studies import STUDIES, find_study
from topcli.studies.study import PYTHON_ONLY
from topcli.table import Column, Table, number

DATA = {"rows": [{"name": "a", "deep": {"x": 0.125}, "y": 2.0}, {"name": "b", "deep": None, "y": math.inf}]}


COLUMNS = (
    Column("name", "name"),
    Column("x", "deep.x", number),
    Column("", "y"),
    Column("twice y", lambda row: 2 * row["y"], "{:g}".format),
    Column(" ", lambda row: row["name"] * 2, key="double"),
)


def test_a_column_is_shown_by_its_heading_and_kept_by_its_name() -> None:
    table = Table("rows", COLUMNS, index="name", caption=lambda data: f"{len(data['rows'])} rows")
    cells = table.cells(DATA)
    assert cells.header == ["name", "x", "twice y", ""]
    assert cells.lines == [["a", "0.125", "4", "aa"], ["b", "–", "inf", "bb"]]
    assert cells.caption == "2 rows"
    assert cells.markdown()[:2] == ["| name | x | twice y |  |", "| --- | --- | --- | --- |"]
    frame = table.frame(DATA)
    assert (frame.index.name, list(frame.index), list(frame.columns)) == ("name", ["a", "b"], ["deep.x", "y", "double"])
    assert frame.loc["a"].tolist() == [0.125, 2.0, "aa"]


def test_rows_across_are_columns_of_the_text_and_rows_of_the_frame() -> None:
    table = Table("rows", COLUMNS[1:3], across=COLUMNS[0], index="name")
    assert table.cells(DATA).header == ["name", "a", "b"]
    assert table.cells(DATA).lines == [["x", "0.125", "–"]]
    assert table.frame(DATA)["y"].to_dict() == {"a": 2.0, "b": math.inf}


def _flag(parameter: inspect.Parameter) -> Any:
    return (*get_args(parameter.annotation)[1:], None)[0]


@pytest.mark.parametrize("name", STUDIES)
def test_command_and_function_have_the_parameters_of_measure(name: str) -> None:
    study = find_study(name)
    doc = inspect.getdoc(study.measure) or ""
    assert doc.splitlines()[0] == STUDIES[name].help
    assert len(STUDIES[name].help) <= 60
    parameters = inspect.signature(study.measure, eval_str=True).parameters
    own = [key for key in parameters if key != "watch"]
    function = inspect.signature(getattr(topcli, name)).parameters
    assert [key for key in function if key != "progress"] == own
    options = inspect.signature(command(study)).parameters
    for key in own:
        parameter = parameters[key]
        hidden = _flag(parameter) is PYTHON_ONLY or parameter.kind is inspect.Parameter.VAR_KEYWORD
        assert (key in options) != hidden
        assert hidden or get_args(options[key].annotation)[-1].help.endswith("."), key


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def notebook(monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that looks like the kernel of a notebook."""
    monkeypatch.setitem(sys.modules, "IPython", ModuleType("IPython"))
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    monkeypatch.setattr(sys, "stderr", io.StringIO())


def ticks(*times: float) -> Any:
    return iter(times).__next__


def test_a_pipe_gets_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    monkeypatch.delitem(sys.modules, "IPython", raising=False)
    assert progress.progress_console() is None
    with progress.Progress("x", clock=ticks(0.0, 9.0)) as shown:
        shown(1, 2)
        assert shown._bar is None


@pytest.mark.usefixtures("notebook")
@pytest.mark.parametrize("widgets", [True, False])
def test_a_notebook_gets_its_widget_if_it_has_one(monkeypatch: pytest.MonkeyPatch, widgets: bool) -> None:
    """Without ipywidgets rich would print a warning instead of a bar."""
    monkeypatch.setattr(progress, "find_spec", lambda name: object() if widgets and name == "ipywidgets" else None)
    console = progress.progress_console()
    assert (console is not None) == widgets
    if console is not None:
        assert console.is_jupyter


def test_a_terminal_gets_a_bar_after_half_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delitem(sys.modules, "IPython", raising=False)
    with progress.Progress("[bold]run\x1b", clock=ticks(0.0, 0.4, 0.6, 5.0)) as shown:
        shown(1, 100)
        assert shown._bar is None
        shown(2, 100)
        shown(50, 100, "3 failed")
        assert shown._bar is not None
        from rich.console import Console

        console = Console(width=200)
        with console.capture() as captured:
            console.print(shown._bar.get_renderable())
    assert r"[bold]run\x1b" in captured.get()
    assert "50.0%  10.7 steps/s, 5 s left, 3 failed" in captured.get()
    assert shown._bar is None


@pytest.mark.parametrize(("shown", "term"), [(False, "xterm"), (True, "dumb")])
def test_no_bar_if_not_wanted_or_not_possible(monkeypatch: pytest.MonkeyPatch, shown: bool, term: str) -> None:
    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setenv("TERM", term)
    monkeypatch.delitem(sys.modules, "IPython", raising=False)
    with progress.Progress("x", shown, clock=ticks(0.0, 9.0, 10.0)) as silent:
        silent(1, 2)
        assert silent._bar is None
