"""Wrong files: configs and sweep files changed in a few places, and damaged bytes, as strategies of hypothesis."""

from __future__ import annotations

import re
from collections.abc import Callable

from hypothesis import strategies as st

from config_texts import CONFIGS
from custom_tops import VOLTERRA


def texts(folder: str) -> dict[str, str]:
    """Packaged configs of a folder by file name."""
    files = sorted(path for path in (CONFIGS / folder).iterdir() if path.suffix in (".yaml", ".toml"))
    return {path.name: path.read_text(encoding="utf-8") for path in files}


STATE = "top: {kind: kowalevski, c0: 1}\ninitial: {omega: [1/3, 0.1, 2], gamma: [2/7, 3/7, 6/7]}\n"
MEMBERS = "ensemble:\n  states:\n    - {omega: [1, 0, 0]}\n    - {omega: [0, 1, 0], gamma: [0, 0, 1]}\n  store: final\n"
COLUMNS = "output:\n  format: csv\n  every: 5\n  columns: [n, t, omega1, energy]\n"
RUNS = texts("") | {
    "columns.yaml": f"{STATE}scheme: hk\nh: 0.1\nN: 100\n{COLUMNS}",
    "composed.yaml": f"{STATE}scheme: hk+suzuki4\nh: -0.01\nN: 50\n",
    "states.yaml": f"{STATE}{MEMBERS}scheme: rk4\nh: 0.01\nN: 50\n",
    "rational.yaml": f"{STATE}scheme: hk\nh: 1/10\nprecision: rational\nmax_digits: 2000\nN: 3\n",
    "custom.yaml": VOLTERRA,
    "digits.yaml": f"{STATE}scheme: rk4\nh: -0.1\nprecision: 40\nN: 3\n",
}
"""Configs of runs: the scenes, and features that they do not have."""
SWEEPS = texts("sweeps") | {
    "small.yaml": """\
base:
  top: kowalevski
  initial: {omega: [0.7, -0.4, 1.3], gamma: [0.6, 0.48, 0.64]}
  N: 60
grid:
  scheme: [hk, rk4]
  h: {from: 0.002, to: 0.02, count: 10}
zip:
  top.c0: [1, 2]
exclude: [{scheme: hk, h: 0.002}]
measure: [max_deviation.energy]
"""
}

TOKEN = re.compile(r"[\w.+-]+|[^\w\s]")
NUMBER = re.compile(r"(?<![\w.])[-+]?\d[\d.]*(?:[eE][-+]?\d+)?(?!\w)")
VALUE = re.compile(r"(?m)(?<=[:=] )[^\n#]+")
LINE = re.compile(r"(?m)^[^#\n][^\n]*\n")
LINES = sorted({line for text in (*RUNS.values(), *SWEEPS.values()) for line in LINE.findall(text)})
NUMBERS = (
    *("0", "-0.0", "-1", "1e308", "-1e308", "1e400", "5e-324", "1e-400", "1e155", "1e20", ".nan", "inf", "-.inf"),
    *("1_000", "0x1F", "0o17", "00012", "1e", "2.0", "1e16", "9007199254740993", "2147483648", "9223372036854775808"),
    *("1000000000000", "1000001", "0.1e-5", "+1", "12:30:45"),
)
VALUES = (
    *("[]", "{}", "null", "~", "true", "no", "'text'", '""', "[[1, 2], [3]]", "{a: 1}", "{kind: heavy}", "1979-05-27"),
    *("[1, 2]", "[1, 2, 3, 4]", "[a, b, c]", "[auto, auto, 0]", "[.nan, 0, 0]", "{sphere: 2}", "{energy: 1e300}", "HK"),
    *("{from: 0, to: 1, count: 3}", "{from: 1, to: 1e308, count: 1000000000000}", "hk+suzuki4", "[0.1, x, .nan]"),
    *("{from: -1, to: .inf, count: 3, spacing: log}", "-auto"),
)


SYNTAX = (": ", "\n  ", "- ", "\t", "\x85", "&a", "*a", "!t", "🌀")
PIECES = st.lists(st.sampled_from(VALUES + NUMBERS + SYNTAX) | st.text(max_size=6), max_size=9).map("".join)
"""Values and pieces of YAML, joined."""


def replaced(pattern: re.Pattern[str], by: st.SearchStrategy[str]) -> Callable[[st.DrawFn, str], str]:
    """Function that replaces something that ``pattern`` finds in a text."""

    def change(draw: st.DrawFn, text: str) -> str:
        places = [place.span() for place in pattern.finditer(text)] or [(len(text), len(text))]
        start, end = draw(st.sampled_from(places))
        return text[:start] + draw(by) + text[end:]

    return change


def inserted(draw: st.DrawFn, text: str) -> str:
    """Text with a line of another config, or one of its own lines again, perhaps with another indentation."""
    lines = text.splitlines(keepends=True)
    line = draw(st.sampled_from(LINES) | st.sampled_from(lines or [""]))
    line = draw(st.sampled_from(("", " ", "   ", "\t", "- "))) + line if draw(st.booleans()) else line
    at = draw(st.integers(0, len(lines)))
    return "".join([*lines[:at], line, *lines[at:]])


MUTATIONS: tuple[Callable[[st.DrawFn, str], str], ...] = (
    replaced(NUMBER, st.sampled_from(NUMBERS)),
    replaced(TOKEN, st.sampled_from(sorted({token for line in LINES for token in TOKEN.findall(line)}))),
    replaced(VALUE, st.sampled_from(VALUES)),
    replaced(LINE, st.sampled_from(LINES)),
    inserted,
    lambda draw, text: text[: draw(st.integers(0, len(text)))],
)


@st.composite
def mutants(draw: st.DrawFn, files: dict[str, str]) -> tuple[str, str]:
    """Name and text of one of the files after up to three mutations."""
    name = draw(st.sampled_from(sorted(files)))
    text = files[name]
    for change in draw(st.lists(st.sampled_from(MUTATIONS), max_size=3)):
        text = change(draw, text)
    return name, text


Damage = tuple[str, float, int]
KINDS = ("flip", "zero", "cut", "append", "other")
PLACES = st.floats(0.0, 1.0, exclude_max=True)
DAMAGES: st.SearchStrategy[Damage] = st.tuples(st.sampled_from(KINDS), PLACES, st.integers(0, 7))
"""Kind of damage, its place as a part of the file, and a small number that varies it."""


def damaged(data: bytes, damage: Damage) -> bytes:
    """Bytes of which one bit is flipped or some are set to 0, without their end, with others behind, or replaced."""
    kind, place, number = damage
    at = int(place * len(data))
    if kind == "flip":
        return data[:at] + bytes(byte ^ 1 << number for byte in data[at : at + 1]) + data[at + 1 :]
    if kind == "zero":
        return data[:at] + bytes(len(data[at : at + 8**number])) + data[at + 8**number :]
    return {"cut": data[:at], "append": data + b"x" * 8**number, "other": (b"a text\n", b"{}", b"[]")[number % 3]}[kind]
