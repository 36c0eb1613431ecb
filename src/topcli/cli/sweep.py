"""``topcli sweep``: run every combination of a sweep file and gather the results in one table."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from topcli.cli.options import DryRun, Force, Json, Out, Quiet, Sets, Threads
from topcli.cli.output import ProgressDisplay, emit, emit_text, print_cells, print_json, print_message
from topcli.cli.run import Interruption
from topcli.errors import ExitCode, UsageError, shortened
from topcli.table import Cells

if TYPE_CHECKING:
    from topcli.config.sweep import Sweep
    from topcli.sweeps.run import SweepResult

SHOWN_FAILURES = SHOWN_ROWS = 20
LISTED_ROWS = 1000
"""Rows that the JSON document of a dry run lists."""


def complete_sweep(incomplete: str) -> list[str]:
    """Names of packaged sweeps that begin with ``incomplete``."""
    from topcli.config.files import sweep_files

    return [name for name in sweep_files() if name.startswith(incomplete)]


SweepFile = Annotated[
    str,
    typer.Argument(metavar="SWEEP", help="Sweep file or name of a packaged sweep.", autocompletion=complete_sweep),
]
Dask = Annotated[
    str | None,
    typer.Option("--dask", metavar="ADDRESS", help="Use a Dask cluster: tcp://host:port, or local:4 (4 workers)."),
]


def _dry_run(sweep: Sweep, out: Path, as_json: bool) -> None:
    from topcli.sweeps.run import planned

    plan, waiting = planned(sweep, out)
    rows, to_run, folder = len(plan.digests), int(waiting.sum()), out / sweep.name
    listed: list[dict[str, Any]] = []
    for group in plan.groups:
        for i, number in enumerate(group.numbers.tolist()):
            if waiting[number] and len(listed) < LISTED_ROWS:
                listed.append({"row": number, "keys": {key: group.values[key][i] for key in sweep.keys}})
    listed.sort(key=lambda row: row["row"])
    if as_json:
        data = {"dry_run": True, "name": sweep.name, "rows": rows, "new": to_run, "varied": list(sweep.keys)}
        print_json("sweep", {**data, "folder": str(folder), "to_run": listed})
        return
    emit(f"{sweep.name}: {to_run} of {rows} rows to run, in {folder}")
    for row in listed[:SHOWN_ROWS]:
        emit(f"row {row['row']}: {', '.join(f'{key} = {value}' for key, value in row['keys'].items())}")
    if to_run > SHOWN_ROWS:
        emit(f"... and {to_run - SHOWN_ROWS} more")


def exit_code(result: SweepResult) -> ExitCode:
    """Exit code of a sweep, by how many of its finished rows failed."""
    if result.interrupted:
        return ExitCode.INTERRUPTED
    if not result.failed:
        return ExitCode.SUCCESS
    return ExitCode.FAILED if result.failed == result.finished else ExitCode.PARTLY_FAILED


def sweep(
    file: SweepFile,
    sets: Sets = None,
    out: Out = Path("results"),
    dry_run: DryRun = False,
    force: Force = False,
    threads: Threads = None,
    dask: Dask = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run all combinations of the values in a sweep file.

    The result is a table with one row for each run. It is stored as NAME/rows.parquet in the folder of --out, where
    NAME is the name of the sweep. Finished rows are not run again. To continue an interrupted or killed sweep, give the
    same command again. After a change of the sweep file, only new rows are run; with --force all rows are run, and the
    earlier folder is renamed. In this command, --set sets a key of the sweep file, such as base.T=20 or name=other.
    """
    from topcli.config.sweep import load_sweep
    from topcli.sweeps.run import SweepOptions, run_sweep

    if dask is not None and threads is not None:
        raise UsageError("--threads cannot be used with --dask; each worker has its own number of threads")
    loaded = load_sweep(file, sets or [])
    if dry_run:
        _dry_run(loaded, out, as_json)
        return
    count = itertools.count(1)

    def on_failure(row: int, message: str) -> None:
        """Print the first failures when they happen; all are in the table."""
        if (number := next(count)) <= SHOWN_FAILURES:
            print_message(f"error: row {row}: {shortened(message, 300)}")
        elif number == SHOWN_FAILURES + 1:
            print_message("further failures are only counted; the messages of all are in the table")

    display = ProgressDisplay(1, quiet, unit="rows")
    display.begin(loaded.name)
    on_message = (lambda line: None) if quiet else print_message
    try:
        with Interruption() as stop:
            result = run_sweep(loaded, out, SweepOptions(force, threads, dask, stop, display, on_failure, on_message))
    finally:
        display.close()
    if as_json:
        print_json("sweep", _result_data(loaded, result))
    elif not quiet:
        _report(loaded, result)
    if code := exit_code(result):
        raise typer.Exit(code)


def _report(sweep: Sweep, result: SweepResult) -> None:
    """Print the result of a sweep."""
    state = "interrupted; run it again to continue" if result.interrupted else f"{result.ran} ran"
    failed = f"; {result.failed} failed" if result.failed else ""
    place = result.folder / "rows.parquet"
    print_message(f"{sweep.name}: {result.finished} of {result.rows} rows finished{failed} -> {place} ({state})")
    rows = [[outcome, str(count)] for outcome, count in sorted(result.outcomes.items())]
    print_cells(Cells("", ["outcome", "rows"], rows))


def _result_data(sweep: Sweep, result: SweepResult) -> dict[str, Any]:
    """Result of a sweep as plain data."""
    counts = {"rows": result.rows, "finished": result.finished, "ran": result.ran, "failed": result.failed}
    about = {"dry_run": False, "name": sweep.name, "digest": sweep.digest, "folder": str(result.folder)}
    rest = {"varied": list(sweep.keys), "interrupted": result.interrupted, "seconds": result.seconds}
    return {**about, **counts, "outcomes": dict(sorted(result.outcomes.items())), **rest}


def show_sweep(folder: Path, number: int | None, sets: list[str], as_json: bool) -> None:
    """Print the config of a row of the sweep in ``folder``, or the whole sweep file if ``number`` is None."""
    from topcli.config.load import load_experiment
    from topcli.sweeps.store import stored_sweep_file

    sweep = stored_sweep_file(folder, sets if number is None else [])
    if number is None:
        if as_json:
            print_json("show", {"sweep": sweep.resolved(), "digest": sweep.digest})
        else:
            emit_text(sweep.to_yaml())
        return
    try:
        row = sweep.row(number)
    except IndexError as error:
        raise UsageError(f"{folder}: {error}") from None
    experiment = load_experiment(row.resolved(), sets, any_precision=True)
    if as_json:
        print_json("show", {"config": experiment.resolved(), "digest": experiment.digest})
    else:
        emit_text(experiment.to_yaml())
