"""What follows from the declaration of a study and of a table."""

from __future__ import annotations

import inspect
import math
from typing import Any, get_args

import pytest

import topcli
from topcli.cli.study import command
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
