"""Examples of all commands, and options that mean the same wherever they occur."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Collection
from copy import copy
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from conftest import ROOT, Said
from documentation import read_page
from topcli.cli.app import all_commands, app
from topcli.cli.commands import FIRST_EXAMPLES, GROUPS, examples_of
from topcli.config.files import scene_files, sweep_files
from topcli.config.load import load
from topcli.config.sweep import load_sweep
from topcli.figures.catalogue import FIGURES
from topcli.paper.ledger import claim_names
from topcli.schemes.registry import all_schemes, unload_plugin_files
from topcli.studies import STUDIES
from topcli.studies.bench.contest import SCENES
from topcli.studies.stress.cases import CASES
from topcli.tops import top_names

CONTEXTS = all_commands()
GROUP = get_command(app)
NAMES: dict[str, Callable[[], Collection[str]]] = {
    "SCHEME": lambda: {scheme.name for scheme in all_schemes()},
    "TOP": top_names,
    "CONFIG": lambda: {*scene_files(), "experiment.yaml"},
    "RUN": lambda: {*scene_files(), *sweep_files()},
    "SWEEP": sweep_files,
    "FIGURE": lambda: {*FIGURES, *sweep_files(), "sweep"},
    "CASE": lambda: {case.name for case in CASES},
    "SCENE": lambda: SCENES,
    "ID": claim_names,
    "MEASURE": lambda: {measure for name in sweep_files() for measure in load_sweep(name).measures},
    "KEY": lambda: {key for name in sweep_files() for key in load_sweep(name).keys},
}
"""Names that exist, by the words for them in the help."""


def parsed(line: str) -> tuple[str, Any]:
    """Name of the command of a line, and its context. Raises an error of typer for wrong options."""
    words = shlex.split(line.partition(" > ")[0])
    assert words[0] == "topcli"
    name = max((name for name in CONTEXTS if words[1 : 1 + len(name.split())] == name.split()), key=len)
    return name, CONTEXTS[name].command.make_context(name, words[1 + len(name.split()) :])


def unknown(context: Any) -> list[str]:
    """Names in an example that do not exist."""
    wrong = []
    for parameter in context.command.params:
        value = context.params.get(parameter.name)
        words = str(parameter.metavar or "").partition("[")[0].split("|")
        if value is None or not set(words) & NAMES.keys():
            continue
        known = {name for word in words if word in NAMES for name in NAMES[word]()}
        given = value if isinstance(value, list | tuple) else [value]
        wrong += [text for text in map(str, given) if text.removeprefix("results/").partition(":")[0] not in known]
    return wrong


@pytest.fixture
def plugin(in_tmp: Path) -> Any:
    """The file ``mine.py`` of the examples."""
    text = read_page(ROOT / "docs" / "own-scheme.md").files()["gyrostat.py"]
    (in_tmp / "mine.py").write_text(text)
    yield
    unload_plugin_files()


@pytest.mark.parametrize("name", ["", *CONTEXTS])
def test_every_help_ends_with_two_examples_that_exist(name: str, cli: Callable[..., Said], plugin: None) -> None:
    examples = examples_of(name)
    assert len(set(examples)) == 2
    text = cli(*name.split(), "--help").out
    assert text.endswith("\nExamples:\n" + "".join(f"  {line}\n" for line in examples))
    for line in examples:
        assert len(line) <= 76
        found, context = parsed(line)
        assert name in ("", "list") or found == name
        assert unknown(context) == []
        sets, config = context.params.get("sets"), (context.params.get("configs") or [context.params.get("config")])[0]
        if sets and config != "experiment.yaml":
            load_sweep(context.params["file"], sets) if name == "sweep" else load(config or "kowalevski_hk", sets)


@pytest.mark.parametrize(
    ("line", "wrong"),
    [
        ("topcli run kowalevski_hkk", ["kowalevski_hkk"]),
        ("topcli compare hk nosuch:h=0.1", ["nosuch:h=0.1"]),
        ("topcli cite nosuch hk kowalevski", ["nosuch"]),
        ("topcli plot sweep results/heavy_drift --x nosuch --y drift.energy", ["nosuch"]),
        ("topcli report results/nosuch --out page.html", ["nosuch"]),
    ],
)
def test_an_example_with_a_wrong_name_would_be_found(line: str, wrong: list[str]) -> None:
    assert [text.removeprefix("results/") for text in unknown(parsed(line)[1])] == wrong


def test_an_example_with_a_wrong_option_would_be_found() -> None:
    with pytest.raises(Exception, match="No such option: --nosuch"):
        parsed("topcli run kowalevski_hk --nosuch")


def test_every_command_is_in_one_group_of_the_help(cli: Callable[..., Said]) -> None:
    listed = [name for group in GROUPS.values() for name in group]
    assert sorted(listed) == sorted(GROUP.commands)  # pyright: ignore[reportAttributeAccessIssue]
    text = cli("--help").out
    places = [text.index(f"\n{title}:\n") for title in GROUPS]
    assert places == sorted(places)
    for (_, group), start, end in zip(GROUPS.items(), places, [*places[1:], len(text)], strict=True):
        shown = [line.split()[0] for line in text[start:end].split("\n\n")[0].splitlines() if line[:2] == "  "]
        assert shown == list(group)
    assert examples_of("") == FIRST_EXAMPLES


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


@pytest.mark.parametrize("change", [{"help": "Other."}, {"opts": ["--quiet"]}, {"is_flag": False}])
def test_an_option_with_another_meaning_would_be_found(change: dict[str, Any]) -> None:
    found = [(command, option) for command, option in options() if "--quiet" in option.opts]
    other = copy(found[0][1])
    for name, value in change.items():
        setattr(other, name, value)
    assert len(meanings([*found, ("run", other)])["--quiet"]) == 2


COMMON = {
    "--out": "run sweep bench compare analyse order roundoff stress lyapunov plot report animate table",
    "--results": "report plot animate table verify show list-runs",
    "--format": "table plot compare analyse order roundoff lyapunov",
    "--force": "run plot report animate table init",
    "--quiet": "run sweep bench plot report animate table verify init",
}
"""Commands that have an option, besides what is said of studies."""


@pytest.mark.parametrize("option", COMMON)
def test_a_common_option_is_where_it_can_be_used(option: str) -> None:
    having = {command for command, one in options() if option in one.opts}
    studies = STUDIES if option in ("--force", "--quiet") else ()
    assert having == {*(name.replace("list-", "list ") for name in COMMON[option].split()), *studies}
