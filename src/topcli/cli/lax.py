"""``topcli lax``: check the Lax forms of a top along runs."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from topcli.cli.options import (
    Json,
    SchemeFiles,
    Sets,
    complete_scheme,
    complete_top,
    config_option,
    load_scheme_files,
)
from topcli.cli.output import emit, print_json, print_message, print_table


def _form_lines(forms: list[dict[str, Any]]) -> list[list[str]]:
    from topcli.table import number

    def line(label: str, cell: Any) -> list[str]:
        return [label, *(cell(form) for form in forms)]

    def order(form: dict[str, Any]) -> str:
        found = form["midpoint"]["order"]
        if form["midpoint"]["conjugation_defect"] is None:
            return "did not converge"
        return "round-off" if found is None else f"{found:.2f}"

    return [
        line("size", lambda f: f"{f['size']}x{f['size']}"),
        line("dL/dt - [M,L] by the equations", lambda f: number(f["residual_by_field"])),
        line("dL/dt - [M,L] by differences", lambda f: number(f["residual_by_differences"])),
        line("traces", lambda f: f["traces"]),
        line("independent integrals", lambda f: str(f["independent_integrals"])),
        line("carried integrals", lambda f: ", ".join(f["carries"]) or "–"),
        line("Lax pair", lambda f: "yes" if f["lax_pair"] else "no"),
        line("midpoint rule: L' - U L U^-1", lambda f: number(f["midpoint"]["conjugation_defect"])),
        line("  its order in h", order),
    ]


def _report(found: dict[str, Any], title: str) -> None:
    from topcli.table import number

    forms, runs = found["forms"], found["runs"]
    names = [form["form"] for form in forms]
    traces = {form["form"]: form["traces"] for form in forms}
    print_table(["", *names], _form_lines(forms), title)
    emit()
    header = ["", *(f"{name}: {what}" for name in names for what in (traces[name], "eigenvalues"))]
    lines = [
        [run["scheme"], *(number(form[key]) for form in run["forms"] for key in ("drift", "eigenvalue_shift"))]
        for run in runs
    ]
    if any(run["discrete_lax_defect"] is not None for run in runs):
        header.append("L'U - UL")
        for line, run in zip(lines, runs, strict=True):
            line.append(number(run["discrete_lax_defect"]))
        print_message("L'U - UL: defect of the discrete Lax pair of backlund, over the first steps of a run")
    print_table(header, lines, "largest relative drift of the spectrum of L")
    for form in forms:
        if form["why_not"]:
            print_message(f"{form['form']}: no Lax pair: {form['why_not']}")


def lax(
    top: Annotated[str, typer.Argument(metavar="TOP", help="Name of a top.", autocompletion=complete_top)],
    schemes: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="SCHEME",
            help="Names of schemes; all except adaptive ones by default.",
            autocompletion=complete_scheme,
        ),
    ] = None,
    config: Annotated[
        str | None,
        config_option("Read the experiment from a config; by default, a generic state."),
    ] = None,
    sets: Sets = None,
    as_json: Json = False,
    scheme_files: SchemeFiles = None,
) -> None:
    """Check the Lax forms of a top and the spectrum of L.

    Test dL/dt = [M, L] along the motion, and measure the drift of the spectrum of L under each scheme; for the
    Kowalevski top, also the discrete Lax pair L' U = U L.
    """
    from topcli.studies.lax import default_schemes, lax_experiment, lax_study

    load_scheme_files(scheme_files)
    experiment = lax_experiment(top, config, sets or [])
    found = lax_study(experiment, schemes or default_schemes(experiment))
    if as_json:
        print_json("lax", found)
    else:
        _report(found, f"{experiment.name}: {experiment.top.title}, h = {experiment.h:g}, N = {experiment.N}")
    failed = [run for run in found["runs"] if run["outcome"] != "completed"]
    for run in failed:
        print_message(f"error: {run['scheme']}: {run['message']}")
    if failed:
        raise typer.Exit(1)
