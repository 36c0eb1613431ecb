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
from topcli.config.files import read_document
from topcli.config.load import load
from topcli.config.sweep import load_sweep
from topcli.config.text import parse_yaml, to_yaml
from topcli.errors import TopcliError

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


KEYS = (
    "h N T name top top.c0 initial.omega scheme scheme.branch output.columns output.quantities.q section ensemble.grid"
)


@pytest.mark.slow
@CONFIG
@given(text=st.text(max_size=40) | st.tuples(st.sampled_from(KEYS.split()), st.just("="), PIECED).map("".join))
def test_any_override_loads_or_is_refused(text: str) -> None:
    message = refusal(lambda: load(HYBRID, [text]))
    assert not message.startswith("not a message")
    assert not message or "--set " in message or str(HYBRID) in message


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
    with np.errstate(all="ignore"):
        for invariant in (*loaded.top.invariants(), *loaded.modified):
            assert invariant.value(np.array([loaded.y0])).shape == (1,)


numbers = st.floats(allow_nan=False, allow_infinity=False)
TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=10)  # half a surrogate pair is not in UTF-8
PLAIN_DATA = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**18), 10**18) | numbers | TEXT,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXT, inner, max_size=3),
    max_leaves=10,
)
VALUES = st.integers(-3, 3) | st.floats() | st.sampled_from(["auto", "sphere", "hk", "rk4", None, True, 10**400])
DRAWS = VALUES | st.dictionaries(st.sampled_from(["sphere", "near", "energy", "from", "to"]), VALUES, max_size=2)
AXES = VALUES | st.lists(VALUES, max_size=3) | PLAIN_DATA
AXES |= st.fixed_dictionaries({"from": VALUES, "to": VALUES, "count": VALUES | st.integers(1, 4)})
OPTIONAL = {"gamma": DRAWS, "omega": DRAWS, "seed": VALUES, "top.c0": DRAWS}
RANDOM = VALUES | st.fixed_dictionaries({"count": st.integers(0, 4)}, optional=OPTIONAL)
VECTORS = st.dictionaries(st.sampled_from(["omega", "gamma", "omega1", "m", "normalize"]), st.lists(VALUES, max_size=3))
ENSEMBLES = {
    "random": RANDOM,
    "grid": st.dictionaries(st.sampled_from(["omega1", "gamma3", "gamma1", "top.c0", "top.A", "x"]), AXES, max_size=3),
    "states": VALUES | st.lists(VECTORS | VALUES, max_size=3),
}
VARIED = "h N T scheme top top.c0 initial.omega initial.gamma3 initial.x output.every sample seed scheme.project x"
KEYS_OF_ROWS = st.dictionaries(st.sampled_from(VARIED.split()), AXES, max_size=2)
SWEEPS = {"grid": KEYS_OF_ROWS | VALUES, "zip": KEYS_OF_ROWS | st.lists(KEYS_OF_ROWS, max_size=2), "random": RANDOM}
SWEEPS |= {"exclude": KEYS_OF_ROWS, "name": VALUES}


@pytest.mark.slow
@CONFIG
@given(section=st.sampled_from(list(ENSEMBLES)).flatmap(lambda name: st.fixed_dictionaries({name: ENSEMBLES[name]})))
def test_any_section_of_an_ensemble_is_refused_or_round_trips(section: dict[str, Any]) -> None:
    data = {**PLAIN, "ensemble": section}
    if message := refusal(lambda: load(data)):
        assert not message.startswith("not a message")
        return
    first = load(data)
    again = load(first.resolved())
    assert first.ensemble
    assert again.ensemble
    states, others = first.ensemble.states, again.ensemble.states
    assert np.isfinite(states).all()
    assert np.abs((states[:, 3:] ** 2).sum(axis=1) - 1.0).max() <= 2e-12
    assert (first.digest, states.tobytes()) == (again.digest, others.tobytes())


@pytest.mark.slow
@CONFIG
@given(sections=st.fixed_dictionaries({}, optional=SWEEPS), key=st.sampled_from([*PLAIN]), value=VALUES | PLAIN_DATA)
def test_any_sweep_is_refused_or_round_trips(sections: dict[str, Any], key: str, value: object) -> None:
    for base in (PLAIN, {**PLAIN, key: value}):
        data = {"base": {key: item for key, item in base.items() if key != "name"}, **sections}

        def read(data: Any = data) -> int:
            return sum(len(group.numbers) for group in load_sweep(data).groups())

        message = refusal(read)
        assert not message.startswith("not a message")
        if not message:
            sweep = load_sweep(data)
            assert read() == sweep.count_left == load_sweep(sweep.resolved()).count_left
            assert load_sweep(sweep.resolved()).digest == sweep.digest


@pytest.mark.slow
@CONFIG
@given(data=st.dictionaries(TEXT, PLAIN_DATA, min_size=1, max_size=4))
@example(data={"texts": ["no", "true", "1e3", "", 'a "b" \\ #', "ä\x85\u2028\ufeff🌀", "-", "x: y"], "with space": {}})
@example(data={"numbers": [1e-5, 1e22, -0.0, 5e-324, 1.7976931348623157e308, 3, True, None], "deep": {"a": [[], [{}]]}})
def test_emitted_yaml_reads_back(data: dict[str, Any]) -> None:
    again, _ = parse_yaml(to_yaml(data), "text")
    assert repr(again) == repr(data)
