"""Series on the disk: bit for bit in every format, cut anywhere, thinned to be drawn, and files of other programs."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from cases import table_of
from topcli.errors import RunError, UsageError
from topcli.store import series
from topcli.store.envelope import envelope, thinned
from topcli.store.foreign import ForeignSeries
from topcli.store.series import (
    SeriesWriter,
    read_metadata,
    read_series,
    series_length,
    series_pieces,
    write_parquet,
)

pytestmark = pytest.mark.usefixtures("small_chunks")


def bits(values: np.ndarray) -> Any:
    return values.tolist() if values.dtype.kind == "O" else values.view(np.int64).tolist()


VALUES = [0.0, -0.0, 0.1, -1e-308, 5e-324, 1.7976931348623157e308, np.inf, -np.inf, np.nan, 1 / 3, 2.0**53 + 2, -7.0]


@pytest.mark.parametrize("rows", [0, 1, 12, 5000])
def test_a_series_keeps_its_bits_in_every_format(tmp_path: Path, rows: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("topcli.store.series.ROW_GROUP", 700)
    data = {
        "n": np.arange(rows, dtype=np.int64) * 10**11,
        "x": np.resize(np.array(VALUES), rows) * np.float64(1.0),
        "y": np.random.default_rng(4).standard_normal(rows),
        "outcome": np.resize(np.array(["completed", "blew_up"], dtype=object), rows),
    }
    write_parquet(tmp_path / "0.parquet", data, {})
    for name in ("1.csv", "2.parquet"):
        with SeriesWriter(tmp_path / name, list(data), {"about": "it"}) as writer:
            for rows in series_pieces(tmp_path / "0.parquet"):
                writer.write(rows)
            writer.finish({"end": "now"})
    for name in ("0.parquet", "1.csv", "2.parquet"):
        found = read_series(tmp_path / name)
        assert list(found) == list(data)
        assert {key: bits(found[key]) for key in data} == {key: bits(data[key]) for key in data}
    found = pq.read_metadata(tmp_path / "2.parquet").metadata
    assert (found[b"about"], found[b"end"]) == (b"it", b"now")


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
@pytest.mark.parametrize("rows", [0, 1, 39, 40, 41, 400])
def test_series_cut_anywhere_resumes_to_the_same_file(tmp_path: Path, suffix: str, rows: int) -> None:
    data = {"n": np.arange(500), "x": np.random.default_rng(1).normal(size=500)}
    whole, cut = tmp_path / f"whole.{suffix}", tmp_path / f"cut.{suffix}"
    cuts = [*range(0, rows, 17), rows]

    def write(writer: SeriesWriter, begin: int, end: int) -> None:
        writer.write({name: values[begin:end] for name, values in data.items()})

    with SeriesWriter(whole, ["n", "x"], {"who": "test"}) as writer:
        for begin, end in zip(cuts, [*cuts[1:], 500], strict=True):
            write(writer, begin, end)
        writer.finish({"end": "yes"})
    with SeriesWriter(cut, ["n", "x"], {"who": "test"}) as writer:
        for begin, end in itertools.pairwise(cuts):
            write(writer, begin, end)
        mark = writer.mark()
        write(writer, rows, min(rows + 90, 500))
    with SeriesWriter(cut, ["n", "x"], {"who": "test"}, mark) as writer:
        write(writer, rows, 500)
        writer.finish({"end": "yes"})
    assert cut.read_bytes() == whole.read_bytes()
    assert all((read_series(cut)[name] == values).all() for name, values in data.items())
    if suffix == "parquet":
        assert pq.read_metadata(cut).metadata[b"end"] == b"yes"
        assert read_metadata(cut)["who"] == "test"


@pytest.mark.slow
def test_many_row_groups_keep_their_places(tmp_path: Path) -> None:
    """Offsets beyond one byte of a varint, and one row group read without the others."""
    path = tmp_path / "series.parquet"
    names = ["n", *(f"x{i}" for i in range(20))]
    data = {name: np.random.default_rng(i).normal(size=40) for i, name in enumerate(names)}
    data["n"] = np.arange(40)
    with SeriesWriter(path, names, {}) as writer:
        for _ in range(300):
            writer.write(data)
        writer.finish({})
    file = pq.ParquetFile(path)
    assert file.num_row_groups == 300
    for index in (0, 1, 150, 299):
        group = file.read_row_group(index)
        assert all((group.column(name).to_numpy() == data[name]).all() for name in names)
    assert pq.read_table(path).num_rows == 12_000


def test_few_rows_in_many_pieces_take_the_memory_of_their_numbers(tmp_path: Path) -> None:
    import tracemalloc

    with SeriesWriter(tmp_path / "series.parquet", ["n", "x"], {}) as writer:
        tracemalloc.start()
        for i in range(39):
            writer.write({"n": np.array([i]), "x": np.array([0.5])})
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 10_000


ROWS = 20_011
"""A prime number: the last stretch is shorter than the others."""


def columns(rows: int = ROWS) -> dict[str, np.ndarray]:
    random = np.random.default_rng(5)
    noise = random.normal(size=rows)
    noise[rows // 3] = 50.0
    noise[rows // 2] = -60.0
    return {"n": np.arange(rows), "t": np.arange(rows) * 0.1, "a": noise, "b": np.cumsum(noise)}


def stored(folder: Path, suffix: str, data: dict[str, np.ndarray]) -> Path:
    path = folder / f"series.{suffix}"
    with SeriesWriter(path, list(data), {}) as writer:
        for start in range(0, len(data["n"]), 1777):
            writer.write({name: values[start : start + 1777] for name, values in data.items()})
        writer.finish({})
    return path


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_extremes_of_every_stretch_are_kept(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(series, "ROW_GROUP", 4000)
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
    in_memory = thinned({name: data[name] for name in ("t", "a", "b")}, 100)
    for name, values in found.items():
        np.testing.assert_array_equal(in_memory[name], values)


@pytest.mark.parametrize("rows", [1, 2, 799, 800])
def test_a_short_series_is_kept_whole(tmp_path: Path, rows: int) -> None:
    """Up to eight rows in a stretch, as many as the extremes of three columns and the ends."""
    data = {name: values[:rows] for name, values in columns(2000).items()}
    found = envelope(stored(tmp_path, "parquet", data), ["t", "a", "b"], 100)
    np.testing.assert_array_equal(found["a"], data["a"])
    assert len(thinned({name: data[name] for name in ("t", "a", "b")}, 100)["a"]) == rows


def test_beyond_that_rows_are_left_out() -> None:
    data = columns(2000)
    assert len(thinned({name: data[name] for name in ("t", "a", "b")}, 100)["a"]) < 1000
    ends = thinned({"a": data["a"]}, 1)["a"][[0, -1]]
    assert ends.tolist() == data["a"][[0, -1]].tolist()


def test_missing_numbers_hide_no_extreme() -> None:
    data = columns()
    values = data["a"].copy()
    values[::2] = np.nan
    found = thinned({"t": data["t"], "a": values}, 50)["a"]
    assert np.nanmax(found) == np.nanmax(values)
    assert np.nanmin(found) == np.nanmin(values)


def test_a_damaged_series_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "series.parquet"
    path.write_bytes(b"PAR1")
    with pytest.raises(RunError, match=r"series\.parquet: cannot be read"):
        envelope(path, ["t"])
    with pytest.raises(RunError, match=r"none\.csv: cannot be read"):
        series_length(tmp_path / "none.csv")


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
    table_of(r"""
""                          is empty
" \n\n"                     is empty
b"t,a\n0,\0\n"              neither CSV nor Parquet (it holds binary data)
b"t,\xff\n0,1\n"            neither CSV nor Parquet (byte 0xff is not UTF-8 text)
b"PAR1 and no more"         damaged Parquet
"hello\nworld\n"            no column names separated by commas, semicolons or tabs
"0,1\n0.5,2\n"              first line holds numbers; expected the names of the columns
"t,a,t\n0,1,0\n"            two columns are called 't'
"t,a\n0,1\n0.5,two\n"       row 2: a is not a number: 'two'
"t,a\n0,1\n0.5,\n"          row 2: a is empty
"t,a\n0,1\n0.5\n"           row 2: has 1 columns; expected 2
"t,a\n0,1\n0.5,2,3\n"       row 2: has 3 columns; expected 2
"t,a\n0,1\n1,2\n0.5,nan\n"  row 3: a is not finite (nan)
"t,a\n0,1\n1,-inf\n"        row 2: a is not finite (-inf)
b"t,a\n0,1\n1,\xff\n"       is neither CSV nor Parquet (byte 0xff is not UTF-8 text)
"""),
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
