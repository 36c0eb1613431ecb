"""Configs: what they mean, how they round-trip, and how overrides and YAML are read."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from config_texts import BASE, CONFIGS, ENSEMBLES, FILES, PAPER_GAMMA, refusal, write
from topcli.config.document import Document
from topcli.config.files import apply_overrides, parse_override, scene_files
from topcli.config.load import load_experiment
from topcli.config.text import parse_yaml, resolve_scalar, to_yaml
from topcli.contracts import Stepper
from topcli.errors import ConfigError, UnknownNameError


@pytest.mark.slow
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_config_round_trips(path: Path, tmp_path: Path) -> None:
    first = load_experiment(path)
    assert first.name == path.stem
    again = load_experiment(first.resolved())
    from_yaml = load_experiment(write(tmp_path, first.to_yaml(), "other.yaml"))
    from_json = load_experiment(json.loads(json.dumps(first.resolved())))
    for other in (again, from_yaml, from_json):
        assert other == first
        assert other.digest == first.digest
    assert len(first.digest) == 64


def test_the_paper_scene() -> None:
    schemes = {
        path.stem.removeprefix("kowalevski_"): load_experiment(path)
        for path in FILES
        if path.match("kowalevski_*.yaml")
    }
    papers = {"hk", "bohlin_a", "bohlin_b", "bohlin_c", "hybrid"}
    beyond = {"hk_projected", "hk_symproj", "dg4", "midpoint4", "hybrid_sym", "hybrid_xi", "backlund"}
    assert set(schemes) == papers | beyond | {"midpoint", "rk2", "rk4", "dop853", "taylor", "splitting", "dmv", "exact"}
    for stem, experiment in schemes.items():
        assert experiment.scheme.name == stem.replace("_", "-")
        assert experiment.y0 == (2.0, 0.0, 0.0, *PAPER_GAMMA)
        assert experiment.top.model_dump() == {"c0": 1.0, "A": 2.0}
        assert (experiment.h, experiment.N, experiment.duration) == (1e-3, 50000, 50.0)
        assert experiment.output.columns is None
    assert len({experiment.digest for experiment in schemes.values()}) == len(schemes)


def test_scene_by_bare_name() -> None:
    assert set(scene_files()) == {path.stem for path in (*FILES, *ENSEMBLES)}
    assert load_experiment("Kowalevski-Bohlin-A").digest == load_experiment(CONFIGS / "kowalevski_bohlin_a.yaml").digest
    assert load_experiment("kowalevski_generic_hk").N == 10000
    with pytest.raises(UnknownNameError, match="did you mean 'kowalevski_hk'"):
        load_experiment("kowalevski_hkk")


def test_packaged_scene_is_distinguished_from_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path, BASE, "mine.yaml")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UnknownNameError, match=r"did you mean the file mine\.yaml\?"):
        load_experiment("mine")


def test_name_defaults(tmp_path: Path) -> None:
    path = write(tmp_path, BASE.replace("name: x\n", ""), "my scene.yaml")
    assert load_experiment(path).name == "my scene"
    data = load_experiment(path).resolved() | {"scheme": "bohlin-a"}
    del data["name"]
    assert load_experiment(data).name == "kowalevski_bohlin_a"
    message = refusal(write(tmp_path, BASE.replace("name: x\n", ""), "-x.yaml"))
    assert "name: missing, and the file name cannot be used instead" in message
    assert message.count("\n") == 0


def test_auto_completes_with_the_stated_sign(tmp_path: Path) -> None:
    def gamma(text: str) -> tuple[float, ...]:
        return load_experiment(write(tmp_path, BASE.replace("[auto, 0, 1e-3]", text))).y0[3:]

    assert gamma("[auto, 0, 1e-3]") == gamma("[+auto, 0, 1e-3]") == PAPER_GAMMA
    assert gamma("[-auto, 0, 1e-3]") == (-PAPER_GAMMA[0], 0.0, 1e-3)
    assert gamma("[0.28, -auto, 0]") == pytest.approx((0.28, -0.96, 0.0), abs=1e-15)
    assert gamma("[0, 1, -auto]") == (0.0, 1.0, 0.0)
    assert gamma("[3, 0, 4]\n  normalize: true") == pytest.approx((0.6, 0.0, 0.8), abs=1e-16)
    assert gamma("[3e200, 0, 4e200]\n  normalize: true") == pytest.approx((0.6, 0.0, 0.8), abs=1e-16)
    assert gamma("[0.6, 0.48, 0.64]") == (0.6, 0.48, 0.64)


def test_gamma_must_be_a_unit_vector_within_tolerance(tmp_path: Path) -> None:
    within, beyond = math.sqrt(1.0 + 0.9e-12), math.sqrt(1.0 + 1.2e-12)
    path = write(tmp_path, BASE.replace("[auto, 0, 1e-3]", f"[{within!r}, 0, 0]"))
    assert load_experiment(path).y0[3] == within
    message = refusal(write(tmp_path, BASE.replace("[auto, 0, 1e-3]", f"[{beyond!r}, 0, 0]")))
    assert "is off by 1.2e-12" in message


def test_numbers_and_case_of_names_are_read_leniently(tmp_path: Path) -> None:
    path = write(tmp_path, BASE.replace("100", "5e4").replace("0.001", "-1").replace("hk", "HK"))
    experiment = load_experiment(path)
    assert (experiment.N, experiment.h, experiment.scheme.name) == (50000, -1.0, "hk")
    assert type(experiment.N) is int
    assert type(experiment.h) is float


def test_python_interface() -> None:
    data: dict[str, Any] = {
        "top": "kowalevski",
        "initial": {"omega": np.array([2.0, 0.0, 0.0]), "gamma": ("auto", 0, np.float64(1e-3))},
        "scheme": {"name": "bohlin-b", "chart": "single"},
        "h": np.float64(1e-3),
        "N": np.int64(7),
        "output": {"columns": ("t", "k_sq"), "every": 7},
    }
    experiment = load_experiment(data, ["scheme.branch=sign"])
    assert experiment.name == "kowalevski_bohlin_b"
    assert experiment.y0 == (2.0, 0.0, 0.0, *PAPER_GAMMA)
    assert experiment.options.model_dump() == {"branch": "sign", "chart": "single"}
    assert experiment.output.columns == ("t", "k_sq")
    assert isinstance(experiment.method(), Stepper)
    assert load_experiment(experiment.resolved()) == experiment
    with pytest.raises(ConfigError, match=r"^h: must not be zero"):
        load_experiment(data | {"h": 0})
    with pytest.raises(ConfigError, match="h: must be a number, text, list or section, not a object"):
        load_experiment(data | {"h": object()})
    loop: dict[str, Any] = {}
    loop["top"] = loop
    with pytest.raises(ConfigError, match="top: nested deeper than 16 levels"):
        load_experiment(loop)


def test_overrides_replace_keys() -> None:
    path = CONFIGS / "kowalevski_hybrid.yaml"
    overrides = [
        "h=1e-2",
        "initial.gamma=[-auto,0,1e-3]",
        "top.c0=-1",
        "scheme.branch=sign",
        "output.every=10",
        "name=foo",
        "output.columns=[t, k_sq]",
    ]
    changed = load_experiment(path, overrides)
    assert changed.resolved() == {
        "name": "foo",
        "top": {"kind": "kowalevski", "c0": -1.0, "A": 2.0},
        "initial": {"omega": [2.0, 0.0, 0.0], "gamma": [-PAPER_GAMMA[0], 0.0, 1e-3]},
        "scheme": {"name": "hybrid", "branch": "sign"},
        "h": 0.01,
        "N": 50000,
        "output": {"format": "parquet", "every": 10, "columns": ["t", "k_sq"]},
    }
    assert load_experiment(path, overrides[::-1]) == changed
    whole = load_experiment(path, ["scheme.chart=single", "scheme=bohlin-b"])
    assert whole.resolved()["scheme"] == {"name": "bohlin-b", "branch": "nearest", "chart": "single"}
    assert load_experiment(path, ["top=kowalevski", "top.c0=2"]).top.model_dump() == {"c0": 2.0, "A": 2.0}
    assert load_experiment(path, ["name='1e3'"]).name == "1e3"
    assert load_experiment(path, ["N=5e3"]).N == 5000


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("foo", "--set foo: expected key=value, such as h=0.01"),
        ("", "--set : expected key=value"),
        ("=3", "--set =3: '' is not a key"),
        ("top..c0=1", "--set top..c0=1: 'top..c0' is not a key"),
        ("h=", "--set h=: no value is given"),
        ("h=0", "--set h=0: h: must not be zero"),
        ("H=1", "--set H=1: H: unknown key; did you mean 'h'?"),
        ("top.c_0=1", "--set top.c_0=1: top.c_0: unknown key; did you mean 'c0'?"),
        ("scheme.brunch=sign", "--set scheme.brunch=sign: scheme.brunch: unknown key; did you mean 'branch'?"),
        ("scheme=hkk", "--set scheme=hkk: scheme: unknown scheme 'hkk'; did you mean 'hk'?"),
        ("h.x=1", "--set h.x=1: h is 0.001, not a section; set h as a whole"),
        ("initial.gamma=[1,0", "--set initial.gamma=[1,0: YAML: expected ',' or ']'"),
        ("initial.gamma=[1,1,0]", "--set initial.gamma=[1,1,0]: initial.gamma: must be a unit vector"),
        ("h=!!float 3", "--set h=!!float 3: YAML: tags such as"),
        ("name=a/b", "--set name=a/b: name: must not hold a path separator"),
        ("name=1e3", "--set name=1e3: name: must be text (in quotes"),
        ("output.every=50001", "--set output.every=50001: output.every: must be at most N = 50000"),
    ],
)
def test_wrong_override(override: str, says: str) -> None:
    assert refusal(CONFIGS / "kowalevski_hybrid.yaml", (override,)).startswith(says)


def test_repeated_override() -> None:
    message = refusal(CONFIGS / "kowalevski_hk.yaml", ("h=1", "N=3", "h=2"))
    assert message == "--set h=2: h is already set by --set h=1; set it once"


def test_parse_override() -> None:
    assert parse_override("scheme={name: hybrid, branch: sign}")[1] == {"name": "hybrid", "branch": "sign"}
    assert parse_override("a.b=[auto, -.5, 1e-3, no, '2']") == (("a", "b"), ["auto", -0.5, 1e-3, "no", "2"])
    assert parse_override("a=b=c") == (("a",), "b=c")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 0.001),
        ("1E3", 1000.0),
        ("-.5", -0.5),
        ("2.", 2.0),
        ("010", 10),
        ("0x1f", 31),
        ("0o17", 15),
        ("+7", 7),
        ("no", "no"),
        ("on", "on"),
        ("1_000", "1_000"),
        ("12:30", "12:30"),
        ("2025-01-01", "2025-01-01"),
        ("true", True),
        ("TRUE", True),
        ("~", None),
        ("", None),
        ("-.inf", -math.inf),
        ("1" * 400, math.inf),
        ("٣", "٣"),
    ],
)
def test_yaml_scalars(text: str, value: object) -> None:
    found = resolve_scalar(text)
    assert found == value
    assert type(found) is type(value)


def test_yaml_emitter_reads_back() -> None:
    data = {
        "texts": {"a": "no", "b": "true", "c": "1e3", "d": "", "e": 'a "b" \\ #', "f": "ä\x85\u2028\ufeff🌀", "g": "-"},
        "numbers": [1e-5, 1e22, -0.0, 5e-324, 1.7976931348623157e308, 3, True, None],
        "empty": {},
        "deep": {"a": {"b": [[], [1, {}]]}},
        "with space": "x: y",
    }
    found, _ = parse_yaml(to_yaml(data), "text")
    assert repr(found) == repr(data)


def test_override_changes_one_place_of_an_aliased_section() -> None:
    data, lines = parse_yaml("a: &shared {k: [1, 2]}\nb: *shared\n", "x")
    document = Document(data, {path: f"x:{line}" for path, line in lines.items()})
    apply_overrides(document, ["b.k=3"])
    assert document.data == {"a": {"k": [1, 2]}, "b": {"k": 3}}
