"""Drift at uneven times: slopes and noise that are known, against the report on even times."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from made_up import Line, report_on
from topcli.analysis.series_report import represented_times, uneven_report
from topcli.analysis.trend import trend
from topcli.analysis.verdict import InvariantRow
from topcli.contracts import Invariant


def motion(t: np.ndarray) -> np.ndarray:
    """A component with 50 oscillations over the series."""
    return np.cos(2.0 * math.pi * 50.0 * (t - t[0]) / (t[-1] - t[0]))[:, None]


def series(values: np.ndarray, terms: float = 1.0) -> Invariant:
    return Invariant("x", "x", "x", "a series", lambda y: values, lambda y: np.abs(values) + terms)


def uneven(t: np.ndarray, values: np.ndarray, steps: int = 100, terms: float = 1.0) -> InvariantRow:
    return uneven_report(Line(), [series(values, terms)], t, motion(t), steps)[0][0]


TIMES: dict[str, Callable[[np.random.Generator, int], np.ndarray]] = {
    "uniform": lambda random, m: np.sort(random.uniform(0.0, 100.0, m)),
    "cluster": lambda random, m: np.sort(np.append(random.uniform(0, 100, m // 4), random.normal(30, 2, 3 * m // 4))),
    "gap": lambda random, m: np.sort(np.append(random.uniform(0, 40, m // 2), random.uniform(60, 100, m // 2))),
    "logarithmic": lambda random, m: 100.0 * np.logspace(-4.0, 0.0, m),
    "adaptive": lambda random, m: np.linspace(0, 100, m) + 1.35 * np.sin(0.7 * np.linspace(0, 100, m)),
}


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("kind", TIMES)
def test_a_known_slope_is_found_within_its_error(kind: str, direction: float) -> None:
    """In 400 trials each, white noise was never more than 5.2 standard errors off."""
    random = np.random.default_rng(5)
    t = direction * (TIMES[kind](random, 600) + 7.0)
    row = uneven(t, 1.0 + 2e-4 * t + random.normal(size=len(t)) * 1e-3)
    assert row.drift is not None
    assert row.drift_error is not None
    assert row.verdict == "drifting"
    assert abs(row.drift - 2e-4) < 5.0 * row.drift_error
    assert row.drift_error < 2e-5
    assert row.drift_over_run == row.drift * (t[-1] - t[0])


@pytest.mark.slow
@pytest.mark.parametrize("kind", TIMES)
@pytest.mark.parametrize("m", [64, 150])
@pytest.mark.parametrize("noise", ["white", "walk"])
def test_slope_errors_are_honest_at_uneven_times(kind: str, m: int, noise: str) -> None:
    """Without a trend the slope rarely reaches the 4 standard errors of the verdict.

    Rates over 400 cases: walks 0 to 1%, white noise 0; medians of the ratio 0.20 to 0.73. White noise was taken for a
    walk in up to 6% of the cases with few rows, walks in 94 to 98%.
    """
    random = np.random.default_rng(11)
    fits = []
    for _ in range(100):
        t = TIMES[kind](random, m)
        steps = np.append(0.0, np.sqrt(np.diff(t))) if noise == "walk" else np.ones(len(t))
        jumps = random.normal(size=len(t)) * steps
        fits.append(uneven(t, np.cumsum(jumps) if noise == "walk" else jumps))
    ratios = [abs(fit.drift) / fit.drift_error for fit in fits if fit.drift is not None and fit.drift_error is not None]
    assert len(ratios) == len(fits)
    assert np.mean(np.array(ratios) > 4.0) <= (0.045 if noise == "walk" else 0.015)
    assert 0.15 < np.median(ratios) < 1.1
    walks = np.mean([fit.model == "random walk" for fit in fits])
    assert (walks > 0.9) if noise == "walk" else (walks < 0.14)


@pytest.mark.parametrize("kind", TIMES)
@pytest.mark.parametrize(("begin", "end"), [(0.97, 0.97), (0.03, 0.03), (0.95, 1.0), (0.0, 0.05)])
def test_the_bound_covers_a_change_at_an_end_of_the_run(kind: str, begin: float, end: float) -> None:
    """A jump or a ramp, one to a hundred times the range of the noise: 20 of 20, none from the fit alone."""
    random = np.random.default_rng(19)
    covered = []
    for _ in range(20):
        t = TIMES[kind](random, 600)
        part = (t - t[0]) / (t[-1] - t[0])
        noise = random.normal(size=len(t))
        size = np.ptp(noise) * 10.0 ** random.uniform(0.0, 2.0)
        row = uneven(t, noise + size * np.clip((part - begin) / (end - begin + 1e-9), 0.0, 1.0), 600, 1e6)
        assert row.drift_bound is not None
        covered.append(row.drift_bound * (t[-1] - t[0]) >= 0.999 * size)
    assert np.mean(covered) >= 0.95


@pytest.mark.parametrize("shape", ["noise", "walk", "wave"])
def test_even_rows_give_nearly_the_report_on_even_times(shape: str) -> None:
    random = np.random.default_rng(3)
    noise = random.normal(size=4096)
    values = {"noise": noise, "walk": np.cumsum(noise), "wave": np.sin(0.37 * np.arange(4096))}[shape] + 1.0
    t = 0.01 * np.arange(4096)
    one, other = uneven(t, values, 4095), report_on(values, motion(t)[:, 0], 0.01, np.abs(values) + 1.0)
    assert one.drift is not None
    assert other.drift is not None
    assert other.drift_error is not None
    assert abs(one.drift - other.drift) < 0.1 * other.drift_error
    assert one.drift_error == pytest.approx(other.drift_error, rel=0.1)
    assert one.model == other.model
    assert one.rms_deviation == pytest.approx(other.rms_deviation, rel=1e-12)
    for name in ("first", "min", "max", "max_deviation", "round_off_bound", "verdict"):
        assert getattr(one, name) == getattr(other, name), name


def test_oscillations_hardly_leak_into_the_slope_when_steps_follow_them() -> None:
    """An adaptive method takes short steps where the deviation is large; a plain line sees a slope of -1.5e-7.

    The slope here is 6e-10; if all rows weighed the same it would be -6e-8.
    """
    s = np.linspace(0.0, 200.0, 4001)
    t = s + 0.9 * np.sin(s)
    wave = 1e-3 * np.cos(t)
    row = uneven(t, 1.0 + wave)
    assert row.drift is not None
    plain = np.polyfit(t, wave, 1)[0]
    assert abs(plain) > 1e-7
    assert abs(row.drift) < 0.02 * abs(plain)
    assert row.verdict == "no drift seen"


def test_rows_represent_half_of_their_gaps_and_at_most_a_bin() -> None:
    t = np.array([0.0, 0.1, 0.4, 0.5, 100.0])
    width = 100.0 / 128.0
    expected = [0.1, 0.2, 0.2, 0.05 + width / 2.0, width]
    np.testing.assert_allclose(represented_times(t), expected, rtol=1e-12)
    np.testing.assert_allclose(represented_times(-t), expected, rtol=1e-12)


@pytest.mark.parametrize(("longest", "enough"), [(4.0, True), (5.0, False)])
def test_a_slope_needs_weights_worth_eight_points(longest: float, enough: bool) -> None:
    """Of 16 points one in the middle represents more time: 1.5 / (sum of squared weights) is 8.7 or 7.3 here."""
    t, lengths = np.arange(16.0), np.ones(16)
    lengths[7] = longest
    window = lengths * np.sin(np.pi * (t + 0.5) / 16.0) ** 2
    worth = 1.5 * window.sum() ** 2 / (window @ window)
    assert (worth >= 8.0) == enough
    assert (trend(t, np.sin(t), lengths) is not None) == enough


def test_the_bound_follows_the_steps_and_few_rows_are_unjudged() -> None:
    t = np.array([0.0, 1.0, 3.0, 4.0, 8.0])
    row = uneven(t, np.array([1.0, 1.0, 1.0, 1.1, 1.0]), steps=400)
    assert row.round_off_bound == pytest.approx(20.0 * 2.0**-52 * math.sqrt(400.0) * 2.1)
    assert row.verdict == "undecided"
    assert row.drift is None
