"""Configs under arbitrary input: only TopcliError is ever raised, and every valid experiment round-trips."""

from __future__ import annotations

import copy
import math
import struct
import tempfile
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import numpy as np
import pytest
from hypothesis import example, given, reject
from hypothesis import strategies as st

from config_texts import CONFIGS, PLAIN
from conftest import examples
from topcli.config.ensemble import EnsembleExperiment
from topcli.config.files import parse_override, read_document
from topcli.config.load import load, load_experiment
from topcli.config.models import name_fault
from topcli.config.text import key_lines, parse_yaml, to_yaml
from topcli.contracts import Stepper
from topcli.errors import ConfigError, StepTooLongError, TopcliError
from topcli.schemes.registry import all_schemes

CONFIG = examples(150)


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as name:
        yield Path(name)


# Texts near to configs reach deeper than arbitrary ones do.
KEYS = "name top kind initial omega gamma scheme h N output columns normalize "
YAML_WORDS = r"""
kowalevski hk hybrid auto -auto 1e-3 0 -1 .nan no true ~ 'x' "\u00e9"
: - [ ] { } &a *a !t << ? | > --- ... ' " \ @ `
"""
TOML_WORDS = r"""
"kowalevski" 'hk' "auto" 1e-3 0x1F nan inf true 1979-05-27 07:32:00 "\u00e9"
= . [ ] [[ ]] { } " ' ''' \
"""
YAML_PIECES = [*(KEYS + YAML_WORDS).split(), ": ", "\n", "\n  ", "\n    ", "- ", ", ", " #", "%YAML 1.1\n"]
YAML_PIECES += ["\t", "\x85", "\u2028", "\ufeff", "\ud7ff", "🌀"]
TOML_PIECES = [*(KEYS + TOML_WORDS).split(), '"""', " = ", "\n", ", ", " #", "\t", "\r", "🌀"]


def pieces(words: list[str]) -> st.SearchStrategy[str]:
    return st.lists(st.sampled_from(words), max_size=40).map("".join)


def spliced(text: str) -> st.SearchStrategy[str]:
    """``text`` with a stretch of it replaced by something else."""
    places = st.tuples(st.integers(0, len(text)), st.integers(0, 12), st.text(max_size=6) | pieces(YAML_PIECES[:60]))
    return places.map(lambda cut: text[: cut[0]] + cut[2] + text[cut[0] + cut[1] :])


HYBRID = (CONFIGS / "kowalevski_hybrid.yaml").read_text()
GENERIC = (CONFIGS / "kowalevski_generic_hk.toml").read_text()
ANYTHING = st.binary(max_size=200) | st.text(max_size=200).map(lambda text: text.encode("utf-8", "surrogatepass"))


def refusal(call: Callable[[], object]) -> str:
    """The message with which ``call`` refuses; empty when it does not. Any other exception passes."""
    try:
        call()
    except TopcliError as error:
        message = str(error)
        wrong = error.exit_code != 2 or not 1 <= len(message.splitlines()) <= 3
        return "not a message for a user: " + message if wrong else message
    return ""


def loads_or_refuses(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    message = refusal(lambda: load_experiment(path))
    assert not message or message.startswith(str(path))


@pytest.mark.slow
@CONFIG
@given(content=ANYTHING | pieces(YAML_PIECES).map(str.encode) | spliced(HYBRID).map(str.encode))
@example(content=b"a: &a\n  b: &a *a\n")
@example(content=b"\xff\xfe\x00")
@example(content=b"%YAML 9.9\n---\na: 1\n")
@example(content=b"%TAG ! !\n%TAG ! !\n---\na: 1\n")
@example(content=b'a: "\\UFFFFFFFF"\n')
@example(content=b"? ? ? ?\n")
def test_any_yaml_text_loads_or_is_refused(folder: Path, content: bytes) -> None:
    loads_or_refuses(folder / "any.yaml", content)


@pytest.mark.slow
@CONFIG
@given(content=ANYTHING | pieces(TOML_PIECES).map(str.encode) | spliced(GENERIC).map(str.encode))
def test_any_toml_text_loads_or_is_refused(folder: Path, content: bytes) -> None:
    loads_or_refuses(folder / "any.toml", content)


@pytest.mark.slow
@CONFIG
@given(text=st.text(max_size=40) | pieces(YAML_PIECES).map(lambda text: "h=" + text))
def test_any_override_loads_or_is_refused(text: str) -> None:
    message = refusal(lambda: parse_override(text))
    assert not message or message.startswith("--set ")


PLAIN_DATA = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=12,
)


@pytest.mark.slow
@CONFIG
@given(key=st.sampled_from(["name", "top", "initial", "scheme", "h", "N", "output"]), value=PLAIN_DATA)
def test_any_value_of_a_key_loads_or_is_refused(key: str, value: object) -> None:
    data: dict[str, Any] = load_experiment(CONFIGS / "kowalevski_hybrid.yaml").resolved() | {key: value}
    message = refusal(lambda: load_experiment(data))
    assert key in message or not message
    assert not message.startswith("not a message")


OSCILLATOR = {
    "top": {
        "kind": "custom",
        "components": ["x", "v"],
        "parameters": {"A": 2.0, "k": 0.3},
        "field": {"x": "v/A**3", "v": "-k**3*x"},
        "invariants": {"energy": "v**2/2/A**3 + k**3*x**2/2"},
    },
    "initial": {"x": 1.0, "v": 0.5},
    "scheme": "hk",
    "h": 0.1,
    "N": 10,
    "output": {"every": 2, "quantities": {"size": "A**3*x**2 + exp(k)/h**2"}},
}
FILED = {path.stem: read_document(path).data for path in sorted(CONFIGS.iterdir()) if path.is_file()}
NUMBERED = [OSCILLATOR, *FILED.values()]
EXTREME = [0.0, 5e-324, 1e-308, 1e-200, 1e-155, 1e20, 1e100, 1e155, 1e200, 1e308, math.inf, math.nan, 10**20, 10**400]
EXTREME += [-1, 2**63, *(-x for x in EXTREME if isinstance(x, float)), "1/3", "1/0", "1e999", "9" * 5000]


def places_of_numbers(data: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Keys and indices that lead to each number."""
    if isinstance(data, dict | list):
        items = data.items() if isinstance(data, dict) else enumerate(data)
        for key, value in items:
            yield from places_of_numbers(value, (*place, key))
    elif isinstance(data, int | float) and not isinstance(data, bool):
        yield place


@pytest.mark.slow
@examples(500)
@given(data=st.sampled_from(NUMBERED), choice=st.data())
def test_numbers_of_any_size_give_an_experiment_or_are_refused(data: dict[str, Any], choice: st.DataObject) -> None:
    """Each number of each packaged config; invariants and constants of the experiment exist, finite or not."""
    data = copy.deepcopy(data)
    place = choice.draw(st.sampled_from(list(places_of_numbers(data))))
    section: Any = data
    for key in place[:-1]:
        section = section[key]
    section[place[-1]] = choice.draw(st.sampled_from(EXTREME) | st.floats())
    if (precision := choice.draw(st.sampled_from(["double", "double", "rational", 40]))) != "double":
        data["precision"] = precision
    if message := refusal(lambda: load(data)):
        assert not message.startswith("not a message")
        return
    loaded = load(data)
    first = loaded.first if isinstance(loaded, EnsembleExperiment) else loaded
    states = np.array([first.y0])
    with np.errstate(all="ignore"):
        for invariant in (*first.top.invariants(), *first.modified):
            assert invariant.value(states).shape == invariant.scale(states).shape == (1,)
        for quantity in first.quantities:
            assert quantity.values(first.top, np.array([0]), first.h, states).shape == (1,)
    if isinstance(method := first.method(), Stepper):
        assert all(isinstance(constant, float) for constant in method.parameters(first.top))


# --- round trips ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
@CONFIG
@given(text=pieces(TOML_PIECES) | spliced(GENERIC))
def test_toml_lines_hold_their_keys(text: str) -> None:
    try:
        data = tomllib.loads(text)
    except ValueError:
        return
    lines = key_lines(text)
    rows = text.split("\n")
    for key in data:
        number = next(number for path, number in lines.items() if path[0] == key or "\\" in text)
        assert key in rows[number - 1] or "\\" in text
    assert all(1 <= number <= len(rows) for number in lines.values())


numbers = st.floats(allow_nan=False, allow_infinity=False)
names = st.text(min_size=1, max_size=30).filter(
    lambda name: not any("\ud800" <= letter <= "\udfff" for letter in name) and not name_fault(name)
)


@st.composite
def experiments(draw: st.DrawFn) -> dict[str, Any]:
    """Any valid config of a Kowalevski top."""
    scheme = draw(st.sampled_from([scheme for scheme in all_schemes() if scheme.top == "kowalevski"]))
    options: dict[str, Any] = {"name": scheme.name}
    for key, field in scheme.options.model_fields.items():
        if get_origin(field.annotation) is Literal and draw(st.booleans()):
            options[key] = draw(st.sampled_from(get_args(field.annotation)))
    try:
        scheme.options(**{key: value for key, value in options.items() if key != "name"})
    except ValueError:
        reject()  # they exclude each other
    N = draw(st.integers(1, 10**12))
    columns = ["n", "t", "omega1", "omega2", "omega3", "gamma1", "gamma2", "gamma3", "gamma_sq", "energy", "k_sq"]
    gamma: list[Any] = draw(st.lists(st.floats(-1, 1), min_size=3, max_size=3).filter(any))
    initial = {"omega": draw(st.lists(numbers, min_size=3, max_size=3)), "gamma": gamma, "normalize": True}
    return {
        "name": draw(names),
        "top": {"kind": "kowalevski", "c0": draw(st.floats(-1e300, 1e300)), "A": draw(st.floats(1e-3, 1e3))},
        "initial": initial,
        "scheme": options,
        "h": draw(st.floats(1e-12, 1e12) | st.floats(-1e12, -1e-12)),
        "N": N,
        "output": {
            "format": draw(st.sampled_from(["parquet", "csv"])),
            "every": draw(st.integers(1, N)),
            "columns": draw(st.none() | st.lists(st.sampled_from(columns), min_size=1, unique=True)),
        },
    }


def bits(values: tuple[float, ...]) -> bytes:
    return struct.pack(f"{len(values)}d", *values)


@pytest.mark.slow
@CONFIG
@given(data=experiments())
def test_valid_experiments_round_trip(folder: Path, data: dict[str, Any]) -> None:
    try:
        first = load_experiment(data)
    except StepTooLongError:
        reject()  # a step beyond the domain of its scheme
    path = folder / "round.yaml"
    path.write_text(first.to_yaml(), encoding="utf-8")
    for other in (load_experiment(path), load_experiment(first.resolved())):
        assert other == first
        assert other.digest == first.digest
        assert bits((*other.y0, other.h)) == bits((*first.y0, first.h))
    assert bits(first.y0[:3]) == bits(tuple(float(value) for value in data["initial"]["omega"]))
    assert abs(sum(value * value for value in first.y0[3:]) - 1.0) < 1e-15


@pytest.mark.slow
@CONFIG
@given(others=st.tuples(st.floats(-1, 1), st.floats(-1, 1)), place=st.integers(0, 2), sign=st.sampled_from("+-"))
def test_auto_gives_a_unit_vector(others: tuple[float, float], place: int, sign: str) -> None:
    data: dict[str, Any] = load_experiment(CONFIGS / "kowalevski_hk.yaml").resolved()
    gamma: list[Any] = list(others)
    gamma.insert(place, sign + "auto")
    data["initial"] = data["initial"] | {"gamma": gamma}
    square = others[0] ** 2 + others[1] ** 2
    if square > 1.0 + 1e-12:
        with pytest.raises(ConfigError, match="auto cannot make it a unit vector"):
            load_experiment(data)
        return
    found = load_experiment(data).y0[3:]
    assert abs(sum(value * value for value in found) - 1.0) <= 1e-12
    assert found[place] == 0.0 or (found[place] < 0.0) == (sign == "-")
    assert tuple(value for index, value in enumerate(found) if index != place) == others


VALUES = st.integers(-3, 3) | st.floats() | st.sampled_from(["auto", "sphere", None, True])
DRAWS = VALUES | st.dictionaries(st.sampled_from(["sphere", "near", "energy", "x"]), VALUES, max_size=2)
AXES = VALUES | st.lists(VALUES, max_size=3)
AXES |= st.fixed_dictionaries({"from": VALUES, "to": VALUES, "count": VALUES | st.integers(1, 4)})
VECTORS = st.dictionaries(st.sampled_from(["omega", "gamma", "m", "normalize"]), st.lists(VALUES, max_size=3))
OPTIONAL = {"gamma": DRAWS, "omega": DRAWS, "seed": VALUES}
SECTIONS = {
    "random": st.fixed_dictionaries({"count": st.integers(0, 4)}, optional=OPTIONAL) | VALUES,
    "grid": st.dictionaries(st.sampled_from(["omega1", "gamma3", "gamma1", "top.c0", "top.A", "x"]), AXES, max_size=3),
    "states": VALUES | st.lists(VECTORS | VALUES, max_size=3),
}


@pytest.mark.slow
@CONFIG
@given(section=st.sampled_from(list(SECTIONS)).flatmap(lambda name: st.fixed_dictionaries({name: SECTIONS[name]})))
def test_any_section_of_an_ensemble_is_refused_or_round_trips(section: dict[str, Any]) -> None:
    data = {**PLAIN, "ensemble": section}
    if message := refusal(lambda: load(data)):
        assert not message.startswith("not a message")
        return
    first = load(data)
    again = load(first.resolved())
    assert isinstance(first, EnsembleExperiment)
    assert isinstance(again, EnsembleExperiment)
    states, others = (np.concatenate([group.states for group in one.members.groups]) for one in (first, again))
    assert np.isfinite(states).all()
    assert np.abs((states[:, 3:] ** 2).sum(axis=1) - 1.0).max() <= 2e-12
    assert (first.digest, states.tobytes()) == (again.digest, others.tobytes())


# Half a surrogate pair is not a text that UTF-8 can hold.
TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=10)
SECTION_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**18), 10**18) | numbers | TEXT,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXT, inner, max_size=3),
    max_leaves=10,
)


@pytest.mark.slow
@CONFIG
@given(data=st.dictionaries(TEXT, SECTION_VALUES, min_size=1, max_size=4))
@example(data={"texts": ["no", "true", "1e3", "", 'a "b" \\ #', "ä\x85\u2028\ufeff🌀", "-", "x: y"], "with space": {}})
@example(data={"numbers": [1e-5, 1e22, -0.0, 5e-324, 1.7976931348623157e308, 3, True, None], "deep": {"a": [[], [{}]]}})
def test_emitted_yaml_reads_back(data: dict[str, Any]) -> None:
    found, _ = parse_yaml(to_yaml(data), "text")
    assert repr(found) == repr(data)
