"""First steps of a new user: terminals of 80 columns, answers to mistaken arguments, texts that need no checkout."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from conftest import ROOT
from terminal import in_terminal
from topcli.cli.app import _Topcli
from topcli.cli.options import show_hint
from topcli.config.files import is_config
from topcli.config.schema import starter_config
from topcli.errors import LIST_LENGTH, nearest
from topcli.tops import TOPS

TOPCLI = [sys.executable, "-m", "topcli"]
ESCAPES = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]")
COLOURS = re.compile(r"\x1b\[(?:[0-9;]*;)?(?:3|4|9|10)[0-9](?:;[0-9;]*)?m")


def too_wide(text: str, columns: int = 80) -> list[str]:
    return [line for line in ESCAPES.sub("", text).replace("\r", "\n").split("\n") if len(line) > columns]


def test_lines_that_are_too_wide_are_found() -> None:
    assert too_wide("\x1b[31m" + "x" * 80 + "\n" + "y" * 81) == ["y" * 81]
    assert too_wide("z" * 60 + "\r" + "z" * 60) == []


LISTS = ("tops", "schemes", "compositions", "scenes", "sweeps", "cases", "measures", "figures", "runs")


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments",
    [
        *([*name.split(), "--help"] for name in ("", *_Topcli.places, *(f"list {name}" for name in LISTS))),
        *(["list", name] for name in LISTS),
        ["show", "hk"],
        ["show", "kowalevski_hk"],
        ["show", "kowalevski_hk", "--motion"],
        ["show", "fig1"],
        ["plot", "kowalevski_hk"],
        ["init"],
        ["run", "kowalevski_hk", "--set", "N=200"],
        ["run", "kowalevski_hkk"],
        ["run", "nowhere.yaml"],
        ["compare", "hk", "hybrid", "bohlin-a", "--set", "N=200"],
        ["sweep", "kowalevski_errors", "--dry-run"],
        ["doctor"],
    ],
    ids=" ".join,
)
def test_nothing_is_wider_than_80_columns(arguments: list[str], tmp_path: Path) -> None:
    code, shown = in_terminal([*TOPCLI, *arguments], tmp_path)
    assert code in (0, 2), shown
    assert shown.strip()
    assert "Traceback" not in shown
    assert not too_wide(shown)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("environment", "escapes", "colours"),
    [({}, True, True), ({"NO_COLOR": "1"}, True, False), ({"TERM": "dumb"}, False, False)],
    ids=str,
)
def test_colour_and_bars_where_they_are_welcome(
    environment: dict[str, str], escapes: bool, colours: bool, tmp_path: Path
) -> None:
    """A run of some seconds has a bar; PATIENCE is 0.5 s."""
    code, shown = in_terminal([*TOPCLI, "claims", "--fast"], tmp_path, **environment)
    assert code == 0
    assert bool(ESCAPES.search(shown)) == escapes
    assert bool(COLOURS.search(shown)) == colours


@pytest.mark.slow
def test_the_next_command_stays_on_a_line_of_its_own(tmp_path: Path) -> None:
    """It is copied from the terminal."""
    name = "an-experiment-whose-name-takes-some-space.yaml"
    code, shown = in_terminal([*TOPCLI, "init", name], tmp_path)
    assert code == 0
    assert shown.splitlines()[-1] == f"next: topcli run {name}"


@pytest.mark.slow
def test_messages_follow_the_data_in_one_log(tmp_path: Path) -> None:
    """As in topcli ... 2>&1 | tee log, where Python keeps what goes to stdout."""
    command = [*TOPCLI, "compare", "hk", "--set", "N=200", "--save", "hk.json"]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    done = subprocess.run(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=tmp_path, env=environment
    )
    lines = done.stdout.splitlines()
    assert lines[0].startswith("kowalevski_hk")
    assert lines[-1] == "wrote hk.json"


def store_run(cli) -> None:
    assert cli("run", "kowalevski_hk", "--set", "N=20", "--name", "mine", "-q").code == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("plot", "mine"), "is a run, not a figure; draw it with: topcli report results/mine --out mine.html"),
        (("plot", "results/mine"), "is a run, not a figure; draw it with: topcli report results/mine --out mine.html"),
        (("plot", "fig1", "mine"), "'mine' is a run"),
        (("plot", "kowalevski_hk"), "is a config, not a figure; run it with `topcli run kowalevski_hk`"),
        (("plot", "fig9"), "unknown figure 'fig9'; did you mean 'fig4'"),
        (("show", "mine"), "show its config with: topcli show results/mine"),
        (("show", "FIG1"), "is a figure; draw it with: topcli plot fig1"),
        (("show", "kowalevski"), "is a top; see `topcli list schemes --top kowalevski`"),
        (("show", "hkk"), "did you mean 'hk'?"),
        (("show", "kowalevski_hkk"), "did you mean 'kowalevski_hk'"),
        (("show", "zzz"), "see `topcli list scenes` and `topcli list schemes`"),
        (("show", "kowalevski_hk", "--set", "scheme=hkk"), "unknown scheme 'hkk'; did you mean 'hk'?"),
        (("compare", "hk", "kowalevski_hk"), "with: topcli compare hk hybrid --config kowalevski_hk"),
        (("compare", "results/mine/config.yaml"), "hk hybrid --config results/mine/config.yaml"),
        (("compare", "hk", "hybird"), "unknown scheme 'hybird'; did you mean 'hybrid'"),
        (("run", "results/mine"), "that of this run is results/mine/config.yaml"),
        (("run", "zzz"), "`topcli list scenes` lists them"),
    ],
)
def test_a_mistaken_argument_is_answered_with_the_right_command(cli, arguments: tuple[str, ...], says: str) -> None:
    store_run(cli)
    said = cli(*arguments)
    assert said.code == 2
    assert says in said.err
    assert len(said.err.splitlines()) == 1
    assert said.out == ""


@pytest.mark.slow
def test_a_stored_sweep_is_no_figure(cli, in_tmp: Path) -> None:
    text = "base: {top: kowalevski, scheme: hk, initial: {omega: [1, 0, 0], gamma: [0, 0, 1]}, N: 10}\n"
    (in_tmp / "small.yaml").write_text(text + "grid: {h: [0.1, 0.2]}\nmeasure: [deviation.energy]\n")
    assert cli("sweep", "small.yaml", "-q").code == 0
    assert "with: topcli plot sweep results/small --x KEY --y MEASURE" in cli("plot", "small").err
    assert "show its config with: topcli show results/small" in cli("show", "small").err
    assert "grid:" in cli("show", "results/small").out
    for arguments in (("table", "small", "--rows", "h", "--value", "deviation.energy"), ("plot", "sweep", "small")):
        said = cli(*arguments)
        assert said.code == 2
        assert "no sweep is stored here (rows.parquet is missing); did you mean results/small?" in said.err


@pytest.mark.slow
def test_the_folder_of_a_run_shows_its_config(cli) -> None:
    store_run(cli)
    shown = cli("show", "results/mine")
    assert (shown.code, shown.out) == (0, cli("show", "results/mine/config.yaml").out)
    assert "N: 20\n" in shown.out


def test_hints_are_for_names_that_are_none() -> None:
    assert is_config("kowalevski-hk")
    assert not is_config("hk")
    assert not is_config("nowhere.yaml")
    assert not is_config("")
    assert show_hint("kowalevski_hk") == ""


def test_a_long_list_of_names_is_replaced_by_the_command_that_lists_them() -> None:
    few = ["a" * 10, "b" * (LIST_LENGTH - 12)]
    many = ["a" * 10, "b" * (LIST_LENGTH - 11)]
    assert nearest("zzz", few, "topcli list x") == "known: " + ", ".join(few)
    assert nearest("zzz", many, "topcli list x") == "`topcli list x` lists them"
    assert nearest("zzz", many) == "known: " + ", ".join(many)


@pytest.mark.slow
def test_origins_are_listed_if_something_is_not_built_in(cli, in_tmp: Path) -> None:
    assert "origin" not in cli("list", "schemes").out
    assert "origin" not in cli("list", "measures").out
    (in_tmp / "mine.py").write_text(
        'import topcli\n\n@topcli.measure("omega1.least", summary="least omega1", needs=["omega1"])\n'
        "def least(batch):\n    return batch.column('omega1').min(axis=0)\n"
    )
    listed = cli("list", "measures", "--scheme-file", "mine.py")
    items = cli("list", "measures", "--scheme-file", "mine.py", "--json").json()["measures"]
    header, *rows = listed.out.splitlines()
    assert header.split()[-1] == "origin"
    assert [row.split()[-1] for row in rows] == [item["origin"] for item in items]
    assert {item["origin"] for item in items} == {"topcli", "mine.py"}


@pytest.mark.slow
def test_packaged_sweeps_are_listed(cli) -> None:
    listed = cli("list", "sweeps", "--json").json()["sweeps"]
    assert [one["name"] for one in listed] == sorted(path.stem for path in (ROOT / "configs" / "sweeps").glob("*"))
    (errors,) = (one for one in listed if one["name"] == "kowalevski_errors")
    assert errors["varied"] == ["scheme", "h"]
    assert errors["about"].startswith("Error and drift of all schemes of the Kowalevski top over h")


TARGETS = "|".join(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
CHECKOUT = re.compile(rf"docs/|README|CONTRIBUTING|\bmake (?:{TARGETS})\b|tests/|examples/")


def user_texts(path: Path) -> list[str]:
    """String constants of a module other than docstrings."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    bare = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    return [
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in bare
    ]


GENERATE_PAGES = {"paper/page.py", "studies/scheme_page.py"}
"""Write pages of the documentation, and name them there."""


@pytest.mark.slow
def test_messages_name_no_file_of_the_checkout() -> None:
    """The wheel has none of them."""
    package = ROOT / "src" / "topcli"
    named = {
        f"{path.relative_to(package)}: {text}"
        for path in package.rglob("*.py")
        if path.relative_to(package).as_posix() not in GENERATE_PAGES
        for text in user_texts(path)
        if CHECKOUT.search(text)
    }
    assert not named
    assert any(CHECKOUT.search(text) for text in user_texts(package / "studies" / "scheme_page.py"))


def test_packaged_configs_name_no_file_of_the_checkout() -> None:
    texts = {path.name: path.read_text(encoding="utf-8") for path in (ROOT / "configs").rglob("*.*")}
    assert not [name for name, text in texts.items() if CHECKOUT.search(text)]


@pytest.mark.parametrize("form", TOPS)
def test_starters_name_no_file_of_the_checkout(form: str) -> None:
    text = starter_config(form, None, "topcli.schema.json")
    assert not CHECKOUT.search(text)
    assert "as in the scene kowalevski_ensemble" in text
