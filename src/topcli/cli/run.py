"""``topcli run``: experiments into run folders."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from topcli.cli.options import Force, Json, Out, SchemeFiles, Sets, complete_config, load_scheme_files
from topcli.cli.talk import ProgressTeller, print_json, print_table, say, say_warnings
from topcli.errors import TopcliError, UsageError

if TYPE_CHECKING:
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


def _experiment(config: str, sets: list[str], output_format: str | None) -> Experiment:
    from topcli.config.load import load_experiment

    return load_experiment(config, [*sets, *([f"output.format={output_format}"] if output_format else [])])


def _tell(result: RunResult, labelled: bool) -> None:
    from topcli.studies.report import invariant_table, warning_of

    report = result.report
    if result.set_aside:
        say(f"kept the earlier, different run as {result.set_aside}")
    say(f"{report['name']}: {report['message']} -> {result.stored.folder} ({result.status})")
    if warning := warning_of(report):
        say(f"warning: {report['name']}: {warning}")
    header, *lines = invariant_table(report)
    print_table(header, lines, report["name"] if labelled else "")


def _dry_run(experiment: Experiment, out: Path, force: bool, resume: bool) -> dict[str, Any]:
    from topcli.studies.resume import find_source
    from topcli.studies.run import method_fingerprint, plan_run

    code = method_fingerprint(experiment.method())
    source = find_source(experiment, out, code) if resume else None
    return {
        "config": experiment.resolved(),
        "digest": experiment.digest,
        "folder": str(out / experiment.name),
        "action": plan_run(experiment, out, code, force=force, source=source).action,
        "rows": experiment.N // experiment.output.every + 1,
    }


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
            metavar="CONFIG...",
            help="Config files, or names of packaged scenes.",
            autocompletion=complete_config,
        ),
    ],
    sets: Sets = None,
    out: Out = Path("results"),
    output_format: Annotated[str | None, typer.Option("--format", help="parquet or csv.")] = None,
    force: Force = False,
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Continue an interrupted or killed run from its last checkpoint, bit for bit."),
    ] = False,
    checkpoint_every: Annotated[
        float,
        typer.Option(
            "--checkpoint-every", metavar="SECONDS", help="Seconds between checkpoints; 0: as often as can be."
        ),
    ] = 10.0,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check the configs and say what would be done.")] = False,
    as_json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")] = False,
    fail_fast: Annotated[bool, typer.Option("--fail-fast", help="Stop at the first config that fails.")] = False,
    scheme_files: SchemeFiles = None,
) -> None:
    """Run experiments: time series and a report on the conservation laws, in one folder each.

    A long run writes checkpoints. Ctrl-C or SIGTERM ends it as interrupted (exit code 130), with what was recorded in
    its folder; --resume continues it, and also a run that was killed, and ends as if it had never been stopped.
    """
    if output_format not in (None, "parquet", "csv"):
        raise UsageError(f"--format {output_format}: not a format of a series; choose parquet or csv")
    if resume and force:
        raise UsageError("--resume continues a run and --force repeats it: give one of them")
    if not checkpoint_every >= 0.0:
        raise UsageError(f"--checkpoint-every {checkpoint_every:g}: must be a number of seconds from 0 on")
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
                    plan = _dry_run(experiment, out, force, resume)
                    told.append(plan)
                    codes.append(0)
                    if not (as_json or quiet):
                        print(f"{experiment.name}: {plan['action']}: {plan['rows']} rows in {plan['folder']}")
                    continue
                from topcli.studies.run import run_experiment

                teller.begin(experiment.name)
                result = run_experiment(
                    experiment,
                    out,
                    force=force,
                    resume=resume,
                    checkpoint_every=checkpoint_every,
                    progress=teller,
                    stop=lambda: interruption.asked,
                    tell=(lambda line: None) if quiet else say,
                )
                teller.close()
                if not (quiet or as_json):
                    _tell(result, labelled=len(configs) > 1)
                told.append({"folder": str(result.stored.folder), "status": result.status, **result.report})
                codes.append({"completed": 0, "interrupted": 130}.get(result.outcome.value, 1))
                if codes[-1]:
                    more = "; --resume continues it" if codes[-1] == 130 else ""
                    say(f"error: {experiment.name}: {result.outcome.value}; what came before is kept{more}")
            except TopcliError as error:
                teller.close()
                say(f"error: {error}")
                told.append({"config": config, "error": str(error), "exit_code": error.exit_code})
                codes.append(error.exit_code)
            if codes[-1] == 130 or (codes[-1] and fail_fast):
                break
    if as_json:
        print_json("run", {"runs": told})
    elif len(configs) > 1 and not quiet:
        say(f"{codes.count(0)} of {len(configs)} configs fine, {len(configs) - codes.count(0)} not")
    if code := _exit_code(codes):
        raise typer.Exit(code)
