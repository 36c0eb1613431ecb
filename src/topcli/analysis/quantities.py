"""Quantities: a user's own observables along a run, formulas of the state, the parameters of the top, t and h."""

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
    """Observable ``name`` with the text of its ``formula``; ``function(y, p)`` evaluates it (``quantities_of``)."""

    name: str
    formula: str
    function: Callable[[Sequence[Any], Sequence[Any]], Any]

    def values(self, top: Top, n: NDArray[np.int64], h: Any, states: Array) -> Array:
        """Values (m,) at ``states`` (m, d) of ``top`` after ``n`` (m,) steps of ``h``, in their arithmetic."""
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


class QuantityTally:
    """First and last value, range and mean of quantities over the rows of a run, fed in the order of time."""

    def __init__(self, quantities: Sequence[Quantity]) -> None:
        self._quantities = tuple(quantities)
        self._count = 0
        self._sums = np.full((len(self._quantities), len(FIGURES)), np.nan)
        """A row for each quantity: the ``FIGURES``, with the sum in the place of the mean."""

    def add(self, values: Mapping[str, Array]) -> None:
        """Add rows: values (m,) of each quantity by name; a value that is not finite makes the figures so."""
        count = 0
        with np.errstate(all="ignore"):
            for sums, quantity in zip(self._sums, self._quantities, strict=True):
                of_rows = values[quantity.name]
                if not (count := len(of_rows)):
                    return
                begun = self._count > 0
                sums[0] = sums[0] if begun else of_rows[0]
                sums[1] = of_rows[-1]
                sums[2] = np.minimum(sums[2], of_rows.min()) if begun else of_rows.min()
                sums[3] = np.maximum(sums[3], of_rows.max()) if begun else of_rows.max()
                sums[4] = (sums[4] if begun else 0.0) + of_rows.sum()
        self._count += count

    def rows(self) -> list[dict[str, Any]]:
        """Plain data for each quantity: name, formula and ``FIGURES``."""
        return [
            {
                "name": one.name,
                "formula": one.formula,
                **dict(zip(FIGURES, (*sums[:4], sums[4] / (self._count or 1)), strict=True)),
            }
            for one, sums in zip(self._quantities, self._sums.tolist(), strict=True)
        ]

    def state(self) -> dict[str, NDArray[Any]]:
        """All sums, from which ``restore`` continues; empty without quantities."""
        return {"quantities": np.vstack([self._sums, np.full(len(FIGURES), self._count)])} if self._quantities else {}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continue from a ``state()``. Raises KeyError or ValueError if it has another form."""
        if self._quantities:
            *sums, count = state["quantities"]
            self._sums[:] = sums
            self._count = int(count[0])
