"""``topcli run`` and ``topcli sweep``: compute experiments and sweeps into folders."""

from __future__ import annotations

import itertools
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topcli.cli.output import CommandResult, Screen, print_error, print_message
from topcli.errors import ExitCode, TopcliError, UsageError, counted, shortened
from topcli.table import Cells

if TYPE_CHECKING:
    from topcli.config.models import Experiment
    from topcli.config.sweep import Sweep
    from topcli.runs.run import RunOptions, RunResult
    from topcli.sweeps.run_sweep import SweepResult

PRINTED_FAILURES = PRINTED_ROWS = 20
LISTED_ROWS = 1000
"""Rows that the JSON document of a dry run lists."""


@contextmanager
def interruptible() -> Iterator[None]:
    """Within the block, the first Ctrl-C, SIGTERM or hang-up asks the work to stop; the second stops it at once.

    A hang-up that is ignored, as under ``nohup``, remains ignored.
    """
    from topcli.contracts import stopping_when

    asked: list[int] = []

    def ask(number: int, frame: object) -> None:
        if asked:
            raise KeyboardInterrupt
        asked.append(number)

    hang_up = [signal.SIGHUP] if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN else []
    previous = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM, *hang_up)}
    try:
        with stopping_when(lambda: bool(asked)):
            yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def run(
    configs: Sequence[str],
    *,
    overrides: Sequence[str] = (),
    out: Path = Path("results"),
    force: bool = False,
    dry_run: bool = False,
    threads: int | None = None,
    verbose: bool = False,
    screen: Screen,
) -> CommandResult:
    """Run experiments and report on their conservation laws.

    Each experiment or ensemble is stored in a folder of its own, with its time series and its report. The folder has
    the name of the config. If --set changes the experiment, digits of a hash of the experiment are appended to this
    name, unless --set name=NAME gives another one.

    A long run writes checkpoints. Ctrl-C or SIGTERM stops the run with exit code 130 and keeps the rows recorded so
    far. To continue an interrupted or killed run, run it again; the result is the same as without the interruption.
    --force repeats a run that exists already; the earlier result is renamed, not overwritten. A result of the same name
    that is of a different experiment is refused without --force.

    Parameters
    ----------
    configs : sequence of str
        Config files or names of packaged scenes.
    """
    from topcli.config.load import load
    from topcli.plugins import users_error
    from topcli.runs.run import RunOptions

    entries: list[dict[str, Any]] = []
    codes: list[ExitCode] = []
    with interruptible():
        options = RunOptions(force, threads=threads, on_progress=screen, on_message=screen.warn)
        for number, config in enumerate(configs, 1):
            try:
                experiment = load(config, overrides, rename=True)
                label = f"[{number}/{len(configs)}] " if len(configs) > 1 else ""
                screen.begin(label + experiment.name, experiment)
                if dry_run:
                    code, entry = ExitCode.SUCCESS, plan_table(experiment, out, options, screen)
                else:
                    code, entry = run_one(experiment, out, options, verbose, len(configs) > 1, screen)
            # one config that fails does not keep the others from running
            except Exception as error:
                failure = error if isinstance(error, TopcliError) else users_error(error)
                if failure is None:
                    raise
                screen.close()
                print_error(failure)
                code = failure.exit_code
                entry = {"config": config, "error": str(failure), "exit_code": code}
            codes.append(code)
            entries.append(entry)
            if code is ExitCode.INTERRUPTED:
                break
    if len(configs) > 1:
        succeeded, left = codes.count(ExitCode.SUCCESS), len(configs) - len(codes)
        more = f"; {left} not run" if left else ""
        screen.say(f"{succeeded} of {len(configs)} runs succeeded; {len(codes) - succeeded} failed{more}")
    # the code of an interruption stands before that of failures
    partly = ExitCode.INTERRUPTED not in codes and ExitCode.SUCCESS in codes and any(codes)
    return CommandResult({"runs": entries}, ExitCode.PARTLY_FAILED if partly else max(codes))


def plan_table(experiment: Experiment, out: Path, options: RunOptions, screen: Screen) -> dict[str, Any]:
    """Plan of a run: its config and digest, folder, action and number of rows."""
    from topcli.runs.run import outlook

    identity, action = outlook(experiment, out, options.force)
    folder = out / experiment.name
    rows = "the crossings" if experiment.rows is None else counted(experiment.rows, "row")
    screen.show(f"{experiment.name}: {action}: {rows} in {folder}")
    plan = {"config": identity.config, "digest": identity.digest, "folder": str(folder)}
    return {**plan, "action": action, "rows": experiment.rows}


def run_one(
    experiment: Experiment, out: Path, options: RunOptions, verbose: bool, titled: bool, screen: Screen
) -> tuple[ExitCode, dict[str, Any]]:
    """Run one experiment and print its result; return its exit code and its entry in the document of JSON."""
    from topcli.runs.run import run_experiment

    result = run_experiment(experiment, out, options)
    print_result(result, experiment, verbose, titled, screen)
    code = code_of(result)
    if code:
        failure = "some trajectories failed" if code is ExitCode.PARTLY_FAILED else result.outcome.value
        rows = "all rows" if result.outcome.value == "left_motion" else "the rows before"
        more = "; run it again to continue" if code is ExitCode.INTERRUPTED and "precision" not in result.report else ""
        print_message(f"error: {experiment.name}: {failure}; {rows} are kept{more}")
    return code, {"folder": str(result.stored.folder), "status": result.status, **result.report}


def code_of(result: RunResult) -> ExitCode:
    """Exit code of one run; an ensemble in which some trajectories completed failed in part."""
    if result.outcome.value in ("completed", "interrupted"):
        return ExitCode.SUCCESS if result.outcome.value == "completed" else ExitCode.INTERRUPTED
    return ExitCode.PARTLY_FAILED if result.report.get("outcomes", {}).get("completed") else ExitCode.FAILED


def print_result(result: RunResult, experiment: Experiment, verbose: bool, titled: bool, screen: Screen) -> None:
    """Print the message and the tables of a run; without ``verbose`` only of the invariants of its top."""
    from topcli.runs import report as texts

    report, status = result.report, result.status
    name, many = report["name"], report.get("kind") == "ensemble"
    if result.set_aside:
        screen.say(f"renamed the earlier result to {result.set_aside}")
    if status == "up to date" and result.outcome.value != "completed":
        status = f"not run again, because it ended as {result.outcome.value} before; --force runs it again"
    screen.say(f"{name}: {report['message']} -> {result.stored.folder} ({status})")
    if not many:
        for prefix, line in (("", texts.precision_note(report)), ("warning: ", texts.warning_of(report))):
            if line:
                screen.say(f"{prefix}{name}: {line}")
    title = name if titled else ""
    # briefly, the physical invariants have a table, and what else the scheme conserves has one line
    invariants, *others = texts.report_tables(report)
    rows = report["invariants"]
    if verbose:
        statements = [] if many else [f"{row['symbol']}: {row['statement']}" for row in rows]
        screen.show(replace(invariants.cells(), title=title), *statements)
    else:
        names = {invariant.name for invariant in experiment.top.invariants()}
        physical = [row for row in rows if row["name"] in names]
        modified = texts.modified_line([row for row in rows if row["name"] not in names])
        brief = texts.brief_ensemble_table if many else texts.brief_table
        screen.show(replace(brief(physical).cells(), title=title))
        screen.show(*texts.open_lines([(row["symbol"], row) for row in physical]), *filter(None, [modified]))
    screen.show(*(replace(table.cells(), title="") for table in others))


def sweep(
    sweep: str,
    *,
    overrides: Sequence[str] = (),
    out: Path = Path("results"),
    dry_run: bool = False,
    force: bool = False,
    threads: int | None = None,
    dask: str | None = None,
    screen: Screen,
) -> CommandResult:
    """Run all combinations of the values in a sweep file.

    The result is a table with one row for each run. It is stored as NAME/rows.parquet in the folder of --out, where
    NAME is the name of the sweep. Finished rows are not run again. To continue an interrupted or killed sweep, give the
    same command again. After a change of the sweep file, only new rows are run; with --force all rows are run, and the
    earlier folder is renamed. In this command, --set sets a key of the sweep file, such as base.T=20 or name=other.

    Parameters
    ----------
    sweep : str
        Sweep file or name of a packaged sweep.
    dask : str, optional
        Use a Dask cluster: tcp://host:port, or local:4 (4 workers).
    """
    from topcli.config.sweep import load_sweep
    from topcli.sweeps.run_sweep import SweepOptions, run_sweep

    if dask is not None and threads is not None:
        raise UsageError("--threads cannot be used with --dask; each worker has its own number of threads")
    loaded = load_sweep(sweep, overrides)
    if dry_run:
        return plan_of_sweep(loaded, out, screen)
    count = itertools.count(1)

    def on_failure(row: int, message: str) -> None:
        """Print the first failures when they happen; all are in the table."""
        if (number := next(count)) <= PRINTED_FAILURES:
            print_message(f"error: row {row}: {shortened(message, 300)}")
        elif number == PRINTED_FAILURES + 1:
            print_message("further failures are only counted; the messages of all are in the table")

    screen.begin(loaded.name, unit="rows")
    with interruptible():
        result = run_sweep(loaded, out, SweepOptions(force, threads, dask, screen, on_failure, screen.warn))
    # one line for people and one table of outcomes; the JSON has all numbers
    state = "interrupted; run it again to continue" if result.interrupted else f"{result.ran} ran"
    failed = f"; {result.failed} failed" if result.failed else ""
    place = result.folder / "rows.parquet"
    screen.say(f"{loaded.name}: {result.finished} of {result.rows} rows finished{failed} -> {place} ({state})")
    outcomes = dict(sorted(result.outcomes.items()))
    screen.show(Cells("", ["outcome", "rows"], [[outcome, str(rows)] for outcome, rows in outcomes.items()]))
    data = {"dry_run": False, "name": loaded.name, "digest": loaded.digest, "folder": str(result.folder)}
    data |= {"rows": result.rows, "finished": result.finished, "ran": result.ran, "failed": result.failed}
    data |= {"outcomes": outcomes, "varied": list(loaded.keys), "interrupted": result.interrupted}
    return CommandResult(data | {"seconds": result.seconds}, code_of_sweep(result))


def plan_of_sweep(sweep: Sweep, out: Path, screen: Screen) -> CommandResult:
    """Rows that would be run, the first of them with their keys."""
    from topcli.sweeps.run_sweep import planned

    plan, waiting = planned(sweep, out)
    rows, to_run, folder = len(plan.digests), int(waiting.sum()), out / sweep.name
    listed: list[dict[str, Any]] = []
    for group in plan.groups:
        for i, number in enumerate(group.numbers.tolist()):
            if waiting[number] and len(listed) < LISTED_ROWS:
                listed.append({"row": number, "keys": {key: group.values[key][i] for key in sweep.keys}})
    listed.sort(key=lambda row: row["row"])
    screen.show(f"{sweep.name}: {to_run} of {rows} rows to run, in {folder}")
    for row in listed[:PRINTED_ROWS]:
        screen.show(f"row {row['row']}: {', '.join(f'{key} = {value}' for key, value in row['keys'].items())}")
    if to_run > PRINTED_ROWS:
        screen.show(f"... and {to_run - PRINTED_ROWS} more")
    data = {"dry_run": True, "name": sweep.name, "rows": rows, "new": to_run, "varied": list(sweep.keys)}
    return CommandResult({**data, "folder": str(folder), "to_run": listed})


def code_of_sweep(result: SweepResult) -> ExitCode:
    """Exit code of a sweep, by how many of its finished rows failed."""
    if result.interrupted:
        return ExitCode.INTERRUPTED
    if not result.failed:
        return ExitCode.SUCCESS
    return ExitCode.FAILED if result.failed == result.finished else ExitCode.PARTLY_FAILED
