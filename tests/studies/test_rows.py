"""Rows of a sweep as tables and figures read them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from sweep_rows import write_rows
from topcli.errors import RunError, UnknownNameError, UsageError
from topcli.sweeps.rows import key_labels, read_rows

H = [0.1, 0.01, 0.1, 0.01]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    keys = {"scheme": ["hk", "hk", "rk4", "rk4"], "h": H, "N": [10, 20, 10, 20], "initial.omega": ["[1.0, 2.0]"] * 4}
    measures = {"error.max": [1.0, 2.0, 3.0, 4.0], "drift.energy": [5.0, 6.0, 7.0, 8.0]}
    return write_rows(
        tmp_path / "mine", keys, measures, current=[True, False, True, True], log=["h"], order=[3, 1, 0, 2]
    )


def test_only_current_rows_are_read_in_the_order_of_the_plan(folder: Path) -> None:
    for place in (folder, folder / "rows.parquet"):
        rows = read_rows(place)
        assert (rows.name, len(rows), rows.left_out) == ("mine", 3, 1)
        assert rows.columns["row"].tolist() == [0, 2, 3]
        assert rows.columns["error.max"].tolist() == [1.0, 3.0, 4.0]
        assert rows.columns["h"].tolist() == [0.1, 0.1, 0.01]
    assert rows.keys == ("scheme", "h", "N", "initial.omega")
    assert rows.measures == ("error.max", "drift.energy")
    assert rows.log == ("h",)


@pytest.mark.parametrize(
    ("conditions", "kept"),
    [
        ((), [0, 2, 3]),
        (("h=0.1",), [0, 2]),
        (("h=1e-1",), [0, 2]),
        (("h=0.1000000000001",), [0, 2]),
        (("h=0.10000000009",), [0, 2]),
        (("h=0.09999999991",), [0, 2]),
        (("h = 0.01",), [3]),
        (("h=0.1", "h=0.01"), [0, 2, 3]),
        (("h=0.1", "scheme=rk4"), [2]),
        (("N=10",), [0, 2]),
        (("initial.omega=[1,2]", "N=20"), [3]),
        (("outcome=completed",), [0, 2, 3]),
    ],
)
def test_conditions_select_rows(folder: Path, conditions: tuple[str, ...], kept: list[int]) -> None:
    rows = read_rows(folder).where(conditions)
    assert rows.columns["row"].tolist() == kept
    assert len(rows.chosen) == len(conditions)


@pytest.mark.parametrize(
    ("conditions", "message"),
    [
        (("h",), "expected key=value"),
        (("h=",), "expected key=value"),
        (("hh=0.1",), "--where: unknown key 'hh'; did you mean 'h'"),
        (("error.max=1",), "unknown key 'error.max'"),
        (("h=0.10000000011",), r"no row has this value; h is one of: 0.1, 0.01"),
        (("h=0.09999999989",), r"no row has this value"),
        (("h=0.1001",), r"no row has this value; h is one of: 0.1, 0.01"),
        (("h=abc",), "no row has this value"),
        (("scheme=bs",), "scheme is one of: hk, rk4"),
        (("scheme=hk", "N=20"), "no row satisfies all conditions"),
    ],
)
def test_wrong_conditions_are_named(folder: Path, conditions: tuple[str, ...], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        read_rows(folder).where(conditions)


def test_keys_and_measures_are_told_apart(folder: Path) -> None:
    rows = read_rows(folder)
    assert rows.require_key("h", "--x") == "h"
    assert rows.require_measure("error.max", "--y") == "error.max"
    with pytest.raises(UnknownNameError, match="--x: unknown key 'shceme'; did you mean 'scheme'"):
        rows.require_key("shceme", "--x")
    with pytest.raises(UnknownNameError, match=r"--y: unknown measure 'error'; did you mean 'error.max'"):
        rows.require_measure("error", "--y")
    with pytest.raises(UsageError, match=r"--x: 'error.max' is a measure; give a varied key: scheme, h"):
        rows.require_key("error.max", "--x")
    with pytest.raises(UsageError, match=r"--y: 'h' is a key; give a measure: error.max"):
        rows.require_measure("h", "--y")


def test_a_folder_without_rows_names_the_nearest(folder: Path) -> None:
    with pytest.raises(UsageError, match=r"no sweep is stored here \(rows.parquet is missing\); did you mean 'mine'"):
        read_rows(folder.with_name("mien"))
    with pytest.raises(UsageError, match="no sweep is stored here") as caught:
        read_rows(folder / "deeper")
    assert "mean" not in str(caught.value)
    none = write_rows(folder.parent / "old", {"h": [1.0]}, {"a": [1.0]}, current=[False])
    with pytest.raises(UsageError, match="has no rows yet"):
        read_rows(none)


def test_damaged_and_foreign_files_are_reported(folder: Path) -> None:
    path = folder / "rows.parquet"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RunError, match=r"rows.parquet: cannot be read"):
        read_rows(folder)
    pq.write_table(pa.table({"h": [1.0]}), path)
    with pytest.raises(RunError, match=r"not the rows of a sweep \(name is missing\)"):
        read_rows(folder)
    path.write_bytes(whole)
    table = pq.read_table(path)
    pq.write_table(table.drop_columns(["drift.energy"]), path)
    with pytest.raises(RunError, match=r"not the rows of a sweep \(drift.energy is missing\)"):
        read_rows(folder)


@pytest.mark.parametrize(
    ("values", "labels"),
    [
        ([0.1, 0.025, 0.1], ["0.1", "0.025"]),
        ([1024.0, 0.015625], ["1024", "0.015625"]),
        ([0.031622776601683794, 1e-7], ["0.0316", "1e-7"]),
        ([1.00001234, 1.00002345], ["1.00001", "1.00002"]),
        ([1e20], ["1e20"]),
        ([3.0, float("nan")], ["3", "–"]),
    ],
)
def test_labels_are_short_and_different(values: list[float], labels: list[str]) -> None:
    assert list(key_labels(np.array(values)).values()) == labels


def test_labels_of_integers_and_words() -> None:
    assert list(key_labels(np.array([1234567, 2])).values()) == ["1234567", "2"]
    assert list(key_labels(np.array(["b", "a", None], dtype=object)).values()) == ["b", "a", "–"]
