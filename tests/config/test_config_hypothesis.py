"""Configs under arbitrary input: only TopcliError is ever raised, and every valid experiment round-trips."""

from __future__ import annotations

import copy
import math
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from config_texts import CONFIGS, PLAIN
from conftest import examples
from topcli.config.ensemble import EnsembleExperiment
from topcli.config.files import read_document
from topcli.config.load import load, load_experiment
from topcli.config.overrides import parse_override
from topcli.config.text import parse_toml, parse_yaml, to_yaml
from topcli.contracts import Stepper
from topcli.errors import ConfigError, TopcliError, UsageError

CONFIG = examples(150)
HYBRID = CONFIGS / "kowalevski_hybrid.yaml"


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as name:
        yield Path(name)


# Texts near to configs reach deeper than arbitrary ones do.
WORDS = r"""
name top kind initial omega gamma scheme h N output columns normalize kowalevski hk hybrid auto -auto 1e-3 0 -1 .nan no
true ~ 'x' "\u00e9" 0x1F inf 1979-05-27 : = - [ ] [[ ]] { } &a *a !t << ? | > --- ... ' " ''' \ @ `
"""
PIECES = [*WORDS.split(), ": ", " = ", "\n", "\n  ", "\n    ", "- ", ", ", " #", "%YAML 1.1\n", '"""']
PIECES += ["\t", "\r", "\x85", "\u2028", "\ufeff", "\ud7ff", "🌀"]
SCENES = {path.suffix: path.read_text() for path in (HYBRID, CONFIGS / "kowalevski_generic_hk.toml")}
ANYTHING = st.binary(max_size=200) | st.text(max_size=200).map(lambda text: text.encode("utf-8", "surrogatepass"))
PIECED = st.lists(st.sampled_from(PIECES), max_size=40).map("".join)


def spliced(text: str) -> st.SearchStrategy[str]:
    """``text`` with a stretch of it replaced by something else."""
    places = st.tuples(st.integers(0, len(text)), st.integers(0, 12), st.text(max_size=6) | PIECED)
    return places.map(lambda cut: text[: cut[0]] + cut[2] + text[cut[0] + cut[1] :])


def refusal(call: Callable[[], object]) -> str:
    """The message with which ``call`` refuses; empty when it does not. Any other exception passes."""
    try:
        call()
    except TopcliError as error:
        message = str(error)
        wrong = error.exit_code != 2 or not 1 <= len(message.splitlines()) <= 3
        return "not a message for a user: " + message if wrong else message
    return ""


@pytest.mark.slow
@CONFIG
@given(suffix=st.sampled_from([*SCENES]), choice=st.data())
def test_any_text_loads_or_is_refused(folder: Path, suffix: str, choice: st.DataObject) -> None:
    path = folder / f"any{suffix}"
    path.write_bytes(choice.draw(ANYTHING | (PIECED | spliced(SCENES[suffix])).map(str.encode)))
    message = refusal(lambda: load(path))
    assert not message or message.startswith(str(path))


@pytest.mark.slow
@CONFIG
@given(text=st.text(max_size=40) | PIECED.map(lambda text: "h=" + text))
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
    data: dict[str, Any] = load_experiment(HYBRID).resolved() | {key: value}
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
def test_numbers_of_any_size_round_trip_or_are_refused(data: dict[str, Any], choice: st.DataObject) -> None:
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
    for again in (load(parse_yaml(loaded.to_yaml(), "again")[0]), load(loaded.resolved())):
        assert again.digest == loaded.digest
    first = loaded.first if isinstance(loaded, EnsembleExperiment) else loaded
    states = np.array([first.y0])
    with np.errstate(all="ignore"):
        for invariant in (*first.top.invariants(), *first.modified):
            assert invariant.value(states).shape == invariant.scale(states).shape == (1,)
        for quantity in first.quantities:
            assert quantity.values(first.top, np.array([0]), first.h, states).shape == (1,)
    try:
        method = first.method()
    except UsageError:  # a constant of the scheme may be beyond the doubles
        return
    if isinstance(method, Stepper):
        assert all(isinstance(constant, float) for constant in method.parameters(first.top))


@pytest.mark.slow
@CONFIG
@given(text=PIECED | spliced(SCENES[".toml"]))
def test_toml_lines_hold_their_keys(text: str) -> None:
    try:
        data, lines = parse_toml(text, "any")
    except ConfigError:
        return
    rows = text.split("\n")
    for path, number in lines.items():
        assert path[0] in data
        assert str(path[-1]) in rows[number - 1]


numbers = st.floats(allow_nan=False, allow_infinity=False)

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
