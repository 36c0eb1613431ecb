"""``topcli plot``: draw figures from results, producing missing ones."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from topcli.cli.options import FigureOut, Force, Json, complete_figure
from topcli.cli.talk import ProgressDisplay, emit, print_json, say

Names = Annotated[
    list[str] | None,
    typer.Argument(metavar="FIGURE", help="Names of figures; see topcli list figures.", autocompletion=complete_figure),
]
Every = Annotated[bool, typer.Option("--all", help="Draw all; skip what takes minutes to measure.")]
Formats = Annotated[
    list[str] | None, typer.Option("--format", metavar="FORMAT", help="Write png or pdf; both by default.")
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


def plot(
    names: Names = None,
    every: Every = False,
    formats: Formats = None,
    out: FigureOut = Path("results/figures"),
    results: Results = Path("results"),
    configs: Configs = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Draw figures as PNG and PDF, with their data as Parquet."""
    from topcli.errors import UsageError, shortened
    from topcli.figures.catalogue import FIGURES, find_figure
    from topcli.figures.contract import NothingMeasuredError, Request
    from topcli.figures.make import make_figure
    from topcli.figures.picture import IMAGE_FORMATS

    if bool(names) == every:
        raise UsageError(f"give either names of figures or --all; figures: {', '.join(FIGURES)}")
    wrong = [name for name in formats or () if name not in IMAGE_FORMATS]
    if wrong:
        raise UsageError(f"--format {shortened(wrong[0])}: unknown format; use {' or '.join(IMAGE_FORMATS)}")
    if configs is not None and not os.path.isdir(configs):
        raise UsageError(f"--configs {configs}: no such folder")
    chosen = tuple(dict.fromkeys(formats or IMAGE_FORMATS))
    figures = [find_figure(name) for name in names] if names else list(FIGURES.values())
    display = ProgressDisplay(len(figures), as_json)
    request = Request(results, configs or Path("configs"), force, every, display, say)
    made = []
    for figure in figures:
        display.begin(figure.name)
        try:
            one = make_figure(figure, request, out, chosen)
        except NothingMeasuredError as nothing:
            if not every:
                raise
            say(f"{figure.name}: skipped: {nothing}")
            continue
        finally:
            display.close()
        made.append(one)
        if not as_json:
            emit(f"{one.name}: {one.status}: {', '.join(str(path) for path in one.files)}")
    if as_json:
        items = [{"name": one.name, "status": one.status, "files": [str(path) for path in one.files]} for one in made]
        print_json("plot", {"figures": items})
