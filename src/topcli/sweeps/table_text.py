"""Tables of a sweep as text, CSV, Markdown and LaTeX: the cells, and the notes that explain them."""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict

from topcli.errors import counted
from topcli.sweeps.measures import of_name
from topcli.sweeps.table import ORDER, SPREADS, Cell, Summary, SweepTable
from topcli.table import (
    error_places,
    escaped,
    is_number,
    latex_number,
    latex_table,
    markdown_table,
    number,
    significant,
)

FORMATS = ("text", "csv", "markdown", "latex")
NO_ROW = "–"
MARK = "*"


def _exponent(value: float) -> int:
    """Decimal exponent of a number; 0 for zero."""
    return math.floor(math.log10(abs(value))) if value else 0


def rounded(figure: Summary) -> tuple[str, ...]:
    """Texts of a summary: the value; the value and its standard error; or the value and its quartiles.

    An error has two significant digits, and the value ends at the same place. Quartiles and median end where their
    distance has two significant digits, but have two themselves at least.
    """
    if figure.low is None or figure.high is None:
        return (number(figure.value),)
    width = figure.high - figure.low
    if not (math.isfinite(width) and width > 0.0):
        return tuple(map(number, (figure.value, figure.low, figure.high)))
    place = _exponent(float(f"{width:.1e}")) - 1
    return tuple(
        significant(value, max(2, min(_exponent(value) - place + 1, 15)))
        for value in (figure.value, figure.low, figure.high)
    )


def with_error(value: float, error: float) -> tuple[str, str]:
    """Texts of a mean and its standard error, both to the place of the error's second digit."""
    if error == 0.0:
        return number(value), "0"
    shown = float(f"{error:.1e}")
    place, scale = error_places(value, error)
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
        least = f"{sizes[0]} to " if len(sizes) > 1 else ""
        said.append(f"{least}{counted(sizes[-1], 'row')} in each cell")
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
        said.append(f"{NO_ROW}: the sweep has no such row")
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


def _latex_cell(cell: Cell, aggregate: str | None) -> str:
    if cell.summary is None:
        return escaped(_word(cell))
    parts = [latex_number(part) for part in _parts(cell, aggregate)]
    mark = "{}^{*}" * cell.incomplete  # of its own base: a power of ten has a superscript already
    return f"${LATEX[len(parts) - 1].format(*parts)}{mark}$"


def _latex_label(text: str) -> str:
    """Value of a key, as a number if it is one."""
    return f"${latex_number(text)}$" if is_number(text) else escaped(text)


def _definitions(measures: Sequence[str]) -> list[str]:
    """Sentence on each measure that is registered."""
    return [escaped(f"{name}: {found.summary}.") for name in measures if (found := of_name(name))]


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
    numeric = ["r" if all(is_number(row[i]) for row in table.row_labels) else "l" for i in range(keys)]
    aligned = f"{''.join(numeric)}{'r' * columns}"
    return (
        "\n".join(
            latex_table(
                header, body, aligned, " ".join([*said, *_definitions(table.measures), _units(table.measures)]), above
            )
        )
        + "\n"
    )
