"""Configs: what they mean, how overrides, keywords and YAML are read, and times instead of steps."""

from __future__ import annotations

import ast
import copy
import json
import math
import re
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import topcli
from cases import cases_of
from config_texts import BASE, CONFIGS, ENSEMBLES, FILES, PAPER_GAMMA, refusal, write
from topcli.config.document import Document
from topcli.config.files import scene_files
from topcli.config.load import load, load_experiment
from topcli.config.overrides import apply_overrides, parse_override
from topcli.config.ranges import steps_of
from topcli.config.text import parse_yaml, resolve_scalar
from topcli.contracts import Stepper
from topcli.errors import ConfigError, UnknownNameError, UsageError

SCENE = "kowalevski_hk"


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


@pytest.mark.parametrize(
    ("text", "gamma"),
    [
        ("[+auto, 0, 1e-3]", PAPER_GAMMA),
        ("[0, 1, -auto]", (0.0, 1.0, 0.0)),
        ("[0.28, -auto, 0]", (0.28, -0.96, 0.0)),
        ("[3, 0, 4]\n  normalize: true", (0.6, 0.0, 0.8)),
        ("[3e200, 0, 4e200]\n  normalize: true", (0.6, 0.0, 0.8)),
        ("[0.6, 0.48, 0.64]", (0.6, 0.48, 0.64)),
    ],
)
def test_gamma_is_completed_or_normalised(tmp_path: Path, text: str, gamma: tuple[float, ...]) -> None:
    path = write(tmp_path, BASE.replace("[auto, 0, 1e-3]", text))
    assert load_experiment(path).y0[3:] == pytest.approx(gamma, abs=2e-16)


@pytest.mark.parametrize(
    ("excess", "warns"),
    [(0.9e-12, False), (1.2e-12, True), (-1.2e-12, True), (9e-5, True), (0.99e-2, True), (-0.99e-2, True)],
)
def test_a_vector_that_is_nearly_a_unit_vector_is_kept_with_a_warning(
    tmp_path: Path, excess: float, warns: bool
) -> None:
    first = math.sqrt(1.0 + excess)
    experiment = load_experiment(write(tmp_path, BASE.replace("[auto, 0, 1e-3]", f"[{first!r}, 0, 0]")))
    assert experiment.y0[3] == first
    warnings = experiment.state_warnings()
    assert len(warnings) == warns
    assert load_experiment(experiment.resolved()).y0 == experiment.y0
    for line in warnings:
        assert line.startswith("initial gamma is not a unit vector: gamma² is off by ")
        assert float(line.split("off by ")[1].split(",")[0]) == pytest.approx(
            excess, rel=1e-2 if excess > 1e-9 else 1e-3
        )


@pytest.mark.parametrize("excess", [1.01e-2, -1.01e-2])
def test_a_vector_that_is_far_from_a_unit_vector_is_refused(tmp_path: Path, excess: float) -> None:
    first = math.sqrt(1.0 + excess)
    message = refusal(write(tmp_path, BASE.replace("[auto, 0, 1e-3]", f"[{first!r}, 0, 0]")))
    assert f"is off by {excess:.3g} (allowed: 0.01); write one component as auto" in message


def test_numbers_and_case_of_names_are_read_leniently(tmp_path: Path) -> None:
    experiment = load_experiment(write(tmp_path, BASE.replace("100", "5e4").replace("0.001", "-1").replace("hk", "HK")))
    assert repr((experiment.N, experiment.h, experiment.scheme.name)) == "(50000, -1.0, 'hk')"


def test_python_interface() -> None:
    data: dict[str, Any] = {
        "top": "kowalevski",
        "initial": {"omega": np.array([2.0, 0.0, 0.0]), "gamma": ("auto", 0, np.float64(1e-3))},
        "scheme": {"name": "bohlin-b", "branch": "nearest"},
        "h": np.float64(1e-3),
        "N": np.int64(7),
        "output": {"columns": ("t", "k_sq"), "every": 7},
    }
    experiment = load_experiment(data, ["scheme.branch=sign"])
    assert (experiment.name, experiment.y0) == ("kowalevski_bohlin_b", (2.0, 0.0, 0.0, *PAPER_GAMMA))
    assert experiment.options.model_dump() == {"branch": "sign", "project": 0}
    assert experiment.output.columns == ("t", "k_sq")
    assert isinstance(experiment.method(), Stepper)
    assert load_experiment(experiment.resolved()) == experiment
    loop: dict[str, Any] = {}
    loop["top"] = loop
    for wrong, message in (
        (data | {"h": 0}, "^h: must not be zero"),
        (data | {"h": object()}, "h: must be a number, text, list or section, not a object"),
        (loop, "top: nested deeper than 16 levels"),
    ):
        with pytest.raises(ConfigError, match=message):
            load_experiment(wrong)


def test_aliases_are_expanded_up_to_a_bound(tmp_path: Path) -> None:
    rows = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    rows += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 10)]
    with pytest.raises(ConfigError, match=r"^bomb:1:\d+: more than 5000 values"):
        parse_yaml("\n".join(rows), "bomb")
    path = write(
        tmp_path, BASE.replace("[2, 0, 0]", "&w [2, 0, 0]").replace("[auto, 0, 1e-3]", "*w\n  normalize: true")
    )
    assert load_experiment(path).y0 == (2.0, 0.0, 0.0, 1.0, 0.0, 0.0)


def test_a_parameter_that_no_scheme_can_divide_by_is_refused() -> None:
    tiny = load_experiment("heavy_chaotic", ["scheme=midpoint", "top.A=5e-324"])
    with pytest.raises(UsageError, match=r"the field has a coefficient of about 2\^1073, which no double holds"):
        tiny.method()


def test_several_mistakes_are_reported_at_once(tmp_path: Path) -> None:
    text = BASE.replace("h: 0.001", "h: 0").replace("c0", "c_0").replace("hk", "hkk").replace("100", "0")
    messages = refusal(write(tmp_path, text)).splitlines()
    assert len(messages) == 3
    assert messages[2].endswith("(and 1 more)")
    assert {line.split(": ")[1] for line in messages} == {"h", "N", "top.c_0"}


def test_unreadable_config_files_are_refused(tmp_path: Path) -> None:
    write(tmp_path, BASE, "wobble.yaml")
    (tmp_path / "folder.yaml").mkdir()
    assert refusal(tmp_path / "woble.yaml") == f"{tmp_path}/woble.yaml: no such file; did you mean 'wobble'?"
    assert refusal(tmp_path / "q.yaml").endswith("q.yaml: no such file; known: folder, wobble")
    assert "no such file" in refusal(tmp_path / "no" / "x.yaml")
    assert "cannot be read: Is a directory" in refusal(tmp_path / "folder.yaml")
    assert "ends in .yaml, .yml or .toml" in refusal(tmp_path / "x.txt")
    assert "ends in .yaml, .yml or .toml" in refusal(str(tmp_path / "x"))
    assert "cannot be read: embedded null byte" in refusal("a\0.yaml")
    crlf = write(tmp_path, b"\xef\xbb\xbf" + BASE.replace("\n", "\r\n").encode(), "crlf.yaml")
    assert load_experiment(crlf) == load_experiment(tmp_path / "wobble.yaml")


# overrides


def test_overrides_replace_keys() -> None:
    path = CONFIGS / "kowalevski_hybrid.yaml"
    overrides = ["h=1e-2", "initial.gamma=[-auto,0,1e-3]", "top.c0=-1", "scheme.branch=sign", "output.every=10"]
    overrides += ["name='1e3'", "output.columns=[t, k_sq]", "N=5e3"]
    changed = load_experiment(path, overrides)
    assert changed.resolved() == {
        "name": "1e3",
        "top": {"kind": "kowalevski", "c0": -1.0, "A": 2.0},
        "initial": {"omega": [2.0, 0.0, 0.0], "gamma": [-PAPER_GAMMA[0], 0.0, 1e-3]},
        "scheme": {"name": "hybrid", "branch": "sign", "project": 0},
        "h": 0.01,
        "N": 5000,
        "output": {"format": "parquet", "every": 10, "columns": ["t", "k_sq"]},
    }
    assert load_experiment(path, overrides[::-1]) == changed
    whole = load_experiment(path, ["scheme.branch=sign", "scheme=bohlin-b"])
    assert whole.resolved()["scheme"] == {"name": "bohlin-b", "branch": "sign", "project": 0}
    assert load_experiment(path, ["top=kowalevski", "top.c0=2"]).top.model_dump() == {"c0": 2.0, "A": 2.0}


def test_the_last_of_two_overrides_of_a_key_counts() -> None:
    assert load_experiment(CONFIGS / "kowalevski_hk.yaml", ("h=1", "N=3", "h=2")).h == 2.0


def test_parse_override() -> None:
    assert parse_override("a.b=[auto, -.5, 1e-3, no, '2']") == (("a", "b"), ["auto", -0.5, 1e-3, "no", "2"])
    assert parse_override("a=b=c") == (("a",), "b=c")
    assert parse_override("name='run #1'") == (("name",), "run #1")


SCALARS = """
1e-3
    0.001
1E3
    1000.0
-.5
    -0.5
2.
    2.0
010
    10
0x1f
    31
0o17
    15
+7
    7
no
    'no'
on
    'on'
1_000
    '1_000'
12:30
    '12:30'
2025-01-01
    '2025-01-01'
true
    True
TRUE
    True
~
    None
-.inf
    -1e999
٣
    '٣'
"""


@pytest.mark.parametrize(("text", "value"), cases_of(SCALARS))
def test_yaml_scalars(text: str, value: list[str]) -> None:
    assert repr(resolve_scalar(text)) == repr(ast.literal_eval(value[0]))


def test_odd_yaml_scalars() -> None:
    assert resolve_scalar("") is None
    assert resolve_scalar("1" * 400) == math.inf


def test_override_changes_one_place_of_an_aliased_section() -> None:
    data, lines = parse_yaml("a: &shared {k: [1, 2]}\nb: *shared\n", "x")
    document = Document(data, {path: f"x:{line}" for path, line in lines.items()})
    apply_overrides(document, ["b.k=3"])
    assert document.data == {"a": {"k": [1, 2]}, "b": {"k": 3}}


# a time in the place of the number of steps


@pytest.mark.parametrize("h", ["0.001", "0.1", "0.007", "1e-4", "0.3", "3", "-0.05"])
@pytest.mark.parametrize("N", [1, 3, 7, 5000, 123_457, 10**9 + 7, 10**12])
def test_a_decimal_multiple_of_h_is_a_number_of_steps(N: int, h: str) -> None:
    """T is the decimal number N*h, rounded once; T/h is then off by at most 1.5 ulp."""
    assert steps_of(float(Fraction(h) * N), float(h)) == N


def test_the_tolerance_is_four_ulp() -> None:
    """Relative to T/h: 4 ulp are round-off, 5 ulp are not."""
    assert steps_of(1024.0 * (1.0 + 4 * 2.0**-52), 1.0) == 1024
    with pytest.raises(UsageError, match="not a whole number"):
        steps_of(1024.0 * (1.0 + 5 * 2.0**-52), 1.0)


@pytest.mark.parametrize(
    ("adapted", "T", "h", "counts"),
    [
        ("T", 50.0, 0.007, [7142, 7143]),
        ("T", 2.0, 1 / 3 + 1e-9, [5, 6]),
        ("T", -1.0, -0.3, [3, 4]),
        ("T", 1e-4, 1e-3, [1]),
        ("h", 1.0, 0.3, [3, 4]),
    ],
)
def test_the_nearest_times_or_steps_are_on_both_sides_and_fit(adapted: Any, T: float, h: float, counts: list) -> None:
    with pytest.raises(UsageError) as refused:
        steps_of(T, h, adapted)
    pairs = re.findall(r"[Th] = (\S+) \(N = (\d+)\)", str(refused.value))
    assert [int(N) for _, N in pairs] == counts
    assert [steps_of(*((float(near), h) if adapted == "T" else (T, float(near)))) for near, _ in pairs] == counts


@pytest.mark.parametrize(("T", "h"), [(-1.0, 0.1), (1e9, 1e-4)])
def test_times_that_no_number_of_steps_fits(T: float, h: float) -> None:
    with pytest.raises(UsageError, match="steps; must be from 1 to 1000000000000"):
        steps_of(T, h)


def test_a_config_with_a_time_resolves_to_the_number_of_steps(tmp_path: Path) -> None:
    text = "top: kowalevski\ninitial: {omega: [2, 0, 0], gamma: [auto, 0, 1e-3]}\nscheme: hk\nh: 0.01\nT: 50\n"
    path = tmp_path / "timed.yaml"
    path.write_text(text)
    counted = tmp_path / "counted.yaml"
    counted.write_text(text.replace("T: 50", "N: 5000"))
    timed = load_experiment(path)
    assert timed.resolved() == {**load_experiment(counted).resolved(), "name": "timed"}
    assert "T" not in timed.resolved()
    assert load_experiment(path, ["h=0.02"]).N == 2500
    assert load_experiment(path, ["N=7"]).N == 7
    assert load_experiment(counted, ["T=3"]).N == 300
    assert topcli.simulate(path, h=0.05, output={"every": 1000}).t[-1] == 1000 * 0.05
    path.write_text(text + "N: 5000\n")
    with pytest.raises(ConfigError, match=re.escape(f"{path}:5: T: N is given too ({path}:6); keep one of them")):
        load_experiment(path)


def test_overrides_and_keywords_replace_the_number_of_steps() -> None:
    assert load_experiment(SCENE, ["T=2", "h=0.01"]).N == 200
    assert load("kowalevski_ensemble", ["h=0.01", "T=2"]).resolved()["N"] == 200
    message = "--set T=2: T: N is given too (--set N=3); keep one of them"
    with pytest.raises(ConfigError, match=re.escape(message)):
        load_experiment(SCENE, ["T=2", "N=3"])
    for config in (SCENE, load_experiment(SCENE).resolved()):
        assert len(topcli.simulate(config, h=0.01, T=2)) == 201
        starts = np.array([load_experiment(SCENE).y0] * 2)
        assert topcli.simulate(config, states=starts, h=0.01, T=2).n[-1] == 200


def test_keywords_replace_keys_of_a_mapping_which_stays_as_it_is() -> None:
    """In the Python call: the last word is that of an override, then a keyword, then the mapping, a file or a scene."""
    given: dict[str, Any] = load_experiment(SCENE, ["N=20", "h=0.01"]).resolved()
    before = copy.deepcopy(given)

    def ran(config: Any, overrides: Sequence[str] = (), **changes: Any) -> tuple[str, int, float]:
        found = topcli.simulate(config, overrides=overrides, **changes)
        return found.scheme, len(found) - 1, float(found.t[-1])

    assert ran(given, h=0.5) == ran(None, **{**given, "h": 0.5}) == ("hk", 20, 10.0)
    assert ran(given, scheme="rk4", N=30) == ("rk4", 30, 0.3)
    for config in (given, SCENE):
        assert ran(config, ["h=0.25"], h=0.5, N=4) == ("hk", 4, 1.0)
    assert given == before
    same = topcli.simulate(given, h=0.5)
    assert same.states.tobytes() == topcli.simulate(SCENE, h=0.5, N=20).states.tobytes()
    with pytest.raises(ConfigError, match=r"^hh: unknown key"):
        topcli.simulate(given, hh=0.5)


def test_a_wrong_custom_top_is_refused_each_time() -> None:
    components = ["a1", "a2", "a3"]
    field = {"a1": "-a2*a3", "a2": "2*a3*a1", "a3": "-a1*a2"}
    top = {"kind": "custom", "components": components, "field": field, "angular_velocity": components}
    initial = dict(zip(components, (0.1, 0.2, 0.9), strict=True))
    for _ in range(2):
        with pytest.raises(ConfigError, match=r"top\.vertical: .* is not fixed in space"):
            load({"top": {**top, "vertical": components}, "initial": initial, "scheme": "rk4", "h": 0.1, "N": 2})
