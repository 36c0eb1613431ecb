"""``topcli order``: error over h, with observed orders and the plateau of round-off."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from topcli.cli.options import Json, Out, SchemeFiles, Schemes, Sets, complete_config, complete_top, load_scheme_files
from topcli.cli.output import ProgressDisplay, emit, print_json, print_message, print_table, print_warnings
from topcli.errors import UsageError, quoted, shortened


def _print_study(study: dict[str, Any]) -> None:
    from topcli.studies.order_table import HEADER, error_lines, order_line, order_title

    print_table(HEADER, [order_line(row) for row in study["schemes"]], order_title(study))
    emit()
    header = ["h", *(row["scheme"] for row in study["schemes"])]
    print_table(header, error_lines(study["schemes"]), "largest error at each h", range(len(header)))


def _say_failures(study: dict[str, Any]) -> int:
    """Report schemes left out, code and settings that failed, and orders that are not as declared; the exit code."""
    from topcli.studies.order import FALSE

    for one in study["left_out"]:
        print_message(f"{one['scheme']} is left out: {one['reason']}")
    rows = study["schemes"]
    for row in rows:
        if row["broken"]:
            print_message(f"error: {row['scheme']}: {row['broken']}")
            continue
        if row["failed"]:
            first = row["failed"][0]
            failed = f"{len(row['failed'])} of its step sizes gave no result"
            print_message(f"{row['scheme']}: {failed}; h = {first['h']:.2g} {first['reason']}")
        if row["verdict"] in FALSE:
            print_message(f"error: {row['scheme']}: {row['why']}")
        elif row["why"] and len(row["points"]) > 2:
            print_message(f"{row['scheme']}: order undecided: {row['why']}")
    broken = [row for row in rows if row["broken"]]
    if broken:
        return 3 if len(broken) < len(rows) else 2
    if not all(row["points"] for row in rows):
        return 1
    return 4 if any(row["verdict"] in FALSE for row in rows) else 0


Top = Annotated[
    str | None,
    typer.Option("--top", metavar="TOP", help="Run the packaged scene of this top.", autocompletion=complete_top),
]
Config = Annotated[
    str | None,
    typer.Option(
        "--config", metavar="CONFIG", help="Run this config or scene for its N*h.", autocompletion=complete_config
    ),
]
Sizes = Annotated[
    list[str] | None,
    typer.Option("--h", metavar="H", help="Use this step size; repeat for several.", show_default="a ladder"),
]
Duration = Annotated[
    float | None, typer.Option("--duration", metavar="T", help="Run for the time T.", show_default="10, or N*h")
]
Steps = Annotated[int, typer.Option("--steps", metavar="N", help="Take at most N steps in a run of a ladder.", min=1)]
Plot = Annotated[bool, typer.Option("--plot", help="Draw the errors over h into DIR/figures.")]


def order(
    schemes: Schemes = None,
    top: Top = None,
    config: Config = None,
    sets: Sets = None,
    sizes: Sizes = None,
    duration: Duration = None,
    steps: Steps = 4_000_000,
    plot: Plot = False,
    out: Out = Path("results"),
    as_json: Json = False,
    scheme_files: SchemeFiles = None,
) -> None:
    """Measure errors over h, observed orders and round-off.

    Errors are the largest over the run against a reference in double-double arithmetic. The order is fitted at the
    smallest steps above the plateau of round-off. Exits with status 4 if it is below the declared order, and with 3 if
    the code of some of the schemes fails.
    """
    from topcli.store.run_folder import require_writable
    from topcli.studies.order import ladders, order_source, order_study, write_order

    load_scheme_files(scheme_files)
    what = ladders(
        schemes or (),
        top=top,
        config=config,
        sets=sets or (),
        sizes=_sizes(sizes or ()),
        duration=duration,
        steps=steps,
    )
    print_warnings(what.problem.experiment)
    default = what == ladders(())
    if plot or default:
        require_writable(out)
    _say_sizes(what.sizes, [rung.value for rung in what.rungs])
    display = ProgressDisplay(1, as_json)
    display.begin("order")
    try:
        study = order_study(what, display)
    finally:
        display.close()
    files = [str(write_order(study, out, order_source(what)))] if default else []
    if plot:
        from topcli.figures.make import write_figure
        from topcli.figures.order import loaded_order

        written = write_figure(f"order_{what.problem.name}", loaded_order(study, order_source(what)), out / "figures")
        files += [str(path) for path in written]
    if as_json:
        print_json("order", {**study, "files": files})
    else:
        _print_study(study)
        for file in files:
            print_message(f"wrote {file}")
    if code := _say_failures(study):
        raise typer.Exit(code)


def _sizes(texts: Sequence[str]) -> list[float]:
    """Step sizes of the options ``--h``. Raises UsageError."""
    try:
        return [float(text) for text in texts]
    except ValueError:
        given = [part.strip() for text in texts for part in text.split(",")]
        right = " ".join(f"--h {part}" for part in given)
        known = all(re.fullmatch(r"[-+.\deE]+", part) for part in given)
        raise UsageError(
            f"--h {quoted(','.join(texts))}: must be one number; "
            + (f"repeat the option for several: {shortened(right)}" if known else "for example --h 0.1 --h 0.05")
        ) from None


def _say_sizes(asked: tuple[float, ...], used: list[float]) -> None:
    """Report step sizes that had to be changed to divide the time between comparisons."""
    for size in asked:
        near = min(used, key=lambda one: abs(one - size))
        if abs(near - size) > 1e-9 * size:
            print_message(f"h = {size:g} becomes {near:.6g}, which divides the time between comparisons")
