"""``topcli plot``: draw figures from results, producing missing ones."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from topcli.cli.options import FigureOut, Force, Json, Sets, complete_figure, hint_instead, plot_hint
from topcli.cli.output import ProgressDisplay, emit, print_json, print_message
from topcli.cli.results import Aggregate, Where

if TYPE_CHECKING:
    from topcli.errors import TopcliError
    from topcli.figures.figure import Figure, MadeFigure, Request

OVERLAY = "exact"
SECTION = "section"
"""First argument of ``topcli plot section DIR/NAME``, which draws the crossings of runs."""
SWEEP = "sweep"
"""First argument of ``topcli plot sweep DIR/NAME``, whose figure is described by options."""

Names = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="FIGURE",
        help="Names of figures, see topcli list figures; or the word sweep or section and folders DIR/NAME.",
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
Jobs = Annotated[
    int | None,
    typer.Option("--jobs", metavar="N", min=1, help="Draw N figures at once; with --all one per core."),
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
KeyX = Annotated[
    str | None, typer.Option("--x", metavar="KEY", help="Draw a sweep over this key, or a section over this column.")
]
MeasureY = Annotated[
    str | None,
    typer.Option(
        "--y", metavar="MEASURE", help="Draw this measure of a sweep (with --colour: key), or column of a section."
    ),
]
KeyBy = Annotated[
    str | None, typer.Option("--by", metavar="KEY", help="Of a sweep: draw a curve for each value of this key.")
]
Colour = Annotated[
    str | None,
    typer.Option(
        "--colour", metavar="MEASURE", help="Of a sweep: draw a heat map of this measure; of a section: verdict."
    ),
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

    if names and names[0].lower() == SECTION and not (options["by"] or options["aggregate"] or where):
        from topcli.figures.section import section_figure

        return [section_figure([Path(name) for name in names[1:]], options["x"], options["y"], options["colour"])]
    if names and names[0].lower() == SWEEP:
        return [_sweep_figure(names, options, where)]
    given = [f"--{name}" for name, value in {**options, "where": where}.items() if value]
    if given:
        raise UsageError(f"{given[0]} belongs to sweeps: topcli plot sweep DIR/NAME --x KEY --y MEASURE")
    if not names:
        from topcli.cli.listing import print_plugin_failures

        print_plugin_failures()  # figures of installed packages are drawn too
    return [find_figure(name) for name in names] if names else list(FIGURES.values())


def _require_able(figures: list[Figure], sets: bool, overlay: bool) -> None:
    """Raise UsageError for a figure that cannot take overrides or an overlay."""
    from topcli.errors import UsageError
    from topcli.figures.catalogue import FIGURES

    for given, name, able in (
        (sets, "--set", lambda figure: figure.takes_overrides),
        (overlay, f"--overlay {OVERLAY}", lambda figure: figure.takes_overlay),
    ):
        unable = [figure.name for figure in figures if not able(figure)]
        if given and unable:
            known = ", ".join(figure.name for figure in FIGURES.values() if able(figure))
            raise UsageError(f"{name}: {unable[0]} is not drawn from runs of one config; use it with {known}")


class _Watch:
    """Progress of figures: of each one after the other, or of all that are drawn at the same time."""

    def __init__(self, figures: list[Figure], jobs: int, quiet: bool) -> None:
        self.together, self.count = min(jobs, len(figures)) > 1, len(figures)
        self.display = ProgressDisplay(
            1 if self.together else len(figures), quiet, unit="figures" if self.together else "steps"
        )
        self.parts: dict[str, float] = {}
        self.ended = 0
        if self.together:
            self.display.begin("figures")

    def __call__(self, name: str, done: int, total: int) -> None:
        """Show that ``done`` of ``total`` parts of the data of the figure ``name`` are done."""
        if not self.together:
            if name not in self.parts:
                self.display.begin(name)
            else:
                self.display(done, total)
        self.parts[name] = done / total
        if self.together:
            drawn = ", ".join(f"{each} {100.0 * part:.0f}%" if part else each for each, part in self.parts.items())
            self.display(self.ended, self.count, f"drawing {drawn}")

    def end(self, name: str) -> None:
        """The figure ``name`` is drawn, or has failed."""
        self.parts.pop(name, None)
        self.ended += 1
        if not self.together:
            self.display.close()


def _require_options(
    names: list[str], every: bool, formats: list[str], overlay: str | None, configs: Path | None
) -> None:
    """Raise UsageError for options that are wrong whatever is drawn."""
    from topcli.errors import UsageError, shortened
    from topcli.figures.catalogue import FIGURES
    from topcli.figures.picture import IMAGE_FORMATS

    if bool(names) == every:
        raise UsageError(f"give either names of figures or --all; figures: {', '.join(FIGURES)}")
    wrong = [name for name in formats if name not in IMAGE_FORMATS]
    if wrong:
        raise UsageError(f"--format {shortened(wrong[0])}: unknown format; use png, pdf or svg")
    if overlay not in (None, OVERLAY):
        raise UsageError(f"--overlay {shortened(overlay)}: unknown overlay; use {OVERLAY}")
    if configs is not None and not os.path.isdir(configs):
        raise UsageError(f"--configs {configs}: no such folder")


def _draw(
    figures: list[Figure], request: Request, out: Path, formats: tuple[str, ...], jobs: int, quiet: bool
) -> tuple[list[MadeFigure], list[TopcliError]]:
    """Draw figures and report on each; the files of those that were drawn, in the order given, and the errors.

    Raises the error of a single figure. Of all figures, those without stored results are skipped.
    """
    from topcli.errors import TopcliError
    from topcli.figures.figure import NothingMeasuredError, make_figures

    watch = _Watch(figures, jobs, quiet)
    drawn, failed = {}, []
    with contextlib.ExitStack() as stack:
        stack.callback(watch.display.close)
        outcomes = stack.enter_context(contextlib.closing(make_figures(figures, request, out, formats, jobs, watch)))
        for figure, outcome in outcomes:
            watch.end(figure.name)
            if isinstance(outcome, NothingMeasuredError) and request.stored_only:
                print_message(f"{figure.name}: skipped: {outcome}")
            elif isinstance(outcome, TopcliError):
                if len(figures) == 1:
                    raise outcome
                failed.append(outcome)
                first, *others = outcome.lines
                print_message(f"error: {first}" if first.startswith(figure.name) else f"error: {figure.name}: {first}")
                for line in others:
                    print_message(line)
            else:
                drawn[figure.name] = outcome
                if not quiet:
                    emit(f"{outcome.name}: {outcome.status}: {', '.join(str(path) for path in outcome.files)}")
    return [drawn[figure.name] for figure in figures if figure.name in drawn], failed


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
    jobs: Jobs = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Draw figures as PNG and PDF, with their data as Parquet.

    For a sweep: topcli plot sweep DIR/NAME --x KEY --y MEASURE --by KEY.
    For runs with a section: topcli plot section DIR/NAME --colour verdict.
    For a run: topcli report DIR/NAME --out FILE.html.
    --set changes the runs that a figure draws, and its file has digits of
    the changed experiment in its name.
    """
    from topcli.engine.ensemble import default_threads
    from topcli.errors import ExitCode
    from topcli.figures.figure import Request
    from topcli.figures.picture import DEFAULT_FORMATS
    from topcli.figures.style import read_style

    _require_options(names or [], every, formats or [], overlay, configs)
    looks = read_style(style) if style else {}
    options = {"x": x, "y": y, "by": by, "colour": colour, "aggregate": aggregate}
    with hint_instead(names or [], lambda name: plot_hint(name, results)):
        figures = _chosen(names or [], options, where or [])
    _require_able(figures, bool(sets), overlay is not None)
    request = Request(
        results=results,
        configs=configs or Path("configs"),
        force=force,
        stored_only=every,
        on_message=print_message,
        overrides=tuple(sets or ()),
        overlay=overlay is not None,
        style=looks,
    )
    chosen = tuple(dict.fromkeys(formats or DEFAULT_FORMATS))
    drawn, failed = _draw(figures, request, out, chosen, jobs or (default_threads() if every else 1), as_json)
    if as_json:
        items = [
            {"name": figure.name, "status": figure.status, "files": list(map(str, figure.files))} for figure in drawn
        ]
        print_json("plot", {"figures": items})
    if failed:
        print_message(f"{len(failed)} of {len(figures)} figures failed")
        raise typer.Exit(ExitCode.PARTLY_FAILED if drawn else failed[0].exit_code)
