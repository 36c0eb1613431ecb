"""Time series of other programs: columns of a CSV or Parquet file, with row and column in every error.

Rows are counted from 1, without the header. The content decides how a file is read, not the ending of its name.
"""

from __future__ import annotations

import csv
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from topcli.errors import UsageError, quoted, shortened
from topcli.store.series import open_parquet

_PARQUET = b"PAR1"
_SEPARATORS = (",", ";", "\t")
_HEADER_BYTES = 1 << 20
MAX_ROWS = 2_000_000
MAX_LINE = 1 << 20
"""Characters of a line of CSV, beyond which the file is not a table of numbers."""
MAX_COLUMN = 64 * MAX_ROWS
"""Bytes of a decompressed Parquet column; numbers take 8 for each row, the rest is left for their encoding."""


class ForeignSeries:
    """A CSV or Parquet file with the ``names`` of its columns; ``read`` returns some of them.

    CSV is UTF-8 text with a header; commas, semicolons or tabs separate the columns. Raises UsageError for a file that
    is neither.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            if os.path.isdir(path):
                own = next((name for name in ("series.parquet", "series.csv") if (path / name).is_file()), "")
                hint = f"; did you mean {path / own}?" if own else "; give a CSV or Parquet file"
                raise UsageError(f"{path}: is a folder{hint}")
            if os.path.exists(path) and not os.path.isfile(path):
                raise UsageError(f"{path}: is not a regular file; give a CSV or Parquet file")
            with path.open("rb") as file:
                head = file.read(_HEADER_BYTES)
        except FileNotFoundError:
            raise UsageError(f"{path}: no such file") from None
        except (OSError, ValueError) as error:
            raise UsageError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
        if not head.strip():
            raise UsageError(f"{path}: is empty; expected a CSV or Parquet file with the columns of a series")
        self._separator = ""
        self.names = self._parquet_names() if head.startswith(_PARQUET) else self._csv_names(head)
        repeated = sorted({name for name in self.names if self.names.count(name) > 1})
        if repeated:
            raise UsageError(f"{path}: two columns are called {quoted(repeated[0])}")

    def _neither(self, reason: str) -> UsageError:
        return UsageError(f"{self.path}: is neither CSV nor Parquet ({shortened(reason)})")

    def _parquet_names(self) -> list[str]:
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            return list(pq.read_schema(self.path).names)
        except (OSError, pa.ArrowException) as error:
            raise UsageError(f"{self.path}: is a damaged Parquet file ({_first_line(error)})") from None

    def _csv_names(self, head: bytes) -> list[str]:
        if b"\0" in head:
            raise self._neither("it holds binary data")
        try:
            line = head.splitlines()[0].decode("utf-8-sig")
        except UnicodeDecodeError as error:
            raise self._neither(f"byte 0x{error.object[error.start]:02x} is not UTF-8 text") from None
        self._separator = max(_SEPARATORS, key=line.count)
        try:
            names = [name.strip() for name in next(self._cells([line]), [])]
        except csv.Error as error:
            raise self._neither(str(error)) from None
        if names and names[0].startswith("#"):  # as numpy.savetxt writes it
            names[0] = names[0].lstrip("#").strip()
        if len(names) < 2:
            separators = "commas, semicolons or tabs"
            raise UsageError(f"{self.path}: its first line has no column names separated by {separators}")
        if all(_number(name) is not None for name in names):
            raise UsageError(f"{self.path}: its first line holds numbers; expected the names of the columns")
        return names

    def _cells(self, lines: Iterable[str]) -> Iterator[list[str]]:
        """Cells of each of the lines of a CSV file."""
        return csv.reader(lines, delimiter=self._separator, skipinitialspace=True)

    def read(self, names: Sequence[str]) -> dict[str, np.ndarray]:
        """Columns ``names`` as float64, each (m,). Raises UsageError for values that are not finite numbers."""
        columns = self._read_csv(names) if self._separator else self._read_parquet(names)
        for name, values in columns.items():
            if not np.isfinite(values).all():
                at = int(np.argmin(np.isfinite(values)))
                raise UsageError(f"{self.path}: row {at + 1}: {name} is not finite ({values[at]})")
        return columns

    def _read_parquet(self, names: Sequence[str]) -> dict[str, np.ndarray]:
        import pyarrow as pa

        try:
            with open_parquet(self.path) as file:
                self._check_parquet(file, names)
                table = file.read(columns=list(names), use_threads=False)
        except (OSError, ValueError, pa.ArrowException) as error:
            raise UsageError(f"{self.path}: is a damaged Parquet file ({_first_line(error)})") from None
        columns = {}
        for name in names:
            column = table.column(name)
            if column.null_count:
                at = int(np.argmax(column.is_null().to_numpy()))
                raise UsageError(f"{self.path}: row {at + 1}: {name} is empty")
            columns[name] = column.to_numpy().astype(np.float64)
        return columns

    def _check_parquet(self, file: Any, names: Sequence[str]) -> None:
        """Raise UsageError for columns that hold no numbers or too many, before any of them is decompressed."""
        import pyarrow as pa

        about = file.metadata
        self._check_count(about.num_rows)
        for name in names:
            kind = file.schema_arrow.field(name).type
            if not (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
                raise UsageError(f"{self.path}: {name} is not a number but of type {shortened(str(kind))}")
        sizes: Counter[str] = Counter()
        for group in range(about.num_row_groups):
            for place in range(about.num_columns):
                column = about.row_group(group).column(place)
                sizes[column.path_in_schema] += column.total_uncompressed_size
        if large := [name for name in names if sizes[name] > MAX_COLUMN]:
            raise UsageError(f"{self.path}: {large[0]} has {sizes[large[0]]} bytes, too many for a column of numbers")

    def _check_count(self, rows: int) -> None:
        """Raise UsageError for more rows than fit in memory."""
        if rows > MAX_ROWS:
            raise UsageError(f"{self.path}: more than {MAX_ROWS} rows, which do not fit in memory; write fewer")

    def _read_csv(self, names: Sequence[str]) -> dict[str, np.ndarray]:
        import pyarrow as pa
        import pyarrow.csv as arrow

        try:
            with (
                pa.input_stream(self.path, compression=None) as source,  # by default the ending of the name decides
                arrow.open_csv(
                    source,
                    arrow.ReadOptions(column_names=self.names, skip_rows=1),
                    arrow.ParseOptions(delimiter=self._separator),
                    arrow.ConvertOptions(
                        column_types=dict.fromkeys(names, pa.float64()), include_columns=list(names), null_values=[]
                    ),
                ) as reader,
            ):
                pieces, rows = [], 0
                for piece in reader:
                    rows += piece.num_rows
                    self._check_count(rows)
                    pieces.append(piece)
        except (OSError, pa.ArrowException):
            return self._read_slowly(names)
        table = pa.Table.from_batches(pieces, reader.schema)
        return {name: table.column(name).to_numpy() for name in names}

    def _read_slowly(self, names: Sequence[str]) -> dict[str, np.ndarray]:
        """Read a CSV file that the fast reader refuses; raises UsageError with the row at fault."""
        places = {name: self.names.index(name) for name in names}
        columns: dict[str, list[float]] = {name: [] for name in names}
        for row, cells in enumerate(self._rows(), 1):
            self._check_count(row)
            if len(cells) != len(self.names):
                raise UsageError(f"{self.path}: row {row}: has {len(cells)} columns; expected {len(self.names)}")
            for name, place in places.items():
                value = _number(cells[place])
                if value is None:
                    wrong = f"is not a number: {quoted(cells[place])}" if cells[place].strip() else "is empty"
                    raise UsageError(f"{self.path}: row {row}: {name} {wrong}")
                columns[name].append(value)
        return {name: np.array(values) for name, values in columns.items()}

    def _rows(self) -> Iterator[list[str]]:
        """Rows of a CSV file without the header and without empty lines."""
        try:
            with self.path.open(encoding="utf-8-sig", newline="") as file:
                reader = self._cells(self._lines(file))
                next(reader, None)
                yield from (cells for cells in reader if cells)
        except UnicodeDecodeError as error:
            raise self._neither(f"byte 0x{error.object[error.start]:02x} is not UTF-8 text") from None
        except (OSError, csv.Error) as error:
            raise UsageError(f"{self.path}: cannot be read ({_first_line(error)})") from None

    def _lines(self, file: TextIO) -> Iterator[str]:
        """Lines of an open CSV file. Raises UsageError for one that is too long."""
        number = 0
        while line := file.readline(MAX_LINE):
            number += 1
            if len(line) == MAX_LINE:
                raise self._neither(f"line {number} has more than {MAX_LINE} characters")
            yield line


def _number(text: str) -> float | None:
    """``text`` as a float, nan and inf included; None if it is not a number."""
    try:
        return None if "_" in text else float(text)
    except ValueError:
        return None


def _first_line(error: Any) -> str:
    return shortened(str(error).split("\n", maxsplit=1)[0])
