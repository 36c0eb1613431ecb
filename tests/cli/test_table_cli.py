"""``topcli table``: every cell shown is the one of ``--json``, in all formats; files, notes and errors."""

from __future__ import annotations

import csv
import io
import itertools
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from shown import cells_of, shows
from sweep_rows import write_rows

SCHEMES, SIZES = ("hk", "rk4", "bohlin-a"), (0.1, 0.031622776601683794, 1e-3)
ROWS = list(itertools.product(SCHEMES, SIZES, range(4)))


@pytest.fixture
def sweep(in_tmp: Path) -> Path:
    """A sweep whose values all differ; one cell has no value, another lacks one."""
    values = [10.0 ** (-5.0 * i / len(ROWS)) * (1.0 + 0.01 * i) for i in range(len(ROWS))]
    drifts = [(-1.0) ** (i // 4) * value * (i + 3) for i, value in enumerate(values)]
    outcome = ["completed"] * len(ROWS)
    outcome[5] = "blew_up"
    outcome[24:28] = ["no_convergence"] * 4
    for i in (5, 24, 25, 26, 27):
        values[i] = math.nan
    keys = {name: [row[i] for row in ROWS] for i, name in enumerate(("scheme", "h", "seed"))}
    return write_rows(in_tmp / "out" / "mine", keys, {"error.max": values, "drift.energy": drifts}, outcome=outcome)


def numbers(cell: dict[str, Any], aggregate: str | None) -> tuple[float, ...]:
    """The numbers that a cell must show."""
    if aggregate == "mean":
        return cell["value"], cell["high"] - cell["value"]
    return (cell["value"], cell["low"], cell["high"]) if aggregate == "median" else (cell["value"],)


def expect(shown: str, cell: dict[str, Any], aggregate: str | None) -> None:
    """The text of a cell shows its numbers, and is marked if rows are missing; without a value it says why."""
    if cell["value"] is None:
        assert shown == next(iter(cell["outcomes"]))
        return
    failed = cell["count"] < cell["rows"] or bool(cell["outcomes"])
    assert shown.endswith("*") == failed
    assert shows(shown.rstrip("*").replace(",", " ").replace("[", "").replace("]", ""), *numbers(cell, aggregate))


@pytest.mark.slow
@pytest.mark.parametrize("aggregate", ["median", "mean", "max", None])
@pytest.mark.parametrize("measure", ["error.max", "drift.energy"])
def test_a_table_shows_what_is_stored(
    cli: Callable[..., Any], sweep: Path, aggregate: str | None, measure: str
) -> None:
    chosen = ("--aggregate", aggregate) if aggregate else ("--where", "seed=1")
    command = ("table", str(sweep), "--rows", "scheme", "--columns", "h", "--value", measure, *chosen)
    found = cli(*command, "--json").json()
    assert found["column_values"] == list(SIZES)
    assert [line["row"] for line in found["table"]] == [[scheme] for scheme in SCHEMES]
    title, header, *rows = cli(*command).out.splitlines()
    assert title.startswith(f"{measure} of mine")
    assert cells_of(header) == ["scheme", "h = 0.1", "h = 0.0316", "h = 0.001"]
    marked = cli(*command, "--format", "markdown").out.replace("\\", "").splitlines()
    for line, row, piped in zip(found["table"], rows, marked[4:], strict=False):
        name, *cells = cells_of(row)
        again = [one.strip() for one in piped.strip("|").split("|")]
        assert name == again[0] == line["row"][0]
        for shown, other, cell in zip(cells, again[1:], line["cells"], strict=True):
            assert shown == other
            expect(shown, cell, aggregate)
    read = list(csv.DictReader(io.StringIO(cli(*command, "--format", "csv").out)))
    for line, fields in zip(found["table"], read, strict=True):
        for h, cell in zip(SIZES, line["cells"], strict=True):
            value = float(fields[f"h={h!r}"])
            assert math.isnan(value) if cell["value"] is None else value == cell["value"]
            if aggregate in ("median", "mean") and cell["value"] is not None:
                assert [float(fields[f"h={h!r}:{end}"]) for end in ("low", "high")] == [cell["low"], cell["high"]]


@pytest.mark.parametrize("aggregate", ["median", "mean", "max"])
def test_latex_shows_what_is_stored(cli: Callable[..., Any], sweep: Path, aggregate: str) -> None:
    command = ("table", str(sweep), "--rows", "scheme", "--rows", "h", "--value", "error.max", "--value")
    command = (*command, "drift.energy", "--aggregate", aggregate)
    found = cli(*command, "--json").json()
    text = cli(*command, "--format", "latex").out
    body = text.partition("\\midrule\n")[2].partition("\\bottomrule")[0].splitlines()
    for line, row in zip(found["table"], body, strict=True):
        cells = row.removesuffix(r" \\").split(" & ")[2:]
        for shown, cell in zip(cells, line["cells"], strict=True):
            plain = shown.strip("$").replace("{}^{*}", "*").replace(r"\;", " ").replace(r"\,", " ").replace("\\_", "_")
            plain = re.sub(r" \\times 10\^\{(-?\d+)\}", r"e\1", plain.replace(r" \pm ", " ± "))
            expect(plain, cell, aggregate)


@pytest.mark.slow
def test_a_table_is_written_whole_and_overwrites_nothing(cli: Callable[..., Any], sweep: Path) -> None:
    command = ("table", str(sweep), "--rows", "scheme", "--columns", "h", "--value", "error.max", "--aggregate", "max")
    for form in ("text", "csv", "markdown", "latex"):
        printed = cli(*command, "--format", form)
        written = cli(*command, "--format", form, "--out", f"tables/a.{form}")
        text = Path(f"tables/a.{form}").read_text()
        assert text.startswith(printed.out)
        assert (written.code, written.out) == (0, "")
        assert f"wrote tables/a.{form}" in written.err
        refused = cli(*command, "--out", f"tables/a.{form}")
        assert (refused.code, refused.out) == (2, "")
        assert "exists already" in refused.err
        assert Path(f"tables/a.{form}").read_text() == text
    assert cli(*command, "--format", "csv", "--out", "tables/a.text", "--force").code == 0
    assert Path("tables/a.text").read_text() == Path("tables/a.csv").read_text()
    assert cli(*command, "--out", "tables").code == 2
    assert sorted(path.name for path in Path("tables").iterdir()) == ["a.csv", "a.latex", "a.markdown", "a.text"]


def test_failures_are_counted_on_stderr(cli: Callable[..., Any], sweep: Path) -> None:
    said = cli("table", str(sweep), "--rows", "scheme", "--columns", "h", "--value", "error.max", "--aggregate", "max")
    assert said.err.splitlines() == [
        "4 rows in each cell",
        "* 5 of 36 values are of runs that did not complete: 1 blew_up, 4 no_convergence",
        "* 5 of 36 values could not be computed (nan) and are left out",
    ]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"--value": "error"}, "--value: unknown measure 'error'; did you mean 'error.max'?"),
        ({"--rows": "schem"}, "--rows: unknown key 'schem'; did you mean 'scheme'?"),
        ({"--columns": "seeds"}, "--columns: unknown key 'seeds'; did you mean 'seed'?"),
        ({"--aggregate": "avg"}, "--aggregate 'avg': unknown aggregate; known: max, mean, median, order"),
        ({"--format": "latx"}, "--format 'latx': unknown format; did you mean 'latex'?"),
        ({"--where": "h=7"}, "--where 'h=7': no row has this value; h is one of: 0.1, 0.0316, 0.001"),
        (
            {"": "out/mien"},
            "out/mien: no sweep is stored here (rows.parquet is missing); did you mean 'mine'?",
        ),
        ({"--columns": "h"}, "up to 4 values fall into one cell, because seed still varies"),
    ],
)
def test_wrong_options_are_named(cli: Callable[..., Any], sweep: Path, changed: dict[str, str], message: str) -> None:
    options = {"--rows": "scheme", "--value": "error.max", **changed}
    place = options.pop("", str(sweep))
    said = cli("table", place, *itertools.chain(*options.items()), "--out", "table.txt")
    assert (said.code, said.out) == (2, "")
    assert said.err.startswith(f"error: {message}")
    assert not Path("table.txt").exists()


EVIL = "a\x1b[31m\n\u202e" + "x" * 300


@pytest.mark.parametrize("option", ["--rows", "--columns", "--value", "--aggregate", "--format", "--where", "--out"])
def test_no_argument_reaches_the_terminal_raw(cli: Callable[..., Any], sweep: Path, option: str) -> None:
    options = {"--rows": "scheme", "--value": "error.max", "--aggregate": "max", option: EVIL}
    said = cli("table", str(sweep), *itertools.chain(*options.items()))
    assert (said.code, said.out) == (2, "")
    assert said.err.startswith("error: ")
    assert all(letter.isprintable() for letter in said.err.replace("\n", ""))
    assert len(said.err) < 1000
