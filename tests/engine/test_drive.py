"""The driver: pieces, lanes, threads and stops change no bit and no order of rows, and failures stay alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from conftest import random_states
from steppers import RK2, built
from topcli.contracts import Ending, Floats, Method, Outcome, Stepper, Top, stopping_when
from topcli.engine import integration
from topcli.engine.consumers import Consumer
from topcli.engine.drive import Chunk, drive, orbit
from topcli.engine.integration import Integration
from topcli.engine.machine import FEW_LANES, MANY_LANES, SIDE_BY_SIDE, Machine
from topcli.engine.rows import Plan, Rows
from topcli.tops.kowalevski import Kowalevski


class Kept(Consumer):
    """The numbers of trajectory and step, and the states, of all rows as they come."""

    def __init__(self) -> None:
        self.pieces: list[tuple[np.ndarray, ...]] = []

    def add(self, rows: Rows) -> tuple[np.ndarray, ...]:
        return (*rows.columns(["trajectory", "n"]).values(), rows.recorded[rows.reached])

    def take(self, result: tuple[np.ndarray, ...]) -> None:
        self.pieces.append(tuple(map(np.array, result)))

    @property
    def rows(self) -> tuple[np.ndarray, ...]:
        return tuple(map(np.concatenate, zip(*self.pieces, strict=True)))


def planned(top: Top, method: Method, y0: np.ndarray, h: float, N: int, every: int = 1) -> Plan:
    return Plan(top, Machine(top, method), y0, h, N, every)


def assert_same(plan: Plan, lanes: Sequence[int] = (), **options: Any) -> Integration:
    """A batch has the bits, the rows and the endings of single trajectories, by default of all."""
    kept, (top, h, N, every), machine = Kept(), (plan.top, plan.h, plan.N, plan.every), plan.machine
    run = drive(plan, [kept], **options)
    which, n, states = kept.rows
    assert machine
    assert len(run.endings) == len(plan.states)
    for i in lanes or range(len(plan.states)):
        alone = orbit(top, machine.method, plan.states[i], h, N, every)
        assert np.array_equal(n[which == i], alone.n)
        assert np.array_equal(states[which == i], alone.states), i
        assert run.endings[i] == alone.ending
        if N % every and alone.ending.outcome is Outcome.COMPLETED:
            alone = orbit(top, machine.method, plan.states[i], h, N, math.gcd(N, every))
        assert (run.last[i].tolist(), run.last_n[i]) == (alone.states[-1].tolist(), alone.n[-1])
    return run


def small_pieces(patch: pytest.MonkeyPatch, rows: int, steps: int) -> None:
    """Pieces of this many rows of a batch of eight or of a single trajectory, and chunks of this many steps."""
    patch.setattr(integration, "ROWS", rows * FEW_LANES)
    patch.setattr(integration, "ROWS_ALONE", rows)
    patch.setattr(integration, "CHUNK_STEPS", steps)
    patch.setattr(integration, "CALL_SECONDS", 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hk", "hybrid", "bohlin-b", "midpoint", "hybrid-sym", "hk+suzuki4"])
def test_large_steps_have_the_bits_of_a_single_run(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Large angles take libm's branch, iterations fail, schemes blow up: what happens is what happens alone."""
    small_pieces(monkeypatch, 4, 4)
    y0 = random_states(20, 8) * np.array([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])
    run = assert_same(planned(Kowalevski(), built(name), y0, 1.7, 60))
    failed = [ending.outcome for ending in run.endings if ending.outcome is not Outcome.COMPLETED]
    if name == "hybrid-sym":
        assert Outcome.NO_CONVERGENCE in failed
        assert 0 < len(failed) < 20


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, SIDE_BY_SIDE, FEW_LANES + 1, MANY_LANES // 2 + 1, MANY_LANES, MANY_LANES + 1])
@pytest.mark.parametrize(("N", "every"), [(1, 1), (2, 1), (10, 3), (10, 10), (10, 11)])
def test_batches_of_every_size_and_length_have_the_bits_of_single_runs(count: int, N: int, every: int) -> None:
    run = assert_same(planned(Kowalevski(), built("hk"), random_states(count, 2), 0.01, N, every))
    assert {(ending.outcome, ending.step, ending.t) for ending in run.endings} == {(Outcome.COMPLETED, N, N * 0.01)}


def test_a_failure_stays_alone_in_slabs_and_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of seven slabs of 64 lanes one fails as a whole, and in another a single lane."""
    y0 = random_states(6 * MANY_LANES + 5, 6)
    y0[2 * MANY_LANES : 3 * MANY_LANES, :3] = y0[7, :3] = 1e200
    some = (0, 7, 8, 2 * MANY_LANES, 3 * MANY_LANES, 5 * MANY_LANES + 1, 6 * MANY_LANES + 4)
    plan = planned(Kowalevski(), RK2, y0, 0.01, 50, 5)
    assert assert_same(plan, some, threads=1).work.shape[:2] == (1, 7)
    assert assert_same(plan, some, threads=2).work.shape[:2] == (2, 4)
    monkeypatch.setattr(integration, "ROWS", MANY_LANES)
    assert assert_same(plan, some, threads=2).work.shape[:2] == (7, 1)


def passing_step(s: Floats, h: float, p: Floats) -> Floats:
    """Infinite for one step only, when it meets 1, because 1/inf is 0."""
    return (1.0 / (s[0] - 1.0), s[1], s[2], s[3], s[4], s[5])


def doubled(s: Floats, h: float, p: Floats) -> Floats:
    """The sum of large components overflows a step before one of them does."""
    return (2.0 * s[0], 2.0 * s[1], s[2], s[3], s[4], s[5])


def stay(s: Floats, h: float, p: Floats) -> Floats:
    return s


@pytest.mark.parametrize(
    ("step", "state", "failed"), [(passing_step, (2.0,), 2), (doubled, (2.0**1000, 2.0**1000), 24)]
)
def test_a_failure_is_seen_at_its_step(step: Any, state: tuple[float, ...], failed: int) -> None:
    y0 = random_states(9, 3)
    y0[4, : len(state)] = state
    run = assert_same(planned(Kowalevski(), Stepper(step, 6), y0, 0.5, 50))
    assert run.endings[4] == Ending(Outcome.BLEW_UP, failed, 0.5 * failed)
    assert run.endings.outcomes == {Outcome.COMPLETED: 8, Outcome.BLEW_UP: 1}


@pytest.mark.parametrize(
    ("method", "count"),
    [(built("hk"), 3 * MANY_LANES + 5), (Stepper(stay, 6), 9), (built("hk"), 1), (built("dop853"), 3)],
    ids=["hk", "stay", "hk alone", "dop853"],
)
@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("asked", [0, 1, 4, 9])
@pytest.mark.parametrize("rows", [40, 1 << 15])
def test_neither_threads_nor_stops_change_rows_or_their_order(
    method: Method, count: int, threads: int, asked: int, rows: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stopped after any question, within a tile or between two, and continued from the state of the last chunk.

    Two trajectories repeat their steps alone, because one fails or the sum of its components overflows.
    """
    small_pieces(monkeypatch, rows, 20)
    y0 = random_states(count, 6)
    y0[1:3, :3] = 1e308
    plan, answers, states = planned(Kowalevski(), method, y0, 0.01, 50, 2), iter(range(10**6)), []
    whole, parts = Kept(), Kept()
    ended = drive(plan, [whole], threads=1)

    def note(chunk: Chunk) -> None:
        states[:] = [chunk.state()] if chunk.stopping else []

    with stopping_when(lambda: next(answers) >= asked):
        run = drive(plan, [parts], on_chunk=note, threads=threads)
    assert asked > 1 or Outcome.INTERRUPTED in run.endings.outcomes  # later questions may come after the end
    if states:
        run = drive(plan, [parts], start=states[0], threads=threads)
    assert list(run.endings) == list(ended.endings)
    for column, continued in zip(whole.rows, parts.rows, strict=True):
        assert np.array_equal(continued, column)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("broken", [0, 3])
def test_an_error_stops_the_drive(threads: int, broken: int, monkeypatch: pytest.MonkeyPatch) -> None:
    class Full(Consumer):
        def add(self, rows: Rows) -> None:
            begun.append(rows.first // MANY_LANES)
            if begun[-1] == broken:
                raise OSError(f"no room for tile {broken}")

    small_pieces(monkeypatch, 80, 10)
    begun: list[int] = []
    plan = planned(Kowalevski(), built("hk"), random_states(4 * MANY_LANES, 2), 0.01, 50)
    with pytest.raises(OSError, match=f"no room for tile {broken}"):
        drive(plan, [Full()], threads=threads)
    assert len(begun) == len(set(begun)) <= 4  # no tile twice, and no second chunk
