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
import re
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    import pandas as pd

DASH = "–"
"""Text of a missing value."""
EVERY = range(10**6)
"""Indices of all columns."""


def significant(value: float, digits: int) -> str:
    """Number with this many significant digits, with an exponent if it is very large or small; 1234 stays whole."""
    if not math.isfinite(value) or value == 0.0:
        return f"{value:g}"
    text = f"{value:.{digits - 1}e}"  # rounds first: 0.0009996 has the exponent of 0.001
    exponent = int(text.partition("e")[2])
    if not -3 <= exponent < 5:
        return text
    return f"{value:.{max(0, digits - 1 - exponent)}f}"


def short(text: str) -> str:
    """Text of a number without zeros at the end of its decimals, unless it has an exponent."""
    return text.rstrip("0").rstrip(".") if "." in text and "e" not in text else text


def number(value: float | None, digits: int = 3) -> str:
    """Number with this many significant digits, the same in terminals, tables and pages; a dash for None."""
    return DASH if value is None else short(significant(value, digits))


def two_digits(value: float | None) -> str:
    """Number with two digits."""
    return number(value, 2)


def error_places(value: float, error: float) -> tuple[int, int]:
    """Exponents of the second digit of a positive error, and of the leading digit of the larger of value and error."""
    place = int(f"{error:.1e}".partition("e")[2]) - 1
    return place, max(int(f"{value:.3e}".partition("e")[2]), place + 1) if value else place + 1


def plus_minus(value: float, error: float) -> str:
    """Number with its error, both to the second digit of the error: 0.123 ± 0.031, (-8.5 ± 2.2)e-05."""
    if not (math.isfinite(value) and math.isfinite(error) and error > 0.0):
        return number(value)
    place, scale = error_places(value, error)
    if -3 <= scale < 5:
        decimals = max(0, -place)
        return f"{value:.{decimals}f} ± {error:.{decimals}f}"
    unit, decimals = 10.0**scale, scale - place
    return f"({value / unit:.{decimals}f} ± {error / unit:.{decimals}f})e{scale:+03d}"


def rounded_up(value: float) -> float:
    """Next number with two digits that is not smaller than a positive ``value``; 0 and infinity as they are."""
    if not 0.0 < value < math.inf:
        return value
    unit = max(10.0 ** (math.floor(math.log10(value)) - 1), 5e-324)
    return math.ceil(value / unit) * unit


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
        return markdown_table([self.header or [""] * len(self.lines[0]), *self.lines])

    def latex(self, title: str = "") -> list[str]:
        """Lines of a LaTeX table, with ``title`` before the caption."""
        count = len(self.header or self.lines[0])
        right = range(1, count) if self.numbers is True else self.numbers or ()
        aligned = "".join("r" if i in right else "l" for i in range(count))
        said = [escaped(f"{text.rstrip('.')}.") for text in (title, self.caption) if text]
        body = [[latex_text(cell) for cell in line] for line in self.lines]
        return latex_table(list(map(escaped, self.header)), body, aligned, " ".join(said))


def markdown_table(lines: Sequence[Sequence[str]]) -> list[str]:
    """Markdown table of lines of cells; the first line is the header."""
    ruled = ["| " + " | ".join(line) + " |" for line in lines]
    return [ruled[0], "|" + " --- |" * len(lines[0]), *ruled[1:]]


_SPECIAL = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    **{letter: f"\\{letter}" for letter in "&%$#_{}"},
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    "–": "--",
    "±": r"$\pm$",
    "−": "$-$",
    "·": r"$\cdot$",
    "×": r"$\times$",
    "≤": r"$\leq$",
    "≥": r"$\geq$",
    "ε": r"$\varepsilon$",
    "µ": r"$\mu$",
}
_FORMS = {"<super>": "$^{%s}$", "<sub>": "$_{%s}$"}
"""Raised and lowered characters in LaTeX, by their form in Unicode."""
_NUMBER = re.compile(r"(?<![\w.])(-?\d+(?:\.\d+)?(?:e[+-]?\d+)?)(?![\w.])")


def escaped(text: str) -> str:
    """Text with the special characters of LaTeX escaped; Greek letters, raised and lowered digits in mathematics."""
    return "".join(map(_letter, text)).replace("$$", "").replace("}_{", "").replace("}^{", "")


def _letter(letter: str) -> str:
    """Character in LaTeX."""
    if letter in _SPECIAL or letter.isascii():
        return _SPECIAL.get(letter, letter)
    if greek := re.fullmatch(r"GREEK (SMALL|CAPITAL) LETTER (\w+)", unicodedata.name(letter, "")):
        return f"$\\{greek[2].lower() if greek[1] == 'SMALL' else greek[2].capitalize()}$"
    form, _, code = unicodedata.decomposition(letter).partition(" ")
    return _FORMS[form] % chr(int(code, 16)) if form in _FORMS else letter


def is_number(text: str) -> bool:
    """True if a text is a finite number."""
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def latex_number(number: str) -> str:
    """Number of a table in LaTeX's mathematics: 1.2e-05 becomes 1.2 times a power of ten."""
    parts = re.fullmatch(r"(-?[0-9.]+)(?:e([+-]?\d+))?", number)
    if parts is None:
        return {"inf": r"\infty", "-inf": r"-\infty"}.get(number, rf"\mathrm{{{number}}}")
    return parts[1] + (rf" \times 10^{{{int(parts[2])}}}" if parts[2] else "")


def latex_text(text: str) -> str:
    """Text in LaTeX, the numbers in it in mathematics."""
    parts = _NUMBER.split(text)
    return "".join(f"${latex_number(part)}$" if i % 2 else escaped(part) for i, part in enumerate(parts))


def latex_table(
    header: Sequence[str], body: Sequence[Sequence[str]], aligned: str, caption: str, above: Sequence[str] = ()
) -> list[str]:
    """Lines of a LaTeX table for the package booktabs, of cells in LaTeX; ``above`` are lines above the header."""
    head = [" & ".join(header) + r" \\", r"\midrule"] if header else []
    return [
        r"% needs \usepackage{booktabs}",
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{caption}}}",
        rf"\begin{{tabular}}{{{aligned}}}",
        r"\toprule",
        *above,
        *head,
        *(" & ".join(line) + r" \\" for line in body),
        r"\bottomrule",
        r"\end{tabular}",
        r"\end{table}",
    ]


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
    detail : bool
        True for a column that a terminal shows only with ``--verbose``; pages and files always have it.
    """

    head: str
    of: str | Callable[[Any], Any]
    show: Callable[[Any], str] = str
    key: str | None = None
    detail: bool = False

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
    detail : bool
        True for a table that a terminal shows only with ``--verbose``.
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
    detail: bool = False
    keys: int = 1
    numbers: bool | Sequence[int] = True
    marks: Mapping[str, str] = field(default_factory=dict)

    def content(self, data: Any) -> tuple[Sequence[Any], Sequence[Column]]:
        """Rows and columns of the table of ``data``."""
        rows = at(data, self.rows) if isinstance(self.rows, str) else self.rows(data)
        return rows, self.columns(data) if callable(self.columns) else self.columns

    def cells(self, data: Any, detail: bool = True) -> Cells:
        """Texts of the table of ``data``, with or without the columns that are details."""
        rows, columns = self.content(data)
        headed = [column for column in columns if column.head]
        places = [i for i, column in enumerate(headed) if detail or not column.detail]
        shown = [headed[i] for i in places]
        if self.across is None:
            header = ["" if column.head.isspace() else column.head for column in shown]
            lines = [[column.text(row) for column in shown] for row in rows]
        else:
            header = [self.across.head, *map(self.across.text, rows)]
            lines = [[column.head, *map(column.text, rows)] for column in shown]
        caption = self.caption(data) if callable(self.caption) else self.caption
        header = header if self.ruled else []
        numbers = self.numbers
        if self.across is None and not isinstance(numbers, bool):
            numbers = [i for i, place in enumerate(places) if place in numbers]
        return Cells(self.heading, header, lines, caption, self.keys, numbers, self.marks)

    def title_of(self, data: Any) -> str:
        """Line above the table on a terminal."""
        return self.title(data) if callable(self.title) else self.title

    def text(self, data: Any, form: str) -> str:
        """Table of ``data`` with all columns in a format: "csv" with all digits, "markdown" or "latex"."""
        if form == "csv":
            return str(self.frame(data).to_csv(index=bool(self.index), lineterminator="\n"))
        cells, title = self.cells(data), self.title_of(data) or self.heading
        if form == "latex":
            return "\n".join(cells.latex(title)) + "\n"
        said = [f"{line}\n" for line in (title, cells.caption) if line]
        return "\n".join([*said[:1], *cells.markdown(), "", *said[1:]])

    def frame(self, data: Any) -> pd.DataFrame:
        """DataFrame of the table of ``data``, with all digits."""
        import pandas as pd

        rows, columns = self.content(data)
        kept = [column for column in (*([self.across] if self.across else []), *columns) if column.name]
        values = [[column.value(row) for column in kept] for row in rows]
        frame = pd.DataFrame(values, columns=[column.name for column in kept])
        return frame.set_index(self.index) if self.index else frame
