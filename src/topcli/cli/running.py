"""``topcli.run``, ``sweep`` and ``motion``, and the commands ``topcli run`` and ``topcli sweep``."""

from __future__ import annotations

import itertools
import signal
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topcli.cli.output import CommandResult, Progress, Screen, print_error, print_message
from topcli.errors import ExitCode, TopcliError, UsageError, counted, shortened
from topcli.table import Cells

if TYPE_CHECKING:
    from topcli.analysis.motion import Motion
    from topcli.cli.reports import RunReport, SweepReport
    from topcli.config.models import Experiment
    from topcli.config.sweep import Sweep
    from topcli.runs.run import RunResult
    from topcli.sweeps.run_sweep import SweepResult

PRINTED_ROWS = 20
"""Largest numbers of failures that a sweep prints, and of rows that a dry run lists."""


def run(
    config: str | Path | Mapping[str, Any],
    out: str | Path = "results",
    *,
    overrides: Sequence[str] = (),
    force: bool = False,
    threads: int | None = None,
    progress: bool = True,
    **changes: Any,
) -> RunReport:
    """Run an experiment or ensemble and store it in a folder; a finished run is not repeated.

    Parameters
    ----------
    config : path, str or mapping
        Config file (YAML or TOML), name of a scene (a packaged config), or the content of a config as nested mappings.
    out : path or str, optional
        Folder for results, as for ``--out`` on the command line. The run is stored in its subfolder ``name``.
    overrides : sequence of str, optional
        Texts ``"key=value"`` that replace keys of the config, as for ``--set`` on the command line. They are applied
        after ``changes``.
    force : bool, optional
        True to repeat a run that exists already; the earlier result is renamed, not overwritten.
    threads : int, optional
        Number of threads for an ensemble, by default one per CPU. The results do not depend on this number.
    progress : bool, optional
        False to show no progress bar in a notebook or terminal.
    **changes
        Values that replace whole top-level keys of the config, such as ``h=0.01``. If the changes or the overrides
        alter the run, the first digits of its digest (a hash of the config) are appended to its name, unless they set
        the name themselves.

    Returns
    -------
    RunReport
        Report with the folder of the run. A failed run raises no exception; ``outcome`` says how the run ended.

    Raises
    ------
    ConfigError
        If the config cannot be read or is invalid. The message names the key and, for a file, the line.
    UsageError
        If the folder of the run contains something other than this run.
    RunError
        If the results cannot be written.

    Examples
    --------
    >>> import tempfile, topcli
    >>> folder = tempfile.mkdtemp()
    >>> report = topcli.run("kowalevski_hybrid", folder, h=0.01, N=1000)
    >>> report
    <RunReport of kowalevski_hybrid-84d1c2: completed 1000 steps (t = 10)>
    >>> report.table.loc["k_sq", "verdict"]
    'exact'
    >>> report["gamma1"].shape
    (1001,)
    >>> topcli.run("kowalevski_hybrid", folder, h=0.01, N=1000).status
    'up to date'
    """
    from topcli.cli.reports import report_on_run
    from topcli.config.load import load
    from topcli.runs.run import RunOptions, run_experiment

    experiment = load(config, overrides, changes, rename=True)
    with closing(Progress(progress)) as bar:
        bar.begin(experiment.name)
        options = RunOptions(force, threads=threads, on_progress=bar)
        return report_on_run(run_experiment(experiment, Path(out), options))


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


def run_command(
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
    from topcli.runs.run import RunOptions, run_experiment

    entries: list[dict[str, Any]] = []
    codes: list[ExitCode] = []
    several = len(configs) > 1
    with interruptible():
        options = RunOptions(force, threads=threads, on_progress=screen, on_message=screen.warn)
        for number, config in enumerate(configs, 1):
            try:
                experiment = load(config, overrides, rename=True)
                screen.begin(f"[{number}/{len(configs)}] " * several + experiment.name, experiment)
                if dry_run:
                    code, entry = ExitCode.SUCCESS, plan_of_run(experiment, out, force, screen)
                else:
                    result = run_experiment(experiment, out, options)
                    print_result(result, experiment, verbose, several, screen)
                    code = code_of_run(result)
                    entry = {"folder": str(result.stored.folder), "status": result.status, **result.report}
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
    if several:
        succeeded, left = codes.count(ExitCode.SUCCESS), len(configs) - len(codes)
        more = f"; {left} not run" if left else ""
        screen.say(f"{succeeded} of {len(configs)} runs succeeded; {len(codes) - succeeded} failed{more}")
    # the code of an interruption stands before that of failures
    partly = ExitCode.INTERRUPTED not in codes and ExitCode.SUCCESS in codes and any(codes)
    return CommandResult({"runs": entries}, ExitCode.PARTLY_FAILED if partly else max(codes))


def plan_of_run(experiment: Experiment, out: Path, force: bool, screen: Screen) -> dict[str, Any]:
    """Print and return what would be done: config and digest, folder, action and number of rows."""
    from topcli.runs.run import outlook

    identity, action = outlook(experiment, out, force)
    folder = out / experiment.name
    rows = "the crossings" if experiment.rows is None else counted(experiment.rows, "row")
    screen.show(f"{experiment.name}: {action}: {rows} in {folder}")
    plan = {"config": identity.config, "digest": identity.digest, "folder": str(folder)}
    return {**plan, "action": action, "rows": experiment.rows}


def code_of_run(result: RunResult) -> ExitCode:
    """Exit code of one run; an ensemble in which some trajectories completed failed in part."""
    if result.outcome.value in ("completed", "interrupted"):
        return ExitCode.SUCCESS if result.outcome.value == "completed" else ExitCode.INTERRUPTED
    return ExitCode.PARTLY_FAILED if result.report.get("outcomes", {}).get("completed") else ExitCode.FAILED


def print_result(result: RunResult, experiment: Experiment, verbose: bool, titled: bool, screen: Screen) -> None:
    """Print the message and the tables of a run; without ``verbose`` only of the invariants of its top."""
    from topcli.runs import report as texts

    report, status, code = result.report, result.status, code_of_run(result)
    name, many, outcome = report["name"], report.get("kind") == "ensemble", result.outcome.value
    if result.set_aside:
        screen.say(f"renamed the earlier result to {result.set_aside}")
    if status == "up to date" and outcome != "completed":
        status = f"not run again, because it ended as {outcome} before; --force runs it again"
    screen.say(f"{name}: {report['message']} -> {result.stored.folder} ({status})")
    if not many:
        for prefix, line in (("", texts.precision_note(report)), ("warning: ", texts.warning_of(report))):
            if line:
                screen.say(f"{prefix}{name}: {line}")

    # briefly, the physical invariants have a table, and what else the scheme conserves has one line
    invariants, *others = texts.report_tables(report)
    rows, title = report["invariants"], name if titled else ""
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

    if code:
        failure = "some trajectories failed" if code is ExitCode.PARTLY_FAILED else outcome
        stored_rows = "all rows" if outcome == "left_motion" else "the rows before"
        more = "; run it again to continue" if code is ExitCode.INTERRUPTED and "precision" not in report else ""
        print_message(f"error: {name}: {failure}; {stored_rows} are kept{more}")


def sweep(
    file: str | Path | Mapping[str, Any],
    out: str | Path = "results",
    *,
    overrides: Sequence[str] = (),
    force: bool = False,
    threads: int | None = None,
    dask: str | None = None,
    progress: bool = True,
) -> SweepReport:
    """Run the unfinished rows of a sweep and return a report on all rows.

    A row is one run of the sweep, with one combination of the values of the varied keys.

    Parameters
    ----------
    file : path, str or mapping
        Sweep file (YAML or TOML), name of a packaged sweep, or the content of a sweep file as nested mappings.
    out : path or str, optional
        Folder for results, as for ``--out`` on the command line. The sweep is stored in its subfolder ``name``. Rows
        that are finished there do not run again.
    overrides : sequence of str, optional
        Texts ``"key=value"`` that replace keys of the sweep file, as for ``--set`` on the command line, such as
        ``"base.N=100"``.
    force : bool, optional
        True to begin anew; the folder of an earlier sweep of this name is renamed.
    threads : int, optional
        Number of threads, by default one per CPU. The results do not depend on this number.
    dask : str, optional
        Address of a Dask cluster that runs the rows, as for ``--dask`` on the command line. With a cluster,
        ``threads`` is ignored.
    progress : bool, optional
        False to show no progress bar.

    Returns
    -------
    SweepReport
        Report with the rows and the folder of the sweep. The table gives the outcome and message of each failed row.

    Raises
    ------
    ConfigError
        If the sweep file is invalid. The message names the key and, for a file, the line.
    UsageError
        If another sweep is using the folder, or if the folder contains something other than this sweep.
    RunError
        If the results cannot be written.

    Examples
    --------
    >>> import tempfile, topcli
    >>> start = {"omega": [2, 0, 0], "gamma": ["auto", 0, 0.1]}
    >>> base = {"top": "kowalevski", "initial": start, "scheme": "hk", "T": 10}
    >>> study = {"base": base, "grid": {"h": [0.02, 0.01]}, "measure": ["max_deviation.energy"]}
    >>> result = topcli.sweep(study, tempfile.mkdtemp())
    >>> coarse, fine = result.table["max_deviation.energy"]
    >>> bool(3.9 < coarse / fine < 4.1)
    True
    >>> result.plot().get_xlabel()
    'step size h'
    """
    from topcli.cli.reports import report_on_sweep
    from topcli.config.sweep import load_sweep
    from topcli.store.results import read_result
    from topcli.sweeps.run_sweep import SweepOptions, run_sweep

    loaded = load_sweep(file, overrides)
    with closing(Progress(progress)) as bar:
        bar.begin(loaded.name, unit="rows")
        options = SweepOptions(force=force, threads=threads, dask=dask, on_progress=bar)
        stored = read_result(run_sweep(loaded, Path(out), options).folder)
    assert stored is not None
    return report_on_sweep(stored)


def sweep_command(
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
        if (number := next(count)) <= PRINTED_ROWS:
            print_message(f"error: row {row}: {shortened(message, 300)}")
        elif number == PRINTED_ROWS + 1:
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
    data = {"dry_run": False, "name": loaded.name, "digest": loaded.digest, "varied": list(loaded.keys)}
    data |= asdict(result) | {"folder": str(result.folder), "outcomes": outcomes}
    return CommandResult({**data, "finished": result.finished, "failed": result.failed}, code_of_sweep(result))


def plan_of_sweep(sweep: Sweep, out: Path, screen: Screen) -> CommandResult:
    """Print the number of rows that would be run, and the keys of the first of them."""
    from topcli.sweeps.run_sweep import planned

    plan, waiting = planned(sweep, out)
    rows, to_run, folder = len(plan.digests), int(waiting.sum()), out / sweep.name
    first = waiting.nonzero()[0][:PRINTED_ROWS].tolist()
    keys: dict[int, dict[str, Any]] = {}
    for group in plan.groups:
        for i, number in enumerate(group.numbers.tolist()):
            if number in first:
                keys[number] = {key: group.values[key][i] for key in sweep.keys}
    screen.show(f"{sweep.name}: {to_run} of {rows} rows to run, in {folder}")
    for number in first:
        screen.show(f"row {number}: {', '.join(f'{key} = {value}' for key, value in keys[number].items())}")
    if to_run > PRINTED_ROWS:
        screen.show(f"... and {to_run - PRINTED_ROWS} more")
    data = {"dry_run": True, "name": sweep.name, "rows": rows, "new": to_run, "varied": list(sweep.keys)}
    listed = [{"row": number, "keys": keys[number]} for number in first]
    return CommandResult({**data, "folder": str(folder), "to_run": listed})


def code_of_sweep(result: SweepResult) -> ExitCode:
    """Exit code of a sweep, by how many of its finished rows failed."""
    if result.interrupted or not result.failed:
        return ExitCode.INTERRUPTED if result.interrupted else ExitCode.SUCCESS
    return ExitCode.FAILED if result.failed == result.finished else ExitCode.PARTLY_FAILED


def motion(
    config: str | Path | Mapping[str, Any] | None = None, overrides: Sequence[str] = (), **changes: Any
) -> Motion:
    """Return the class, the frequencies and the periods of an exact motion.

    All results follow from the initial state and the closed form of the motion. Nothing is integrated, so the scheme,
    ``h`` and ``N`` of the config do not matter. All quantities are dimensionless, as in configs.

    Parameters
    ----------
    config : path, str or mapping, optional
        Config file, name of a scene (a packaged config), or the content of a config, as for ``topcli.simulate``. The
        keys ``top`` and ``initial`` are enough.
    overrides : sequence of str
        Texts ``"key=value"`` that replace keys of the config, as for ``--set`` on the command line. They are applied
        after ``changes``.
    **changes
        Values that replace whole top-level keys of the config.

    Returns
    -------
    Motion
        For the Kowalevski top, the class of the torus, its frequencies and periods, and the distance to the nearest
        separatrix. For the Euler top, the class and the period of the polhode. For the Lagrange top, nutation and
        precession. For a top without a closed form, only the integrals.

    Raises
    ------
    ConfigError
        If the config cannot be read, is invalid, or describes an ensemble or a sweep.
    UnknownNameError
        If no scene has the given name.

    Examples
    --------
    >>> import topcli
    >>> motion = topcli.motion("lagrange_cusps")
    >>> motion.title
    'nutation with cusps: the axis stops at one of the bounds'
    >>> round(motion["period.nutation"], 6)
    2.15473
    """
    from topcli.analysis.motion.of_top import motion_of
    from topcli.config.load import load_experiment

    if config is None or isinstance(config, Mapping):
        # keys that a config needs and a motion does not
        length = {} if "T" in {**(config or {}), **changes} else {"N": 1}
        config = {"name": "motion", "scheme": "taylor", "h": 0.01, **length, **(config or {})}
    experiment = load_experiment(config, overrides, changes, any_precision=True)
    return motion_of(experiment.top, experiment.y0)
