"""``topcli plot``: figures, from run folders, running what is missing."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from topcli.cli.options import Force, Json, complete_figure
from topcli.cli.talk import ProgressTeller, emit, print_json, say

STRESS = "stress"
"""The figure that is made from a study of its own and not from run folders."""


def plot(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="FIGURE", help="Names of figures.", autocompletion=complete_figure),
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="All figures but stress, which takes long.")] = False,
    formats: Annotated[
        list[str] | None,
        typer.Option("--format", metavar="FORMAT", help="png or pdf; may be given twice. Default: both."),
    ] = None,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder of the figures.")] = Path("results/figures"),
    results: Annotated[Path, typer.Option("--results", metavar="DIR", help="Folder of the run folders.")] = Path(
        "results"
    ),
    configs: Annotated[
        Path | None,
        typer.Option(
            "--configs",
            metavar="DIR",
            help="Folder of the configs; packaged scenes where it has none.",
            show_default="configs",
        ),
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Draw figures as PNG and PDF, with their data as Parquet."""
    from topcli.errors import UsageError, shortened
    from topcli.figures.catalogue import FIGURES, figure_spec
    from topcli.figures.make import make_figure
    from topcli.figures.picture import IMAGE_FORMATS, NothingMeasuredError

    if bool(names) == every:
        raise UsageError(f"name figures or say --all, one of the two; figures: {', '.join(FIGURES)}, {STRESS}")
    wrong = [name for name in formats or () if name not in IMAGE_FORMATS]
    if wrong:
        raise UsageError(
            f"--format {shortened(wrong[0])}: not a picture format here; choose from {', '.join(IMAGE_FORMATS)}"
        )
    if configs is not None and not os.path.isdir(configs):
        raise UsageError(f"--configs {configs}: no such folder")
    wanted = [name.lower() for name in names or ()]
    with_stress = STRESS in wanted
    specs = list(FIGURES.values()) if every else [figure_spec(name) for name in wanted if name != STRESS]
    teller = ProgressTeller(len(specs) + with_stress, as_json)
    made = []
    if with_stress:
        from topcli.figures.stress import make_stress

        teller.begin(STRESS)
        chosen = tuple(dict.fromkeys(formats or IMAGE_FORMATS))
        one = make_stress(out=out, results=results, formats=chosen, force=force, progress=teller)
        teller.close()
        made.append(one)
        if not as_json:
            emit(f"{one.name}: {one.status}: {', '.join(str(path) for path in one.files)}")
    for spec in specs:
        teller.begin(spec.scene)
        try:
            one = make_figure(
                spec,
                out=out,
                results=results,
                configs=Path("configs") if configs is None else configs,
                formats=tuple(dict.fromkeys(formats or IMAGE_FORMATS)),
                force=force,
                progress=teller,
                told=say,
            )
        except NothingMeasuredError as nothing:
            if not every:
                raise
            say(f"{spec.name}: skipped: {nothing}")
            continue
        teller.close()
        made.append(one)
        if not as_json:
            emit(f"{one.name}: {one.status}: {', '.join(str(path) for path in one.files)}")
    if as_json:
        figures = [{"name": m.name, "status": m.status, "files": [str(path) for path in m.files]} for m in made]
        print_json("plot", {"figures": figures})
