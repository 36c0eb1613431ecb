"""Compiled steps of any scheme, called with physical states."""

from __future__ import annotations

import numpy as np

from conftest import random_states
from topcli.contracts import Outcome, Stepper, Top
from topcli.engine.driver import loop_of
from topcli.engine.loop import Run
from topcli.schemes.registry import find_scheme


def made(top: Top, name: str, **options: object) -> Stepper:
    scheme = find_scheme(name, top.form)
    method = scheme.build(top, scheme.options(**options))
    assert isinstance(method, Stepper)
    return method


class Steps:
    """Compiled steps of a scheme on physical states."""

    def __init__(self, top: Top, name: str, **options: object) -> None:
        self.top, self.method = top, made(top, name, **options)
        self.loop = loop_of(self.method, len(top.components), len(top.constants()))

    def run(self, y, h: float, N: int) -> Run:
        return Run(self.top, self.loop, y, h, N, N)

    def __call__(self, y, h: float, N: int = 1) -> np.ndarray:
        run = self.run(y, h, N)
        states = run.collect().states
        assert run.ending is not None
        assert run.ending.outcome is Outcome.COMPLETED, run.ending.message
        return states[-1]


def states_of(top: Top, count: int, seed: int) -> np.ndarray:
    return random_states(count, seed)[:, : len(top.components)]


def root_mean_square(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))
