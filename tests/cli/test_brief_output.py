"""Output of ``run`` and ``compare`` without ``--verbose``: little, within 80 columns, and with the figures of JSON."""

from __future__ import annotations

import math
import re
import sys
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest

from terminal import in_terminal
from topcli.config.files import scene_files
from topcli.table import plus_minus, rounded_up

TOPCLI = [sys.executable, "-m", "topcli"]
CONTROLS = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\r")
MOST_LINES = 12


def row(verdict: str, **figures: Any) -> dict[str, Any]:
    about = {"symbol": "E", "name": "energy", "first": 2.0, "max_deviation": 3e-4, "max_deviation_relative": 1.5e-4}
    return {**about, "drift": 2.134835e-05, "drift_bound": 2.692297e-05, "verdict": verdict, **figures}


@pytest.mark.slow
def test_every_packaged_scene_prints_at_most_12_lines_of_80_columns(tmp_path: Path) -> None:
    scenes = list(scene_files())
    code, shown = in_terminal([*TOPCLI, "run", *scenes, "--set", "N=24"], tmp_path)
    assert code == 0
    lines = [line for line in CONTROLS.sub("", shown).splitlines() if "━" not in line]  # without the progress bar
    begins = [i for i, line in enumerate(lines) if re.search(r"\b(completed|all \d+ trajectories)\b", line)]
    assert len(begins) == len(scenes)
    ends = [*begins[1:], len(lines) - 1]  # the last line counts the runs
    for begin, end in zip(begins, ends, strict=True):
        warnings = sum("warning: " in line for line in lines[begin:end])
        titles = 1  # the name, which a single run does not print
        assert end - begin - warnings - titles <= MOST_LINES, lines[begin:end]
    assert max(map(len, lines)) <= 80


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (-8.523e-5, 2.2e-5, "(-8.5 ± 2.2)e-05"),
        (9.99e-5, 3.1e-9, "(9.99000 ± 0.00031)e-05"),
        (0.1234, 0.0312, "0.123 ± 0.031"),
        (0.0999, 0.00996, "0.100 ± 0.010"),
        (12345.6, 3.2, "12345.6 ± 3.2"),
        (3e-9, 2e-7, "(0.0 ± 2.0)e-07"),
        (1.0, 0.0, "1"),
        (1.0, float("inf"), "1"),
    ],
)
def test_a_number_ends_at_the_second_digit_of_its_error(value: float, error: float, text: str) -> None:
    assert plus_minus(value, error) == text
    if "±" in text:  # the value shown is within half a unit of its last digit
        power = Decimal(10) ** int(text.partition(")e")[2] or 0)
        shown, _, spread = text.strip("(").partition(")")[0].partition(" ± ")
        unit = Decimal(1).scaleb(int(Decimal(spread).as_tuple().exponent)) * power
        assert abs(Decimal(shown) * power - Decimal(value)) <= unit * Decimal("0.51")


@pytest.mark.parametrize("value", [0.0, 5e-324, 1e-320, 2.3e-308, 1.234e-7, 1.0, 12.01, 9.99e99, 1.7e308, math.inf])
def test_numbers_are_rounded_up_to_two_digits(value: float) -> None:
    above = rounded_up(value)
    assert value <= above
    if 1e-300 < value < 1e300:
        assert above <= 1.1 * value
        assert float(f"{above:.1e}") == pytest.approx(above, rel=1e-12)
