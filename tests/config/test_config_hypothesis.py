"""Arbitrary texts as configs and overrides: only TopcliError is ever raised."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from config_texts import CONFIGS
from conftest import examples
from topcli.config.load import load
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


numbers = st.floats(allow_nan=False, allow_infinity=False)
TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=10)  # half a surrogate pair is not in UTF-8
PLAIN_DATA = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**18), 10**18) | numbers | TEXT,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXT, inner, max_size=3),
    max_leaves=10,
)


@pytest.mark.slow
@CONFIG
@given(data=st.dictionaries(TEXT, PLAIN_DATA, min_size=1, max_size=4))
@example(data={"texts": ["no", "true", "1e3", "", 'a "b" \\ #', "ä\x85\u2028\ufeff🌀", "-", "x: y"], "with space": {}})
@example(data={"numbers": [1e-5, 1e22, -0.0, 5e-324, 1.7976931348623157e308, 3, True, None], "deep": {"a": [[], [{}]]}})
def test_emitted_yaml_reads_back(data: dict[str, Any]) -> None:
    again, _ = parse_yaml(to_yaml(data), "text")
    assert repr(again) == repr(data)
