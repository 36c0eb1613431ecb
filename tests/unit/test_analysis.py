"""Drift verdicts, slopes and their errors, swings, observed orders: on signals whose answer is known."""

from __future__ import annotations

import doctest
import math
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import GEN
from topcli.analysis import columns as columns_module
from topcli.analysis import order, trajectory
from topcli.analysis.columns import column_names, columns
from topcli.analysis.order import convergence, observed_order
from topcli.analysis.swings import minima_times, swing_spacing
from topcli.analysis.tally import InvariantTally
from topcli.analysis.trend import sizes_in_all
from topcli.contracts import Invariant
from topcli.errors import UsageError
from topcli.tops.kowalevski import Kowalevski, field


@pytest.mark.parametrize("module", [columns_module, order, trajectory], ids=lambda m: m.__name__)
def test_the_examples_of_docstrings_run(module: ModuleType) -> None:
    done = doctest.testmod(module)
    assert done.attempted > 0
    assert done.failed == 0


class Signal(Kowalevski):
    """A top whose one invariant is the first component: feed it any series."""

    def invariants(self) -> tuple[Invariant, ...]:
        return (Invariant("x", "x", "x", "a series", lambda y: y[:, 0], lambda y: np.abs(y[:, 0]) + 1.0),)


def report(values: np.ndarray, h: float = 0.01, pieces: int = 1):
    tally = InvariantTally(Signal().invariants(), h)
    for n in np.array_split(np.arange(len(values)), pieces):
        states = np.zeros((len(n), 6))
        states[:, 0] = values[n]
        tally.add(n, states)
    return tally.report()[0]


N = 20_000
TIMES = 0.01 * np.arange(N + 1)


def test_known_slope_is_recovered_within_its_error() -> None:
    noise = np.random.default_rng(7).normal(size=N + 1) * 1e-3
    row = report(1.0 + 2e-4 * TIMES + noise)
    assert row.verdict == "drifting"
    assert abs(row.drift - 2e-4) < 4.0 * row.drift_error
    assert row.drift_error < 1e-5
    assert row.drift_over_run == pytest.approx(2e-4 * 200.0, rel=0.1)


@pytest.mark.parametrize("m", [8, 9, 128])
def test_all_components_of_a_residual_are_weighed_as_by_their_covariance(m: int) -> None:
    """White noise and a walk in an orthonormal basis of what is no line, with the covariance min(i, j) written out."""
    lines = np.stack([np.ones(m), np.arange(m)], axis=1)
    basis = np.linalg.svd(lines)[0][:, 2:]
    covariance = basis.T @ (np.minimum.outer(np.arange(m), np.arange(m)) + 1.0) @ basis
    residual = np.random.default_rng(m).normal(size=m)
    z = basis.T @ residual
    expected = z @ z, z @ np.linalg.solve(covariance, z), 0.5 * np.linalg.slogdet(covariance)[1]
    assert sizes_in_all(residual) == pytest.approx(expected, rel=1e-12)  # 4e-15 typically


def test_a_walk_with_a_drift_of_its_own_is_drifting() -> None:
    """The control: increments with a mean ten times its standard error."""
    walk = np.concatenate([[0.0], np.cumsum(np.random.default_rng(9).normal(size=N))]) * 1e-6
    assert report(1.0 + walk).verdict == "bounded"
    row = report(1.0 + walk + 10.0 * 1e-6 / math.sqrt(N) * np.arange(N + 1))
    assert (row.verdict, row.model) == ("drifting", "random walk")
    assert row.drift is not None
    assert row.drift * 200.0 == pytest.approx(10.0 * 1e-6 * math.sqrt(N), rel=0.3)


def test_noise_about_a_line_is_a_linear_trend() -> None:
    row = report(1.0 + 1e-3 * np.random.default_rng(3).normal(size=N + 1))
    assert (row.verdict, row.model) == ("bounded", "linear trend")
    assert report(1.0 + np.zeros(10)).model == "linear trend"  # nothing that could walk
    assert report(1.0 + np.zeros(5)).model is None


def sinking(depth: float) -> np.ndarray:
    """From 1 down by ``depth``, in a smooth wave."""
    return 1.0 - 0.5 * depth * (1.0 - np.cos(2.0 * math.pi * np.arange(N + 1) / N))


@pytest.mark.parametrize(("depth", "verdict"), [(0.24, "bounded"), (0.26, "lost"), (2.6, "lost")])
def test_a_deviation_of_order_one_is_lost(depth: float, verdict: str) -> None:
    """A quarter of the first value; the terms (|x| + 1) are at most two of it."""
    assert report(sinking(depth)).verdict == verdict


@pytest.mark.parametrize(("depth", "verdict"), [(0.024, "bounded"), (0.026, "lost")])
@pytest.mark.parametrize("first", [0.0, 1e-4])
def test_a_small_first_value_is_measured_by_its_terms(depth: float, verdict: str, first: float) -> None:
    """If large terms cancel, the limit is a quarter of a tenth of their size, which is 1 here."""
    assert report(sinking(depth) - 1.0 + first).verdict == verdict
    assert report(first * (1.0 + 0.01 * np.sin(TIMES))).verdict in ("bounded", "exact")


@pytest.mark.parametrize("period", [0.7, 9.0, 28.0, 95.0])
@pytest.mark.parametrize("phase", [0.0, 1.0, 2.5])
def test_oscillations_are_bounded(period: float, phase: float) -> None:
    row = report(1e-3 * np.sin(2 * math.pi * TIMES / period + phase))
    assert row.verdict == "bounded"


@pytest.mark.parametrize("period", [0.7, 9.0, 28.0])
def test_a_small_drift_under_an_oscillation_is_found(period: float) -> None:
    row = report(1e-3 * np.sin(2 * math.pi * TIMES / period) + 4e-5 * TIMES)
    assert row.verdict == "drifting"
    assert row.drift == pytest.approx(4e-5, rel=0.1)


def test_round_off_walk_is_exact_and_a_larger_one_is_not() -> None:
    signs = np.random.default_rng(8).choice([-1.0, 1.0], size=N)
    walk = np.concatenate([[0.0], np.cumsum(signs)]) * np.finfo(float).eps
    assert report(1.0 + 2.0 * walk).verdict == "exact"
    assert report(1.0 + 400.0 * walk).verdict != "exact"
    row = report(1.0 + 2.0 * walk)
    assert row.round_off_bound == pytest.approx(20 * np.finfo(float).eps * math.sqrt(N) * 2.0, rel=1e-6)


def test_a_linear_loss_of_one_ulp_a_step_is_not_exact() -> None:
    row = report(1.0 + np.finfo(float).eps * np.arange(N + 1))
    assert row.verdict == "drifting"


def test_the_figures_are_those_of_the_series() -> None:
    values = 2.0 + 0.1 * np.sin(TIMES) + 0.01 * np.random.default_rng(9).normal(size=N + 1)
    row = report(values)
    assert row.first == values[0]
    assert (row.min, row.max) == (values.min(), values.max())
    assert row.max_deviation == np.abs(values - values[0]).max()
    assert row.rms_deviation == pytest.approx(np.sqrt(np.mean((values - values[0]) ** 2)), rel=1e-12)
    assert row.max_deviation_relative == row.max_deviation / values[0]


def test_report_does_not_depend_on_the_pieces() -> None:
    values = 2.0 + 0.1 * np.sin(TIMES)
    whole, cut = report(values).as_dict(), report(values, pieces=37).as_dict()
    for key, value in whole.items():
        assert cut[key] == (pytest.approx(value, rel=1e-9) if isinstance(value, float) else value) or key == "reason"


@pytest.mark.parametrize("rows", [1, 2, 7])
def test_short_runs_have_no_slope_and_no_verdict(rows: int) -> None:
    row = report(1.0 + 0.01 * np.arange(rows))
    assert row.drift is None
    assert row.verdict == "unjudged"


def test_runaway_or_non_finite_series_are_not_bounded() -> None:
    values = 1.0 + 1e9 * np.sin(TIMES)
    assert report(values).verdict == "lost"
    values[500] = math.inf
    assert report(values).verdict == "unjudged"


@pytest.mark.slow
@pytest.mark.parametrize("rows", [100, 129, 1000, 20_000])
def test_the_slope_does_not_need_the_planned_length(rows: int) -> None:
    """Blocks join in pairs as a run grows: a run stopped anywhere has its slope."""
    noise = 1e-3 * np.random.default_rng(rows).normal(size=rows)
    row = report(1.0 + 3e-3 * TIMES[:rows] * (20_000 / rows) + noise, pieces=13)
    assert row.drift == pytest.approx(3e-3 * 20_000 / rows, rel=0.05)


def test_a_first_value_of_zero_has_no_relative_figures() -> None:
    assert report(np.zeros(100)).max_deviation_relative is None


@pytest.mark.slow
@settings(deadline=None)
@given(shift=st.floats(-0.5, 0.5), period=st.floats(5.0, 30.0))
def test_minima_are_placed_between_the_samples(shift: float, period: float) -> None:
    t = np.arange(0.0, 100.0, 0.05)
    values = -(np.cos(2 * math.pi * (t - shift) / period) ** 3)
    found = minima_times(t, values)
    expected = shift + period * np.arange(-2, 40)
    for time in found:
        assert np.abs(expected - time).min() < 2e-5
    assert swing_spacing(t, values) == pytest.approx(period, abs=2e-5)


def test_placement_beats_the_sampling() -> None:
    """The error falls with the fourth power of the sampling interval; the nearest sample's with the first."""
    errors = []
    for dt in (0.1, 0.05, 0.025):
        t = np.arange(0.0, 12.0, dt)
        values = -np.exp(np.cos(t - 4.123)) * (1 + 0.3 * np.sin(t - 4.123) ** 3)
        errors.append(abs(minima_times(t, values)[0] - 4.123))
    assert math.log2(errors[0] / errors[2]) / 2.0 > 3.5
    assert errors[-1] < 0.025**3


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


@pytest.mark.parametrize("y", [[2.0, 0.0, 2.0, 3.0, 3.0], [0.0, 0.0, 0.0, 0.0, 0.0], [9.0, 1.0, 0.0, 1e-9, 9.0]])
@pytest.mark.parametrize("gap", [1e-3, 1e-13])
def test_a_minimum_of_uneven_samples_lies_between_its_neighbours(y: list[float], gap: float) -> None:
    """Of two samples 1e-13 apart a quartic would have a poorly conditioned fit, with a warning."""
    t = np.array([0.0, 1.0, 1.0 + gap, 1.0 + 2.0 * gap, 4.0])
    series = np.concatenate([[10.0, 10.0], y, [10.0, 10.0]])
    times = np.concatenate([[-9.0, -8.0], t, [5.0, 6.0]])
    lowest = float(times[np.argmin(series)])
    (found,) = minima_times(times, series)
    near = times[np.argmin(series) - 1], times[np.argmin(series) + 1]
    assert near[0] <= found <= near[1]
    assert abs(found - lowest) <= 1.0


def test_series_without_two_minima_have_no_spacing() -> None:
    assert swing_spacing(np.arange(10.0), np.arange(10.0)) is None
    assert swing_spacing(np.arange(3.0), np.arange(3.0)) is None
    assert swing_spacing(np.arange(9.0), np.full(9, np.nan)) is None


def test_observed_order_ignores_the_round_off_plateau() -> None:
    sizes = [0.1 / 2**i for i in range(12)]
    errors = [size**3 + 1e-15 for size in sizes]
    assert observed_order(sizes, errors, 1e-11) == pytest.approx(3.0, abs=0.01)
    assert observed_order(sizes, [1e-16] * 12, 1e-14) is None


def ladder_errors(order: float, plateau: list[float]) -> tuple[list[float], list[float]]:
    """Sizes 0.1/2^k and errors of an exact order, the last ones replaced by a plateau."""
    sizes = [0.1 * 2.0**-k for k in range(12)]
    errors = [3e4 * h**order for h in sizes]
    return sizes, errors[: len(errors) - len(plateau)] + plateau


@pytest.mark.parametrize("order", [1.0, 2.0, 4.0])
def test_convergence_finds_order_and_plateau(order: float) -> None:
    sizes, errors = ladder_errors(order, [])
    clean = convergence(sizes, errors)
    assert clean.order == pytest.approx(order, abs=1e-9)
    assert clean.fitted == tuple(sorted(h for h in sizes if 3e4 * h**order > 1e-11)[:3])
    assert (clean.plateau, clean.onset) == (None, None)
    sizes, errors = ladder_errors(4.0, [2e-12, 5e-12, 1.5e-12, 8e-12])
    found = convergence(sizes[::-1], errors[::-1])
    assert (found.plateau, found.onset) == (3.5e-12, sizes[8])
    assert found.order == pytest.approx(4.0, abs=1e-9)
    assert found.fitted == (sizes[7], sizes[6], sizes[5])


@pytest.mark.parametrize(
    ("tail", "plateau"),
    [
        ([1e-9, 0.51e-9, 0.52e-9], 0.52e-9),
        ([1e-9, 0.49e-9, 0.26e-9], None),
        ([0.9e-6, 0.8e-6, 0.7e-6], 0.8e-6),
        ([1.1e-6, 1.1e-6, 1.2e-6], None),
        ([1e-9, 1e-9], None),
    ],
)
def test_a_plateau_is_small_and_gains_less_than_a_factor_of_two(tail: list[float], plateau: float | None) -> None:
    sizes = [1.0, 0.1, 0.01, 0.001, 1e-4, 1e-5, 1e-6]
    errors = [1.0, 1e-2, 1e-4, *tail]
    assert convergence(sizes[: len(errors)], errors).plateau == plateau


@pytest.mark.parametrize(("factor", "fitted"), [(0.99, (0.04, 0.08, 0.16)), (1.01, (0.02, 0.04, 0.08))])
def test_errors_near_the_plateau_are_not_fitted(factor: float, fitted: tuple[float, ...]) -> None:
    """Between 2 and 32 times its level an error is neither on the plateau nor fitted."""
    sizes = [0.32, 0.16, 0.08, 0.04, 0.02, 0.01, 0.005, 0.0025]
    found = convergence(sizes, [1e-3, 1e-4, 1e-5, 1e-6, 32e-10 * factor, 1e-10, 1e-10, 1e-10])
    assert (found.plateau, found.onset, found.fitted) == (1e-10, 0.01, fitted)


def test_errors_below_1e_11_are_fitted_only_if_there_are_too_few_others() -> None:
    sizes = [0.4, 0.2, 0.1, 0.05, 0.025]
    assert convergence(sizes, [1e-9, 2.5e-10, 6.3e-11, 1.1e-11, 9e-12]).fitted == (0.05, 0.1, 0.2)
    few = convergence(sizes, [1.1e-11, 1.1e-11 / 4, 1.1e-11 / 16, 1.1e-11 / 64, 1e-14])
    assert few.order == pytest.approx(2.0, abs=1e-9)
    assert few.fitted == (0.05, 0.1, 0.2)


def test_convergence_ignores_failed_sizes_and_needs_three() -> None:
    sizes, errors = ladder_errors(2.0, [])
    errors[1], errors[3], errors[11] = math.inf, math.nan, 0.0
    assert convergence(sizes, errors).order == pytest.approx(2.0, abs=1e-9)
    few = convergence(sizes[:2], [1e-2, 1e-3])
    assert (few.order, few.fitted, few.plateau) == (None, (), None)
    assert convergence([], []).order is None


def test_columns_by_name() -> None:
    top, states = Kowalevski(), np.array([GEN, GEN])
    made = columns(top, np.array([0, 5]), 0.1, states, column_names(top))
    assert list(made) == column_names(top)
    assert made["t"][1] == 5 * 0.1
    assert made["gamma_sq"][0] == pytest.approx(1.0, abs=1e-15)
    with pytest.raises(UsageError, match="did you mean 'energy'"):
        columns(top, np.array([0]), 0.1, states[:1], ["enrgy"])


@pytest.mark.parametrize("top", [Kowalevski(), Kowalevski(c0=-2.0, A=0.7), Kowalevski(c0=0.0)], ids=str)
def test_invariants_are_constant_along_the_field(top: Kowalevski) -> None:
    """dI/dt = grad I . f = 0, by central differences; a wrong coefficient in either shows at once."""
    for y in np.random.default_rng(5).normal(size=(20, 6)):
        f = np.array(field(tuple(y), top.constants()))
        for invariant in top.invariants():
            step = 1e-5
            rate = (invariant.value((y + step * f)[None]) - invariant.value((y - step * f)[None]))[0] / (2 * step)
            assert abs(rate) < 1e-8 * (1.0 + invariant.scale(y[None])[0])


def test_the_general_equations_are_those_of_the_top() -> None:
    """A Kowalevski top with any A obeys the Euler-Poisson equations with its moments and gravity."""
    top = Kowalevski(c0=1.3, A=3.0)
    (A, B, C), g = top.euler_poisson().moments, np.array(top.euler_poisson().gravity)
    for y in np.random.default_rng(8).normal(size=(20, 6)):
        w, gamma = y[:3], y[3:]
        m = np.array([A, B, C]) * w
        expected = np.concatenate([(np.cross(m, w) + np.cross(gamma, g)) / [A, B, C], np.cross(gamma, w)])
        assert np.allclose(field(tuple(y), top.constants()), expected, rtol=1e-14, atol=1e-14)
