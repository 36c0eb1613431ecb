"""Files of other programs: what is read, and the one line that says what is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from topcli.errors import UsageError
from topcli.store.foreign import ForeignSeries


def written(folder: Path, content: str | bytes, name: str = "x.csv") -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize(
    "text",
    [
        "t,a\n0,1\n0.5,2\n",
        "\ufefft,a\r\n0,1\r\n0.5,2\r\n",
        "# t;a\n0;1\n0.5;2\n",
        "t\ta\n0.0\t1e0\n\n5e-1\t2\n",
        't , "a"\n0, 1\n0.5, +2\n',
        "b,t,a\nword,0,1\n,0.5,2\n",
    ],
)
def test_csv_is_read_however_it_is_written(tmp_path: Path, text: str) -> None:
    found = ForeignSeries(written(tmp_path, text)).read(["t", "a"])
    assert {name: values.tolist() for name, values in found.items()} == {"t": [0.0, 0.5], "a": [1.0, 2.0]}
    assert all(values.dtype == np.float64 for values in found.values())


def test_parquet_is_known_by_its_content(tmp_path: Path) -> None:
    path = tmp_path / "x.dat"
    pq.write_table(pa.table({"t": [0, 1], "a": pa.array([1.5, 2.5], pa.float32()), "w": ["x", "y"]}), path)
    found = ForeignSeries(path).read(["a", "t"])
    assert {name: values.tolist() for name, values in found.items()} == {"a": [1.5, 2.5], "t": [0.0, 1.0]}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "is empty"),
        (" \n\n", "is empty"),
        (b"t,a\n0,\0\n", "neither CSV nor Parquet (it holds binary data)"),
        (b"t,\xff\n0,1\n", "neither CSV nor Parquet (byte 0xff is not UTF-8 text)"),
        (b"PAR1 and no more", "damaged Parquet"),
        ("hello\nworld\n", "no column names separated by commas, semicolons or tabs"),
        ("0,1\n0.5,2\n", "first line holds numbers; expected the names of the columns"),
        ("t,a,t\n0,1,0\n", "two columns are called 't'"),
        ("t,a\n0,1\n0.5,two\n", "row 2: a is not a number: 'two'"),
        ("t,a\n0,1\n0.5,\n", "row 2: a is empty"),
        ("t,a\n0,1\n0.5\n", "row 2: has 1 columns; expected 2"),
        ("t,a\n0,1\n0.5,2,3\n", "row 2: has 3 columns; expected 2"),
        ("t,a\n0,1\n1,2\n0.5,nan\n", "row 3: a is not finite (nan)"),
        ("t,a\n0,1\n1,-inf\n", "row 2: a is not finite (-inf)"),
        (b"t,a\n0,1\n1,\xff\n", "is neither CSV nor Parquet (byte 0xff is not UTF-8 text)"),
    ],
)
def test_wrong_content_is_named(tmp_path: Path, content: str | bytes, words: str) -> None:
    path = written(tmp_path, content)
    with pytest.raises(UsageError) as caught:
        ForeignSeries(path).read(["t", "a"])
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert words in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("column", "words"),
    [
        (pa.array([1.0, None]), "row 2: a is empty"),
        (pa.array(["one", "two"]), "a is not a number but of type string"),
        (pa.array([1.0, float("nan")]), "row 2: a is not finite (nan)"),
    ],
)
def test_wrong_columns_of_parquet_are_named(tmp_path: Path, column: pa.Array, words: str) -> None:
    path = tmp_path / "x.parquet"
    pq.write_table(pa.table({"t": [0.0, 1.0], "a": column}), path)
    with pytest.raises(UsageError) as caught:
        ForeignSeries(path).read(["t", "a"])
    assert str(caught.value) == f"{path}: {words}"


def test_a_damaged_page_of_parquet_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "x.parquet"
    table = pa.table({"t": np.arange(1000.0), "a": np.sin(np.arange(1000.0))})
    pq.write_table(table, path, compression="none", use_dictionary=False, write_page_checksum=True)
    content = bytearray(path.read_bytes())
    content[3000] ^= 1
    path.write_bytes(content)
    with pytest.raises(UsageError, match="damaged Parquet file"):
        ForeignSeries(path).read(["t", "a"])


def test_a_missing_file_and_a_run_folder_are_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no such file"):
        ForeignSeries(tmp_path / "x.csv")
    with pytest.raises(UsageError, match="is a folder; give a CSV or Parquet file"):
        ForeignSeries(tmp_path)
    written(tmp_path, "t,a\n", "series.csv")
    with pytest.raises(UsageError, match=r"is a folder; did you mean .*series\.csv\?"):
        ForeignSeries(tmp_path)


def parquet_of(tmp_path: Path, columns: dict[str, Any]) -> ForeignSeries:
    path = tmp_path / "series.parquet"
    pq.write_table(pa.table(columns), path, compression="zstd")
    return ForeignSeries(path)


def test_too_many_rows_are_refused_before_they_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("topcli.store.foreign.MAX_ROWS", 10)
    monkeypatch.setattr(pq.ParquetFile, "read", lambda *arguments, **options: pytest.fail("the rows were read"))
    with pytest.raises(UsageError, match="more than 10 rows"):
        parquet_of(tmp_path, {"t": np.arange(11.0)}).read(["t"])


@pytest.mark.parametrize("columns", [{"t": [[0.0] * 50]}, {"t": ["x" * 50]}, {"t": [{"a": 1.0}]}, {"t": [None]}])
def test_columns_without_numbers_are_refused_before_they_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, columns: dict[str, Any]
) -> None:
    monkeypatch.setattr(pq.ParquetFile, "read", lambda *arguments, **options: pytest.fail("the rows were read"))
    with pytest.raises(UsageError, match="t is not a number but of type"):
        parquet_of(tmp_path, columns).read(["t"])


def test_the_ending_of_a_name_decompresses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The fast reader of Arrow decompresses by the ending unless that is switched off."""
    path = tmp_path / "a.csv.gz"
    path.write_text("t,x\n0,1\n1,2\n")
    monkeypatch.setattr(ForeignSeries, "_read_slowly", lambda *arguments: pytest.fail("the fast reader refused it"))
    assert ForeignSeries(path).read(["x"])["x"].tolist() == [1.0, 2.0]


@pytest.mark.parametrize("cell", ["2", "'2'"])  # the second one takes the slow reader
def test_text_is_read_up_to_the_limit_of_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cell: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t,x\n" + "0,1\n" * 20 + f"1,{cell}\n")
    monkeypatch.setattr("topcli.store.foreign.MAX_ROWS", 10)
    with pytest.raises(UsageError, match="more than 10 rows"):
        ForeignSeries(path).read(["x"])


def test_a_line_without_end_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t,x\n0,y\n" + "1" * 300)
    monkeypatch.setattr("topcli.store.foreign.MAX_LINE", 200)
    with pytest.raises(UsageError, match="line 3 has more than 200 characters"):
        list(ForeignSeries(path)._rows())
