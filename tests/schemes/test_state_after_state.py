"""What a scheme computes from a state does not depend on the states that it was given before."""

from __future__ import annotations

import functools
import sys

import numpy as np
import pytest

from steppers import built
from topcli.contracts import Scheme
from topcli.engine.collect import orbit
from topcli.engine.machine import Machine
from topcli.errors import TopcliError
from topcli.schemes.registry import all_schemes, find_scheme
from topcli.tops import TOPS

H, N = 0.1, 3
STATES = 6


def forget() -> None:
    """Empty the caches of the schemes for single tops, such as those of closed forms, as in a new process."""
    for name, module in list(sys.modules.items()):
        if name.startswith(("topcli.schemes.euler", "topcli.schemes.kowalevski", "topcli.schemes.lagrange")):
            for value in vars(module).values():
                if isinstance(value, functools._lru_cache_wrapper):
                    value.cache_clear()


def states_with_zeros(d: int, seed: int) -> np.ndarray:
    """The origin, and states of which every other component is zero on average."""
    random = np.random.default_rng(seed)
    y = random.normal(size=(STATES, d)) * (random.random((STATES, d)) < 0.5)
    y[0] = 0.0
    return y


def image(scheme: Scheme, machine: Machine, y: np.ndarray) -> bytes:
    """Recorded states and outcome of a run from ``y``, or the reason why there is none."""
    try:
        _, states, ending = orbit(TOPS[scheme.top].new(), machine, y, H, N)
    except TopcliError as error:
        return str(error).encode()
    return states.tobytes() + ending.outcome.encode()


def check_states_in_turn(scheme: Scheme, seed: int) -> None:
    top = TOPS[scheme.top].new()
    y = states_with_zeros(len(top.components), seed)
    forget()
    with np.errstate(all="ignore"):
        shared = Machine(top, built(scheme.name, top))
        in_turn = [image(scheme, shared, state) for state in y]
        for state, earlier in zip(y[::-1], in_turn[::-1], strict=True):
            forget()
            assert image(scheme, Machine(top, built(scheme.name, top)), state) == earlier, state


def test_a_series_does_not_depend_on_earlier_states() -> None:
    check_states_in_turn(find_scheme("taylor", "euler"), seed=1)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", all_schemes(), ids=lambda s: f"{s.name}/{s.top}")
def test_a_step_does_not_depend_on_earlier_states(scheme: Scheme) -> None:
    check_states_in_turn(scheme, seed=1)
