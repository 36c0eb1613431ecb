"""``--plugin`` on every command, and what the commands do with a top and a scheme of a user."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from conftest import ROOT, Said
from documentation import read_page
from topcli.cli.app import all_commands


@pytest.mark.parametrize("name", [name for name in all_commands() if name != "list"])
def test_every_command_loads_a_plugin(cli: Callable[..., Said], name: str) -> None:
    for option in ("--plugin", "--scheme-file"):
        said = cli(*name.split(), option, "nowhere.py")
        assert "plugin nowhere.py: no such file" in said.out + said.err
        assert said.code == 2


@pytest.fixture
def gyrostat(cli: Callable[..., Said]) -> Callable[..., Said]:
    """Call a command with the top and the scheme of the documentation."""
    for name, text in read_page(ROOT / "docs" / "own-scheme.md").files().items():
        Path(name).write_text(text)
    return lambda *arguments: cli(*arguments, "--plugin", "gyrostat.py")


def test_an_own_top_is_listed_with_schemes_that_run(gyrostat: Callable[..., Said]) -> None:
    tops = {top["name"]: top for top in gyrostat("list", "tops", "--json").json()["tops"]}
    assert tops["gyrostat"]["components"] == ["w1", "w2", "w3"]
    assert tops["gyrostat"]["origin"] == "gyrostat.py"
    assert tops["heavy"]["origin"] == "topcli"
    listed = gyrostat("list", "schemes", "--top", "gyrostat", "--json").json()["schemes"]
    names = {scheme["name"]: scheme["origin"] for scheme in listed}
    assert names["heun"] == "gyrostat.py"
    assert names["hk"] == "topcli"
    runnable = [name for name in names if name != "taylor"]
    for name in runnable:
        said = gyrostat("run", "rotor.yaml", "--set", f"scheme={name}", "--set", "T=0.1", "--quiet")
        assert said.code == 0, said.err


def test_cite_prints_the_citation_of_an_own_top(gyrostat: Callable[..., Said]) -> None:
    assert "note = {Volterra 1899}" in gyrostat("cite", "gyrostat").out


def test_the_studies_take_an_own_top(gyrostat: Callable[..., Said]) -> None:
    compared = gyrostat("compare", "heun", "hk", "--config", "rotor.yaml", "--set", "T=2", "--json").json()
    errors = {row["scheme"]: row["max_error"] for row in compared["tables"][0]["rows"]}
    assert 1e-7 < errors["hk"] < errors["heun"] < 1e-3  # 2e-6 and 4e-6
    ordered = gyrostat("order", "heun", "--config", "rotor.yaml", "--set", "T=1", "--json").json()
    assert ordered["tables"][0]["rows"][0]["order"] == pytest.approx(2.0, abs=0.1)
    stressed = gyrostat("stress", "heun", "--json").json()
    outcomes = {row["case"]: row["outcome"] for row in stressed["tables"][0]["rows"]}
    assert outcomes == {"backwards": "held", "one-step": "held", "there-and-back": "degraded", "drift": "not tried"}
