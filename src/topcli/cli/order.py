"""``topcli order``: error over h, with observed orders and the plateau of round-off."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from topcli.cli.options import Json, Out, SchemeFiles, Schemes, Sets, complete_config, complete_top, load_scheme_files
from topcli.cli.talk import ProgressDisplay, emit, print_json, print_table, say, say_warnings

HEADER = ("scheme", "order", "observed", "fitted over h", "round-off", "from h", "smallest error", "at h")


def _summary(row: dict[str, Any]) -> list[str]:
    """Line of one scheme: declared and observed order, the fitted step sizes, the plateau, the smallest error."""
    from topcli.studies.report import number

    best = min((one for one in row["points"] if one["error"] is not None), key=lambda one: one["error"], default=None)
    fitted = f"{number(row['fitted'][0], 2)} to {number(row['fitted'][-1], 2)}" if row["fitted"] else "–"
    return [
        row["scheme"],
        "–" if row["declared_order"] is None else str(row["declared_order"]),
        "–" if row["order"] is None else f"{row['order']:.2f}",
        fitted,
        number(row["plateau"], 2),
        number(row["onset"], 2),
        number(best and best["error"], 2),
        number(best and best["h"], 2),
    ]


def _error_lines(schemes: list[dict[str, Any]]) -> list[list[str]]:
    """Lines of the table of errors: a step size, then a cell for each scheme; a dash where it was not run."""
    from topcli.studies.report import number

    each = [{one["h"]: one["error"] for one in row["points"]} for row in schemes]
    lines = []
    for h in sorted({h for points in each for h in points}, reverse=True):
        cells = ["–" if h not in points else "nan" if points[h] is None else number(points[h], 2) for points in each]
        lines.append([f"{h:.4g}", *cells])
    return lines


def _print_study(study: dict[str, Any]) -> None:
    span = f"t from 0 to {study['duration']:g}"
    print_table(HEADER, [_summary(row) for row in study["schemes"]], f"{study['name']}: {study['top']}, {span}")
    emit()
    header = ["h", *(row["scheme"] for row in study["schemes"])]
    print_table(header, _error_lines(study["schemes"]), "largest error at each h", range(len(header)))


def _say_failures(study: dict[str, Any]) -> bool:
    """Report schemes left out and settings that failed; True if a scheme could not be measured."""
    for one in study["left_out"]:
        say(f"{one['scheme']} is left out: {one['reason']}")
    for row in study["schemes"]:
        if row["broken"]:
            say(f"error: {row['scheme']}: {row['broken']}")
        elif row["failed"]:
            first = row["failed"][0]
            failed = f"{len(row['failed'])} of its step sizes gave no result"
            say(f"{row['scheme']}: {failed}; h = {first['h']:.2g} {first['reason']}")
    return any(row["broken"] or not row["points"] for row in study["schemes"])


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
    list[float] | None,
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
    smallest steps above the plateau of round-off.
    """
    from topcli.store.run_folder import require_writable
    from topcli.studies.order import ladders, order_source, order_study, write_order

    load_scheme_files(scheme_files)
    what = ladders(
        schemes or (), top=top, config=config, sets=sets or (), sizes=sizes or (), duration=duration, steps=steps
    )
    say_warnings(what.problem.experiment)
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
            say(f"wrote {file}")
    if _say_failures(study):
        raise typer.Exit(1)


def _say_sizes(asked: tuple[float, ...], used: list[float]) -> None:
    """Report step sizes that had to be changed to divide the time between comparisons."""
    for size in asked:
        near = min(used, key=lambda one: abs(one - size))
        if abs(near - size) > 1e-9 * size:
            say(f"h = {size:g} becomes {near:.6g}, which divides the time between comparisons")
