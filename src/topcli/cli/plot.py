"""``topcli plot``: draw figures of the catalogue, sweeps, sections and runs."""

from __future__ import annotations

import os
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
from topcli.cli.output import ProgressDisplay, emit, print_json, print_message
from topcli.cli.results import Aggregate, Where

if TYPE_CHECKING:
    from topcli.errors import TopcliError
    from topcli.figures.figure import Figure

SECTION, SWEEP = "section", "sweep"
"""First arguments of ``topcli plot section DIR/NAME`` and ``topcli plot sweep DIR/NAME``, described by options."""

Names = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="FIGURE",
        help="Names of figures or stored runs, or the word sweep and a stored sweep, or section and stored runs.",
        autocompletion=complete_figure,
    ),
]
Every = Annotated[bool, typer.Option("--all", help="Draw all figures, but measure nothing that takes minutes.")]
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
    from topcli.store.files import sha256_of
    from topcli.sweeps.table import names_of, read_rows

    if len(names) != 2:
        example = "topcli plot sweep DIR/NAME --x h --y max_error --by scheme"
        raise UsageError(f"plot sweep: name one folder, as in: {example}")
    rows = read_rows(stored_place(names[1], results), where)
    x, y = options["x"], options["y"]
    if x is None or y is None:
        hint = "plot sweep: give --x KEY and --y MEASURE, or --x KEY --y KEY --colour MEASURE"
        raise UsageError(hint, names_of(rows))
    takes = f"{sha256_of(Path(rows.attrs['path']))} {where}"
    choice = Choice(x, y, options["by"], options["colour"], options["aggregate"])
    return sweep_figure(rows, choice, ", ".join([rows.attrs["name"], *where]), takes)


def _chosen(names: list[str], options: dict[str, str | None], where: list[str], results: Path) -> list[Figure]:
    """Figures named in the command, all of the catalogue without names."""
    from topcli.errors import UsageError
    from topcli.figures.catalogue import FIGURES

    word = names[0].lower() if names else ""
    if word == SWEEP:
        return [_sweep_figure(names, options, where, results)]
    if word == SECTION and not (options["by"] or options["aggregate"] or where):
        from topcli.figures.section import section_figure

        folders = [stored_place(name, results) for name in names[1:]]
        return [section_figure(folders, options["x"], options["y"], options["colour"])]
    given = [f"--{name}" for name, value in {**options, "where": where}.items() if value]
    if given:
        raise UsageError(f"{given[0]} is only for sweeps: topcli plot sweep DIR/NAME --x KEY --y MEASURE")
    if not names:
        from topcli.cli.listing import print_plugin_failures

        print_plugin_failures()  # figures of installed packages are drawn too
    return [_figure(name, results) for name in names] if names else list(FIGURES.values())


def _figure(name: str, results: Path) -> Figure:
    """Figure of the catalogue, or of a stored run."""
    from topcli.figures.catalogue import FIGURES, find_figure
    from topcli.store.results import read_result
    from topcli.sweeps.run import is_sweep

    place = place_of(name, results)
    stored = name.lower() not in FIGURES and os.path.isdir(place) and not is_sweep(place)
    if stored and (run := read_result(place)) and run.outcome:
        from topcli.figures.run import run_figure

        return run_figure(run)
    return find_figure(name)


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

    The data of a figure are computed if they are not stored beside it, or by an older version of the code.

    Three other forms of this command draw results that you have stored. One draws the columns of a run over time:
    topcli plot RUN. Another draws measures of a sweep: topcli plot sweep NAME --x KEY --y MEASURE --by KEY. The third
    draws the Poincaré sections of runs: topcli plot section NAME --colour verdict.
    """
    from topcli.errors import ExitCode, TopcliError, UsageError
    from topcli.figures.catalogue import FIGURES
    from topcli.figures.figure import NothingMeasuredError

    if bool(names) == every:
        raise UsageError(f"give either names of figures or --all; figures: {', '.join(FIGURES)}")
    kinds = picture_formats(formats)
    options = {"x": x, "y": y, "by": by, "colour": colour, "aggregate": aggregate}
    with hint_instead(names or [], lambda name: plot_hint(name, results)):
        figures = _chosen(names or [], options, where or [], results)

    # those that draw stored measurements are left out of --all where there are none
    files: dict[str, list[str]] = {}
    failed: list[TopcliError] = []
    display = ProgressDisplay(1, as_json or quiet, unit="figures")
    display.begin("plot")
    for number, figure in enumerate(figures):
        display(number, len(figures))
        try:
            files[figure.name] = list(map(str, figure.make(out, kinds, force)))
        except NothingMeasuredError as error:
            if not every:
                raise
            print_message(f"{figure.name}: skipped: {error}")
        except TopcliError as error:
            if len(figures) == 1:
                raise
            failed.append(error)
            print_message(f"error: {figure.name}: {error}")
        else:
            if not (as_json or quiet):
                emit(f"{figure.name}: drawn: {', '.join(files[figure.name])}")
    display.close()
    if as_json:
        print_json("plot", {"figures": [{"name": name, "files": paths} for name, paths in files.items()]})
    if failed:
        print_message(f"{len(failed)} of {len(figures)} figures failed")
        raise typer.Exit(ExitCode.PARTLY_FAILED if files else failed[0].exit_code)
