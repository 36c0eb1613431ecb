"""The domain of backlund's step: its bounds, how a longer step is refused or divided, and the rounding of tau."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from mpmath import mp, mpf

import topcli
from conftest import GEN, PAPER, random_states
from test_backlund import HANGING, dressed, exact_step, integrals, limit, stepper, with_digits
from test_beyond import DELONE, deviations, ran
from topcli.contracts import Floats, Outcome
from topcli.errors import ConfigError, StepTooLongError
from topcli.schemes.kowalevski import backlund_parameters
from topcli.schemes.kowalevski.backlund_parameters import admits, frozen_constants, rounded_tau, tau_of
from topcli.schemes.kowalevski.backlund_step import physical_step

INITIAL = {"omega": [0.7, -0.4, 1.3], "gamma": [0.6, 0.48, 0.64]}


def safe(h: np.ndarray, y: Floats, c: float) -> np.ndarray:
    """True where round-off is safe at each of these steps: the limits of the docs on h and 1 - S + P."""
    gamma_sq, two_l, energy, k_sq = integrals(y, c)
    u, q = h * h / 16.0, c * c * h * h / 4.0
    S = u * (4.0 * energy - q * gamma_sq)
    P = u * u * (4.0 * energy**2 - 4.0 * k_sq - q * two_l**2)
    R = 1.0 - S + P
    short = np.maximum(h * h * (2.0 * energy + 2.0 * math.sqrt(k_sq)), h * h * abs(c) * math.sqrt(gamma_sq)) <= 25.0
    return short & (R >= 1.0 / 32.0)


DIPS = (-0.27, 0.3, 2.31, -0.262, -0.903, -0.341)
"""R falls below 1/32 and rises again before 5/sqrt(2E + 2k)."""


@pytest.mark.slow
@pytest.mark.parametrize("c", [1.0, -0.7, 0.0, 30.0])
def test_longest_step_is_the_first_that_is_not_safe(c: float) -> None:
    """On a fine grid; a little more is not admissible, and each of the limits binds for some state."""
    steps = np.linspace(0.0, 40.0, 400_001)[1:]
    for y in [*map(tuple, random_states(30, seed=77)), GEN, PAPER, HANGING, DELONE, DIPS]:
        off = np.flatnonzero(~safe(steps, y, c))
        longest = limit(y, c)
        assert longest == pytest.approx(steps[off[0]], abs=3e-4)
        constants = frozen_constants(y, (c,))[:4]
        assert admits(longest, *constants)
        assert admits(-longest, *constants)
        assert not any(admits(longest * factor, *constants) for factor in np.linspace(1.0 + 1e-9, 1.5, 51))


def test_nothing_ends_the_map_up_to_four() -> None:
    """R >= (1 - y)(1 - x + r²) for 2e5 real states, and not by much for some."""
    y = np.vstack([random_states(100_000, seed=91), random_states(100_000, seed=92) * np.array([3, 3, 3, 1, 1, 1])]).T
    gamma_sq, two_l, energy, k_sq = integrals(list(y), 1.0)
    low, high = 2.0 * (energy - np.sqrt(k_sq)), 2.0 * (energy + np.sqrt(k_sq))
    assert (two_l**2 <= gamma_sq * high * (1.0 + 1e-12)).all()
    u = 16.0 / high * np.random.default_rng(93).uniform(0.0, 1.0, high.shape)
    x, yy, rr, vv = u * low / 16.0, u * high / 16.0, gamma_sq * u * u / 64.0, u**3 * two_l**2 / 1024.0
    R = (1.0 - x) * (1.0 - yy) + rr - vv
    least = (1.0 - yy) * (1.0 - x + rr)
    assert (least <= R + 1e-12).all()
    assert (least > R - rr * yy).any()


@pytest.mark.slow
def test_map_is_exact_up_to_the_longest_step() -> None:
    """With 60 digits it equals the two transformations and keeps the integrals; in doubles to round-off."""
    for y in map(tuple, random_states(20, seed=95)):
        h = limit(y)
        with mp.workdps(60):
            found, expected = with_digits(exact_step, y, h, 1.0), with_digits(dressed, y, h, 1.0)
            assert max(abs(p - q) for p, q in zip(found, expected, strict=True)) < 1e-45
            before, after = integrals([mpf(v) for v in y], mpf(1)), integrals(found, mpf(1))
            assert max(abs(p - q) for p, q in zip(before, after, strict=True)) < 1e-50
            exact = [float(v) for v in expected]
        tau = tau_of(h, *frozen_constants(y, (1.0,))[:4])
        np.testing.assert_allclose(physical_step(y, h, 1.0, tau), exact, rtol=0, atol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"project": 16}, {"compensated": True}], ids=str)
def test_integrals_up_to_the_longest_step(options: dict[str, Any]) -> None:
    """1e5 steps from states that are not chosen: at most 50 ulp sqrt(N); 3 is typical."""
    N = 100_000
    for y in map(tuple, random_states(40, seed=94)):
        h = limit(y)
        states, ending = ran(stepper(**options), y, h, N, 10)
        assert ending.outcome is Outcome.COMPLETED
        assert max(deviations(states).values()) < 50.0 * math.sqrt(N)


@pytest.mark.slow
def test_integrals_are_lost_beyond_the_longest_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """The control: without the limits the map, exact as it is, loses the integrals of some states to round-off."""
    for limit_name, value in (("REACH", 100.0), ("LEAST_R", 1e-6)):
        monkeypatch.setattr(backlund_parameters, limit_name, value)
    lost = completed = 0
    for y in map(tuple, random_states(40, seed=94)):
        _, _, energy, k_sq = integrals(y, 1.0)
        states, ending = ran(stepper(), y, 12.0 / math.sqrt(2.0 * (energy + math.sqrt(k_sq))), 20_000, 10)
        if ending.outcome is Outcome.COMPLETED:
            completed += 1
            lost += max(deviations(states).values()) > 1e6 * math.sqrt(20_000)
    assert 1 <= lost <= completed < 40


def test_frozen_steps_of_a_spinning_top_need_a_projection() -> None:
    """Deviations grow in a window of steps below the longest, as the limits say; a projection prevents it."""
    y, N = (-0.41189954, 0.18065694, 2.7894444, 0.22891664, -0.21960694, -0.94835118), 20_000
    h = 1.1
    assert 0.8 * limit(y) < h < limit(y)
    assert 2.9 < h * abs(y[2]) < 3.3
    choices: list[dict[str, Any]] = [{}, {"project": 16}]
    off = [max(deviations(ran(stepper(**options), y, h, N, 10)[0]).values()) for options in choices]
    assert off[0] > 1e6 * math.sqrt(N)
    assert off[1] < 1.0 * math.sqrt(N)
    short = deviations(ran(stepper(), y, 0.7 * limit(y), N, 10)[0])
    assert max(short.values()) < 5.0 * math.sqrt(N)


def test_extreme_states_have_a_domain() -> None:
    """At rest without gravity every step is possible; beyond |omega| = 1e154 none is."""
    assert limit((0.0, 0.0, 0.0, 0.0, 0.0, 1.0), 0.0) == 1e300
    assert limit((1e150, 0.0, 0.0, 0.0, 0.0, 1.0)) == pytest.approx(math.sqrt(31.0 / 32.0) * 2e-150, rel=1e-6)
    assert limit((1e200, 0.0, 0.0, 0.0, 0.0, 1.0)) == 0.0
    assert limit((1e-100, 0.0, 0.0, 0.0, 0.0, 1.0), 0.0) == pytest.approx(math.sqrt(31.0 / 32.0) * 2e100, rel=1e-6)


def test_too_long_a_step_is_refused_before_the_run(tmp_path: Any) -> None:
    """The message names the longest step, which is accepted, and the line; a composition counts stages."""
    config = {"top": "kowalevski", "initial": INITIAL, "scheme": "backlund", "N": 5}
    with pytest.raises(
        StepTooLongError, match=r"^h: \|h\| must be at most 1\.65 under backlund from this state, not 1.7, or"
    ) as found:
        topcli.simulate({**config, "h": 1.7})
    named = float(str(found.value).split("at most ")[1].split()[0])
    assert topcli.simulate({**config, "h": named}).outcome is Outcome.COMPLETED
    assert topcli.simulate({**config, "h": -named}).outcome is Outcome.COMPLETED
    with pytest.raises(ConfigError):
        topcli.simulate({**config, "h": 1.002 * named})
    composed = {**config, "scheme": {"name": "backlund", "compose": "suzuki4"}}
    with pytest.raises(StepTooLongError, match=r"at most 2\.5"):
        topcli.simulate({**composed, "h": 2.6})
    assert topcli.simulate({**composed, "h": 2.5}).outcome is Outcome.COMPLETED
    path = tmp_path / "long.yaml"
    path.write_text(
        "top: kowalevski\ninitial:\n  omega: [0.7, -0.4, 1.3]\n  gamma: [0.6, 0.48, 0.64]\n"
        "scheme: backlund\nh: 3\nN: 5\n"
    )
    with pytest.raises(StepTooLongError, match=r"long\.yaml:6: h: \|h\| must be at most 1\.65"):
        topcli.simulate(path)
    fast = {"omega": [1e200, 0, 0], "gamma": [0, 0, 1]}
    with pytest.raises(StepTooLongError, match="no step is possible"):
        topcli.simulate({**config, "initial": fast, "h": 1e-210})


def test_substeps_divide_a_long_step() -> None:
    """As few as the domain allows: the same states as with the divided h."""
    config = {"top": "kowalevski", "initial": INITIAL}
    auto = topcli.simulate({**config, "scheme": {"name": "backlund", "substeps": "auto"}, "h": 4.0, "N": 50})
    short = topcli.simulate({**config, "scheme": "backlund", "h": 4.0 / 3.0, "N": 150, "output": {"every": 3}})
    np.testing.assert_allclose(auto.states, short.states, rtol=0, atol=1e-12)
    assert auto.outcome is Outcome.COMPLETED


@pytest.mark.slow
def test_members_beyond_the_domain_end_by_themselves() -> None:
    """They do not converge at step 1, without disturbing the others; also in the form for compositions."""
    states = np.array([GEN, (4.0, -2.0, 3.0, 0.6, 0.48, 0.64), PAPER])
    for scheme in (
        "backlund",
        {"name": "backlund", "compose": "suzuki4"},
        {"name": "backlund", "constants": "recomputed"},
    ):
        ensemble = topcli.simulate_ensemble(top="kowalevski", states=states, scheme=scheme, h=0.8, N=20)
        assert [ending.outcome for ending in ensemble.endings] == [
            Outcome.COMPLETED,
            Outcome.NO_CONVERGENCE,
            Outcome.COMPLETED,
        ]
        assert ensemble.endings[1].step == 1


def test_rounded_tau_makes_its_complements_exact() -> None:
    """2 - tau and 4 - tau have no rounding error, except for a tiny scaled state, where tau itself matters more."""
    for tau in np.random.default_rng(78).uniform(1e-3, 0.9, 200).tolist():
        rounded = rounded_tau(tau, 8.01e-3)
        assert abs(rounded - tau) < 3.5e-16
        assert Fraction(2.0 - rounded) == 2 - Fraction(rounded)
        assert Fraction(2.0 + (2.0 - rounded)) == 4 - Fraction(rounded)
        assert rounded_tau(tau, 7.99e-3) == tau
