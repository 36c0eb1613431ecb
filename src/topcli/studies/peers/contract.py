"""Contract of a peer's file: ``variants(problem)``, each with a ladder of settings and a call for each setting."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from topcli.contracts import Array, Top

Call = Callable[[], Array]
"""Integrate once, warm, and return the states at the problem's times, shape (m, d). Raises PeerError."""


class PeerError(Exception):
    """A peer did not solve the problem, as it reports or its numbers show; the message is the reason."""


@dataclass(frozen=True)
class Problem:
    """The motion of ``top`` from ``y0`` at time zero, to be recorded at ``times`` (m,), the first of them zero."""

    top: Top
    y0: Array
    times: Array

    @property
    def d(self) -> int:
        """Number of components of the state."""
        return len(self.y0)


@dataclass(frozen=True)
class Variant:
    """One way to use a peer; ``prepare(value)`` compiles everything for one value of ``parameter``."""

    name: str
    parameter: str
    values: Sequence[float]
    prepare: Callable[[float], Call]


def decades(first: int, last: int, step: int = 1) -> list[float]:
    """Return 10^first, 10^(first - step), ... down to 10^last."""
    return [float(f"1e{exponent}") for exponent in range(first, last - 1, -step)]


def compiled_field(top: Top) -> Any:
    """Return the top's right-hand side as an inlined numba function of the tuples of state and constants."""
    from numba import njit

    from topcli.engine.source import compilable_copy

    jit = njit(forceinline=True, error_model="numpy")
    return jit(compilable_copy(top.field, jit))


def checked(states: Array, problem: Problem) -> Array:
    """Return ``states`` if they are complete and finite; raise PeerError otherwise."""
    if states.shape != (len(problem.times), problem.d):
        raise PeerError(f"gave states of shape {states.shape}; expected {(len(problem.times), problem.d)}")
    if not np.isfinite(states).all():
        raise PeerError("gave states that are not finite")
    return states
