"""Verdicts regular or chaotic: against what is known of an orbit, at many lengths, and on both sides of each bound."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np
import pytest

from orbits import DUFFING, LORENZ, PENDULUM, curves, growth_along, hard, of_field
from topcli.analysis.lyapunov import CHAOTIC, DEEP, FALLS, LATE, LEAST_STEPS, REGULAR, Verdict
from topcli.analysis.recurrence import Recurrence
from topcli.config.load import load_experiment

LENGTHS = np.unique(np.round(np.geomspace(LEAST_STEPS, 200_000, 40)).astype(int)).tolist()
LOG_T = math.log(1001.0)
"""Growth of a regular orbit of ``curves``: a unit of time of 1, over 1000."""


def saw(teeth: float, height: float, u: Any) -> Any:
    """Rises and falls by ``height``, from 0 on."""
    return height * (1.0 - np.abs((teeth * u) % 2.0 - 1.0))


def verdicts(*of_time: Any, **options: Any) -> list[str]:
    return [str(verdict) for verdict in curves(*of_time, **options).verdicts]


def test_growth_that_is_regular_or_exponential() -> None:
    assert verdicts(
        lambda u: np.log1p(1000.0 * u),
        lambda u: np.log1p(1000.0 * u) + saw(40.0, 2.0, u),
        lambda u: 40.0 * u,
        lambda u: 40.0 * u + saw(60.0, 2.0, u),
        lambda u: np.full_like(u, np.nan),
        lambda u: -40.0 * u,
    ) == ["regular", "regular", "chaotic", "chaotic", "broke off", "regular"]


@pytest.mark.parametrize(
    ("below", "above"),
    [
        (lambda u: (LOG_T + CHAOTIC - 0.5) * u, lambda u: (LOG_T + CHAOTIC + 0.5) * u),
        (
            lambda u: 20.0 * np.minimum(u, 0.5) + 2.0 * (LATE - 0.3) * np.maximum(u - 0.5, 0.0),
            lambda u: 20.0 * np.minimum(u, 0.5) + 2.0 * (LATE + 0.3) * np.maximum(u - 0.5, 0.0),
        ),
        # a growth that stops in the last quarter of the second half
        (lambda u: 40.0 * np.minimum(u, 0.87), lambda u: 40.0 * np.minimum(u, 0.9)),
        # teeth whose falls, while the rest grows by 1.25, are half the growth in the second half
        (
            lambda u: 20.0 * u + saw(16.0, 10.0 / FALLS + 1.25 + 0.3, u),
            lambda u: 20.0 * u + saw(16.0, 10.0 / FALLS + 1.25 - 0.3, u),
        ),
        # a single fall next to a separatrix
        (
            lambda u: 800.0 * u - (DEEP + 8.0) * np.exp(-(((u - 0.61) / 0.003) ** 2)),
            lambda u: 800.0 * u - (DEEP + 1.0) * np.exp(-(((u - 0.61) / 0.003) ** 2)),
        ),
        # a growth that comes in two bursts, and one that comes in eight
        (
            lambda u: 16.0 * u + 12.0 * np.floor(2.0 * u - 0.25),
            lambda u: 16.0 * u + 3.0 * np.floor(8.0 * u - 0.25),
        ),
    ],
    ids=["excess", "late", "at all times", "teeth", "deep fall", "error"],
)
def test_both_sides_of_a_bound(below: Any, above: Any) -> None:
    assert verdicts(below, above) == ["undecided", "chaotic"]


def test_growth_that_is_no_more_exponential_is_regular() -> None:
    """Growth that ended in the first eighth, and growth that fell back to that of a regular orbit later."""
    ended = 0.5 * (math.log(8.0) + 1.0)
    assert verdicts(
        lambda u: 400.0 * np.minimum(u, 0.1) + ended * u,
        lambda u: 400.0 * np.minimum(u, 0.1) + 3.0 * ended * u,
        lambda u: saw(15.0, LOG_T + 9.0, u),
        lambda u: saw(15.0, LOG_T + 9.0, u) + LOG_T + REGULAR + 1.0,
    ) == ["regular", "undecided", "regular", "undecided"]


def test_exponential_growth_is_chaos_on_an_orbit_that_wanders() -> None:
    kinds = {
        Recurrence.WANDERS: "chaotic",
        Recurrence.REPEATS: "unstable",
        Recurrence.LEAVES: "escaping",
        Recurrence.AT_REST: "equilibrium",
        Recurrence.TOO_SHORT: "undecided",
    }
    assert {kind: verdicts(lambda u: 40.0 * u, recurrence=kind)[0] for kind in Recurrence} == kinds
    assert verdicts(lambda u: 0.0 * u, recurrence=Recurrence.AT_REST) == ["equilibrium"]


def counted(experiment: Any, y: Any, lengths: Any) -> Counter[str]:
    return Counter(str(verdict) for N in lengths for verdict in growth_along(experiment, y, N).verdicts)


def packaged(name: str, *overrides: str) -> Any:
    return load_experiment(name, ["N=1000", *overrides])


NEAR = [[10.0**-k, 1.0, 10.0**-k] for k in (1, 3, 5, 6, 7, 9, 12)]
BESIDE = [[10.0**-k, 0.0] for k in (1, 3, 5, 6, 7, 9, 12)]
SEPARATRICES: dict[str, tuple[Any, Any]] = {
    "hk of Euler's top": (packaged("euler_hk", "h=0.05"), NEAR),
    "hk of Euler's top, long steps": (packaged("euler_hk", "h=0.3"), NEAR),
    "Duffing's oscillator": (of_field(DUFFING, (1.0, 0.0), "midpoint", 0.05), BESIDE),
    "a pendulum": (of_field(PENDULUM, (1.0, 0.0), "rk4", 0.05), BESIDE),
    "a pendulum that turns": (
        of_field(PENDULUM, (1.0, 0.0), "rk4", 0.05),
        [[math.pi, 2.0 + s * 10.0**-k] for k in (2, 6, 10, 14) for s in (1, -1)],
    ),
    "a gyrostat": (hard("kowalevski-gyrostat", "N=1000"), None),
    "Kirchhoff's body": (hard("kirchhoff", "N=1000"), None),
    "Gaudin's top": (hard("gaudin", "N=1000"), None),
    "a sleeping top": (packaged("lagrange_sleeping"), None),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SEPARATRICES)
def test_integrable_motion_near_a_separatrix_is_never_chaotic(name: str) -> None:
    """At 40 lengths. Half the verdicts at least are not undecided, or the test would say little."""
    experiment, y = SEPARATRICES[name]
    counts = counted(experiment, y, LENGTHS)
    assert set(counts) <= {"regular", "undecided", "escaping"}
    assert counts["escaping"] <= 0.1 * counts.total()  # those that have not come back yet
    assert counts["regular"] >= 0.5 * counts.total()


@pytest.mark.slow
def test_chaotic_motion_is_chaotic_at_all_lengths() -> None:
    """hk of Kowalevski's top with a long step: from 60 e-foldings on, but for a few lengths."""
    counts = counted(packaged("kowalevski_generic_hk", "h=0.6"), None, LENGTHS)
    assert set(counts) <= {"chaotic", "undecided"}
    assert counts["undecided"] <= 6


@pytest.mark.slow
def test_an_unstable_periodic_orbit_is_not_chaotic() -> None:
    """Neumann's problem within a plane, whose exponent 1.63 belongs to the direction across it."""
    counts = counted(hard("clebsch", "N=1000"), None, LENGTHS)
    assert set(counts) <= {"unstable", "undecided"}
    assert counts["undecided"] < 20  # those with less than six periods
    growth = growth_along(hard("clebsch", "N=1000"), N=20_000)
    assert growth.exponents[0] == pytest.approx(1.628, abs=growth.errors[0])


ESCAPES: dict[str, tuple[dict[str, str], list[list[float]]]] = {
    "exponential": ({"x": "0.1*x"}, [[1.0], [-1e-8]]),
    "saddle": ({"x": "x", "y": "-y"}, [[1e-9, 1.0], [1.0, 1.0]]),
    "spiral": ({"x": "0.2*x - 3*y", "y": "3*x + 0.2*y"}, [[1.0, 0.0]]),
    "with the time": ({"x": "0.3*x", "s": "1"}, [[1.0, 0.0]]),
}


@pytest.mark.parametrize("name", ESCAPES)
def test_exponential_escapes_are_not_chaotic(name: str) -> None:
    field, y = ESCAPES[name]
    counts = counted(of_field(field, y[0], "rk4", 0.05), y, (2000, 3000, 5000))
    assert set(counts) <= {"escaping", "undecided"}
    assert counts["escaping"] >= 0.6 * counts.total()


@pytest.mark.parametrize(
    ("experiment", "y", "rate"),
    [
        (packaged("euler_hk", "h=0.05"), (0.0, 1.0, 0.0), None),
        (packaged("euler_hk", "h=0.05"), (1.0, 0.0, 0.0), 0.0),
        (packaged("euler_hk", "h=0.05"), (0.0, 0.0, 0.0), 0.0),
        (of_field(DUFFING, (0.0, 0.0), "rk4", 0.05), (0.0, 0.0), 1.0),
        (of_field(LORENZ, (0.0, 0.0, 0.0), "rk4", 0.01), (0.0, 0.0, 0.0), 11.8277),
        (of_field(LORENZ, (0.0, 0.0, 0.0), "rk4", 0.01), (0.0, 0.0, 30.0), 11.8277),
        (hard("clebsch", "N=1000"), (0.0, 0.0, 0.0, 0.0, 0.0, 1.0), None),
    ],
)
def test_equilibria_are_named(experiment: Any, y: Any, rate: float | None) -> None:
    """With the rates at which they are left, among them one to which the orbit comes near from elsewhere."""
    growth = growth_along(experiment, [y], 3000)
    assert growth.verdicts == [Verdict.EQUILIBRIUM]
    if rate is None:
        assert growth.exponents[0] > 10.0 * growth.errors[0]
    else:
        assert growth.exponents[0] == pytest.approx(rate, abs=growth.errors[0])


def test_no_verdict_on_fewer_steps_than_the_command_takes() -> None:
    lorenz = of_field(LORENZ, (1.0, 2.0, 20.0), "rk4", 0.05)
    for N, decided in ((LEAST_STEPS - 1, False), (LEAST_STEPS, True)):
        assert (growth_along(lorenz, N=N).verdicts[0] is Verdict.CHAOTIC) == decided
    assert growth_along(lorenz, N=1).verdicts == [Verdict.UNDECIDED]


def test_a_chaotic_angle_may_wind() -> None:
    """A driven pendulum: its angle and the time grow without bound."""
    field = {"q": "p", "p": "-sin(q) - 0.5*p + 1.15*cos(2/3*s)", "s": "1"}
    growth = growth_along(of_field(field, (0.3, 0.0, 0.0), "rk4", 0.05), N=100_000)
    assert growth.verdicts == [Verdict.CHAOTIC]
