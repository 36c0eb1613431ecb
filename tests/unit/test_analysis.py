"""Swings, columns, and the events that schemes count: both sides of their thresholds."""

from __future__ import annotations

import doctest
import math
from types import ModuleType

import numpy as np
import pytest

from conftest import GEN
from topcli.analysis import order, trajectory
from topcli.analysis.quantities import quantities_of
from topcli.analysis.swings import first_swing_spacing, minima_times
from topcli.analysis.tally import tally_of
from topcli.engine.rows import Plan, Rows
from topcli.tops.kowalevski import Kowalevski


@pytest.mark.parametrize("module", [order, trajectory], ids=lambda m: m.__name__)
def test_the_examples_of_docstrings_run(module: ModuleType) -> None:
    done = doctest.testmod(module)
    assert done.attempted > 0
    assert done.failed == 0


@pytest.mark.parametrize("ratio", [1.0, 0.4, 0.12, 0.08, 1e-6])
def test_minima_are_placed_between_uneven_samples(ratio: float) -> None:
    """Intervals of 0.05 and ``ratio`` times that in turn; below a tenth by the parabola, whose error is larger."""
    t = 0.05 * np.cumsum(np.where(np.arange(600) % 2, ratio, 1.0))
    for direction in (1.0, -1.0):
        found = minima_times(direction * t, -np.exp(np.cos(t - 4.123)) * (1 + 0.3 * np.sin(t - 4.123) ** 3))
        expected = direction * (4.123 + 2.0 * math.pi * np.arange(len(found)))
        assert len(found) >= 2
        assert np.abs(found - expected).max() < (1e-5 if ratio > 0.1 else 5e-3)
        assert np.abs(found - expected).max() > 0.0


@pytest.mark.parametrize("first", [math.inf, 1e300, 0.5])
def test_figures_of_a_quantity_are_those_of_its_values(first: float) -> None:
    """Also after a first value that is infinite or so large that differences from it are its negative."""
    values = np.array([[first, 3e-7, -2.5, 1.0], [7.0, 5.0, math.nan, math.nan]])
    plan = Plan(Kowalevski(), None, np.array([GEN, GEN]), 0.1, 3, quantities=quantities_of(Kowalevski, {"x": "omega1"}))
    states = np.broadcast_to(np.array(GEN), (2, 4, 6))
    tally = tally_of(Rows(plan, np.arange(4), states, lengths=np.array([4, 2]), columns={"x": values}))
    figures = {key.removesuffix(".x"): column.tolist() for key, column in tally.quantities().items()}
    assert {key: figures[key] for key in ("first", "last", "min", "max")} == {
        "first": [first, 7.0],
        "last": [1.0, 5.0],
        "min": [-2.5, 5.0],
        "max": [max(first, 1.0), 7.0],
    }
    assert figures["mean"] == pytest.approx([values[0].mean(), 6.0])


@pytest.mark.parametrize("factor", [0.98, 1.02])
def test_a_swing_reaches_below_half_of_the_range(factor: float) -> None:
    """From 1 down to 0 twice, and between them down to 0.5, just less deep or just deeper."""
    t = np.linspace(0.0, 3.0, 601)
    depth = np.where((t > 1.0) & (t < 2.0), factor * 0.5, 1.0)
    values = 1.0 - depth * np.sin(math.pi * t) ** 2
    expected = [0.5, 2.5] if factor < 1.0 else [0.5, 1.5, 2.5]
    np.testing.assert_allclose(minima_times(t, values), expected, atol=1e-13)  # typically exact
    assert first_swing_spacing(minima_times(t, values)) == pytest.approx(2.0 if factor < 1.0 else 1.0, abs=1e-13)
