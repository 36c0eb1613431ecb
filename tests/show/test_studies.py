"""Command and function of a study have the parameters of its measure."""

from __future__ import annotations

import inspect
from typing import Any, get_args

import pytest

import topcli
from topcli.cli.study import command
from topcli.studies import STUDIES, find_study
from topcli.studies.study import PYTHON_ONLY


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
