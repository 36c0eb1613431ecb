"""``topcli plot``: draw figures from results, producing missing ones."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from topcli.cli.hints import hint_instead, plot_hint
from topcli.cli.options import FigureOut, Force, Json, Sets, complete_figure
from topcli.cli.output import ProgressDisplay, emit, print_json, print_message
from topcli.cli.table import Aggregate, Where

if TYPE_CHECKING:
    from topcli.figures.contract import Figure

EXACT = "exact"
SWEEP = "sweep"
"""First argument of ``topcli plot sweep DIR/NAME``, whose figure is described by options."""

Names = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="FIGURE",
        help="Names of figures, see topcli list figures; or the word sweep and the folder DIR/NAME of a sweep.",
        autocompletion=complete_figure,
    ),
]
Every = Annotated[bool, typer.Option("--all", help="Draw all; skip what takes minutes to measure.")]
Formats = Annotated[
    list[str] | None, typer.Option("--format", metavar="FORMAT", help="Write png, pdf or svg; png and pdf by default.")
]
Overlay = Annotated[
    str | None,
    typer.Option("--overlay", metavar="exact", help="Draw the exact motion in grey behind runs."),
]
StyleFile = Annotated[
    Path | None, typer.Option("--style", metavar="FILE", help="Apply a style file of matplotlib (.mplstyle).")
]
Results = Annotated[Path, typer.Option("--results", metavar="DIR", help="Read and write run folders in this folder.")]
Configs = Annotated[
    Path | None,
    typer.Option(
        "--configs",
        metavar="DIR",
        help="Use configs in this folder instead of packaged scenes.",
        show_default="configs",
    ),
]
KeyX = Annotated[str | None, typer.Option("--x", metavar="KEY", help="Of a sweep: draw over this key.")]
MeasureY = Annotated[
    str | None,
    typer.Option("--y", metavar="MEASURE", help="Of a sweep: draw this measure; with --colour, over this key."),
]
KeyBy = Annotated[
    str | None, typer.Option("--by", metavar="KEY", help="Of a sweep: draw a curve for each value of this key.")
]
Colour = Annotated[
    str | None, typer.Option("--colour", metavar="MEASURE", help="Of a sweep: draw a heat map of this measure.")
]


def _sweep_figure(names: list[str], options: dict[str, str | None], where: list[str]) -> Figure:
    """The figure of a sweep that the arguments and options describe."""
    from topcli.errors import UsageError
    from topcli.figures.sweep import Choice, sweep_figure
    from topcli.sweeps.rows import read_rows

    if len(names) != 2:
        raise UsageError(
            "plot sweep: name one folder, as in: topcli plot sweep DIR/NAME --x h --y error.max --by scheme"
        )
    x, y = options.pop("x"), options.pop("y")
    rows = read_rows(Path(names[1]))
    if x is None or y is None:
        known = f"keys: {', '.join(rows.keys)}; measures: {', '.join(rows.measures)}"
        raise UsageError("plot sweep: give --x KEY and --y MEASURE, or --x KEY --y KEY --colour MEASURE", known)
    choice = Choice(x, y, **options)
    choice.require(rows)
    return sweep_figure(rows.where(where), choice)


def _chosen(names: list[str], options: dict[str, str | None], where: list[str]) -> list[Figure]:
    """Figures named in the command, all of the catalogue without names."""
    from topcli.errors import UsageError
    from topcli.figures.catalogue import FIGURES, find_figure

    if names and names[0].lower() == SWEEP:
        return [_sweep_figure(names, options, where)]
    given = [f"--{name}" for name, value in {**options, "where": where}.items() if value]
    if given:
        raise UsageError(f"{given[0]} belongs to sweeps: topcli plot sweep DIR/NAME --x KEY --y MEASURE")
    return [find_figure(name) for name in names] if names else list(FIGURES.values())


def _require(figures: list[Figure], sets: bool, overlay: bool) -> None:
    """Raise UsageError for a figure that cannot take overrides or an overlay."""
    from topcli.errors import UsageError
    from topcli.figures.catalogue import FIGURES

    for given, name, able in (
        (sets, "--set", lambda figure: figure.takes_overrides),
        (overlay, f"--overlay {EXACT}", lambda figure: figure.takes_overlay),
    ):
        unable = [figure.name for figure in figures if not able(figure)]
        if given and unable:
            known = ", ".join(figure.name for figure in FIGURES.values() if able(figure))
            raise UsageError(f"{name}: {unable[0]} is not drawn from runs of one config; use it with {known}")


def plot(
    names: Names = None,
    every: Every = False,
    formats: Formats = None,
    out: FigureOut = Path("results/figures"),
    results: Results = Path("results"),
    configs: Configs = None,
    x: KeyX = None,
    y: MeasureY = None,
    by: KeyBy = None,
    colour: Colour = None,
    aggregate: Aggregate = None,
    where: Where = None,
    sets: Sets = None,
    overlay: Overlay = None,
    style: StyleFile = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Draw figures as PNG and PDF, with their data as Parquet.

    For a sweep: topcli plot sweep DIR/NAME --x KEY --y MEASURE --by KEY.
    For a run: topcli report DIR/NAME --out FILE.html.
    --set changes the runs that a figure draws, and its file has digits of
    the changed experiment in its name.
    """
    from topcli.errors import UsageError, shortened
    from topcli.figures.catalogue import FIGURES
    from topcli.figures.contract import NothingMeasuredError, Request
    from topcli.figures.make import make_figure
    from topcli.figures.picture import DEFAULT_FORMATS, IMAGE_FORMATS
    from topcli.figures.style import read_style

    if bool(names) == every:
        raise UsageError(f"give either names of figures or --all; figures: {', '.join(FIGURES)}")
    wrong = [name for name in formats or () if name not in IMAGE_FORMATS]
    if wrong:
        raise UsageError(f"--format {shortened(wrong[0])}: unknown format; use png, pdf or svg")
    if overlay not in (None, EXACT):
        raise UsageError(f"--overlay {shortened(overlay)}: unknown overlay; use {EXACT}")
    if configs is not None and not os.path.isdir(configs):
        raise UsageError(f"--configs {configs}: no such folder")
    chosen = tuple(dict.fromkeys(formats or DEFAULT_FORMATS))
    looks = read_style(style) if style else {}
    options = {"x": x, "y": y, "by": by, "colour": colour, "aggregate": aggregate}
    with hint_instead(names or [], lambda name: plot_hint(name, results)):
        figures = _chosen(names or [], options, where or [])
    _require(figures, bool(sets), overlay is not None)
    display = ProgressDisplay(len(figures), as_json)
    request = Request(
        results,
        configs or Path("configs"),
        force,
        every,
        display,
        print_message,
        tuple(sets or ()),
        overlay is not None,
        looks,
    )
    made = []
    for figure in figures:
        display.begin(figure.name)
        try:
            one = make_figure(figure, request, out, chosen)
        except NothingMeasuredError as nothing:
            if not every:
                raise
            print_message(f"{figure.name}: skipped: {nothing}")
            continue
        finally:
            display.close()
        made.append(one)
        if not as_json:
            emit(f"{one.name}: {one.status}: {', '.join(str(path) for path in one.files)}")
    if as_json:
        items = [{"name": one.name, "status": one.status, "files": [str(path) for path in one.files]} for one in made]
        print_json("plot", {"figures": items})
