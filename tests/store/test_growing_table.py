"""Tables that grow: the same bytes however they were cut and continued, and the same bits in every format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from topcli.errors import RunError
from topcli.store import growing_table
from topcli.store.growing_table import GrowingTable
from topcli.store.series import envelope, read_metadata, read_series

VALUES = [0.0, -0.0, 0.1, -1e-308, 5e-324, 1.7976931348623157e308, np.inf, -np.inf, np.nan, 1 / 3, 2.0**53 + 2, -7.0]


@pytest.fixture(autouse=True)
def small_row_groups(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growing_table, "ROW_GROUP", 40)


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
    with GrowingTable(tmp_path, "series", {"about": "it"}, form) as table:
        table.add(data)
        path = table.finish(list(data), {"end": "now"})
    assert [file.name for file in tmp_path.iterdir() if file.suffix != ".arrow"] == [f"series.{form}"]
    stored = read_series(path)
    assert {name: bits(stored[name]) for name in stored} == {name: bits(data[name]) for name in data}
    if form == "parquet":
        assert read_metadata(path)["about"] == "it"
        assert pq.read_metadata(path).metadata[b"end"] == b"now"


@pytest.mark.parametrize("form", ["parquet", "csv"])
def test_bytes_depend_neither_on_pieces_nor_on_kills(tmp_path: Path, form: str) -> None:
    random, data, lives = np.random.default_rng(7), columns(500), 0
    with GrowingTable(tmp_path, "whole", {"who": "test"}, form) as whole:
        whole.add(data)
        expected = whole.finish([], {}).read_bytes()
    for life in range(5):
        state, begin, end = {}, 0, 0
        while end < 500:
            end, lives = begin, lives + 1
            with GrowingTable(tmp_path, f"cut{life}", {"who": "test"}, form) as table:
                if state:
                    table.restore(state)
                for _ in range(random.integers(0, 12)):  # rows after the last checkpoint are lost
                    table.add(piece(data, end, end := min(end + int(random.integers(0, 70)), 500)))
                    if random.random() < 0.4:
                        state, begin = table.commit(), end
                if end == 500:
                    assert table.finish([], {}).read_bytes() == expected
    assert lives > 12


def test_many_short_pieces_can_be_read_while_the_table_grows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growing_table, "ROW_GROUP", 100)
    data = columns(140)
    with GrowingTable(tmp_path, "series", {}) as table:
        for begin in range(70):
            table.add(piece(data, begin, begin + 1))
        assert list(tmp_path.iterdir()) == []  # a short table has no parts
        table.commit()
        table.add(piece(data, 70, 140))
        table.commit()
    rows = pd.concat([pd.read_feather(path) for path in sorted(tmp_path.glob("*.arrow"))])
    np.testing.assert_array_equal(rows["y"], data["y"])


@pytest.mark.parametrize("damage", ["empty", "short", "missing", "flipped"])
def test_a_damaged_part_is_never_continued(tmp_path: Path, damage: str) -> None:
    with GrowingTable(tmp_path, "series", {}) as table:
        for _ in range(2):
            table.add(columns(50))
            state = table.commit()
    path = tmp_path / "series.000001.arrow"
    content = path.read_bytes()
    place = content.rindex(columns(50)["y"][-1:].tobytes())  # a number: Arrow would read another one
    flipped = content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :]
    damaged = {"empty": b"", "short": content[:-9], "flipped": flipped}
    path.write_bytes(damaged[damage]) if damage in damaged else path.unlink()
    with (
        GrowingTable(tmp_path, "series", {}) as table,
        pytest.raises(RunError, match=r"000001\.arrow: damaged .*--force"),
    ):
        table.restore(state)


ROWS = 20_011
"""A prime number: the last stretch is shorter than the others."""


def thinned(folder: Path, suffix: str, data: dict[str, np.ndarray], stretches: int = 100) -> dict[str, np.ndarray]:
    """Envelope of a stored series."""
    with GrowingTable(folder, "series", {}, suffix) as growing:
        growing.add(data)
        return envelope(growing.finish((), {}), list(data), stretches)


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_a_picture_keeps_the_extremes_of_every_stretch(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("topcli.store.series.PIECE", 4000)
    noise = np.random.default_rng(5).normal(size=ROWS)
    noise[::2] = np.nan  # which hides no extreme
    data = {"t": np.arange(ROWS) * 0.1, "a": noise, "b": np.arange(ROWS) % 977.0}
    rows = thinned(tmp_path, suffix, data)
    assert len(rows["t"]) <= 101 * 8
    assert (rows["t"][0], rows["t"][-1]) == (0.0, data["t"][-1])
    assert (np.diff(rows["t"]) > 0.0).all()
    size = -(-ROWS // 100)
    for name in ("a", "b"):
        for start in range(0, ROWS, size):
            whole = data[name][start : start + size]
            inside = rows[name][(rows["t"] >= data["t"][start]) & (rows["t"] <= data["t"][min(start + size, ROWS) - 1])]
            assert (np.nanmin(inside), np.nanmax(inside)) == (np.nanmin(whole), np.nanmax(whole))
    np.testing.assert_array_equal(rows["b"], data["b"][np.rint(rows["t"] / 0.1).astype(int)])


@pytest.mark.parametrize("rows", [1, 800])
def test_a_picture_of_a_short_series_keeps_all_rows(tmp_path: Path, rows: int) -> None:
    data = {name: np.arange(rows) * 1.0 for name in "tab"}
    assert len(thinned(tmp_path, "parquet", data)["a"]) == rows


@pytest.mark.parametrize("name", ["series.parquet", "series.csv", "none.parquet"])
def test_a_damaged_series_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "series.parquet").write_bytes(b"PAR1")
    with pytest.raises(RunError, match="cannot be read"):
        envelope(tmp_path / name, ["t"])
