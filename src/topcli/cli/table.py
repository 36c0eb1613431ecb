"""``topcli table``: tables of the rows of a sweep."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from topcli.cli.files import Overwrite, require_new, write_text
from topcli.cli.options import Json
from topcli.cli.output import emit_text, print_json, print_message, print_table
from topcli.cli.tables import table_lines

if TYPE_CHECKING:
    from topcli.sweeps.table import SweepTable

Folder = Annotated[Path, typer.Argument(metavar="DIR/NAME", help="Folder of a sweep.")]
Where = Annotated[
    list[str] | None,
    typer.Option("--where", metavar="KEY=VALUE", help="Use only these rows of the sweep; repeat for several."),
]
Aggregate = Annotated[
    str | None,
    typer.Option(
        "--aggregate",
        metavar="NAME",
        help="Combine values by median, max, mean or order (over h).",
        show_default="none",
    ),
]
RowKeys = Annotated[list[str], typer.Option("--rows", metavar="KEY", help="Key that names a row; repeat for several.")]
ColumnKey = Annotated[
    str | None,
    typer.Option("--columns", metavar="KEY", help="Key with a column for each value.", show_default="the measures"),
]
Values = Annotated[
    list[str],
    typer.Option("--value", metavar="MEASURE", help="Measure to show; several without --columns."),
]
Format = Annotated[str, typer.Option("--format", metavar="FORMAT", help="Write text, csv, markdown or latex.")]
OutFile = Annotated[
    Path | None, typer.Option("--out", metavar="FILE", help="Write to this file.", show_default="stdout")
]


def _text(table: SweepTable, form: str) -> str:
    """The table as text in one of the formats."""
    from topcli.sweeps import table_text

    if form == "text":
        header, keys = table_text.header(table), len(table.row_keys)
        lines = table_lines(header, table_text.lines(table), range(keys, len(header)), keys=keys)
        return "\n".join([table_text.title(table), *lines, *table_text.notes(table)]) + "\n"
    write = {"csv": table_text.csv_text, "markdown": table_text.markdown, "latex": table_text.latex}[form]
    return write(table)


def table(
    folder: Folder,
    row_keys: RowKeys,
    values: Values,
    column_key: ColumnKey = None,
    aggregate: Aggregate = None,
    where: Where = None,
    form: Format = "text",
    out: OutFile = None,
    force: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Show a measure of a sweep as text, CSV, Markdown or LaTeX.

    Each cell holds one value, or with --aggregate the median with its quartiles, the mean with its standard error, the
    maximum, or the observed order in h. Cells with failed rows are marked. CSV and JSON have all digits.
    """
    from topcli.errors import UsageError, nearest, quoted
    from topcli.sweeps.rows import read_rows
    from topcli.sweeps.table import sweep_table
    from topcli.sweeps.table_text import FORMATS, header, lines, notes, title

    if form not in FORMATS:
        raise UsageError(f"--format {quoted(form)}: unknown format; {nearest(form, FORMATS)}")
    found = sweep_table(read_rows(folder).where(where or []), row_keys, column_key, values, aggregate)
    if out is not None:
        require_new(out, force)
        write_text(_text(found, form), out)
        print_message(f"wrote {out}")
    elif as_json:
        print_json("table", found.as_dict())
    elif form == "text":
        keys = len(row_keys)
        print_table(header(found), lines(found), title(found), range(keys, keys + len(found.columns)), keys)
    else:
        emit_text(_text(found, form))
    for note in notes(found):
        print_message(note)
