"""Lyapunov exponents against known values, and verdicts against the truth known from integrable tops."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import pytest

from orbits import HENON_HEILES, LORENZ, ROESSLER, curves, growth_along, of_field
from steppers import built
from topcli import Top
from topcli.analysis.lyapunov import Verdict, growth_of, spectrum_of
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Stepper, StopAsked, stopping_when
from topcli.schemes.registry import find_scheme
from topcli.tops import TOPS

RK4 = find_scheme("rk4", "heavy")


def henon_step(s, h, p):
    """Henon's map with a = 1.4 and b = 0.3."""
    return (1.0 - 1.4 * s[0] * s[0] + s[1], 0.3 * s[0])


class Plane(Top):
    """Two components at rest."""

    kind: ClassVar[str] = "plane"
    components: ClassVar[tuple[str, ...]] = ("x", "y")

    @staticmethod
    def field(s, p):
        return (1.0, 1.0)


@pytest.mark.slow
def test_exponents_of_henons_map() -> None:
    """0.41922 and -1.62319 a step; their sum is the logarithm of the determinant, 0.3, to round-off."""
    growth = spectrum_of(Plane(), RK4, Stepper(henon_step, 2), 1.0, 200_000, (0.1, 0.1))
    assert growth.exponents == pytest.approx([0.41922, -1.62319], abs=4e-3)
    assert growth.exponents.sum() == pytest.approx(math.log(0.3), abs=1e-12)
    assert growth.verdicts[0] is Verdict.CHAOTIC
    largest = growth_of(Plane(), RK4, Stepper(henon_step, 2), 1.0, 1_000_000, np.array([[0.1, 0.1]]))
    assert abs(largest.exponents[0] - 0.41922) < 4.0 * largest.errors[0] + 1e-4


@pytest.mark.slow
def test_exponents_of_a_canonical_map_come_in_pairs() -> None:
    """Of opposite sign, and one pair of zeros for each integral; rk4, which contracts, is the control."""
    top, y, N = TOPS["heavy"].new(), (1.5, 0.4, 0.6, 0.36, 0.48, 0.8), 100_000
    found = {}
    for name, h in (("splitting", 0.1), ("rk4", 0.4)):
        found[name] = spectrum_of(top, find_scheme(name, "heavy"), built(name, top), h, N, y)
    x, tolerance = found["splitting"].exponents, 2.0 * math.log(0.1 * N) / (0.1 * N)
    assert x[0] > 50.0 * tolerance
    assert np.abs(x + x[::-1]).max() < tolerance
    assert np.abs(x[1:5]).max() < tolerance
    assert abs(x.sum()) < 1e-13
    assert abs(found["rk4"].exponents.sum()) > 1e-3


def states(count: int, seed: int = 3) -> np.ndarray:
    y = np.random.default_rng(seed).normal(size=(count, 6)) * [1.5, 1.5, 1.5, 1.0, 1.0, 1.0]
    y[:, 3:] /= np.linalg.norm(y[:, 3:], axis=1)[:, None]
    return y


def test_an_orbit_that_breaks_off_has_no_exponent() -> None:
    """The logarithm of a state that is not finite is not a growth; orbits beside it are not affected."""

    def step(s, h, p):
        return (s[0] * s[0], s[1])

    y = np.array([[2.0, 1.0], [0.5, 1.0]])
    growth = growth_of(Plane(), RK4, Stepper(step, 2), 1.0, 1000, y)
    assert growth.verdicts[0] is Verdict.BROKE_OFF
    assert math.isnan(growth.exponents[0])
    assert not math.isnan(growth.exponents[1])


def test_work_that_is_to_stop_stops() -> None:
    top = TOPS["kowalevski"].new()
    with stopping_when(lambda: True), pytest.raises(StopAsked):
        growth_of(top, find_scheme("hk", "kowalevski"), built("hk", top), 0.1, 10**12, states(64))


def beside(y: Sequence[float], column: int, size: float = 1e-9) -> np.ndarray:
    """64 states that differ from ``y`` in a component."""
    states = np.tile(np.array(y, dtype=float), (64, 1))
    states[:, column] += size * np.arange(64)
    return states


def scattered(y: Sequence[float], size: float) -> np.ndarray:
    return np.array(y) + size * np.random.default_rng(5).normal(size=(64, len(y)))


def covered_cases() -> dict[str, tuple[Any, np.ndarray, float | None]]:
    """Experiment, initial states, and the exponent; by default the mean."""

    def lorenz(N: int) -> Experiment:
        return of_field(LORENZ, (1, 2, 20), "rk4", 0.01, N)

    roessler = of_field(ROESSLER, (1, 2, 0), "rk4", 0.02, 50_000)
    sea = of_field(HENON_HEILES, (0.0, -0.016, 0.49974, 0.0), "hk", 0.05, 1_000_000)
    kowalevski = load_experiment("kowalevski_generic_hk", ["h=0.6", "N=20000"])
    heavy = load_experiment("heavy_chaotic", ["N=50000"])
    return {
        "Lorenz": (lorenz(20_000), scattered((1, 2, 20), 1.0), 0.9056),
        "Lorenz, longer": (lorenz(100_000), scattered((1, 2, 20), 1.0), 0.9056),
        "Lorenz, transient": (lorenz(20_000), beside((0, 10, 0), 0), 0.9056),
        "Lorenz, transient, longer": (lorenz(100_000), beside((0, 10, 0), 0), 0.9056),
        "Roessler": (roessler, scattered((1, 2, 0.5), 0.3), 0.0714),
        "Henon and Heiles": (sea, beside(sea.y0, 1), None),
        "Kowalevski's top under hk": (kowalevski, beside(kowalevski.y0, 0), None),
        "a heavy top": (heavy, beside(heavy.y0, 0), None),
    }


@pytest.mark.slow
def test_intervals_cover_the_exponent() -> None:
    """Of intervals of 95 %, at least 85 % for each system and 94 % of all, with 64 orbits each.

    At the rate of 95 %, 10 or more of 64 intervals miss with a probability of 0.1 %. The intervals are no wider than a
    few times the scatter of the exponents, and most orbits are called chaotic.
    """
    shares = []
    for name, (experiment, y, exponent) in covered_cases().items():
        growth = growth_along(experiment, y)
        x = growth.exponents
        shares.append(np.mean(np.abs(x - (x.mean() if exponent is None else exponent)) <= growth.errors))
        assert shares[-1] >= 0.85, name
        assert np.median(growth.errors) < 8.0 * x.std(), name
        assert growth.verdicts.count(Verdict.CHAOTIC) >= 48, name
    assert np.mean(shares) >= 0.94


@pytest.mark.parametrize(("begin", "skipped"), [(2.5, 3), (0.1, 0), (7.5, 8), (9.5, 0)])
def test_exponents_leave_out_a_transient(begin: float, skipped: int) -> None:
    """Parts of 16 in which nothing grows, within the first half; a tenth of a part counts for nothing."""
    whole = curves(lambda u: 400.0 * np.maximum(u - begin / 16.0, 0.0) + np.sin(70.0 * u))
    assert whole.transients.tolist() == [skipped]
    growth = replace(whole, skipped=whole.transients)
    assert growth.exponents[0] == pytest.approx(0.4, abs=growth.errors[0])
    assert growth.errors[0] <= whole.errors[0]
    if skipped:
        assert growth.errors[0] < 0.03 < 0.1 < whole.errors[0]


def test_the_growth_along_an_orbit_does_not_depend_on_the_others() -> None:
    """Bit for bit, with few and with many orbits beside it, on tops of three to eight components."""
    for name, count in (("euler_hk", 70), ("heavy_chaotic", 9), ("so4_gentle", 3)):
        experiment = load_experiment(name, ["N=1500"])
        y = np.array(experiment.y0) * np.linspace(0.9, 1.1, count)[:, None]
        many = growth_along(experiment, y)
        for i in (0, 1, count // 2, count - 1):
            alone = growth_along(experiment, y[i : i + 1])
            assert np.array_equal(alone.logs[:, 0], many.logs[:, i])
            assert (alone.exponents[0], alone.errors[0]) == (many.exponents[i], many.errors[i])
            assert (alone.rate[0], alone.verdicts[0]) == (many.rate[i], many.verdicts[i])
