"""``topcli analyse``: judge a series that another program wrote."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from topcli.cli.options import FigureOut, Json, SchemeFiles, Sets, config_option, load_scheme_files
from topcli.cli.output import emit, print_json, print_message, print_table, print_warnings

SHOWN = 5
"""Times of swings in the table; --json has them all."""

File = Annotated[Path, typer.Argument(metavar="FILE", help="CSV or Parquet file with t and the components.")]
Config = Annotated[str, config_option("Take top and initial state from a config.")]
Columns = Annotated[
    list[str] | None,
    typer.Option("--columns", metavar="NAME=COLUMN,...", help="Name columns, e.g. t=time,omega1=w_x."),
]
Steps = Annotated[
    int | None,
    typer.Option("--steps", metavar="COUNT", min=1, help="Set the steps taken; by default rows - 1."),
]
Plot = Annotated[bool, typer.Option("--plot", help="Draw errors, swings and deviations.")]


def _lines(report: dict[str, Any]) -> list[list[str]]:
    """Lines of the report before the invariants: a label and a cell each."""
    from topcli.table import exact_number, number

    about, swing = report["reference"], report["swing"]
    start = {"config": "the config's initial state", "first row": "the first row"}[about["start"]]
    error = "none" if about["message"] else start
    listed = ", ".join(map(exact_number, swing["times"][:SHOWN]))
    more = f" and {len(swing['times']) - SHOWN} more" if len(swing["times"]) > SHOWN else ""
    spacing = exact_number(swing["spacing"])
    if swing["reference_spacing"] is not None:
        spacing += f" (reference {exact_number(swing['reference_spacing'])})"
    return [
        ["rows", str(report["rows"])],
        ["times", f"{exact_number(report['t_first'])} to {exact_number(report['t_last'])}, {report['times']}"],
        ["steps", f"{report['steps']} ({report['steps_from']})"],
        ["reference from", error],
        ["first row − config", number(about["difference"])],
        ["max error", number(report["max_error"])],
        ["error at the end", number(report["end_error"])],
        [f"minima of {swing['component']}", (listed or "–") + more],
        ["their spacing", spacing],
    ]


def _print_report(report: dict[str, Any]) -> None:
    """Print the tables of the report."""
    from topcli.runs.report import invariant_table

    print_table([], _lines(report), f"{report['file']}: {report['top_title']}", numbers=False)
    emit()
    header, *lines = invariant_table(report)
    print_table(header, lines)


def _say_notes(report: dict[str, Any]) -> None:
    """Print what the tables leave out: a missing reference, a motion that was left, components that were not read."""
    if report["reference"]["message"]:
        print_message(f"warning: no error: {report['reference']['message']}")
    if left := report["left_motion"]:
        print_message(
            f"warning: {report['file']}: far off its energy surface at row {left['row']} (t = {left['t']:.6g})"
        )
    if report["unread"]:
        print_message(f"not read: {', '.join(report['unread'])}; the config's initial state has no such components")


def analyse(
    path: File,
    config: Config,
    columns: Columns = None,
    steps: Steps = None,
    sets: Sets = None,
    as_json: Json = False,
    plot: Plot = False,
    out: FigureOut = Path("results/figures"),
    scheme_files: SchemeFiles = None,
) -> None:
    """Judge a series of another program like a run.

    Its times may start anywhere, rise or fall, and be uneven. The error is measured against a solution that starts from
    the config's initial state if the first row agrees with that to 1e-6, and otherwise from the first row.
    """
    from topcli.config.load import load_experiment
    from topcli.store.foreign import ForeignSeries
    from topcli.store.run_folder import require_writable
    from topcli.studies.analyse import analyse_series, column_map

    load_scheme_files(scheme_files)
    experiment = load_experiment(config, sets or [])
    print_warnings(experiment)
    if plot:
        require_writable(out)
    analysis = analyse_series(experiment, ForeignSeries(path), column_map(columns or [], experiment.top), steps)
    files: list[str] = []
    if plot:
        from topcli.figures.analysis import loaded_analysis
        from topcli.figures.make import write_figure

        name = f"analyse_{experiment.name}_{path.stem}"
        files = [str(file) for file in write_figure(name, loaded_analysis(analysis, experiment.top), out)]
    if as_json:
        print_json("analyse", {**analysis.report, "files": files})
    else:
        _print_report(analysis.report)
        for file in files:
            print_message(f"wrote {file}")
    _say_notes(analysis.report)
