"""Series on the disk: thinned to be drawn, and files of other programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from topcli.errors import RunError
from topcli.store import table
from topcli.store.envelope import envelope
from topcli.store.series import series_length
from topcli.store.table import Table

ROWS = 20_011
"""A prime number: the last stretch is shorter than the others."""


def columns(rows: int = ROWS) -> dict[str, np.ndarray]:
    random = np.random.default_rng(5)
    noise = random.normal(size=rows)
    noise[rows // 3] = 50.0
    noise[rows // 2] = -60.0
    return {"n": np.arange(rows), "t": np.arange(rows) * 0.1, "a": noise, "b": np.cumsum(noise)}


def stored(folder: Path, suffix: str, data: dict[str, np.ndarray]) -> Path:
    with Table(folder, "series", {}, suffix) as growing:
        for start in range(0, len(data["n"]), 1777):
            growing.add({name: values[start : start + 1777] for name, values in data.items()})
        return growing.finish((), {})


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_extremes_of_every_stretch_are_kept(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table, "ROW_GROUP", 4000)
    data = columns()
    path = stored(tmp_path, suffix, data)
    assert series_length(path) == ROWS
    found = envelope(path, ["t", "a", "b"], 100)
    assert len(found["t"]) <= 101 * 8
    size = -(-ROWS // 100)
    for name in ("a", "b"):
        for start in range(0, ROWS, size):
            whole = data[name][start : start + size]
            inside = (found["t"] >= data["t"][start]) & (found["t"] <= data["t"][min(start + size, ROWS) - 1])
            assert (found[name][inside].min(), found[name][inside].max()) == (whole.min(), whole.max())
    assert (found["t"][0], found["t"][-1]) == (0.0, data["t"][-1])
    assert (np.diff(found["t"]) > 0.0).all()
    at = np.rint(found["t"] / 0.1).astype(int)
    np.testing.assert_array_equal(found["b"], data["b"][at])


@pytest.mark.parametrize("rows", [1, 2, 799, 800])
def test_a_short_series_is_kept_whole(tmp_path: Path, rows: int) -> None:
    """Up to eight rows in a stretch, as many as the extremes of three columns and the ends."""
    data = {name: values[:rows] for name, values in columns(2000).items()}
    found = envelope(stored(tmp_path, "parquet", data), ["t", "a", "b"], 100)
    np.testing.assert_array_equal(found["a"], data["a"])


def test_missing_numbers_hide_no_extreme(tmp_path: Path) -> None:
    data = columns()
    values = data["a"]
    values[::2] = np.nan
    found = envelope(stored(tmp_path, "parquet", data), ["t", "a"], 50)["a"]
    assert np.nanmax(found) == np.nanmax(values)
    assert np.nanmin(found) == np.nanmin(values)


def test_a_damaged_series_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "series.parquet"
    path.write_bytes(b"PAR1")
    with pytest.raises(RunError, match=r"series\.parquet: cannot be read"):
        envelope(path, ["t"])
    with pytest.raises(RunError, match=r"none\.csv: cannot be read"):
        series_length(tmp_path / "none.csv")
