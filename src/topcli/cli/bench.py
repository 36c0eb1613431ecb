"""``topcli bench``: speed against error, ours and other people's integrators."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from topcli.cli.options import Json, SchemeFiles, Sets, complete_config, complete_scheme, load_scheme_files
from topcli.cli.talk import ProgressDisplay, emit, emit_prose, print_json, print_table, say, say_warnings


def _complete_scene(incomplete: str) -> list[str]:
    from topcli.studies.bench.scenes import SCENES

    return [name for name in SCENES if name.startswith(incomplete.lower())]


def _tell(result: dict[str, Any], all_points: bool) -> None:
    """Print one scene's result: the table of decades, the front in words, and every point when asked for."""
    from topcli.studies.bench.stored import decade_lines, ladder_lines, microseconds, point_lines
    from topcli.studies.report import number

    span = f"t from 0 to {result['duration']:g}, CPU time per unit of time"
    print_table(*decade_lines(result), numbers=(0, 3, 6, 7, 8), title=f"{result['name']}: {result['title']}, {span}")
    emit()
    for row in result["decades"]:
        emit_prose(row["words"])
    reached = [row for row in result["decades"] if row["peer"]]
    if reached and result["goal"]:
        met = sum(row["ratio"] is not None and row["ratio"] >= result["goal"] for row in reached)
        goal = f"at least {result['goal']:g} times faster than the best peer"
        emit_prose(f"{goal} at {met} of the {len(reached)} decades that a peer reaches")
    for row in result["closed_forms"]:
        told = f"{number(row['error'])}, {microseconds(row['seconds_per_state'])} µs a state"
        emit_prose(f"in closed form, {row['name']}: distance from the reference {told}")
    emit()
    if all_points:
        print_table(*point_lines(result), numbers=(2, 3, 4, 5, 6), keys=2, title=f"{result['name']}: every point")
        emit()
        for line in ladder_lines(result):
            emit_prose(line)
        emit()


def bench(
    schemes: Annotated[
        list[str] | None,
        typer.Argument(metavar="SCHEME", help="Names of schemes; all by default.", autocompletion=complete_scheme),
    ] = None,
    scenes: Annotated[
        list[str] | None,
        typer.Option("--scene", metavar="SCENE", help="A scene; all by default.", autocompletion=_complete_scene),
    ] = None,
    configs: Annotated[
        list[str] | None,
        typer.Option("--config", metavar="CONFIG", help="A config as a scene.", autocompletion=complete_config),
    ] = None,
    sets: Sets = None,
    against: Annotated[
        str, typer.Option("--against", metavar="PEER,...", help="Peers: all, none, or names with commas.")
    ] = "all",
    budget: Annotated[
        float, typer.Option("--budget", metavar="SECONDS", help="CPU seconds that one run may take.", min=1e-4)
    ] = 0.06,
    repetitions: Annotated[
        int, typer.Option("--repetitions", metavar="COUNT", help="Repetitions of a quick run.", min=1)
    ] = 7,
    processes: Annotated[
        int,
        typer.Option(
            "--processes", metavar="COUNT", help="Processes for a peer whose speed varies between them.", min=1
        ),
    ] = 5,
    samples: Annotated[
        int,
        typer.Option("--samples", metavar="COUNT", help="Times at which the error is looked at.", min=1, max=100_000),
    ] = 100,
    all_points: Annotated[bool, typer.Option("--points", help="Print every point, not the front alone.")] = False,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder of the results.")] = Path("results/bench"),
    as_json: Json = False,
    scheme_files: SchemeFiles = None,
) -> None:
    """Measure speed against error and name the fastest schemes.

    Every scheme and peer climbs a ladder of step sizes or tolerances.
    """
    from topcli.errors import UsageError, quoted
    from topcli.schemes.registry import find_scheme
    from topcli.store.provenance import now
    from topcli.store.run_folder import require_writable
    from topcli.studies.bench.measure import Effort
    from topcli.studies.bench.run import bench as measure
    from topcli.studies.bench.run import choose, code_of
    from topcli.studies.bench.scenes import bench_problems
    from topcli.studies.bench.stored import require_bench_folder, store_bench
    from topcli.studies.peers import PEERS, find_peers

    load_scheme_files(scheme_files)
    named = [] if against.lower() == "none" else [part for part in against.split(",") if part]
    peers = find_peers(list(PEERS) if against.lower() == "all" else named)
    problems = bench_problems(scenes or (), configs or (), sets or (), samples)
    fields = [choose(problem, schemes or ()) for problem in problems]
    for name in schemes or ():
        if all(any(name == left for left, _ in field.left_out) for field in fields):
            find_scheme(name, problems[0].top.form)  # says what it fits
            raise UsageError(f"scheme {quoted(name)} cannot be measured: {fields[0].left_out[0][1]}")
    require_bench_folder(out, [problem.name for problem in problems])
    require_writable(out)
    teller = ProgressDisplay(len(problems), as_json)
    results, failed = [], False
    for problem, field in zip(problems, fields, strict=True):
        say_warnings(problem.experiment)
        for name, reason in field.left_out if schemes else ():
            say(f"{problem.name}: {name} is left out: {reason}")
        if not (field.schemes or field.exact or peers):
            continue
        teller.begin(problem.name)
        started = now()
        try:
            result = measure(
                problem, field, peers, Effort(budget, repetitions), processes=processes, progress=teller, told=say
            )
        finally:
            teller.close()
        stored, aside = store_bench(result, code_of(field, problem), started, now(), out)
        if aside is not None:
            say(f"{problem.name}: kept the earlier, different result as {aside}")
        results.append({**result, "folder": str(stored.folder)})
        failed = failed or bool(result["failed_peers"]) or any(row["broken"] for row in result["competitors"])
        if not as_json:
            _tell(result, all_points)
            say(f"wrote {stored.folder}")
    if as_json:
        print_json("bench", {"scenes": results})
    if failed:
        raise typer.Exit(3)
