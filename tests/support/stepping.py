"""Compiled steps of any scheme, called with physical states, runs of them, and how far integrals deviate."""

from __future__ import annotations

import numpy as np

from conftest import random_states
from topcli.contracts import Ending, Outcome, Stepper, Top
from topcli.engine.drive import orbit
from topcli.engine.machine import Machine
from topcli.schemes.registry import find_scheme
from topcli.tops.kowalevski import Kowalevski

EPS = 2.0**-52


def made(top: Top, name: str, **options: object) -> Stepper:
    scheme = find_scheme(name, top.form)
    method = scheme.build(top, scheme.options(**options))
    assert isinstance(method, Stepper)
    return method


class Steps:
    """Compiled steps of a scheme on physical states."""

    def __init__(self, top: Top, name: str, **options: object) -> None:
        self.top, self.method = top, made(top, name, **options)
        self.machine = Machine(top, self.method)

    def __call__(self, y, h: float, N: int = 1) -> np.ndarray:
        _, states, ending = orbit(self.top, self.machine, y, h, N, N)
        assert ending.outcome is Outcome.COMPLETED, ending.message
        return states[-1]


def states_of(top: Top, count: int, seed: int) -> np.ndarray:
    return random_states(count, seed)[:, : len(top.components)]


def root_mean_square(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


def stepper(name: str, top: Top | None = None, **options: object) -> Stepper:
    """A scheme of the Kowalevski top."""
    return made(top or Kowalevski(), name, **options)


def ran(method: Stepper, y0, h: float, N: int, every: int = 1, top: Top | None = None) -> tuple[np.ndarray, Ending]:
    """States and ending of a run of the Kowalevski top."""
    _, states, ending = orbit(top or Kowalevski(), method, y0, h, N, every)
    return states, ending


def deviations(states: np.ndarray, top: Top | None = None) -> dict[str, float]:
    """Largest deviations of the integrals from their first values, in ulp of their terms' sizes."""
    found = {}
    for invariant in (top or Kowalevski()).invariants():
        values = invariant.value(states)
        found[invariant.name] = float(np.abs(values - values[0]).max() / (EPS * invariant.scale(states).max() or 1.0))
    return found


def gradients(top: Top, y) -> np.ndarray:
    """Gradients (d, count) of the integrals of a top, by complex steps: right to the last bit."""
    moved = np.asarray(y) + 1e-30j * np.eye(len(y))
    return np.array([invariant.value(moved).imag / 1e-30 for invariant in top.invariants()]).T
