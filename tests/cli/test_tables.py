"""Tables fit the terminal, with every cell and no word broken; ``topcli table`` shows the cells of ``--json``."""

from __future__ import annotations

import csv
import io
import itertools
import math
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from shown import cells_of, shows
from sweep_rows import write_rows
from topcli.cli.output import table_lines


def test_a_wide_table_is_split_into_blocks_that_repeat_the_label() -> None:
    rows = [["first row", "1.5e-10", "22", "333"], ["second row", "1", "2", "3"]]
    assert table_lines(["", "column a", "b", "c"], rows, (1, 2, 3), 23) == [
        "            column a",
        "first row    1.5e-10",
        "second row         1",
        "",
        "             b    c",
        "first row   22  333",
        "second row   2    3",
    ]


def test_columns_that_name_a_row_are_repeated_together() -> None:
    rows = [["m²", "plain", "1.5e-10", "22.5"], ["m²", "kept", "2.5e-10", "33.5"]]
    assert table_lines(["", "sums", "drift", "cost"], rows, (2, 3), 20, keys=2) == [
        "    sums     drift",
        "m²  plain  1.5e-10",
        "m²  kept   2.5e-10",
        "",
        "    sums   cost",
        "m²  plain  22.5",
        "m²  kept   33.5",
    ]


def test_a_last_column_of_text_is_neither_cut_nor_moved() -> None:
    rows = [["hk", "0.5", "held, with an error of 1e-5"], ["rk4", "12.5", "broke"]]
    assert table_lines(["", "h", "outcome"], rows, (1,), 24, rule=True) == [
        "        h  outcome",
        "────────────────────────",
        "hk    0.5  held, with an error of 1e-5",
        "rk4  12.5  broke",
    ]
    assert table_lines([], [["  a", "b c"], ["d", "e"]], (), 24, colours={"e": "32"}) == [
        "  a  b c",
        "d    \x1b[32me\x1b[0m",
    ]


def test_text_is_left_aligned_and_numbers_right_aligned(cli) -> None:
    header, *rows = cli("list", "compositions").out.splitlines()
    for name, right in (("order", True), ("stages", True), ("title", False), ("citation", False)):
        start, end = header.index(name), header.index(name) + len(name)
        for row in rows:
            edge, beyond = (row[end - 1], row[end : end + 1]) if right else (row[start], row[start - 1])
            assert edge != " ", name
            assert beyond in (" ", ""), name


cells = st.text("abc xyz0123456789.-", max_size=30).map(lambda text: " ".join(text.split()))


@pytest.mark.slow
@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.integers(1, 8).flatmap(lambda n: st.lists(st.lists(cells, min_size=n, max_size=n), min_size=1, max_size=5)),
    st.integers(20, 130),
    st.integers(1, 3),
)
def test_any_table_keeps_every_cell_and_fits_as_far_as_one_column_does(
    rows: list[list[str]], width: int, keys: int
) -> None:
    """Cells contain single spaces only, and columns are two apart."""
    lines = table_lines(rows[0], rows[1:], range(1, len(rows[0])), width, keys=keys)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    first = sum(one + 2 for one in widths[:keys])
    assert all(len(line) <= max(width, first + max([0, *widths[keys:]])) for line in lines)
    printed = Counter(cell for line in lines for cell in line.split("  "))
    assert not {cell for row in rows for cell in row} - {""} - {cell.strip() for cell in printed}


def test_measures_of_a_top_are_listed_one_by_one(cli) -> None:
    families, items = (
        {item["name"]: item for item in cli("list", "measures", *top, "--json").json()["measures"]}
        for top in ((), ("--top", "kowalevski"))
    )
    assert {"drift.NAME", "median_swing_spacing", "seconds"} <= families.keys()
    assert not [name for name in items if "NAME" in name]
    assert items["drift.k_sq"]["summary"] == "slope of a line fitted to k_sq, per unit time"
    assert items["drift.k_sq"]["unit"] == "unit of k_sq per time"
    assert (items["seconds"]["reproducible"], items["steps"]["of_failed"]) == (False, True)


# topcli table

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
    return write_rows(in_tmp / "out" / "mine", keys, {"max_error": values, "drift.energy": drifts}, outcome=outcome)


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
@pytest.mark.parametrize("measure", ["max_error", "drift.energy"])
def test_a_table_shows_what_is_stored(
    cli: Callable[..., Any], sweep: Path, aggregate: str | None, measure: str
) -> None:
    chosen = ("--aggregate", aggregate) if aggregate else ("--where", "seed=1")
    command = ("table", str(sweep), "--rows", "scheme", "--columns", "h", "--value", measure, *chosen)
    found = cli(*command, "--json").json()
    assert found["column_values"] == list(SIZES)
    title, header, *rows = cli(*command).out.splitlines()
    assert title.startswith(f"{measure} of mine")
    assert cells_of(header) == ["scheme", "h = 0.1", "h = 0.0316", "h = 0.001"]
    read = list(csv.DictReader(io.StringIO(cli(*command, "--format", "csv").out)))
    for scheme, line, row, fields in zip(SCHEMES, found["table"], rows, read, strict=False):
        name, *cells = cells_of(row)
        assert [name] == line["row"] == [scheme]
        for h, shown, cell in zip(SIZES, cells, line["cells"], strict=True):
            expect(shown, cell, aggregate)
            value = float(fields[f"h={h!r}"])
            assert math.isnan(value) if cell["value"] is None else value == cell["value"]


@pytest.mark.slow
def test_a_table_is_written_whole_and_overwrites_nothing(cli: Callable[..., Any], sweep: Path) -> None:
    command = ("table", str(sweep), "--rows", "scheme", "--columns", "h", "--value", "max_error", "--aggregate", "max")
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
    said = cli("table", str(sweep), "--rows", "scheme", "--columns", "h", "--value", "max_error", "--aggregate", "max")
    assert said.err.splitlines() == [
        "4 rows in each cell",
        "* 5 of 36 values are of runs that did not complete: 1 blew_up, 4 no_convergence",
        "* 5 of 36 values could not be computed (nan) and are left out",
    ]
