"""``topcli roundoff``: how a scheme's round-off grows with the number of steps."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from topcli.cli.options import FigureOut, Json, SchemeFiles, Sets, complete_config, complete_scheme, load_scheme_files
from topcli.cli.talk import print_json, print_table, say, say_warnings

HEADER = (
    "invariant",
    "sums",
    "drift (rms)",
    "largest",
    "exponent",
    "growth",
    "bias per step",
    "ns/step",
    "cost",
)


def _cells(form: dict[str, Any], row: dict[str, Any]) -> list[str]:
    from topcli.studies.report import number

    exponent = "–" if row["exponent"] is None else f"{row['exponent']:.2f} ± {row['exponent_error']:.2f}"
    return [
        row["symbol"],
        form["form"],
        number(row["drift"], 2),
        number(row["max_drift"], 2),
        exponent,
        row["verdict"],
        "–" if row["bias"] is None else f"{number(row['bias'], 2)} ± {number(row['bias_error'], 2)}",
        f"{form['nanoseconds_per_step']:.1f}",
        f"{form['cost']:.2f}",
    ]


def _violations(form: dict[str, Any], max_exponent: float | None, max_drift: float | None) -> list[str]:
    """What the form violates of the stated tolerances, a line each."""
    said = []
    for row in form["invariants"]:
        where = f"{row['name']} of {form['scheme']} with {form['form']} sums"
        exponent, error = row["exponent"], row["exponent_error"]
        if max_exponent is not None and exponent is not None and exponent - 2.0 * error > max_exponent:
            said.append(f"{where}: exponent {exponent:.2f} ± {error:.2f} exceeds {max_exponent:g}")
        if max_drift is not None and row["max_drift"] > max_drift:
            said.append(f"{where}: drift {row['max_drift']:.1e} exceeds {max_drift:g}")
    return said


def roundoff(
    scheme: Annotated[str, typer.Argument(metavar="SCHEME", help="Name of a scheme.", autocompletion=complete_scheme)],
    config: Annotated[
        str | None,
        typer.Option(
            "--config",
            metavar="CONFIG",
            help="The experiment; a packaged scene at h = 0.01 by default.",
            autocompletion=complete_config,
        ),
    ] = None,
    steps: Annotated[float, typer.Option("--steps", metavar="N", help="Steps of each copy, e.g. 1e8.")] = 1e7,
    copies: Annotated[
        int, typer.Option("--copies", metavar="K", help="Runs whose states differ in the last two digits.")
    ] = 8,
    max_exponent: Annotated[
        float | None,
        typer.Option("--max-exponent", metavar="X", help="Exit with 4 if an exponent is above this, by two errors."),
    ] = None,
    max_drift: Annotated[
        float | None,
        typer.Option("--max-drift", metavar="X", help="Exit with 4 if a drift of any copy is above this."),
    ] = None,
    sets: Sets = None,
    as_json: Json = False,
    plot: Annotated[bool, typer.Option("--plot", help="Draw the drift against the number of steps.")] = False,
    out: FigureOut = Path("results/figures"),
    scheme_files: SchemeFiles = None,
) -> None:
    """Measure how round-off grows, and what compensation costs.

    It grows as a random walk, with a bias, or not at all, with plain and with compensated sums. Tolerances are
    those of the compensated form where a scheme has one.
    """
    from topcli.errors import UsageError
    from topcli.store.run_folder import require_writable
    from topcli.studies.roundoff import roundoff_experiment, roundoff_study

    load_scheme_files(scheme_files)
    if not 1.0 <= steps <= 1e12 or steps != int(steps):
        raise UsageError(f"--steps {steps:g}: must be a whole number from 1 to 1e12")
    experiment = roundoff_experiment(scheme, config, sets or [])
    say_warnings(experiment)
    if plot:
        require_writable(out)
    found = roundoff_study(experiment, int(steps), copies)
    failed = [form for form in found["forms"] if form["outcome"] != "completed"]
    files: list[str] = []
    if plot and not failed:
        from topcli.figures.make import write_figure
        from topcli.figures.roundoff import loaded_roundoff

        name = f"roundoff_{experiment.scheme.name}_{experiment.name}"
        files = [str(path) for path in write_figure(name, loaded_roundoff(found), out)]
    violations = _violations(found["forms"][-1], max_exponent, max_drift)
    if as_json:
        print_json("roundoff", {**found, "violations": violations, "files": files})
    else:
        rows = [_cells(form, row) for form in found["forms"] for row in form["invariants"]]
        order = [row["symbol"] for row in found["forms"][0]["invariants"]]
        title = (
            f"{experiment.scheme.name} on {experiment.name}: {found['top']}, h = {found['h']:g}, "
            f"{found['steps']} steps, {copies} copies"
        )
        print_table(
            HEADER, sorted(rows, key=lambda row: order.index(row[0])), title, numbers=(2, 3, 4, 6, 7, 8), keys=2
        )
        if not found["claimed"]:
            say(
                f"{experiment.scheme.name} claims no invariant exactly: drifts of means over long windows, by which "
                "the copies differ from the motion that they have in common"
            )
        for file in files:
            say(f"wrote {file}")
    for form in failed:
        say(f"error: {form['scheme']} with {form['form']} sums: {form['message']}")
    for line in violations:
        say(f"violated: {line}")
    if failed or violations:
        raise typer.Exit(1 if failed else 4)
