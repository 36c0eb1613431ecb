"""Groups of the commands, and options that mean the same wherever they occur."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import pytest
from typer.main import get_command

from conftest import Said
from topcli import STUDIES
from topcli.cli.app import all_commands, app
from topcli.cli.commands import GROUPS

CONTEXTS = all_commands()
GROUP = get_command(app)


def test_every_command_is_in_one_group_of_the_help(cli: Callable[..., Said]) -> None:
    listed = [name for group in GROUPS.values() for name in group]
    assert sorted(listed) == sorted(GROUP.commands)  # pyright: ignore[reportAttributeAccessIssue]
    text = cli("--help").out
    places = [text.index(f"\n{title}:\n") for title in GROUPS]
    assert places == sorted(places)
    for (_, group), start, end in zip(GROUPS.items(), places, [*places[1:], len(text)], strict=True):
        shown = [line.split()[0] for line in text[start:end].split("\n\n")[0].splitlines() if line[:2] == "  "]
        assert shown == list(group)


def options() -> list[tuple[str, Any]]:
    """Options of all commands, each with the name of its command."""
    return [
        (name, parameter)
        for name, context in CONTEXTS.items()
        for parameter in context.command.get_params(context)
        if parameter.param_type_name == "option"
    ]


def meanings(found: list[tuple[str, Any]]) -> dict[str, dict[tuple[Any, ...], list[str]]]:
    """Commands by the names, the type of a value and the help of each option, by the option."""
    table: dict[str, dict[tuple[Any, ...], list[str]]] = {}
    for command, option in found:
        names = sorted(option.opts + option.secondary_opts, key=len)
        kind = "flag" if option.is_flag else re.sub(r"list\[(.*)\]", r"\1", option.bare_type())
        meaning = (*names, kind, option.help)
        table.setdefault(names[-1], {}).setdefault(meaning, []).append(command)
    return table


def test_an_option_means_the_same_everywhere() -> None:
    table = meanings(options())
    assert len(table) > 50
    assert {name: different for name, different in table.items() if len(different) > 1} == {}
    short = [name for different in table.values() for names in different for name in names if re.fullmatch("-.", name)]
    assert len(set(short)) == len(short)


COMMON = {
    "--out": "run sweep plot report animate table",
    "--results": "report plot animate table verify show list-runs",
    "--format": "table plot",
    "--force": "run sweep plot report animate table init",
    "--quiet": "run sweep plot report animate table verify init",
}
"""Commands that have an option, besides what is said of studies."""


@pytest.mark.parametrize("option", COMMON)
def test_a_common_option_is_where_it_can_be_used(option: str) -> None:
    having = {command for command, one in options() if option in one.opts}
    studies = STUDIES if option in ("--force", "--quiet") else ()
    assert having == {*(name.replace("list-", "list ") for name in COMMON[option].split()), *studies}
