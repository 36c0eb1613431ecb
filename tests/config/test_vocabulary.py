"""Names that commands take are those that they print: columns, tops, scenes, cases; and a starter config for each."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import pytest

from config_texts import BASE, refusal, write
from conftest import ROOT
from test_config_schema import fits
from topcli.analysis.columns import spellings
from topcli.cli import options
from topcli.config.ensemble import EnsembleExperiment
from topcli.config.files import scene_files
from topcli.config.load import load, load_experiment
from topcli.config.schema import config_schema, starter_config
from topcli.config.text import parse_yaml
from topcli.errors import UnknownNameError, UsageError
from topcli.schemes.registry import names_for
from topcli.studies.bench.peers import PEERS, missing
from topcli.studies.lax import lax_experiment
from topcli.tops import TOPS, top_class

PAIRS = [(form, name) for form in TOPS for name in names_for(form)]


@pytest.mark.parametrize(
    ("given", "name"),
    [("E", "energy"), ("2l", "two_l"), ("k²", "k_sq"), ("γ²", "gamma_sq"), ("k^2", "k_sq"), ("gamma^2", "gamma_sq")],
)
def test_columns_are_named_as_printed(given: str, name: str) -> None:
    data = load_experiment("kowalevski_hk").resolved()
    by_symbol = load_experiment(data | {"output": {"columns": ["t", given]}})
    by_name = load_experiment(data | {"output": {"columns": ["t", name]}})
    assert by_symbol.output.columns == ("t", name)
    assert by_symbol.digest == by_name.digest
    assert fits(config_schema(), data | {"output": {"columns": ["t", given]}})


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
    assert fits(config_schema(), columns)


def test_unknown_columns_list_names_and_symbols(tmp_path: Path) -> None:
    message = refusal(write(tmp_path, BASE.replace("format: csv", "columns: [zzz]")))
    assert "unknown column 'zzz'; known: n, t, omega1" in message
    assert "energy (E), k_sq (k²)" in message
    assert "names 'energy' twice" in refusal(write(tmp_path, BASE.replace("format: csv", "columns: [energy, E]")))


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
    schema = config_schema()
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
    else:
        assert type(lax_experiment(form, None, []).top) is cls


def test_a_form_says_which_vectors_it_needs() -> None:
    data = load_experiment("lagrange_hk").resolved()
    with pytest.raises(UsageError, match=r"initial\.omega: unknown key"):
        load_experiment(data | {"top": "lagrange/inertial"})
    with pytest.raises(UnknownNameError, match=r"known: euler, euler\+gamma, heavy, .*lagrange/inertial"):
        top_class("zzz")


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["yaml", "toml"])
@pytest.mark.parametrize(("form", "name"), PAIRS)
def test_init_for_every_top_and_scheme_loads(tmp_path: Path, form: str, name: str, suffix: str) -> None:
    path = write(tmp_path, starter_config(form, name, toml=suffix == "toml"), f"x.{suffix}")
    experiment = load_experiment(path)
    assert (experiment.top.form, experiment.scheme.name) == (form, name)
    assert experiment.options == type(experiment.options)()
    assert experiment.top == TOPS[form].new()


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


@pytest.mark.slow
@pytest.mark.parametrize("form", TOPS)
@pytest.mark.parametrize("suffix", ["yaml", "yml", "toml"])
def test_init_needs_no_scheme(cli, form: str, suffix: str) -> None:
    assert cli("init", "--top", form, f"x.{suffix}").code == 0
    assert cli("run", f"x.{suffix}", "--set", "N=5").code == 0


def test_scenes_are_listed(cli) -> None:
    scenes = cli("list", "scenes", "--json").json()["scenes"]
    assert [scene["name"] for scene in scenes] == list(scene_files())
    by_name = {scene["name"]: scene for scene in scenes}
    assert by_name["kowalevski_hk"] | {"about": ""} == {
        "name": "kowalevski_hk",
        "top": "kowalevski",
        "scheme": "hk",
        "h": 0.001,
        "N": 50000,
        "trajectories": 1,
        "about": "",
    }
    assert by_name["euler_ensemble"]["trajectories"] == 243
    assert all(scene["about"] for scene in scenes)


def test_folders_that_do_not_exist_are_refused(cli, in_tmp: Path) -> None:
    for arguments, option in (
        (("list", "runs", "--out", "nowhere"), "--out"),
        (("plot", "fig1", "--configs", "nowhere"), "--configs"),
    ):
        said = cli(*arguments)
        assert (said.code, said.out) == (2, "")
        assert said.err == f"error: {option} nowhere: no such folder\n"
    said = cli("list", "runs")
    assert (said.code, said.err) == (0, "no runs in results\n")
    assert list(in_tmp.iterdir()) == []


def test_times_of_runs_are_short_and_local(cli) -> None:
    cli("run", "kowalevski_hk", "--set", "N=5", "--quiet")
    ended = cli("list", "runs", "--json").json()["runs"][0]["ended"]
    local = datetime.fromisoformat(ended).astimezone().strftime("%Y-%m-%d %H:%M")
    assert cli("list", "runs").out.rstrip().endswith(local)


@pytest.mark.parametrize(
    ("section", "says"),
    [
        (
            {"random": {"count": 3, "omega": "sphere"}},
            "write omega: {sphere: 2}, omega: {near: 0.1} or omega: {energy: 1.5}",
        ),
        ({"random": {"count": 3, "omega": 2}}, "write omega: {sphere: 2}, omega: {near: 0.1} or omega: {energy: 1.5}"),
        (
            {"random": {"count": 3, "omega": {"radius": 2}}},
            "write omega: {sphere: 2}, omega: {near: 0.1} or omega: {energy: 1.5}",
        ),
        ({"random": {"count": 3, "omega": {"sphere": "2"}}}, "omega.sphere: must be a number, not the text '2'"),
        ({"random": {"count": 3, "gamma": 1}}, "write gamma: sphere or gamma: {near: 0.1}"),
        ({"random": {"count": 3}}, "for example random: {count: 100, omega: {sphere: 2}, gamma: sphere}"),
        ({"random": 3}, "for example random: {count: 100, omega: {sphere: 2}, gamma: sphere}"),
        ({}, "for example random: {count: 100, omega: {sphere: 2}, gamma: sphere}"),
        (7, "for example random: {count: 100, omega: {sphere: 2}, gamma: sphere}"),
        ({"states": 3}, "for example [{omega: [1, 0, 0]}, {omega: [0, 1, 0]}]"),
        ({"grid": 3}, "for example {omega1: {from: 0, to: 1, count: 11}}"),
        ({"grid": {"omega1": 3}}, "for example [0.1, 0.2] or {from: 0.1, to: 1, count: 10}"),
    ],
)
def test_mistakes_in_an_ensemble_show_an_example_that_works(section: object, says: str) -> None:
    data = load_experiment("kowalevski_hk").resolved()
    with pytest.raises(UsageError) as caught:
        load(data | {"ensemble": section})
    assert says in str(caught.value)
    for example in re.findall(r"(omega: \{\w+: [\d.]+\}|gamma: (?:sphere|\{\w+: [\d.]+\}))", says):
        drawn = parse_yaml(f"{{count: 3, {example}}}", "example")[0]
        assert load(data | {"ensemble": {"random": drawn}}).resolved()["ensemble"]["random"]["count"] == 3


def test_the_schema_types_an_ensemble_of_any_top() -> None:
    """Also where no branch for a top applies, as in a config whose top is not written yet."""
    schema = config_schema()["properties"]["ensemble"]
    for good in (
        {"random": {"count": 3, "omega": {"sphere": 2}, "gamma": "sphere"}},
        {"random": {"count": 3, "m": {"energy": 2}, "a": {"near": 0.1}}},
        {"grid": {"omega1": [1, 2], "top.c0": {"from": 0, "to": 1, "count": 3}}},
        {"states": [{"omega": [1, 2, 3]}], "store": "final"},
        None,
    ):
        assert fits(schema, good), good
    for bad in (
        {"randm": {}},
        {"random": {"omega": {"sphere": 2}}},
        {"random": {"count": 0, "gamma": "sphere"}},
        {"random": {"count": 3, "gamma": "spere"}},
        {"random": {"count": 3, "omega": "sphere"}},
        {"grid": {"omega1": 3}},
        {"states": []},
        {"states": [3]},
        {"states": [{"omega": [1, 2, 3]}], "store": "some"},
        {},
        3,
    ):
        assert not fits(schema, bad), bad


DOCS = (ROOT / "docs" / "ensembles.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("text", re.findall(r"```yaml\n(.*?)```", DOCS, re.DOTALL))
def test_the_configs_of_the_docs_are_ensembles(tmp_path: Path, text: str) -> None:
    found = load(write(tmp_path, text))
    assert isinstance(found, EnsembleExperiment)
    assert fits(config_schema(), parse_yaml(text, "docs")[0])


def test_the_draws_of_the_docs_are_all_that_exist() -> None:
    data = load_experiment("kowalevski_hk").resolved()
    written = re.findall(r"^\|[^|]*\| `(\w+): ([^`]+)` \|", DOCS, re.MULTILINE)
    assert len(written) == 5
    for vector, draw in written:
        drawn = parse_yaml(f"{{count: 2, {vector}: {draw}}}", "docs")[0]
        assert load(data | {"ensemble": {"random": drawn}}).count == 2


def test_every_peer_has_an_extra_that_installs_it() -> None:
    import tomllib

    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    for peer in PEERS.values():
        if peer.name == "scipy":
            continue
        absent = replace(peer, requires=("no_such_package_of_anybody",))
        assert f"pip install 'topcli[{peer.name}]'" in missing(absent)
        installed = {re.split("[<>=]", requirement)[0] for requirement in extras[peer.name]}
        assert set(peer.requires) - {"numba"} <= installed
        assert peer.name in extras["peers"][0]


def test_make_bench_keeps_the_log_of_an_installation(tmp_path: Path) -> None:
    """A peer that cannot be built costs one line that names the log."""
    import shutil
    import subprocess

    make = shutil.which("make")
    if make is None:
        pytest.skip("no make here")
    recipe = (ROOT / "Makefile").read_text(encoding="utf-8").split("$(VENV)/.installed-peers:")[1].split("\n\n")[0]
    body = recipe.split("\n", 1)[1]
    (tmp_path / "Makefile").write_text(f"VENV := venv\nPYTHON := python3\npeers:\n{body}\n")
    (tmp_path / "venv").mkdir()
    (tmp_path / "install.sh").write_text('case "$2" in *diffrax*) seq 200; seq 200 >&2; exit 1;; esac; echo fine\n')
    done = subprocess.run(
        [make, "--no-print-directory", "peers"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        env={name: value for name, value in os.environ.items() if not name.startswith("MAKE")},
    )
    assert done.returncode == 0
    assert done.stdout == ""
    assert done.stderr.splitlines() == [
        "diffrax could not be installed (see venv/install-diffrax.log); topcli bench runs without it"
    ]
    assert len((tmp_path / "venv" / "install-diffrax.log").read_text().splitlines()) == 400


@pytest.mark.parametrize(
    ("complete", "begin", "found"),
    [
        (options.complete_config, "kowalevski_hyb", "kowalevski_hybrid"),
        (options.complete_top, "lagr", "lagrange/inertial"),
        (options.complete_figure, "work", "work-precision"),
        (options.complete_scheme, "hybrid-", "hybrid-xi"),
    ],
)
def test_names_are_completed(complete, begin: str, found: str, in_tmp: Path) -> None:
    assert found in complete(begin)
    assert all(name.startswith(begin) for name in complete(begin))
