"""Eight Taylor series side by side: every trajectory is its own motion, whatever its neighbours do."""

from __future__ import annotations

import math

import numpy as np
import pytest

from conftest import random_states
from topcli.analysis.reference import reference_states
from topcli.contracts import Top
from topcli.engine.batch import ORDERS, batch_order, taylor_batch
from topcli.engine.loop import Run
from topcli.schemes.taylor.scheme import Tolerance, build
from topcli.tops import TOPS
from topcli.tops.heavy import Heavy
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange


def some(top: Top, count: int) -> np.ndarray:
    return random_states(count, seed=5)[:, : len(top.components)]


@pytest.mark.parametrize("form", TOPS)
@pytest.mark.parametrize(("h", "N", "every"), [(0.25, 40, 1), (0.013, 700, 70), (-10.0, 1, 1)])
def test_against_the_reference(form: str, h: float, N: int, every: int) -> None:
    top = TOPS[form].new()
    y0 = some(top, 11)
    states, series = taylor_batch(top, y0, h, N, every)
    assert states.shape == (11, 1 + N // every, len(top.components))
    assert (states[:, 0] == y0).all()
    assert (series >= 1.0).all()
    t = h * np.arange(every, N + 1, every)
    for i in range(11):
        assert np.abs(states[i, 1:] - reference_states(top, y0[i], t)).max() < (4e-12 if form == "heavy" else 4e-13)


def test_the_tolerance_is_the_schemes() -> None:
    top = Kowalevski()
    y0 = some(top, 8)
    exact = np.array([reference_states(top, y, np.array([5.0]))[0] for y in y0])
    errors = [
        np.abs(taylor_batch(top, y0, 5.0, 1, 1, tol)[0][:, -1] - exact).max() for tol in (1e-4, 1e-7, 1e-10, 1e-13)
    ]
    assert all(e < 300.0 * tol for e, tol in zip(errors, (1e-4, 1e-7, 1e-10, 1e-13), strict=True))
    assert errors[0] > 1e-7


def test_neighbours_and_threads_change_no_bit() -> None:
    top = Heavy()
    y0 = some(top, 21)
    all_of_them, counts = taylor_batch(top, y0, 0.3, 30)
    turned, turned_counts = taylor_batch(top, y0[::-1], 0.3, 30, threads=2)
    assert (turned[::-1] == all_of_them).all()
    assert (turned_counts[::-1] == counts).all()
    assert (taylor_batch(top, y0[4:5], 0.3, 30)[0] == all_of_them[4:5]).all()


def test_one_that_is_not_finite_is_nan_alone() -> None:
    top = Kowalevski()
    y0 = some(top, 8)
    good, _ = taylor_batch(top, y0, 0.5, 9)
    y0[3, 1] = math.inf
    mixed, _ = taylor_batch(top, y0, 0.5, 9)
    assert np.isnan(mixed[3, 1:]).all()
    others = np.arange(8) != 3
    assert (mixed[others] == good[others]).all()
    assert np.isnan(taylor_batch(top, y0[:1], 1e16, 1)[0][:, 1:]).all()  # steps that shrink to nothing


def test_agrees_with_single_runs() -> None:
    top = Kowalevski()
    y0 = some(top, 3)
    states, series = taylor_batch(top, y0, 0.5, 20)
    for i in range(3):
        run = Run(top, build(top, Tolerance()), y0[i], 0.5, 20)
        single = np.concatenate([chunk.states.copy() for chunk in run])
        assert run.ending is not None
        assert np.abs(states[i] - single).max() < 1e-12
        assert (states[i] != single).any()  # not bit for bit, as its documentation says
        assert series[i] == pytest.approx(run.ending.counters["expansions"], rel=0.3)


@pytest.mark.parametrize(
    ("top", "omega", "t"),
    [
        (Kowalevski(), (31.0, -17.0, 42.0), 3.0),  # a fast spin: gamma's series is an exponential's, without a radius
        (Lagrange(), (1e-3, 0.0, 20.0), 20.0),  # nearly steady, so that the coefficients fall fast
        (Kowalevski(c0=1e-6), (0.9, -0.4, 0.7), 50.0),
        (Kowalevski(c0=1e4), (0.0, 0.1, 0.0), 0.5),  # the unit of time is far from the radius at first
    ],
)
def test_products_of_sums_lose_nothing(top: Top, omega: tuple[float, ...], t: float) -> None:
    """Motions whose coefficients grow or fall with their number: still round-off, by steps as long as otherwise."""
    y0 = np.array([*omega, 0.6, 0.0, 0.8])
    exact = reference_states(top, y0, np.array([t]))[0]
    states, series = taylor_batch(top, [y0], t, 1)
    run = Run(top, build(top, Tolerance()), y0, t, 1)
    list(run)
    assert np.abs(states[0, 1] - exact).max() < 3e-14 * np.abs(exact).max()
    assert run.ending is not None
    assert series[0] < 1.5 * run.ending.counters["expansions"] + 3


def test_orders() -> None:
    orders = [batch_order(10.0**-k) for k in range(20)]
    assert orders == sorted(orders)
    assert (orders[0], orders[-1]) == ORDERS


@pytest.mark.parametrize(
    ("y0", "N", "every", "told"),
    [(np.zeros((2, 3)), 5, 1, r"\(m, 6\)"), (np.zeros(6), 5, 1, "shape"), (np.zeros((2, 6)), 0, 1, "N = 0")],
)
def test_what_is_wrong_is_told(y0: np.ndarray, N: int, every: int, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        taylor_batch(Kowalevski(), y0, 0.1, N, every)
