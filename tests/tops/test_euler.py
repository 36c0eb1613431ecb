"""The Euler top: implicit steps, special states, and round-off."""

from __future__ import annotations

import numpy as np
import pytest

from steppers import built, physical
from topcli.contracts import Method, Outcome, Top
from topcli.engine.drive import orbit
from topcli.tops.euler import Euler, EulerGamma


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


@pytest.mark.parametrize("name", ["hk", "bs", "bs-implicit", "midpoint"])
def test_steady_rotations_are_exact(name: str) -> None:
    """About a principal axis, or for A = B = C, omega does not move by a single bit."""
    for top, omega in ((Euler(), (0, 0, 2)), (Euler(A=1.7, B=1.7, C=1.7), (0.3, -1.1, 2)), (Euler(), (0, 0, 0))):
        states = series(top, built(name, top), np.array(omega, dtype=float), 0.1, 1000)
        assert np.array_equal(states, np.tile(np.array(omega, dtype=float), (len(states), 1)))
