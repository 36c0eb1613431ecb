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
from topcli.runs.report import BRIEF, REPORT_COLUMNS, accuracy_note, modified_line, open_lines
from topcli.table import plus_minus, rounded_up

TOPCLI = [sys.executable, "-m", "topcli"]
CONTROLS = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\r")
MOST_LINES = 12
SIX = ("hk", "hybrid-sym", "bohlin-a", "rk4", "midpoint", "hk:h=0.02")


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


def test_brief_cells_are_the_figures_of_the_report() -> None:
    rows = [
        row("drifting"),
        row("no drift seen", drift=-1e-9, drift_bound=2.01e-9),
        row("exact", first=0.0, max_deviation=4e-16, max_deviation_relative=None, drift=0.0, drift_bound=0.0),
        row("undecided", drift=None, drift_bound=None),
    ]
    cells = BRIEF.cells({"invariants": rows})
    assert [list(line) for line in cells.lines] == [
        ["E", "2", "1.50e-04", "(2.13 ± 0.56)e-05", "drifting"],
        ["E", "2", "1.50e-04", "< 2.1e-09", "no drift seen"],
        ["E", "0", "4.00e-16 abs", "0", "exact"],
        ["E", "2", "1.50e-04", "–", "undecided"],
    ]


def test_a_verdict_that_is_open_names_what_it_lacks_once() -> None:
    short, strange = {"statement": "undecided: run T >= 67"}, {"statement": "unjudged: not finite"}
    rows = [("hk", row("undecided", **short)), ("hk", row("undecided", **short)), ("rk4", row("unjudged", **strange))]
    rows += [("rk4", row("undecided", **short)), ("exact", row("exact", statement="exact"))]
    assert open_lines(rows) == ["hk, rk4: undecided: run T >= 67", "rk4: unjudged: not finite"]


def test_modified_integrals_are_grouped_by_verdict() -> None:
    rows = [row("exact", symbol="a"), row("drifting", symbol="b"), row("exact", symbol="c")]
    assert modified_line(rows) == "modified integrals: exact: a, c; drifting: b"
    assert modified_line([]) == ""
    assert modified_line([{"symbol": "a", "within_round_off": 3, "judged": 4}]) == (
        "modified integrals: 3 of 4 within round-off: a"
    )


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


@pytest.mark.slow
@pytest.mark.parametrize(("environment", "coloured"), [({}, True), ({"NO_COLOR": "1"}, False)], ids=str)
def test_verdicts_are_coloured_on_a_terminal(environment: dict[str, str], coloured: bool, tmp_path: Path) -> None:
    code, shown = in_terminal([*TOPCLI, "run", "kowalevski_bohlin_a"], tmp_path, **environment)
    assert code == 0
    assert ("\x1b[32mexact\x1b[0m" in shown, "\x1b[33mdrifting\x1b[0m" in shown) == (coloured, coloured)


def test_a_pipe_has_no_colours_and_verbose_shows_every_figure(cli: Any) -> None:
    said = cli("run", "kowalevski_bohlin_a", "--set", "N=2000", "-v")
    assert "\x1b" not in said.out
    heads = [line.split("  ")[0] for line in said.out.splitlines()]
    assert heads[: len(REPORT_COLUMNS)] == [column.head for column in REPORT_COLUMNS]
    assert [head.partition(":")[0] for head in heads[len(REPORT_COLUMNS) :]] == ["γ²", "2l", "E", "k²"]


@pytest.mark.slow
def test_six_schemes_are_compared_in_one_block_of_80_columns_each(tmp_path: Path) -> None:
    code, shown = in_terminal([*TOPCLI, "compare", *SIX, "--set", "N=2000"], tmp_path)
    lines = CONTROLS.sub("", shown).splitlines()
    assert code == 0
    assert max(map(len, lines)) <= 80
    for scheme in SIX:
        assert sum(line.split(" ")[0] == scheme for line in lines) == 3


def test_brief_comparison_shows_the_figures_of_json(cli: Any) -> None:
    command = ("compare", "hk", "rk4:h=0.02", "--config", "kowalevski_generic_hk", "--set", "h=0.01", "--set", "N=400")
    lines = [line.split() for line in cli(*command).out.splitlines()]
    for one in cli(*command, "--json").json()["schemes"]:
        errors, deviations, _ = (line for line in lines if line[:1] == [one["label"]])
        found = [one["max_error"], one["final_error"], one["reversal_defect"]]
        assert [float(cell) for cell in errors[1:4]] == pytest.approx(found, rel=0.06)
        relative = [invariant["max_deviation_relative"] for invariant in one["invariants"]]
        assert [float(cell) for cell in deviations[1:]] == pytest.approx(relative, rel=0.06)


@pytest.mark.parametrize("value", [0.0, 5e-324, 1e-320, 2.3e-308, 1.234e-7, 1.0, 12.01, 9.99e99, 1.7e308, math.inf])
def test_numbers_are_rounded_up_to_two_digits(value: float) -> None:
    above = rounded_up(value)
    assert value <= above
    if 1e-300 < value < 1e300:
        assert above <= 1.1 * value
        assert float(f"{above:.1e}") == pytest.approx(above, rel=1e-12)


@pytest.mark.parametrize("size", [None, 3.14e-15])
def test_the_accuracy_of_a_closed_form_may_be_unknown(size: float | None) -> None:
    accuracy = {"round_off": size, "reason": "eps", "sensitivity": None}
    known = "unknown" if size is None else "at most about 3e-15"
    assert accuracy_note({"accuracy": accuracy}).startswith(f"round-off {known} (eps); ")
