"""Measurements that test the declarations of a scheme or top, for ``topcli check`` and the tests.

The measures take a top and a method, whoever wrote them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from topcli.analysis.order import one_step_back_and_forth
from topcli.contracts import Array, Invariant, Method, Outcome, Stepper, Top
from topcli.engine.drive import drive, orbit
from topcli.engine.loops import interpreted, loop_of
from topcli.engine.machine import Machine
from topcli.engine.rows import Plan

ULPS = 50.0
"""Deviation of an exact invariant that round-off may cause, in ulp of its terms times the square root of the steps."""


def states_near(y0: Sequence[float], count: int) -> Array:
    """States (count, d) of the size of ``y0``, the first of which is ``y0``; components of zero are moved too."""
    y, number = np.array(y0, dtype=float), np.arange(count)[:, None]
    size = max(float(np.abs(y).max()), 1e-3)
    return y + 0.3 * size * (number > 0) * np.cos(1.0 + 2.0 * number + 3.0 * np.arange(len(y)))


def reversal_defect(top: Top, method: Method, h: float, states: Array) -> float:
    """Largest component missed by one step there and one back, over the ``states`` (n, d)."""
    return max(one_step_back_and_forth(top, method, y, h) for y in states)


def deviation(states: Array, invariant: Invariant, steps: int) -> float:
    """Largest deviation of an invariant from its first value, in units of what round-off explains.

    The unit is ``ULPS`` ulp of its terms times the square root of the number of ``steps`` taken.
    """
    values, scale = invariant.value(states), float(invariant.scale(states).max())
    return float(np.abs(values - values[0]).max()) / (ULPS * np.finfo(float).eps * math.sqrt(steps) * scale or 1.0)


def working_states(top: Top, method: Stepper, y0: Sequence[float], h: float, N: int) -> list[list[float]]:
    """Working state after N steps of the interpreter, and of machine code."""
    start, p, states = np.array(y0, dtype=float), np.array(top.constants()), []
    for make in (interpreted, loop_of):
        loop, work = make(method, len(start), len(p)), np.zeros(method.width)
        loop.enter(start, work, p, h)
        loop.take_steps(work, work[:0], p, h, N, N + 1, N + 1)
        states.append(work.tolist())
    return states


def differing_lanes(top: Top, method: Method, alone: Array, together: Array, h: float, N: int) -> int:
    """Number of states (n, d) whose trajectory ``alone`` ends on other bits than that ``together`` with the others."""
    machine = Machine(top, method)
    last = drive(Plan(top, machine, np.ascontiguousarray(together), h, N, N)).last
    ends = [orbit(top, machine, y, h, N, N).states[-1] for y in alone]
    return sum(end.tobytes() != other.tobytes() for end, other in zip(ends, last, strict=True))


def completed(top: Top, method: Method, y0: Sequence[float], h: float, N: int) -> Array | None:
    """States of every tenth step of a run; None if it does not complete."""
    _, states, ending = orbit(top, method, y0, h, N, 10)
    return states if ending.outcome in (Outcome.COMPLETED, Outcome.LEFT_MOTION) else None


def is_vector_of(rates: Any, top: Top) -> bool:
    """True if ``rates`` are as many finite floats as the top has components."""
    return (
        isinstance(rates, tuple)
        and len(rates) == len(top.components)
        and all(isinstance(x, int | float) and math.isfinite(x) for x in rates)
    )
