"""Commands on stored results: ``topcli verify``, ``table``, ``report`` and ``animate``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol

import typer

from topcli.cli.options import (
    Force,
    Json,
    OutFile,
    Quiet,
    Results,
    format_option,
    option,
    require_new,
    stored_place,
    write_text,
)
from topcli.cli.output import (
    ProgressDisplay,
    emit,
    emit_text,
    messages,
    print_cells,
    print_json,
    print_message,
    print_table,
    table_lines,
)
from topcli.errors import ExitCode, counted

if TYPE_CHECKING:
    from topcli.sweeps.table import SweepTable


def complete_result(incomplete: str) -> list[str]:
    """Names of the results in ``results`` that begin with ``incomplete``."""
    folder = Path("results")
    try:
        folders = [path.name for path in sorted(folder.iterdir()) if path.is_dir()]
    except OSError:
        return []
    return [name for name in folders if name.startswith(incomplete)]


Stored = Annotated[
    list[str],
    typer.Argument(
        metavar="RUN",
        help="Folders or names of runs and sweeps, or JSON files.",
        autocompletion=complete_result,
    ),
]


def verify(
    runs: Stored,
    results: Results = Path("results"),
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Verify stored results by their checksums.

    Of an unfinished run, the command verifies the checkpoint and the rows before it. Of an unfinished sweep, it
    verifies the journal. The command exits with code 1 if a file is damaged.
    """
    from topcli.studies.health import check_all

    checked = [check_all(run, results) for run in runs]
    if as_json:
        print_json("verify", {"runs": [result.data() for result in checked]})
    for result in checked:
        for name, fault in result.damage.items():
            print_message(f"error: {result.folder / name}: damaged: {fault}")
        if not (as_json or quiet or result.damage):
            kind = "finished" if result.finished else "unfinished"
            emit(f"{result.folder}: {kind}, {counted(len(result.files), 'file')} intact")
    if any(result.damage for result in checked):
        raise typer.Exit(ExitCode.FAILED)


Place = Annotated[Path, typer.Argument(metavar="RUN", help="Folder or name of a result, or the file of a study.")]
Where = Annotated[
    list[str] | None,
    typer.Option("--where", metavar="KEY=VALUE", help="Use only the rows of the sweep in which KEY has this value."),
]
Aggregate = Annotated[
    str | None,
    typer.Option(
        "--aggregate",
        metavar="NAME",
        help="One value for all rows of a cell or point: their median, mean, max or order (the observed order in h).",
        show_default="none",
    ),
]
RowKeys = Annotated[
    list[str] | None, typer.Option("--rows", metavar="KEY", help="Make a table row for each value of this key.")
]
ColumnKey = Annotated[
    str | None,
    typer.Option(
        "--columns", metavar="KEY", help="Make a table column for each value of this key.", show_default="the measures"
    ),
]
Values = Annotated[
    list[str] | None,
    typer.Option("--value", metavar="MEASURE", help="Show this measure; several are possible without --columns."),
]
TableName = Annotated[str | None, option("--table", metavar="NAME", default="all; in CSV, the main table")]
Format = Annotated[str, format_option("text", "csv", "markdown", "latex")]
TableFile = Annotated[Path | None, option("--out", metavar="FILE", default="stdout")]


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
    place: Place,
    row_keys: RowKeys = None,
    values: Values = None,
    column_key: ColumnKey = None,
    aggregate: Aggregate = None,
    where: Where = None,
    name: TableName = None,
    form: Format = "text",
    out: TableFile = None,
    results: Results = Path("results"),
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Show tables of a result as text, CSV or LaTeX.

    For a run, a benchmark or the file of a study, the command shows the tables of its report. For a sweep, --rows and
    --value define a table of measures. Each cell contains one value, or with --aggregate the median with its quartiles,
    the mean with its standard error, the maximum, or the observed order in h. Cells to which failed rows belong are
    marked. In CSV and JSON, numbers have all digits.
    """
    from topcli.errors import UsageError, nearest, quoted
    from topcli.sweeps.run import is_sweep
    from topcli.sweeps.table_text import FORMATS

    if form not in FORMATS:
        raise UsageError(f"--format {quoted(form)}: unknown format; {nearest(form, FORMATS)}")
    folder = stored_place(place, results)
    if is_sweep(folder) or row_keys or values or column_key or aggregate or where:
        shown: _Shown = _ShownSweep(folder, row_keys or [], column_key, values or [], aggregate, where or [])
    else:
        shown = _ShownTables(folder, name)
    if out is not None:
        require_new(out, force)
        write_text(shown.text(form), out)
        messages(quiet)(f"wrote {out}")
    elif as_json:
        print_json("table", shown.data())
    elif form == "text":
        shown.show()
    else:
        emit_text(shown.text(form))
    for note in shown.notes(form):
        print_message(note)


class _Shown(Protocol):
    """Tables of one stored result."""

    def data(self) -> dict[str, Any]: ...
    def text(self, form: str) -> str: ...
    def show(self) -> None: ...
    def notes(self, form: str) -> list[str]: ...


class _ShownSweep:
    """Table of measures of a sweep."""

    def __init__(
        self,
        folder: Path,
        row_keys: list[str],
        column_key: str | None,
        values: list[str],
        aggregate: str | None,
        where: list[str],
    ) -> None:
        from topcli.errors import UsageError
        from topcli.sweeps.rows import read_rows
        from topcli.sweeps.table import sweep_table

        rows = read_rows(folder)
        if not (row_keys and values):
            raise UsageError(f"{folder}: is a sweep; give --rows KEY and --value MEASURE", rows.names)
        self._table = sweep_table(rows.where(where), row_keys, column_key, values, aggregate)

    def data(self) -> dict[str, Any]:
        return self._table.as_dict()

    def text(self, form: str) -> str:
        return _text(self._table, form)

    def show(self) -> None:
        from topcli.sweeps.table_text import header, lines, title

        table = self._table
        keys = len(table.row_keys)
        print_table(header(table), lines(table), title(table), range(keys, keys + len(table.columns)), keys)

    def notes(self, form: str) -> list[str]:
        from topcli.sweeps.table_text import notes

        return notes(self._table)


class _ShownTables:
    """Tables of a run, a benchmark or a study."""

    def __init__(self, folder: Path, name: str | None) -> None:
        from topcli.show.tables import stored_tables

        self._all = stored_tables(folder)
        self._tables = self._all.chosen(name)

    def data(self) -> dict[str, Any]:
        return {"result": self._all.data}

    def text(self, form: str) -> str:
        if form != "text":
            return self._tables.text(form)
        tables = ((table.cells(self._tables.data), table.title_of(self._tables.data)) for table in self._tables.shown)
        texts = (
            "\n".join(filter(None, (title, *table_lines(cells.header, cells.lines, keys=cells.keys))))
            for cells, title in tables
        )
        return "\n\n".join(texts) + "\n"

    def show(self) -> None:
        for i, table in enumerate(self._tables.shown):
            if i:
                emit()
            print_cells(table.cells(self._tables.data), table.title_of(self._tables.data))

    def notes(self, form: str) -> list[str]:
        others = list(self._all.named)
        several = form == "csv" and len(self._tables.shown) > 1
        return [f"this is the main table; choose another with --table: {', '.join(others)}"] if several else []


Title = Annotated[
    str | None,
    typer.Option("--title", metavar="TEXT", help="Give the page this title.", show_default="the names of the results"),
]


def report(
    places: Stored,
    out: OutFile,
    results: Results = Path("results"),
    title: Title = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write a self-contained HTML page about stored results.

    Results are runs, ensembles, sweeps, benchmarks, and JSON files that studies write with --save. Runs of the same top
    are compared in a table. Unfinished and damaged results are refused.
    """
    from topcli.errors import UsageError
    from topcli.pages.page import report_page

    if out.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"--out {out}: unknown type of page; use a name ending in .html")
    require_new(out, force)
    page = report_page(places, results, title)
    write_text(page.text, out)
    if as_json:
        keys = {"name": "title", "kind": "kind", "state": "state"}
        results_data = [{key: getattr(chapter, name) for key, name in keys.items()} for chapter in page.chapters]
        print_json("report", {"file": str(out), "results": results_data})
    if as_json or quiet:
        return
    print_message(f"wrote {out}")


Run = Annotated[Path, typer.Argument(metavar="RUN", help="Folder or name of a run.", autocompletion=complete_result)]
Fps = Annotated[
    float, typer.Option("--fps", metavar="RATE", min=1.0, max=120.0, help="Show this many frames per second.")
]
Seconds = Annotated[
    float,
    typer.Option("--seconds", metavar="SECONDS", min=0.1, max=600.0, help="Make the animation this many seconds long."),
]
Size = Annotated[
    int,
    typer.Option(
        "--size", metavar="PIXELS", min=240, max=3840, help="Set the width in pixels; the height is 2/3 of the width."
    ),
]
Start = Annotated[
    float | None,
    typer.Option("--start", metavar="T", help="Begin at this time of the run.", show_default="its beginning"),
]
Stop = Annotated[
    float | None,
    typer.Option(
        "--stop",
        metavar="T",
        help="End at this time of the run.",
        show_default="a time up to which the animation looks smooth",
    ),
]


def animate(
    run: Run,
    out: OutFile,
    fps: Fps = 25.0,
    seconds: Seconds = 10.0,
    size: Size = 720,
    start: Start = None,
    stop: Stop = None,
    results: Results = Path("results"),
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Animate the body of a run, with the trace of its axis.

    If the run recorded the attitude of the body (output.attitude), the attitude is read from the run. Otherwise it is
    reconstructed from the recorded rows, which must then be close in time. The file name must end in .gif or .mp4; an
    .mp4 file needs pip install 'topcli[video]'.
    """
    from topcli.figures.animation import animate as draw
    from topcli.figures.animation import encoder_for, planned
    from topcli.figures.body import stored_body_motion

    encoder_for(out, fps, seconds)  # before anything is read or drawn
    require_new(out, force)
    folder = stored_place(run, results)
    motion = stored_body_motion(folder)
    say = messages(quiet)
    for note in motion.notes:
        say(note)
    film = planned(motion, fps, seconds, size, start, stop)
    begin, end, last = float(film.times[0]), float(film.times[-1]), float(motion.t[-1])
    if stop is None and end != last:
        shown = f"{begin:g} to {end:.4g} of {last:g}"
        say(f"{motion.experiment.name}: shows t = {shown}; --stop {last:g} shows the whole run faster")
    display = ProgressDisplay(1, as_json or quiet, unit="frames")
    display.begin(str(out))
    try:
        draw(motion, film, out, display)
    finally:
        display.close()
    frames, (width, height) = len(film.times), film.size
    if as_json:
        content = {"file": str(out), "frames": frames, "fps": fps, "width": width, "height": height}
        print_json("animate", {"run": motion.experiment.name, **content, "t_first": begin, "t_last": end})
    elif not quiet:
        emit(f"{motion.experiment.name}: {frames} frames, {width} x {height} -> {out}")
