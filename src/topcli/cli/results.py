"""Commands on stored results: ``topcli verify``, ``table``, ``report``, ``plot`` and ``animate``."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from topcli.cli.output import CommandResult, Screen, print_message
from topcli.errors import ExitCode, TopcliError, UsageError, counted, nearest, quoted

if TYPE_CHECKING:
    from topcli.figures.figure import Figure
    from topcli.table import Table

WIDTHS = (240, 3840)
"""Smallest and largest width of an animation in pixels."""


def stored_place(name: str, results: Path) -> Path:
    """Path that ``name`` is, or that of the stored result of this name. Raises UsageError if there is nothing."""
    from topcli.sweeps.store import missing_result

    for place in (Path(name), results / name):
        if os.path.lexists(place):
            return place
    raise missing_result(name, results)


def require_new_file(path: Path, force: bool, option: str = "--out") -> None:
    """Raise UsageError if ``path`` exists and may not be overwritten, or is a folder."""
    from topcli.store import files

    if os.path.isdir(path):
        raise UsageError(f"{option} {path}: is a folder; name a file")
    if not force:
        files.require_new([path], option)


def verify_command(runs: Sequence[str], *, results: Path = Path("results"), screen: Screen) -> CommandResult:
    """Verify stored results by their checksums.

    Of an unfinished run, the command verifies the checkpoint and the rows before it. The rows of
    an unfinished sweep are verified when it continues. The command exits with code 1 if a file is damaged.

    Parameters
    ----------
    runs : sequence of str
        Folders or names of runs and sweeps, or JSON files.
    """
    from topcli.studies.verify import check_all

    checked = [check_all(run, results) for run in runs]
    for result in checked:
        for name, fault in result.damage.items():
            print_message(f"error: {result.folder / name}: damaged: {fault}")
        if not result.damage:
            state = "finished" if result.finished else "unfinished"
            screen.show(f"{result.folder}: {state}, {counted(len(result.files), 'file')} intact")
    damaged = any(result.damage for result in checked)
    return CommandResult({"runs": [result.data() for result in checked]}, ExitCode(int(damaged)))


def table_command(
    result: str,
    *,
    rows: Sequence[str] = (),
    value: Sequence[str] = (),
    columns: str | None = None,
    aggregate: str | None = None,
    where: Sequence[str] = (),
    table: str | None = None,
    form: Literal["text", "csv", "markdown", "latex"] = "text",
    results: Path = Path("results"),
    screen: Screen,
) -> CommandResult:
    """Show tables of a result as text, CSV or LaTeX.

    For a run or the file of a study, the command shows the tables of its report. For a sweep, --rows and
    --value define a table of measures. Each cell contains one value, or with --aggregate the median with its quartiles,
    the mean with its standard error, or the maximum. A note counts rows that did not complete.
    In CSV and JSON, numbers have all digits.

    Parameters
    ----------
    result : str
        Folder or name of a result, or the file of a study.
    rows : sequence of str, optional
        Make a table row for each value of this key.
    value : sequence of str, optional
        Show this measure; several are possible without --columns.
    columns : str, optional
        Make a table column for each value of this key; by default one for each measure.
    aggregate : str, optional
        One value for all rows of a cell or point: their median, mean or max.
    where : sequence of str, optional
        Use only the rows of the sweep in which KEY has this value.
    table : str, optional
        Show only this table of the result; by default all, in CSV the main table.
    """
    from topcli.sweeps.aggregates import names_hint, read_rows, sweep_table
    from topcli.sweeps.store import is_sweep

    place = stored_place(result, results)
    if is_sweep(place) or rows or value or columns or aggregate or where:
        frame = read_rows(place, where)
        if not (rows and value):
            raise UsageError(f"{place}: is a sweep; give --rows KEY and --value MEASURE", names_hint(frame))
        swept = sweep_table(frame, list(rows), columns, list(value), aggregate)
        screen.show(swept.cells() if form == "text" else swept.text(form).removesuffix("\n"))
        if form == "csv":
            screen.warn(swept.caption)
        return CommandResult(swept.as_dict())
    data, tables = tables_of(place)
    names = [each.name for each in tables]
    if table is not None and table not in names:
        raise UsageError(f"--table {quoted(table)}: no such table; {nearest(table, names)}")
    tables = [each for each in tables if table in (None, each.name)]
    if form == "csv":
        screen.show(tables[0].text(form).removesuffix("\n"))
        if len(tables) > 1:
            screen.say(f"this is the main table; choose another with --table: {', '.join(names)}")
        return CommandResult({"result": data})
    for number, each in enumerate(each for each in tables if each.rows):
        screen.show(*([""] if number else []), each.cells() if form == "text" else each.text(form).removesuffix("\n"))
    return CommandResult({"result": data})


def tables_of(place: Path) -> tuple[dict[str, Any], list[Table]]:
    """Report of a run, an ensemble or the file of a study, and its tables. Raises UsageError and RunError."""
    from topcli.runs.report import report_tables
    from topcli.store.results import read_result
    from topcli.studies.report import read_record
    from topcli.table import Table, stored_cells

    if place.is_dir():
        run = read_result(place)
        if run is None or run.outcome is None:
            raise UsageError(f"{place}: no run or sweep is stored here")
        return run.report(), report_tables(run.report())
    data = read_record(place)
    return data, [Table(each["heading"], each["rows"], stored=stored_cells(each)) for each in data["tables"]]


def report_command(
    runs: Sequence[str], *, out: Path, results: Path = Path("results"), force: bool = False, screen: Screen
) -> CommandResult:
    """Write a self-contained HTML page about stored results.

    Results are runs, ensembles, sweeps, and JSON files that studies write with --save. Unfinished and damaged results
    are refused.

    Parameters
    ----------
    runs : sequence of str
        Folders or names of runs and sweeps, or JSON files.
    """
    from topcli.cli.reports import stored_record
    from topcli.store.files import write_by_ending
    from topcli.studies.page import page_of

    require_new_file(out, force)
    records = [stored_record(place) for place in dict.fromkeys(stored_place(run, results) for run in runs)]
    write_by_ending(out, {".html": lambda: page_of(records)})
    screen.say(f"wrote {out}")
    return CommandResult(
        {"file": str(out), "results": [{"name": each["title"], "answer": each["answer"]} for each in records]}
    )


def plot_command(
    figures: Sequence[str] = (),
    *,
    all_figures: bool = False,
    form: Sequence[str] = (),
    out: Path = Path("results/figures"),
    results: Path = Path("results"),
    x: str | None = None,
    y: str | None = None,
    by: str | None = None,
    colour: str | None = None,
    aggregate: str | None = None,
    where: Sequence[str] = (),
    force: bool = False,
    screen: Screen,
) -> CommandResult:
    """Draw figures as PNG and PDF, with their data as Parquet.

    The data of a figure are computed if they are not stored beside it, or by an older version of the code.

    Three other forms of this command draw results that you have stored. One draws the columns of a run over time:
    topcli plot RUN. Another draws measures of a sweep: topcli plot sweep NAME --x KEY --y MEASURE --by KEY. The third
    draws the Poincaré section of a run: topcli plot section NAME --colour verdict.

    Parameters
    ----------
    figures : sequence of str, optional
        Names of figures or stored runs, or the word sweep and a stored sweep, or section and a stored run.
    all_figures : bool, optional
        Draw all figures, but measure nothing that takes minutes.
    x : str, optional
        Put this key of a sweep, or column of a section, on the x axis.
    y : str, optional
        Put this measure of a sweep, or column of a section, on the y axis; with --colour, a key.
    by : str, optional
        Draw one curve of a sweep for each value of this key.
    colour : str, optional
        Colour a map of a sweep by this measure, or a section by verdict.
    aggregate : str, optional
        One value for all rows of a cell or point: their median, mean or max.
    where : sequence of str, optional
        Use only the rows of the sweep in which KEY has this value.
    """
    from topcli.figures.catalogue import FIGURES
    from topcli.figures.figure import DEFAULT_FORMATS, IMAGE_FORMATS, NothingMeasuredError
    from topcli.figures.stored import section_figure
    from topcli.figures.sweep import sweep_figure
    from topcli.plugins import plugin_failures

    if bool(figures) == all_figures:
        raise UsageError(f"give either names of figures or --all; figures: {', '.join(FIGURES)}")
    if unknown := [name for name in form if name not in IMAGE_FORMATS]:
        raise UsageError(f"--format {quoted(unknown[0])}: unknown format; use png, pdf or svg")
    word, places = (figures[0].lower(), figures[1:]) if figures else ("", ())
    choice = {"x": x, "y": y, "colour": colour, "by": by, "aggregate": aggregate, "where": where}
    unfit = () if word == "sweep" else list(choice)[3 if word == "section" else 0 :]
    if option := next((name for name in unfit if choice[name]), ""):
        raise UsageError(f"--{option} is only for sweeps: topcli plot sweep DIR/NAME --x KEY --y MEASURE")
    if word in ("sweep", "section"):
        example = "--x h --y max_error --by scheme" if word == "sweep" else "--colour verdict"
        if len(places) != 1:
            raise UsageError(f"plot {word}: name one folder, as in: topcli plot {word} DIR/NAME {example}")
        place = stored_place(places[0], results)
        chosen = [sweep_figure(place, **choice) if word == "sweep" else section_figure(place, x, y, colour)]
    else:
        for failure in plugin_failures().values() if all_figures else ():
            print_message(failure)
        chosen = [figure_called(name, results) for name in figures] or list(FIGURES.values())

    # figures of stored measurements are left out of --all where there are none
    files: dict[str, list[str]] = {}
    failures: list[TopcliError] = []
    screen.begin("plot", unit="figures")
    for number, figure in enumerate(chosen):
        screen(number, len(chosen))
        try:
            files[figure.name] = list(map(str, figure.make(out, tuple(dict.fromkeys(form)) or DEFAULT_FORMATS, force)))
        except TopcliError as error:
            if all_figures and isinstance(error, NothingMeasuredError):
                print_message(f"{figure.name}: skipped: {error}")
                continue
            if len(chosen) == 1:
                raise
            failures.append(error)
            print_message(f"error: {figure.name}: {error}")
        else:
            screen.show(f"{figure.name}: drawn: {', '.join(files[figure.name])}")
    data = {"figures": [{"name": name, "files": paths} for name, paths in files.items()]}
    if not failures:
        return CommandResult(data)
    print_message(f"{len(failures)} of {len(chosen)} figures failed")
    return CommandResult(data, ExitCode.PARTLY_FAILED if files else failures[0].exit_code)


def figure_called(name: str, results: Path) -> Figure:
    """Figure of the catalogue, or of a stored run."""
    from topcli.figures.catalogue import FIGURES, find_figure
    from topcli.store.results import read_result
    from topcli.sweeps.store import is_sweep

    for place in () if name.lower() in FIGURES else (Path(name), results / name):
        if os.path.isdir(place) and is_sweep(place):
            raise UsageError(f"{place} is a sweep; draw it with: topcli plot sweep {place} --x KEY --y MEASURE")
        if os.path.isdir(place) and (run := read_result(place)) and run.outcome:
            from topcli.figures.stored import run_figure

            return run_figure(run)
    return find_figure(name)


def animate_command(
    result: str,
    *,
    out: Path,
    seconds: float = 10.0,
    size: int = 720,
    results: Path = Path("results"),
    force: bool = False,
    screen: Screen,
) -> CommandResult:
    """Animate the body of a run, with the trace of its axis.

    The run must have recorded the attitude of the body (output.attitude). The animation begins with the run and ends
    before the body would turn too far from frame to frame. The file name must end in .gif or .mp4; an .mp4 file needs
    pip install 'topcli[video]'.

    Parameters
    ----------
    result : str
        Folder or name of a run.
    seconds : float, optional
        Make the animation this many seconds long.
    size : int, optional
        Set the width in pixels; the height is 2/3 of the width.
    """
    from topcli.figures.animation import FPS, frame_times, require_format, stored_body_motion, write_animation

    if not WIDTHS[0] <= size <= WIDTHS[1]:
        raise UsageError(f"--size {size}: must be {WIDTHS[0]} to {WIDTHS[1]} pixels")
    if not 0.1 <= seconds <= 600.0:
        raise UsageError(f"--seconds {seconds:g}: must be 0.1 to 600 seconds")
    require_format(out, seconds)  # before anything is read or drawn
    require_new_file(out, force)
    motion = stored_body_motion(stored_place(result, results))
    if motion.note:
        screen.warn(motion.note)
    times = frame_times(motion, max(2, round(FPS * seconds)))
    name, begin, end, last = motion.experiment.name, float(times[0]), float(times[-1]), float(motion.t[-1])
    if end != last:
        screen.warn(f"{name}: shows t = {begin:g} to {end:.4g} of {last:g}; more --seconds show more")
    screen.begin(str(out), unit="frames")
    write_animation(motion, times, out, size, screen)
    frames, width, height = len(times), 2 * (size // 2), 2 * round(size / 3.0)
    screen.show(f"{name}: {frames} frames, {width} x {height} -> {out}")
    content = {"file": str(out), "frames": frames, "fps": FPS, "width": width, "height": height}
    return CommandResult({"run": name, **content, "t_first": begin, "t_last": end})
