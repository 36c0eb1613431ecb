"""Plan of a computation, and its recorded rows: columns n, t, components, invariants, quantities, the attitude.

A plan is a batch of trajectories of one top under one scheme, with the quantities observed on them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, Invariant, Top
from topcli.engine.columns import ATTITUDES, attitude_columns, column_names
from topcli.engine.machine import Machine
from topcli.engine.numbers import NotRationalError
from topcli.errors import UsageError, nearest, quoted

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


class Rows:
    """Recorded rows of trajectories of a plan; ``rows[name]`` is a column, evaluated once.

    A name is ``n``, ``t``, ``trajectory``, a component of the state, an invariant, a quantity, or a component of the
    attitude in any form.

    Attributes
    ----------
    plan : Plan
        Top, step size and observables.
    n : ndarray, shape (m,)
        Step numbers, with fractions at the crossings of a section.
    recorded : ndarray, shape (c, m, d) or (m, d)
        States in the order of ``top.components``; with an attitude, followed by its quaternion. ``states`` is without.
    first : int
        Number of the first trajectory in the plan.
    lengths : ndarray of int64, shape (c,)
        Rows that each trajectory reached; the others are arbitrary.
    columns : mapping of str to ndarray, shape (c, m), optional
        Columns that are not functions of the other arguments.
    """

    def __init__(
        self,
        plan: Plan,
        n: NDArray[Any],
        recorded: Array,
        first: int = 0,
        lengths: NDArray[np.int64] | None = None,
        columns: Mapping[str, NDArray[Any]] | None = None,
    ) -> None:
        self.plan, self.n, self.first = plan, n, first
        self.recorded, self.states = recorded, recorded[..., : len(plan.top.components)]
        self.lengths = np.full(recorded.shape[:-2], len(n)) if lengths is None else lengths
        self._columns: dict[str, NDArray[Any]] = dict(columns or {})

    def __len__(self) -> int:
        return len(self.n)

    @property
    def whole(self) -> bool:
        """True if every trajectory reached all rows."""
        return bool((self.lengths == len(self.n)).all())

    @property
    def reached(self) -> NDArray[np.bool_]:
        """True (c, m) for the rows that were reached."""
        return np.arange(len(self.n)) < self.lengths[..., None]

    @property
    def tallied(self) -> Rows:
        """The rows at which invariants are looked at: every ``plan.tallied`` steps, and all crossings of a section."""
        return self if self._thinned is None else self._thinned

    @cached_property
    def _thinned(self) -> Rows | None:
        plan = self.plan
        if plan.tallied <= plan.every or not len(self) or self.n.dtype.kind == "f":
            return None  # not itself: an object that refers to itself lives on
        start, step = -int(self.n[0]) % plan.tallied, plan.tallied // plan.every
        at, lengths = slice(start, None, step), np.maximum(0, -((start - self.lengths) // step))
        return Rows(plan, self.n[at], self.recorded[..., at, :], self.first, lengths)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Column (c, m) called ``name``, of doubles or, for ``n``, of integers. Raises UsageError if there is none."""
        values = self.numbers(name)
        return values.astype(np.float64) if values.dtype == np.object_ else values

    def numbers(self, name: str) -> NDArray[Any]:
        """Column (c, m) in the arithmetic of the states; nan where a quotient does not exist."""
        if name not in self._columns:
            with np.errstate(all="ignore"):
                self._columns[name] = self._column(name)
        return self._columns[name]

    def _column(self, name: str) -> NDArray[Any]:
        plan, shape = self.plan, self.states.shape[:-1]
        if name == "n":
            return np.broadcast_to(self.n, shape)
        if name == "trajectory":
            return np.broadcast_to(np.arange(shape[0])[:, None] + self.first + plan.first, shape)
        if name == "t":
            return np.broadcast_to(self.n * plan.h, shape)
        if name in plan.top.components:
            return self.flat[:, plan.top.components.index(name)].reshape(shape)
        if name in plan.functions:
            values = _evaluated(plan.functions[name], self)
            rational = plan.precise and not plan.precise.arithmetic.bits
            if rational and any(isinstance(x, float) and x == x for x in values):
                raise NotRationalError(f"precision: {name!r} has no rational values; leave it out or choose another")
            return values.reshape(shape)
        for form, names in ATTITUDES.items() if plan.attitude else ():
            if name in names:
                q = np.array(self.recorded[..., self.states.shape[-1] :].reshape(-1, 4), order="F")
                return attitude_columns(form, q)[name].reshape(shape)
        usable = dict.fromkeys((*column_names(plan.top, plan.functions), *ATTITUDES.get(plan.attitude, ())))
        raise UsageError(f"no column {quoted(name)}; {nearest(name, usable)}")

    @cached_property
    def flat(self) -> Array:
        """States (c m, d) of all rows in a row, copied; each component is contiguous."""
        return np.array(self.states.reshape(-1, self.states.shape[-1]), order="F")

    @property
    def steps(self) -> NDArray[Any]:
        """Step numbers (c m,) of all rows in a row."""
        return np.tile(self.n, len(self.flat) // max(len(self.n), 1))

    def scale(self, invariant: int) -> Array:
        """Sum of the magnitudes of the terms of an invariant (c, m)."""
        with np.errstate(all="ignore"):
            states = self.flat.astype(np.float64, order="K", copy=False)
            return self.plan.invariants[invariant].scale(states).reshape(self.states.shape[:-1])

    def columns(self, names: Iterable[str]) -> dict[str, NDArray[Any]]:
        """Columns (k,) of the rows that were reached, trajectory by trajectory."""
        chosen = slice(None) if self.whole else self.reached.ravel()
        return {name: self[name].reshape(-1)[chosen] for name in names}


def _evaluated(function: Observable, rows: Rows) -> NDArray[Any]:
    """Values (c m,) of a function of rows; nan where numbers of another arithmetic divide by zero."""
    try:
        return function(rows)
    except ZeroDivisionError:
        if len(rows.flat) == 1:
            return np.array([np.nan], dtype=object)
        each = [Rows(rows.plan, rows.steps[i : i + 1], rows.flat[None, i : i + 1]) for i in range(len(rows.flat))]
        return np.concatenate([_evaluated(function, row) for row in each])
