"""``topcli stress``: test schemes in hard cases."""

from __future__ import annotations

from pathlib import Path
from textwrap import shorten
from typing import Annotated, Any

import typer

from topcli.cli.options import Json, Out, SchemeFiles, Schemes, load_scheme_files, top_option
from topcli.cli.output import ProgressDisplay, emit, emit_prose, on_terminal, print_json, print_message, print_table

MARKS = {"held": "·", "degraded": "o", "broke": "X", "not tried": " "}
SHOWN = 40
"""List all trials up to this many; beyond it, only failures."""


def complete_case(incomplete: str) -> list[str]:
    """Names of hard cases that begin with ``incomplete``."""
    from topcli.studies.stress import case_names

    return [name for name in case_names() if name.startswith(incomplete.lower())]


def _options(sets: list[str]) -> dict[str, Any]:
    """Options of schemes given by ``--set scheme.KEY=VALUE``. Raises UsageError for other keys."""
    from topcli.config.overrides import override_label, parse_override
    from topcli.errors import UsageError

    options: dict[str, Any] = {}
    for text in sets:
        path, value = parse_override(text)
        if path[0] != "scheme" or len(path) != 2 or path[1] in ("name", "compose"):
            raise UsageError(f"{override_label(text)}: only options of schemes can be set, as scheme.KEY=VALUE")
        options[str(path[1])] = value
    return options


def _grid(data: dict[str, Any], top: str) -> None:
    """Print the outcomes of one top: a row for each scheme, a column for each case, with the cases numbered below."""
    trials = [one for one in data["trials"] if one["top"] == top]
    cases = list(dict.fromkeys(one["case"] for one in trials))
    marks: dict[str, dict[str, str]] = {}
    for one in trials:
        marks.setdefault(one["scheme"], {})[one["case"]] = MARKS[one["outcome"]]
    header = [top, *(str(number) for number in range(1, len(cases) + 1))]
    rows = [[scheme, *(row.get(case, " ") for case in cases)] for scheme, row in marks.items()]
    print_table(header, rows)
    emit_prose(", ".join(f"{number}={case}" for number, case in enumerate(cases, 1)), indent="  ")
    emit()


def _list(trials: list[dict[str, Any]]) -> None:
    """Print a row for each trial."""
    rows = []
    for one in trials:
        what = one["outcome"] if one["step"] is None else f"{one['outcome']} at step {one['step']}"
        meaning = {"ok": "", "limit": "declared limit"}.get(one["verdict"], one["verdict"].upper())
        rows.append([one["scheme"], one["top"], one["case"], what, shorten(one["why"], 100), meaning])
    header = ["scheme", "top", "case", "outcome", "why", ""]
    print_table(header, rows, numbers=False, keys=3)


def _summary(data: dict[str, Any]) -> str:
    counts = [f"{count} {outcome}" for outcome, count in data["outcomes"].items()]
    limits = data["verdicts"].get("limit", 0)
    return ", ".join(counts) + (f"; {limits} of the failures are declared limits" if limits else "")


def _print_study(data: dict[str, Any], files: list[str], verbose: bool) -> None:
    """Print the outcomes of all trials and the files written."""
    trials = data["trials"]
    every = verbose or len(trials) <= SHOWN
    if not every:
        for form in dict.fromkeys(one["top"] for one in trials):
            _grid(data, form)
        emit("· held   o degraded   X broke   (blank: not tried, or not a case of the top)")
        emit()
    _list([one for one in trials if every or one["outcome"] in ("degraded", "broke") or one["verdict"] != "ok"])
    if on_terminal():
        emit()
    print_message(_summary(data))
    for file in files:
        print_message(f"wrote {file}; draw it with: topcli plot stress")


Cases = Annotated[
    list[str] | None,
    typer.Option(
        "--case", metavar="CASE", help="Try only this case; repeat for several.", autocompletion=complete_case
    ),
]
Top = Annotated[
    str | None,
    top_option("Try only schemes and cases of this top."),
]
SchemeSets = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Set an option for all schemes that have it, e.g. scheme.branch=sign."
    ),
]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="List trials that held as well.")]


def stress(
    schemes: Schemes = None,
    cases: Cases = None,
    top: Top = None,
    sets: SchemeSets = None,
    verbose: Verbose = False,
    out: Out = Path("results"),
    as_json: Json = False,
    scheme_files: SchemeFiles = None,
) -> None:
    """Test schemes in hard cases and find what breaks.

    Exits with status 4 if a scheme breaks without a declared limit, or holds in a case that it declares as its limit;
    with 3 if the code of some of the schemes fails.
    """
    from topcli.store.run_folder import require_writable
    from topcli.studies.stress.record import stress_data, stress_source, write_stress
    from topcli.studies.stress.suite import chosen, require_options
    from topcli.studies.stress.suite import stress as run_stress

    load_scheme_files(scheme_files)
    options = _options(sets or [])
    used, _ = chosen(schemes or (), cases or (), top)
    require_options(options, used)
    whole = not (schemes or cases or top or options)
    if whole:
        require_writable(out)
    display = ProgressDisplay(1, as_json)
    display.begin("stress")
    try:
        judged = run_stress(schemes or (), cases or (), top, options, display)
    finally:
        display.close()
    data = stress_data(judged)
    files = [str(write_stress(data, out, stress_source()))] if whole else []
    if as_json:
        print_json("stress", {**data, "files": files})
    else:
        _print_study(data, files, verbose)
    if code := _say_faults(data["trials"]):
        raise typer.Exit(code)


def _say_faults(trials: list[dict[str, Any]]) -> int:
    """Report code that failed and trials that contradict a declaration; the exit code."""
    failed = [one for one in trials if one["verdict"] == "code failed"]
    for scheme, top, why in dict.fromkeys((one["scheme"], one["top"], one["why"]) for one in failed):
        print_message(f"error: {scheme} ({top}): {why}")
    wrong = [one for one in trials if one["verdict"] in ("unexplained", "outlived limit")]
    for one in wrong:
        unexplained = one["verdict"] == "unexplained"
        defect = "breaks without a declared limit" if unexplained else "holds in a case declared as its limit"
        print_message(f"error: {one['scheme']} ({one['top']}), case {one['case']}: {defect}: {one['why']}")
    if failed:
        return 3 if len(failed) < len(trials) else 2
    return 4 if wrong else 0
