"""Quantities: the user's own formulas of the state, the parameters of the top, t and h, evaluated along a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, Top
from topcli.field.expression import parse, value_of

TIME, STEP = "t", "h"
"""Names of the time and of the step size in a formula, unless the top has others of these names."""


@dataclass(frozen=True)
class Quantity:
    """Formula given in ``output.quantities`` of a config.

    ``name`` is the name of its column, and ``formula`` is its text. ``function(y, p)`` evaluates the formula. ``y``
    contains the components of the state and the time; ``p`` contains the parameters of the top, and h.
    """

    name: str
    formula: str
    function: Callable[[Sequence[Any], Sequence[Any]], Any]

    def values(self, top: Top, n: NDArray[Any], h: Any, states: Array) -> Array:
        """Return the values of the formula at given states of ``top``, shape (m,).

        ``states``, shape (m, d), are the states after ``n`` steps of ``h``; ``n`` has shape (m,).
        """
        parameters = (getattr(top, name) for name in type(top).model_fields)
        t = np.array([int(step) * h for step in n], dtype=object) if states.dtype.hasobject else n * h
        with np.errstate(all="ignore"):
            values = self.function((*states.T, t), (*parameters, h))
            return values + np.zeros(len(states), dtype=states.dtype)


def quantity_names(cls: type[Top]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names that change along a run and those that do not, in the order of the arguments of ``Quantity.function``."""
    own = {*cls.components, *cls.model_fields}
    # one that the top uses itself is given a name that no formula can hold
    time, step = (name if name not in own else f"({name})" for name in (TIME, STEP))
    return (*cls.components, time), (*cls.model_fields, step)


def usable_names(cls: type[Top]) -> tuple[str, ...]:
    """Names that the formula of a quantity may use."""
    moving, fixed = quantity_names(cls)
    return tuple(name for name in (*moving, *fixed) if not name.startswith("("))


def quantities_of(cls: type[Top], formulas: Mapping[str, str] | None) -> tuple[Quantity, ...]:
    """Quantities of tops of class ``cls`` by their formulas, in that order. Raises ExpressionError."""
    return _quantities(cls, tuple((formulas or {}).items()))


@cache
def _quantities(cls: type[Top], formulas: tuple[tuple[str, str], ...]) -> tuple[Quantity, ...]:
    usable = usable_names(cls)
    return tuple(Quantity(name, text, value_of(parse(text, usable), *quantity_names(cls))) for name, text in formulas)


FIGURES = ("first", "last", "min", "max", "mean")
LOW, HIGH = FIGURES.index("min"), FIGURES.index("max")


class QuantityTally:
    """First and last value, range and mean of quantities over the rows of ``count`` trajectories, fed in time order.

    Different trajectories may be added from different threads.
    """

    def __init__(self, quantities: Sequence[Quantity], count: int = 1) -> None:
        self.quantities = tuple(quantities)
        self._rows = np.zeros(count, dtype=np.int64)
        self._sums = np.full((len(self.quantities), len(FIGURES), count), np.nan)
        """For each quantity the ``FIGURES``, with the sum in the place of the mean."""

    def add(self, values: Mapping[str, Array], first: int = 0, kept: NDArray[np.int64] | None = None) -> None:
        """Add rows of the trajectories from ``first`` on: values (trajectories * m,) of each quantity by name.

        Only the first ``kept[i]`` rows of each count; by default there is one trajectory. A value that is not finite
        makes the figures so.
        """
        if not self.quantities:
            return
        if kept is None:
            kept = np.array([len(values[self.quantities[0].name])])
        here, count = slice(first, first + len(kept)), len(kept)
        fresh, some = self._rows[here] == 0, kept > 0
        if not some.any():
            return
        with np.errstate(all="ignore"):
            for sums, quantity in zip(self._sums[:, :, here], self.quantities, strict=True):
                rows = values[quantity.name].reshape(count, -1)
                beyond = np.arange(rows.shape[1]) >= kept[:, None]
                low, high = np.where(beyond, np.inf, rows).min(axis=1), np.where(beyond, -np.inf, rows).max(axis=1)
                total = np.where(beyond, 0.0, rows).sum(axis=1)
                new = (
                    np.where(fresh, rows[:, 0], sums[0]),
                    rows[np.arange(count), kept - 1],
                    np.where(fresh, low, np.minimum(sums[2], low)),
                    np.where(fresh, high, np.maximum(sums[3], high)),
                    np.where(fresh, 0.0, sums[4]) + total,
                )
                sums[:] = np.where(some, new, sums)
        self._rows[here] += kept

    @property
    def figures(self) -> Array:
        """``FIGURES`` of each quantity (quantities, figures, trajectories); nan without rows."""
        return np.concatenate([self._sums[:, :4], self._sums[:, 4:] / np.maximum(self._rows, 1)], axis=1)

    def together(self) -> tuple[Array, int]:
        """``FIGURES`` (quantities, figures) of all trajectories with rows, and how many these are.

        First, last and mean are averages over the trajectories.
        """
        figures = self.figures[:, :, self._rows > 0]
        count = figures.shape[2]
        if not count:
            return np.full(figures.shape[:2], np.nan), 0
        joined = figures.mean(axis=2)
        joined[:, LOW], joined[:, HIGH] = figures[:, LOW].min(axis=1), figures[:, HIGH].max(axis=1)
        return joined, count

    def rows(self) -> list[dict[str, Any]]:
        """Plain data for each quantity: name, formula and ``FIGURES``, of all trajectories ``together``."""
        return quantity_rows(self.quantities, [self.together()])

    def columns(self) -> dict[str, Array]:
        """``first.<quantity>`` and the other ``FIGURES`` (trajectories,)."""
        return {
            f"{figure}.{quantity.name}": values
            for quantity, figures in zip(self.quantities, self.figures, strict=True)
            for figure, values in zip(FIGURES, figures, strict=True)
        }

    def state(self) -> dict[str, NDArray[Any]]:
        """All sums, from which ``restore`` continues; empty without quantities."""
        counts = np.broadcast_to(self._rows, (1, len(FIGURES), len(self._rows)))
        return {"quantities": np.concatenate([self._sums, counts])} if self.quantities else {}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continue from a ``state()``. Raises KeyError or ValueError if it has another form."""
        if self.quantities:
            self._sums[:] = state["quantities"][:-1]
            self._rows[:] = state["quantities"][-1, 0]


def quantity_rows(quantities: Sequence[Quantity], parts: Sequence[tuple[Array, int]]) -> list[dict[str, Any]]:
    """Plain data for each quantity: name, formula and ``FIGURES`` of several parts (``QuantityTally.together``)."""
    parts = [part for part in parts if part[1]] or list(parts)
    if not quantities or not parts:
        return []
    figures = np.array([part for part, _ in parts])
    with np.errstate(all="ignore"):
        joined = np.average(figures, axis=0, weights=[max(count, 1) for _, count in parts])
    joined[:, LOW], joined[:, HIGH] = figures[:, :, LOW].min(axis=0), figures[:, :, HIGH].max(axis=0)
    return [
        {"name": one.name, "formula": one.formula, **dict(zip(FIGURES, row, strict=True))}
        for one, row in zip(quantities, joined.tolist(), strict=True)
    ]
