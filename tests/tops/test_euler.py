"""The Euler top: implicit steps, special states, and round-off."""

from __future__ import annotations

import math

import numpy as np
import pytest

from steppers import built, physical
from topcli.contracts import Invariant, Method, Outcome, Top
from topcli.engine.collect import orbit
from topcli.schemes.registry import find_scheme
from topcli.tops.euler import Euler, EulerGamma

EPS = 2.0**-52


def random_tops(count: int, seed: int, cls: type[Euler] = EulerGamma) -> list[tuple[Euler, np.ndarray]]:
    """Tops with moments from 0.5 to 4 (some break the triangle inequality) and states with omega of size one."""
    random = np.random.default_rng(seed)
    made = []
    for _ in range(count):
        A, B, C = random.uniform(0.5, 4.0, 3)
        omega, gamma = random.normal(size=(2, 3))
        y0 = np.concatenate([omega, gamma / np.linalg.norm(gamma)])
        top = cls(A=A, B=B, C=C)
        made.append((top, y0[: len(top.components)]))
    return made


def test_bs_implicit_is_the_inverse_of_bs() -> None:
    for top, y0 in random_tops(10, seed=22):
        there = physical(built("bs-implicit", top))(tuple(y0), 0.2, top.constants())
        back = physical(built("bs", top))(there, -0.2, top.constants())
        assert back == pytest.approx(tuple(y0), abs=1e-14)


@pytest.mark.parametrize("name", ["hk", "bs", "bs-implicit"])
def test_omega_does_not_depend_on_gamma(name: str) -> None:
    """The six-component step moves omega as the three-component step does, bit for bit."""
    for top, y0 in random_tops(5, seed=23):
        free = Euler(A=top.A, B=top.B, C=top.C)
        six, three = (
            physical(method)(tuple(y0[: len(body.components)]), 0.1, method.parameters(body))
            for body, method in ((top, built(name, top)), (free, built(name, free)))
        )
        assert six[:3] == three


@pytest.mark.parametrize("name", ["bs-implicit", "midpoint"])
@pytest.mark.parametrize("h", [1.0, 3.0, -10.0])
def test_steps_far_beyond_useful_lengths_are_solved_or_refused(name: str, h: float) -> None:
    """A solution always exists (a map of a sphere to itself homotopic to a constant); Newton's method may miss it."""
    outcomes = []
    for top, y0 in random_tops(50, seed=24, cls=Euler):
        _, states, ending = orbit(top, built(name, top), y0, h, 1)
        outcomes.append(ending.outcome)
        if ending.outcome is Outcome.COMPLETED:
            m, m_new = ((np.array(top.constants()[:3]) * state) for state in (y0, states[-1]))
            assert m_new @ m_new == pytest.approx(m @ m, rel=1e-12)
    assert set(outcomes) <= {Outcome.COMPLETED, Outcome.NO_CONVERGENCE}
    assert outcomes.count(Outcome.COMPLETED) >= 10


def series(top: Top, method: Method, y0: np.ndarray, h: float, N: int) -> np.ndarray:
    _, states, ending = orbit(top, method, y0, h, N, 20)
    assert ending.outcome is Outcome.COMPLETED
    return states


def over_bar(invariant: Invariant, states: np.ndarray, N: int) -> float:
    """Largest deviation in units of 50 ulp sqrt(N)."""
    values = invariant.value(states)
    return float(np.abs(values - values[0]).max() / (50 * EPS * math.sqrt(N) * invariant.scale(states).max()))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hk", "midpoint"])
def test_round_off_is_a_random_walk(name: str) -> None:
    """Over 100 times as many steps the error of m² (HK: of its modified m²) grows like their root, not like them."""
    grown = []
    for top, y0 in random_tops(5, seed=33, cls=Euler):
        scheme = find_scheme(name, "euler")
        options = scheme.options()
        one = scheme.modified(top, 0.02, options)[0] if scheme.modified else top.invariants()[0]
        values = one.value(series(top, scheme.build(top, options), y0, 0.02, 400_000))
        short = np.mean([np.ptp(part) for part in np.array_split(values[1:], 100)])
        grown.append(np.ptp(values) / short)
    assert np.median(grown) < 25.0  # 10 for a random walk, 100 for a drift


def test_bs_implicit_survives_vanishing_components() -> None:
    """omega1 and omega2 shrink below 1e-160, where their squares underflow; the iteration still ends."""
    top = Euler(A=2.05, B=2.49, C=3.68)
    states = series(top, built("bs-implicit", top), np.array((0.04, -1.6, 1.0)), 0.1, 60_000)
    assert np.abs(states[-1, :2]).max() < 1e-160
    assert over_bar(top.invariants()[0], states, 60_000) < 1.0


@pytest.mark.parametrize("name", ["hk", "bs", "bs-implicit", "midpoint"])
def test_steady_rotations_are_exact(name: str) -> None:
    """About a principal axis, or for A = B = C, omega does not move by a single bit."""
    for top, omega in ((Euler(), (0, 0, 2)), (Euler(A=1.7, B=1.7, C=1.7), (0.3, -1.1, 2)), (Euler(), (0, 0, 0))):
        states = series(top, built(name, top), np.array(omega, dtype=float), 0.1, 1000)
        assert np.array_equal(states, np.tile(np.array(omega, dtype=float), (len(states), 1)))
