"""The JSON Schema of a config, the configs that init writes, and the names of columns and tops that commands know."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from config_texts import FILES, PLAIN, write
from conftest import ROOT
from declared import SCHEMES
from json_schema import fits
from topcli.config.load import load, load_experiment
from topcli.config.schema import config_schema
from topcli.config.text import parse_yaml
from topcli.engine.columns import spellings
from topcli.errors import TopcliError, UnknownNameError, UsageError
from topcli.schemes.own_tops import top_class
from topcli.tops import CATALOGUE, TOPS

schema_of_configs = cache(config_schema)
PAIRS = [*((scheme.top, scheme.name) for scheme in SCHEMES), *((form, "hk") for form in CATALOGUE)]


@pytest.mark.slow
def test_schema_accepts_the_packaged_scenes() -> None:
    schema = schema_of_configs()
    assert schema["$schema"].endswith("2020-12/schema")
    assert all(section.get("description") for section in schema["properties"].values())
    for path in FILES:
        resolved = load_experiment(path).resolved()
        assert fits(schema, resolved), path
        timed = {key: value for key, value in resolved.items() if key != "N"}
        assert [fits(schema, timed | more) for more in ({}, {"T": 0.5})] == [False, True]


ACCEPTED = """
scheme: hk+suzuki4
scheme: {name: hk, compose: suzuki4, project: 2}
initial: {from: one, normalize: true}
ensemble: {random: {count: 3, gamma: {near: 0.1}, omega: {energy: 4.0}}, store: final}
ensemble: {grid: {omega1: [1.0], top.c0: {from: 0.0, to: 1.0, count: 2}}}
ensemble: {states: [{omega: [1, 2, 3]}], store: final}
"""
REFUSED = """
h: '0.1'
N: 0
N: 2.5
T: 50
top: {kind: kowalevski, c_0: 1}
top: {kind: kowalevski, A: 0}
top: {kind: x}
scheme: x
scheme: {name: x}
scheme: {name: hybrid, branch: x}
output: {format: x}
output: {columns: []}
foo: 1
ensemble: 3
ensemble: {randm: {}}
ensemble: {random: {count: 3, gamma: sphere}, store: some}
"""


@pytest.mark.slow
@pytest.mark.parametrize("text", [*REFUSED.strip().splitlines(), *ACCEPTED.strip().splitlines()])
def test_schema_judges_as_the_loader(text: str) -> None:
    data = PLAIN | parse_yaml(text, "x")[0]
    assert fits(schema_of_configs(), data) == (text in ACCEPTED)
    if text in REFUSED:
        with pytest.raises(TopcliError):
            load(data)


DOCS = (ROOT / "docs" / "ensembles.md").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize(
    "text", [text for text in re.findall(r"```yaml\n(.*?)```", DOCS, re.DOTALL) if "ensemble:" in text]
)
def test_the_configs_of_the_docs_are_ensembles(tmp_path: Path, text: str) -> None:
    found = load(write(tmp_path, text))
    assert found.ensemble
    assert fits(schema_of_configs(), parse_yaml(text, "docs")[0])


# names


def config_of(form: str, scheme: str) -> dict[str, Any]:
    """Config of a form of a top with its default parameters."""
    cls = TOPS[form]
    state = [0.8 if i % 2 else 0.6 for i in range(len(cls.components))]
    initial = cls.initial_section(state) | {name: ["auto", 0, 1e-3] for name in cls.unit_vectors}
    return {"top": form, "initial": initial, "scheme": scheme, "h": 0.001, "N": 50000}


@pytest.mark.parametrize(
    ("symbol", "name"),
    [("E", "energy"), ("2l", "two_l"), ("k²", "k_sq"), ("gamma^2", "gamma_sq"), ("gamma2", "gamma2")],
)
def test_columns_are_named_as_printed(symbol: str, name: str) -> None:
    data = load_experiment("kowalevski_hk").resolved()
    by_symbol, by_name = (load_experiment(data | {"output": {"columns": ["t", text]}}) for text in (symbol, name))
    assert by_symbol.output.columns == ("t", name)
    assert by_symbol.digest == by_name.digest


@pytest.mark.slow
@pytest.mark.parametrize(("form", "name"), PAIRS)
def test_no_two_columns_share_a_spelling(form: str, name: str) -> None:
    experiment = load_experiment(config_of(form, name))
    plain = ["n", "t", *experiment.top.components]
    integrals = (*experiment.top.invariants(), *experiment.modified)
    texts = [text for integral in integrals for text in spellings(integral.name, integral.symbol)]
    assert len({*plain, *texts}) == len([*plain, *texts])
    assert len([text for text in texts if text.isascii()]) >= len(integrals)


@pytest.mark.slow
@pytest.mark.parametrize("form", TOPS)
def test_a_form_is_a_name_of_a_top_wherever_one_is_named(form: str) -> None:
    cls = TOPS[form]
    assert top_class(form, list(cls.vectors)) is cls
    data = config_of(form, "rk4")
    experiment = load_experiment(data)
    assert type(experiment.top) is cls
    assert experiment.resolved()["top"]["kind"] == cls.kind
    assert fits(schema_of_configs(), data)


def test_a_form_says_which_vectors_it_needs() -> None:
    data = load_experiment("lagrange_hk").resolved()
    with pytest.raises(UsageError, match=r"initial\.omega: unknown key"):
        load_experiment(data | {"top": "lagrange/inertial"})
    with pytest.raises(UnknownNameError, match=r"known: .*euler, euler\+gamma, .*heavy, .*lagrange/inertial"):
        top_class("zzz")
