"""Tables of a sweep as text, CSV, Markdown and LaTeX: what a cell shows, and the notes that explain it."""

from __future__ import annotations

import csv
import io
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict

from topcli.sweeps.table import ORDER, SPREADS, Cell, Summary, SweepTable
from topcli.table import markdown_table

FORMATS = ("text", "csv", "markdown", "latex")
NO_ROW = "–"
MARK = "*"
DIGITS = 3
"""Significant digits of a number without a spread."""


def _exponent(value: float) -> int:
    """Decimal exponent of a number; 0 for zero."""
    return math.floor(math.log10(abs(value))) if value else 0


def significant(value: float, digits: int) -> str:
    """Number with this many significant digits, with an exponent if it is very large or small; 1234 stays whole."""
    if not math.isfinite(value) or value == 0.0:
        return f"{value:g}"
    text = f"{value:.{digits - 1}e}"  # rounds first: 0.0009996 has the exponent of 0.001
    exponent = int(text.partition("e")[2])
    if not -3 <= exponent < 5:
        return text
    return f"{value:.{max(0, digits - 1 - exponent)}f}"


def rounded(figure: Summary) -> tuple[str, ...]:
    """Texts of a summary: the value; the value and its standard error; or the value and its quartiles.

    An error has two significant digits, and the value ends at the same place. Quartiles and median end where their
    distance has two significant digits, but have two themselves at least.
    """
    if figure.low is None or figure.high is None:
        return (_short(significant(figure.value, DIGITS)),)
    width = figure.high - figure.low
    if not (math.isfinite(width) and width > 0.0):
        return tuple(_short(significant(value, DIGITS)) for value in (figure.value, figure.low, figure.high))
    place = _exponent(float(f"{width:.1e}")) - 1
    return tuple(
        significant(value, max(2, min(_exponent(value) - place + 1, 15)))
        for value in (figure.value, figure.low, figure.high)
    )


def _short(text: str) -> str:
    """Text of a number without zeros at the end of its decimals."""
    mantissa, e, exponent = text.partition("e")
    if "." in mantissa and not e:
        mantissa = mantissa.rstrip("0").rstrip(".")
    return mantissa + e + exponent


def with_error(value: float, error: float) -> tuple[str, str]:
    """Texts of a mean and its standard error, both to the place of the error's second digit."""
    if error == 0.0:
        return _short(significant(value, DIGITS)), "0"
    shown = float(f"{error:.1e}")
    place = _exponent(shown) - 1
    scale = max(_exponent(float(f"{value:.{DIGITS}e}")) if value else place, place + 1)
    if -3 <= scale < 5:
        step = 10.0**place
        decimals = max(0, -place)
        return f"{round(value / step) * step + 0.0:.{decimals}f}", f"{shown:.{decimals}f}"
    return (
        f"{round(value / 10.0**place) * 10.0 ** (place - scale) + 0.0:.{scale - place}f}e{scale:+03d}",
        f"{shown:.1e}",
    )


def _parts(cell: Cell, aggregate: str | None) -> tuple[str, ...]:
    """Texts of the numbers of a cell that has a value."""
    summary = cell.summary or Summary(math.nan)
    if aggregate == "mean" and summary.high is not None:
        return with_error(summary.value, summary.high - summary.value)
    return (f"{summary.value:.2f}",) if aggregate == ORDER else rounded(summary)


def _word(cell: Cell) -> str:
    """Text of a cell without a value."""
    outcomes = Counter(cell.outcomes).most_common(1)
    return NO_ROW if not cell.rows else outcomes[0][0] if outcomes else "nan"


TEXT = ("{}", "{} ± {}", "{} [{}, {}]")
LATEX = ("{}", r"{} \pm {}", r"{}\;[{},\, {}]")
"""Forms of a value, a value with its error, and a value with the ends of its spread."""


def cell_text(cell: Cell, aggregate: str | None) -> str:
    """Text of a cell: the value with its spread, marked if a row did not complete or has no value."""
    if cell.summary is None:
        return _word(cell)
    parts = _parts(cell, aggregate)
    return TEXT[len(parts) - 1].format(*parts) + MARK * cell.incomplete


def title(table: SweepTable) -> str:
    """Line above a table: the measures, the sweep, the aggregate and what it is taken over."""
    words = f"{', '.join(table.measures)} of {table.source.name}"
    if table.aggregate:
        spread = {"quartiles": " [quartiles]", "standard error": " ± standard error"}.get(SPREADS[table.aggregate], "")
        over = f" over {', '.join(table.over)}" if table.over else ""
        words += f": {'observed ' * (table.aggregate == ORDER)}{table.aggregate}{spread}{over}"
    return words + "".join(f", {condition}" for condition in table.source.chosen)


def notes(table: SweepTable) -> list[str]:
    """Sentences on the number of rows in a cell, and on rows that failed, have no value, are absent or left out."""
    cells, said = table.cells, []
    sizes = sorted({cell.rows for cell in cells if cell.rows})
    if table.aggregate:
        count = str(sizes[0]) if len(sizes) == 1 else f"{sizes[0]} to {sizes[-1]}"
        said.append(f"{count} row{'s' * (count != '1')} in each cell")
    total = sum(cell.rows for cell in cells)
    outcomes = sum((Counter(cell.outcomes) for cell in cells), Counter[str]())
    missing = total - sum(cell.count for cell in cells)
    if outcomes:
        listed = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items())
        failed = sum(outcomes.values())
        said.append(f"{MARK} {failed} of {total} values {_verb(failed)} of runs that did not complete: {listed}")
    if missing:
        said.append(f"{MARK} {missing} of {total} values could not be computed (nan) and {_verb(missing)} left out")
    if any(cell.rows == 0 for cell in cells):
        said.append(f"{NO_ROW} the sweep has no such row")
    if table.source.left_out:
        said.append(left_out(table.source.left_out))
    return said


def left_out(count: int) -> str:
    """Sentence on stored rows that no longer belong to the sweep."""
    many = "row no longer belongs" if count == 1 else "rows no longer belong"
    return f"{count} stored {many} to the sweep and {_verb(count)} left out"


def _verb(count: int) -> str:
    return "is" if count == 1 else "are"


def header(table: SweepTable) -> list[str]:
    """Header of a table: the keys that name a row, then the columns."""
    prefix = f"{table.column_key} = " if table.column_key else ""
    return [*table.row_keys, *(prefix + column for column in table.columns.values())]


def lines(table: SweepTable) -> list[list[str]]:
    """Cells of a table as text, without the header."""
    return [
        [*labels, *(cell_text(cell, table.aggregate) for cell in cells)]
        for labels, cells in zip(table.row_labels, table.lines.values(), strict=True)
    ]


def markdown(table: SweepTable) -> str:
    """Table in Markdown, with its title above and its notes below."""
    escaped = [
        [cell.replace("|", "\\|").replace("*", "\\*") for cell in line] for line in (header(table), *lines(table))
    ]
    below = [f"{note}.".replace("*", "\\*") for note in notes(table)]
    return "\n".join([f"{title(table)}:", "", *markdown_table(escaped), *([""] if below else []), *below]) + "\n"


def csv_text(table: SweepTable) -> str:
    """Table as CSV with all digits.

    A column of an aggregate is followed by the ends of its spread (``:low``, ``:high``) and the numbers of values and
    of rows (``:count``, ``:rows``). If any row failed, the outcomes of each cell are in ``:outcomes``. A cell is empty
    without a row, and nan without a value.
    """
    ends = ["", *[":low", ":high"] * bool(SPREADS.get(table.aggregate or ""))]
    ends += [":count", ":rows"] * bool(table.aggregate)
    ends += [":outcomes"] * any(cell.outcomes for cell in table.cells)
    prefix = f"{table.column_key}=" if table.column_key else ""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*table.row_keys, *(f"{prefix}{value}{end}" for value in table.columns for end in ends)])
    for values, cells in table.lines.items():
        fields = [_csv_fields(cell).get(end, "") for cell in cells for end in ends]
        writer.writerow([*values, *fields])
    return out.getvalue()


def _csv_fields(cell: Cell) -> dict[str, str]:
    """Fields of a cell by the ends of their names; none without a row."""
    if not cell.rows:
        return {}
    data = {"": math.nan, **{f":{key}": value for key, value in asdict(cell.summary or Summary(math.nan)).items()}}
    fields = {end: repr(value) for end, value in data.items() if value is not None}
    outcomes = "; ".join(f"{count} {outcome}" for outcome, count in cell.outcomes.items())
    return {**fields, "": fields[":value"], ":count": str(cell.count), ":rows": str(cell.rows), ":outcomes": outcomes}


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
}


def escaped(text: str) -> str:
    """Text with the special characters of LaTeX escaped."""
    return "".join(_SPECIAL.get(letter, letter) for letter in text)


def _math(number: str) -> str:
    """Number of a table in LaTeX's mathematics: 1.2e-05 becomes 1.2 times a power of ten."""
    parts = re.fullmatch(r"(-?[0-9.]+)(?:e([+-]?\d+))?", number)
    if parts is None:
        return {"inf": r"\infty", "-inf": r"-\infty"}.get(number, rf"\mathrm{{{number}}}")
    return parts[1] + (rf" \times 10^{{{int(parts[2])}}}" if parts[2] else "")


def _latex_cell(cell: Cell, aggregate: str | None) -> str:
    if cell.summary is None:
        return escaped(_word(cell))
    parts = [_math(part) for part in _parts(cell, aggregate)]
    mark = "{}^{*}" * cell.incomplete  # of its own base: a power of ten has a superscript already
    return f"${LATEX[len(parts) - 1].format(*parts)}{mark}$"


def _latex_label(text: str) -> str:
    """Value of a key, as a number if it is one."""
    return f"${_math(text)}$" if _is_number(text) else escaped(text)


def _units(measures: Sequence[str]) -> str:
    """Sentence on the units of measures; all but times of computation are dimensionless."""
    if "seconds" not in measures:
        return "All quantities are dimensionless."
    return r"\texttt{seconds} is in s" + ("; all other quantities are dimensionless." if len(measures) > 1 else ".")


def latex(table: SweepTable) -> str:
    """Table in LaTeX, for the package booktabs, with title, notes and units in the caption."""
    said = [escaped(f"{sentence}.") for sentence in (title(table), *notes(table))]
    keys, columns = len(table.row_keys), len(table.columns)
    above, label = [], escaped
    if table.column_key:
        span = rf"\multicolumn{{{columns}}}{{c}}{{{escaped(table.column_key)}}}"
        above = [" & ".join([*[""] * keys, span]).strip() + r" \\", rf"\cmidrule(lr){{{keys + 1}-{keys + columns}}}"]
        label = _latex_label
    header = [*map(escaped, table.row_keys), *map(label, table.columns.values())]
    body = [
        [*map(_latex_label, labels), *(_latex_cell(cell, table.aggregate) for cell in cells)]
        for labels, cells in zip(table.row_labels, table.lines.values(), strict=True)
    ]
    numeric = ["r" if all(_is_number(row[i]) for row in table.row_labels) else "l" for i in range(keys)]
    return "\n".join(
        [
            r"% needs \usepackage{booktabs}",
            r"\begin{table}",
            r"\centering",
            rf"\caption{{{' '.join([*said, _units(table.measures)])}}}",
            rf"\begin{{tabular}}{{{''.join(numeric)}{'r' * columns}}}",
            r"\toprule",
            *above,
            " & ".join(header) + r" \\",
            r"\midrule",
            *(" & ".join(line) + r" \\" for line in body),
            r"\bottomrule",
            r"\end{tabular}",
            r"\end{table}",
            "",
        ]
    )


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
