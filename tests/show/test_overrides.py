"""Overrides in Python: they follow the config in every function, and a list is never taken for something else."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import pytest

import topcli

POSITIONAL = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
LIST = ["h=0.6", "N=2000"]
STORING = ("run", "sweep")
"""Functions that take a folder after the config; their overrides have to be named."""


def functions() -> dict[str, Callable[..., Any]]:
    """All public functions with overrides."""
    public = {name: getattr(topcli, name) for name in topcli.__all__}
    found = {name: one for name, one in public.items() if inspect.isfunction(one)}
    return {name: one for name, one in found.items() if "overrides" in inspect.signature(one).parameters}


def test_overrides_follow_the_config() -> None:
    """By position where the config has one, otherwise by name; nothing else follows them by position."""
    for name, one in functions().items():
        parameters = list(inspect.signature(one).parameters.values())
        place = [each.name for each in parameters].index("overrides")
        if name in STORING:
            assert parameters[place].kind is inspect.Parameter.KEYWORD_ONLY, name
            continue
        assert parameters[place - 1].name == "config", name
        assert parameters[place].kind is parameters[place - 1].kind, name
        assert not [each for each in parameters[place + 1 :] if each.kind in POSITIONAL], name
    assert set(functions()) > {"lyapunov", "compare", "order", "simulate", "step", "motion", *STORING}


@pytest.mark.parametrize("name", ["lyapunov", "frequencies"])
def test_overrides_by_position_are_those_by_name(name: str) -> None:
    function = getattr(topcli, name)
    by_place = function("kowalevski_generic_hk", LIST).as_dict()
    assert by_place == function("kowalevski_generic_hk", overrides=LIST).as_dict()
    assert (by_place["config"]["h"], by_place["config"]["N"]) == (0.6, 2000)


def test_overrides_by_position_of_a_run_in_memory() -> None:
    assert topcli.simulate("euler_hk", ["N=7"]).n[-1] == 7
    assert len(topcli.simulate("euler_hk", ["N=7"], states=[[1.0, 0.2, 0.3]]).n) == 8
    assert topcli.motion("euler_hk", ["initial.omega=[0, 0, 2]"]).experiment.y0 == (0.0, 0.0, 2.0)
    assert topcli.step("euler_hk", ["h=0.25"]).h == 0.25
