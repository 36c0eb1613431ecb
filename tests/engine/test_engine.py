"""The engine: compiled equals plain, chunked equals whole, failures at the exact step, the cache of machine code."""

from __future__ import annotations

import math
from itertools import chain

import numpy as np
import pytest

from conftest import GEN
from declared import SCHEMES
from steppers import RK2
from topcli.contracts import Outcome, Stepper
from topcli.engine import native
from topcli.engine.run import Run
from topcli.tops import TOPS
from topcli.tops.kowalevski import Kowalevski


def rows(run: Run) -> tuple[np.ndarray, np.ndarray]:
    n, states, _ = run.collect()
    return n, states


@pytest.mark.slow
@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: f"{s.name}/{s.top}")
def test_chunked_equals_whole(scheme, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cutting a run into pieces of awkward sizes, and recording some rows only, changes no bit and loses no row."""
    top, N = TOPS[scheme.top](), 400
    method, y0 = scheme.build(top, scheme.options()), GEN[: len(top.components)]
    n, whole = rows(Run(top, method, y0, 0.01, N))
    assert n.tolist() == list(range(N + 1))
    monkeypatch.setattr("topcli.engine.run.CHUNK_STEPS", 23)
    monkeypatch.setattr("topcli.engine.run.CHUNK_ROWS", 5)
    for every in (1, 7):
        n, cut = rows(Run(top, method, y0, 0.01, N, every))
        assert n.tolist() == list(range(0, N + 1, every))
        assert (cut == whole[::every]).all()


def test_collected_rows_are_those_of_all_chunks_and_outlive_the_run() -> None:
    """Three chunks in one buffer; a run that goes on from its last step has no further row."""
    first = Run(Kowalevski(), RK2, GEN, 1e-3, 20_000)
    n, states = zip(*((chunk.n.tolist(), chunk.states.tolist()) for chunk in first), strict=True)
    second = Run(Kowalevski(), RK2, GEN, 1e-3, 20_000)
    kept = second.collect()
    assert kept.n.tolist() == list(chain(*n))
    assert kept.states.tolist() == list(chain(*states))
    assert kept.ending is second.ending
    over = Run(Kowalevski(), RK2, GEN, 1e-3, 20_000, start=first.position()).collect()
    assert (over.n.shape, over.states.shape, over.ending) == ((0,), (0, 6), kept.ending)


@pytest.mark.parametrize("N", [1, 2, 8192, 8193])
def test_every_run_length_records_the_same_states(N: int) -> None:
    run = Run(Kowalevski(), RK2, GEN, 1e-3, N)
    n, states = rows(run)
    assert len(n) == len(states) == N + 1
    assert run.ending is not None
    assert run.ending.outcome is Outcome.COMPLETED
    assert run.ending.step == N
    assert run.ending.t == N * 1e-3


def test_arrays_of_the_wrong_kind_are_refused_by_the_loop() -> None:
    compiled = native.native(_first, "p")
    assert compiled(np.array([3.0])) == 3
    with pytest.raises(TypeError, match="float64"):
        compiled(np.array([3]))
    with pytest.raises(TypeError, match="contiguous"):
        compiled(np.arange(10.0)[::2])


def _first(x):
    return int(x[0])


def _doubled(s, h, p):
    return (2.0 * s[0], 2.0 * s[1], s[2], s[3], s[4], s[5])


def test_largest_finite_states_do_not_fail() -> None:
    """Their sum overflows a step before one of them does; the run ends at the first step at which one does."""
    start = 2.0**1000
    run = Run(Kowalevski(), Stepper(_doubled, 6), (start, start, 1.0, 0.6, 0.48, 0.64), 0.1, 50)
    n, states = rows(run)
    assert run.ending is not None
    assert (run.ending.outcome, run.ending.step, run.ending.t) == (Outcome.BLEW_UP, 24, 24 * 0.1)
    assert n.tolist() == list(range(24))
    assert states[-1, 0] == 2.0**1023
    assert math.isinf(float(states[-1, 0]) + float(states[-1, 1]))
