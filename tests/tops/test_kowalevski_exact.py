"""The closed form of the Kowalevski top against the double-double reference, closed forms and its symmetries.

``TOPCLI_RANDOM_TOPS=1000 pytest tests/tops/test_kowalevski_exact.py`` compares 1000 random states (minutes).
Errors are compared with the sensitivity: the change of the reference when the largest component of the initial state
changes by one ulp. Typical errors at t = 100 are 1e-15.
"""

from __future__ import annotations

import os
from itertools import product

import numpy as np
import pytest

from cases import MOTIONS, numbers_of
from conftest import GEN
from steppers import built
from topcli.analysis.reference import reference_states
from topcli.contracts import Sampler
from topcli.errors import RunError
from topcli.tops.kowalevski import Kowalevski

RANDOM_STATES = int(os.environ.get("TOPCLI_RANDOM_TOPS", "6"))
TIMES = np.array([1, 7, 30, 100])

FAMILIES = {
    "pinch, m.gamma = 0": lambda d: (0.5, 0.25, d, 0.0, 0.1 * d, 1.0),
    "at rest": lambda d: (0.0, 0.0, d, 0.6, 0.0, 0.8),
    "gamma on the third axis": lambda d: (0.7, 0.3, 1.0, d, 0.0, 1.0),
    "pendulum about the second axis": lambda d: (d, 1.0, 0.0, 0.6, 0.0, 0.8),
    "pendulum about the third axis": lambda d: (0.0, d, 1.0, 0.6, 0.8, d),
    "equilibrium, spinning": lambda d: (2.0, d, 0.0, 1.0, d, d),
    "hanging": lambda d: (d, 0.0, d, -1.0, d, d),
    "upright": lambda d: (d, 0.0, d, 1.0, d, d),
    "Delone, k = 0": lambda d: (0.5 + d, 0.5, 1.75, 0.0, 0.5, 0.75),
    "stable spin about the first axis": lambda d: (0.5, d, d, 1.0, d, 0.0),
    "Bobylev-Steklov": lambda d: (0.75, d, 0.5, 0.0, 0.75, 0.375),
}


def states(y0, h: float, n, c: float = 1.0) -> np.ndarray:
    method = built("exact", Kowalevski(c0=c))
    assert isinstance(method, Sampler)
    return method.states(np.array(y0, dtype=float), h, np.array(n, dtype=np.int64), (c,))


def assert_is_the_motion(y0, c: float = 1.0, times: np.ndarray = TIMES, factor: float = 8.0, loss: float = 1.0) -> None:
    """Within 2e-14 times the square of omega and a few times the sensitivity of the double-double reference."""
    y = np.array(y0, dtype=float)
    top = Kowalevski(c0=c)
    exact = reference_states(top, y.tolist(), times.astype(float))
    moved = y.copy()
    largest = int(np.argmax(np.abs(y)))
    moved[largest] = np.nextafter(y[largest], np.inf)
    sensitivity = np.abs(reference_states(top, moved.tolist(), times.astype(float)) - exact).max(axis=1)
    error = np.abs(states(y, 1.0, times, c) - exact).max(axis=1)
    allowed = 2e-14 * loss * max(1.0, float((y[:3] ** 2).sum())) / min(1.0, abs(c)) + factor * sensitivity
    assert (error <= allowed).all(), (y, c, error, allowed)


def random_state(seed: int) -> tuple[list[float], float]:
    random = np.random.default_rng(seed)
    gamma = random.normal(size=3)
    omega = random.normal(size=3) * (0.5, 1.0, 1.5, 3.0)[seed % 4]
    return [*omega, *(gamma / np.linalg.norm(gamma))], (1.0, -0.7, 2.5)[seed % 3]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(RANDOM_STATES))
def test_random_motions(seed: int) -> None:
    assert_is_the_motion(*random_state(seed))


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_degenerate_motions_and_their_neighbours(family: str) -> None:
    for distance in (0.0, 1e-8, 1e-15):
        assert_is_the_motion(FAMILIES[family](distance), times=TIMES[:3])


NATURAL = numbers_of(MOTIONS["whole numbers"])


@pytest.mark.slow
@pytest.mark.parametrize("name", NATURAL)
def test_degenerate_motions_of_whole_numbers(name: str) -> None:
    """Typical errors 1e-15. Two bits of the phases are lost in the long periods of what replaces a separatrix."""
    for distance, loss in ((0.0, 4.0), (1e-8, 1.0)):
        y = np.array(NATURAL[name])
        y[1] += distance
        assert_is_the_motion(y, times=np.array([1, 2, 7]), loss=loss)


def states_or_refusal(y0, h: float, n) -> np.ndarray | str:
    try:
        return states(y0, h, n)
    except RunError as error:
        return str(error)


@pytest.mark.slow
@pytest.mark.parametrize("y0", [*NATURAL.values(), GEN, FAMILIES["upright"](1e-3)])
def test_states_at_long_times_satisfy_the_equations(y0) -> None:
    """Up to t = 3e10 a Taylor step leads from each state to the next; or the motion is unstable, which is refused."""
    h = 2.0**-5
    for n in (0, 10**3, 10**6, 10**9, 10**12):
        got = states_or_refusal(y0, h, [n, n + 1])
        if isinstance(got, str):
            assert n >= 10**3
            assert f"is unstable; its state at step {n} depends on 2^-200" in got
        else:
            later = reference_states(Kowalevski(), got[0].tolist(), np.array([h]))[0]
            np.testing.assert_allclose(got[1], later, atol=5e-14 * max(1.0, float((got[:, :3] ** 2).sum())))


def test_motion_at_a_double_root_of_the_cubic_is_refused() -> None:
    with pytest.raises(RunError, match="too close to a degenerate motion"):
        states((-1.0, 0.0, 2.0, 0.0, 0.0, 2.0), 1.0, [1])


@pytest.mark.slow
@pytest.mark.parametrize("after", [2.0**-k for k in (52, 40, 20, 10, 5)])
def test_states_next_to_a_common_passage(after: float) -> None:
    """s1 - s2 is proportional to the time from the passage; the plain formula is off by 1e-16 divided by it."""
    for name in ("pendulum at the passage", "pinch at the passage", "pinch at the passage, sideways"):
        y = NATURAL[name]
        for sign in (1, -1):
            expected = reference_states(Kowalevski(), list(y), np.array([sign * after]))[0]
            np.testing.assert_allclose(states(y, after, [sign])[0], expected, atol=2e-13)


@pytest.mark.slow
def test_small_c() -> None:
    """gamma is right to eps |omega|²/c, and weaker gravity is refused by that figure."""
    for c in (1e-2, 1e-4, 1e-6, 1e-8):
        exact = reference_states(Kowalevski(c0=c), list(GEN), np.array([10.0]))[0]
        error = np.abs(states(GEN, 1.0, [10], c)[0] - exact)
        assert error[:3].max() < 1e-13
        assert error[3:].max() < 5e-15 / c
    with pytest.raises(RunError, match=r"uncertain by eps .omega.²/c = \de-04"):
        states(GEN, 1.0, [10], 1e-12)


def test_equilibria_and_the_free_top() -> None:
    np.testing.assert_array_equal(states((2.0, 0.0, 0.0, 1.0, 0.0, 0.0), 1.0, [10**9])[0], (2, 0, 0, 1, 0, 0))
    free = reference_states(Kowalevski(c0=0.0), GEN, np.array([50.0]))[0]
    np.testing.assert_allclose(states(GEN, 0.5, [100], 0.0)[0], free, atol=2e-14)


SIGNS = [(s, u, s * u) for s, u in product((1.0, -1.0), repeat=2)]
TRIPLE_ROOTS = [
    (0.0, 0.0, 1.5, 0.0, 0.0, 1.0),  # spin about the vertical third axis
    (0.0, 0.0, -9.25, 0.0, 0.0, -1.0),
    (0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
    (0.0, 0.0, 2.0, 0.0, 0.0, 1.0),  # on the separatrix
    (0.0, 0.0, 2.0 - 2.0**-20, 0.0, 0.0, 1.0),  # and next to it
    (0.0, 0.0, 2.0 + 2.0**-20, 0.0, 0.0, 1.0),
    # elsewhere on such orbits, with sin phi = 3/5: parameters m below and above one, in both directions, mirrored
    *[(s * 3.0, s * u * 3.0, v * 8.0, 0.0, u * 18.0, s * v * 24.0) for s, u, v in SIGNS],
    *[(s * 6.0, s * u * 3.0, v * 16.0, 27.0, u * 36.0, s * v * 60.0) for s, u, v in SIGNS],
]


@pytest.mark.slow
@pytest.mark.parametrize("c", [1.0, -1.0])
@pytest.mark.parametrize("y0", TRIPLE_ROOTS)
def test_motions_with_a_triple_root(y0, c: float) -> None:
    """k = 0 and E = 2 l²/gamma²; the typical error is 1e-16 of the largest component."""
    turned = (*y0[:3], c * y0[3], c * y0[4], c * y0[5])
    assert_is_the_motion(turned, c, TIMES[:3])


def test_gravity_too_weak_to_resolve_is_refused() -> None:
    with pytest.raises(RunError, match="too weak"):
        states([1e110 * v for v in GEN[:3]] + list(GEN[3:]), 0.1, [1])
