"""Commands on stored results: ``topcli verify``, ``table``, ``report`` and ``animate``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

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
    table_lines,
)
from topcli.errors import ExitCode, counted

if TYPE_CHECKING:
    from collections.abc import Callable

    from topcli.table import Cells


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

    Of an unfinished run, the command verifies the checkpoint and the rows before it. The rows of
    an unfinished sweep are verified when it continues. The command exits with code 1 if a file is damaged.
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


class _Shown(NamedTuple):
    """Tables of a stored result: their data, their cells, the text in a format, and notes."""

    data: dict[str, Any]
    cells: list[Cells]
    text: Callable[[str], str]
    notes: list[str]


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

    For a run or the file of a study, the command shows the tables of its report. For a sweep, --rows and
    --value define a table of measures. Each cell contains one value, or with --aggregate the median with its quartiles,
    the mean with its standard error, the maximum, or the observed order in h. A note counts rows that did not complete.
    In CSV and JSON, numbers have all digits.
    """
    from topcli.errors import UsageError, nearest, quoted
    from topcli.sweeps.store import is_sweep
    from topcli.sweeps.table import FORMATS

    if form not in FORMATS:
        raise UsageError(f"--format {quoted(form)}: unknown format; {nearest(form, FORMATS)}")
    folder = stored_place(place, results)
    if is_sweep(folder) or row_keys or values or column_key or aggregate or where:
        shown = _shown_sweep(folder, row_keys or [], column_key, values or [], aggregate, where or [])
    else:
        shown = _shown_tables(folder, name, form)
    if form == "text":
        tables = (
            "\n".join([each.title, *table_lines(each.header, each.lines, each.right, keys=each.keys), ""])
            for each in shown.cells
        )
        text = "\n".join(tables)
    else:
        text = shown.text(form)
    if out is not None:
        require_new(out, force)
        write_text(text, out)
        messages(quiet)(f"wrote {out}")
    elif as_json:
        print_json("table", shown.data)
    elif form != "text":
        emit_text(text)
    else:
        for i, cells in enumerate(shown.cells):
            if i:
                emit()
            print_cells(cells, cells.title)
    for note in shown.notes:
        print_message(note)


def _shown_sweep(
    folder: Path,
    row_keys: list[str],
    column_key: str | None,
    values: list[str],
    aggregate: str | None,
    where: list[str],
) -> _Shown:
    """Table of measures of a sweep. Raises UsageError."""
    from topcli.errors import UsageError
    from topcli.sweeps.table import names_of, read_rows, sweep_table
    from topcli.table import Cells

    rows = read_rows(folder, where)
    if not (row_keys and values):
        raise UsageError(f"{folder}: is a sweep; give --rows KEY and --value MEASURE", names_of(rows))
    table, keys = sweep_table(rows, row_keys, column_key, values, aggregate), len(row_keys)
    header, *lines = table.lines()
    cells = Cells(table.title, header, lines, keys=keys, numbers=range(keys, len(header)))
    return _Shown(table.as_dict(), [cells], table.text, table.notes)


def _shown_tables(place: Path, name: str | None, form: str) -> _Shown:
    """Tables of a run, an ensemble or the file of a study; all, or the one called ``name``.

    Raises UsageError and RunError.
    """
    from topcli.errors import UsageError, nearest, quoted
    from topcli.runs.report import report_tables
    from topcli.store.results import read_result
    from topcli.studies.report import read_record
    from topcli.table import Table, stored_cells

    if place.is_dir():
        run = read_result(place)
        if run is None or run.outcome is None:
            raise UsageError(f"{place}: no run or sweep is stored here")
        data = run.report()
        tables = report_tables(data)
    else:
        data = read_record(place)
        tables = [Table(table["heading"], table["rows"], stored=stored_cells(table)) for table in data["tables"]]
    names = [table.name for table in tables]
    if name is not None and name not in names:
        raise UsageError(f"--table {quoted(name)}: no such table; {nearest(name, names)}")
    tables = [table for table in tables if name in (None, table.name)]
    filled = [table for table in tables if table.rows]
    several = form == "csv" and len(tables) > 1
    notes = [f"this is the main table; choose another with --table: {', '.join(names)}"] if several else []

    def text(form: str) -> str:
        return tables[0].text(form) if form == "csv" else "\n".join(table.text(form) for table in filled)

    return _Shown({"result": data}, [table.cells() for table in filled], text, notes)


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

    Results are runs, ensembles, sweeps, and JSON files that studies write with --save. Runs of the same top
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
    from topcli.figures.animation import frame_times, require_format, stored_body_motion

    require_format(out, fps, seconds)  # before anything is read or drawn
    require_new(out, force)
    folder = stored_place(run, results)
    motion = stored_body_motion(folder)
    say = messages(quiet)
    for note in motion.notes:
        say(note)
    times = frame_times(motion, max(2, round(fps * seconds)), start, stop)
    begin, end, last = float(times[0]), float(times[-1]), float(motion.t[-1])
    if stop is None and end != last:
        shown = f"{begin:g} to {end:.4g} of {last:g}"
        say(f"{motion.experiment.name}: shows t = {shown}; --stop {last:g} shows the whole run faster")
    display = ProgressDisplay(1, as_json or quiet, unit="frames")
    display.begin(str(out))
    try:
        draw(motion, times, out, fps, size, display)
    finally:
        display.close()
    frames, width, height = len(times), 2 * (size // 2), 2 * round(size / 3.0)
    if as_json:
        content = {"file": str(out), "frames": frames, "fps": fps, "width": width, "height": height}
        print_json("animate", {"run": motion.experiment.name, **content, "t_first": begin, "t_last": end})
    elif not quiet:
        emit(f"{motion.experiment.name}: {frames} frames, {width} x {height} -> {out}")
