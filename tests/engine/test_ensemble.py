"""Ensembles in the engine: the bits of single runs, failures that stay alone, threads and interruptions."""

from __future__ import annotations

import math
import os

import numpy as np
import pytest

from cases import table_of
from conftest import random_states
from declared import SCHEMES
from steppers import built
from topcli.contracts import Ending, Floats, Method, Outcome, Stepper, Top
from topcli.engine import ensemble
from topcli.engine.ensemble import TILE, EnsembleRun, Execution, Piece
from topcli.engine.run import Run
from topcli.schemes.registry import find_scheme
from topcli.tops import TOPS
from topcli.tops.kowalevski import Kowalevski

COUNT = TILE + 6
Rows = list[tuple[np.ndarray, np.ndarray]]


def slow(method: Method) -> bool:
    """True if trajectories run one after the other: in the interpreter, by a closed form, or by a loop of their own."""
    return not isinstance(method, Stepper) or method.plain


def together(
    top: Top, method: Method, y0: np.ndarray, h: float, N: int, every: int = 1, **options
) -> tuple[Rows, EnsembleRun]:
    """Step numbers and states of every trajectory, and the run."""

    def made(piece: Piece) -> tuple[int, Rows]:
        kept = [(piece.n[:k].copy(), piece.states[i, :k].copy()) for i, k in enumerate(piece.kept)]
        return piece.first, kept

    run = EnsembleRun(top, method, y0, h, N, every, on_piece=made, execution=Execution(**options))
    pieces: list[Rows] = [[] for _ in y0]
    for (first, rows), _ in run:
        for i, one in enumerate(rows):
            pieces[first + i].append(one)
    return [(np.concatenate([n for n, _ in p]), np.concatenate([y for _, y in p])) for p in pieces if p], run


def alone(
    top: Top, method: Method, y0: np.ndarray, h: float, N: int, every: int = 1
) -> tuple[np.ndarray, np.ndarray, Ending]:
    run = Run(top, method, y0.tolist(), h, N, every)
    return run.collect()


def assert_same(
    top: Top, method: Method, y0: np.ndarray, h: float, N: int, every: int = 1, lanes=None, **options
) -> EnsembleRun:
    """The ensemble has the bits, the rows and the endings of single runs."""
    rows, run = together(top, method, y0, h, N, every, **options)
    assert len(rows) == len(run.endings) == len(y0)
    for i in range(len(y0)) if lanes is None else lanes:
        n, states, ending = alone(top, method, y0[i], h, N, every)
        assert np.array_equal(rows[i][0], n)
        assert np.array_equal(rows[i][1], states), i
        assert run.endings[i] == ending
        if N % every == 0 or ending.outcome is not Outcome.COMPLETED:
            assert np.array_equal(run.last[i], states[-1])
            assert run.last_n[i] == n[-1]
        else:
            finer = alone(top, method, y0[i], h, N, math.gcd(N, every))
            assert np.array_equal(run.last[i], finer[1][-1])
            assert run.last_n[i] == N
    return run


@pytest.mark.slow
@pytest.mark.parametrize("scheme", [*SCHEMES, find_scheme("hk", "coupled-euler")], ids=lambda s: f"{s.name}/{s.top}")
def test_a_trajectory_has_the_bits_of_a_single_run(scheme, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ensemble, "PIECE_ROWS", 37)
    monkeypatch.setattr(ensemble, "PIECE_STEPS", 61)
    top = TOPS[scheme.top]()
    method = scheme.build(top, scheme.options())
    count, N = (3, 20) if slow(method) else (COUNT, 150)
    y0 = random_states(count, 5)[:, : len(top.components)]
    for h, every in ((0.02, 1), (-0.03, 7)):
        run = assert_same(top, method, y0, h, N, every, lanes=sorted({0, 1, count - 1, min(count - 1, TILE - 1)}))
        outcomes = {Outcome.COMPLETED, *([Outcome.BLEW_UP] if scheme.name == "bohlin-b" else [])}  # where gamma3 is -1
        assert {ending.outcome for ending in run.endings} <= outcomes


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hk", "hybrid", "bohlin-b", "midpoint", "hybrid-sym", "hk+suzuki4"])
def test_large_steps_have_the_bits_of_a_single_run(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Large angles take libm's branch, iterations fail, schemes blow up: what happens is what happens alone."""
    monkeypatch.setattr(ensemble, "PIECE_STEPS", 4)
    top = Kowalevski()
    method = built(name)
    y0 = random_states(20, 8) * np.array([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])
    run = assert_same(top, method, y0, 1.7, 60)
    failed = [ending.outcome for ending in run.endings if ending.outcome is not Outcome.COMPLETED]
    if name == "hybrid-sym":
        assert Outcome.NO_CONVERGENCE in failed
        assert 0 < len(failed) < 20


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 2, ensemble.SMALL_TILE, TILE // 2 + 1, TILE, TILE + 1])
@pytest.mark.parametrize(
    ("N", "every"),
    table_of("""
1   1
10  3
10  10
10  11
"""),
)
def test_ensembles_of_every_size_have_the_bits_of_single_runs(count: int, N: int, every: int) -> None:
    method = built("hk")
    assert_same(Kowalevski(), method, random_states(count, 2), 0.01, N, every)


def passing_step(s: Floats, h: float, p: Floats) -> Floats:
    """Infinite for one step only, when it meets 1, because 1/inf is 0."""
    return (1.0 / (s[0] - 1.0), s[1], s[2], s[3], s[4], s[5])


def test_an_infinity_that_passes_is_seen() -> None:
    y0 = random_states(9, 3)
    y0[4, 0] = 2.0
    _, run = together(Kowalevski(), Stepper(passing_step, 6), y0, 0.5, 50)
    assert run.endings[4] == Ending(Outcome.BLEW_UP, 2, 1.0)
    assert [ending.outcome for ending in run.endings].count(Outcome.COMPLETED) == 8


def test_threads_change_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    """The pieces come in the same order with the same bits."""
    monkeypatch.setattr(ensemble, "GROUP", 2)
    monkeypatch.setattr(ensemble, "PIECE_ROWS", 20)
    method = built("hybrid")
    y0 = random_states(3 * TILE + 5, 6)

    def pieces(threads: int) -> list[tuple[int, bytes, bytes, int]]:
        def made(piece: Piece) -> tuple[int, bytes, bytes]:
            return piece.first, piece.n.tobytes(), piece.states.tobytes()

        run = EnsembleRun(Kowalevski(), method, y0, 0.01, 50, on_piece=made, execution=Execution(threads=threads))
        return [(*one, done) for one, done in run]

    one = pieces(1)
    assert one == pieces(2) == pieces(5)  # five: more than there are tiles to take
    assert [first // TILE for first, *_ in one] == [0, 1, 0, 1, 0, 1, 2, 3, 2, 3, 2, 3]
    assert one[-1][-1] == len(y0) * 50


@pytest.mark.parametrize("threads", [1, 2])
def test_wide_pieces_hold_several_tiles_with_the_same_bits(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also around a tile that is left out because all of it failed."""
    monkeypatch.setattr(ensemble, "PIECE_STEPS", 20)
    y0 = random_states(6 * TILE + 5, 6)
    y0[2 * TILE : 3 * TILE, :3] = 1e200
    y0[7, :3] = 1e200
    method, sizes = built("rk2"), []
    options = {"threads": threads, "wide": True}
    some = (0, 7, 8, 2 * TILE, 3 * TILE, 5 * TILE + 1, 6 * TILE + 4)
    assert_same(Kowalevski(), method, y0, 0.01, 50, 5, lanes=some, **options)

    def made(piece: Piece) -> None:
        assert len(piece.states) == len(piece.kept)
        sizes.append(len(piece.kept))

    for _ in EnsembleRun(Kowalevski(), method, y0, 0.01, 50, 5, on_piece=made, execution=Execution(**options)):
        pass
    first = [7 * TILE - 59] if threads == 1 else [3 * TILE, 3 * TILE, 5]
    later = [2 * TILE, 3 * TILE + 5] if threads == 1 else [2 * TILE, 3 * TILE, 5]
    assert sorted(sizes) == sorted([*first, *later, *later])


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("broken", [0, 1, 3])
def test_error_in_one_piece_is_raised_once_and_stops_the_others(
    threads: int, broken: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ensemble, "PIECE_STEPS", 10)
    begun: list[int] = []

    def made(piece: Piece) -> int:
        begun.append(piece.first // TILE)
        if begun[-1] == broken:
            raise OSError(f"no room for tile {broken}")
        return begun[-1]

    method = built("hk")
    y0, execution = random_states(4 * TILE, 2), Execution(threads=threads)
    run = EnsembleRun(Kowalevski(), method, y0, 0.01, 50, on_piece=made, execution=execution)
    with pytest.raises(OSError, match=f"no room for tile {broken}"):
        list(run)
    assert len(begun) == len(set(begun)) <= 4  # no tile twice, and no second chunk


@pytest.mark.parametrize("name", ["hk", "dop853"])
def test_interruption_keeps_recorded_rows(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ensemble, "GROUP", 1)
    monkeypatch.setattr(ensemble, "PIECE_STEPS", 10)
    monkeypatch.setattr("topcli.engine.run.PLAIN_STEPS", 10)
    count, asked = (TILE + 6, 7) if name == "hk" else (3, 5)  # within the second tile, within the second trajectory
    answers = iter([False] * asked + [True] * 10)
    rows, run = together(
        Kowalevski(),
        built(name),
        random_states(count, 6),
        0.01,
        40 if name == "dop853" else 50,
        stop=lambda: next(answers),
    )
    done = TILE if name == "hk" else 1
    assert [ending.outcome for ending in run.endings[:done]] == [Outcome.COMPLETED] * done
    assert [ending.outcome for ending in run.endings[done:]] == [Outcome.INTERRUPTED] * (count - done)
    step = 20 if name == "hk" else 10
    assert run.endings[done].step == run.last_n[done] == step
    assert len(rows[done][0]) == step + 1


def test_a_step_that_cannot_be_compiled_is_reported() -> None:
    from topcli.errors import SchemeCodeError

    def step(s: Floats, h: float, p: Floats) -> Floats:
        return tuple(float(str(x)) for x in s)

    with pytest.raises(SchemeCodeError, match=r"test_ensemble\.py:"):
        together(Kowalevski(), Stepper(step, 6), random_states(2, 1), 0.1, 1)


def test_a_limit_is_an_upper_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ensemble, "_most_threads", None)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(6)), raising=False)
    assert ensemble.default_threads() == 6
    ensemble.limit_threads(2)
    assert ensemble.default_threads() == 2
    ensemble.limit_threads(8)
    assert ensemble.default_threads() == 6
