"""Series of other programs: every usual form is read, and whatever is not a table of finite numbers is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from cases import table_of
from topcli.errors import UsageError
from topcli.store.foreign import ForeignSeries


def written(folder: Path, content: str | bytes | pa.Table, name: str = "x.csv") -> Path:
    path = folder / name
    if isinstance(content, pa.Table):
        pq.write_table(content, path, compression="none", use_dictionary=False, write_page_checksum=True)
    else:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize(
    "content",
    [
        "t,a\n0,1\n0.5,2\n",
        "\ufefft,a\r\n0,1\r\n0.5,2\r\n",
        "# t;a\n0;1\n0.5;2\n",
        "t\ta\n0.0\t1e0\n\n5e-1\t2\n",
        't , "a"\n0, 1\n0.5, +2\n',
        "b,t,a\nword,0,1\n,0.5,2\n",
        pa.table({"a": pa.array([1.0, 2.0], pa.float32()), "t": [0.0, 0.5], "w": ["x", "y"]}),
    ],
)
def test_tables_are_read_however_they_are_written(tmp_path: Path, content: str | pa.Table) -> None:
    """Also under a name that would have the file decompressed."""
    found = ForeignSeries(written(tmp_path, content, "x.csv.gz")).read(["t", "a"])
    assert {name: values.tolist() for name, values in found.items()} == {"t": [0.0, 0.5], "a": [1.0, 2.0]}
    assert all(values.dtype == np.float64 for values in found.values())


def test_numbers_keep_all_their_bits(tmp_path: Path) -> None:
    random = np.random.default_rng(3)
    values = random.standard_normal(1000) * 10.0 ** random.integers(-300, 300, 1000)
    text = "t,a\n" + "".join(f"{n}.,{value!r}\n" for n, value in enumerate(values.tolist()))
    np.testing.assert_array_equal(ForeignSeries(written(tmp_path, text)).read(["a"])["a"], values)


FAULTS = table_of(r"""
""                          first line holds no names of columns separated by commas, semicolons or tabs
b"t,a\n0,\0\n"              row 1: a is not a finite number
b"t,\xff\n0,1\n"            cannot be read as CSV ('utf-8' codec
b"t,a\n0,1\n1,\xff\n"       cannot be read as CSV
b"PAR1 and no more"         cannot be read as Parquet
"hello\nworld\n"            first line holds no names of columns
"0,1\n0.5,2\n"              first line holds no names of columns
"t,a,t\n0,1,0\n"            two columns are called 't'
"t,a\n0,1\n0.5,two\n"       row 2: a is not a finite number: 'two'
"t,a\n0,1\n0.5,\n"          row 2: a is not a finite number: ''
"t,a\n0,1\n0.5\n"           Row #3: Expected 2 columns, got 1
"t,a\n0,1\n0.5,2,3\n"       Row #3: Expected 2 columns, got 3
"t,a\n0,1,5\n0.5,2,3\n"     Row #2: Expected 2 columns, got 3
"t,a\n0,True\n"             row 1: a is not a finite number: 'True'
"t,a\n0,1_000\n"            row 1: a is not a finite number: '1_000'
"t,a\n0,1\n1,2\n0.5,nan\n"  row 3: a is not a finite number: 'nan'
"t,a\n0,1\n1,-inf\n"        row 2: a is not a finite number: '-inf'
""")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        *FAULTS,
        (pa.table({"t": [0, 1], "a": [1.0, None]}), "row 2: a is not a finite number: 'None'"),
        (pa.table({"t": [0, 1], "a": ["1", "two"]}), "row 2: a is not a finite number: 'two'"),
        (pa.table({"t": [0, 1], "a": [True, False]}), "row 1: a is not a finite number: 'True'"),
        (pa.table({"t": [0, 1], "a": [[1.0], [2.0]]}), "row 1: a is not a finite number: '[1.0]'"),
    ],
)
def test_wrong_content_is_named(tmp_path: Path, content: str | bytes | pa.Table, words: str) -> None:
    path = written(tmp_path, content)
    with pytest.raises(UsageError) as caught:
        ForeignSeries(path).read(["t", "a"])
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert words in message
    assert "\n" not in message


def test_a_damaged_page_of_parquet_is_reported(tmp_path: Path) -> None:
    path = written(tmp_path, pa.table({"t": np.arange(1000.0), "a": np.sin(np.arange(1000.0))}))
    content = bytearray(path.read_bytes())
    content[3000] ^= 1
    path.write_bytes(content)
    with pytest.raises(UsageError, match=r"cannot be read as Parquet .*page"):
        ForeignSeries(path).read(["t", "a"])


def test_a_missing_file_and_a_run_folder_are_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="No such file"):
        ForeignSeries(tmp_path / "x.csv")
    with pytest.raises(UsageError, match="is a folder; give a CSV or Parquet file"):
        ForeignSeries(tmp_path)
    written(tmp_path, "t,a\n", "series.csv")
    with pytest.raises(UsageError, match=r"is a folder; did you mean .*series\.csv\?"):
        ForeignSeries(tmp_path)


@pytest.mark.parametrize("content", ["t,a\n" + "0,1\n" * 11, pa.table({"t": np.arange(11.0), "a": np.arange(11.0)})])
def test_too_many_rows_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: str | pa.Table) -> None:
    file = ForeignSeries(written(tmp_path, content))
    monkeypatch.setattr("topcli.store.foreign.MAX_ROWS", 11)
    assert len(file.read(["a"])["a"]) == 11
    monkeypatch.setattr("topcli.store.foreign.MAX_ROWS", 10)
    with pytest.raises(UsageError, match="more than 10 rows"):
        file.read(["a"])
