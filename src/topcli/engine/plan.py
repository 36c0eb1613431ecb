"""Plan of a computation: a batch of trajectories of one top under one scheme, and the quantities observed on them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from topcli.contracts import Array, Invariant, Top
from topcli.engine.machine import Machine

if TYPE_CHECKING:
    from topcli.analysis.quantities import Quantity
    from topcli.engine.numbers import PreciseRun

Observable = Callable[[Any], Array]
"""Function of ``Rows`` whose values are those at each row (k,)."""


@dataclass(frozen=True)
class Plan:
    """A batch of B trajectories, their steps, and what can be observed of them.

    Attributes
    ----------
    top : Top
        Top with its parameters as doubles.
    machine : Machine
        Code of the scheme; None for rows that were recorded elsewhere.
    states : ndarray, shape (B, d)
        Initial states; with an ``attitude``, each is followed by a quaternion (B, d + 4).
    h : float
        Step size.
    N, every : int
        Number of steps, and of those from one recorded row to the next.
    tallied : int
        Number of steps from one row to the next at which invariants are looked at, a multiple of ``every``; 0 for
        ``every``.
    first : int
        Number of the first trajectory in the whole ensemble.
    invariants : tuple of Invariant
        Integrals of the top and of the scheme, as functions of doubles.
    quantities : tuple of Quantity
        Observables of the user.
    precise : PreciseRun, optional
        Top, step and constants in another arithmetic; the states are then arrays of its numbers.
    exact : tuple of Invariant
        The ``invariants`` in that arithmetic.
    attitude : str
        Form in which the attitude is recorded; empty for none.
    """

    top: Top
    machine: Machine | None
    states: Array
    h: float
    N: int
    every: int = 1
    tallied: int = 0
    first: int = 0
    invariants: tuple[Invariant, ...] = ()
    quantities: tuple[Quantity, ...] = ()
    precise: PreciseRun | None = None
    exact: tuple[Invariant, ...] = ()
    attitude: str = ""

    @property
    def step(self) -> Any:
        """Step size in the arithmetic of the states."""
        return self.precise.h if self.precise else self.h

    def active(self) -> AbstractContextManager[Any]:
        """Context in which numbers of the arithmetic of the states compute."""
        return self.precise.arithmetic.active() if self.precise else nullcontext()

    @cached_property
    def functions(self) -> dict[str, Observable]:
        """Observables by name."""
        top, h = (self.precise.top if self.precise else self.top), self.step
        invariants: dict[str, Observable] = {
            each.name: lambda rows, each=each: each.value(rows.flat) for each in self.exact or self.invariants
        }
        return invariants | {
            each.name: lambda rows, each=each: each.values(top, rows.steps, h, rows.flat) for each in self.quantities
        }
