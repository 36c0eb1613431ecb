"""Series from states at or near zero, and with gaps: ``taylor`` and the reference against closed forms.

The step is relative to the size of the state; near zero, to that of the motion in the step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction

import mpmath
import numpy as np
import pytest

from fields import top_of
from topcli.analysis.reference import reference_states
from topcli.contracts import Outcome, Top
from topcli.engine.drive import orbit
from topcli.field.polynomial import Field, Polynomial
from topcli.schemes.any_top.taylor import Tolerance, build_taylor

Solution = Callable[[Top, list[float], float, int], np.ndarray]
MOST_SERIES = 400


def by_taylor(top: Top, y0: list[float], h: float, N: int) -> np.ndarray:
    _, states, ending = orbit(top, build_taylor(top, Tolerance()), y0, h, N)
    assert ending.outcome is Outcome.COMPLETED
    assert ending.counters["expansions"] < MOST_SERIES
    return states


def by_reference(top: Top, y0: list[float], h: float, N: int) -> np.ndarray:
    return reference_states(top, y0, h * np.arange(N + 1), max_steps=MOST_SERIES)


of_each = pytest.mark.parametrize("solution", [by_taylor, by_reference])


def system(*rates: dict[tuple[int, ...], object]) -> Field:
    return tuple(Polynomial({monomial: Fraction(c) for monomial, c in rate.items()}) for rate in rates)


DRIVEN = system({(1,): 1}, {(): 1, (0,): -1, (1,): "-0.3"})
"""x'' = 1 - x - 0.3 x'."""


@of_each
@pytest.mark.parametrize("start", [0.0, 1e-300, 1e-30, -1e-9])
def test_a_driven_oscillator_leaves_the_origin(solution: Solution, start: float) -> None:
    h, N = 0.25, 80
    states, t, w = solution(top_of(DRIVEN), [start, 0.0], h, N), h * np.arange(N + 1), math.sqrt(1.0 - 0.15**2)
    x = 1.0 - (1.0 - start) * np.exp(-0.15 * t) * (np.cos(w * t) + 0.15 / w * np.sin(w * t))
    assert np.abs(states[:, 0] - x).max() < 4e-15


@pytest.mark.slow
@of_each
@pytest.mark.parametrize("start", [0.0, 1e-200, 1e-9, 1.0])
@pytest.mark.parametrize("h", [1e-6, 0.1, 1e4])
def test_a_polynomial_in_time_is_its_own_series(solution: Solution, start: float, h: float) -> None:
    """a' = b², b' = 0; x' = v, v' = w, w' = 1: no step is as short as the time in which a component changes much."""
    top = top_of(system({(1, 1): 1}, {}, {(3,): 1}, {(4,): 1}, {(): 1}))
    y0, N = [start, 1.5, start, 0.0, -start], 1000
    t = h * np.arange(N + 1)
    states = solution(top, y0, h, N)
    exact = np.array(
        [start + 2.25 * t, 1.5 + 0.0 * t, start + t * t * (t / 6.0 - start / 2.0), t * (t / 2.0 - start), t - start]
    )
    size = np.abs([start + 0.0 * t, 1.5 + 0.0 * t, start + t * t * start, t * start, start + 0.0 * t]) + np.abs(exact)
    assert (np.abs(states - exact.T) <= 1e-15 * size.T).all()


def gap_motion(n: int, t: float) -> list[float]:
    """x and x' of x'' = t^n x with x = 1, x' = 0 at 0: hypergeometric series of z = t^g/g^2, g = n + 2."""
    with mpmath.workdps(40):
        s, g = mpmath.mpf(t), mpmath.mpf(n + 2)
        b, z = 1 - 1 / g, s**g / g**2
        return [float(mpmath.hyp0f1(b, z)), float(mpmath.hyp0f1(b + 1, z) / b * g * z / s)]


@of_each
@pytest.mark.parametrize("n", [5, *(pytest.param(n, marks=pytest.mark.slow) for n in range(24) if n != 5)])
def test_series_with_gaps_are_summed_in_safe_steps(solution: Solution, n: int) -> None:
    """From t = 0, all coefficients but those of every (n + 2)th power vanish, among them those that set the step."""
    top = top_of(system({(): 1}, {(2,): 1}, {(0,) * n + (1,): 1}))
    h, N = 0.125, 14
    states = solution(top, [0.0, 1.0, 0.0], h, N)
    exact = np.array([gap_motion(n, h * k) for k in range(1, N + 1)])
    assert (np.abs(states[1:, 1:] - exact).max(axis=1) / np.abs(exact).max(axis=1)).max() < 1e-14  # seen: 5e-15
