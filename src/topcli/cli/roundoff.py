"""``topcli roundoff``: measure the growth of round-off with the number of steps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from topcli.cli.options import FigureOut, Json, SchemeFiles, Sets, complete_scheme, config_option, load_scheme_files
from topcli.cli.output import print_json, print_message, print_table, print_warnings

if TYPE_CHECKING:
    from topcli.config.models import Experiment

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
    from topcli.table import number

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
    """Violations of the stated tolerances by one form, a line each."""
    said = []
    for row in form["invariants"]:
        where = f"{row['name']} of {form['scheme']} with {form['form']} sums"
        exponent, error = row["exponent"], row["exponent_error"]
        if max_exponent is not None and exponent is not None and exponent - 2.0 * error > max_exponent:
            said.append(f"{where}: exponent {exponent:.2f} ± {error:.2f} exceeds {max_exponent:g}")
        if max_drift is not None and row["max_drift"] > max_drift:
            said.append(f"{where}: drift {row['max_drift']:.1e} exceeds {max_drift:g}")
    return said


def _print_study(study: dict[str, Any], experiment: Experiment, files: list[str]) -> None:
    """Print the table of a study and the files written."""
    rows = [_cells(form, row) for form in study["forms"] for row in form["invariants"]]
    order = [row["symbol"] for row in study["forms"][0]["invariants"]]
    title = (
        f"{experiment.scheme.name} on {experiment.name}: {study['top']}, h = {study['h']:g}, "
        f"{study['steps']} steps, {study['copies']} copies"
    )
    print_table(HEADER, sorted(rows, key=lambda row: order.index(row[0])), title, numbers=(2, 3, 4, 6, 7, 8), keys=2)
    if not study["claimed"]:
        print_message(
            f"{experiment.scheme.name} claims no invariant exactly; the drifts are of means over long windows, "
            "relative to the motion common to all copies"
        )
    for file in files:
        print_message(f"wrote {file}")


Config = Annotated[
    str | None,
    config_option("Read the experiment from a config; by default, a packaged scene at h = 0.01."),
]
Steps = Annotated[float, typer.Option("--steps", metavar="N", help="Take N steps in each copy, e.g. 1e8.")]
Copies = Annotated[
    int, typer.Option("--copies", metavar="K", help="Follow K copies that differ initially by some ulp.")
]
MaxExponent = Annotated[
    float | None,
    typer.Option(
        "--max-exponent", metavar="X", help="Exit with status 4 if an exponent minus two standard errors exceeds X."
    ),
]
MaxDrift = Annotated[
    float | None, typer.Option("--max-drift", metavar="X", help="Exit with status 4 if a drift exceeds X.")
]
Plot = Annotated[bool, typer.Option("--plot", help="Draw the drift against the number of steps.")]


def roundoff(
    scheme: Annotated[str, typer.Argument(metavar="SCHEME", help="Name of a scheme.", autocompletion=complete_scheme)],
    config: Config = None,
    steps: Steps = 1e7,
    copies: Copies = 8,
    max_exponent: MaxExponent = None,
    max_drift: MaxDrift = None,
    sets: Sets = None,
    as_json: Json = False,
    plot: Plot = False,
    out: FigureOut = Path("results/figures"),
    scheme_files: SchemeFiles = None,
) -> None:
    """Measure growth of round-off and the cost of compensation.

    Find whether round-off grows as a random walk, with a bias, or not at all, with plain and with compensated sums. The
    tolerances apply to the compensated form if the scheme has one.
    """
    from topcli.errors import UsageError
    from topcli.store.run_folder import require_writable
    from topcli.studies.roundoff import roundoff_experiment, roundoff_study

    load_scheme_files(scheme_files)
    if not 1.0 <= steps <= 1e12 or steps != int(steps):
        raise UsageError(f"--steps {steps:g}: must be a whole number from 1 to 1e12")
    experiment = roundoff_experiment(scheme, config, sets or [])
    print_warnings(experiment)
    if plot:
        require_writable(out)
    study = roundoff_study(experiment, int(steps), copies)
    failed = [form for form in study["forms"] if form["outcome"] != "completed"]
    files: list[str] = []
    if plot and not failed:
        from topcli.figures.make import write_figure
        from topcli.figures.roundoff import loaded_roundoff

        name = f"roundoff_{experiment.scheme.name}_{experiment.name}"
        files = [str(path) for path in write_figure(name, loaded_roundoff(study), out)]
    violations = _violations(study["forms"][-1], max_exponent, max_drift)
    if as_json:
        print_json("roundoff", {**study, "violations": violations, "files": files})
    else:
        _print_study(study, experiment, files)
    for form in failed:
        print_message(f"error: {form['scheme']} with {form['form']} sums: {form['message']}")
    for line in violations:
        print_message(f"error: {line}")
    if failed or violations:
        raise typer.Exit(1 if failed else 4)
