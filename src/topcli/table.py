"""Tables: rows of plain data with all digits, and their texts for terminals, pages, Markdown, LaTeX and CSV."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    import pandas as pd

Row = Mapping[str, Any]
Format = str | Callable[[Any], str]
DASH = "–"
"""Text of a missing value."""


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


def plus_minus(value: float, error: float) -> str:
    """Number with its error, both to the second digit of the error: 0.123 ± 0.031, (-8.5 ± 2.2)e-05."""
    if not (math.isfinite(value) and math.isfinite(error) and error > 0.0):
        return number(value)
    # exponents of the second digit of the error, and of the leading digit of the larger of value and error
    place = int(f"{error:.1e}".partition("e")[2]) - 1
    scale = max(int(f"{value:.3e}".partition("e")[2]), place + 1) if value else place + 1
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

    @property
    def right(self) -> Sequence[int]:
        """Indices of the right-aligned columns."""
        return range(1, len(self.header or self.lines[0])) if self.numbers is True else self.numbers or ()

    def markdown(self) -> list[str]:
        """Lines of a Markdown table."""
        lines = [self.header or [""] * len(self.lines[0]), *self.lines]
        head, *rest = ("| " + " | ".join(line) + " |" for line in lines)
        return [head, "|" + " --- |" * len(lines[0]), *rest]

    def latex(self, title: str = "") -> list[str]:
        """Lines of a LaTeX table for the package booktabs, with ``title`` before the caption."""
        aligned = "".join("r" if i in self.right else "l" for i in range(len(self.header or self.lines[0])))
        caption = " ".join(escaped(f"{text.rstrip('.')}.") for text in (title, self.caption) if text)
        head = [" & ".join(map(escaped, self.header)) + r" \\", r"\midrule"] if self.header else []
        return [
            r"% needs \usepackage{booktabs}",
            r"\begin{table}",
            r"\centering",
            rf"\caption{{{caption}}}",
            rf"\begin{{tabular}}{{{aligned}}}",
            r"\toprule",
            *head,
            *(" & ".join(map(latex_text, line)) + r" \\" for line in self.lines),
            r"\bottomrule",
            r"\end{tabular}",
            r"\end{table}",
        ]

    def text(self, form: str, title: str = "") -> str:
        """Table in a format, "markdown" or "latex", under ``title`` or its own."""
        title = title or self.title
        if form == "latex":
            return "\n".join(self.latex(title)) + "\n"
        said = [f"{line}\n" for line in (title, self.caption) if line]
        return "\n".join([*said[:1], *self.markdown(), "", *said[1:]])


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
_NUMBER = re.compile(r"(?<![\w.])(-?\d+(?:\.\d+)?)(?:e([+-]?\d+))?(?![\w.])")


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


def latex_text(text: str) -> str:
    """Text in LaTeX, the numbers in it in mathematics: 1.2e-05 becomes 1.2 times a power of ten."""
    *parts, last = _NUMBER.split(text)
    triples = zip(parts[::3], parts[1::3], parts[2::3], strict=True)
    powers = (rf"{escaped(words)}${x}" + (rf" \times 10^{{{int(e)}}}$" if e else "$") for words, x, e in triples)
    return "".join(powers) + escaped(last)


@dataclass(frozen=True)
class Table:
    """Rows under a heading.

    Attributes
    ----------
    heading : str
        Title of the table.
    rows : sequence of dict
        Plain values by column, with all digits; None for a missing one. The first column names the row.
    formats : mapping, optional
        Format specification, such as ``".2f"``, or function of a value, by column. Other numbers have three digits.
    detail : bool or sequence of str, optional
        Columns that a terminal shows only with ``--verbose``; True for all.
    names : mapping, optional
        Headings of columns; by default the key, with spaces for underscores.
    right : sequence of str, optional
        Columns that are right-aligned; by default those without texts.
    across : bool, optional
        True to show each row as a column, and each column as a line.
    caption : str, optional
        Line below the table.
    marks : mapping, optional
        Looks of cells with certain texts, as in ``Cells``.
    stored : Cells, optional
        Texts of a stored table, whose formats are gone.
    """

    heading: str
    rows: Sequence[Row]
    formats: Mapping[str, Format] = field(default_factory=dict)
    detail: bool | Sequence[str] = ()
    names: Mapping[str, str] = field(default_factory=dict)
    right: Sequence[str] | None = None
    across: bool = False
    caption: str = ""
    marks: Mapping[str, str] = field(default_factory=dict)
    stored: Cells | None = None

    @property
    def name(self) -> str:
        """Heading as a name, for files and ``topcli table --table``."""
        return "".join(letter if letter.isalnum() else "_" for letter in self.heading.lower())

    def columns(self, verbose: bool = True) -> list[str]:
        """Keys of the columns, with or without details, in the order of their first appearance."""
        hidden = () if verbose or isinstance(self.detail, bool) else self.detail
        return [key for key in dict.fromkeys(key for row in self.rows for key in row) if key not in hidden]

    def cell(self, key: str, value: Any) -> str:
        """Text of a value in the column ``key``."""
        if value is None:
            return DASH
        form = self.formats.get(key)
        if form is not None:
            return format(value, form) if isinstance(form, str) else form(value)
        if isinstance(value, bool):
            return "yes" if value else "no"
        return number(value) if isinstance(value, float) else str(value)

    def cells(self, verbose: bool = True) -> Cells:
        """Texts of the table, with or without details."""
        if self.stored is not None:
            return self.stored
        keys = self.columns(verbose)
        header = [self.names.get(key, key.replace("_", " ") if key.isidentifier() else key) for key in keys]
        lines = [[self.cell(key, row.get(key)) for key in keys] for row in self.rows]
        if self.across:
            header, *lines = map(list, zip(header, *lines, strict=True))
            return Cells(self.heading, header, lines, self.caption, marks=self.marks)
        words = {key for row in self.rows for key in keys if isinstance(row.get(key), str)}
        right = [i for i, key in enumerate(keys) if (key not in words if self.right is None else key in self.right)]
        return Cells(self.heading, header, lines, self.caption, numbers=right, marks=self.marks)

    def text(self, form: str) -> str:
        """Table with all columns in a format: "csv" with all digits, "markdown" or "latex"."""
        return str(self.frame().to_csv(lineterminator="\n")) if form == "csv" else self.cells().text(form)

    def frame(self) -> pd.DataFrame:
        """DataFrame with all digits, whose index is the first column."""
        import pandas as pd

        keys = self.columns()
        frame = pd.DataFrame([dict(row) for row in self.rows], columns=keys)
        return frame.set_index(keys[0]) if keys else frame

    def as_dict(self) -> dict[str, Any]:
        """Plain data: heading, rows with all digits, and cells as they are shown."""
        cells = self.cells()
        texts = {"header": cells.header, "lines": cells.lines, "right": cells.numbers}
        texts |= {"caption": cells.caption, "marks": dict(cells.marks)}
        return {"heading": self.heading, "rows": plain(self.rows), "cells": texts}


def stored_cells(table: Mapping[str, Any]) -> Cells:
    """Texts of a table that is stored as plain data."""
    cells = table["cells"]
    rest = {"numbers": cells["right"], "marks": cells["marks"]}
    return Cells(table["heading"], cells["header"], cells["lines"], cells["caption"], **rest)


def plain(value: Any) -> Any:
    """Value ready for JSON: plain numbers, None for those that are not finite."""
    if isinstance(value, Mapping):
        return {str(key): plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [plain(inner) for inner in value]
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and not math.isfinite(value) else value
