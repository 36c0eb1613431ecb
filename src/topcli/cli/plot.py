"""``topcli plot``: draw figures from results, producing missing ones."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from topcli.cli.options import (
    Force,
    Json,
    Out,
    PictureFormats,
    Quiet,
    Results,
    complete_figure,
    hint_instead,
    picture_formats,
    place_of,
    plot_hint,
    stored_place,
)
from topcli.cli.output import ProgressDisplay, emit, messages, print_json, print_message
from topcli.cli.results import Aggregate, Where
from topcli.store.files import is_study

if TYPE_CHECKING:
    from topcli.errors import TopcliError
    from topcli.figures.figure import Figure, MadeFigure, Request

SECTION = "section"
"""First argument of ``topcli plot section DIR/NAME``, which draws the crossings of runs."""
SWEEP = "sweep"
"""First argument of ``topcli plot sweep DIR/NAME``, whose figure is described by options."""

Names = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="FIGURE",
        help="Names of figures, or the word sweep and a stored sweep, or the word section and stored runs.",
        autocompletion=complete_figure,
    ),
]
Every = Annotated[bool, typer.Option("--all", help="Draw all figures, but compute nothing that takes minutes.")]
KeyX = Annotated[
    str | None,
    typer.Option("--x", metavar="KEY", help="Put this key of a sweep, or column of a section, on the x axis."),
]
MeasureY = Annotated[
    str | None,
    typer.Option(
        "--y",
        metavar="MEASURE",
        help="Put this measure of a sweep, or column of a section, on the y axis. With --colour, give a key.",
    ),
]
KeyBy = Annotated[
    str | None, typer.Option("--by", metavar="KEY", help="Draw one curve of a sweep for each value of this key.")
]
Colour = Annotated[
    str | None,
    typer.Option(
        "--colour", metavar="MEASURE", help="Colour a map of a sweep by this measure, or a section by verdict."
    ),
]


def _sweep_figure(names: list[str], options: dict[str, str | None], where: list[str], results: Path) -> Figure:
    """The figure of a sweep that the arguments and options describe."""
    from topcli.errors import UsageError
    from topcli.figures.sweep import Choice, sweep_figure
    from topcli.sweeps.rows import read_rows

    if len(names) != 2:
        raise UsageError(
            "plot sweep: name one folder, as in: topcli plot sweep DIR/NAME --x h --y max_error --by scheme"
        )
    x, y = options["x"], options["y"]
    rows = read_rows(stored_place(names[1], results))
    if x is None or y is None:
        hint = "plot sweep: give --x KEY and --y MEASURE, or --x KEY --y KEY --colour MEASURE"
        raise UsageError(hint, rows.names)
    choice = Choice(x, y, options["by"], options["colour"], options["aggregate"])
    choice.require(rows)
    return sweep_figure(rows.where(where), choice)


def _chosen(names: list[str], options: dict[str, str | None], where: list[str], results: Path) -> list[Figure]:
    """Figures named in the command, all of the catalogue without names."""
    from topcli.errors import UsageError
    from topcli.figures.catalogue import FIGURES

    if names and names[0].lower() == SECTION and not (options["by"] or options["aggregate"] or where):
        from topcli.figures.section import section_figure

        return [
            section_figure(
                [stored_place(name, results) for name in names[1:]], options["x"], options["y"], options["colour"]
            )
        ]
    if names and names[0].lower() == SWEEP:
        return [_sweep_figure(names, options, where, results)]
    given = [f"--{name}" for name, value in {**options, "where": where}.items() if value]
    if given:
        raise UsageError(f"{given[0]} is only for sweeps: topcli plot sweep DIR/NAME --x KEY --y MEASURE")
    if not names:
        from topcli.cli.listing import print_plugin_failures

        print_plugin_failures()  # figures of installed packages are drawn too
    return [_figure(name, results) for name in names] if names else list(FIGURES.values())


def _figure(name: str, results: Path) -> Figure:
    """Figure of the catalogue, or of the result of a study in a file."""
    from topcli.figures.catalogue import FIGURES, find_figure

    file = place_of(name, results)
    if name.lower() not in FIGURES and is_study(file):
        from topcli.show.tables import study_figure

        return study_figure(file)
    return find_figure(name)


def _draw(
    figures: list[Figure], every: bool, request: Request, out: Path, formats: tuple[str, ...], quiet: bool
) -> tuple[list[MadeFigure], list[TopcliError]]:
    """Draw figures and report on each; the files of those that were drawn, in the order given, and the errors.

    Raises the error of a single figure. If ``every`` figure is drawn, those without stored results are skipped.
    """
    from topcli.errors import TopcliError
    from topcli.figures.figure import NothingMeasuredError, make_figure

    drawn, failed = [], []
    display = ProgressDisplay(len(figures), quiet, unit="parts")
    for figure in figures:
        display.begin(figure.name)
        try:
            with contextlib.closing(display):
                made = make_figure(figure, replace(request, on_progress=display), out, formats)
        except TopcliError as error:
            if every and isinstance(error, NothingMeasuredError):
                print_message(f"{figure.name}: skipped: {error}")
                continue
            if len(figures) == 1:
                raise
            failed.append(error)
            first, *others = error.lines
            print_message(f"error: {first}" if first.startswith(figure.name) else f"error: {figure.name}: {first}")
            for line in others:
                print_message(line)
        else:
            drawn.append(made)
            if not quiet:
                emit(f"{made.name}: {made.status}: {', '.join(str(path) for path in made.files)}")
    return drawn, failed


def plot(
    names: Names = None,
    every: Every = False,
    formats: PictureFormats = None,
    out: Out = Path("results/figures"),
    results: Results = Path("results"),
    x: KeyX = None,
    y: MeasureY = None,
    by: KeyBy = None,
    colour: Colour = None,
    aggregate: Aggregate = None,
    where: Where = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Draw figures as PNG and PDF, with their data as Parquet.

    If the results that a figure needs are missing, topcli computes them first and stores them in the folder of
    --results. A figure that is up to date is not drawn again.

    Two other forms of this command draw results that you have stored. One draws measures of a sweep: topcli plot sweep
    NAME --x KEY --y MEASURE --by KEY. The other draws the Poincaré sections of runs: topcli plot section NAME --colour
    verdict. To draw a single run, use topcli report.
    """
    from topcli.errors import ExitCode, UsageError
    from topcli.figures.catalogue import FIGURES
    from topcli.figures.figure import Request

    if bool(names) == every:
        raise UsageError(f"give either names of figures or --all; figures: {', '.join(FIGURES)}")
    chosen = picture_formats(formats)
    options = {"x": x, "y": y, "by": by, "colour": colour, "aggregate": aggregate}
    with hint_instead(names or [], lambda name: plot_hint(name, results)):
        figures = _chosen(names or [], options, where or [], results)
    request = Request(results=results, force=force, on_message=messages(quiet))
    drawn, failed = _draw(figures, every, request, out, chosen, as_json or quiet)
    if as_json:
        items = [
            {"name": figure.name, "status": figure.status, "files": list(map(str, figure.files))} for figure in drawn
        ]
        print_json("plot", {"figures": items})
    if failed:
        print_message(f"{len(failed)} of {len(figures)} figures failed")
        raise typer.Exit(ExitCode.PARTLY_FAILED if drawn else failed[0].exit_code)
