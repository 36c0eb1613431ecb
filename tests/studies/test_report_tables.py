"""Every figure of the invariant report: one entry of one table, shown as stored wherever it is shown."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import pytest

from topcli.analysis.tally import InvariantRow
from topcli.runs.report import INVARIANTS, REPORT_COLUMNS, comparison_lines, report_markdown

SHOWN = {
    "invariant": ("symbol", "A"),
    "first": ("first", "1.012345678"),
    "min": ("min", "1.022345678"),
    "max": ("max", "1.032345678"),
    "max deviation": ("max_deviation", "0.104"),
    "relative": ("max_deviation_relative", "0.105"),
    "rms deviation": ("rms_deviation", "0.106"),
    "relative ": ("rms_deviation_relative", "0.107"),
    "drift per unit time": ("drift", "-0.108"),
    "± standard error": ("drift_error", "0.11"),
    "over the run": ("drift_over_run", "0.111"),
    "model": ("model", "random walk"),
    "scatter": ("scatter", "0.112"),
    "round-off bound": ("round_off_bound", "1.1e-13"),
    "verdict": ("verdict", "drifting"),
}
"""Cells of each line of the report, by label, for ``ROW``."""
ROW: dict[str, Any] = {
    "name": "a",
    "symbol": "A",
    "first": 1.0123456781,
    "min": 1.0223456781,
    "max": 1.0323456781,
    "max_deviation": 0.1041,
    "max_deviation_relative": 0.1051,
    "rms_deviation": 0.1061,
    "rms_deviation_relative": 0.1071,
    "drift": -0.1081,
    "drift_error": 0.1091,
    "drift_over_run": 0.1111,
    "model": "random walk",
    "scatter": 0.1121,
    "round_off_bound": 1.13e-13,
    "verdict": "drifting",
    "reason": "of the test",
}


def report(**changes: Any) -> dict[str, Any]:
    return {
        "name": "some",
        "top_title": "a top",
        "scheme": "hk",
        "scheme_title": "a scheme",
        "h": 0.1,
        "N": 10,
        "outcome": "completed",
        "message": "10 steps",
        "counters": {},
        "seconds": {"compile": 0.0, "run": 0.0},
        "invariants": [ROW, {**ROW, "symbol": "B", "drift": None, "model": None, **changes}],
    }


def lines_of(data: dict[str, Any]) -> list[list[str]]:
    cells = INVARIANTS.cells(data)
    return [list(cells.header), *map(list, cells.lines)]


def test_every_cell_is_the_stored_field() -> None:
    lines = lines_of(report())
    assert [line[0] for line in lines] == [label.strip() for label in SHOWN]
    assert [line[1] for line in lines] == [cell for _, cell in SHOWN.values()]
    assert [line[0] for line in lines if line[1] != line[2]] == ["invariant", "drift per unit time", "model"]
    assert {line[2] for line in lines if line[1] != line[2]} == {"B", "–"}


@pytest.mark.parametrize(("label", "key"), [(label.strip(), key) for label, (key, _) in SHOWN.items()])
def test_a_field_changes_its_own_line_only(label: str, key: str) -> None:
    changed = "C" if isinstance(ROW[key], str) else 7.5
    before, after = lines_of(report()), lines_of(report(**{key: changed}))
    differs = [line[0] for line, other in zip(before, after, strict=True) if line != other]
    assert differs == [label]


def test_every_figure_of_the_report_is_shown() -> None:
    """The name and the reason of the verdict are in the text below the table."""
    assert {column.name for column in REPORT_COLUMNS} == {field.name for field in fields(InvariantRow)} - {
        "name",
        "reason",
    }


def test_markdown_has_the_same_cells_as_the_terminal() -> None:
    header, ruler, *lines = (line for line in report_markdown(report()).splitlines() if line.startswith("|"))
    assert set(ruler) <= set("| -")
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in (header, *lines)]
    assert cells == lines_of(report())


def test_comparisons_show_the_stored_fields_of_each_scheme() -> None:
    one, other = {"invariants": [ROW]}, {"invariants": [{**ROW, "drift_error": 0.31, "verdict": "exact"}]}
    assert comparison_lines([one, other]) == [
        ["A max deviation", "0.104", "0.104"],
        ["A drift per unit time", "-0.108", "-0.108"],
        ["  its standard error", "0.11", "0.31"],
        ["  model", "random walk", "random walk"],
        ["  verdict", "drifting", "exact"],
    ]
