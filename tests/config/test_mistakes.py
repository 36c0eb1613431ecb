"""Messages about a wrong config, ensemble, sweep or override: file, line, key, the mistake and its correction.

Most of the mistakes are in ``mistakes.txt``; here are those with characters that a page
does not show, or with very many of them.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from cases import cases_of, parts_of
from config_texts import BASE, BASE_TOML, CONFIGS, ENSEMBLE_TEXT, SWEEP_TEXT, write
from topcli.config.load import load, load_experiment
from topcli.config.sweep import load_sweep
from topcli.errors import TopcliError
from topcli.sweeps.plan import survey


def load_any_precision(path: Path) -> object:
    return load_experiment(path, any_precision=True)


TEXTS: dict[str, tuple[str, str, Callable[[Path], object]]] = {
    "experiment": (BASE, "bad.yaml", load_experiment),
    "syntax": (BASE, "bad.yaml", load_experiment),
    "toml": (BASE_TOML, "bad.toml", load_experiment),
    "precision": (BASE, "bad.yaml", load_any_precision),
    "ensemble": (ENSEMBLE_TEXT, "bad.yaml", load),
    "section of an ensemble": (f"{BASE}ensemble: ", "bad.yaml", load),
    "sweep": (SWEEP_TEXT, "bad.yaml", lambda path: survey(load_sweep(path))),
}
PARTS = parts_of(Path(__file__).with_name("mistakes.txt"))


def changed(text: str, change: str) -> str:
    """The text with a change, which it makes possible: a part of it replaced, or lines added at its end."""
    old, arrow, new = change.replace("\\n", "\n").partition(" ->")
    if not arrow:
        return f"{text}{old}\n"
    assert old in text
    return text.replace(old, new.removeprefix(" "), 1)


def refusal(call: Callable[[], object]) -> str:
    """Message of a refusal, of at most three lines."""
    with pytest.raises(TopcliError) as caught:
        call()
    assert caught.value.exit_code == 2
    assert 1 <= len(str(caught.value).splitlines()) <= 3
    return str(caught.value)


def assert_says(message: str, place: str, expected: str) -> None:
    """A line of the message begins with the place, and has the parts of the text between the dots in their order."""
    begin = re.escape(place) + (":" if expected[:1].isdigit() else ".*")
    assert re.search(f"^{begin}{'.*'.join(map(re.escape, expected.split('...')))}", message, re.MULTILINE), message


CASES = [pytest.param(part, *case.values, id=f"{part}: {case.id}") for part in TEXTS for case in cases_of(PARTS[part])]


@pytest.mark.slow
@pytest.mark.parametrize(("part", "change", "says"), CASES)
def test_a_mistake_is_named_with_file_line_and_key(tmp_path: Path, part: str, change: str, says: list[str]) -> None:
    text, name, loads = TEXTS[part]
    path = write(tmp_path, changed(text, change), name)
    message = refusal(lambda: loads(path))
    for expected in says:
        assert_says(message, str(path), expected)


@pytest.mark.parametrize(("override", "says"), cases_of(PARTS["override"]))
def test_a_wrong_override_is_named(override: str, says: list[str]) -> None:
    message = refusal(lambda: load_experiment(CONFIGS / "kowalevski_hybrid.yaml", [override]))
    assert message.startswith(f"--set {override}: {says[0]}")


ODD: list[tuple[str | bytes, str]] = [
    (BASE.replace("name: x", "name: 'x\u00a0'"), "1: name: 'x\\xa0' cannot name a folder"),
    (BASE.replace("name: x", f"name: {'é' * 100}x"), "1: name: 'ééé...at most 100 characters"),
    (BASE.replace("[2, 0, 0]", f"[{'9' * 350}, 0, 0]"), "4: initial.omega: omega1 must be a finite number"),
    (BASE + "\tx: 1\n", r"11:1: YAML: found character '\t' that cannot start any token; indent with spaces"),
    (BASE + "x: \x07\n", "11: YAML: the character U+0007 is not allowed"),
    (BASE.replace("hk", '"\\ud800"'), "6:9: scheme: the text holds half of a surrogate pair"),
    ("# nothing\n\n", ": is empty; `topcli init` writes a config"),
    ("- a\n", "1: a config is a list of `key: value` lines, not a list"),
    ("a: " + "[" * 1000 + "]" * 1000, ": cannot be read as YAML (RecursionError"),
    ("a: [" + "1," * 6000 + "]", "1:9999: more than 5000 values"),
    (b"name: x\nh: \xff\xfe", ": cannot be read: 'utf-8' codec can't decode byte 0xff"),
]
ODD_TOML = [
    (BASE_TOML.replace("0.001", f"0x{'f' * 3000}"), "2: h: an integer of more than 1024 bits"),
    (BASE_TOML.replace("0.001", "1" * 5000), ": TOML: Exceeds the limit (4300 digits)"),
    (BASE_TOML.replace("N = 100", "N = " + "[" * 100_000), ": TOML: maximum recursion depth exceeded"),
    ("", ": is empty"),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "says", "suffix"),
    [*((*case, "yaml") for case in ODD), *((*case, "toml") for case in ODD_TOML)],
    ids=range(len(ODD) + len(ODD_TOML)),
)
def test_odd_content_is_refused(tmp_path: Path, text: str | bytes, says: str, suffix: str) -> None:
    path = write(tmp_path, text, f"odd.{suffix}")
    assert_says(refusal(lambda: load_experiment(path)), str(path), says)
