"""The JSON Schema of a config, the starter configs, and the names of columns and tops that commands know."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest

from cases import cases_of, table_of
from config_texts import FILES, PLAIN, write
from conftest import ROOT
from declared import SCHEMES
from json_schema import fits
from topcli.analysis.columns import spellings
from topcli.config.ensemble import EnsembleExperiment
from topcli.config.load import load, load_experiment
from topcli.config.schema import config_schema, starter_config
from topcli.config.text import parse_yaml
from topcli.errors import TopcliError, UnknownNameError, UsageError
from topcli.schemes.compose import COMPOSITIONS
from topcli.schemes.own_tops import top_class
from topcli.studies.lax_checks import lax_experiment
from topcli.tops import CATALOGUE, TOPS, BodyTop

schema_of_configs = cache(config_schema)
PAIRS = [*((scheme.top, scheme.name) for scheme in SCHEMES), *((form, "hk") for form in CATALOGUE)]


@pytest.mark.slow
def test_schema_accepts_the_packaged_scenes() -> None:
    schema = schema_of_configs()
    assert schema["$schema"].endswith("2020-12/schema")
    for path in FILES:
        resolved = load_experiment(path).resolved()
        assert fits(schema, resolved), path
        timed = {key: value for key, value in resolved.items() if key != "N"}
        assert [fits(schema, timed | more) for more in ({}, {"T": 0.5}, {"T": 0})] == [False, True, False]


ACCEPTED = """
scheme: hk+{composition}
scheme: {{name: hk+{composition}}}
scheme: {{name: hk, compose: {composition}}}
"""
REFUSED = """
h: 0
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
scheme: {name: hybrid, chart: single}
scheme: hk+x
scheme: {name: hk, compose: x}
scheme: hybrid+suzuki4
scheme: {name: hybrid, compose: suzuki4}
scheme: {name: hk+suzuki4, compose: suzuki4}
initial: {omga: [1, 2, 3], gamma: [0, 0, 1]}
initial: {omega: [1, 2, 3]}
initial: {omega: [auto, 1, 2], gamma: [0, 0, 1]}
initial: {omega: [0, 1, 2], gamma: [0, 1]}
output: {format: x}
output: {columns: [gama1]}
output: {columns: []}
output: {columns: [t, t]}
name: a/b
name: ''
foo: 1
ensemble: {}
ensemble: 3
ensemble: {store: final}
ensemble: {randm: {}}
ensemble: {random: {count: 3}}
ensemble: {random: {omega: {sphere: 2}}}
ensemble: {random: {count: 0, gamma: sphere}}
ensemble: {random: {count: 3, gamma: spere}}
ensemble: {random: {count: 3, gamma: {energy: 1}}}
ensemble: {random: {count: 3, omega: sphere}}
ensemble: {random: {count: 3, gamma: sphere}, store: some}
ensemble: {grid: {omega1: 3}}
ensemble: {grid: {omega4: [1]}}
ensemble: {grid: {omega1: {from: 0, to: 1}}}
ensemble: {states: []}
ensemble: {states: [3]}
ensemble: {states: [{omga: [1, 2, 3]}]}
ensemble: {states: [{omega: [1, 2, 3]}], store: some}
"""
ENSEMBLES = """
ensemble: {random: {count: 3, gamma: sphere}}
ensemble: {random: {count: 3, gamma: {near: 0.1}, omega: {energy: 4.0}}, store: final}
ensemble: {grid: {omega1: [1.0], top.c0: {from: 0.0, to: 1.0, count: 2}}}
ensemble: {states: [{omega: [1, 2, 3]}], store: final}
"""


@pytest.mark.slow
@pytest.mark.parametrize(("text", "_"), cases_of(REFUSED))
def test_schema_refuses_what_the_loader_refuses(text: str, _: list[str]) -> None:
    data = PLAIN | parse_yaml(text, "x")[0]
    assert not fits(schema_of_configs(), data)
    with pytest.raises(TopcliError):
        load(data)


@pytest.mark.slow
def test_schema_accepts_what_the_loader_accepts() -> None:
    texts = [ACCEPTED.format(composition=name) for name in COMPOSITIONS]
    for text in "".join([ENSEMBLES, *texts]).split("\n"):
        if text:
            data = PLAIN | parse_yaml(text, "x")[0]
            assert fits(schema_of_configs(), data), text
            load(data)
    bare = {key: value for key, value in PLAIN.items() if key != "initial"}
    drawn = {"count": 1, "gamma": "sphere", "omega": {"sphere": 1}}
    assert not fits(schema_of_configs(), bare)
    assert fits(schema_of_configs(), {**bare, "ensemble": {"random": drawn}})


def test_the_schema_types_an_ensemble_of_any_top() -> None:
    """Also where no branch for a top applies, as in a config whose top is not written yet."""
    whole = schema_of_configs()
    schema = whole["properties"]["ensemble"] | {"$defs": whole["$defs"]}
    good, bad = (
        [parse_yaml(line, "x")[0]["ensemble"] for line in text.split("\n") if line.startswith("ensemble")]
        for text in (ENSEMBLES, REFUSED)
    )
    assert all(fits(schema, section) for section in (*good, None))
    of_a_top = ("omega4", "omga", "energy")
    assert [section for section in bad if fits(schema, section) and not any(x in str(section) for x in of_a_top)] == []


def test_schema_describes_every_key() -> None:
    schema = schema_of_configs()
    assert all(section.get("description") for section in schema["properties"].values())
    then = schema["allOf"][0]["then"]["properties"]
    parameters = then["top"]["anyOf"][1]["properties"]
    assert all(parameters[key]["description"] for key in ("c0", "A"))


# starter configs


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["yaml", "toml"])
@pytest.mark.parametrize(("form", "name"), PAIRS)
def test_init_for_every_top_and_scheme_loads(tmp_path: Path, form: str, name: str, suffix: str) -> None:
    text = starter_config(form, name, toml=suffix == "toml", schema="schemas/top.json")
    experiment = load_experiment(write(tmp_path, text, f"x.{suffix}"))
    assert (experiment.top.form, experiment.scheme.name) == (form, name)
    assert experiment.options == type(experiment.options)()
    assert experiment.top == TOPS[form].new()
    if suffix == "yaml":
        assert text.startswith("# yaml-language-server: $schema=schemas/top.json\n")
        assert fits(schema_of_configs(), parse_yaml(text, "starter")[0])
        if form == "kowalevski":
            assert experiment == load_experiment("kowalevski_hk", [f"scheme={name}", f"name={experiment.name}"])
        for key, value in experiment.resolved()["scheme"].items():
            assert f"  # {key}: " in text if value is None else f"  {key}: " in text


@pytest.mark.parametrize("suffix", ["yaml", "toml"])
@pytest.mark.parametrize("form", TOPS)
def test_the_commented_ensemble_of_init_loads(tmp_path: Path, form: str, suffix: str) -> None:
    text = starter_config(form, toml=suffix == "toml")
    first = next(line for line in text.splitlines() if line.startswith("# many trajectories"))
    head, block = text.split(first + "\n")
    block, tail = block.split("\n\n", 1)
    uncommented = re.sub("^# ", "", block, flags=re.MULTILINE)
    found = load(write(tmp_path, f"{head}{uncommented}\n\n{tail}", f"x.{suffix}"))
    assert isinstance(found, EnsembleExperiment)
    assert found.count == 100
    assert set(found.resolved()["ensemble"]["random"]) == {"count", "seed", *TOPS[form].vectors}


def test_starter_config_takes_compositions(tmp_path: Path) -> None:
    assert load_experiment(write(tmp_path, starter_config(scheme="hk+suzuki4"))).scheme.name == "hk+suzuki4"


DOCS = (ROOT / "docs" / "ensembles.md").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize(
    "text", [text for text in re.findall(r"```yaml\n(.*?)```", DOCS, re.DOTALL) if "ensemble:" in text]
)
def test_the_configs_of_the_docs_are_ensembles(tmp_path: Path, text: str) -> None:
    found = load(write(tmp_path, text))
    assert isinstance(found, EnsembleExperiment)
    assert fits(schema_of_configs(), parse_yaml(text, "docs")[0])


def test_the_draws_of_the_docs_are_all_that_exist() -> None:
    data = load_experiment("kowalevski_hk").resolved()
    written = re.findall(r"^\|[^|]*\| `(\w+): ([^`]+)` \|", DOCS, re.MULTILINE)
    assert len(written) == 5
    for vector, draw in written:
        drawn = parse_yaml(f"{{count: 2, {vector}: {draw}}}", "docs")[0]
        assert load(data | {"ensemble": {"random": drawn}}).count == 2


# names


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "name"),
    table_of("""
E        energy
2l       two_l
k²       k_sq
γ²       gamma_sq
k^2      k_sq
gamma^2  gamma_sq
"""),
)
def test_columns_are_named_as_printed(given: str, name: str) -> None:
    data = load_experiment("kowalevski_hk").resolved()
    by_symbol = load_experiment(data | {"output": {"columns": ["t", given]}})
    by_name = load_experiment(data | {"output": {"columns": ["t", name]}})
    assert by_symbol.output.columns == ("t", name)
    assert by_symbol.digest == by_name.digest
    assert fits(schema_of_configs(), data | {"output": {"columns": ["t", given]}})


def test_a_component_is_not_taken_for_a_square() -> None:
    data = load_experiment("kowalevski_hk").resolved()
    assert load_experiment(data | {"output": {"columns": ["gamma2"]}}).output.columns == ("gamma2",)


@pytest.mark.slow
@pytest.mark.parametrize(("form", "name"), PAIRS)
def test_no_two_columns_share_a_spelling(form: str, name: str) -> None:
    experiment = load_experiment(parse_yaml(starter_config(form, name), "starter")[0])
    plain = ["n", "t", *experiment.top.components]
    texts = [
        text for one in (*experiment.top.invariants(), *experiment.modified) for text in spellings(one.name, one.symbol)
    ]
    assert len({*plain, *texts}) == len([*plain, *texts])
    ascii_only = [text for text in texts if text.isascii()]
    assert len(ascii_only) >= len(experiment.top.invariants()) + len(experiment.modified)
    columns = experiment.resolved() | {"output": {"columns": ["t", *(one.symbol for one in experiment.modified)]}}
    assert load_experiment(columns).output.columns == ("t", *(one.name for one in experiment.modified))
    assert fits(schema_of_configs(), columns)


@pytest.mark.slow
@pytest.mark.parametrize("form", TOPS)
def test_a_form_is_a_name_of_a_top_wherever_one_is_named(cli, form: str) -> None:
    """``list tops`` prints forms; configs, the schema, ``lax``, ``list``, ``init`` and ``stress`` know them."""
    cls = TOPS[form]
    assert top_class(form, list(cls.vectors)) is cls
    assert form in cli("list", "tops").out
    data = parse_yaml(starter_config(form), "starter")[0]
    data["top"]["kind"] = form
    experiment = load_experiment(data)
    assert type(experiment.top) is cls
    assert experiment.resolved()["top"]["kind"] == cls.kind
    schema = schema_of_configs()
    assert fits(schema, data)
    assert not fits(schema, data | {"scheme": "zzz"})
    for command in ("schemes", "cases", "scenes"):
        found = cli("list", command, "--top", form, "--json").json()[command]
        assert found
        tops = {one.form for one in TOPS.values() if one.kind == form} | {form}
        assert {item["top"] for item in found} <= tops
    if form == "lagrange/inertial":
        with pytest.raises(UsageError, match=r"written for omega and gamma.*take the top lagrange"):
            lax_experiment(form, None, [])
    elif cls.components in (BodyTop.components, BodyTop.components[:3]):
        assert type(lax_experiment(form, None, []).top) is cls
    else:
        with pytest.raises(UsageError, match=f"written for omega and gamma.* of the top {form}"):
            lax_experiment(form, None, [])


def test_a_form_says_which_vectors_it_needs() -> None:
    data = load_experiment("lagrange_hk").resolved()
    with pytest.raises(UsageError, match=r"initial\.omega: unknown key"):
        load_experiment(data | {"top": "lagrange/inertial"})
    with pytest.raises(UnknownNameError, match=r"known: .*euler, euler\+gamma, .*heavy, .*lagrange/inertial"):
        top_class("zzz")
