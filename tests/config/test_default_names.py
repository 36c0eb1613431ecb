"""Names of runs: that of the config; with the first digits of the digest if an override changes what is computed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from topcli.config.ensemble import EnsembleExperiment
from topcli.config.load import load, load_named
from topcli.config.models import changed_name, name_fault
from topcli.errors import UsageError

SCENE = "kowalevski_hk"


def test_an_override_that_changes_the_run_changes_its_name() -> None:
    found = load_named(SCENE, ["h=0.01"])
    assert found.name == f"{SCENE}-{load(SCENE, ['h=0.01']).digest[:6]}"
    assert found.digest == load(SCENE, ["h=0.01"]).digest
    assert load_named(SCENE, ["h=0.02"]).name != found.name
    assert load_named(SCENE, ["h=1e-2"]).name == found.name


@pytest.mark.parametrize(
    "overrides", [[], ["output.format=csv"], ["h=0.001"], ["N=50000"], ["T=50"], ["scheme={name: HK}"]]
)
def test_an_override_that_changes_nothing_keeps_the_name(overrides: list[str]) -> None:
    assert load_named(SCENE, overrides).name == SCENE


@pytest.mark.parametrize("override", ["output.every=2", "output.columns=[t, gamma1]", "initial.gamma=[0, 0, 1]", "T=5"])
def test_whatever_enters_the_digest_enters_the_name(override: str) -> None:
    assert load_named(SCENE, [override]).name.startswith(f"{SCENE}-")


def test_a_name_that_is_given_wins(tmp_path: Path) -> None:
    assert load_named(SCENE, ["h=0.01"], "mine").name == "mine"
    assert load_named(SCENE, ["h=0.01", "name=mine"]).name == "mine"
    assert load_named(SCENE, [], "mine").name == "mine"
    file = tmp_path / "file.yaml"
    file.write_text(load(SCENE).to_yaml().replace(SCENE, "inside"))
    assert load_named(file, ["h=0.01"]).name.startswith("inside-")


def test_an_ensemble_is_named_alike() -> None:
    found = load_named("euler_ensemble", ["h=0.01"])
    assert isinstance(found, EnsembleExperiment)
    assert found.name == f"euler_ensemble-{found.digest[:6]}"
    assert found.resolved()["name"] == found.name
    assert load_named("euler_ensemble", ["output.format=csv"]).name == "euler_ensemble"


def test_a_config_that_overrides_complete_has_a_name(tmp_path: Path) -> None:
    file = tmp_path / "part.yaml"
    file.write_text("top: euler\ninitial: {omega: [1, 1, 1]}\nh: 0.1\nN: 10\n")
    found = load_named(file, ["scheme=hk"])
    assert found.name == f"part-{found.digest[:6]}"


@pytest.mark.parametrize("base", ["x", "n" * 100, "é" * 97, "ab " * 33])
def test_a_default_name_is_a_name(base: str) -> None:
    assert not name_fault(base.strip())
    name = changed_name(base.strip(), "0123456789abcdef")
    assert name_fault(name) == ""
    assert name.endswith("-012345")
    assert base.startswith(name.removesuffix("-012345"))


@pytest.mark.parametrize(
    ("overrides", "name", "message"),
    [
        ([], "", "--name must not be empty"),
        ([], "a/b", "--name must not hold a path separator: 'a/b'"),
        (["name=x"], "y", "--name 'y': --set name=x names the run too; keep one of them"),
    ],
)
def test_unusable_names_are_refused(overrides: list[str], name: str, message: str) -> None:
    with pytest.raises(UsageError) as refused:
        load_named(SCENE, overrides, name)
    assert str(refused.value) == message


def test_run_and_show_use_the_name(cli: Any) -> None:
    name = load_named(SCENE, ["h=0.01", "N=20"]).name
    sets = ("--set", "h=0.01", "--set", "N=20")
    said = cli("run", SCENE, *sets)
    assert f"{name}: completed 20 steps (t = 0.2) -> results/{name} (ran)" in said.err
    assert f"-> results/{name} (up to date)" in cli("run", SCENE, *sets).err
    assert f"-> results/{name} (rewritten as csv)" in cli("run", SCENE, *sets, "--format", "csv").err
    assert cli("show", SCENE, *sets, "--json").json()["config"]["name"] == name
    Path("shown.yaml").write_text(cli("show", SCENE, *sets).out)
    assert f"{name}: will be rewritten as parquet" in cli("run", "shown.yaml", "--dry-run").out
    assert sorted(path.name for path in Path("results").iterdir()) == [name]


def test_an_empty_name_is_refused_by_run(cli: Any) -> None:
    said = cli("run", SCENE, "--name", "", "--dry-run")
    assert (said.code, said.out, said.err) == (2, "", "error: --name must not be empty\n")
    said = cli("run", SCENE, "euler_hk", "--name", "", "--dry-run")
    assert said.err == "error: --name '': names one run, and 2 configs are given\n"
