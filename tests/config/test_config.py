"""Configs: what they mean, how overrides, keywords and YAML are read, and times instead of steps."""

from __future__ import annotations

import copy
import json
import math
import re
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import topcli
from config_texts import BASE, CONFIGS, ENSEMBLES, FILES, PAPER_GAMMA, refusal, write
from conftest import examples
from topcli.config.files import scene_files
from topcli.config.load import load, load_experiment
from topcli.config.models import steps_of
from topcli.config.sweep import load_sweep
from topcli.config.text import parse_yaml, resolve_scalar, to_yaml
from topcli.contracts import Stepper
from topcli.errors import ConfigError, UnknownNameError, UsageError

SCENE = "kowalevski_hk"


@pytest.mark.slow
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_config_round_trips(path: Path, tmp_path: Path) -> None:
    first = load_experiment(path)
    assert (first.name, len(first.digest)) == (path.stem, 64)
    for source in (json.loads(json.dumps(first.resolved())), write(tmp_path, first.to_yaml(), "other.yaml")):
        other = load_experiment(source)
        assert other == first
        assert other.digest == first.digest


def test_scene_by_bare_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert set(scene_files()) == {path.stem for path in (*FILES, *ENSEMBLES)}
    assert load_experiment("Kowalevski-Bohlin-A").digest == load_experiment(CONFIGS / "kowalevski_bohlin_a.yaml").digest
    assert load_sweep("Heavy-Drift").name == "heavy_drift"
    with pytest.raises(UnknownNameError, match="did you mean 'kowalevski_hk'"):
        load_experiment("kowalevski_hkk")
    write(tmp_path, BASE, "mine.yaml")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UnknownNameError, match=r"did you mean the file mine\.yaml\?"):
        load_experiment("mine")


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
    ("excess", "warnings"), [(0.9e-12, 0), (1.2e-12, 1), (-1.2e-12, 1), (0.99e-2, 1), (-0.99e-2, 1)]
)
def test_a_vector_that_is_nearly_a_unit_vector_is_kept_with_a_warning(
    tmp_path: Path, excess: float, warnings: int
) -> None:
    first = math.sqrt(1.0 + excess)
    experiment = load_experiment(write(tmp_path, BASE.replace("[auto, 0, 1e-3]", f"[{first!r}, 0, 0]")))
    assert experiment.y0[3] == load_experiment(experiment.resolved()).y0[3] == first
    lines = experiment.state_warnings()
    assert len(lines) == warnings
    for line in lines:
        off = float(line.removeprefix("initial gamma is not a unit vector: gamma² is off by ").split(",")[0])
        assert off == pytest.approx(excess, rel=1e-2)


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
    with pytest.raises(ConfigError, match="h: must be a number, text, list or section, not a object"):
        load_experiment(data | {"h": object()})


def test_several_mistakes_are_reported_at_once(tmp_path: Path) -> None:
    text = BASE.replace("h: 0.001", "h: 0").replace("scheme", "shceme").replace("100", "0")
    messages = refusal(write(tmp_path, text)).splitlines()
    assert [line.split(": ")[1] for line in messages] == ["shceme", "scheme", "h"]
    assert messages[2].endswith("(and 1 more)")


def test_unreadable_config_files_are_refused(tmp_path: Path) -> None:
    write(tmp_path, BASE, "wobble.yaml")
    (tmp_path / "folder.yaml").mkdir()
    assert refusal(tmp_path / "woble.yaml") == f"{tmp_path}/woble.yaml: no such file; did you mean 'wobble'?"
    assert "no such file" in refusal(tmp_path / "no" / "x.yaml")
    assert "cannot be read: Is a directory" in refusal(tmp_path / "folder.yaml")
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
    assert load_experiment(path, ("h=1", "N=3", "h=2")).h == 2.0


SCALARS = {"1e-3": 0.001, "-.5": -0.5, "2.": 2.0, "010": 10, "+7": 7, "0x1f": "0x1f", "1e99999": "1e99999", "no": "no"}
SCALARS |= {
    "1_000": "1_000",
    "2025-01-01": "2025-01-01",
    "TRUE": True,
    "~": None,
    "": None,
    "-.inf": -math.inf,
    "٣": "٣",
}


@pytest.mark.parametrize(("text", "value"), [*SCALARS.items(), ("1" * 400, math.inf)])
def test_yaml_scalars(text: str, value: object) -> None:
    assert repr(resolve_scalar(text)) == repr(value)


# a time in the place of the number of steps


@pytest.mark.parametrize("h", ["0.001", "0.007", "1e-4", "0.3", "-0.05"])
@pytest.mark.parametrize("N", [1, 7, 123_457, 10**12])
def test_a_decimal_multiple_of_h_is_a_number_of_steps(N: int, h: str) -> None:
    """T is the decimal number N*h, rounded once; T/h is then off by at most 1.5 ulp."""
    assert steps_of(float(Fraction(h) * N), float(h)) == N


def test_the_tolerance_is_four_ulp() -> None:
    """Relative to T/h: 4 ulp are round-off, 5 ulp are not."""
    assert steps_of(1024.0 * (1.0 + 4 * 2.0**-52), 1.0) == 1024
    with pytest.raises(UsageError, match="not a whole number"):
        steps_of(1024.0 * (1.0 + 5 * 2.0**-52), 1.0)


NEAR = [(50.0, 0.007, [7142, 7143]), (-1.0, -0.3, [3, 4]), (1e-4, 1e-3, [1]), (1.0, 1.1 / 7.0, [6, 7])]


@pytest.mark.parametrize(("T", "h", "counts"), NEAR)
def test_the_nearest_times_are_on_both_sides_and_fit(T: float, h: float, counts: list[int]) -> None:
    with pytest.raises(UsageError) as refused:
        steps_of(T, h)
    pairs = re.findall(r"T = (\S+) \(N = (\d+)\)", str(refused.value))
    assert [int(N) for _, N in pairs] == counts == [steps_of(float(near), h) for near, _ in pairs]


def test_a_time_resolves_to_the_number_of_steps(tmp_path: Path) -> None:
    timed = write(tmp_path, BASE.replace("N: 100", "T: 0.1"), "timed.yaml")
    counted = write(tmp_path, BASE, "counted.yaml")
    assert load_experiment(timed) == load_experiment(counted)
    assert load_experiment(timed, ["h=0.002"]).N == 50
    assert load_experiment(counted, ["T=3"]).N == 3000
    assert load("kowalevski_ensemble", ["h=0.01", "T=2"]).resolved()["N"] == 200
    message = "N: give either the number of steps N or the duration T"
    for overrides in (["T=2", "N=3"], ["T=~", "N=~"]):
        with pytest.raises(ConfigError, match=message):
            load_experiment(SCENE, overrides)


def test_keywords_replace_keys_of_a_mapping_which_stays_as_it_is() -> None:
    """The last word is that of an override, then a keyword, then the mapping, a file or a scene."""
    data: dict[str, Any] = load_experiment(SCENE, ["N=20", "h=0.01"]).resolved()
    before = copy.deepcopy(data)
    assert topcli.simulate(data, h=0.5).t[-1] == topcli.simulate(None, **{**data, "h": 0.5}).t[-1] == 10.0
    for config in (data, SCENE):
        run = topcli.simulate(config, overrides=["h=0.25"], h=0.5, N=4, scheme="rk4")
        assert (run.scheme, len(run) - 1, run.t[-1]) == ("rk4", 4, 1.0)
    assert data == before
    with pytest.raises(ConfigError, match=r"^hh: unknown key"):
        topcli.simulate(data, hh=0.5)


numbers = st.floats(allow_nan=False, allow_infinity=False)
TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=10)  # half a surrogate pair is not in UTF-8
PLAIN_DATA = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**18), 10**18) | numbers | TEXT,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXT, inner, max_size=3),
    max_leaves=10,
)


@pytest.mark.slow
@examples(150)
@given(data=st.dictionaries(TEXT, PLAIN_DATA, min_size=1, max_size=4))
@example(data={"texts": ["no", "true", "1e3", "", 'a "b" \\ #', "ä\x85\u2028\ufeff🌀", "-", "x: y"], "with space": {}})
@example(data={"numbers": [1e-5, 1e22, -0.0, 5e-324, 1.7976931348623157e308, 3, True, None], "deep": {"a": [[], [{}]]}})
def test_emitted_yaml_reads_back(data: dict[str, Any]) -> None:
    again, _ = parse_yaml(to_yaml(data), "text")
    assert repr(again) == repr(data)
