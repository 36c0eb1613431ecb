"""``topcli run``: run experiments into run folders."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from topcli.cli.options import (
    DryRun,
    Force,
    Json,
    Out,
    Quiet,
    Sets,
    Threads,
    Verbose,
    complete_config,
)
from topcli.cli.output import (
    ProgressDisplay,
    emit,
    emit_prose,
    messages,
    print_cells,
    print_error,
    print_json,
    print_message,
    print_warnings,
)
from topcli.errors import ExitCode, TopcliError, UsageError, counted, quoted

if TYPE_CHECKING:
    from collections.abc import Collection

    from topcli.config.models import Experiment
    from topcli.runs.run import RunOptions, RunResult


class Interruption:
    """Request to stop between chunks, made by the first Ctrl-C, SIGTERM or hang-up; the second one stops at once.

    A hang-up that is ignored, as under ``nohup``, remains ignored.
    """

    def __init__(self) -> None:
        self._asked = False
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> Interruption:
        hang_up = getattr(signal, "SIGHUP", None)
        hung_up = [] if hang_up is None or signal.getsignal(hang_up) == signal.SIG_IGN else [hang_up]
        for number in (signal.SIGINT, signal.SIGTERM, *hung_up):
            self._previous[number] = signal.signal(number, self._ask)
        return self

    def _ask(self, number: int, frame: object) -> None:
        if self._asked:
            raise KeyboardInterrupt
        self._asked = True

    def __call__(self) -> bool:
        """True if a stop has been requested."""
        return self._asked

    def __exit__(self, *exception: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)


@dataclass(frozen=True)
class _Request:
    """Options of ``topcli run`` besides those of each run."""

    out: Path
    overrides: tuple[str, ...]
    dry_run: bool
    quiet: bool
    as_json: bool
    verbose: bool
    labelled: bool


def _print_result(result: RunResult, own: Collection[str], request: _Request) -> None:
    """Print the message and the table of a run; without ``--verbose`` only of the invariants of the top, ``own``."""
    from topcli.runs.report import (
        brief_ensemble_table,
        brief_table,
        modified_line,
        open_lines,
        precision_note,
        report_tables,
        warning_of,
    )

    report, warning, notes, title = result.report, "", [], result.report["name"] if request.labelled else ""
    if report.get("kind") != "ensemble":
        warning = warning_of(report)
        notes = [precision_note(report)]
    if result.set_aside:
        print_message(f"renamed the earlier result to {result.set_aside}")
    status = result.status
    if status == "up to date" and result.outcome.value != "completed":
        status = f"not run again, because it ended as {result.outcome.value} before; --force runs it again"
    print_message(f"{report['name']}: {report['message']} -> {result.stored.folder} ({status})")
    for note in filter(None, notes):
        print_message(f"{report['name']}: {note}")
    if warning:
        print_message(f"warning: {report['name']}: {warning}")
    if request.verbose:
        _print_all(report, title)
    else:
        physical = [row for row in report["invariants"] if row["name"] in own]
        modified = [row for row in report["invariants"] if row["name"] not in own]
        brief = brief_ensemble_table if report.get("kind") == "ensemble" else brief_table
        print_cells(brief(physical).cells(), title)
        for line in (*open_lines([(row["symbol"], row) for row in physical]), modified_line(modified)):
            if line:
                emit_prose(line)
    for table in report_tables(report)[1:]:
        print_cells(table.cells())


def _print_all(report: dict[str, Any], title: str) -> None:
    """Print all figures on the invariants, and a sentence on each that can be quoted."""
    from topcli.runs.report import report_tables

    print_cells(report_tables(report)[0].cells(), title)
    for row in () if report.get("kind") == "ensemble" else report["invariants"]:
        emit_prose(f"{row['symbol']}: {row['statement']}")


def _plan_data(experiment: Experiment, out: Path, options: RunOptions) -> dict[str, Any]:
    """Plan of a run: its config and digest, folder, action and number of rows."""
    from topcli.runs.run import outlook

    identity, action = outlook(experiment, out, options.force)
    return {
        "config": identity.config,
        "digest": identity.digest,
        "folder": str(out / experiment.name),
        "action": action,
        "rows": experiment.rows,
    }


def _code(result: RunResult) -> ExitCode:
    """Exit code of one run; an ensemble in which some trajectories completed failed in part."""
    if result.outcome.value == "completed":
        return ExitCode.SUCCESS
    if result.outcome.value == "interrupted":
        return ExitCode.INTERRUPTED
    return ExitCode.PARTLY_FAILED if result.report.get("outcomes", {}).get("completed") else ExitCode.FAILED


def _exit_code(codes: list[ExitCode]) -> ExitCode:
    """Exit code of the command from those of its runs: the largest of all, unless only a part failed."""
    if ExitCode.INTERRUPTED not in codes and ExitCode.SUCCESS in codes and any(codes):
        return ExitCode.PARTLY_FAILED
    return max(codes)


def _say_failure(name: str, result: RunResult, code: ExitCode) -> None:
    """Print how a run failed and what is kept of it."""
    failure = "some trajectories failed" if code is ExitCode.PARTLY_FAILED else result.outcome.value
    kept = "all rows" if result.outcome.value == "left_motion" else "the rows before"
    more = "; run it again to continue" if code is ExitCode.INTERRUPTED and "precision" not in result.report else ""
    print_message(f"error: {name}: {failure}; {kept} are kept{more}")


def _experiment(config: str, request: _Request) -> Experiment:
    """Experiment of a config or scene. Raises UsageError for the name or the folder of a stored run."""
    from topcli.config.files import is_config
    from topcli.config.load import load

    if not is_config(config):
        from topcli.store.results import MANIFEST

        for folder in (Path(config), request.out / config):
            if os.path.exists(folder / MANIFEST):
                raise UsageError(f"{quoted(config)} is a stored run; its config is {folder / 'config.yaml'}")
    return load(config, request.overrides, rename=True)


def _run_config(
    config: str, request: _Request, options: RunOptions, display: ProgressDisplay
) -> tuple[ExitCode, dict[str, Any]]:
    """Run one config, print its result or error, and return its exit code and its entry in the JSON document."""
    from topcli.runs.run import run_experiment

    try:
        experiment = _experiment(config, request)
        if not request.quiet:
            print_warnings(experiment)
        if request.dry_run:
            plan = _plan_data(experiment, request.out, options)
            if not (request.as_json or request.quiet):
                rows = "the crossings" if plan["rows"] is None else counted(plan["rows"], "row")
                emit(f"{experiment.name}: {plan['action']}: {rows} in {plan['folder']}")
            return ExitCode.SUCCESS, plan
        display.begin(experiment.name)
        try:
            result = run_experiment(experiment, request.out, options)
        finally:
            display.close()
    except Exception as error:
        from topcli.schemes.plugins import users_error

        failure = error if isinstance(error, TopcliError) else users_error(error)
        if failure is None:
            raise
        print_error(failure)
        return failure.exit_code, {"config": config, "error": str(failure), "exit_code": failure.exit_code}
    if not (request.quiet or request.as_json):
        own = {invariant.name for invariant in experiment.top.invariants()}
        _print_result(result, own, request)
    if code := _code(result):
        _say_failure(experiment.name, result, code)
    return code, {"folder": str(result.stored.folder), "status": result.status, **result.report}


Configs = Annotated[
    list[str],
    typer.Argument(
        metavar="CONFIG",
        help="Config files or names of packaged scenes.",
        autocompletion=complete_config,
    ),
]
CheckpointEvery = Annotated[
    float,
    typer.Option(
        "--checkpoint-every",
        metavar="SECONDS",
        help="Set the seconds between checkpoints; with 0, checkpoints are written as often as possible.",
    ),
]


def run(
    configs: Configs,
    sets: Sets = None,
    out: Out = Path("results"),
    force: Force = False,
    checkpoint_every: CheckpointEvery = 10.0,
    dry_run: DryRun = False,
    as_json: Json = False,
    threads: Threads = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Run experiments and report on their conservation laws.

    Each experiment or ensemble is stored in a folder of its own, with its time series and its report. The folder has
    the name of the config. If --set changes the experiment, digits of a hash of the experiment are appended to this
    name, unless --set name=NAME gives another one.

    A long run writes checkpoints. Ctrl-C or SIGTERM stops the run with exit code 130 and keeps the rows recorded so
    far. To continue an interrupted or killed run, run it again; the result is the same as without the interruption.
    --force repeats a run that exists already; the earlier result is renamed, not overwritten. A result of the same name
    that is of a different experiment is refused without --force.
    """
    if not checkpoint_every >= 0.0:
        raise UsageError(f"--checkpoint-every {checkpoint_every:g}: must be a number of seconds, at least 0")
    from topcli.runs.run import RunOptions

    request = _Request(out, tuple(sets or ()), dry_run, quiet, as_json, verbose, len(configs) > 1)
    reports: list[dict[str, Any]] = []
    codes: list[ExitCode] = []
    display = ProgressDisplay(len(configs), quiet)
    on_message = messages(quiet)
    with Interruption() as interruption:
        options = RunOptions(force, checkpoint_every, threads, interruption, display, on_message)
        for config in configs:
            code, report = _run_config(config, request, options, display)
            codes.append(code)
            reports.append(report)
            if code is ExitCode.INTERRUPTED:
                break
    if as_json:
        print_json("run", {"runs": reports})
    elif len(configs) > 1 and not quiet:
        succeeded, skipped = codes.count(ExitCode.SUCCESS), len(configs) - len(codes)
        more = f"; {skipped} not run" if skipped else ""
        print_message(f"{succeeded} of {len(configs)} runs succeeded; {len(codes) - succeeded} failed{more}")
    if code := _exit_code(codes):
        raise typer.Exit(code)
