"""The only driver: advances the trajectories of a plan chunk by chunk and passes their rows to consumers.

Of a single trajectory without more, it returns the orbit: its states in memory, and its ending.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from contextvars import copy_context
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topcli.contracts import Array, Ending, Invariant, Method, Top, stop_asked
from topcli.engine.consumers import Consumer, EnergyWatch, Memory, State
from topcli.engine.integration import Integration
from topcli.engine.machine import Machine
from topcli.engine.rows import Plan

# glibc keeps freed memory up to twice the largest block freed before, which saves the page faults of temporaries
np.empty(1 << 21)


def default_threads() -> int:
    """Number of CPUs that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Chunk:
    """The moment between two chunks of a drive: all that was computed is with the consumers.

    It is the last one if the drive is ``stopping``.
    """

    def __init__(self, run: Integration, consumers: Sequence[Consumer], stopping: bool) -> None:
        self.run, self._consumers, self.stopping = run, consumers, stopping

    def state(self) -> State:
        """The complete state, from which ``drive`` continues: of the trajectories and of all consumers."""
        states = [self.run.state(), *(consumer.state() for consumer in self._consumers)]
        return {f"{i}.{name}": array for i, state in enumerate(states) for name, array in state.items()}


def drive(
    plan: Plan,
    consumers: Sequence[Consumer] = (),
    *,
    start: State | None = None,
    on_chunk: Callable[[Chunk], None] = lambda chunk: None,
    threads: int | None = None,
) -> Integration:
    """Take all steps of a plan, and pass the rows recorded on the way to the ``consumers``.

    Once the work is asked to stop (``contracts.stopping_when``), the trajectories that have steps left are
    ``interrupted``. A batch stops between two tiles, which may be before the first row of the later ones.

    Parameters
    ----------
    plan : Plan
        Trajectories, steps and machine code.
    consumers : sequence of Consumer
        They are fed with the same pieces of rows; columns are evaluated once for all of them.
    start : mapping, optional
        ``state()`` of a chunk of an equal drive with equal consumers, to continue from there.
    on_chunk : callable, optional
        Called between chunks.
    threads : int, optional
        Threads for the tiles of a batch, by default one for each CPU. They change no bit of any row.

    Returns
    -------
    Integration
        ``endings`` tells how the trajectories ended, ``last`` holds their last states.
    """
    threads = threads or default_threads()
    everyone = [EnergyWatch(), *consumers]
    run = Integration(plan, threads, _part(start, 0) if start else None)
    for i, consumer in enumerate(everyone, start=1):
        consumer.begin(plan)
        if start:
            consumer.restore(_part(start, i))

    def advance(tile: int) -> list[Any]:
        rows = run.advance(tile)
        return [consumer.add(rows) for consumer in everyone]

    threads = min(threads, len(run.done)) if run.lanes > 1 else 1
    with ThreadPoolExecutor(threads - 1) if threads > 1 else nullcontext() as pool:
        stopping = False
        while (tiles := run.waiting) and not stopping:
            with np.errstate(all="ignore"):
                pieces = _in_order(advance, tiles, pool) if run.lanes > 1 else [advance(tile) for tile in tiles]
            for results in pieces:
                for consumer, result in zip(everyone, results, strict=True):
                    consumer.take(result)
            stopping = stop_asked()
            on_chunk(Chunk(run, everyone, stopping))
    run.finish()
    with np.errstate(all="ignore"):
        for consumer in everyone:
            consumer.end(run)
    return run


def _in_order(
    advance: Callable[[int], list[Any]],
    tiles: Sequence[int],
    pool: ThreadPoolExecutor | None,
) -> list[list[Any]]:
    """Results of ``advance`` for the ``tiles``, of all of them or, after a request to stop, of the first ones.

    No tile is begun after a stop, nor one without those before it, so that the order of rows depends on no stop.
    """
    results, waiting, taking = dict[int, list[Any]](), iter(tiles), threading.Lock()

    def work() -> None:
        while True:
            with taking:
                tile = None if stop_asked() else next(waiting, None)
            if tile is None:
                return
            results[tile] = advance(tile)

    others = [pool.submit(copy_context().run, work) for _ in tiles[1:]] if pool else []
    work()
    for other in others:
        other.result()
    return [results[tile] for tile in tiles if tile in results]


def _part(state: State, i: int) -> State:
    """State of the trajectories (0) or of consumer number ``i`` from that of a chunk."""
    return {key.removeprefix(f"{i}."): array for key, array in state.items() if key.startswith(f"{i}.")}


class Orbit(NamedTuple):
    """Recorded rows of one trajectory, step numbers ``n`` (m,) and ``states`` (m, d), and its ``ending``."""

    n: NDArray[np.int64]
    states: Array
    ending: Ending


def orbit(
    top: Top,
    method: Method | Machine,
    y0: ArrayLike,
    h: float,
    N: int,
    every: int = 1,
    invariants: Sequence[Invariant] = (),
) -> Orbit:
    """Orbit of ``method`` from the state ``y0`` (d,) over N steps of ``h``, of which every ``every``-th is recorded.

    Instead of the method, its machine code may be given. The energy is watched if it is one of the ``invariants``.
    """
    states: Any = np.array([y0])
    if states.dtype != np.object_:
        states = states.astype(np.float64)
    memory = Memory()
    machine = method if isinstance(method, Machine) else Machine(top, method)
    plan = Plan(top, machine, states, h, N, every, invariants=tuple(invariants))
    run = drive(plan, [memory])
    return Orbit(memory.n, memory.states[0], run.endings[0])
