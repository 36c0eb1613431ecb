"""Tables that grow: the same bytes however they were cut and continued, and the same bits in every format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from topcli.errors import RunError
from topcli.store import table as table_module
from topcli.store.series import read_metadata, read_series, series_pieces
from topcli.store.table import Table

VALUES = [0.0, -0.0, 0.1, -1e-308, 5e-324, 1.7976931348623157e308, np.inf, -np.inf, np.nan, 1 / 3, 2.0**53 + 2, -7.0]


@pytest.fixture(autouse=True)
def small_row_groups(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_module, "ROW_GROUP", 40)


def columns(rows: int) -> dict[str, np.ndarray]:
    return {
        "n": np.arange(rows, dtype=np.int64) * 10**11,
        "x": np.resize(np.array(VALUES), rows) * np.float64(1.0),
        "y": np.random.default_rng(4).standard_normal(rows),
        "outcome": np.resize(np.array(["completed", "blew_up"], dtype=object), rows),
    }


def piece(data: dict[str, np.ndarray], begin: int, end: int) -> dict[str, np.ndarray]:
    return {name: values[begin:end] for name, values in data.items()}


def bits(values: np.ndarray) -> Any:
    return values.tolist() if values.dtype.kind == "O" else values.view(np.int64).tolist()


@pytest.mark.parametrize("form", ["parquet", "csv"])
@pytest.mark.parametrize("rows", [0, 1, 39, 40, 41, 500])
def test_a_table_keeps_its_bits_in_every_format(tmp_path: Path, form: str, rows: int) -> None:
    data = columns(rows)
    with Table(tmp_path, "series", {"about": "it"}, form) as table:
        table.add(data)
        path = table.finish(list(data), {"end": "now"})
    assert path.name == f"series.{form}"
    assert {path.name} == {one.name for one in tmp_path.iterdir() if one.suffix != ".arrow"}
    found = read_series(path)
    assert {name: bits(found[name]) for name in found} == {name: bits(data[name]) for name in data}
    assert sum(len(rows["n"]) for rows in series_pieces(path, ["n"])) == rows
    if form == "parquet":
        assert read_metadata(path)["about"] == "it"
        assert pq.read_metadata(path).metadata[b"end"] == b"now"


@pytest.mark.parametrize("form", ["parquet", "csv"])
def test_bytes_depend_neither_on_pieces_nor_on_kills(tmp_path: Path, form: str) -> None:
    random, data, lives = np.random.default_rng(7), columns(500), 0
    with Table(tmp_path, "whole", {"who": "test"}, form) as whole:
        whole.add(data)
        expected = whole.finish([], {}).read_bytes()
    for life in range(5):
        state, begin, end = {}, 0, 0
        while end < 500:
            end, lives = begin, lives + 1
            with Table(tmp_path, f"cut{life}", {"who": "test"}, form) as table:
                if state:
                    table.restore(state)
                for _ in range(random.integers(0, 12)):  # rows after the last checkpoint are lost
                    table.add(piece(data, end, end := min(end + int(random.integers(0, 70)), 500)))
                    if random.random() < 0.4:
                        state, begin = table.commit(), end
                if end == 500:
                    assert table.finish([], {}).read_bytes() == expected
    assert lives > 12


def test_rows_can_be_read_while_the_table_grows(tmp_path: Path) -> None:
    data = columns(100)
    with Table(tmp_path, "series", {}) as table:
        for begin, end in ((0, 70), (70, 100)):
            table.add(piece(data, begin, end))
            table.commit()
    rows = pd.concat([pd.read_feather(path) for path in sorted(tmp_path.glob("*.arrow"))])
    np.testing.assert_array_equal(rows["y"], data["y"])


def test_a_short_table_has_no_parts(tmp_path: Path) -> None:
    with Table(tmp_path, "series", {}) as table:
        table.add(columns(39))
        assert list(tmp_path.iterdir()) == []
        assert table.commit()["series.parts"].shape == (1,)


@pytest.mark.parametrize("damage", ["flip", "cut", "empty", "remove"])
def test_a_damaged_part_is_never_continued(tmp_path: Path, damage: str) -> None:
    with Table(tmp_path, "series", {}) as table:
        for _ in range(2):
            table.add(columns(50))
            state = table.commit()
    path = tmp_path / "series.000001.arrow"
    content = path.read_bytes()
    path.unlink()
    if damage != "remove":
        torn = {"flip": content[:600] + bytes([content[600] ^ 1]) + content[601:], "cut": content[:-9], "empty": b""}
        path.write_bytes(torn[damage])
    with pytest.raises(RunError, match=r"series\.000001\.arrow: damaged .*--force"):
        Table(tmp_path, "series", {}).restore(state)
