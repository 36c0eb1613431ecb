"""Tables: columns over the rows of plain data, for terminals, pages, Markdown and DataFrames.

A report declares its figures once, as columns, and every rendering follows::

    DRIFTS = Table(
        "invariants",
        (
            Column("invariant", "symbol"),
            Column("drift", "drift", number),
            Column("± standard error", "drift_error", two_digits),
        ),
        heading="Drifts",
        index="symbol",
    )
    DRIFTS.cells(report).lines   # texts, as the terminal and a page show them
    DRIFTS.frame(report)         # a DataFrame with all digits
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    import pandas as pd

DASH = "–"
"""Text of a missing value."""
EVERY = range(10**6)
"""Indices of all columns."""


def number(value: float | None, digits: int = 3) -> str:
    """Number for a table: short, with an exponent if it is very large or small; a dash for None."""
    if value is None:
        return DASH
    if value == 0.0:
        return "0"
    if not math.isfinite(value):
        return str(value)
    return f"{value:.{digits}g}" if 1e-3 <= abs(value) < 1e5 else f"{value:.{max(digits - 2, 1)}e}"


def two_digits(value: float | None) -> str:
    """Number with two digits."""
    return number(value, 2)


def ten_digits(value: float | None) -> str:
    """Number to ten digits, which show how an invariant moves; a dash for None."""
    return DASH if value is None else f"{value:.10g}"


def at(data: Any, path: str) -> Any:
    """Value at a dotted ``path`` in nested mappings and lists; None below a None."""
    for key in path.split("."):
        if data is not None:
            data = data[int(key)] if isinstance(data, list) else data[key]
    return data


@dataclass(frozen=True)
class Cells:
    """Texts of a table under a header, as pages and terminals show them.

    The first ``keys`` columns name a row. ``numbers`` is True if the others are right-aligned, or the indices of those
    that are. ``marks`` are the classes of cells with certain texts on a page.
    """

    kind: ClassVar[str] = "table"
    title: str
    header: Sequence[str]
    lines: Sequence[Sequence[str]]
    caption: str = ""
    keys: int = 1
    numbers: bool | Sequence[int] = True
    marks: Mapping[str, str] = field(default_factory=dict)

    def markdown(self) -> list[str]:
        """Lines of a Markdown table."""
        return markdown_table([self.header, *self.lines])


def markdown_table(lines: Sequence[Sequence[str]]) -> list[str]:
    """Markdown table of lines of cells; the first line is the header."""
    ruled = ["| " + " | ".join(line) + " |" for line in lines]
    return [ruled[0], "|" + " --- |" * len(lines[0]), *ruled[1:]]


@dataclass(frozen=True)
class Column:
    """One figure of each row.

    Attributes
    ----------
    head : str
        Heading in texts, blank for none; an empty one keeps the column out of them.
    of : str or callable
        Dotted path into a row, or a function of the row. A value of None is shown as a dash.
    show : callable
        Text of a value.
    key : str or None
        Name in DataFrames; by default the path, and none for a function. An empty one keeps the column out of them.
    """

    head: str
    of: str | Callable[[Any], Any]
    show: Callable[[Any], str] = str
    key: str | None = None

    @property
    def name(self) -> str:
        """Name of the column in DataFrames; empty if it is in none."""
        if self.key is not None:
            return self.key
        return self.of if isinstance(self.of, str) else ""

    def value(self, row: Any) -> Any:
        """Figure of a row, with all digits."""
        return at(row, self.of) if isinstance(self.of, str) else self.of(row)

    def text(self, row: Any) -> str:
        """Figure of a row, as tables show it."""
        value = self.value(row)
        return DASH if value is None else self.show(value)


@dataclass(frozen=True)
class Table:
    """Columns over the rows of some data.

    Attributes
    ----------
    rows : str or callable
        Dotted path to the rows, or a function of the data.
    columns : sequence of Column, or callable
        The columns, or a function of the data that returns them.
    name : str
        Attribute of the Python result that has the DataFrame.
    heading : str
        Title on a page.
    title, caption : str or callable
        Lines above the table on a terminal, and below it everywhere.
    index : str
        Column that is the index of the DataFrame.
    across : Column, optional
        Column that is the header if each row of the data is a column of the text, and each column a line.
    ruled : bool
        False to leave out the header.
    keys, numbers, marks
        As in ``Cells``.
    """

    rows: str | Callable[[Any], Sequence[Any]]
    columns: Sequence[Column] | Callable[[Any], Sequence[Column]]
    name: str = "table"
    heading: str = ""
    title: str | Callable[[Any], str] = ""
    caption: str | Callable[[Any], str] = ""
    index: str = ""
    across: Column | None = None
    ruled: bool = True
    keys: int = 1
    numbers: bool | Sequence[int] = True
    marks: Mapping[str, str] = field(default_factory=dict)

    def content(self, data: Any) -> tuple[Sequence[Any], Sequence[Column]]:
        """Rows and columns of the table of ``data``."""
        rows = at(data, self.rows) if isinstance(self.rows, str) else self.rows(data)
        return rows, self.columns(data) if callable(self.columns) else self.columns

    def cells(self, data: Any) -> Cells:
        """Texts of the table of ``data``."""
        rows, columns = self.content(data)
        shown = [column for column in columns if column.head]
        if self.across is None:
            header = ["" if column.head.isspace() else column.head for column in shown]
            lines = [[column.text(row) for column in shown] for row in rows]
        else:
            header = [self.across.head, *map(self.across.text, rows)]
            lines = [[column.head, *map(column.text, rows)] for column in shown]
        caption = self.caption(data) if callable(self.caption) else self.caption
        header = header if self.ruled else []
        return Cells(self.heading, header, lines, caption, self.keys, self.numbers, self.marks)

    def title_of(self, data: Any) -> str:
        """Line above the table on a terminal."""
        return self.title(data) if callable(self.title) else self.title

    def frame(self, data: Any) -> pd.DataFrame:
        """DataFrame of the table of ``data``, with all digits."""
        import pandas as pd

        rows, columns = self.content(data)
        kept = [column for column in (*([self.across] if self.across else []), *columns) if column.name]
        values = [[column.value(row) for column in kept] for row in rows]
        frame = pd.DataFrame(values, columns=[column.name for column in kept])
        return frame.set_index(self.index) if self.index else frame
