"""Rows of a sweep as tables and figures read them: conditions, cells, and how numbers are rounded."""

from __future__ import annotations

import statistics
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from cases import table_of
from sweep_rows import write_rows
from topcli.errors import RunError, UsageError
from topcli.sweeps.aggregates import (
    SweepTable,
    aggregate_of,
    cell_text,
    key_labels,
    read_rows,
    sweep_table,
)

SCHEMES, SIZES, SEEDS = ("hk", "a_b"), (0.1, 0.01, 1e-7), (1, 2, 3, 4)
ROWS = list(product(SCHEMES, SIZES, SEEDS))


def value_of(scheme: str, h: float, seed: int) -> float:
    """A number of its own for each row."""
    return h ** (1.5 + SCHEMES.index(scheme)) * (1.0 + 0.37 * seed**2)


def stored(folder: Path, spoilt: dict[int, float] = {}, **options: Any) -> Path:  # noqa: B006 (never changed)
    values = [spoilt.get(i, value_of(*row)) for i, row in enumerate(ROWS)]
    keys = {name: [row[i] for row in ROWS] for i, name in enumerate(("scheme", "h", "seed"))}
    return write_rows(folder / "mine", keys, {"max_error": values, "seconds": [1.0 + v for v in values]}, **options)


def table(folder: Path, aggregate: str | None = "median", where: tuple[str, ...] = (), **options: Any) -> SweepTable:
    return sweep_table(read_rows(stored(folder, **options), where), ["scheme"], "h", ["max_error"], aggregate)


@pytest.mark.parametrize(
    ("conditions", "kept"),
    table_of("""
()                                          24
('h=1e-1', 'seed = 2')                      [1, 13]
('h=0.10000000009', 'seed=2')               [1, 13]
('h=0.1', 'h=0.01', 'scheme=hk', 'seed=1')  [0, 4]
('h',)                                      'expected key=value'
('hh=0.1',)                                "--where: unknown key 'hh'; did you mean 'h'"
('max_error=1',)                           "unknown key 'max_error'"
('h=0.10000000011',)                       'no row has this value; h is one of: 0.1, 0.01, 1e-7'
('h=abc',)                                 'no row has this value'
('scheme=bs',)                             'scheme is one of: hk, a_b'
('outcome=blew_up', 'h=0.1')               'no row has this value; outcome is one of: completed'
"""),
)
def test_conditions_select_rows_or_are_refused(tmp_path: Path, conditions: tuple[str, ...], kept: Any) -> None:
    if isinstance(kept, str):
        with pytest.raises(UsageError, match=kept):
            read_rows(stored(tmp_path), conditions)
        return
    rows = read_rows(stored(tmp_path), conditions)
    assert (len(rows) if isinstance(kept, int) else rows["row"].tolist()) == kept
    assert rows.attrs["keys"] == ["scheme", "h", "seed"]
    assert rows.attrs["where"] == list(conditions)


def test_missing_and_damaged_rows_are_reported(tmp_path: Path) -> None:
    folder = stored(tmp_path)
    with pytest.raises(UsageError, match=r"no sweep is stored here \(rows.parquet is missing\); did you mean 'mine'"):
        read_rows(folder.with_name("mien"))
    pd.DataFrame({"h": [1.0]}).to_parquet(folder / "rows.parquet")
    with pytest.raises(RunError, match=r"rows.parquet: cannot be read"):
        read_rows(folder)


def test_each_cell_is_the_aggregate_of_its_rows(tmp_path: Path) -> None:
    for (scheme, h), label in zip(product(SCHEMES, SIZES), ("0.1", "0.01", "1e-7") * 2, strict=True):
        values = [value_of(scheme, h, seed) for seed in SEEDS]
        median, mean, largest = (
            table(tmp_path, name).rows[SCHEMES.index(scheme)][f"h = {label}"] for name in ("median", "mean", "max")
        )
        low, middle, high = statistics.quantiles(values, n=4, method="inclusive")
        assert median == pytest.approx((middle, low, high), rel=1e-14)
        center, error = statistics.fmean(values), statistics.stdev(values) / 2.0
        assert mean == pytest.approx((center, center - error, center + error), rel=1e-13)
        assert largest == (max(values),)


def test_failed_rows_are_left_out_and_counted(tmp_path: Path) -> None:
    outcome = ["blew_up", "left_motion", *["completed"] * 2, *["no_convergence"] * 4, *["completed"] * 16]
    shown = table(tmp_path, outcome=outcome, spoilt=dict.fromkeys((0, 4, 5, 6, 7, 20), np.nan))
    assert shown.rows[0]["h = 0.1"][0] == statistics.median([value_of("hk", 0.1, seed) for seed in (2, 3, 4)])
    assert shown.cells().lines[0][2] == "–"
    assert shown.caption == (
        "4 rows in each cell; 6 of 24 rows did not complete: 4 no_convergence, 1 blew_up, 1 left_motion; "
        "6 of 24 rows have no value and are left out"
    )
    rows = read_rows(stored(tmp_path, spoilt={3: np.nan})).assign(seconds=1.0)
    assert sweep_table(rows[1:], ["scheme"], "h", ["seconds"], "max").caption == "3 to 4 rows in each cell"
    both = sweep_table(rows, ["scheme"], None, ["max_error", "seconds"], "max")
    assert (both.caption or "").endswith("; 1 of 24 rows have no value and are left out")


@pytest.mark.parametrize(
    ("cell", "aggregate", "text"),
    table_of("""
(28.172345, 28.171115, 28.173575)     mean    28.1723 ± 0.0012
(2.0, 2.0, 2.0)                       mean    '2'
(28.172345, 28.1711, 28.1741)         median  28.1723 [28.1711, 28.1741]
(1.5e-6, 1.0e-8, 2.0e-3)              median  1.5e-06 [1.0e-08, 0.0020]
(5.0, 5.0, 5.0)                       median  5 [5, 5]
(2.0e-5,)                             max     '2.00e-05'
()                                    max     '–'
"""),
)
def test_numbers_are_rounded_to_their_spread(cell: tuple[float, ...], aggregate: str, text: str) -> None:
    assert cell_text(cell, aggregate) == text


@pytest.mark.parametrize(
    ("numbers", "median"),
    table_of("""
(1.0, 1e999, 2.0, 1e999, 1e999)  (1e999, 2.0, 1e999)
(1.0, 1e999, 2.0, 3.0)           (2.5, 1.75, 1e999)
(1e999, 1e999, 1e999)            (1e999, 1e999, 1e999)
"""),
)
def test_infinite_values_count_as_the_largest(numbers: tuple[float, ...], median: tuple[float, ...]) -> None:
    """A failed reversal is infinite: it never makes a median better, nor the value disappear."""
    values = pd.Series(numbers)
    assert aggregate_of(values, "median") == median
    assert aggregate_of(values, "mean") == aggregate_of(values, "max") == (np.inf,)


def test_labels_of_keys_are_short_and_different() -> None:
    assert list(key_labels(pd.Series([0.1, 1e-7, 3e12, 1 / 3])).values()) == ["0.1", "1e-7", "3e12", "0.333333"]
    assert list(key_labels(pd.Series([1 / 3, 0.333333])).values()) == ["0.3333333333333333", "0.333333"]
