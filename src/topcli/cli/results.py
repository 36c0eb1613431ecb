"""Commands on stored results: ``topcli verify``, ``table``, ``report`` and ``animate``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from topcli.cli.options import Json, Out, Overwrite, require_new, write_text
from topcli.cli.output import ProgressDisplay, emit, emit_text, print_json, print_message, print_table, table_lines
from topcli.errors import ExitCode

if TYPE_CHECKING:
    from topcli.sweeps.table import SweepTable


def verify(
    runs: Annotated[
        list[str], typer.Argument(metavar="RUN...", help="Folders of runs or sweeps, names in --out, or JSON files.")
    ],
    out: Out = Path("results"),
    as_json: Json = False,
) -> None:
    """Verify stored results by their checksums.

    For an unfinished run, verify the checkpoint and the rows that it can be continued from; for an unfinished sweep,
    its journal. Exits with status 0 if all files are intact, with 1 if a file is damaged.
    """
    from topcli.studies.health import check_all

    checked = [result for run in runs for result in check_all(run, out)]
    if as_json:
        print_json("verify", {"runs": [result.data() for result in checked]})
    for result in checked:
        for file in result.files:
            if file.damaged:
                print_message(f"error: {result.folder / file.name}: damaged: {file.reason}")
        if not (as_json or result.damaged):
            kind = "finished" if result.finished else "unfinished"
            notes = "".join(f"; {file.name}: {file.reason}" for file in result.files if file.reason)
            emit(f"{result.folder}: {kind}, {len(result.files)} files intact{notes}")
    if any(result.damaged for result in checked):
        raise typer.Exit(ExitCode.FAILED)


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
TableFile = Annotated[
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
    out: TableFile = None,
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
    shown = sweep_table(read_rows(folder).where(where or []), row_keys, column_key, values, aggregate)
    if out is not None:
        require_new(out, force)
        write_text(_text(shown, form), out)
        print_message(f"wrote {out}")
    elif as_json:
        print_json("table", shown.as_dict())
    elif form == "text":
        keys = len(row_keys)
        print_table(header(shown), lines(shown), title(shown), range(keys, keys + len(shown.columns)), keys)
    else:
        emit_text(_text(shown, form))
    for note in notes(shown):
        print_message(note)


def complete_result(incomplete: str) -> list[str]:
    """Names of the results in ``results`` that begin with ``incomplete``."""
    folder = Path("results")
    try:
        folders = [path.name for path in sorted(folder.iterdir()) if path.is_dir()]
    except OSError:
        return []
    return [name for name in folders if name.startswith(incomplete)]


Places = Annotated[
    list[str],
    typer.Argument(
        metavar="RUN...",
        help="Folders of runs or sweeps, or JSON files of studies.",
        autocompletion=complete_result,
    ),
]
PageFile = Annotated[Path, typer.Option("--out", metavar="FILE", help="Write the page to this file, FILE.html.")]
Results = Annotated[Path, typer.Option("--results", metavar="DIR", help="Find results by name in this folder.")]
Title = Annotated[
    str | None,
    typer.Option("--title", metavar="TEXT", help="Title of the page.", show_default="the names of the results"),
]


def report(
    places: Places,
    out: PageFile,
    results: Results = Path("results"),
    title: Title = None,
    force: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Write one self-contained HTML page on stored results.

    Results are runs, ensembles, sweeps, benchmarks, and JSON files of compare, order and stress. The page loads nothing
    from elsewhere. Runs of the same top are compared in a table. What is missing of an unfinished or damaged result is
    said on the page.
    """
    from topcli.errors import UsageError
    from topcli.pages.page import report_page

    if out.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"--out {out}: unknown type of page; use a name ending in .html")
    require_new(out, force)
    page = report_page(places, results, title)
    write_text(page.text, out)
    if as_json:
        keys = {"name": "title", "kind": "kind", "state": "state", "missing": "missing"}
        results_data = [{key: getattr(chapter, name) for key, name in keys.items()} for chapter in page.chapters]
        print_json("report", {"file": str(out), "results": results_data})
        return
    print_message(f"wrote {out}")
    for chapter in page.chapters:
        for line in chapter.missing:
            print_message(f"warning: {chapter.title}: {line}")


Run = Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run, such as results/NAME.")]
FilmFile = Annotated[Path, typer.Option("--out", metavar="FILE", help="Write this file, a .gif or an .mp4.")]
Fps = Annotated[
    float, typer.Option("--fps", metavar="RATE", min=1.0, max=120.0, help="Show this number of frames per second.")
]
Seconds = Annotated[
    float, typer.Option("--seconds", metavar="SECONDS", min=0.1, max=600.0, help="Make it last this long.")
]
Size = Annotated[int, typer.Option("--size", metavar="PIXELS", min=240, max=3840, help="Set the width; 3:2.")]
Start = Annotated[float | None, typer.Option("--start", metavar="T", help="Begin at this time of the run.")]
Stop = Annotated[
    float | None,
    typer.Option("--stop", metavar="T", help="End at this time; by default as far as the motion is smooth."),
]


def animate(
    run: Run,
    out: FilmFile,
    fps: Fps = 25.0,
    seconds: Seconds = 10.0,
    size: Size = 720,
    start: Start = None,
    stop: Stop = None,
    as_json: Json = False,
) -> None:
    """Animate the body of a run, with the trace of its axis.

    The attitude is that of the run (output.attitude), or it is reconstructed from densely recorded rows. An .mp4
    needs pip install 'topcli[video]'; a .gif needs nothing more.
    """
    from topcli.figures.animation import animate as draw
    from topcli.figures.animation import encoder_for, planned
    from topcli.figures.body import stored_body_motion

    encoder_for(out, fps, seconds)  # before anything is read or drawn
    motion = stored_body_motion(run)
    for note in motion.notes:
        print_message(note)
    film = planned(motion, fps, seconds, size, start, stop)
    begin, end, last = float(film.times[0]), float(film.times[-1]), float(motion.t[-1])
    if stop is None and end != last:
        print_message(
            f"{motion.experiment.name}: shows t = {begin:g} to {end:.4g} of {last:g}; --stop {last:g} shows all, faster"
        )
    display = ProgressDisplay(1, as_json, unit="frames")
    display.begin(str(out))
    try:
        draw(motion, film, out, display)
    finally:
        display.close()
    frames, (width, height) = len(film.times), film.size
    if as_json:
        content = {"file": str(out), "frames": frames, "fps": fps, "width": width, "height": height}
        print_json("animate", {"run": motion.experiment.name, **content, "t_first": begin, "t_last": end})
    else:
        emit(f"{motion.experiment.name}: {frames} frames, {width} x {height} -> {out}")
