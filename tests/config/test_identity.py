"""Each key of a resolved config, changed in turn, gives another digest, and a run another name."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from cases import table_of
from topcli.config.load import load, load_experiment
from topcli.config.load import load_experiment as single_from
from topcli.config.models import changed_name, name_fault
from topcli.schemes.registry import all_schemes

PLACES = tuple[str | int, ...]


def leaves(data: Any, path: PLACES = ()) -> Iterator[tuple[PLACES, Any]]:
    """Path and value of every leaf of plain data; a vector of numbers is one."""
    if isinstance(data, dict):
        for key, value in data.items():
            yield from leaves(value, (*path, key))
    elif isinstance(data, list) and any(isinstance(value, list | dict) for value in data):
        for i, value in enumerate(data):
            yield from leaves(value, (*path, i))
    else:
        yield path, data


def changed(path: PLACES, value: Any, schema: dict[str, Any]) -> Any:
    """Another valid value for a key, close to this one."""
    match value:
        case _ if "enum" in schema:
            return next(one for one in schema["enum"] if one != value)
        case bool():
            return not value
        case int() | str() if "enum" in schema:
            return next(one for one in schema["enum"] if one != value)
        case int():
            return value + 2 if path[-1] == "order" else value + 1  # orders are even
        case float():
            return value * (1.0 + 2.0**-40) if value else 2.0**-40
        case None if path[0] == "scheme":  # an option that the scheme chooses by itself
            return next(one["minimum"] for one in schema["anyOf"] if one["type"] == "integer")
        case list():
            rest = math.hypot(value[0], value[1])
            return [rest, 0.0, *value[2:]] if value[0] != rest else [0.6 * rest, 0.8 * rest, *value[2:]]
    others = {("name",): "other", ("output", "format"): "csv", ("output", "columns"): ["t"], ("scheme", "project"): 3}
    return others[path]


def replaced(data: dict[str, Any], path: PLACES, value: Any) -> dict[str, Any]:
    """A copy of the data with another value at a path."""
    made = copy.deepcopy(data)
    inner: Any = made
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    return made


NAMES = {("top", "kind"), ("scheme", "name")}
"""Tried by the tests over all tops and schemes: another name needs other keys beside it."""


def one_of_each() -> list[Any]:
    """A config for each scheme and each form of a top."""
    forms = {"kowalevski": "kowalevski_hk", "euler": "euler_hk", "heavy": "heavy_hk", "lagrange": "lagrange_hk"}
    return [
        pytest.param(forms[scheme.top], scheme.name, id=f"{scheme.name}/{scheme.top}")
        for scheme in all_schemes()
        if scheme.top in forms
    ]


@pytest.mark.parametrize(("scene", "scheme"), one_of_each())
def test_every_key_of_a_run_enters_its_digest(scene: str, scheme: str) -> None:
    experiment = load_experiment(scene, [f"scheme={scheme}", "output.every=3"])
    resolved = experiment.resolved()
    options = experiment.scheme.options.model_json_schema().get("properties", {})
    digests: dict[PLACES, str] = {(): experiment.digest}
    outside = {}
    for path, value in leaves(resolved):
        if path in NAMES:
            continue
        schema = options.get(path[-1], {}) if path[0] == "scheme" else {}
        if path == ("top", "B") and scene == "lagrange_hk":
            continue  # must equal A, and is changed with it
        other = replaced(resolved, path, changed(path, value, schema))
        if path == ("top", "A") and scene == "lagrange_hk":
            other["top"]["B"] = other["top"]["A"]
        where = outside if path in (("name",), ("output", "format")) else digests
        where[path] = single_from(other).digest
    assert list(outside.values()) == [experiment.digest] * 2
    assert len(set(digests.values())) == len(digests)
    assert {path[1] for path in digests if path[:1] == ("scheme",)} == set(options)
    assert {path[1] for path in digests if path[:1] == ("output",)} == {"every", "columns"}
    assert {path[0] for path in digests if path} >= {"top", "initial", "h", "N", "output"}


def test_every_scheme_and_top_has_a_digest_of_its_own() -> None:
    digests = [load(*(one.values[0], [f"scheme={one.values[1]}", "name=x"])).digest for one in one_of_each()]
    assert len(set(digests)) == len(digests)


@pytest.mark.parametrize(
    "override",
    [
        "ensemble.random.seed=8",
        "ensemble.random.count=5",
        "ensemble.random.omega.near=0.25",
        "ensemble.store=final",
        "output.every=2",
        "output.columns=[t]",
        "N=50",
        "h=0.02",
    ],
)
def test_every_key_of_an_ensemble_enters_its_digest(override: str) -> None:
    base = ["ensemble={random: {count: 4, seed: 3, gamma: sphere, omega: {near: 0.3}}, store: trajectories}"]
    first = load("kowalevski_hk", base)
    assert load("kowalevski_hk", [*base, override]).digest != first.digest
    assert load("kowalevski_hk", base).digest == first.digest


def test_name_and_format_of_an_ensemble_do_not_enter_its_digest() -> None:
    first = load("kowalevski_ensemble")
    assert load("kowalevski_ensemble", ["name=other", "output.format=csv"]).digest == first.digest


# names of runs: that of the config, with the first digits of the digest if an override changes what is computed

SCENE = "kowalevski_hk"


@pytest.mark.parametrize(
    "overrides",
    table_of("""
[]
['output.format=csv']
['h=0.001']
['N=50000']
['T=50']
['scheme={name: HK}']
"""),
)
def test_an_override_that_changes_nothing_keeps_the_name(overrides: list[str]) -> None:
    assert load(SCENE, overrides, rename=True).name == SCENE


@pytest.mark.parametrize(
    ("scene", "override"),
    [
        (SCENE, "h=0.01"),
        (SCENE, "output.every=2"),
        (SCENE, "output.columns=[t, gamma1]"),
        (SCENE, "initial.gamma=[0, 0, 1]"),
        (SCENE, "T=5"),
        ("euler_ensemble", "h=0.01"),
    ],
)
def test_an_override_that_changes_the_run_changes_its_name(scene: str, override: str) -> None:
    found = load(scene, [override], rename=True)
    assert found.name == found.resolved()["name"] == f"{scene}-{load(scene, [override]).digest[:6]}"
    assert found.digest == load(scene, [override]).digest


def test_a_name_that_is_given_wins(tmp_path: Path) -> None:
    assert load(SCENE, ["h=0.01"], {"name": "mine"}, rename=True).name == "mine"
    assert load(SCENE, ["h=0.01", "name=mine"], rename=True).name == "mine"
    assert load(SCENE, [], {"name": "mine"}, rename=True).name == "mine"
    file = tmp_path / "file.yaml"
    file.write_text(load(SCENE).to_yaml().replace(SCENE, "inside"))
    assert load(file, ["h=0.01"], rename=True).name.startswith("inside-")


def test_a_config_that_overrides_complete_has_a_name(tmp_path: Path) -> None:
    file = tmp_path / "part.yaml"
    file.write_text("top: euler\ninitial: {omega: [1, 1, 1]}\nh: 0.1\nN: 10\n")
    found = load(file, ["scheme=hk"], rename=True)
    assert found.name == f"part-{found.digest[:6]}"


@pytest.mark.parametrize(
    "name",
    ["con", "NUL", "Com1", "lpt9.txt", "aux .x", "figures", "x.", "x ", " x", "..", "-x", "a\tb", "a:b", "a/b", ""],
)
def test_names_that_some_system_reserves_or_changes_are_refused(name: str) -> None:
    assert name_fault(name)


@pytest.mark.parametrize("name", ["run #1", "console", "com10", "a.b", "é (2)", "x+y"])
def test_other_names_are_accepted(name: str) -> None:
    assert not name_fault(name)


@pytest.mark.parametrize("base", ["x", "n" * 100, "é" * 97, "ab " * 33])
def test_a_default_name_is_a_name(base: str) -> None:
    assert not name_fault(base.strip())
    name = changed_name(base.strip(), "0123456789abcdef")
    assert name_fault(name) == ""
    assert name.endswith("-012345")
    assert base.startswith(name.removesuffix("-012345"))
