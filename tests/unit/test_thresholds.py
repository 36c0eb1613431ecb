"""Both sides of every threshold of the analysis: synthetic data just below and just above each.

The thresholds are written out here: a constant that changes is a change of what the reports mean.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from topcli.analysis.order import observed_order
from topcli.analysis.roundoff import growth
from topcli.analysis.swings import minima_times, swing_spacing
from topcli.analysis.tally import InvariantRow, InvariantTally
from topcli.analysis.trend import trend
from topcli.contracts import Invariant
from topcli.schemes.layout import ambiguous_root, small_determinant
from topcli.studies.roundoff import violations_of

EPS = 2.0**-52
H, N = 0.01, 16_384
BELOW_AND_ABOVE = pytest.mark.parametrize("factor", [0.98, 1.02])


def report(values: np.ndarray, terms: float = 2.0) -> InvariantRow:
    """The report on a series, one value a step, of an invariant whose terms have this size."""
    series = Invariant("x", "x", "x", "a series", lambda y: y[:, 0], lambda y: np.full(len(y), terms))
    tally = InvariantTally((series,), H)
    tally.add(np.arange(len(values)), values[:, None])
    return tally.report()[0]


@BELOW_AND_ABOVE
def test_exact_ends_at_20_ulp_of_the_terms_times_the_root_of_the_steps(factor: float) -> None:
    values = np.ones(N + 1)
    values[N // 2] += factor * 20.0 * EPS * math.sqrt(N) * 2.0
    assert report(values).verdict == ("exact" if factor < 1.0 else "bounded")


@BELOW_AND_ABOVE
def test_drifting_begins_at_five_standard_errors(factor: float) -> None:
    """An exact line changes the fitted slope by its own and leaves the standard error as it is."""
    noise = 1.0 + 1e-3 * np.random.default_rng(5).normal(size=N + 1)
    plain = report(noise)
    assert plain.drift is not None
    assert plain.drift_error is not None
    slope = factor * 5.0 * plain.drift_error - plain.drift
    row = report(noise + slope * H * np.arange(N + 1))
    assert row.drift_over_run is not None
    assert row.scatter is not None
    assert abs(row.drift_over_run) > 2.1 * row.scatter  # the other condition holds
    assert row.verdict == ("drifting" if factor > 1.0 else "bounded")


@BELOW_AND_ABOVE
def test_drifting_moves_the_mean_by_twice_the_scatter(factor: float) -> None:
    """An oscillation between neighbouring blocks has a small standard error and a large scatter."""
    wave = 1e-3 * np.sign(np.sin(2.0 * math.pi * (np.arange(N + 1) + 0.5) / 512.0))
    plain = report(1.0 + wave)
    assert plain.drift is not None
    assert plain.scatter is not None
    slope = factor * 2.0 * plain.scatter / (N * H) - plain.drift
    row = report(1.0 + wave + slope * H * np.arange(N + 1))
    assert row.drift is not None
    assert row.drift_error is not None
    assert abs(row.drift) > 6.0 * row.drift_error  # the other condition holds
    assert row.verdict == ("drifting" if factor > 1.0 else "bounded")


@BELOW_AND_ABOVE
@pytest.mark.parametrize(("first", "terms"), [(3.0, 4.0), (0.05, 8.0)])
def test_lost_begins_at_a_quarter_of_the_value_or_of_a_tenth_of_the_terms(
    first: float, terms: float, factor: float
) -> None:
    size = 3.0 if first == 3.0 else 0.8
    sinking = first - factor * 0.25 * size * 0.5 * (1.0 - np.cos(2.0 * math.pi * np.arange(N + 1) / N))
    assert (report(sinking, terms).verdict == "lost") == (factor > 1.0)


@pytest.mark.parametrize("rows", [7, 8])
def test_a_slope_needs_eight_rows(rows: int) -> None:
    t = np.arange(float(rows))
    assert (trend(t, np.sin(t)) is None) == (rows < 8)


@BELOW_AND_ABOVE
def test_a_swing_reaches_below_half_of_the_range(factor: float) -> None:
    """From 1 down to 0 twice, and between them down to 0.5, just less deep or just deeper."""
    t = np.linspace(0.0, 3.0, 601)
    depth = np.where((t > 1.0) & (t < 2.0), factor * 0.5, 1.0)
    values = 1.0 - depth * np.sin(math.pi * t) ** 2
    expected = [0.5, 2.5] if factor < 1.0 else [0.5, 1.5, 2.5]
    np.testing.assert_allclose(minima_times(t, values), expected, atol=1e-13)  # typically exact
    assert swing_spacing(t, values) == pytest.approx(2.0 if factor < 1.0 else 1.0, abs=1e-13)


@BELOW_AND_ABOVE
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_solve_is_near_singular_below_two_to_the_minus_ten_of_its_terms(sign: float, factor: float) -> None:
    event = small_determinant(lambda state, h, p: (sign * factor * 2.0**-10 * 48.0, 48.0))
    assert event((0.0,), (0.0,), 0.1, ()) == (factor < 1.0)


@BELOW_AND_ABOVE
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_roots_are_ambiguous_below_a_ratio_of_distances_of_1_3(sign: float, factor: float) -> None:
    """The distances of both roots from the prediction, computed here: 8 r.q = r.r + q.q is a ratio of sqrt(5/3)."""
    root = np.array([0.6, 0.8])
    ratio = math.sqrt(5.0 / 3.0) * factor
    # q = x r + y s with s normal to r: |q + r| / |q - r| = ratio at |q| = 1
    x = (ratio**2 - 1.0) / (ratio**2 + 1.0)
    q = sign * (x * root + math.sqrt(1.0 - x * x) * np.array([-0.8, 0.6]))
    near, far = sorted((np.linalg.norm(q - root), np.linalg.norm(q + root)))
    assert far / near == pytest.approx(ratio)
    event = ambiguous_root(lambda state, h, p: (float(q[0]), float(q[1])))
    assert event((), tuple(root), 0.1, ()) == (ratio < math.sqrt(5.0 / 3.0))


@BELOW_AND_ABOVE
def test_an_order_needs_three_errors_above_the_floor(factor: float) -> None:
    errors = [1.0, 0.25, 0.0625]
    found = observed_order([4.0, 2.0, 1.0], errors, 0.0625 / factor)
    assert found == (None if factor < 1.0 else pytest.approx(2.0))


@pytest.mark.parametrize(("exponent", "verdict"), [(0.25, "flat"), (0.4, "random walk"), (1.0, "biased")])
def test_growth_is_named_by_its_exponent(exponent: float, verdict: str) -> None:
    """Copies of Gaussian series with the covariance of that power; 0.3 and 0.6 are the limits."""
    blocks, random = 256, np.random.default_rng(11)
    lag = np.abs(np.subtract.outer(np.arange(blocks), np.arange(blocks)))
    variance = 0.5 * (np.arange(blocks) + 1.0) ** (2 * exponent)
    covariance = variance[:, None] + variance[None] - 0.5 * lag ** (2 * exponent)
    roots, vectors = np.linalg.eigh(covariance)
    means = 1e-16 * random.normal(size=(24, blocks)) @ (vectors * np.sqrt(np.maximum(roots, 0.0))).T
    found = growth(means, 100, 1.0)
    assert found.exponent == pytest.approx(exponent, abs=0.04)
    assert found.verdict == verdict


@pytest.mark.parametrize(("limit", "names"), [(0.3, ("flat", "random walk")), (0.6, ("random walk", "biased"))])
def test_growth_changes_its_name_at_0_3_and_at_two_errors_above_0_6(limit: float, names: tuple[str, str]) -> None:
    """One draw of Gaussian series, whose power is bisected until the exponent (less two errors) is the limit."""
    at = np.arange(64) + 1.0
    lag = np.abs(np.subtract.outer(at, at))
    draws = np.random.default_rng(12).normal(size=(8, 64))
    low, high, margin = 0.1, 0.95, math.inf
    for _ in range(10):
        power = 0.5 * (low + high)
        covariance = 0.5 * (at[:, None] ** (2 * power) + at[None] ** (2 * power) - lag ** (2 * power))
        found = growth(1e-16 * draws @ np.linalg.cholesky(covariance).T, 100, 1.0)
        assert found.exponent is not None
        assert found.exponent_error is not None
        margin = found.exponent - (2.0 * found.exponent_error if limit == 0.6 else 0.0) - limit
        assert found.verdict == names[margin > 0.0]
        low, high = (low, power) if margin > 0.0 else (power, high)
    assert abs(margin) < 0.01


@BELOW_AND_ABOVE
def test_what_is_a_thousand_times_round_off_moves(factor: float) -> None:
    random = np.random.default_rng(2)
    walk = np.cumsum(random.normal(size=(4, 64)), axis=1)
    largest = growth(walk, 100, 1.0).rms
    size = factor * 1e3 * EPS * math.sqrt(64 * 100) / max(largest)
    assert (growth(size * walk, 100, 1.0).verdict == "moves") == (factor > 1.0)


@BELOW_AND_ABOVE
def test_tolerances_of_roundoff_are_violated_beyond_them(factor: float) -> None:
    row = {"name": "x", "exponent": 0.5, "exponent_error": 0.1, "max_drift": 1e-12, "drift": 1.0, "rms": [1.0]}
    form: dict[str, Any] = {"scheme": "hk", "form": "plain", "invariants": [row]}
    assert bool(list(violations_of(form, 0.3 / factor, None))) == (factor > 1.0)  # 0.5 less two errors
    assert bool(list(violations_of(form, None, 1e-12 / factor))) == (factor > 1.0)
    assert not list(violations_of(form, None, None))
