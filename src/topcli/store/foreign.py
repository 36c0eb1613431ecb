"""Series of other programs: columns of numbers from a CSV or Parquet file, with messages that name row and column.

Rows are counted from 1, without the header. The content decides how a file is read, not the ending of its name.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from topcli.errors import UsageError, quoted, shortened

_PARQUET = b"PAR1"
_SEPARATORS = (",", ";", "\t")
_HEADER_BYTES = 1 << 20


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
        found = self._read_csv(names) if self._separator else self._read_parquet(names)
        for name, values in found.items():
            if not np.isfinite(values).all():
                at = int(np.argmin(np.isfinite(values)))
                raise UsageError(f"{self.path}: row {at + 1}: {name} is not finite ({values[at]})")
        return found

    def _read_parquet(self, names: Sequence[str]) -> dict[str, np.ndarray]:
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            table = pq.read_table(self.path, columns=list(names), page_checksum_verification=True)
        except (OSError, pa.ArrowException) as error:
            raise UsageError(f"{self.path}: is a damaged Parquet file ({_first_line(error)})") from None
        found = {}
        for name in names:
            column = table.column(name)
            if not (pa.types.is_integer(column.type) or pa.types.is_floating(column.type)):
                first = f": {quoted(str(column[0].as_py()))}" if len(column) else ""
                raise UsageError(f"{self.path}: row 1: {name} is not a number but of type {column.type}{first}")
            if column.null_count:
                at = int(np.argmax(column.is_null().to_numpy()))
                raise UsageError(f"{self.path}: row {at + 1}: {name} is empty")
            found[name] = column.to_numpy().astype(np.float64)
        return found

    def _read_csv(self, names: Sequence[str]) -> dict[str, np.ndarray]:
        import pyarrow as pa
        import pyarrow.csv as arrow

        try:
            table = arrow.read_csv(
                self.path,
                arrow.ReadOptions(column_names=self.names, skip_rows=1),
                arrow.ParseOptions(delimiter=self._separator),
                arrow.ConvertOptions(
                    column_types=dict.fromkeys(names, pa.float64()), include_columns=list(names), null_values=[]
                ),
            )
        except (OSError, pa.ArrowException):
            return self._read_slowly(names)
        return {name: table.column(name).to_numpy() for name in names}

    def _read_slowly(self, names: Sequence[str]) -> dict[str, np.ndarray]:
        """Read a CSV file that the fast reader refuses; raises UsageError with the row at fault."""
        places = {name: self.names.index(name) for name in names}
        found: dict[str, list[float]] = {name: [] for name in names}
        for row, cells in enumerate(self._rows(), 1):
            if len(cells) != len(self.names):
                raise UsageError(f"{self.path}: row {row}: has {len(cells)} columns; expected {len(self.names)}")
            for name, place in places.items():
                value = _number(cells[place])
                if value is None:
                    wrong = f"is not a number: {quoted(cells[place])}" if cells[place].strip() else "is empty"
                    raise UsageError(f"{self.path}: row {row}: {name} {wrong}")
                found[name].append(value)
        return {name: np.array(values) for name, values in found.items()}

    def _rows(self) -> Iterator[list[str]]:
        """Rows of a CSV file without the header and without empty lines."""
        try:
            with self.path.open(encoding="utf-8-sig", newline="") as file:
                reader = self._cells(file)
                next(reader, None)
                yield from (cells for cells in reader if cells)
        except UnicodeDecodeError as error:
            raise self._neither(f"byte 0x{error.object[error.start]:02x} is not UTF-8 text") from None
        except (OSError, csv.Error) as error:
            raise UsageError(f"{self.path}: cannot be read ({_first_line(error)})") from None


def _number(text: str) -> float | None:
    """``text`` as a float, nan and inf included; None if it is not a number."""
    try:
        return None if "_" in text else float(text)
    except ValueError:
        return None


def _first_line(error: Any) -> str:
    return shortened(str(error).split("\n", maxsplit=1)[0])
