"""The domain of backlund's step: its bounds, how a longer step is refused or divided, and the rounding of tau."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import topcli
from conftest import GEN, PAPER, random_states
from test_backlund import HANGING, integrals, limit
from test_beyond import DELONE
from topcli.contracts import Floats, Outcome
from topcli.errors import ConfigError, StepTooLongError
from topcli.schemes.kowalevski.backlund_constants import admits, frozen_constants, rounded_tau

INITIAL = {"omega": [0.7, -0.4, 1.3], "gamma": [0.6, 0.48, 0.64]}


def root(h: np.ndarray, y: Floats, c: float) -> np.ndarray:
    """R and 1 - (h/4)² (F + 2k), whose first zero bounds the domain, by the integrals."""
    gamma_sq, two_l, energy, k_sq = integrals(y, c)
    u, q = h * h / 16.0, c * c * h * h / 4.0
    S = u * (4.0 * energy - q * gamma_sq)
    P = u * u * (4.0 * energy**2 - 4.0 * k_sq - q * two_l**2)
    return np.minimum(1.0 - S + P, 1.0 - 2.0 * u * (energy + math.sqrt(k_sq)))


@pytest.mark.slow
@pytest.mark.parametrize("c", [1.0, -0.7, 0.0, 30.0])
def test_longest_step_is_at_the_first_zero(c: float) -> None:
    """0.9 of the first zero on a fine grid, or of 4/sqrt|c gamma|; a little more is not admissible."""
    top = np.linspace(0.0, 40.0, 200_001)[1:]
    for y in [*map(tuple, random_states(8, seed=77)), GEN, PAPER, HANGING, DELONE]:
        off = np.flatnonzero(root(top, y, c) <= 0.0)
        first = min(top[off[0]] if len(off) else math.inf, 4.0 / math.sqrt(abs(c)) if c else math.inf)
        longest = limit(y, c)
        assert longest == pytest.approx(0.9 * first, abs=4e-4)
        constants = frozen_constants(y, (c,))[:4]
        assert admits(longest, *constants)
        assert admits(-longest, *constants)
        assert not admits(longest * (1.0 + 1e-9), *constants)


def test_extreme_states_have_a_domain() -> None:
    """At rest without gravity every step is possible; beyond |omega| = 1e154 none is."""
    assert limit((0.0, 0.0, 0.0, 0.0, 0.0, 1.0), 0.0) == 1e300
    assert limit((1e150, 0.0, 0.0, 0.0, 0.0, 1.0)) == pytest.approx(0.9 * 2e-150, rel=1e-6)
    assert limit((1e200, 0.0, 0.0, 0.0, 0.0, 1.0)) == 0.0
    assert limit((1e-100, 0.0, 0.0, 0.0, 0.0, 1.0), 0.0) == pytest.approx(0.9 * 2e100, rel=1e-6)


def test_too_long_a_step_is_refused_before_the_run(tmp_path: Any) -> None:
    """The message names the longest step, which is accepted, and the line; a composition counts stages."""
    config = {"top": "kowalevski", "initial": INITIAL, "scheme": "backlund", "N": 5}
    with pytest.raises(
        StepTooLongError, match=r"^h: \|h\| must be at most 1\.4\d+ under backlund from this state, not 1.5, or"
    ) as found:
        topcli.simulate({**config, "h": 1.5})
    named = float(str(found.value).split("at most ")[1].split()[0])
    assert topcli.simulate({**config, "h": named}).outcome is Outcome.COMPLETED
    assert topcli.simulate({**config, "h": -named}).outcome is Outcome.COMPLETED
    with pytest.raises(ConfigError):
        topcli.simulate({**config, "h": 1.001 * named})
    composed = {**config, "scheme": {"name": "backlund", "compose": "suzuki4"}}
    with pytest.raises(StepTooLongError, match="at most 2"):
        topcli.simulate({**composed, "h": 2.5})
    assert topcli.simulate({**composed, "h": 2.1}).outcome is Outcome.COMPLETED
    path = tmp_path / "long.yaml"
    path.write_text(
        "top: kowalevski\ninitial:\n  omega: [0.7, -0.4, 1.3]\n  gamma: [0.6, 0.48, 0.64]\n"
        "scheme: backlund\nh: 3\nN: 5\n"
    )
    with pytest.raises(StepTooLongError, match=r"long\.yaml:6: h: \|h\| must be at most 1\.4"):
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
