"""Messages about a wrong config, ensemble, sweep or override: file, line, key, the mistake and its correction."""

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
from topcli.sweeps.run_sweep import sweep_plan


def load_any_precision(path: Path) -> object:
    return load_experiment(path, any_precision=True)


TEXTS: dict[str, tuple[str, str, Callable[[Path], object]]] = {
    "experiment": (BASE, "bad.yaml", load_experiment),
    "syntax": (BASE, "bad.yaml", load_experiment),
    "toml": (BASE_TOML, "bad.toml", load_experiment),
    "precision": (BASE, "bad.yaml", load_any_precision),
    "ensemble": (ENSEMBLE_TEXT, "bad.yaml", load),
    "section of an ensemble": (f"{BASE}ensemble: ", "bad.yaml", load),
    "sweep": (SWEEP_TEXT, "bad.yaml", lambda path: sweep_plan(load_sweep(path))),
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


ODD: list[tuple[str | bytes, str, str]] = [
    (BASE.replace("[2, 0, 0]", f"[{'9' * 5000}, 0, 0]"), ".yaml", "4: initial.omega[0]: must be a finite number"),
    (BASE + "x: \x07\n", ".yaml", ": YAML: cannot be read: unacceptable character #x0007"),
    (BASE + "\tx: 1\n", ".yaml", "11:1: YAML: ...indent with spaces, not tabs"),
    ("# nothing\n\n", ".yaml", "1: a config is a list of `key: value` lines, not an empty value; `topcli init`"),
    (b"name: x\nh: \xff\xfe", ".yaml", ": cannot be read: 'utf-8' codec can't decode byte 0xff"),
    (BASE_TOML.replace("0.001", f"0x{'f' * 3000}"), ".toml", "2: h: must be a finite number"),
    (BASE_TOML.replace("N = 100", "N = " + "[" * 100_000), ".toml", ": TOML: maximum recursion depth exceeded"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("text", "suffix", "says"), ODD, ids=range(len(ODD)))
def test_odd_content_is_refused(tmp_path: Path, text: str | bytes, suffix: str, says: str) -> None:
    path = write(tmp_path, text, f"odd{suffix}")
    assert_says(refusal(lambda: load_experiment(path)), str(path), says)
