"""``topcli run``: experiments into run folders."""

from __future__ import annotations

import signal
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from topcli.cli.options import Force, Json, Out, SchemeFiles, Sets, complete_config, load_scheme_files
from topcli.cli.talk import ProgressTeller, emit, print_json, print_table, say, say_error, say_warnings
from topcli.errors import TopcliError, UsageError, shortened

if TYPE_CHECKING:
    from topcli.config.ensemble import EnsembleExperiment
    from topcli.config.models import Experiment
    from topcli.studies.run import RunResult


class Interruption:
    """Turns the first Ctrl-C, SIGTERM or hang-up into a request to stop between chunks; the second one is immediate.

    A hang-up that is ignored, as under ``nohup``, stays so.
    """

    def __init__(self) -> None:
        self.asked = False
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> Interruption:
        hang_up = getattr(signal, "SIGHUP", None)
        hung_up = [] if hang_up is None or signal.getsignal(hang_up) == signal.SIG_IGN else [hang_up]
        for number in (signal.SIGINT, signal.SIGTERM, *hung_up):
            self._previous[number] = signal.signal(number, self._ask)
        return self

    def _ask(self, number: int, frame: object) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True

    def __exit__(self, *exception: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)


def _experiment(config: str, sets: list[str], output_format: str | None) -> Experiment | EnsembleExperiment:
    from topcli.config.load import load_any

    return load_any(config, [*sets, *([f"output.format={output_format}"] if output_format else [])])


def _tell(result: RunResult, labelled: bool) -> None:
    report, warning = result.report, ""
    if report.get("kind") == "ensemble":
        from topcli.studies.ensemble_report import ensemble_table as invariant_table
    else:
        from topcli.studies.report import invariant_table, warning_of

        warning = warning_of(report)
    if result.set_aside:
        say(f"kept the earlier, different run as {result.set_aside}")
    status = result.status
    if status == "up to date" and result.outcome.value != "completed":
        status = f"not run again: it ended as {result.outcome.value} before; --retry-failed runs it again"
    say(f"{report['name']}: {report['message']} -> {result.stored.folder} ({status})")
    if warning:
        say(f"warning: {report['name']}: {warning}")
    header, *lines = invariant_table(report)
    print_table(header, lines, report["name"] if labelled else "")


def _dry_run(experiment: Experiment | EnsembleExperiment, out: Path, how: How) -> dict[str, Any]:
    from topcli.config.models import Experiment
    from topcli.studies.identity import Identity
    from topcli.studies.plan import plan_run

    source = None
    if isinstance(experiment, Experiment):
        from topcli.studies.resume import find_source

        identity, rows = Identity.of(experiment, [experiment.method()]), experiment.N // experiment.output.every + 1
        source = find_source(identity, out) if how.resume else None
    else:
        from topcli.studies.ensemble import ensemble_identity

        _refuse_to_resume(how.resume)
        identity, rows = ensemble_identity(experiment), experiment.rows
    plan = plan_run(identity, out, force=how.force, retry_failed=how.retry_failed, source=source)
    return {
        "config": identity.config,
        "digest": identity.digest,
        "folder": str(out / identity.name),
        "action": plan.action,
        "rows": rows,
    }


@dataclass(frozen=True)
class How:
    """What the command line says about how to run, as opposed to what."""

    force: bool
    resume: bool
    retry_failed: bool
    checkpoint_every: float
    threads: int | None
    quiet: bool


def _refuse_to_resume(resume: bool) -> None:
    """Ensembles have no checkpoints."""
    if resume:
        raise UsageError("--resume continues a run of one trajectory; an ensemble is run again whole")


def _run(
    experiment: Experiment | EnsembleExperiment,
    out: Path,
    how: How,
    teller: ProgressTeller,
    interruption: Interruption,
) -> RunResult:
    """Run one experiment or ensemble into its folder."""
    from topcli.config.models import Experiment

    def stop() -> bool:
        return interruption.asked

    if isinstance(experiment, Experiment):
        from topcli.studies.run import run_experiment

        return run_experiment(
            experiment,
            out,
            force=how.force,
            resume=how.resume,
            retry_failed=how.retry_failed,
            checkpoint_every=how.checkpoint_every,
            progress=teller,
            stop=stop,
            tell=(lambda line: None) if how.quiet else say,
        )
    from topcli.studies.ensemble import run_ensemble

    _refuse_to_resume(how.resume)
    return run_ensemble(
        experiment,
        out,
        force=how.force,
        retry_failed=how.retry_failed,
        threads=how.threads,
        progress=teller,
        stop=stop,
    )


def _code(result: RunResult) -> int:
    """The exit code of one run: of an ensemble, 3 when some trajectories failed and some did not."""
    if result.outcome.value in ("completed", "interrupted"):
        return 0 if result.outcome.value == "completed" else 130
    return 3 if result.report.get("outcomes", {}).get("completed") else 1


def _exit_code(codes: list[int]) -> int:
    """130 if interrupted; for one config its code; for several 0, or 3 when some failed, or the one code of all."""
    if 130 in codes:
        return 130
    if 0 in codes and any(codes):
        return 3
    return codes[0] if len(set(codes)) == 1 else max(codes)


def run(
    configs: Annotated[
        list[str],
        typer.Argument(
            metavar="CONFIG",
            help="Config files, or names of packaged scenes.",
            autocompletion=complete_config,
        ),
    ],
    sets: Sets = None,
    out: Out = Path("results"),
    output_format: Annotated[str | None, typer.Option("--format", metavar="FORMAT", help="parquet or csv.")] = None,
    force: Force = False,
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Continue an interrupted or killed run from its last checkpoint, bit for bit."),
    ] = False,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Run again what ended before, but not as completed.")
    ] = False,
    checkpoint_every: Annotated[
        float,
        typer.Option(
            "--checkpoint-every",
            metavar="SECONDS",
            help="Seconds between checkpoints; 0 writes one after every chunk.",
        ),
    ] = 10.0,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check the configs and say what would be done.")] = False,
    as_json: Json = False,
    threads: Annotated[
        int | None,
        typer.Option("--threads", metavar="COUNT", min=1, help="Threads for ensembles; all CPUs by default."),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")] = False,
    fail_fast: Annotated[bool, typer.Option("--fail-fast", help="Stop at the first config that fails.")] = False,
    scheme_files: SchemeFiles = None,
) -> None:
    """Run experiments and report on their conservation laws.

    Each experiment or ensemble gets a folder with its time series and the report.

    A long run writes checkpoints. Ctrl-C or SIGTERM ends it as interrupted (exit code 130), with what was recorded in
    its folder; --resume continues it, and also a run that was killed, and ends as if it had never been stopped.
    """
    if output_format not in (None, "parquet", "csv"):
        raise UsageError(f"--format {shortened(output_format)}: not a format of a series; choose parquet or csv")
    if resume and force:
        raise UsageError("--resume continues a run and --force repeats it: give one of them")
    if not checkpoint_every >= 0.0:
        raise UsageError(f"--checkpoint-every {checkpoint_every:g}: must be a number of seconds from 0 on")
    how = How(force, resume, retry_failed, checkpoint_every, threads, quiet)
    load_scheme_files(scheme_files)
    told: list[dict[str, Any]] = []
    codes: list[int] = []
    teller = ProgressTeller(len(configs), quiet)
    with Interruption() as interruption:
        for config in configs:
            try:
                experiment = _experiment(config, sets or [], output_format)
                if not quiet:
                    say_warnings(experiment)
                if dry_run:
                    plan = _dry_run(experiment, out, how)
                    told.append(plan)
                    codes.append(0)
                    if not (as_json or quiet):
                        emit(f"{experiment.name}: {plan['action']}: {plan['rows']} rows in {plan['folder']}")
                    continue
                teller.begin(experiment.name)
                result = _run(experiment, out, how, teller, interruption)
                teller.close()
                if not (quiet or as_json):
                    _tell(result, labelled=len(configs) > 1)
                told.append({"folder": str(result.stored.folder), "status": result.status, **result.report})
                codes.append(_code(result))
                if codes[-1]:
                    what = "some trajectories failed" if codes[-1] == 3 else result.outcome.value
                    more = "; --resume continues it" if codes[-1] == 130 and "kind" not in result.report else ""
                    kept = "the series" if result.outcome.value == "left_motion" else "what came before"
                    say(f"error: {experiment.name}: {what}; {kept} is kept{more}")
            except Exception as error:
                from topcli.schemes.user_code import users_error

                found = error if isinstance(error, TopcliError) else users_error(error)
                if found is None:
                    raise
                teller.close()
                say_error(found)
                told.append({"config": config, "error": str(found), "exit_code": found.exit_code})
                codes.append(found.exit_code)
            if codes[-1] == 130 or (codes[-1] and fail_fast):
                break
    if as_json:
        print_json("run", {"runs": told})
    elif len(configs) > 1 and not quiet:
        say(f"{codes.count(0)} of {len(configs)} configs fine, {len(configs) - codes.count(0)} not")
    if code := _exit_code(codes):
        raise typer.Exit(code)
