"""What a peer's file gives: ``variants(problem)``, each with a ladder of settings and a call for each of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from topcli.contracts import Array, Top

Call = Callable[[], Array]
"""Integrate once, warm; the states at the problem's times, shape (m, d). Raises PeerError."""


class PeerError(Exception):
    """A peer says, or its numbers show, that it did not solve the problem; the message is its reason."""


@dataclass(frozen=True)
class Problem:
    """The motion of ``top`` from ``y0`` at time zero, to be recorded at ``times`` (m,), the first of them zero."""

    top: Top
    y0: Array
    times: Array

    @property
    def d(self) -> int:
        """The length of the state."""
        return len(self.y0)


@dataclass(frozen=True)
class Variant:
    """One way to use a peer. ``prepare(value)`` compiles all there is to compile for one value of ``parameter``."""

    name: str
    parameter: str
    values: Sequence[float]
    prepare: Callable[[float], Call]


def decades(first: int, last: int, step: int = 1) -> list[float]:
    """10^first, 10^(first - step), ... down to 10^last."""
    return [float(f"1e{exponent}") for exponent in range(first, last - 1, -step)]


def compiled_field(top: Top) -> Any:
    """The top's right-hand side as a numba function of the state's tuple and the constants' tuple, inlined."""
    from numba import njit

    from topcli.engine.source import compilable_copy

    jit = njit(forceinline=True, error_model="numpy")
    return jit(compilable_copy(top.field, jit))


def checked(states: Array, problem: Problem) -> Array:
    """``states`` when they are all there and finite. Raises PeerError."""
    if states.shape != (len(problem.times), problem.d):
        raise PeerError(f"gave states of shape {states.shape}; expected {(len(problem.times), problem.d)}")
    if not np.isfinite(states).all():
        raise PeerError("gave states that are not finite")
    return states
