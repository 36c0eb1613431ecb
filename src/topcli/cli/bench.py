"""``topcli bench``: measure speed against error of schemes and of other integrators."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from topcli.cli.options import Json, Out, Quiet, Schemes, Sets, config_option
from topcli.cli.output import (
    ProgressDisplay,
    emit,
    emit_prose,
    messages,
    print_cells,
    print_json,
    print_message,
    print_warnings,
)
from topcli.errors import ExitCode

if TYPE_CHECKING:
    from topcli.studies.bench.contest import LineUp, Problem
    from topcli.studies.bench.peers import Peer


def _complete_scene(incomplete: str) -> list[str]:
    from topcli.studies.bench.contest import SCENES

    return [name for name in SCENES if name.startswith(incomplete.lower())]


def _print_result(result: dict[str, Any], all_points: bool) -> None:
    """Print the result of one scene: decades that are won, the table of decades; with ``all_points`` all details."""
    from topcli.studies.bench.result import DECADE_TABLE, POINT_TABLE, ladder_lines, microseconds, setup_words
    from topcli.table import number

    span = f"t from 0 to {result['duration']:g}, CPU time per unit of time"
    title = f"{result['name']}: {result['title']}, {span}"
    reached = [row for row in result["decades"] if row["peer"]]
    if reached and result["goal"]:
        met = sum(row["ratio"] is not None and row["ratio"] >= result["goal"] for row in reached)
        goal = f"at least {result['goal']:g} times faster than the best peer"
        emit_prose(f"{result['name']}: {goal} at {met} of the {len(reached)} decades that a peer reaches")
        emit()
    print_cells(replace(DECADE_TABLE.cells(result), numbers=(0, 3, 6, 7, 8)), title)
    said = [row["words"] for row in result["decades"]] if all_points else []
    for row in result["closed_forms"]:
        error, time = number(row["error"]), microseconds(row["seconds_per_state"])
        said.append(
            f"in closed form, {row['name']}: distance from the reference {error}, {time} µs a state over "
            f"{row['states']} states{setup_words(row)}"
        )
    if said:
        emit()
    for line in said:
        emit_prose(line)
    emit()
    if all_points:
        print_cells(replace(POINT_TABLE.cells(result), numbers=range(2, 7), keys=2), f"{result['name']}: every point")
        emit()
        for line in ladder_lines(result):
            emit_prose(line)
        emit()


def _contest(problems: Sequence[Problem], schemes: Sequence[str]) -> list[LineUp]:
    """Competitors of each problem. Raises UsageError for a scheme that takes part in none."""
    from topcli.errors import UsageError, quoted
    from topcli.studies.bench.contest import choose
    from topcli.studies.entries import scheme_with

    fields = [choose(problem, schemes) for problem in problems]
    for name in schemes:
        if all(any(name == left for left, _ in field.left_out) for field in fields):
            scheme_with(name, problems[0].top.form)  # names the tops that it fits
            raise UsageError(f"scheme {quoted(name)} cannot be measured: {fields[0].left_out[0][1]}")
    return fields


def _peers(against: str) -> list[Peer]:
    """Peers named by ``--against``."""
    from topcli.studies.bench.peers import PEERS, find_peers

    if against.lower() == "all":
        return find_peers(list(PEERS))
    return find_peers([] if against.lower() == "none" else [part for part in against.split(",") if part])


Scenes = Annotated[
    list[str] | None,
    typer.Option(
        "--scene", metavar="SCENE", help="Measure on this scene.", show_default="all", autocompletion=_complete_scene
    ),
]
Configs = Annotated[
    list[str] | None,
    config_option("the packaged scenes of the benchmark"),
]
Against = Annotated[
    str, typer.Option("--against", metavar="PEER,...", help="Compare with the peers named here, or with all or none.")
]
Budget = Annotated[float, typer.Option("--budget", metavar="SECONDS", help="Limit the CPU time of one run.", min=1e-4)]
Repetitions = Annotated[
    int, typer.Option("--repetitions", metavar="COUNT", help="Repeat each short run this many times.", min=1)
]
Processes = Annotated[
    int,
    typer.Option("--processes", metavar="COUNT", help="Use this many processes for each peer of varying speed.", min=1),
]
Samples = Annotated[
    int,
    typer.Option(
        "--samples", metavar="COUNT", help="Measure the error at this many points in time.", min=1, max=100_000
    ),
]
Points = Annotated[bool, typer.Option("--points", help="Print all measurements, not only the fastest ones.")]


def bench(
    schemes: Schemes = None,
    scenes: Scenes = None,
    configs: Configs = None,
    sets: Sets = None,
    against: Against = "all",
    budget: Budget = 0.06,
    repetitions: Repetitions = 7,
    processes: Processes = 5,
    samples: Samples = 100,
    all_points: Points = False,
    out: Out = Path("results/bench"),
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure speed against error and name the fastest schemes.

    Each scheme runs with a series of step sizes. Each peer (an integrator of another package) runs with a series of
    step sizes or tolerances. An earlier result of the same name is renamed.
    """
    from topcli.store.files import require_writable
    from topcli.store.provenance import now
    from topcli.studies.bench.contest import bench_problems
    from topcli.studies.bench.measure import Effort, code_of
    from topcli.studies.bench.measure import bench as measure
    from topcli.studies.bench.result import require_bench_folder, store_bench

    peers = _peers(against)
    problems = bench_problems(scenes or (), configs or (), sets or (), samples)
    fields = _contest(problems, schemes or ())
    require_bench_folder(out)
    require_writable(out)
    display = ProgressDisplay(len(problems), as_json or quiet, unit="measurements")
    say = messages(quiet)
    effort = Effort(budget, repetitions)
    results = []
    for problem, field in zip(problems, fields, strict=True):
        if not quiet:
            print_warnings(problem.experiment)
        for name, reason in field.left_out if schemes else ():
            say(f"{problem.name}: {name} is left out: {reason}")
        if not (field.schemes or field.closed_forms or peers):
            continue
        display.begin(problem.name)
        started = now()
        try:
            result = measure(problem, field, peers, effort, processes=processes, on_progress=display, on_message=say)
        finally:
            display.close()
        stored, aside = store_bench(result, code_of(field, problem), started, out)
        if aside is not None:
            say(f"{problem.name}: renamed the earlier result to {aside}")
        results.append({**result, "folder": str(stored.folder)})
        if not (as_json or quiet):
            _print_result(result, all_points)
            print_message(f"wrote {stored.folder}")
    if as_json:
        print_json("bench", {"scenes": results})
    if any(result["failed_peers"] or any(row["broken"] for row in result["competitors"]) for result in results):
        raise typer.Exit(ExitCode.PARTLY_FAILED)
