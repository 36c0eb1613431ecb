"""Plans of an experiment, and its trajectories in memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from topcli.analysis.crossings import CrossingSearch, SectionRows
from topcli.analysis.tally import Tally
from topcli.analysis.trajectory import Trajectory
from topcli.config.models import Experiment
from topcli.contracts import Array, Invariant
from topcli.engine.consumers import Memory, Pieces
from topcli.engine.drive import drive
from topcli.engine.endings import Endings
from topcli.engine.machine import Machine, machine_of
from topcli.engine.rows import Plan, Rows
from topcli.errors import UsageError

if TYPE_CHECKING:
    from topcli.engine.numbers import PreciseRun

_BLOCK = 1024
"""Trajectories of a plan; a larger ensemble is a sequence of plans, so that its memory is bounded."""
MAX_NUMBERS = 5 * 10**8
"""Largest count of numbers in the states of a result in memory: four gigabytes."""


def plans(experiment: Experiment, block: int = _BLOCK) -> Iterator[Plan]:
    """Plans of an experiment: one, or of an ensemble one for each ``block`` of trajectories with the same top.

    Raises UsageError for an experiment that cannot be computed.
    """
    if not experiment.ensemble:
        yield _single(experiment)
        return
    offset = 0
    for top in experiment.ensemble.tops:
        plan = plan_of(experiment.model_copy(update={"top": top}), np.empty((0, 0)))
        for start in range(0, len(experiment.ensemble.states), block):
            states = experiment.ensemble.states[start : start + block]
            yield replace(plan, states=states, first=offset)
            offset += len(states)


def plan_of(experiment: Experiment, states: Array, machine: Machine | None = None) -> Plan:
    """Plan of an experiment in doubles from ``states`` (B, d), with the ``machine`` of its scheme if there is one."""
    top = experiment.top
    return Plan(
        top,
        machine or machine_of(top, experiment.scheme, experiment.options),
        states,
        experiment.h,
        experiment.N,
        1 if experiment.crossings else experiment.output.every,
        experiment.tallied,
        invariants=(*top.invariants(), *experiment.modified),
        quantities=experiment.quantities,
    )


def _single(experiment: Experiment) -> Plan:
    """Plan of one trajectory, in its precision and with its attitude."""
    plan = plan_of(experiment, np.array([experiment.y0]))
    top, scheme = experiment.top, experiment.scheme
    assert plan.machine is not None
    if form := experiment.output.attitude:
        from topcli.engine.attitude import attitude_loop, start_attitude

        loop = attitude_loop(top, scheme, experiment.options, plan.machine.method)
        start = np.array([(*experiment.y0, *start_attitude(top, experiment.y0))])
        return replace(plan, machine=Machine(top, plan.machine.method, loop), states=start, attitude=form)
    precise = precise_of(experiment)
    if precise is None:
        return plan
    exact = _invariants(experiment, precise)
    machine = Machine(precise.top, plan.machine.method, precise.loop)
    return replace(plan, machine=machine, states=precise.y0[None, :], precise=precise, exact=exact)


def _invariants(experiment: Experiment, precise: PreciseRun) -> tuple[Invariant, ...]:
    """Integrals of the top and of the scheme in the numbers of a run."""
    scheme = experiment.scheme
    modified = scheme.modified(precise.top, precise.h, experiment.options) if scheme.modified else ()
    return (*precise.top.invariants(), *modified)


def precise_of(experiment: Experiment) -> PreciseRun | None:
    """Top, step and numbers of an experiment in its precision; None if that is double.

    Raises UsageError, naming the scheme and the reason, if the scheme has no such precision.
    """
    written = experiment.written
    if written is None:
        return None
    from topcli.engine.numbers import prepared

    numbers = (written.h, written.parameters, written.y0)
    options, precision = experiment.options, experiment.precision
    return prepared(experiment.scheme, experiment.top, options, precision, numbers, experiment.max_digits)


def trajectory_of(experiment: Experiment, threads: int | None = None) -> Trajectory:
    """Trajectories of an experiment, computed in memory. Raises UsageError if they would not fit."""
    ensemble = experiment.ensemble
    if not ensemble:
        if experiment.crossings:
            return _crossings(experiment)
        return trajectory_along(next(plans(experiment)), experiment.scheme.name)
    store = ensemble.store == "trajectories"
    if experiment.crossings is not None:
        raise UsageError("`topcli run` records the crossings of an ensemble, in a file; leave out section")
    rows = experiment.N // experiment.output.every + 1 if store else 0
    _require_memory(ensemble.count, rows, len(experiment.top.components))
    parts = [_part(plan, experiment, store, threads) for plan in plans(experiment, ensemble.count)]
    if len(parts) == 1:
        return parts[0]
    last, last_n = (np.concatenate([getattr(part, name) for part in parts]) for name in ("last", "last_n"))
    recorded, lengths = (
        np.concatenate([getattr(part.rows, name) for part in parts]) for name in ("recorded", "lengths")
    )
    endings = Endings.joined([part.endings for part in parts])
    together = Rows(parts[0].rows.plan, parts[0].rows.n, recorded, lengths=lengths)
    seconds = {**parts[0].seconds, "run": sum(part.seconds["run"] for part in parts)}
    tallies = [tally for part in parts for tally in part.tallies]
    return Trajectory(together, experiment.scheme.name, endings, last, last_n, seconds, tallies, tuple(parts))


def _require_memory(count: int, rows: int, d: int) -> None:
    """Raise UsageError if ``rows`` rows of each of ``count`` trajectories do not fit in memory."""
    if count * rows * d > MAX_NUMBERS:
        what = f"{rows} rows" if count == 1 else f"{count} trajectories of {rows} rows"
        less = "" if count == 1 else ", or keep less with store: final or statistics"
        raise UsageError(f"{what} do not fit in memory; record fewer with output.every{less}")


def _part(plan: Plan, experiment: Experiment, store: bool, threads: int | None) -> Trajectory:
    """Trajectories of one plan of an ensemble, with their rows or without."""
    memory, tally = Memory(), Tally()
    run = drive(plan, [memory, tally] if store else [tally], threads=threads)
    n = memory.n if store else np.zeros(0, dtype=np.int64)
    recorded = memory.states if store else np.zeros((len(plan.states), 0, plan.states.shape[1]))
    rows = Rows(plan, n, recorded, lengths=np.searchsorted(n, run.last_n, side="right"))
    return Trajectory(rows, experiment.scheme.name, run.endings, run.last, run.last_n, run.times, [tally])


def trajectory_along(plan: Plan, scheme: str) -> Trajectory:
    """Trajectory of a plan with one initial state under the ``scheme`` of this name."""
    rows = plan.N // plan.every + 1
    _require_memory(1, rows, plan.states.shape[1])
    memory = Memory()
    run = drive(plan, [memory])
    recorded = Rows(plan, memory.n, memory.states[0])
    return Trajectory(recorded, scheme, run.endings, run.last[0], run.last_n[0], run.times)


def search_of(experiment: Experiment, plan: Plan) -> CrossingSearch:
    """Search for the crossings of an experiment's section by the trajectories of a plan."""
    assert experiment.crossings is not None
    assert plan.machine is not None
    return experiment.crossings.search(plan.top, plan.machine.method, plan.h, plan.states)


def _crossings(experiment: Experiment) -> Trajectory:
    """Crossings of a section by one trajectory."""
    pieces, plan = Pieces(), next(plans(experiment))
    run = drive(plan, [SectionRows(lambda plan: search_of(experiment, plan), pieces)])
    n = np.concatenate([np.zeros(0), *(piece.n for piece in pieces.pieces)])
    states = np.concatenate([plan.states[:0], *(piece.states[0] for piece in pieces.pieces)])
    whole = np.concatenate([np.zeros(0, dtype=np.int64), *(piece["n"][0] for piece in pieces.pieces)])
    rows = Rows(plan, n, states, columns={"n": whole})
    return Trajectory(rows, experiment.scheme.name, run.endings, run.last[0], run.last_n[0], run.times)
