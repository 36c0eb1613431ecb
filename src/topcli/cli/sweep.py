"""``topcli sweep``: run every combination of a sweep file and gather the results in one table."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from topcli.cli.options import DryRun, Json, Out, Quiet, RetryFailed, Sets, Threads
from topcli.cli.output import ProgressDisplay, emit, emit_text, print_json, print_message, print_table
from topcli.cli.run import Interruption
from topcli.errors import ExitCode, UsageError, counted, shortened

if TYPE_CHECKING:
    from topcli.config.rows import Row
    from topcli.config.sweep import Sweep
    from topcli.sweeps.run import SweepOptions, SweepResult

SHOWN_FAILURES = 20
SHOWN_ROWS = 20
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


def _values(sweep: Sweep, row: Row) -> str:
    """Values of the varied keys of a row."""
    return ", ".join(f"{key} = {value}" for key, value in zip(sweep.keys, row.keys, strict=True) if value is not None)


def _varied(sweep: Sweep) -> list[str]:
    """Varied keys with the number of their values."""
    values = {key: set[str]() for key in sweep.keys}
    for axis in sweep.axes:
        for key, column in zip(axis.keys, axis.columns, strict=True):
            values[key].update(map(repr, column))
    return [f"{key} ({counted(len(known), 'value')})" for key, known in values.items()]


def _dry_run(sweep: Sweep, out: Path, options: SweepOptions, as_json: bool) -> None:
    from topcli.sweeps.plan import REASONS
    from topcli.sweeps.run import planned, rows_to_run

    plan, changed = planned(sweep, out, options)
    limit = LISTED_ROWS if as_json else SHOWN_ROWS
    rows = [(row, REASONS[reason]) for (row, reason), _ in zip(rows_to_run(plan), range(limit), strict=False)]
    if as_json:
        listed = [
            {"row": row.number, "reason": reason, "keys": dict(zip(sweep.keys, row.keys, strict=True))}
            for row, reason in rows
        ]
        data = {
            "dry_run": True,
            "name": sweep.name,
            "rows": plan.survey.count,
            "new": plan.to_run,
            "done": plan.done,
            "failed": plan.failed,
            "repeated": plan.repeated,
            "not_current": plan.left,
            "varied": list(sweep.keys),
            "reasons": plan.reasons(),
            "changes": changed,
            "folder": str(out / sweep.name),
            "to_run": listed,
        }
        print_json("sweep", data)
        return
    emit(f"{sweep.name}: {plan.to_run} new, {plan.done} done, {plan.failed} failed, in {out / sweep.name}")
    emit(f"varied: {', '.join(_varied(sweep))}")
    for line in changed:
        emit(f"changed: {line}")
    for reason, count in plan.reasons().items():
        emit(f"to run: {counted(count, 'row')}, {reason}")
    for row, reason in rows:
        emit(f"row {row.number}: {reason}: {_values(sweep, row)}")
    if plan.to_run > len(rows):
        emit(f"... and {plan.to_run - len(rows)} more")
    if plan.repeated:
        emit(f"repeated: {counted(plan.repeated, 'row')}, equal to an earlier one and computed once")
    if plan.left:
        emit(f"kept, not current: {counted(plan.left, 'finished row')} of an earlier sweep file")


def exit_code(result: SweepResult) -> ExitCode:
    """Exit code of a sweep, by how many of its finished rows failed."""
    if result.interrupted:
        return ExitCode.INTERRUPTED
    if not result.failed:
        return ExitCode.SUCCESS
    return ExitCode.FAILED if result.failed == result.finished else ExitCode.PARTLY_FAILED


def _report(sweep: Sweep, result: SweepResult) -> None:
    """Print the result of a sweep."""
    total = result.plan.survey.count
    state = "interrupted; run it again to continue" if result.interrupted else f"{result.ran} ran"
    failed = f"; {result.failed} failed" if result.failed else ""
    place = result.folder / "rows.parquet"
    print_message(f"{sweep.name}: {result.finished} of {total} rows finished{failed} -> {place} ({state})")
    if result.plan.left:
        print_message(f"{sweep.name}: not current: {counted(result.plan.left, 'row')} of an earlier sweep file")
    rows = [[outcome, str(count)] for outcome, count in sorted(result.outcomes.items())]
    print_table(["outcome", "rows"], rows)


def sweep(
    file: SweepFile,
    sets: Sets = None,
    out: Out = Path("results"),
    dry_run: DryRun = False,
    retry_failed: RetryFailed = False,
    threads: Threads = None,
    dask: Dask = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run all combinations of the values in a sweep file.

    The result is a table with one row for each run. It is stored as NAME/rows.parquet in the folder of --out, where
    NAME is the name of the sweep. Finished rows are not run again. To continue an interrupted or killed sweep, give the
    same command again. After a change of the sweep file, only new rows are run. In this command, --set sets a key of
    the sweep file, such as base.T=20 or name=other.
    """
    from topcli.config.sweep import load_sweep
    from topcli.sweeps.run import SweepOptions

    if dask is not None and threads is not None:
        raise UsageError("--threads cannot be used with --dask; each worker has its own number of threads")
    loaded = load_sweep(file, sets or [])
    options = SweepOptions(retry_failed, threads)
    if dry_run:
        _dry_run(loaded, out, options, as_json)
        return
    result = _carried_out(loaded, out, options, dask, quiet)
    if as_json:
        print_json("sweep", _result_data(loaded, result))
    elif not quiet:
        _report(loaded, result)
    if code := exit_code(result):
        raise typer.Exit(code)


def _carried_out(sweep: Sweep, out: Path, options: SweepOptions, dask: str | None, quiet: bool) -> SweepResult:
    """Run a sweep in this process or on a cluster, with progress, messages and the first failures."""
    from topcli.sweeps.run import run_sweep

    count = itertools.count(1)

    def on_failure(row: Row, outcome: str, message: str) -> None:
        """Print the first failures when they happen; all are in the table."""
        if (number := next(count)) <= SHOWN_FAILURES:
            print_message(f"error: row {row.number} ({shortened(_values(sweep, row), 200)}): {message}")
        elif number == SHOWN_FAILURES + 1:
            print_message("further failures are only counted; the messages of all are in the table")

    display = ProgressDisplay(1, quiet, unit="rows")
    display.begin(sweep.name)
    with Interruption() as interruption:
        options = replace(options, stop=interruption, on_progress=display, on_failure=on_failure)
        if not quiet:
            options = replace(options, on_message=print_message)
        try:
            if dask is None:
                return run_sweep(sweep, out, options)
            from topcli.sweeps.cluster import run_on_cluster

            return run_on_cluster(dask, sweep, out, options)
        finally:
            display.close()


def _result_data(sweep: Sweep, result: SweepResult) -> dict[str, Any]:
    """Result of a sweep as plain data."""
    return {
        "dry_run": False,
        "name": sweep.name,
        "digest": sweep.digest,
        "folder": str(result.folder),
        "rows": result.plan.survey.count,
        "finished": result.finished,
        "ran": result.ran,
        "failed": result.failed,
        "outcomes": dict(sorted(result.outcomes.items())),
        "not_current": result.plan.left,
        "varied": list(sweep.keys),
        "interrupted": result.interrupted,
        "seconds": result.seconds,
    }


def show_sweep(folder: Path, number: int | None, sets: list[str], as_json: bool) -> None:
    """Print the config of a row of the sweep in ``folder``, or the whole sweep file if ``number`` is None."""
    from topcli.config.load import load_experiment
    from topcli.sweeps.run import find_row, stored_sweep_file

    if number is None:
        sweep = stored_sweep_file(folder, sets)
        if as_json:
            print_json("show", {"sweep": sweep.resolved(), "digest": sweep.digest})
        else:
            emit_text(sweep.to_yaml())
        return
    sweep, row = find_row(folder, number)
    experiment = load_experiment(row.config(f"{sweep.name[:80]}_{number}"), sets, any_precision=True)
    if as_json:
        print_json("show", {"config": experiment.resolved(), "digest": experiment.digest, "row_digest": row.digest})
    else:
        emit_text(experiment.to_yaml())
