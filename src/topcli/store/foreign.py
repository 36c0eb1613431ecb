"""Time series of other programs: columns of a CSV or Parquet file.

Rows are counted from 1, without the header. The content decides how a file is read, not the ending of its name.
"""

from __future__ import annotations

import contextlib
import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from topcli.errors import UsageError, quoted, shortened
from topcli.store.series import open_parquet

MAX_ROWS = 2_000_000


class ForeignSeries:
    """A CSV or Parquet file with the ``names`` of its columns; ``read`` returns some of them.

    CSV is UTF-8 text with a header; commas, semicolons or tabs separate the columns. Raises UsageError for a file that
    is neither.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            if path.is_dir():
                own = next((name for name in ("series.parquet", "series.csv") if (path / name).is_file()), "")
                hint = f"; did you mean {path / own}?" if own else "; give a CSV or Parquet file"
                raise UsageError(f"{path}: is a folder{hint}")
            with path.open("rb") as file:
                line = file.readline(1 << 16)
        except (OSError, ValueError) as error:
            raise UsageError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
        self._separator = "" if line.startswith(b"PAR1") else max(",;\t", key=line.decode("latin-1").count)
        self.names = self._header(line) if self._separator else self._table(None).schema.names
        if repeated := next((name for name in self.names if self.names.count(name) > 1), None):
            raise UsageError(f"{path}: two columns are called {quoted(repeated)}")

    def read(self, names: Sequence[str]) -> dict[str, np.ndarray]:
        """Columns ``names`` as float64, each (m,). Raises UsageError for values that are not finite numbers."""
        table = self._table(names)
        if len(table) > MAX_ROWS:
            raise UsageError(f"{self.path}: more than {MAX_ROWS} rows, which do not fit in memory; write fewer")
        columns = {}
        for name in names:
            values = columns[name] = _numbers(table.column(name))
            if not np.isfinite(values).all():
                row = int(np.argmin(np.isfinite(values)))
                cell = quoted(str(table.column(name)[row]))
                raise UsageError(f"{self.path}: row {row + 1}: {name} is not a finite number: {cell}")
        return columns

    def _header(self, line: bytes) -> list[str]:
        """Names of the columns of a CSV file in its first line."""
        try:
            cells = next(csv.reader([line.decode("utf-8-sig")], delimiter=self._separator, skipinitialspace=True), [])
        except (UnicodeDecodeError, csv.Error) as error:
            raise self._unreadable(error) from None
        names = [name.strip() for name in cells]
        if names and names[0].startswith("#"):  # as numpy.savetxt writes it
            names[0] = names[0].lstrip("#").strip()
        if len(names) < 2 or not any(np.isnan(_number(name)) for name in names):
            separators = "commas, semicolons or tabs"
            raise UsageError(f"{self.path}: its first line holds no names of columns separated by {separators}")
        return names

    def _table(self, names: Sequence[str] | None) -> Any:
        """Columns ``names`` as an Arrow table, those of a CSV file as text; with None, no rows of a Parquet file."""
        import pyarrow as pa
        import pyarrow.csv as arrow

        try:
            if not self._separator:
                with open_parquet(self.path) as file:
                    return file.schema_arrow.empty_table() if names is None else file.read(columns=list(names))
            with pa.input_stream(self.path, compression=None) as source:  # by default the ending of the name decides
                return arrow.read_csv(
                    source,
                    arrow.ReadOptions(column_names=self.names, skip_rows=1, use_threads=False),
                    arrow.ParseOptions(delimiter=self._separator),
                    arrow.ConvertOptions(column_types=dict.fromkeys(self.names, pa.string()), include_columns=names),
                )
        except (OSError, ValueError, pa.ArrowException) as error:
            raise self._unreadable(error) from None

    def _unreadable(self, error: Exception) -> UsageError:
        reason = shortened(str(error).split("\n", maxsplit=1)[0])
        return UsageError(f"{self.path}: cannot be read as {'CSV' if self._separator else 'Parquet'} ({reason})")


def _numbers(column: Any) -> np.ndarray:
    """Values of an Arrow column, those that are not numbers as nan."""
    import pyarrow as pa

    if not pa.types.is_boolean(column.type):
        with contextlib.suppress(pa.ArrowException):  # of other forms, such as +2, and other types
            return column.cast(pa.float64()).to_numpy()
    return np.array([_number(cell) for cell in column.to_pylist()])


def _number(cell: object) -> float:
    """Value of a cell; nan if it is not a number."""
    try:
        return float("nan") if isinstance(cell, bool) or "_" in str(cell) else float(str(cell))
    except ValueError:
        return float("nan")
