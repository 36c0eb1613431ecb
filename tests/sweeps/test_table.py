"""Rows of a sweep as tables and figures read them: conditions, cells, and how numbers are rounded."""

from __future__ import annotations

import math
import statistics
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from cases import table_of
from sweep_rows import write_rows
from topcli.errors import RunError, UsageError
from topcli.sweeps.rows import read_rows
from topcli.sweeps.table import Cell, Summary, SweepTable, summary, sweep_table
from topcli.sweeps.table_text import cell_text, lines, notes, title

H = [0.1, 0.01, 0.1, 0.01]


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    keys = {"scheme": ["hk", "hk", "rk4", "rk4"], "h": H, "N": [10, 20, 10, 20], "initial.omega": ["[1.0, 2.0]"] * 4}
    measures = {"max_error": [1.0, 2.0, 3.0, 4.0], "drift.energy": [5.0, 6.0, 7.0, 8.0]}
    return write_rows(
        tmp_path / "mine", keys, measures, current=[True, False, True, True], log=["h"], order=[3, 1, 0, 2]
    )


def test_only_current_rows_are_read_in_the_order_of_the_plan(stored: Path) -> None:
    for place in (stored, stored / "rows.parquet"):
        rows = read_rows(place)
        assert (rows.name, len(rows), rows.left_out) == ("mine", 3, 1)
        assert rows.columns["row"].tolist() == [0, 2, 3]
        assert rows.columns["max_error"].tolist() == [1.0, 3.0, 4.0]
        assert rows.columns["h"].tolist() == [0.1, 0.1, 0.01]
    assert rows.keys == ("scheme", "h", "N", "initial.omega")
    assert rows.measures == ("max_error", "drift.energy")
    assert rows.log == ("h",)


@pytest.mark.parametrize(
    ("conditions", "kept"),
    table_of("""
()                               [0, 2, 3]
('h=0.1',)                       [0, 2]
('h=1e-1',)                      [0, 2]
('h=0.1000000000001',)           [0, 2]
('h=0.10000000009',)             [0, 2]
('h=0.09999999991',)             [0, 2]
('h = 0.01',)                    [3]
('h=0.1', 'h=0.01')              [0, 2, 3]
('h=0.1', 'scheme=rk4')          [2]
('N=10',)                        [0, 2]
('initial.omega=[1,2]', 'N=20')  [3]
('outcome=completed',)           [0, 2, 3]
"""),
)
def test_conditions_select_rows(stored: Path, conditions: tuple[str, ...], kept: list[int]) -> None:
    rows = read_rows(stored).where(conditions)
    assert rows.columns["row"].tolist() == kept
    assert len(rows.chosen) == len(conditions)


@pytest.mark.parametrize(
    ("conditions", "message"),
    table_of("""
('h',)                 expected key=value
('h=',)                expected key=value
('hh=0.1',)            --where: unknown key 'hh'; did you mean 'h'
('max_error=1',)       unknown key 'max_error'
('h=0.10000000011',)   no row has this value; h is one of: 0.1, 0.01
('h=0.09999999989',)   no row has this value
('h=0.1001',)          no row has this value; h is one of: 0.1, 0.01
('h=abc',)             no row has this value
('scheme=bs',)         scheme is one of: hk, rk4
('scheme=hk', 'N=20')  no row satisfies all conditions
"""),
)
def test_wrong_conditions_are_named(stored: Path, conditions: tuple[str, ...], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        read_rows(stored).where(conditions)


def test_a_folder_without_rows_names_the_nearest(stored: Path) -> None:
    with pytest.raises(UsageError, match=r"no sweep is stored here \(rows.parquet is missing\); did you mean 'mine'"):
        read_rows(stored.with_name("mien"))
    with pytest.raises(UsageError, match="no sweep is stored here") as caught:
        read_rows(stored / "deeper")
    assert "mean" not in str(caught.value)
    none = write_rows(stored.parent / "old", {"h": [1.0]}, {"a": [1.0]}, current=[False])
    with pytest.raises(UsageError, match="has no rows yet"):
        read_rows(none)


def test_damaged_and_foreign_files_are_reported(stored: Path) -> None:
    path = stored / "rows.parquet"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RunError, match=r"rows.parquet: cannot be read"):
        read_rows(stored)
    pq.write_table(pa.table({"h": [1.0]}), path)
    with pytest.raises(RunError, match=r"not the rows of a sweep \(name is missing\)"):
        read_rows(stored)
    path.write_bytes(whole)
    table = pq.read_table(path)
    pq.write_table(table.drop_columns(["drift.energy"]), path)
    with pytest.raises(RunError, match=r"not the rows of a sweep \(drift.energy is missing\)"):
        read_rows(stored)


NAN = math.nan


SCHEMES, SIZES, SEEDS = ("hk", "a_b"), (0.1, 0.01, 1e-7), (1, 2, 3, 4)


ROWS = [(scheme, h, seed) for scheme in SCHEMES for h in SIZES for seed in SEEDS]


def value_of(scheme: str, h: float, seed: int) -> float:
    """A number of its own for each row."""
    return h ** (1.5 + SCHEMES.index(scheme)) * (1.0 + 0.37 * seed**2)


def made(folder: Path, **options: Any) -> Path:
    values = [value_of(*row) for row in ROWS]
    for i, value in options.pop("spoilt", {}).items():
        values[i] = value
    keys = {name: list(column) for name, column in zip(("scheme", "h", "seed"), zip(*ROWS, strict=True), strict=True)}
    return write_rows(folder / "mine", keys, {"max_error": values, "seconds": [1.0 + v for v in values]}, **options)


def table(folder: Path, aggregate: str | None = "median", where: tuple[str, ...] = (), **options: Any) -> SweepTable:
    rows = read_rows(made(folder, **options)).where(where)
    return sweep_table(rows, ["scheme"], "h", ["max_error"], aggregate)


def test_each_cell_is_the_aggregate_of_its_rows(tmp_path: Path) -> None:
    by_aggregate = {name: table(tmp_path, name) for name in ("median", "mean", "max")}
    for scheme in SCHEMES:
        for j, h in enumerate(SIZES):
            values = [value_of(scheme, h, seed) for seed in SEEDS]
            median, mean, largest = (by_aggregate[name].lines[scheme,][j].summary for name in by_aggregate)
            assert median
            assert mean
            assert largest
            quartiles = statistics.quantiles(values, n=4, method="inclusive")
            assert (median.low, median.value, median.high) == pytest.approx(quartiles, rel=1e-14)
            error = statistics.stdev(values) / 2.0
            assert mean.value == pytest.approx(statistics.fmean(values), rel=1e-14)
            assert (mean.low, mean.high) == pytest.approx((mean.value - error, mean.value + error), rel=1e-13)
            assert largest == Summary(max(values))
    assert by_aggregate["max"].over == ("seed",)


def test_several_values_in_a_cell_are_refused_by_the_keys_that_vary(tmp_path: Path) -> None:
    rows = read_rows(made(tmp_path))
    with pytest.raises(UsageError) as caught:
        sweep_table(rows, ["scheme"], "h", ["max_error"], None)
    assert caught.value.lines == (
        "up to 4 values fall into one cell, because seed still varies",
        "choose with --where seed=VALUE, use --rows seed, or add --aggregate median",
    )
    with pytest.raises(UsageError, match=r"up to 12 values fall into one cell, because h, seed still vary"):
        sweep_table(rows, ["scheme"], None, ["max_error"], None)
    twice = write_rows(tmp_path / "twice", {"h": [0.1, 0.1]}, {"a": [1.0, 2.0]})
    with pytest.raises(UsageError, match="2 rows fall into one cell although no key varies"):
        sweep_table(read_rows(twice), ["h"], None, ["a"], None)


def test_the_observed_order_is_an_aggregate_over_h(tmp_path: Path) -> None:
    sizes = [0.1 * 2.0**-k for k in range(6)]
    grid = [(scheme, seed, h) for scheme in ("hk", "rk4", "bs") for seed in (1, 2) for h in sizes]
    errors = [(1.0 + seed) * h ** {"hk": 2, "rk4": 4, "bs": 1}[scheme] for scheme, seed, h in grid]
    errors[-4:] = [NAN] * 4
    keys = {name: [row[i] for row in grid] for i, name in enumerate(("scheme", "seed", "h"))}
    rows = read_rows(write_rows(tmp_path / "x", keys, {"error": errors}))
    found = sweep_table(rows, ["scheme"], "seed", ["error"], "order")
    assert lines(found) == [["hk", "2.00", "2.00"], ["rk4", "4.00", "4.00"], ["bs", "1.00", "nan"]]
    assert title(found) == "error of x: observed order over h"
    assert found.as_dict()["table"][1]["cells"][0]["value"] == pytest.approx(4.0, abs=1e-9)
    with pytest.raises(UsageError, match="up to 2 values fall into one cell at one h, because seed still varies"):
        sweep_table(rows, ["scheme"], None, ["error"], "order")
    with pytest.raises(UsageError, match="is fitted against h, so h cannot distinguish one cell from another"):
        sweep_table(rows, ["scheme"], "h", ["error"], "order")
    other = read_rows(write_rows(tmp_path / "y", {"N": [1, 2]}, {"error": [1.0, 2.0]}))
    with pytest.raises(UsageError, match="--aggregate order: h does not vary; the keys are N"):
        sweep_table(other, ["N"], None, ["error"], "order")


def test_failed_rows_are_marked_and_counted(tmp_path: Path) -> None:
    outcome = ["completed"] * len(ROWS)
    outcome[0], outcome[1] = "blew_up", "left_motion"
    outcome[4:8] = ["no_convergence"] * 3 + ["failed"]
    spoilt = {0: NAN, **dict.fromkeys(range(4, 8), NAN), 20: NAN}
    found = table(tmp_path, outcome=outcome, spoilt=spoilt, current=[True] * 23 + [False])
    (first, none, last), (_, _, other) = found.lines.values()
    assert (first.count, first.rows, first.outcomes) == (3, 4, {"blew_up": 1, "left_motion": 1})
    kept = [value_of("hk", 0.1, seed) for seed in (2, 3, 4)]
    assert first.summary
    assert first.summary.value == statistics.median(kept)
    assert cell_text(first, "median").endswith("*")
    assert (none.summary, none.count, cell_text(none, "median")) == (None, 0, "no_convergence")
    assert not last.incomplete
    assert (other.count, other.rows, other.outcomes, other.incomplete) == (2, 3, {}, True)
    assert cell_text(other, "median").endswith("*"), "a value is missing, although all runs completed"
    assert notes(found) == [
        "3 to 4 rows in each cell",
        "* 6 of 23 values are of runs that did not complete: 1 blew_up, 1 left_motion, 3 no_convergence, 1 failed",
        "* 6 of 23 values could not be computed (nan) and are left out",
        "1 stored row no longer belongs to the sweep and is left out",
    ]


def cell(*numbers: float) -> Cell:
    return Cell(Summary(*numbers), 5, 5, {})


@pytest.mark.parametrize(
    ("mean", "error", "text"),
    table_of("""
28.172345    0.00123  28.1723 ± 0.0012
28.172345    0.0996   28.17 ± 0.10
1.23456e-5   1.23e-8  1.2346e-05 ± 1.2e-08
-1.23456e-5  9.96e-8  -1.235e-05 ± 1.0e-07
3.0e-9       1.2e-7   0.0e-07 ± 1.2e-07
-3.0e-9      1.2e-7   0.0e-07 ± 1.2e-07
12345.6      230.0    12350 ± 230
123456.0     230.0    1.2346e+05 ± 2.3e+02
0.0          0.5      0.00 ± 0.50
2.0          0.0      2 ± 0
"""),
)
def test_a_mean_is_rounded_to_its_error(mean: float, error: float, text: str) -> None:
    assert cell_text(cell(mean, mean - error, mean + error), "mean") == text


@pytest.mark.parametrize(
    ("numbers", "text"),
    table_of("""
(28.172345, 28.1711, 28.1741)  28.1723 [28.1711, 28.1741]
(1.5e-6, 1.0e-8, 2.0e-3)       1.5e-06 [1.0e-08, 0.0020]
(5.0, 5.0, 5.0)                5 [5, 5]
(2.0e-5,)                      '2.00e-05'
"""),
)
def test_a_median_is_rounded_to_its_quartiles(numbers: tuple[float, ...], text: str) -> None:
    assert cell_text(cell(*numbers), "median") == text


INF = math.inf


@pytest.mark.parametrize(
    ("numbers", "median", "quartiles"),
    table_of("""
(1.0, 1e999, 2.0, 1e999, 1e999)  1e999  (2.0, 1e999)
(1.0, 1e999, 2.0, 3.0)           2.5    (1.75, 1e999)
(1.0, 1e999)                     1e999  (1e999, 1e999)
(1e999, 1e999, 1e999)            1e999  (1e999, 1e999)
(1.0, 2.0, 3.0, 4.0, 1e999)      3.0    (2.0, 4.0)
(-1e999, 1.0, 2.0)               1.0    (-1e999, 1.5)
"""),
)
def test_infinite_values_count_as_the_largest(
    numbers: tuple[float, ...], median: float, quartiles: tuple[float, float]
) -> None:
    """A failed reversal is infinite: it never makes a median better, nor the value disappear."""
    found = summary(np.array(numbers), "median")
    assert (found.value, (found.low, found.high)) == (median, quartiles)
    if min(numbers) > 0.0:
        assert summary(np.array(numbers), "mean").value == summary(np.array(numbers), "max").value == INF
