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


def compilable_rates(problem: Problem, template: str, **scope: Any) -> Callable[..., Any]:
    """Return the function ``rates`` of a ``template`` of Python text, to be compiled by numba.

    In the template {items} are the components of the state y, {p} the constants, {store} copies the result f of the
    inlined right-hand side ``field`` to ``out``; ``scope`` holds further names that it uses.
    """
    from numba import njit

    from topcli.engine.source import compilable_copy

    jit, d = njit(forceinline=True, error_model="numpy"), problem.d
    text = template.format(
        items="".join(f"y[{i}], " for i in range(d)),
        p=repr(tuple(map(float, problem.top.constants()))),
        d=d,
        store="\n    ".join(f"out[{i}] = f[{i}]" for i in range(d)),
    )
    scope["field"] = jit(compilable_copy(problem.top.field, jit))
    exec(compile(text, "<right-hand side>", "exec"), scope)
    return scope["rates"]


def checked(states: Array, problem: Problem) -> Array:
    """Return ``states`` if they are complete and finite; raise PeerError otherwise."""
    if states.shape != (len(problem.times), problem.d):
        raise PeerError(f"gave states of shape {states.shape}; expected {(len(problem.times), problem.d)}")
    if not np.isfinite(states).all():
        raise PeerError("gave states that are not finite")
    return states
